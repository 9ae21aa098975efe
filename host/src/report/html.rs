//! A recorded run as one self-contained HTML page, and two of them compared.

use super::{MeanMax, MeanSdMax};
use crate::chart::{Chart, Curve, Figure};
use crate::record::decode::Tick;
use crate::record::{Machine, RecordedRun};
use crate::robot::{Control, Robot};
use mcdpr_twin::record::judge::{Judgement, moving, path_errors};
use std::fmt::Write as _;

const STYLE: &str = "\
:root{--bg:#fff;--text:#17202a;--dim:#566472;--edge:#dde3ea;--good:#1a7f37;--bad:#c6302b;--c0:#0072b2;--c1:#d55e00;--c2:#009e73;--c3:#8a2fb5;--c4:#17202a;--c5:#b3261e;--c6:#00798c;--c7:#777}
@media (prefers-color-scheme:dark){:root{--bg:#12171d;--text:#e6edf3;--dim:#93a1b0;--edge:#2c3743;--good:#3fb950;--bad:#ff6b66;--c0:#4aa8ff;--c1:#ffb454;--c2:#7ee787;--c3:#e58cff;--c4:#e6edf3;--c5:#ff6b66;--c6:#39c5cf;--c7:#999}}
body{margin:0 auto;max-width:68rem;padding:1.5rem;background:var(--bg);color:var(--text);font:15px/1.5 system-ui,'DejaVu Sans',sans-serif}
h1{font-size:1.5rem;margin:0}h2{font-size:1.1rem;margin:2rem 0 .5rem;border-bottom:1px solid var(--edge)}
p.about{color:var(--dim);margin:.2rem 0 1rem}table{border-collapse:collapse;font-variant-numeric:tabular-nums}
td,th{padding:.25rem .8rem .25rem 0;text-align:left;border-bottom:1px solid var(--edge)}td.n,th.n{text-align:right}th{color:var(--dim);font-weight:400}
.pass{color:var(--good);font-weight:600}.fail{color:var(--bad);font-weight:600}
.plots{display:grid;grid-template-columns:repeat(auto-fit,minmax(30rem,1fr));gap:1rem}@media(max-width:34rem){.plots{grid-template-columns:1fr}}
svg{width:100%;height:auto;background:var(--bg)}svg text{fill:var(--dim)}svg text.title{fill:var(--text)}
svg .grid{stroke:var(--edge)}svg .band{fill:var(--c2)}svg .mark{stroke:var(--dim)}svg .fault{stroke:var(--bad)}
.c0{stroke:var(--c0)}.c1{stroke:var(--c1)}.c2{stroke:var(--c2)}.c3{stroke:var(--c3)}.c4{stroke:var(--c4)}.c5{stroke:var(--c5)}.c6{stroke:var(--c6)}.c7{stroke:var(--c7)}
";

/// A page with the given title and body.
#[must_use]
pub fn page(title: &str, body: &str) -> String {
    format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" \
         content=\"width=device-width, initial-scale=1\"><title>{}</title><style>{STYLE}</style>\
         </head><body>{body}</body></html>\n",
        escape(title)
    )
}

/// Text escaped for a page.
#[must_use]
pub(crate) fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}

/// A table; the first row is its head. Cells that start with a digit or a sign are right-aligned.
#[must_use]
pub fn table(rows: &[Vec<String>]) -> String {
    let mut out = String::from("<table>");
    for (index, row) in rows.iter().enumerate() {
        out.push_str("<tr>");
        for (column, cell) in row.iter().enumerate() {
            let class = match cell.as_str() {
                "pass" => " class=\"pass\"",
                "fail" => " class=\"fail\"",
                _ if column > 0 && cell.starts_with(|c: char| c.is_ascii_digit() || c == '-') => {
                    " class=\"n\""
                }
                _ => "",
            };
            let tag = if index == 0 { "th" } else { "td" };
            let _ = write!(out, "<{tag}{class}>{}</{tag}>", escape(cell));
        }
        out.push_str("</tr>");
    }
    out + "</table>"
}

