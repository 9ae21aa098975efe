//! Set-up and picking on the page, in a real browser: steps with their lines, confirmations, questions, live data,
//! results, stopping; the picking task with its phases and grasps.
#![cfg(unix)]

mod browser;

use browser::{Browser, Page, Serve};
use mcdpr_tests::process::{Folder, Simulator, alone, breathe, signal};
use std::process::Command;
use std::time::{Duration, Instant};

/// Long enough for a busy machine.
const PATIENCE: Duration = Duration::from_secs(120);

fn wait(page: &mut Page, what: &str) {
    page.wait(what, PATIENCE);
}

/// The state of a step is this word.
fn is(step: &str, state: &str) -> String {
    format!("mcdpr.steps.known && (mcdpr.steps.known.states['{step}'] || {{}}).state === '{state}'")
}

/// A page with the controls of an idle robot, on this tab.
fn at_tab(browser: &mut Browser, serve: &Serve, tab: &str) -> Page {
    let mut page = browser.open(&serve.with_token());
    wait(
        &mut page,
        "mcdpr.may && mcdpr.live && mcdpr.live.pose && mcdpr.steps.known",
    );
    page.click(&format!("#tab-{tab}"));
    page
}

/// Opens a step of set-up, and waits for its line.
fn open(page: &mut Page, step: &str) {
    page.click(&format!("#step-{step} > summary"));
    wait(page, &format!("{}.startsWith('mcdpr ')", line(step)));
}

fn line(step: &str) -> String {
    format!("document.getElementById('step-{step}-line').textContent")
}

fn disabled(page: &mut Page, id: &str, part: &str) {
    let button = format!("document.getElementById('{id}')");
    let found = page.run(&format!("{button}.disabled + ' ' + {button}.title"));
    let found = found.as_str().unwrap_or_default();
    assert!(
        found.starts_with("true ") && found.contains(part),
        "{id}: {found}"
    );
}

/// Presses Run, and confirms what moves.
fn run_confirmed(page: &mut Page, step: &str) {
    wait(
        page,
        &format!("!document.getElementById('step-{step}-run').disabled"),
    );
    page.click(&format!("#step-{step}-run"));
    wait(
        page,
        &format!("document.getElementById('step-{step}-yes').offsetParent !== null"),
    );
    assert!(
        page.truth("!mcdpr.steps.known.running"),
        "nothing runs before it is confirmed"
    );
    page.click(&format!("#step-{step}-yes"));
}

/// Processes of the system whose command line has this text.
fn processes(text: &str) -> Vec<String> {
    let listed = Command::new("ps")
        .args(["-ww", "-eo", "pid,args"])
        .output()
        .unwrap();
    let listed = String::from_utf8_lossy(&listed.stdout).into_owned();
    listed
        .lines()
        .filter(|line| line.contains(text) && line.contains("--for-page"))
        .map(str::to_owned)
        .collect()
}

