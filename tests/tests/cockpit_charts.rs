//! Charts of the page, in a real browser: those of a recorded run with zoom, cursor and finer data, and the live ones.
#![cfg(unix)]

mod browser;

use browser::{Browser, Page, Serve};
use mcdpr_tests::mcdpr;
use mcdpr_tests::process::{Folder, alone};
use std::time::Duration;

/// Long enough for a busy machine.
const PATIENCE: Duration = Duration::from_secs(120);

const WIDTH: &str = "mcdpr.runCharts.range[1] - mcdpr.runCharts.range[0]";
const SETTLED: &str = "mcdpr.runCharts.data && !mcdpr.runCharts.busy";

/// The middle of the plotting area of a chart of a run.
fn middle(page: &mut Page, title: &str) -> [f64; 2] {
    page.run(&format!(
        "mcdpr.runCharts.chart('{title}').host.scrollIntoView({{ block: 'center' }})"
    ));
    let point = page.run(&format!(
        "(b => [b.x + b.width / 2, b.y + b.height / 2])(mcdpr.runCharts.chart('{title}').u.over.getBoundingClientRect())"
    ));
    [0, 1].map(|axis| point[axis].as_f64().unwrap())
}

#[test]
fn charts_of_a_run_zoom_fetch_finer_data_and_their_cursor_has_the_records_values() {
    let _alone = alone();
    let folder = Folder::new("cockpit-charts");
    let at = folder.path();
    let words = ["run", "paper:table7", "--record", "runs/circle"];
    let done = mcdpr().args(words).current_dir(at).output().unwrap();
    assert!(
        done.status.success(),
        "{}",
        String::from_utf8_lossy(&done.stderr)
    );
    let record = mcdpr::record::load(&at.join("runs/circle")).unwrap();
    let serve = Serve::start_in(at, &["--idle"]);
    let mut browser = Browser::start();
    let mut page = browser.open(&serve.with_token());
    page.wait("mcdpr.may && mcdpr.live && mcdpr.live.pose", PATIENCE);
    page.click("#tab-runs");
    page.wait(
        "document.getElementById('run-list').options.length === 1",
        PATIENCE,
    );
    page.click("#run-show");
    page.wait(SETTLED, PATIENCE);
    let titles = page.run("mcdpr.runCharts.titles.join()");
    assert_eq!(
        titles,
        "Tool position,Path error,Tensions,Length errors,Lengths,Motor currents,Path time"
    );
    // The whole run: columns with the least and the greatest of their samples.
    let whole = page.number(WIDTH);
    assert!((10.0..30.0).contains(&whole), "{whole} s");
    assert!(page.number("mcdpr.runCharts.data.samples_per_column") > 5.0);
    let first = record.truth.first().unwrap().tick;
    let ticks = record.ticks();
    let tension = |tick: &mcdpr::record::decode::Tick| tick.tensions_n[3];
    let greatest = ticks
        .iter()
        .filter(|tick| tick.tick.wrapping_sub(first) < u32::MAX / 2)
        .map(tension)
        .fold(0.0, f64::max);
    let shown = page.number(
        "Math.max(...mcdpr.runCharts.data.traces.tensions_n[3][1].filter(v => v !== null))",
    );
    assert!(
        (shown - greatest).abs() < 1e-6,
        "no peak is lost: {shown}, {greatest} N"
    );
    // The wheel over one chart zooms all, and finer data come.
    let [x, y] = middle(&mut page, "Tensions");
    let before = page.number("mcdpr.runCharts.requests");
    page.wheel([x, y], -600.0);
    page.wait(&format!("{WIDTH} < {whole} * 0.6"), PATIENCE);
    page.wait(
        &format!("{SETTLED} && mcdpr.runCharts.requests > {before}"),
        PATIENCE,
    );
    let nearer = page.number(WIDTH);
    let same = "['Tensions', 'Lengths'].every(t => mcdpr.runCharts.chart(t).u.scales.x.min === mcdpr.runCharts.range[0])";
    assert!(page.truth(same));
    // A part that is drawn over with the mouse is enlarged to the whole width.
    page.drag([x - 60.0, y], [x + 60.0, y]);
    page.wait(&format!("{WIDTH} < {nearer} * 0.8"), PATIENCE);
    page.wait(SETTLED, PATIENCE);
    let drawn = page.number(WIDTH);
    // Two fingers that are spread enlarge what is between them; brought together they do the opposite.
    let [[close, far], [back, apart]] =
        [[20.0, 80.0], [80.0, 20.0]].map(|pair| pair.map(|by| [[x - by, y], [x + by, y]]));
    page.two_fingers(close, far);
    page.wait(&format!("{WIDTH} < {drawn} * 0.5"), PATIENCE);
    page.wait(SETTLED, PATIENCE);
    let spread = page.number(WIDTH);
    page.two_fingers(back, apart);
    page.wait(&format!("{WIDTH} > {spread} * 2"), PATIENCE);
    page.wait(SETTLED, PATIENCE);
    let nearer = page.number(WIDTH);
    // A key does it, too, down to single samples.
    page.run("mcdpr.runCharts.chart('Tensions').host.focus()");
    page.press("+");
    page.wait(&format!("{WIDTH} < {nearer} * 0.6"), PATIENCE);
    for _ in 0..5 {
        page.press("+");
    }
    page.wait(
        &format!("{SETTLED} && mcdpr.runCharts.data.samples_per_column === 1"),
        PATIENCE,
    );
    // The cursor: the mouse on the chart moves it, the slider and the drawing follow.
    page.mouse_to([x + 11.0, y]);
    page.wait("mcdpr.runs.at > 0", PATIENCE);
    let [time_s, low, high] = ["time", "lines[3][0]", "lines[3][1]"]
        .map(|what| page.number(&format!("mcdpr.runCharts.chart('Tensions').at().{what}")));
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a short run"
    )]
    let wanted = first.wrapping_add((time_s * 1e3).round() as u32);
    let recorded = ticks
        .iter()
        .find(|tick| tick.tick == wanted)
        .map(tension)
        .unwrap();
    assert!(
        low == high && (low - recorded).abs() < 1e-6,
        "{low} {high} {recorded} N"
    );
    let words =
        page.run("mcdpr.runCharts.chart('Tensions').figure.querySelector('output').textContent");
    let value = format!("4 {recorded:.3}");
    assert!(words.as_str().unwrap().contains(&value), "{words}: {value}");
    let slider = page.number("document.getElementById('run-time').valueAsNumber");
    let spread = page.number(WIDTH);
    assert!(
        (slider - time_s).abs() < spread / 50.0 + 2e-3,
        "{slider} {time_s}"
    );
    let tool = page.number(
        "(() => { const r = mcdpr.runs.run, i = r.instants.filter(k => k.time_s <= mcdpr.runs.at).pop(); \
         return Math.hypot(...Scene.past.pose.tool_m.map((v, a) => v - i.tool_m[a])); })()",
    );
    assert!(tool == 0.0, "{tool} m");
    // And the other way round.
    page.press("0");
    page.wait(&format!("Math.abs({WIDTH} - {whole}) < 1e-9"), PATIENCE);
    page.mouse_to([1.0, 1.0]);
    page.fill("run-time", "5");
    page.wait(
        "Math.abs(mcdpr.runCharts.chart('Lengths').at().time - 5) < 0.05",
        PATIENCE,
    );
    page.click("#run-leave");
    assert!(page.truth("!Scene.past && document.getElementById('run-view').hidden"));
}

