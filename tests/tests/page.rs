//! The live page in a real browser: it loads, shows live data, stops the robot, comes back after a
//! restart, and serves several viewers. Needs Chromium; `cargo xtask test` installs it where it is
//! missing. Tests run one after the other, and wait with deadlines.
#![cfg(unix)]

mod browser;

use browser::{Browser, Page, Serve};
use mcdpr_tests::process::{Folder, Simulator, alone};
use std::io::{BufRead as _, BufReader, Read as _};
use std::path::Path;
use std::process::{Child, Stdio};
use std::time::Duration;

/// Long enough for a busy machine.
const PATIENCE: Duration = Duration::from_secs(120);

fn wait(page: &mut Page, what: &str) {
    page.wait(what, PATIENCE);
}

const MOVING: &str = "mcdpr.live && mcdpr.live.state === 'Moving' && mcdpr.live.path_s > 0.5";

#[test]
fn the_page_shows_the_moving_robot() {
    let _alone = alone();
    let serve = Serve::start(&[]);
    let mut browser = Browser::start();
    let mut page = browser.open(&serve.with_token());
    wait(&mut page, MOVING);
    // What is shown is what is live: words, numbers, a picture that changes.
    wait(
        &mut page,
        "document.getElementById('state').textContent === 'Moving'",
    );
    assert_eq!(page.text("name"), "paper-table5");
    assert_eq!(page.text("source"), "simulated truth");
    let cells =
        "[...document.querySelectorAll('#cables td:nth-child(4)')].map(c => +c.textContent)";
    wait(
        &mut page,
        &format!("{cells}.length === 4 && {cells}.every(t => t > 1 && t < 40)"),
    );
    let colors = "(() => { const c = document.getElementById('scene'); \
        const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data; \
        const seen = new Set(); let drawn = 0; \
        for (let i = 0; i < d.length; i += 4) if (d[i + 3] > 0) { drawn++; \
        seen.add(d[i] << 16 | d[i + 1] << 8 | d[i + 2]); } \
        return drawn > 3000 && seen.size > 20; })()";
    wait(&mut page, colors);
    let first = page.screenshot();
    let revision = page.number("mcdpr.live.revision");
    let place = page.number("mcdpr.live.path_s");
    wait(&mut page, &format!("mcdpr.live.path_s > {place} + 0.5"));
    assert!(page.number("mcdpr.live.revision") > revision);
    let second = page.screenshot();
    assert!(
        first.len() > 20_000 && first != second,
        "the picture stands still"
    );
    // A path error is known of a simulated robot, and is that of the circle.
    wait(
        &mut page,
        "mcdpr.live.path_error_m !== null && mcdpr.live.path_error_m < 2e-3",
    );
    // The camera's picture is there, not blank, with the tag where it is.
    wait(
        &mut page,
        "mcdpr.pictures > 1 && mcdpr.camera.tags.length > 0 && !document.getElementById('camera').hidden",
    );
    assert!(page.text("seen").contains("tag 0"), "{}", page.text("seen"));
    wait(
        &mut page,
        "(() => { const c = document.getElementById('picture'); \
         const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data; \
         const seen = new Set(); let marked = 0; \
         for (let i = 0; i < d.length; i += 4) { seen.add(d[i] << 16 | d[i + 1] << 8 | d[i + 2]); \
         if (d[i] === 63 && d[i + 1] === 224 && d[i + 2] === 122) marked++; } \
         return c.width > 100 && seen.size > 100 && marked > 20; })()",
    );
    // On a phone nothing sticks out to the side, and the stop button can be seen.
    page.resize(375, 740);
    wait(&mut page, "document.documentElement.scrollWidth <= 376");
    assert!(page.number("document.getElementById('stop').getBoundingClientRect().width") > 200.0);
}

