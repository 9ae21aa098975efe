//! The live page in a real browser: it loads, shows live data, stops the robot, comes back after a
//! restart, and serves several viewers. Needs Chromium; `cargo xtask test` installs it where it is
//! missing. Tests run one after the other, and wait with deadlines.
#![cfg(unix)]

mod browser;

use browser::{Browser, Page, Serve};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Long enough for a busy machine.
const PATIENCE: Duration = Duration::from_secs(40);

/// One browser at a time: two cores do not draw two robots in time.
fn alone() -> MutexGuard<'static, ()> {
    static LOCK: Mutex<()> = Mutex::new(());
    LOCK.lock().unwrap_or_else(PoisonError::into_inner)
}

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
    // On a phone nothing sticks out to the side, and the stop button can be seen.
    page.resize(375, 740);
    wait(&mut page, "document.documentElement.scrollWidth <= 376");
    assert!(page.number("document.getElementById('stop').getBoundingClientRect().width") > 200.0);
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
         s.onmessage = e => { const m = JSON.parse(e.data); if (m.type === 'answer') window.said = m; }; })()",
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
    // A browser that goes away does not disturb anybody.
    drop(browser);
    let mut other = Browser::start();
    let mut page = other.open(&serve.address());
    wait(&mut page, "mcdpr.live && mcdpr.live.age_s < 0.5");
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
    let serve = Serve::start(&["--port", &port]);
    wait(
        &mut page,
        "mcdpr.connected && document.getElementById('stale').hidden",
    );
    wait(&mut page, MOVING);
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
    use std::io::{BufRead as _, BufReader};
    let _alone = alone();
    let folder = std::env::temp_dir().join(format!("mcdpr-page-{}", std::process::id()));
    let mut run = mcdpr_tests::mcdpr()
        .args(["run", "paper:table7", "--serve", "0", "--record"])
        .arg(&folder)
        .stdout(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(run.stdout.take().unwrap()).lines();
    let address = lines
        .find_map(|line| {
            line.unwrap()
                .strip_prefix("to give orders:")
                .map(|a| a.trim().to_owned())
        })
        .unwrap();
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
            .arg(&folder)
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
    let report = std::fs::read_to_string(folder.join("report.html")).unwrap();
    for what in [
        "order: pause",
        "order: resume",
        "order: stop",
        "state Disarmed",
        "<svg",
    ] {
        assert!(report.contains(what), "{what}");
    }
    std::fs::remove_dir_all(folder).unwrap();
}