#[test]
fn the_doctor_and_the_rig_are_run_from_the_page_and_a_failure_says_what_to_do() {
    let _alone = alone();
    let folder = Folder::new("setup-doctor");
    let serve = Serve::start_in(folder.path(), &["--idle", "--time-scale", "20"]);
    let mut browser = Browser::start();
    let mut page = at_tab(&mut browser, &serve, "setup");
    let mut guest = browser.open(&serve.address());
    wait(&mut guest, "mcdpr.steps.known");
    // The steps are in the order of a laboratory, with the lines of their commands.
    let ids =
        page.run("mcdpr.steps.known.steps.filter(s => s.tab === 'setup').map(s => s.id).join(' ')");
    assert_eq!(
        ids,
        "doctor recover commission rig home target collect calibrate tune check verify track tracked"
    );
    open(&mut page, "doctor");
    let shown = page.text("step-doctor-line");
    assert_eq!(shown, "mcdpr doctor --robot paper-table5 --time-scale 20");
    disabled(&mut page, "step-doctor-stop", "does not run");
    page.click("#step-doctor-run");
    wait(&mut page, &is("doctor", "running"));
    wait(
        &mut page,
        "document.getElementById('step-rig-run').title.includes('doctor is under way')",
    );
    disabled(&mut page, "step-rig-run", "stop it first");
    wait(&mut page, &is("doctor", "done"));
    wait(
        &mut page,
        "document.getElementById('step-doctor-output').textContent.includes('drive 4')",
    );
    assert_eq!(page.text("step-doctor-state"), "done");
    let verdict = page.text("step-doctor-result");
    assert!(verdict.contains("to be repaired: 0"), "{verdict}");
    // Somebody who only looks sees the same, and can start nothing.
    wait(&mut guest, &is("doctor", "done"));
    wait(
        &mut guest,
        "document.getElementById('step-doctor-output').textContent.includes('drive 4')",
    );
    disabled(&mut guest, "step-doctor-run", "view only");
    guest.run("mcdpr.send({ order: 'step_run', step: 'doctor', options: {} })");
    wait(
        &mut guest,
        "mcdpr.answers.some(m => m.order === 'step_run' && !m.ok)",
    );
    // A step that fails says why, and what to do.
    open(&mut page, "check");
    run_confirmed(&mut page, "check");
    wait(&mut page, &is("check", "failed"));
    let reason = page.text("step-check-reason");
    assert!(reason.contains("has no calibration to check"), "{reason}");
    assert!(page.text("step-check-next").starts_with("Next: "));
    open(&mut page, "verify");
    page.fill("step-verify-poses", "none.csv");
    wait(
        &mut page,
        &format!("{}.includes('none.csv')", line("verify")),
    );
    page.click("#step-verify-run");
    wait(&mut page, &is("verify", "failed"));
    assert!(page.text("step-verify-reason").contains("none.csv"));
    // What is wrong with an option is said before anything runs.
    open(&mut page, "commission");
    page.fill("step-commission-winch", "12");
    wait(
        &mut page,
        "document.getElementById('step-commission-wrong').textContent.includes('from 1 to 8')",
    );
    disabled(&mut page, "step-commission-run", "from 1 to 8");
    // Nothing moves that was not confirmed, whoever asks.
    page.run(
        "mcdpr.answers.length = 0; mcdpr.send({ order: 'step_run', step: 'rig', options: {} })",
    );
    wait(
        &mut page,
        "mcdpr.answers.some(m => m.order === 'step_run' && m.reason && m.reason.includes('confirm it first'))",
    );
    // The rig asks before each part; the page answers.
    open(&mut page, "rig");
    run_confirmed(&mut page, "rig");
    let asks =
        |part: &str| format!("mcdpr.steps.known.asks && mcdpr.steps.known.asks.includes('{part}')");
    wait(&mut page, &asks("take up the slack"));
    wait(&mut guest, &asks("take up the slack"));
    disabled(&mut guest, "step-rig-say-yes", "view only");
    page.click("#step-rig-say-yes");
    wait(&mut page, &asks("raise all tensions"));
    wait(&mut page, "mcdpr.live.state === 'Holding'");
    page.fill("step-rig-answer", "n");
    page.click("#step-rig-say");
    wait(&mut page, &is("rig", "failed"));
    let reason = page.text("step-rig-reason");
    assert!(reason.contains("stopped before"), "{reason}");
    assert!(page.text("step-rig-next").contains("start again"));
    // A page that comes back sees the state and the output of before.
    page.run("window.old = true; location.reload()");
    wait(
        &mut page,
        "!window.old && document.getElementById('step-rig-output')?.textContent.includes('raise all tensions')",
    );
    assert_eq!(page.text("step-rig-state"), "failed");
    assert!(page.truth(&is("doctor", "done")));
}