#[test]
fn the_page_shows_and_stops_a_robot_of_eight_cables() {
    let _alone = alone();
    let serve = Serve::start(&["--robot", "eight-cable"]);
    let mut browser = Browser::start();
    let mut page = browser.open(&serve.with_token());
    wait(&mut page, MOVING);
    assert_eq!(page.text("name"), "eight-cable");
    let cells =
        "[...document.querySelectorAll('#cables td:nth-child(4)')].map(c => +c.textContent)";
    wait(
        &mut page,
        &format!("{cells}.length === 8 && {cells}.every(t => t > 5 && t < 176)"),
    );
    page.press("Escape");
    wait(&mut page, "mcdpr.live.state !== 'Moving'");
}

#[test]
fn the_stop_button_and_the_escape_key_end_the_motion_within_100_ms() {
    let _alone = alone();
    let serve = Serve::start(&[]);
    let mut browser = Browser::start();
    let mut page = browser.open(&serve.with_token());
    // Time from the click until the page shows that the board brakes; the best of three, because a
    // busy machine can delay a browser, but never hasten it.
    let mut best = f64::MAX;
    for round in 0..3 {
        wait(&mut page, MOVING);
        let act = if round == 0 {
            "document.dispatchEvent(new KeyboardEvent('keydown', { key: 'Escape', bubbles: true }))"
        } else {
            "document.getElementById('stop').click()"
        };
        page.run(&format!(
            "window.took = null; (() => {{ const began = performance.now(); {act}; \
             const look = () => {{ if (mcdpr.live.state !== 'Moving') \
             window.took = performance.now() - began; else setTimeout(look, 1); }}; look(); }})()"
        ));
        wait(&mut page, "window.took !== null");
        best = best.min(page.number("window.took"));
        wait(
            &mut page,
            "mcdpr.live.state === 'Disarmed' && mcdpr.live.brakes_open === 0",
        );
        page.run("document.querySelector('[data-order=start]').click()");
    }
    assert!(best < 100.0, "the stop took {best:.0} ms");
    println!("stop: {best:.0} ms from the click to the braking board on the page");
}

#[test]
fn hold_and_resume_work_and_those_without_the_token_only_look() {
    let _alone = alone();
    let serve = Serve::start(&[]);
    let mut browser = Browser::start();
    let mut page = browser.open(&serve.with_token());
    let mut guest = browser.open(&serve.address());
    wait(&mut page, MOVING);
    wait(&mut guest, MOVING);
    assert!(page.truth("mcdpr.may") && !guest.truth("mcdpr.may"));
    assert!(guest.truth("document.getElementById('stop').disabled"));
    assert!(guest.text("may").starts_with("View only"));
    // A page that is made to send an order all the same is refused, and the robot goes on.
    guest.run(
        "window.said = null; (() => { const s = new WebSocket(`ws://${location.host}/ws`); \
         s.onopen = () => s.send(JSON.stringify({ id: 7, order: 'stop', token: 'guess' })); \
         s.onmessage = e => { if (typeof e.data !== 'string') return; const m = JSON.parse(e.data); \
         if (m.type === 'answer') window.said = m; }; })()",
    );
    wait(
        &mut guest,
        "window.said && !window.said.ok && window.said.reason.startsWith('view only')",
    );
    wait(&mut guest, MOVING);
    page.run("document.querySelector('[data-order=hold]').click()");
    wait(&mut page, "mcdpr.live.state === 'Holding'");
    wait(&mut guest, "mcdpr.live.state === 'Holding'");
    let held = page.number("mcdpr.live.path_s");
    page.run("document.querySelector('[data-order=resume]').click()");
    wait(
        &mut guest,
        &format!("mcdpr.live.state === 'Moving' && mcdpr.live.path_s > {held} + 0.3"),
    );
    // A second page with the token looks on, but may hold and stop.
    let mut second = browser.open(&serve.with_token());
    wait(
        &mut second,
        "document.getElementById('may').textContent.includes('another page has the controls')",
    );
    assert!(
        !second.truth("mcdpr.may")
            && second.truth("document.querySelector('[data-order=resume]').disabled")
    );
    second.run("mcdpr.send({ order: 'start' })");
    wait(
        &mut second,
        "mcdpr.answers.some(m => m.order === 'start' && !m.ok && m.reason.startsWith('view only'))",
    );
    second.run("document.querySelector('[data-order=hold]').click()");
    wait(&mut second, "mcdpr.live.state === 'Holding'");
    // The first leaves, and the controls are the second's.
    page.run("location.href = 'about:blank'");
    wait(&mut second, "mcdpr.may");
    second.run("document.querySelector('[data-order=resume]').click()");
    wait(&mut guest, MOVING);
    // A browser that goes away does not disturb anybody.
    drop(browser);
    let mut other = Browser::start();
    let mut page = other.open(&serve.address());
    wait(&mut page, "mcdpr.live && mcdpr.live.age_s < 0.5");
}

