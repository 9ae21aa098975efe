//! Work from the page, in a real browser: tasks, places and points are planned, judged, drawn and
//! started. Needs Chromium; `cargo xtask test` installs it where it is missing.
#![cfg(unix)]

mod browser;

use browser::{Browser, Page, Serve, distance_mm, tool_mm};
use mcdpr_tests::process::{Folder, alone};
use std::time::Duration;

/// Long enough for a busy machine.
const PATIENCE: Duration = Duration::from_secs(120);

fn wait(page: &mut Page, what: &str) {
    page.wait(what, PATIENCE);
}

const IDLE: &str =
    "mcdpr.live.state === 'Disarmed' && mcdpr.live.brakes_open === 0 && !mcdpr.live.task";
const ALLOWED: &str = "mcdpr.work.preview && mcdpr.work.preview.ok";

/// A page with the controls of an idle robot; its simulated time passes five times as fast.
fn at_work(browser: &mut Browser, serve: &Serve) -> Page {
    let mut page = browser.open(&serve.with_token());
    wait(&mut page, "mcdpr.may && mcdpr.live && mcdpr.live.pose");
    wait(
        &mut page,
        "document.getElementById('task-list').options.length > 0",
    );
    wait(&mut page, IDLE);
    page
}

/// Starts the plan that is shown, and waits until the robot is parked again.
fn carry_out(page: &mut Page) {
    wait(page, "!document.getElementById('plan-start').disabled");
    page.click("#plan-start");
    wait(page, "mcdpr.live.state === 'Moving'");
    wait(page, IDLE);
}

#[test]
fn a_task_is_chosen_planned_drawn_and_started_and_runs_once() {
    let _alone = alone();
    let folder = Folder::new("cockpit-tasks");
    let tasks = folder.path().join("tasks");
    let serve = Serve::start(&[
        "--idle",
        "--time-scale",
        "5",
        "--tasks",
        tasks.to_str().unwrap(),
    ]);
    let mut browser = Browser::start();
    let mut page = at_work(&mut browser, &serve);
    page.click("#tab-tasks");
    // Without a plan nothing can be started, and the button says why.
    page.fill("task-list", "paper:table7");
    assert!(page.truth("document.getElementById('plan-start').disabled"));
    assert!(page.truth("document.getElementById('task-edit').disabled"));
    assert!(page.truth("document.getElementById('task-edit').title.includes('built-in')"));
    page.click("#task-plan");
    wait(&mut page, ALLOWED);
    let words = page.text("verdict-words");
    assert!(
        words.contains("paper:table7") && words.contains("% left"),
        "{words}"
    );
    // Every limit is listed, the tightest first.
    assert!(page.number("document.getElementById('margins').rows.length") > 10.0);
    let left =
        "[...document.getElementById('margins').rows].map(r => parseFloat(r.cells[2].textContent))";
    assert!(page.truth(&format!("{left}.every((v, i, a) => !i || a[i - 1] <= v)")));
    assert!(
        page.truth("mcdpr.live.state === 'Disarmed'"),
        "a plan moves nothing"
    );
    wait(&mut page, "!document.getElementById('plan-start').disabled");
    page.click("#plan-start");
    wait(&mut page, "mcdpr.live.state === 'Moving'");
    // A second start waits for nothing: it is refused while the first is under way.
    page.run("mcdpr.send({ order: 'start' })");
    wait(
        &mut page,
        "mcdpr.answers.some(m => m.order === 'start' && !m.ok && m.reason.includes('under way'))",
    );
    wait(&mut page, IDLE);
    // It is not repeated by itself: an order that comes later is the next thing in the log.
    wait(
        &mut page,
        "document.getElementById('log').textContent.includes('the task is done')",
    );
    page.click("[data-order=hold]");
    wait(
        &mut page,
        "mcdpr.answers.some(m => m.order === 'hold' && !m.ok)",
    );
    assert!(page.truth(IDLE));
}