#[test]
fn a_calibration_is_collected_live_solved_accepted_and_taken_back() {
    let _alone = alone();
    let folder = Folder::new("setup-calibrate");
    let serve = Serve::start_in(folder.path(), &["--idle", "--time-scale", "20"]);
    let mut browser = Browser::start();
    let mut page = at_tab(&mut browser, &serve, "setup");
    open(&mut page, "calibrate");
    for (name, value) in [("poses", "8"), ("candidates", "40")] {
        page.fill(&format!("step-calibrate-{name}"), value);
    }
    wait(
        &mut page,
        &format!(
            "{}.includes('--poses 8 --candidates 40')",
            line("calibrate")
        ),
    );
    for id in ["kept-accept", "kept-discard"] {
        disabled(&mut page, id, "there is no new calibration");
    }
    disabled(&mut page, "kept-back", "no calibration before");
    run_confirmed(&mut page, "calibrate");
    // The robot of the step is on the page: it moves, and its camera sees tags.
    wait(
        &mut page,
        "mcdpr.live.task === 'calibrate' && mcdpr.live.state === 'Moving'",
    );
    wait(
        &mut page,
        "mcdpr.pictures > 0 && mcdpr.camera.tags.length > 0",
    );
    page.run("mcdpr.answers.length = 0; mcdpr.send({ order: 'start' }); mcdpr.send({ order: 'jog', velocity_mps: [0.01, 0, 0] })");
    wait(
        &mut page,
        "mcdpr.answers.filter(m => !m.ok && m.reason.includes('calibrate is under way')).length === 2",
    );
    assert!(page.truth("document.querySelector('[data-order=start]').title.includes('under way')"));
    assert!(page.truth("document.getElementById('jog').disabled"));
    disabled(&mut page, "task-plan", "calibrate is under way");
    wait(
        &mut page,
        "document.querySelector('#step-calibrate progress').value >= 2",
    );
    wait(&mut page, &is("calibrate", "done"));
    let result = page.text("step-calibrate-result");
    for part in [
        "predicted position error",
        "expected error of the platform at rest",
        "one more pose",
        "verdict: accepted",
    ] {
        assert!(result.contains(part), "{result}");
    }
    // It is used only once it is accepted.
    let file = folder.path().join("paper-table5.calibration.json");
    assert!(
        !file.exists()
            && folder
                .path()
                .join("paper-table5.calibration.new.json")
                .exists()
    );
    wait(
        &mut page,
        "!document.getElementById('kept-accept').disabled",
    );
    page.click("#kept-accept");
    wait(&mut page, "mcdpr.steps.known.calibration.used");
    let accepted = std::fs::read_to_string(&file).unwrap();
    assert!(
        page.text("kept-words")
            .contains("paper-table5.calibration.json")
    );
    // The server uses it once it has read it: the page shows the anchors that were found.
    page.run("window.anchors = JSON.stringify(mcdpr.robot.cables)");
    page.click("#kept-use");
    wait(
        &mut page,
        "mcdpr.connected && mcdpr.may && JSON.stringify(mcdpr.robot.cables) !== window.anchors",
    );
    // A step uses it from now on.
    open(&mut page, "check");
    page.fill("step-check-places", "1");
    run_confirmed(&mut page, "check");
    wait(&mut page, &is("check", "done"));
    wait(&mut page, "!document.getElementById('kept-back').disabled");
    page.click("#kept-back");
    wait(&mut page, "!mcdpr.steps.known.calibration.used");
    assert!(!file.exists());
    let undone = folder.path().join("paper-table5.calibration.json.undone");
    assert_eq!(std::fs::read_to_string(undone).unwrap(), accepted);
    // The data can be solved again, without a robot; the result can be discarded.
    page.fill("step-calibrate-data", "paper-table5.calibration-data.json");
    wait(
        &mut page,
        &format!("{}.includes('--data')", line("calibrate")),
    );
    page.click("#step-calibrate-run");
    wait(&mut page, &is("calibrate", "running"));
    wait(&mut page, &is("calibrate", "done"));
    wait(
        &mut page,
        "!document.getElementById('kept-discard').disabled",
    );
    page.click("#kept-discard");
    wait(&mut page, "!mcdpr.steps.known.calibration.proposal");
    assert!(!file.exists());
}

