//! Recorded runs and the robot file on the page, in a real browser: list, figures, replay in the drawing, report,
//! comparison; values, differences, saving.
#![cfg(unix)]

mod browser;

use browser::{Browser, Serve};
use mcdpr_tests::mcdpr;
use mcdpr_tests::process::{Folder, alone};
use std::path::Path;
use std::time::Duration;

/// Long enough for a busy machine.
const PATIENCE: Duration = Duration::from_secs(120);

fn run(folder: &Path, task: &str, robot: &str, name: &str) {
    let record = format!("runs/{name}");
    let words = ["run", task, "--robot", robot, "--record", &record];
    let done = mcdpr().args(words).current_dir(folder).output().unwrap();
    let said = String::from_utf8_lossy(&done.stderr);
    assert!(done.status.success(), "{said}");
}

#[test]
fn a_run_of_before_is_judged_and_moves_in_the_drawing_until_the_robot_moves() {
    let _alone = alone();
    let folder = Folder::new("cockpit-runs");
    let at = folder.path();
    run(at, "paper:table8", "paper-table5", "2026-01-01-line");
    run(at, "paper:table7", "paper-table5", "2026-01-02-circle");
    run(at, "fitting", "eight-cable", "2026-01-03-other");
    std::fs::create_dir(at.join("runs/2026-01-04-broken")).unwrap();
    std::fs::write(at.join("runs/2026-01-04-broken/run.mcap"), b"no record").unwrap();
    let serve = Serve::start_in(at, &["--idle"]);
    let mut browser = Browser::start();
    let mut page = browser.open(&serve.with_token());
    let wait = |page: &mut browser::Page, what: &str| page.wait(what, PATIENCE);
    wait(&mut page, "mcdpr.may && mcdpr.live && mcdpr.live.pose");
    page.click("#tab-runs");
    wait(
        &mut page,
        "document.getElementById('run-list').options.length === 4",
    );
    // The latest first; one that is no record says so, and nothing is drawn.
    assert_eq!(
        page.run("document.getElementById('run-list').value"),
        "2026-01-04-broken"
    );
    page.click("#run-show");
    wait(
        &mut page,
        "document.getElementById('run-trouble').textContent.length > 20",
    );
    assert!(page.truth("document.getElementById('past').hidden && !Scene.past"));
    // A circle: its figures, and its motion at any time.
    page.fill("run-list", "2026-01-02-circle");
    page.click("#run-show");
    wait(&mut page, "mcdpr.runs.run && Scene.past");
    let words = page.text("run-words");
    assert!(
        words.contains("paper-table5") && words.contains("table7"),
        "{words}"
    );
    let figures = page.text("run-figures");
    assert!(
        figures.contains("path error") && figures.contains("pass"),
        "{figures}"
    );
    assert!(page.text("past").contains("true state of the simulation"));
    let half = page.number("document.getElementById('run-time').max / 2");
    assert!((3.0..10.0).contains(&half), "{half} s");
    page.fill("run-time", &half.to_string());
    wait(&mut page, "mcdpr.runs.at > 1");
    // The tool drawn is that of the record at that time.
    let off = page.number(
        "(() => { const r = mcdpr.runs.run, i = r.instants.filter(k => k.time_s <= mcdpr.runs.at).pop(); \
         return Math.hypot(...Scene.past.pose.tool_m.map((v, a) => v - i.tool_m[a])); })()",
    );
    assert!(off == 0.0, "{off} m");
    let moved = page.number(
        "Math.hypot(...Scene.past.pose.tool_m.map((v, a) => v - mcdpr.runs.run.instants[0].tool_m[a])) * 1e3",
    );
    assert!(moved > 10.0, "{moved} mm");
    // Playing goes on by itself, a pause ends it.
    page.click("#run-play");
    let later = format!("mcdpr.runs.at > {half} + 0.3");
    wait(&mut page, &later);
    page.click("#run-play");
    assert_eq!(page.text("run-play"), "Play");
    page.click("#run-live");
    assert!(page.truth("document.getElementById('past').hidden && !Scene.past"));
    // The charts' buttons, and the list read again.
    page.click("#run-show");
    let width = "mcdpr.runCharts.range[1] - mcdpr.runCharts.range[0]";
    let settled = "mcdpr.runCharts.data && !mcdpr.runCharts.busy";
    wait(&mut page, settled);
    let whole = page.number(width);
    page.click("#run-closer");
    wait(&mut page, &format!("{width} < {whole} * 0.9"));
    let closer = page.number(width);
    page.click("#run-wider");
    wait(&mut page, &format!("{width} > {closer} * 1.1"));
    page.click("#run-closer");
    page.click("#run-whole");
    wait(&mut page, &format!("Math.abs({width} - {whole}) < 1e-9"));
    std::fs::create_dir(at.join("runs/2026-01-05-new")).unwrap();
    std::fs::write(at.join("runs/2026-01-05-new/run.mcap"), b"no record").unwrap();
    page.click("#run-again");
    wait(
        &mut page,
        "document.getElementById('run-list').options.length === 5",
    );
    page.fill("run-list", "2026-01-02-circle");
    page.fill("run-other", "2026-01-01-line");
    // Report and comparison open in a window of their own.
    page.run("window.opened = []; window.open = path => { window.opened.push(path); }");
    page.click("#run-report");
    page.click("#run-compare");
    wait(&mut page, "window.opened.length === 2");
    assert_eq!(
        page.run("window.opened.join()"),
        "/runs/2026-01-02-circle/report,/runs/2026-01-02-circle/compare/2026-01-01-line"
    );
    page.click("#run-live");
    // Another robot's run has figures, and no drawing.
    page.fill("run-list", "2026-01-03-other");
    page.click("#run-show");
    wait(&mut page, "mcdpr.runs.run.robot === 'eight-cable'");
    assert!(page.text("run-words").contains("another robot"));
    assert!(page.truth("document.getElementById('run-motion').hidden && !Scene.past"));
    // As soon as the robot moves, it is what is drawn.
    page.fill("run-list", "2026-01-01-line");
    page.click("#run-show");
    wait(&mut page, "Scene.past");
    page.run("mcdpr.send({ order: 'start' })");
    wait(&mut page, "mcdpr.live.state === 'Moving'");
    assert!(page.truth("!Scene.past && document.getElementById('past').hidden"));
    page.press("Escape");
}