#[test]
fn a_text_is_planned_refused_corrected_saved_and_not_replaced_by_mistake() {
    let _alone = alone();
    let folder = Folder::new("cockpit-text");
    let tasks = folder.path().join("tasks");
    let words = ["--idle", "--tasks", tasks.to_str().unwrap()];
    let serve = Serve::start(&words);
    let mut browser = Browser::start();
    let mut page = at_work(&mut browser, &serve);
    page.click("#tab-points");
    page.click("#teach");
    page.run("mcdpr.work.points.push([300, -60, mcdpr.work.points[0][2]])");
    wait(
        &mut page,
        "!document.getElementById('points-edit').disabled",
    );
    page.click("#points-edit");
    // What the page has written is a task within every limit.
    page.click("#text-plan");
    wait(&mut page, ALLOWED);
    let good = page.run("document.getElementById('task-text').value");
    let good = good.as_str().unwrap().to_owned();
    // A place outside is refused with the limit, and cannot be started by any way.
    page.fill("task-text", &good.replace("[300.00,", "[3000.00,"));
    page.click("#text-plan");
    wait(
        &mut page,
        "document.getElementById('verdict').classList.contains('broken')",
    );
    assert!(page.truth("document.getElementById('plan-start').disabled"));
    for start in [
        "{ order: 'start', plan: mcdpr.work.preview.id }",
        "{ order: 'start' }",
    ] {
        page.run("mcdpr.answers.length = 0");
        page.run(&format!("mcdpr.send({start})"));
        wait(
            &mut page,
            "mcdpr.answers.some(m => m.order === 'start' && !m.ok && m.reason.includes('breaks a limit'))",
        );
    }
    // A text that is not a task says where.
    page.fill("task-text", "start_mm = [1, 2]");
    page.click("#text-save");
    wait(
        &mut page,
        "document.getElementById('verdict-words').textContent.includes('points.toml')",
    );
    assert!(!tasks.exists(), "a refused task leaves no file");
    page.fill("task-text", &good);
    page.click("#text-save");
    wait(
        &mut page,
        "document.getElementById('verdict-words').textContent.includes('is saved')",
    );
    assert_eq!(
        std::fs::read_to_string(tasks.join("points.toml")).unwrap(),
        good
    );
    let other = good.replace("[300.00,", "[290.00,");
    page.fill("task-text", &other);
    page.click("#text-save");
    wait(
        &mut page,
        "document.getElementById('verdict-words').textContent.includes('exists already')",
    );
    assert_eq!(
        std::fs::read_to_string(tasks.join("points.toml")).unwrap(),
        good
    );
    page.click("#text-save");
    wait(
        &mut page,
        "document.getElementById('verdict-words').textContent.includes('is saved')",
    );
    assert_eq!(
        std::fs::read_to_string(tasks.join("points.toml")).unwrap(),
        other
    );
    // Letters in a text are letters: they start nothing.
    page.run("mcdpr.answers.length = 0; document.getElementById('task-text').focus()");
    for key in ["g", "r", " "] {
        page.press(key);
    }
    page.press("Escape");
    wait(&mut page, "mcdpr.answers.some(m => m.order === 'stop')");
    assert!(page.truth("mcdpr.answers.every(m => m.order === 'stop')"));
    let typed = "document.getElementById('task-text').value.includes('gr ')";
    assert!(page.truth(typed));
}