/// The machine, in words.
fn machine(run: &RecordedRun) -> String {
    match &run.scenario.machine {
        Machine::Simulated {
            seed,
            mismatch,
            firmware,
        } => {
            let how = if *mismatch == crate::machine::Mismatch::default() {
                "exactly as described"
            } else {
                "with mismatch and pulley loss"
            };
            let core = match firmware {
                Some(_) => ", the firmware's own file on an emulated chip",
                None => "",
            };
            format!("simulation {how}, seed {seed}{core}")
        }
        Machine::InTheLoop { seed, wires, .. } => {
            format!("simulation with the board on {wires} in the loop, seed {seed}")
        }
        Machine::Port { name } => format!("board on {name}"),
    }
}

fn mm(value: f64) -> String {
    format!("{:.3}", value * 1e3)
}

/// Figures as rows: name and one cell per run.
fn figure_rows(runs: &[&Judgement]) -> Vec<Vec<String>> {
    let row = |name: &str, cell: &dyn Fn(&Judgement) -> String| {
        std::iter::once(name.to_owned())
            .chain(runs.iter().map(|run| cell(run)))
            .collect::<Vec<_>>()
    };
    let mean_max = |value: Option<MeanMax>| {
        value.map_or("not measured".to_owned(), |v| {
            format!("{} / {}", mm(v.mean), mm(v.max))
        })
    };
    let mean_sd_max = |value: Option<MeanSdMax>| {
        value.map_or("no motion".to_owned(), |v| {
            format!("{} / {} / {}", mm(v.mean), mm(v.sd), mm(v.max))
        })
    };
    let mut rows = vec![
        row("duration, s", &|j| format!("{:.2}", j.duration_s)),
        row("path error of the tool, mean / max, mm", &|j| {
            mean_max(j.path_error_m)
        }),
        row("cable length error, mean / sd / max, mm", &|j| {
            mean_sd_max(j.cable_length_error_m)
        }),
        row("held tension's error, mean / max, N", &|j| {
            j.tension_error_n.map_or("no motion".to_owned(), |e| {
                format!("{:.3} / {:.3}", e.mean_abs, e.max_abs)
            })
        }),
    ];
    let cables = runs.iter().map(|run| run.cables.len()).max().unwrap_or(0);
    for index in 0..cables {
        rows.push(row(
            &format!("cable {}: length error, mean / sd / max, mm", index + 1),
            &|j| mean_sd_max(j.cables.get(index).map(|c| c.length_error_m)),
        ));
        rows.push(row(
            &format!("cable {}: tension, least to greatest, N", index + 1),
            &|j| {
                j.cables.get(index).map_or("no motion".to_owned(), |c| {
                    format!("{:.2} to {:.2}", c.tension_min_n, c.tension_max_n)
                })
            },
        ));
    }
    rows.push(row("faults", &|j| {
        let faults = j
            .changes
            .iter()
            .filter(|change| change.text.starts_with("fault"));
        format!("{}", faults.count())
    }));
    rows
}