#[test]
fn reports_and_comparisons_open_and_other_files_do_not() {
    let _alone = alone();
    let folder = Folder::new("cockpit-reports");
    let at = folder.path();
    run(at, "paper:table8", "paper-table5", "a");
    run(at, "paper:table8", "paper-table5", "b");
    std::fs::write(at.join("secret"), "secret").unwrap();
    let serve = Serve::start_in(at, &["--idle"]);
    let mut browser = Browser::start();
    // Without the token: whoever may look may look at runs, too.
    let mut page = browser.open(&serve.address());
    page.wait("mcdpr.live", PATIENCE);
    let mut fetched = |path: &str| {
        page.run("window.got = null");
        page.run(&format!(
            "fetch('{path}').then(async a => {{ window.got = [a.status, await a.text()]; }})"
        ));
        page.wait("window.got", PATIENCE);
        (page.number("window.got[0]"), page.run("window.got[1]"))
    };
    let (status, report) = fetched("/runs/a/report");
    assert!(status == 200.0 && report.as_str().unwrap().contains("<svg"));
    let (status, both) = fetched("/runs/a/compare/b");
    assert!(status == 200.0 && both.as_str().unwrap().contains("<svg"));
    for path in [
        "/runs/c",
        "/runs/..%2F..%2Fsecret",
        "/runs/.../report",
        "/secret",
        "/runs/a/run.mcap",
    ] {
        let (status, text) = fetched(path);
        assert!(status == 404.0, "{path}: {text}");
    }
}