#[test]
fn the_tool_goes_to_a_place_that_is_typed_or_clicked_and_home() {
    let _alone = alone();
    let serve = Serve::start(&["--idle", "--time-scale", "5"]);
    let mut browser = Browser::start();
    let mut page = at_work(&mut browser, &serve);
    let home = tool_mm(&mut page);
    page.click("#tab-place");
    // An empty field is refused beside the button.
    page.click("#to-plan");
    wait(
        &mut page,
        "document.getElementById('verdict-words').textContent.includes('three numbers')",
    );
    let to = [home[0] + 40.0, home[1] - 30.0, home[2] + 20.0];
    for (id, value) in ["to-x", "to-y", "to-z"].into_iter().zip(to) {
        page.fill(id, &format!("{value:.2}"));
    }
    page.click("#to-plan");
    wait(&mut page, ALLOWED);
    carry_out(&mut page);
    let at = tool_mm(&mut page);
    assert!(distance_mm(at, to) < 2.0, "{at:?} instead of {to:?}");
    // A click in the drawing is a place at the height in z.
    page.run("document.activeElement.blur()");
    page.click("#to-pick");
    let wanted = [home[0] + 75.0, home[1] + 45.0, to[2]];
    let point = format!(
        "[{}, {}, {}]",
        wanted[0] * 1e-3,
        wanted[1] * 1e-3,
        wanted[2] * 1e-3
    );
    wait(
        &mut page,
        "document.getElementById('to-pick').getAttribute('aria-pressed') === 'true'",
    );
    page.run("mcdpr.work.seen = mcdpr.work.preview.id");
    page.click_at(
        "#scene",
        &format!("(b => {{ const p = Scene.project({point}); return [b.x + p[0], b.y + p[1]]; }})(e.getBoundingClientRect())"),
    );
    wait(
        &mut page,
        &format!("{ALLOWED} && mcdpr.work.preview.id !== mcdpr.work.seen"),
    );
    let typed = ["to-x", "to-y", "to-z"]
        .map(|id| page.number(&format!("document.getElementById('{id}').valueAsNumber")));
    assert!(
        distance_mm(typed, wanted) < 5.0,
        "{typed:?} instead of {wanted:?}"
    );
    carry_out(&mut page);
    let at = tool_mm(&mut page);
    assert!(distance_mm(at, typed) < 2.0, "{at:?} instead of {typed:?}");
    page.run("mcdpr.work.seen = mcdpr.work.preview.id");
    page.click("#to-home");
    wait(
        &mut page,
        &format!("{ALLOWED} && mcdpr.work.preview.id !== mcdpr.work.seen"),
    );
    carry_out(&mut page);
    let at = tool_mm(&mut page);
    assert!(distance_mm(at, home) < 2.0, "{at:?} instead of {home:?}");
}

#[test]
fn taught_points_are_played_as_a_judged_path() {
    let _alone = alone();
    let serve = Serve::start(&["--idle", "--time-scale", "5"]);
    let mut browser = Browser::start();
    let mut page = at_work(&mut browser, &serve);
    page.click("#tab-points");
    assert!(page.truth("document.getElementById('points-plan').disabled"));
    page.click("#teach");
    // Jogged by a held button, then taught again.
    let from = tool_mm(&mut page);
    page.click("#tab-jog");
    let press = |page: &mut Page, what: &str| {
        page.run(&format!(
            "document.querySelector('[data-jog=\"1,0,0\"]').dispatchEvent(new PointerEvent('{what}'))"
        ));
    };
    press(&mut page, "pointerdown");
    let far = format!("mcdpr.live.pose.tool_m[0] * 1e3 > {} + 15", from[0]);
    wait(&mut page, &far);
    press(&mut page, "pointerup");
    wait(&mut page, IDLE);
    let jogged = tool_mm(&mut page);
    page.click("#tab-points");
    page.click("#teach");
    assert_eq!(
        page.number("document.getElementById('taught').children.length"),
        2.0
    );
    page.click("#points-plan");
    wait(&mut page, ALLOWED);
    carry_out(&mut page);
    let at = tool_mm(&mut page);
    assert!(
        distance_mm(at, jogged) < 2.0,
        "{at:?} instead of {jogged:?}"
    );
    // Points that are removed make no path.
    page.click("#unteach");
    assert!(page.truth("document.getElementById('points-plan').disabled"));
    page.click("#unteach-all");
    assert_eq!(
        page.number("document.getElementById('taught').children.length"),
        0.0
    );
}