/// The report of one run.
#[must_use]
pub fn report(
    run: &RecordedRun,
    robot: &Robot,
    judgement: &Judgement,
    tube: Option<&str>,
) -> String {
    let about = format!(
        "{} - {} - recorded by mcdpr {} (protocol {}), {:.1} s",
        robot.name,
        machine(run),
        run.scenario.program,
        run.scenario.protocol,
        judgement.duration_s,
    );
    let name = &run.scenario.task.name;
    let mut body = format!(
        "<h1>{}</h1><p class=\"about\">{}</p><h2>Verdicts</h2>",
        escape(name),
        escape(&about)
    );
    let verdicts = judgement.verdicts.iter().map(|verdict| {
        let word = if verdict.pass { "pass" } else { "fail" };
        vec![
            verdict.what.clone(),
            word.to_owned(),
            verdict.numbers.clone(),
        ]
    });
    let head = ["check", "", "numbers"].map(str::to_owned).to_vec();
    body += &table(&std::iter::once(head).chain(verdicts).collect::<Vec<_>>());
    body += "<h2>Figures</h2>";
    let title = if matches!(run.scenario.machine, Machine::Port { .. }) {
        "hardware"
    } else {
        "simulation"
    };
    let mut rows = vec![vec!["figure".to_owned(), title.to_owned()]];
    rows.extend(figure_rows(&[judgement]));
    body += &table(&rows);
    if let Some(tube) = tube {
        let _ = write!(body, "<p class=\"about\">{}</p>", escape(tube));
    }
    body += "<h2>Plots</h2><p class=\"about\">Dashed: planned. Dotted lines: changes of state; red \
             lines: faults (point at them for words).</p><div class=\"plots\">";
    for chart in charts(run, robot, judgement) {
        body += &chart.svg();
    }
    body += "</div><h2>What happened</h2>";
    let mut rows = vec![vec!["time, s".to_owned(), "what".to_owned()]];
    let lines = run
        .log
        .iter()
        .map(|line| vec![format!("{:.3}", line.time_s), line.text.clone()]);
    rows.extend(lines);
    body += &table(&rows);
    page(&format!("{name} on {}", robot.name), &body)
}

/// Time of a tick on the record's axis, s: the link's clock starts about when the board's does.
fn time_of(tick: &Tick, first: u32) -> f64 {
    // Ticks last 1 ms; their count of 32 bits wraps after 49.7 days.
    f64::from(tick.tick.wrapping_sub(first)) * 1e-3
}

/// The plots of a run, each as a figure of its own with a name for its file.
pub(crate) fn figures(
    run: &RecordedRun,
    robot: &Robot,
    judgement: &Judgement,
) -> Vec<(String, Figure)> {
    let name = &run.scenario.task.name;
    let charts = charts(run, robot, judgement);
    let figure = |(number, chart): (usize, Chart)| {
        let words: String = chart
            .title()
            .chars()
            .map(|c| {
                if c.is_ascii_alphanumeric() {
                    c.to_ascii_lowercase()
                } else {
                    ' '
                }
            })
            .collect();
        let words: Vec<_> = words.split_whitespace().take(5).collect();
        let stem = format!("{number:02}-{}", words.join("-"));
        (
            stem,
            Figure::new(format!("{name} on {}", robot.name), 1, [chart]),
        )
    };
    (1..).zip(charts).map(figure).collect()
}