#[test]
fn a_step_has_an_emulated_chip_of_its_own() {
    let _alone = alone();
    let folder = Folder::new("setup-chip");
    let words = ["--idle", "--on", "chip"];
    let serve = Serve::start_in(folder.path(), &words);
    let mut browser = Browser::start();
    let mut page = at_tab(&mut browser, &serve, "setup");
    open(&mut page, "doctor");
    assert!(page.text("step-doctor-line").contains("--on chip"));
    page.click("#step-doctor-run");
    wait(&mut page, &is("doctor", "done"));
    let verdict = page.text("step-doctor-result");
    assert!(verdict.contains("to be repaired: 0"), "{verdict}");
    // The page's own chip has its line again.
    wait(
        &mut page,
        "mcdpr.live && !mcdpr.live.stale && mcdpr.live.state === 'Disarmed'",
    );
}

#[test]
fn picking_is_started_seen_and_stopped_from_the_page() {
    let _alone = alone();
    let folder = Folder::new("setup-pick");
    let words = ["--idle", "--robot", "lab-fast", "--time-scale", "20"];
    let serve = Serve::start_in(folder.path(), &words);
    let mut browser = Browser::start();
    let mut page = at_tab(&mut browser, &serve, "pick");
    wait(
        &mut page,
        &format!("{}.startsWith('mcdpr pick')", line("pick")),
    );
    for (name, value) in [
        ("objects", "3"),
        ("seed", "1"),
        ("attempts", "1"),
        ("knows", "ideal"),
    ] {
        page.fill(&format!("step-pick-{name}"), value);
    }
    wait(
        &mut page,
        &format!(
            "{}.includes('--objects 3 --seed 1 --attempts 1 --ideal')",
            line("pick")
        ),
    );
    // At this pace a grasp is shown for moments.
    page.run(
        "window.seen = { chosen: '' }; setInterval(() => { const m = mcdpr.pick.now || {}; \
           seen.tray ||= m.tray; seen.objects ||= (m.objects || []).length; seen.picture ||= mcdpr.camera && mcdpr.camera.grasp; \
           if (m.chosen) seen.chosen = document.getElementById('pick-chosen').textContent; \
           seen.refused ||= document.getElementById('pick-refused').children.length; }, 5)",
    );
    run_confirmed(&mut page, "pick");
    let mut guest = browser.open(&serve.address());
    // Tray and object are in the drawing; a grasp is chosen, in the picture, too, and others are refused.
    wait(
        &mut page,
        "seen.tray && seen.objects > 0 && seen.chosen.includes('mm wide') && seen.refused > 0 && seen.picture",
    );
    wait(&mut guest, "mcdpr.pick.now && mcdpr.pick.now.tray");
    wait(&mut page, &is("pick", "done"));
    let seen = page.run("mcdpr.pick.seen.join(' ')");
    let seen = seen.as_str().unwrap();
    for phase in [
        "looking",
        "choosing",
        "approaching",
        "descending",
        "closing",
        "lifting",
        "carrying",
        "releasing",
    ] {
        assert!(seen.contains(phase), "{phase} is not among: {seen}");
    }
    let count = page.text("pick-count");
    assert!(
        count.contains("1 picked") && count.contains("as many attempts"),
        "{count}"
    );
    // What it weighed is shown: in newtons and in grams.
    let weighed = page.text("pick-attempts");
    let weight_n = page.number("mcdpr.pick.now.attempts[0].weight_n");
    assert!(weight_n > 0.05, "{weight_n} N");
    assert_eq!(
        weighed,
        format!(
            "delivered, weighed {weight_n:.2} N ({:.0} g)",
            weight_n / 9.80665 * 1e3
        )
    );
    wait(&mut guest, &is("pick", "done"));
    // The second time it is stopped while it moves, by the key.
    wait(
        &mut page,
        "mcdpr.live.state === 'Disarmed' && !mcdpr.live.task",
    );
    run_confirmed(&mut page, "pick");
    wait(
        &mut page,
        "mcdpr.live.task === 'pick' && mcdpr.live.state === 'Moving'",
    );
    // The page keeps the key from other listeners: the time begins just before it is pressed.
    page.run(
        "window.stopped = null; window.pressed = performance.now(); setInterval(() => { \
           if (window.stopped === null && mcdpr.live.state !== 'Moving') window.stopped = performance.now() - window.pressed; }, 1)",
    );
    page.press("Escape");
    wait(&mut page, "window.stopped !== null");
    wait(&mut page, &is("pick", "failed"));
    let reason = page.text("step-pick-reason");
    assert!(reason.contains("stopped from the page"), "{reason}");
    let output = page.text("step-pick-output");
    assert!(
        output.contains("the order went to the command")
            && !output.contains("interrupted, as by Ctrl-C"),
        "{output}"
    );
    // From the key to the first state that is not moving, over two programs and a busy machine.
    let took_ms = page.number("window.stopped");
    assert!(took_ms < 1_000.0, "{took_ms} ms");
    assert!(processes("lab-fast").is_empty());
}