#[test]
fn without_the_token_nothing_can_be_planned_or_saved() {
    let _alone = alone();
    let folder = Folder::new("cockpit-guest");
    let tasks = folder.path().join("tasks");
    let words = ["--idle", "--tasks", tasks.to_str().unwrap()];
    let serve = Serve::start(&words);
    let mut browser = Browser::start();
    let mut page = at_work(&mut browser, &serve);
    let mut guest = browser.open(&serve.address());
    wait(&mut guest, "mcdpr.live && mcdpr.live.pose");
    for id in ["task-plan", "to-plan", "to-home", "text-save", "plan-start"] {
        let button = format!("document.getElementById('{id}')");
        assert!(guest.truth(&format!(
            "{button}.disabled && {button}.title.includes('view only')"
        )));
    }
    for order in [
        "{ order: 'plan', home: true }",
        "{ order: 'task_save', task: 'a.toml', text: 'start_mm = [0, 0, 0]' }",
        "{ order: 'tasks' }",
        "{ order: 'start' }",
    ] {
        guest.run("mcdpr.answers.length = 0");
        guest.run(&format!("mcdpr.send({order})"));
        wait(
            &mut guest,
            "mcdpr.answers.some(m => !m.ok && m.reason.startsWith('view only'))",
        );
    }
    assert!(!tasks.exists());
    // What one page plans, the others see.
    page.click("#tab-place");
    page.fill("to-x", "0");
    page.run("mcdpr.request({ order: 'plan', task: 'fitting' })");
    wait(&mut guest, ALLOWED);
    assert!(guest.truth("document.getElementById('plan-start').disabled"));
    wait(&mut page, ALLOWED);
    page.click("#plan-forget");
    wait(&mut guest, "document.getElementById('verdict').hidden");
    // Rubbish is refused in words.
    for order in [
        "{ order: 'plan' }",
        "{ order: 'plan', to_mm: [1, 2] }",
        "{ order: 'plan', to_mm: [0, 0, -200], speed_mm_s: -1 }",
        "{ order: 'plan', points_mm: [] }",
        "{ order: 'plan', task: '../Cargo.toml' }",
        "{ order: 'task_read', task: 'none.toml' }",
        "{ order: 'gripper' }",
        "{ order: 'dance' }",
    ] {
        page.run("mcdpr.answers.length = 0");
        page.run(&format!("mcdpr.send({order})"));
        wait(
            &mut page,
            "mcdpr.answers.some(m => !m.ok && m.reason.length > 10)",
        );
    }
    assert!(page.truth(IDLE));
}

#[test]
fn a_gamepad_jogs_while_its_shoulder_button_is_held() {
    let _alone = alone();
    let serve = Serve::start(&["--idle"]);
    let mut browser = Browser::start();
    let mut page = at_work(&mut browser, &serve);
    let from = tool_mm(&mut page);
    // The stick alone moves nothing.
    page.run(
        "window.pad = { axes: [0, -1, 0, 0], buttons: [0, 0, 0, 0, 0, 0].map(() => ({ pressed: false })) }; \
         navigator.getGamepads = () => [window.pad]; mcdpr.answers.length = 0",
    );
    page.click("[data-order=hold]");
    wait(&mut page, "mcdpr.answers.some(m => m.order === 'hold')");
    assert!(page.truth("!mcdpr.answers.some(m => m.order === 'jog')"));
    page.run("window.pad.buttons[4].pressed = true");
    let far = format!("mcdpr.live.pose.tool_m[1] * 1e3 > {} + 8", from[1]);
    wait(&mut page, &far);
    page.run("window.pad.buttons[4].pressed = false");
    wait(&mut page, IDLE);
    let at = tool_mm(&mut page);
    assert!(
        (at[0] - from[0]).abs() < 3.0 && at[1] < from[1] + 100.0,
        "{at:?}"
    );
}

#[test]
fn a_step_of_a_jog_is_judged_and_made_and_the_keys_are_explained() {
    let _alone = alone();
    let serve = Serve::start(&["--idle", "--time-scale", "5"]);
    let mut browser = Browser::start();
    let mut page = at_work(&mut browser, &serve);
    let from = tool_mm(&mut page);
    page.click("#tab-jog");
    page.fill("jog-step", "10");
    let press = "document.querySelector('[data-jog=\"1,0,0\"]').dispatchEvent(new PointerEvent('pointerdown'))";
    page.run(press);
    wait(
        &mut page,
        &format!("mcdpr.live.pose.tool_m[0] * 1e3 > {} + 8", from[0]),
    );
    wait(&mut page, IDLE);
    let at = tool_mm(&mut page);
    let gone = distance_mm(at, [from[0] + 10.0, from[1], from[2]]);
    assert!(gone < 1.0, "{from:?} {at:?}");
    // A key makes one step, too, and a held key no second one.
    page.click("#jog-keys");
    for repeated in [false, true, true] {
        page.run(&format!(
            "window.dispatchEvent(new KeyboardEvent('keydown', {{ key: 'ArrowUp', repeat: {repeated} }}))"
        ));
    }
    page.run("window.dispatchEvent(new KeyboardEvent('keyup', { key: 'ArrowUp' }))");
    wait(
        &mut page,
        &format!("mcdpr.live.pose.tool_m[1] * 1e3 > {} + 8", at[1]),
    );
    wait(&mut page, IDLE);
    let at = tool_mm(&mut page);
    assert!(
        distance_mm(at, [from[0] + 10.0, from[1] + 10.0, from[2]]) < 1.5,
        "{at:?}"
    );
    // A step out of the robot's reach is refused in words, and nothing moves.
    page.run("document.getElementById('jog-step').options[4].value = '900'");
    page.fill("jog-step", "900");
    page.run(press);
    wait(
        &mut page,
        "document.getElementById('verdict').classList.contains('broken')",
    );
    assert!(page.truth(IDLE));
    // The keys are listed by their own key, and by the button.
    let shown = "!document.getElementById('keys').hidden";
    assert!(!page.truth(shown));
    page.press("?");
    wait(&mut page, shown);
    let words = page.text("keys");
    for key in ["Esc", "Space", "Page Up", "resume", "start"] {
        assert!(words.contains(key), "{key}: {words}");
    }
    page.click("#keys-show");
    assert!(!page.truth(shown));
}