#[test]
fn a_held_jog_button_moves_the_tool_and_letting_go_stops_it() {
    let _alone = alone();
    let serve = Serve::start(&["--idle"]);
    let mut browser = Browser::start();
    let mut page = browser.open(&serve.with_token());
    wait(&mut page, "mcdpr.may && mcdpr.live.state === 'Disarmed'");
    let press = |page: &mut Page, what: &str| {
        let act = format!(
            "document.querySelector('[data-jog=\"1,0,0\"]').dispatchEvent(new PointerEvent('{what}'))"
        );
        page.run(&act);
    };
    // The robot arms while the button is held, and then goes.
    press(&mut page, "pointerdown");
    wait(
        &mut page,
        "mcdpr.live.state === 'Holding' && mcdpr.live.pose",
    );
    let from = page.number("mcdpr.live.pose.tool_m[0]");
    wait(
        &mut page,
        &format!("mcdpr.live.pose.tool_m[0] > {from} + 0.01"),
    );
    press(&mut page, "pointerup");
    wait(&mut page, "mcdpr.live.state === 'Holding'");
    let at = page.number("mcdpr.live.pose.tool_m[0]");
    assert!(at < from + 0.1, "it went on: from {from} to {at}");
    // Nobody jogs any more: the brakes close by themselves.
    wait(
        &mut page,
        "mcdpr.live.state === 'Disarmed' && mcdpr.live.brakes_open === 0",
    );
    // A jog that is too fast is refused in words, and nothing moves.
    page.run("mcdpr.send({ order: 'jog', velocity_mps: [9, 0, 0] })");
    wait(
        &mut page,
        "mcdpr.answers.some(m => !m.ok && m.reason.includes('9000 mm/s'))",
    );
    assert!(page.truth("mcdpr.live.state === 'Disarmed'"));
}

/// A command with a live page, on record in `folder`, and the address for orders that it prints.
fn serving(words: &[&str], folder: &Path) -> (Child, String) {
    let mut command = mcdpr_tests::mcdpr();
    command.args(words).args(["--serve", "0", "--record"]);
    command.arg(folder).stdout(Stdio::piped());
    let mut child = command.spawn().unwrap();
    let mut reported = BufReader::new(child.stdout.take().unwrap());
    let mut lines = reported.by_ref().lines().map_while(Result::ok);
    let address = lines.find_map(|line| {
        let address = line.strip_prefix("to give orders:")?;
        Some(address.trim().to_owned())
    });
    // What it says later finds an open pipe.
    child.stdout = Some(reported.into_inner());
    (child, address.unwrap())
}