#[test]
fn the_robot_file_is_changed_with_its_differences_in_view() {
    let _alone = alone();
    let folder = Folder::new("cockpit-robot");
    let at = folder.path();
    let words = [
        "config",
        "init",
        "own.toml",
        "--frame-mm",
        "1000",
        "1000",
        "1000",
    ];
    let done = mcdpr().args(words).current_dir(at).output().unwrap();
    assert!(
        done.status.success(),
        "{}",
        String::from_utf8_lossy(&done.stderr)
    );
    let file = at.join("own.toml");
    let before = std::fs::read_to_string(&file).unwrap();
    let serve = Serve::start_in(at, &["--idle", "--robot", "own.toml"]);
    let mut browser = Browser::start();
    let mut page = browser.open(&serve.with_token());
    let wait = |page: &mut browser::Page, what: &str| page.wait(what, PATIENCE);
    wait(&mut page, "mcdpr.may && mcdpr.live && mcdpr.live.pose");
    page.click("#tab-robot");
    wait(&mut page, "mcdpr.robotFile.file");
    assert_eq!(page.text("robot-name"), "own.toml");
    // Every value with its range and meaning.
    let rows = page.number("document.getElementById('robot-settings').rows.length");
    assert!(rows > 10.0, "{rows}");
    assert!(page.truth(
        "[...document.getElementById('robot-settings').rows].every(r => r.title.length > 5)"
    ));
    let disabled = "document.getElementById('robot-save').disabled";
    assert!(page.truth(disabled), "nothing was checked");
    // Nonsense is named, and cannot be saved.
    let wrong = before.replace("mass_kg = ", "mass_kg = -");
    assert_ne!(wrong, before);
    page.fill("robot-text", &wrong);
    page.click("#robot-check");
    wait(
        &mut page,
        "document.getElementById('robot-words').classList.contains('bad')",
    );
    assert!(page.text("robot-words").contains("mass_kg"));
    assert!(page.truth(disabled));
    // A change is shown with both values before it can be saved.
    let heavier = before.replace("mass_kg = ", "mass_kg = 1");
    page.fill("robot-text", &heavier);
    page.click("#robot-check");
    wait(
        &mut page,
        "document.getElementById('robot-changes').rows.length === 1",
    );
    assert!(page.text("robot-changes").contains("mass_kg"));
    page.run("document.getElementById('robot-save').scrollIntoView()");
    assert!(page.truth(&format!("!{disabled}")));
    // A text that was changed after the check must be checked again.
    page.fill("robot-text", &format!("{heavier}\n"));
    assert!(page.truth(disabled));
    page.fill("robot-text", &heavier);
    page.click("#robot-save");
    wait(
        &mut page,
        "document.getElementById('robot-words').textContent.startsWith('Saved')",
    );
    assert_eq!(std::fs::read_to_string(&file).unwrap(), heavier);
    assert_eq!(
        std::fs::read_to_string(at.join("own.toml.before")).unwrap(),
        before
    );
    // The server reads it without a restart. It keeps its address, so the page comes back by itself.
    let mass = "mcdpr.robotFile.file && mcdpr.robot.mass_kg > 10 && mcdpr.connected && mcdpr.may";
    assert!(!page.truth(mass));
    page.click("#robot-use");
    wait(&mut page, mass);
    assert_eq!(page.text("robot-name"), "own.toml");
    // A file that cannot be used changes nothing, and the reason stands beside the button.
    std::fs::write(&file, &wrong).unwrap();
    page.click("#robot-use");
    wait(
        &mut page,
        "document.getElementById('robot-words').textContent.includes('mass_kg')",
    );
    wait(&mut page, "mcdpr.connected && mcdpr.robot.mass_kg > 10");
    std::fs::write(&file, &heavier).unwrap();
    page.click("#robot-again");
    wait(
        &mut page,
        "document.getElementById('robot-words').textContent === ''",
    );
    // Someone else's change is not overwritten.
    std::fs::write(&file, &before).unwrap();
    page.fill("robot-text", &format!("{heavier}# mine\n"));
    page.click("#robot-check");
    wait(&mut page, &format!("!{disabled}"));
    page.click("#robot-save");
    wait(
        &mut page,
        "document.getElementById('robot-words').textContent.includes('meanwhile')",
    );
    assert_eq!(std::fs::read_to_string(&file).unwrap(), before);
}