#[test]
fn the_gripper_and_a_file_of_ones_own_have_their_buttons() {
    let _alone = alone();
    let folder = Folder::new("cockpit-grip");
    let words = ["--idle", "--robot", "lab-fast", "--time-scale", "5"];
    let serve = Serve::start_in(folder.path(), &words);
    let mut browser = Browser::start();
    let mut page = at_work(&mut browser, &serve);
    page.click("#tab-tasks");
    for button in ["#grip-close", "#grip-open"] {
        page.run("mcdpr.answers.length = 0");
        page.click(button);
        wait(
            &mut page,
            "mcdpr.answers.some(m => m.order === 'gripper' && m.ok)",
        );
    }
    let file = folder.path().join("mine.toml");
    let [x, y, z] = tool_mm(&mut page);
    let text = format!(
        "start_mm = [{x:.1}, {y:.1}, {z:.1}]\n[[leg]]\nto_mm = [{x:.1}, {:.1}, {z:.1}]\n",
        y + 10.0
    );
    std::fs::write(&file, &text).unwrap();
    page.click("#task-open");
    page.choose_file("task-file", &file);
    wait(
        &mut page,
        "document.getElementById('task-name').value === 'mine.toml'",
    );
    assert_eq!(page.run("document.getElementById('task-text').value"), text);
    page.click("#text-plan");
    wait(&mut page, ALLOWED);
    page.click("#text-close");
    assert!(page.truth("document.getElementById('editor').hidden"));
}

/// The requirements of the page: 50 ms from a key to the answered order, a second until it is there.
#[test]
fn a_key_stops_within_50_ms_and_the_page_is_there_within_a_second() {
    let _alone = alone();
    let serve = Serve::start(&["--idle"]);
    let mut browser = Browser::start();
    let mut page = at_work(&mut browser, &serve);
    let mut took = Vec::new();
    for _ in 0..40 {
        page.run(
            "window.took = null; mcdpr.answers.length = 0; (() => { const began = performance.now(); \
             window.dispatchEvent(new KeyboardEvent('keydown', { key: 'Escape' })); \
             const look = () => { if (mcdpr.answers.some(m => m.order === 'stop')) \
             window.took = performance.now() - began; else setTimeout(look); }; look(); })()",
        );
        wait(&mut page, "window.took !== null");
        took.push(page.number("window.took"));
    }
    took.sort_by(f64::total_cmp);
    let (least, median, most) = (took[0], took[20], took[39]);
    println!("key to answered stop: median {median:.0} ms of 40 ({least:.0} to {most:.0} ms)");
    // A busy computer delays a browser, and never hastens it: the quicker ones count.
    assert!(took[10] < 50.0, "{took:?}");
    let loaded = "performance.getEntriesByType('navigation')[0].loadEventEnd";
    let mut again = browser.open(&serve.with_token());
    wait(&mut again, "mcdpr.live");
    let loaded = page.number(loaded).min(again.number(loaded));
    println!("page: {loaded:.0} ms from the request until it is loaded");
    assert!(loaded < 1000.0, "{loaded} ms");
}