#[test]
fn a_server_that_is_killed_leaves_no_command_behind() {
    let _alone = alone();
    let folder = Folder::new("setup-killed");
    let words = ["--idle", "--robot", "lab-fast", "--seed", "4711"];
    let serve = Serve::start_in(folder.path(), &words);
    let mut browser = Browser::start();
    let mut page = at_tab(&mut browser, &serve, "pick");
    page.fill("step-pick-seed", "4711");
    page.fill("step-pick-knows", "ideal");
    run_confirmed(&mut page, "pick");
    wait(
        &mut page,
        "mcdpr.live.task === 'pick' && mcdpr.live.state === 'Moving'",
    );
    assert_eq!(processes("4711").len(), 1);
    // As by `kill -9`.
    drop(serve);
    let give_up = Instant::now() + PATIENCE;
    while !processes("4711").is_empty() {
        assert!(Instant::now() < give_up, "{:?}", processes("4711"));
        breathe();
    }
}

#[test]
fn a_port_is_released_to_a_step_and_taken_back() {
    let _alone = alone();
    let folder = Folder::new("setup-port");
    let simulator = Simulator::start("1");
    let serve = Serve::start_in(folder.path(), &["--on", &simulator.port]);
    let mut browser = Browser::start();
    let mut page = browser.open(&serve.with_token());
    let here =
        "mcdpr.may && mcdpr.live && mcdpr.live.state === 'Disarmed' && mcdpr.live.age_s < 0.5";
    wait(&mut page, here);
    page.click("#tab-setup");
    for step in ["doctor", "home"] {
        open(&mut page, step);
        assert!(
            page.text(&format!("step-{step}-line"))
                .contains("--on /dev/")
        );
        page.click(&format!("#step-{step}-run"));
        wait(&mut page, &is(step, "done"));
        // The server has the robot again, without a word of trouble.
        wait(&mut page, here);
        assert_eq!(page.text("trouble"), "");
    }
    page.run("mcdpr.answers.length = 0");
    page.click("[data-order=clear]");
    wait(
        &mut page,
        "mcdpr.answers.some(m => m.order === 'clear' && m.ok)",
    );
    // It works, and what is tracked meanwhile outlasts the command.
    open(&mut page, "track");
    page.fill("step-track-laps", "1");
    wait(
        &mut page,
        &format!(
            "{}.includes('mcdpr run --track fitting --laps 1 ')",
            line("track")
        ),
    );
    run_confirmed(&mut page, "track");
    wait(&mut page, &is("track", "done"));
    let output = "document.getElementById('step-track-output').textContent";
    wait(&mut page, &format!("{output}.includes('tracked: 2 rests')"));
    wait(&mut page, here);
    open(&mut page, "tracked");
    page.click("#step-tracked-run");
    wait(&mut page, &is("tracked", "done"));
    let output = "document.getElementById('step-tracked-output').textContent";
    wait(
        &mut page,
        &format!("{output}.includes('friction of the winch of cable 4')"),
    );
    wait(
        &mut page,
        &format!("{output}.includes('2 rests, 2 fitted')"),
    );
}

