//! The playground in a real browser: opened from the disk, without a server. Needs Chromium and the files of
//! `cargo xtask playground`; `cargo xtask test` sees to both.
#![cfg(unix)]

mod browser;

use browser::{Browser, Page, distance_mm, tool_mm};
use mcdpr_tests::mcdpr;
use mcdpr_tests::process::{Folder, alone};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Long enough for a busy machine.
const PATIENCE: Duration = Duration::from_secs(120);

fn wait(page: &mut Page, what: &str) {
    page.wait(what, PATIENCE);
}

fn address() -> String {
    let folder = std::env::var_os("CARGO_TARGET_DIR").map_or_else(
        || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../target"),
        PathBuf::from,
    );
    let file = folder.join("playground/index.html");
    let file = file.canonicalize().unwrap_or_else(|error| {
        panic!(
            "{}: {error}; `cargo xtask playground` makes it",
            file.display()
        )
    });
    format!("file://{}", file.display())
}

/// The playground with a robot that moves or waits.
fn open(browser: &mut Browser, hash: &str) -> Page {
    let mut page = browser.open(&format!("{}{hash}", address()));
    wait(&mut page, "mcdpr.may && mcdpr.live && mcdpr.live.pose");
    page
}

fn stop(page: &mut Page) {
    page.press("Escape");
    wait(page, "mcdpr.live.state === 'Disarmed' && !mcdpr.live.task");
}

/// What the program itself says of a robot's run.
fn native(robot: &str, seed: u64) -> String {
    let output = mcdpr()
        .args(["fingerprint", "--json", "--robot", robot, "--seed"])
        .arg(seed.to_string())
        .output()
        .unwrap();
    assert!(output.status.success());
    let said: Value = serde_json::from_slice(&output.stdout).unwrap();
    said["sha256"].as_str().unwrap().to_owned()
}

#[test]
fn a_run_in_the_page_is_that_of_the_program_to_the_last_bit() {
    let _alone = alone();
    let mut browser = Browser::start();
    let mut page = open(&mut browser, "");
    stop(&mut page);
    page.click("#tab-sim");
    // A robot of four cables as it opens, and one of eight, with other errors.
    for (robot, seed) in [("paper-table5", 1), ("eight-cable", 7)] {
        page.fill("sim-robots", robot);
        page.fill("sim-seed", &seed.to_string());
        page.click("#sim-restart");
        wait(
            &mut page,
            &format!("mcdpr.robot.name === '{robot}' && mcdpr.live.pose"),
        );
        stop(&mut page);
        page.click("#sim-check");
        wait(
            &mut page,
            "/^[0-9a-f]{64} /.test(document.getElementById('sim-words').textContent)",
        );
        let words = page.text("sim-words");
        assert_eq!(words[..64], native(robot, seed), "{robot}");
    }
    // The same seed of a machine that is exactly as described is another run.
    assert_ne!(native("eight-cable", 7), native("eight-cable", 8));
}

#[test]
fn the_robot_moves_is_pushed_gets_a_fault_and_goes_on_after_it() {
    let _alone = alone();
    let mut browser = Browser::start();
    let mut page = open(&mut browser, "");
    // It begins with its circle.
    wait(
        &mut page,
        "mcdpr.live.state === 'Moving' && mcdpr.live.path_s > 1",
    );
    let before = tool_mm(&mut page);
    wait(
        &mut page,
        &format!(
            "Math.abs(mcdpr.live.pose.tool_m[0] * 1e3 - {}) > 5",
            before[0]
        ),
    );
    stop(&mut page);
    let rest = tool_mm(&mut page);
    // A hand pushes the platform on its brakes: the cables give way, and it swings back.
    page.click("#tab-sim");
    page.click("#sim-hand");
    page.press_at("#scene", [0.5, 0.4]);
    page.move_to("#scene", [0.53, 0.4]);
    wait(
        &mut page,
        &format!(
            "Math.hypot(...mcdpr.live.pose.tool_m.map((v, i) => v * 1e3 - [{}, {}, {}][i])) > 0.3",
            rest[0], rest[1], rest[2]
        ),
    );
    page.let_go("#scene", [0.53, 0.4]);
    page.click("#sim-hand");
    // However hard the push was: a new robot begins with its circle.
    page.click("#sim-restart");
    // An open tension input stops the motion, by its name, and the robot needs a clear.
    wait(&mut page, "mcdpr.live.state === 'Moving'");
    page.fill("sim-fault", "S7");
    page.fill("sim-cable", "2");
    page.click("#sim-inject");
    wait(&mut page, "mcdpr.live.state === 'Fault'");
    let fault = page.text("alarm");
    assert!(fault.contains("S7") && fault.contains("cable 2"), "{fault}");
    // A new robot has no fault.
    page.click("#sim-restart");
    wait(
        &mut page,
        "!mcdpr.live.fault && mcdpr.live.state === 'Moving'",
    );
    stop(&mut page);
    // A task is planned, judged and run.
    page.click("#tab-place");
    page.fill("to-x", "300");
    page.fill("to-y", "0");
    page.fill("to-z", "-200");
    page.click("#to-plan");
    wait(
        &mut page,
        "mcdpr.work.preview && !document.getElementById('plan-start').disabled",
    );
    page.click("#plan-start");
    wait(&mut page, "mcdpr.live.state === 'Moving'");
    wait(
        &mut page,
        "mcdpr.live.state === 'Disarmed' && !mcdpr.live.task",
    );
    let there = tool_mm(&mut page);
    assert!(distance_mm(there, [300.0, 0.0, -200.0]) < 3.0, "{there:?}");
}