#[test]
fn live_charts_show_what_is_chosen_and_the_band_is_about_the_planned_tension() {
    let _alone = alone();
    let folder = Folder::new("cockpit-live");
    let serve = Serve::start_in(folder.path(), &["--idle"]);
    let mut browser = Browser::start();
    let mut page = browser.open(&serve.with_token());
    page.wait("mcdpr.may && mcdpr.live && mcdpr.live.pose", PATIENCE);
    assert_eq!(page.run("mcdpr.liveCharts.shown.join()"), "tensions,errors");
    page.click("#see-currents");
    page.click("#see-path");
    page.run("mcdpr.send({ order: 'start' })");
    page.wait(
        "mcdpr.live.state === 'Moving' && mcdpr.live.expected_n.length && mcdpr.live.path_s > 1",
        PATIENCE,
    );
    // At every instant, the band is 0.5 N to both sides of what the motion plans for the held cable.
    let off = page.number(
        "(() => { const b = mcdpr.liveCharts.band, wanted = mcdpr.live.expected_n[3]; \
         return Math.max(Math.abs(b[0] - wanted + 0.5), Math.abs(b[1] - wanted - 0.5)); })()",
    );
    assert!(off < 1e-9, "{off} N");
    assert!(page.truth("Math.abs(mcdpr.live.expected_n[3] - mcdpr.robot.setpoint_n) > 0.01"));
    for kind in ["currents", "path"] {
        let some = format!(
            "mcdpr.liveCharts.chart('{kind}').at().lines.every(l => Number.isFinite(l[0]))"
        );
        page.wait(&some, PATIENCE);
    }
    let same = "(() => { const c = mcdpr.liveCharts.chart('currents').at(), t = c.time; \
                return Math.abs(t - mcdpr.live.time_s) < 1 && c.lines.length === 4; })()";
    page.wait(same, PATIENCE);
    // Zoom stops the chart, one button lets it follow again.
    page.run("mcdpr.liveCharts.chart('tensions').host.focus()");
    page.press("+");
    page.wait("mcdpr.liveCharts.range", PATIENCE);
    assert!(page.truth("mcdpr.liveCharts.range[1] - mcdpr.liveCharts.range[0] < 15"));
    page.click("#live-follow");
    assert!(page.truth("!mcdpr.liveCharts.range"));
    page.click("#see-errors");
    assert_eq!(
        page.run("mcdpr.liveCharts.shown.join()"),
        "tensions,currents,path"
    );
    page.press("Escape");
}

/// The browser of these tests: a page that moves between press and release takes the click away from its element.
#[test]
fn a_click_reaches_its_element_though_the_page_moves_under_it() {
    let _alone = alone();
    let mut browser = Browser::start();
    let mut page = browser.open("about:blank");
    page.run(
        "(() => { document.body.innerHTML = \"<div style='height:90vh'><input type='checkbox' id='tick' style='position:relative'></div>\"; \
         const e = document.getElementById('tick'); \
         e.addEventListener('mousedown', () => { e.style.left = '200px'; }, { once: true }); })()",
    );
    page.click("#tick");
    assert!(page.truth("document.getElementById('tick').checked"));
    assert_eq!(
        page.run("document.getElementById('tick').style.left"),
        "200px"
    );
}