/// A command that hears nothing any more is ended by the system, in the end.
#[test]
fn a_command_that_obeys_no_stop_is_ended() {
    let _alone = alone();
    let folder = Folder::new("setup-deaf");
    let words = ["--idle", "--robot", "lab-fast", "--seed", "4712"];
    let serve = Serve::start_in(folder.path(), &words);
    let mut browser = Browser::start();
    let mut page = at_tab(&mut browser, &serve, "pick");
    page.fill("step-pick-seed", "4712");
    page.fill("step-pick-knows", "ideal");
    run_confirmed(&mut page, "pick");
    wait(
        &mut page,
        "mcdpr.live.task === 'pick' && mcdpr.live.state === 'Moving'",
    );
    let found = processes("4712");
    let child = found[0].split_whitespace().next().unwrap();
    signal("STOP", child.parse().unwrap());
    page.click("#stop");
    let give_up = Instant::now() + PATIENCE;
    while !processes("4712").is_empty() {
        assert!(Instant::now() < give_up, "{:?}", processes("4712"));
        breathe();
    }
    wait(
        &mut page,
        "document.getElementById('steps').parentNode.parentNode.textContent.includes('the system ended the command')",
    );
    // The page goes on: the robot is the server's again.
    wait(&mut page, "mcdpr.live && mcdpr.live.state === 'Disarmed'");
}

#[test]
fn after_a_loss_of_power_the_page_says_it_in_a_sentence_with_a_button() {
    let _alone = alone();
    let folder = Folder::new("setup-recover");
    let simulator = Simulator::start_with("0.25", &["--fault", "power:board@1.5s/1s"]);
    let task = folder.path().join("way.toml");
    let text = "start_mm = [255, -105, -180]\n[[leg]]\nto_mm = [305, -75, -190]\nspeed_mm_s = 20\n";
    std::fs::write(&task, text).unwrap();
    let cut = mcdpr_tests::mcdpr()
        .args(["run", &task.display().to_string(), "--on", &simulator.port])
        .args(["--time-scale", "0.25"])
        .current_dir(folder.path())
        .output()
        .unwrap();
    assert!(!cut.status.success(), "{cut:?}");
    let words = ["--idle", "--on", &simulator.port, "--time-scale", "0.25"];
    let serve = Serve::start_in(folder.path(), &words);
    let mut browser = Browser::start();
    let mut page = browser.open(&serve.with_token());
    wait(&mut page, "mcdpr.may && mcdpr.steps.known");
    let button = "document.getElementById('recover')";
    wait(&mut page, &format!("!{button}.hidden"));
    let trouble = page.text("trouble");
    assert!(trouble.contains("the board lost its lengths"), "{trouble}");
    // Without a confirmation it refuses, and says what to do.
    page.click("#recover");
    wait(&mut page, &is("recover", "failed"));
    let next = page.text("step-recover-next");
    assert!(next.contains("--untouched"), "{next}");
    page.click("#step-recover-untouched");
    wait(
        &mut page,
        &format!("{}.includes('--untouched')", line("recover")),
    );
    page.click("#recover");
    wait(&mut page, &is("recover", "done"));
    wait(&mut page, &format!("{button}.hidden"));
}
