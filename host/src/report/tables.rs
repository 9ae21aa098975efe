//! A recorded run as tables for other programs.

use crate::record::decode::Seen;
use crate::record::{RecordedRun, Report};
use std::fmt::Write as _;

/// Every table of a run: file name and CSV text, SI units in the headings.
#[must_use]
pub fn all(run: &RecordedRun) -> Vec<(&'static str, String)> {
    vec![
        ("cables.csv", cables(run)),
        ("status.csv", status(run)),
        ("truth.csv", truth(run)),
        ("log.csv", log(run)),
    ]
}

// Writing to a string cannot fail, here and below.

fn head(text: &mut String, what: &str, unit: &str, count: usize) {
    for cable in 1..=count {
        let _ = write!(text, ",{what}_{cable}_{unit}");
    }
}

fn row(text: &mut String, values: &[f64], count: usize, digits: usize) {
    for index in 0..count {
        match values.get(index) {
            Some(value) => {
                let _ = write!(text, ",{value:.digits$}");
            }
            None => text.push(','),
        }
    }
}

fn cables(run: &RecordedRun) -> String {
    let ticks = run.ticks();
    let count = ticks.first().map_or(0, |tick| tick.lengths_m.len());
    let mut text = String::from("tick,path_s");
    head(&mut text, "length", "m", count);
    head(&mut text, "planned_length", "m", count);
    head(&mut text, "tension", "n", count);
    head(&mut text, "planned_tension", "n", count);
    head(&mut text, "current", "a", count);
    text.push('\n');
    for tick in &ticks {
        let path = tick
            .path_s
            .map_or(String::new(), |path| format!("{path:.3}"));
        let _ = write!(text, "{},{path}", tick.tick);
        let planned: Vec<_> = tick.planned.iter().map(|p| p.length_m).collect();
        let expected: Vec<_> = tick.planned.iter().map(|p| p.tension_n).collect();
        row(&mut text, &tick.lengths_m, count, 7);
        row(&mut text, &planned, count, 7);
        row(&mut text, &tick.tensions_n, count, 3);
        row(&mut text, &expected, count, 3);
        row(&mut text, &tick.currents_a, count, 3);
        text.push('\n');
    }
    text
}

fn status(run: &RecordedRun) -> String {
    let mut text = String::from(
        "time_s,tick,state,path_s,fault,limits,brakes_open,torque_on,frames_bad,tick_overruns\n",
    );
    for Report { time_s, seen } in run.seen() {
        let Seen::Status(status) = seen else { continue };
        let fault = status.fault.map_or("", |fault| fault.fault.name());
        let _ = writeln!(
            text,
            "{time_s:.6},{},{:?},{:.3},{fault},{},{},{},{},{}",
            status.tick.0,
            status.state,
            f64::from(status.path_ms) * 1e-3,
            status.limits.0,
            status.brakes_open,
            status.torque_on,
            status.frames_bad,
            status.tick_overruns,
        );
    }
    text
}

fn truth(run: &RecordedRun) -> String {
    let count = run.truth.first().map_or(0, |point| point.tensions_n.len());
    let mut text = String::from(
        "tick,path_s,tool_x_m,tool_y_m,tool_z_m,platform_x_m,platform_y_m,platform_z_m,qx,qy,qz,qw",
    );
    head(&mut text, "platform_tension", "n", count);
    text.push('\n');
    for point in &run.truth {
        let _ = write!(text, "{},{:.3}", point.tick, point.path_s);
        row(&mut text, &point.tool_m, 3, 7);
        row(&mut text, &point.position_m, 3, 7);
        row(&mut text, &point.rotation_xyzw, 4, 9);
        row(&mut text, &point.tensions_n, count, 3);
        text.push('\n');
    }
    text
}

fn log(run: &RecordedRun) -> String {
    let mut text = String::from("time_s,level,message\n");
    for line in &run.log {
        let quoted = line.text.replace('"', "\"\"");
        let _ = writeln!(text, "{:.6},{},\"{quoted}\"", line.time_s, line.level);
    }
    text
}