#[test]
fn picking_is_shown_with_the_grasp_in_the_picture() {
    let _alone = alone();
    let folder = Folder::new("page-pick");
    let words = ["pick", "--objects", "1", "--attempts", "1"];
    let (mut pick, address) = serving(&words, folder.path());
    let mut browser = Browser::start();
    let mut page = browser.open(&address);
    wait(&mut page, "mcdpr.camera && mcdpr.camera.grasp");
    let seen = page.text("seen");
    assert!(seen.contains("grasp") && seen.contains("mm wide"), "{seen}");
    page.run("document.getElementById('stop').click()");
    assert_eq!(pick.wait().unwrap().code(), Some(130));
    // The picture with its marks is in the record, which says why it cannot be replayed.
    let bytes = std::fs::read(folder.path().join("run.mcap")).unwrap();
    let record = mcdpr::record::mcap::read(&bytes).unwrap();
    for topic in ["/camera/image", "/camera/marks"] {
        let found = record
            .messages
            .iter()
            .find(|message| record.topic(message.channel) == Some(topic));
        let value: serde_json::Value = serde_json::from_slice(&found.unwrap().data).unwrap();
        if topic == "/camera/image" {
            let data = value["data"].as_str().unwrap();
            assert!(data.starts_with("iVBORw0KGgo") && data.len() > 20_000);
        } else {
            assert_eq!(value["points"][0]["points"].as_array().unwrap().len(), 4);
        }
    }
    let replay = mcdpr_tests::mcdpr()
        .arg("replay")
        .arg(folder.path())
        .output()
        .unwrap();
    let message = String::from_utf8_lossy(&replay.stderr);
    assert_eq!(replay.status.code(), Some(1), "{message}");
    assert!(message.contains("it followed pictures"), "{message}");
}

#[test]
fn the_page_marks_old_data_and_comes_back_after_a_restart() {
    let _alone = alone();
    let serve = Serve::start(&[]);
    let port = serve.port();
    let mut browser = Browser::start();
    let mut page = browser.open(&serve.with_token());
    wait(&mut page, MOVING);
    assert!(page.truth("document.getElementById('stale').hidden"));
    drop(serve);
    wait(
        &mut page,
        "!document.getElementById('stale').hidden && !mcdpr.connected",
    );
    assert!(page.text("stale").starts_with("old data"));
    // It says what happened, and does not blame the token.
    wait(
        &mut page,
        "document.getElementById('may').textContent.includes('does not answer')",
    );
    assert!(!page.text("may").contains("token"), "{}", page.text("may"));
    let serve = Serve::start(&["--port", &port]);
    wait(
        &mut page,
        "mcdpr.connected && document.getElementById('stale').hidden",
    );
    wait(&mut page, MOVING);
    assert!(page.text("may").starts_with("Esc stops"));
    let mut guest = browser.open(&format!("{}#token=guess", serve.address()));
    wait(
        &mut guest,
        "document.getElementById('may').textContent.startsWith('The token is not that')",
    );
    // Another program on the same port is refused with a reason, and the first goes on.
    let output = mcdpr_tests::mcdpr()
        .args(["serve", "--port", &port])
        .output()
        .unwrap();
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(
        message.contains(&format!("port {port} is in use")),
        "{message}"
    );
    drop(serve);
}

#[test]
fn a_single_run_is_shown_too_and_its_record_replays_with_the_orders_from_the_page() {
    let _alone = alone();
    let folder = Folder::new("page-run");
    let (mut run, address) = serving(&["run", "paper:table7"], folder.path());
    let mut browser = Browser::start();
    let mut page = browser.open(&address);
    wait(&mut page, MOVING);
    page.run("document.querySelector('[data-order=hold]').click()");
    wait(&mut page, "mcdpr.live.state === 'Holding'");
    page.run("document.querySelector('[data-order=resume]').click()");
    wait(
        &mut page,
        "mcdpr.live.state === 'Moving' && mcdpr.live.path_s > 2",
    );
    page.run("document.getElementById('stop').click()");
    assert_eq!(run.wait().unwrap().code(), Some(130));
    let replay = |arguments: &[&str]| {
        let output = mcdpr_tests::mcdpr()
            .args(arguments)
            .arg(folder.path())
            .output()
            .unwrap();
        let message = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{message}");
        String::from_utf8_lossy(&output.stdout).into_owned()
    };
    let proof: serde_json::Value = serde_json::from_str(&replay(&["--json", "replay"])).unwrap();
    assert_eq!(proof["equal"], true);
    assert!(
        proof["core_bytes"]
            .as_u64()
            .is_some_and(|bytes| bytes > 50_000),
        "{proof}"
    );
    assert_eq!(proof["whole"], true, "{proof}");
    replay(&["report"]);
    let report = std::fs::read_to_string(folder.path().join("report.html")).unwrap();
    for what in [
        "order: pause",
        "order: resume",
        "order: stop",
        "state Disarmed",
        "<svg",
    ] {
        assert!(report.contains(what), "{what}");
    }
}