#[test]
fn the_robot_file_is_changed_and_a_link_keeps_the_state() {
    let _alone = alone();
    let mut browser = Browser::start();
    let mut page = open(&mut browser, "");
    stop(&mut page);
    page.click("#tab-robot");
    wait(
        &mut page,
        "document.getElementById('robot-text').value.length > 100",
    );
    let text = page.run("document.getElementById('robot-text').value");
    let text = text.as_str().unwrap().to_owned();
    // Nonsense is refused in words, and the robot stays.
    page.fill("robot-text", &text.replacen("mass_kg = ", "mass_kg = -", 1));
    page.click("#robot-check");
    wait(
        &mut page,
        "document.getElementById('robot-words').textContent.includes('mass_kg')",
    );
    let own = format!("# changed in the page\n{text}");
    page.fill("robot-text", &own);
    page.click("#robot-check");
    wait(&mut page, "!document.getElementById('robot-save').disabled");
    page.click("#robot-save");
    wait(&mut page, "mcdpr.live.state === 'Moving'");
    wait(&mut page, "mcdpr.live.path_s > 1");
    stop(&mut page);
    let place = tool_mm(&mut page);
    page.click("#tab-sim");
    page.click("#sim-link");
    wait(&mut page, "document.getElementById('sim-url').value");
    let link = page.run("document.getElementById('sim-url').value");
    let link = link.as_str().unwrap();
    let hash = link.split_once('#').unwrap().1;
    let mut other = open(&mut browser, &format!("#{hash}"));
    let there = tool_mm(&mut other);
    assert!(
        distance_mm(there, place) < 2.0,
        "{there:?} instead of {place:?}"
    );
    other.click("#tab-robot");
    wait(
        &mut other,
        "document.getElementById('robot-text').value.startsWith('# changed in the page')",
    );
    // A damaged link is named, and the playground opens all the same.
    let mut damaged = open(&mut browser, "#state=AAAA");
    assert!(damaged.text("trouble").contains("damaged"));
}

/// Records a run by the program itself.
fn record(folder: &Path, robot: &str, name: &str) -> PathBuf {
    let words = ["run", "fitting", "--robot", robot, "--record", name];
    let done = mcdpr().args(words).current_dir(folder).output().unwrap();
    let said = String::from_utf8_lossy(&done.stderr);
    assert!(done.status.success(), "{said}");
    folder.join(name).join("run.mcap")
}

#[test]
fn records_of_the_program_are_opened_drawn_and_charted() {
    let _alone = alone();
    let folder = Folder::new("playground-records");
    let paper = record(folder.path(), "paper-table5", "paper");
    let eight = record(folder.path(), "eight-cable", "eight");
    let torn = folder.path().join("torn.mcap");
    let bytes = std::fs::read(&paper).unwrap();
    std::fs::write(&torn, &bytes[..bytes.len() / 2]).unwrap();
    let other = folder.path().join("other.mcap");
    std::fs::write(&other, b"name = 3").unwrap();

    let mut browser = Browser::start();
    let mut page = open(&mut browser, "");
    stop(&mut page);
    page.click("#tab-runs");
    page.choose_file("run-file", &paper);
    wait(&mut page, "mcdpr.runs.run && mcdpr.runs.run.drawn");
    // What the page says is what the program says of the same file.
    let run = mcdpr::record::load(&paper).unwrap();
    let judged = mcdpr::report::judge(&run, &run.designed_robot().unwrap());
    let wanted = judged.path_error_m.unwrap();
    for (key, wanted) in [("mean", wanted.mean), ("max", wanted.max)] {
        let found = page.number(&format!("mcdpr.runs.run.judgement.path_error_m.{key}"));
        assert!((found - wanted).abs() < 1e-12, "{key}: {found} {wanted}");
    }
    wait(&mut page, "mcdpr.runCharts.data && !mcdpr.runCharts.busy");
    let samples = page.number("mcdpr.runCharts.data.time_s.length");
    assert!(samples > 100.0, "{samples}");
    page.click("#run-play");
    wait(&mut page, "mcdpr.runs.at > 0.5");
    page.click("#run-live");

    // Half of a file is read as far as it goes, and the page says so.
    page.choose_file("run-file", &torn);
    wait(
        &mut page,
        "document.getElementById('run-words').textContent.includes('cut short')",
    );
    // What is no record is refused in words, and the list stays.
    page.choose_file("run-file", &other);
    wait(
        &mut page,
        "document.getElementById('run-trouble').textContent.includes('other.mcap')",
    );
    assert_eq!(
        page.number("document.getElementById('run-list').options.length"),
        2.0
    );
    // Another robot's run is drawn as soon as that robot is on the stage.
    page.choose_file("run-file", &eight);
    wait(
        &mut page,
        "mcdpr.runs.run.robot === 'eight-cable' && !mcdpr.runs.run.drawn",
    );
    page.click("#run-robot");
    wait(
        &mut page,
        "mcdpr.robot.name === 'eight-cable' && mcdpr.runs.run.drawn",
    );
    assert!(page.truth("mcdpr.live.state === 'Disarmed'"), "it waits");
}