fn charts(run: &RecordedRun, robot: &Robot, judgement: &Judgement) -> Vec<Chart> {
    let ticks = run.ticks();
    let first = ticks.first().map_or(0, |tick| tick.tick);
    let start_s = f64::from(first) * 1e-3;
    let marks: Vec<_> = judgement
        .changes
        .iter()
        .map(|change| (change.time_s - start_s, change.text.as_str()))
        .collect();
    let cables = robot.cables.len();
    let each = |value: &dyn Fn(&Tick, usize) -> Option<f64>| -> Vec<Curve> {
        (0..cables)
            .map(|index| {
                let points = ticks
                    .iter()
                    .map(|t| (time_of(t, first), value(t, index).unwrap_or(f64::NAN)));
                Curve::new(format!("{}", index + 1), index, points)
            })
            .collect()
    };
    let chart = |title: &str, unit: &str, curves: Vec<Curve>| {
        let plain = Chart::new(title, "time, s", unit).with(curves);
        marks.iter().fold(plain, |chart, (at_s, what)| {
            chart.mark(*at_s, *what, what.starts_with("fault"))
        })
    };
    let mut all = vec![
        chart(
            "Cable lengths (paid out)",
            "mm",
            each(&|t, i| Some(t.lengths_m.get(i)? * 1e3)),
        ),
        chart(
            "Cable length errors (measured minus commanded)",
            "mm",
            each(&|t, i| Some((t.lengths_m.get(i)? - t.planned.get(i)?.length_m) * 1e3)),
        ),
    ];
    let tensions = chart(
        "Cable tensions and their limits",
        "N",
        each(&|t, i| t.tensions_n.get(i).copied()),
    );
    all.push(tensions.band(robot.limits.tension_min_n, robot.limits.tension_max_n));
    for (index, _) in robot
        .cables
        .iter()
        .enumerate()
        .filter(|(_, cable)| cable.control == Control::Tension)
    {
        let points = ticks.iter().map(|t| {
            (
                time_of(t, first),
                t.tensions_n.get(index).copied().unwrap_or(f64::NAN),
            )
        });
        let curve = Curve::new("measured", index, points);
        let title = format!("Tension of cable {}, set-point and +-0.5 N", index + 1);
        let planned = ticks.iter().filter_map(|t| {
            let planned = t.planned.get(index)?;
            Some((time_of(t, first), planned.tension_n))
        });
        let planned: Vec<_> = planned.collect();
        let least = planned.iter().map(|p| p.1).fold(f64::INFINITY, f64::min);
        let most = planned
            .iter()
            .map(|p| p.1)
            .fold(f64::NEG_INFINITY, f64::max);
        let asked = Curve::new("set-point", index + 1, planned);
        let mut held = chart(&title, "N", vec![curve, asked]);
        // A band only about a constant set-point: one that a plan schedules has none.
        if least.is_finite() && most - least < 1e-6 {
            held = held.band(least - 0.5, most + 0.5);
        }
        all.push(held);
    }
    all.push(chart(
        "Motor currents",
        "A",
        each(&|t, i| t.currents_a.get(i).copied()),
    ));
    all.extend(pose_charts(run));
    all
}

/// Pose over path time, the path from above, and in a slanted projection.
fn pose_charts(run: &RecordedRun) -> Vec<Chart> {
    let Some(plan) = &run.plan else {
        return Vec::new();
    };
    let truth: Vec<_> = run.truth.iter().filter(|p| p.path_s > 0.0).collect();
    let mut charts = Vec::new();
    let errors = path_errors(run);
    if !errors.is_empty() {
        let curve = Curve::new("", 0, errors.iter().map(|(t, e)| (*t, e * 1e3)));
        let chart = Chart::new("Path error of the simulated tool", "path time, s", "mm");
        charts.push(chart.with([curve]));
    }
    let mut curves = Vec::new();
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        let actual = truth.iter().map(|p| (p.path_s, p.tool_m[axis] * 1e3));
        let planned = plan.points.iter().map(|p| (p.time_s, p.tool_m[axis] * 1e3));
        if !truth.is_empty() {
            curves.push(Curve::new(name, axis, actual));
        }
        let label = if truth.is_empty() { name } else { "" };
        curves.push(Curve::new(label, axis, planned).dashed());
    }
    charts.push(Chart::new("Tool position", "path time, s", "mm").with(curves));
    let tilt = |q: &[f64; 4]| {
        // The world's z of the platform's z axis: its arc cosine is the tilt, whatever the yaw.
        (1.0 - 2.0 * (q[0] * q[0] + q[1] * q[1]))
            .clamp(-1.0, 1.0)
            .acos()
    };
    let planned = plan
        .points
        .iter()
        .map(|p| (p.time_s, tilt(&p.rotation_xyzw).to_degrees()));
    let mut curves = vec![Curve::new("planned", 4, planned).dashed()];
    if !truth.is_empty() {
        let actual = truth
            .iter()
            .map(|p| (p.path_s, tilt(&p.rotation_xyzw).to_degrees()));
        curves.push(Curve::new("simulated", 0, actual));
    }
    charts.push(Chart::new("Tilt of the platform", "path time, s", "degrees").with(curves));
    let paths = |flat: &dyn Fn([f64; 3]) -> (f64, f64)| {
        let planned = plan.points.iter().map(|p| flat(p.tool_m));
        let mut curves = vec![Curve::new("planned", 4, planned).dashed()];
        if !truth.is_empty() {
            let actual = truth.iter().map(|p| flat(p.tool_m));
            curves.push(Curve::new("simulated tool", 0, actual));
        }
        curves
    };
    let above = paths(&|p| (p[0] * 1e3, p[1] * 1e3));
    let chart = Chart::new("Path from above", "x, mm", "y, mm");
    charts.push(chart.with(above).square());
    // Seen from the side and above: 30 degrees about z, then 25 degrees down.
    let (s, c) = 30_f64.to_radians().sin_cos();
    let (sp, cp) = 25_f64.to_radians().sin_cos();
    let slanted = paths(&|p| {
        let (across, deep) = (p[0] * c + p[1] * s, -p[0] * s + p[1] * c);
        (across * 1e3, (p[2] * cp + deep * sp) * 1e3)
    });
    let title = "Path in space, seen 30 degrees from the side and 25 from above";
    let chart = Chart::new(title, "across, mm", "up, mm");
    charts.push(chart.with(slanted).square());
    charts
}