/// The page has asked for the tasks and got them: it sends no order by itself any more.
const LISTED: &str = "document.getElementById('task-list').options.length > 0";

/// Every button that there is, with what the page has sent.
const BUTTONS: &str =
    "[...document.querySelectorAll('button')].filter(b => !b.disabled && b.offsetParent)";

#[test]
fn space_and_escape_act_whatever_has_the_focus_and_press_no_button() {
    let _alone = alone();
    let serve = Serve::start(&[]);
    let mut browser = Browser::start();
    let mut page = browser.open(&serve.with_token());
    wait(&mut page, MOVING);
    wait(&mut page, LISTED);
    let count = page.number(&format!("{BUTTONS}.length"));
    assert!(count >= 12.0, "{count} buttons");
    page.run("mcdpr.answers.length = 0");
    for button in 0..count as usize {
        page.run(&format!("{BUTTONS}[{button}].focus()"));
        assert!(page.truth(&format!("document.activeElement === {BUTTONS}[{button}]")));
        page.press(" ");
        wait(
            &mut page,
            &format!(
                "mcdpr.answers.filter(m => m.order === 'hold').length === {}",
                button + 1
            ),
        );
    }
    wait(&mut page, "mcdpr.live.state === 'Holding'");
    // No button was pressed on the way, and no key jogged.
    assert!(
        page.truth("mcdpr.answers.every(m => m.order === 'hold')"),
        "{}",
        page.run("JSON.stringify(mcdpr.answers)")
    );
    assert!(page.truth("document.getElementById('jog-keys').ariaPressed === 'false'"));
    // A real click leaves the focus nowhere, so that the next key presses nothing.
    page.click("[data-order=resume]");
    wait(&mut page, MOVING);
    assert!(page.truth("document.activeElement === document.body"));
    page.press(" ");
    wait(&mut page, "mcdpr.live.state === 'Holding'");
    page.run("document.querySelector('[data-jog=\"1,0,0\"]').focus()");
    page.press("r");
    wait(&mut page, MOVING);
    page.run("document.querySelector('[data-order=start]').focus()");
    page.press("Escape");
    wait(
        &mut page,
        "mcdpr.live.state === 'Disarmed' && mcdpr.live.brakes_open === 0",
    );
    assert!(page.truth("!mcdpr.answers.some(m => m.order === 'jog' || m.order === 'start')"));
}

#[test]
fn keys_jog_only_after_they_were_switched_on() {
    let _alone = alone();
    let serve = Serve::start(&["--idle"]);
    let mut browser = Browser::start();
    let mut page = browser.open(&serve.with_token());
    wait(&mut page, "mcdpr.may && mcdpr.live.state === 'Disarmed'");
    wait(&mut page, LISTED);
    // With the focus on a jog button or nowhere, keys jog nothing: an order that comes after them is
    // the first that is answered.
    for focus in [
        "document.querySelector('[data-jog=\"1,0,0\"]').focus()",
        "document.activeElement.blur()",
    ] {
        page.run("mcdpr.answers.length = 0");
        page.run(focus);
        for key in ["ArrowRight", "Enter"] {
            page.press(key);
        }
        page.press(" ");
        wait(&mut page, "mcdpr.answers.length > 0");
        assert!(page.truth("mcdpr.answers.every(m => m.order === 'hold')"));
    }
    page.click("#jog-keys");
    assert!(page.truth("document.getElementById('jog-keys').ariaPressed === 'true'"));
    page.key("ArrowRight", true);
    wait(
        &mut page,
        "mcdpr.live.state === 'Holding' && mcdpr.live.pose",
    );
    let from = page.number("mcdpr.live.pose.tool_m[0]");
    wait(
        &mut page,
        &format!("mcdpr.live.pose.tool_m[0] > {from} + 0.01"),
    );
    // Space ends it while the key is still down, and switches the keys off.
    page.press(" ");
    assert!(page.truth("document.getElementById('jog-keys').ariaPressed === 'false'"));
    wait(
        &mut page,
        "mcdpr.live.state === 'Disarmed' && mcdpr.live.brakes_open === 0",
    );
    page.key("ArrowRight", false);
    let at = page.number("mcdpr.live.pose.tool_m[0]");
    assert!(at < from + 0.1, "it went on: from {from} to {at}");
}

#[test]
fn stop_stays_in_sight_at_every_size() {
    let _alone = alone();
    let serve = Serve::start(&[]);
    let mut browser = Browser::start();
    let mut page = browser.open(&serve.with_token());
    wait(&mut page, "mcdpr.may && mcdpr.live");
    let seen = "(() => { const b = document.getElementById('stop').getBoundingClientRect(); \
        const at = document.elementFromPoint(b.x + b.width / 2, b.y + b.height / 2); \
        return b.top >= 0 && b.bottom <= innerHeight && b.left >= 0 && b.right <= innerWidth && \
        b.width > 200 && b.height >= 40 && at === document.getElementById('stop'); })()";
    for (width, height) in [
        (1400, 900),
        (1024, 500),
        (820, 1180),
        (740, 360),
        (375, 740),
        (375, 480),
    ] {
        page.resize(width, height);
        wait(
            &mut page,
            &format!(
                "innerWidth === {width} && document.documentElement.scrollWidth <= {width} + 1"
            ),
        );
        for place in [
            "0",
            "document.body.scrollHeight / 2",
            "document.body.scrollHeight",
        ] {
            page.run(&format!("window.scrollTo(0, {place})"));
            assert!(page.truth(seen), "{width} x {height}, scrolled to {place}");
        }
    }
    // It is not only seen: a finger on it stops.
    wait(&mut page, MOVING);
    page.run("window.scrollTo(0, document.body.scrollHeight)");
    page.click("#stop");
    wait(
        &mut page,
        "mcdpr.live.state === 'Disarmed' && mcdpr.live.brakes_open === 0",
    );
}

/// A board on a port that vanishes and comes back: the page stays, says why beside the buttons, and
/// goes on.
#[test]
fn the_page_outlives_its_board() {
    let _alone = alone();
    let folder = Folder::new("page-port");
    let port = folder.path().join("port");
    let plug = |simulator: &Simulator| {
        let _ = std::fs::remove_file(&port);
        std::os::unix::fs::symlink(&simulator.port, &port).unwrap();
    };
    let simulator = Simulator::start("1");
    plug(&simulator);
    let record = folder.path().join("kept");
    let words = [
        "--on",
        port.to_str().unwrap(),
        "--record",
        record.to_str().unwrap(),
    ];
    let mut serve = Serve::start(&words);
    let mut browser = Browser::start();
    let mut page = browser.open(&serve.with_token());
    wait(&mut page, "mcdpr.may && mcdpr.live.state === 'Disarmed'");
    let trouble = "document.getElementById('trouble').textContent";
    page.click("[data-order=clear]");
    wait(&mut page, "mcdpr.answers.some(m => m.order === 'clear')");
    assert!(serve.runs());
    drop(simulator);
    wait(
        &mut page,
        &format!("{trouble} !== '' && !document.getElementById('stale').hidden"),
    );
    // Orders are refused with the reason, and Stop does no harm.
    page.run("mcdpr.answers.length = 0");
    page.click("[data-order=clear]");
    wait(
        &mut page,
        "mcdpr.answers.some(m => m.order === 'clear' && !m.ok)",
    );
    page.press("Escape");
    assert!(serve.runs() && page.truth("mcdpr.connected"));
    let simulator = Simulator::start("1");
    plug(&simulator);
    wait(
        &mut page,
        &format!("{trouble} === '' && document.getElementById('stale').hidden"),
    );
    wait(&mut page, "mcdpr.live.state === 'Disarmed'");
    assert!(serve.runs());
}