/// Two runs beside each other.
#[must_use]
pub fn compare(runs: [(&RecordedRun, &Judgement); 2]) -> String {
    let names = runs.map(|(run, _)| {
        let folder = run.path.parent().and_then(|path| path.file_name());
        folder.map_or_else(
            || run.path.display().to_string(),
            |f| f.to_string_lossy().into_owned(),
        )
    });
    let rows = compare_rows(runs);
    let mut body = String::from("<h1>Two runs</h1>");
    let _ = write!(
        body,
        "<p class=\"about\">{}: {}<br>{}: {}</p>",
        escape(&names[0]),
        escape(&machine(runs[0].0)),
        escape(&names[1]),
        escape(&machine(runs[1].0)),
    );
    body += "<h2>Figures</h2>";
    body += &table(&rows);
    body += "<h2>Plots</h2><p class=\"about\">Solid: the first run. Dashed: the second. Over path \
             time.</p><div class=\"plots\">";
    let mut errors = Vec::new();
    let ticks = runs.map(|(run, _)| run.ticks());
    for (number, (run, _)) in runs.iter().enumerate() {
        let points = path_errors(run).into_iter().map(|(t, e)| (t, e * 1e3));
        let curve = Curve::new(names[number].clone(), number, points);
        errors.push(if number == 0 { curve } else { curve.dashed() });
    }
    let chart = |title: &str, unit: &str, curves: Vec<Curve>| {
        Chart::new(title, "path time, s", unit).with(curves)
    };
    body += &chart("Path error of the simulated tool", "mm", errors).svg();
    let count = runs[0].1.cables.len().max(runs[1].1.cables.len());
    for index in 0..count {
        let both = |value: &dyn Fn(&Tick) -> Option<f64>| {
            let curves = ticks.iter().enumerate().map(|(number, ticks)| {
                let points = moving(ticks)
                    .into_iter()
                    .filter_map(|t| Some((t.path_s?, value(t)?)));
                let curve = Curve::new(names[number].clone(), number, points);
                if number == 0 { curve } else { curve.dashed() }
            });
            curves.collect::<Vec<_>>()
        };
        body += &chart(
            &format!("Length error of cable {}", index + 1),
            "mm",
            both(&|t| Some((t.lengths_m.get(index)? - t.planned.get(index)?.length_m) * 1e3)),
        )
        .svg();
        body += &chart(
            &format!("Tension of cable {}", index + 1),
            "N",
            both(&|t| t.tensions_n.get(index).copied()),
        )
        .svg();
    }
    body += "</div>";
    page("Two runs", &body)
}

/// The figures of two runs as rows, the head first.
#[must_use]
pub(crate) fn compare_rows(runs: [(&RecordedRun, &Judgement); 2]) -> Vec<Vec<String>> {
    let name = |run: &RecordedRun| {
        let folder = run.path.parent().unwrap_or(&run.path);
        folder.display().to_string()
    };
    let mut rows = vec![vec![String::new(), name(runs[0].0), name(runs[1].0)]];
    rows.extend(figure_rows(&[runs[0].1, runs[1].1]));
    rows
}
