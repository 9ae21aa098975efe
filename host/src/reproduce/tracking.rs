//! Following the circle and the line: Tables 7 and 8, Figures 19 to 22 and 28 to 30.

use super::{Bench, Origin, Outcome, ReproduceError, Row, none, paper_robot};
use crate::calibration::study::median;
use crate::experiment::{self, Run};
use crate::machine::{Firmware, Mismatch};
use crate::motion::{Model, Task};
use crate::report::chart::{Chart, Curve};
use crate::report::{Figures, true_path};
use mcdpr_protocol::SessionId;
use mcdpr_simulator::{LinkOptions, Simulation};
use rayon::prelude::*;

/// Height of a level platform's origin, m: the paper's 24 mm is out of the sensors' range.
const HEIGHT_M: f64 = -0.1;

fn run(
    model: &Model,
    name: &str,
    mismatch: &Mismatch,
    seed: u64,
    firmware: Option<&Firmware>,
) -> Result<(Run, Figures), ReproduceError> {
    let height_m = HEIGHT_M + model.robot().tool.tcp_in_platform_m.z;
    let task = Task::find(name, height_m).map_err(|error| {
        crate::run::RunError::from(
            // The built-in tasks exist; a path error is the only one that can be left.
            match error {
                crate::motion::TaskError::Path(error) => crate::motion::PlanError::from(error),
                _ => crate::motion::PlanError::from(crate::motion::path::PathError::Empty),
            },
        )
    })?;
    let options = LinkOptions::default();
    let link = experiment::simulated_robot_on(model, mismatch, seed, &options, firmware)?;
    link.with(Simulation::record_truth);
    let mut run = experiment::on_link_at_home(model, task, link.clone(), Some(SessionId(1)))?;
    run.true_path = Some(true_path(&link.with(Simulation::take_trace)));
    let figures = run.figures(model)?;
    Ok((run, figures))
}

/// The emulated chip's figures, or why there are none; `None` without a firmware file.
type Chip = Option<Result<Figures, String>>;

/// Runs a task under all conditions.
fn conditions(
    bench: &Bench,
    model: &Model,
    name: &str,
) -> Result<(Run, Figures, Vec<Figures>, Chip), ReproduceError> {
    let (ideal, as_described) = run(model, name, &Mismatch::default(), bench.seed, None)?;
    let realistic: Result<Vec<_>, _> = (0..bench.seeds)
        .into_par_iter()
        .map(|number| {
            let seed = bench.seed + number;
            run(model, name, &Mismatch::realistic(), seed, None).map(|(_, figures)| figures)
        })
        .collect();
    // What the chip's firmware does not do is a result, and no reason to lose the others.
    let chip = bench.firmware.as_ref().map(|firmware| {
        let mismatch = Mismatch::realistic();
        let outcome = run(model, name, &mismatch, bench.seed, Some(firmware));
        outcome
            .map(|(_, figures)| figures)
            .map_err(|error| format!("failed: {error}"))
    });
    Ok((ideal, as_described, realistic?, chip))
}

/// One row: a list of figures, joined by slashes, in every column.
fn row(
    quantity: &str,
    paper: &str,
    (as_described, realistic, chip): (&Figures, &[Figures], &Chip),
    of: &dyn Fn(&Figures) -> Vec<f64>,
) -> Row {
    let text = |values: &[f64]| {
        let cells: Vec<_> = values.iter().map(|v| format!("{v:.3}")).collect();
        cells.join(" / ")
    };
    let all: Vec<_> = realistic.iter().map(of).collect();
    let columns = all.first().map_or(0, Vec::len);
    let medians: Vec<_> = (0..columns)
        .map(|c| median(all.iter().filter_map(|v| v.get(c).copied()).collect()))
        .collect();
    Row {
        quantity: quantity.to_owned(),
        paper: paper.to_owned(),
        origin: Origin::Hardware,
        as_described: text(&of(as_described)),
        realistic: text(&medians),
        chip: match chip {
            None => none(),
            Some(Ok(figures)) => text(&of(figures)),
            Some(Err(reason)) => reason.clone(),
        },
    }
}

fn length_error(figures: &Figures) -> Vec<f64> {
    let e = figures.cable_length_error_m;
    vec![e.mean * 1e3, e.sd * 1e3, e.max * 1e3]
}

fn path_error(figures: &Figures) -> Vec<f64> {
    figures
        .path_error_m
        .map_or_else(Vec::new, |e| vec![e.mean * 1e3, e.max * 1e3])
}

fn tension_error(figures: &Figures) -> Vec<f64> {
    let e = figures.tension_error_n;
    vec![e.mean_abs, e.max_abs]
}

/// Lengths, their errors, tensions and the path of a run.
fn charts(model: &Model, run: &Run, figures: [&str; 4]) -> Vec<Chart> {
    let cables = model.robot().cables.len();
    let moving: Vec<_> = run
        .samples
        .iter()
        .filter_map(|sample| Some((sample.path_s?, sample)))
        .collect();
    let each = |value: &dyn Fn(f64, &crate::run::Measured, usize) -> Option<f64>| -> Vec<Curve> {
        (0..cables)
            .map(|cable| {
                let points = moving
                    .iter()
                    .filter_map(|(t, s)| Some((*t, value(*t, s, cable)?)));
                Curve::new(format!("{}", cable + 1), cable, points.collect())
            })
            .collect()
    };
    let chart = |title: &str, unit: &str, curves: Vec<Curve>| Chart {
        title: title.to_owned(),
        axes: ("path time, s".to_owned(), unit.to_owned()),
        curves,
        ..Chart::default()
    };
    let planned = |time_s: f64, cable: usize| {
        let state = run.plan.state(time_s)?;
        state.paid_out_m.get(cable).copied()
    };
    let [lengths, errors, tensions, path] = figures;
    let mut all = vec![
        chart(
            &format!("{lengths}: cable lengths"),
            "mm",
            each(&|_, s, i| Some(s.lengths_m.get(i)? * 1e3)),
        ),
        chart(
            &format!("{errors}: cable length errors"),
            "mm",
            each(&|t, s, i| Some((s.lengths_m.get(i)? - planned(t, i)?) * 1e3)),
        ),
        chart(
            &format!("{tensions}: tensions"),
            "N",
            each(&|_, s, i| s.tensions_n.get(i).copied()),
        ),
    ];
    let truth = run.true_path.as_deref().unwrap_or_default();
    let wanted = truth.iter().filter_map(|(time_s, _)| {
        let at = run.plan.timed.tool_m(*time_s).ok()?;
        Some((at.x * 1e3, at.y * 1e3))
    });
    let actual = truth.iter().map(|(_, at)| (at[0] * 1e3, at[1] * 1e3));
    all.push(Chart {
        title: format!("{path}: the path from above"),
        axes: ("x, mm".to_owned(), "y, mm".to_owned()),
        curves: vec![
            Curve::new("planned", 4, wanted.collect()).dashed(),
            Curve::new("simulated tool", 0, actual.collect()),
        ],
        square: true,
        ..Chart::default()
    });
    all
}

/// The circle.
pub(super) fn circle(bench: &Bench) -> Result<Outcome, ReproduceError> {
    let model = Model::new(&paper_robot()?)?;
    let (ideal, as_described, realistic, chip) = conditions(bench, &model, "paper:table7")?;
    let all = (&as_described, realistic.as_slice(), &chip);
    Ok(Outcome {
        id: "circle",
        title: "The circle (Table 7, Figures 19 to 22)",
        rows: vec![
            row(
                "path error of the tool, mean / max, mm",
                "3.425 / 7.044",
                all,
                &path_error,
            ),
            row(
                "cable length error, mean / sd / max, mm",
                "1.240 / 1.062 / 4.105",
                all,
                &length_error,
            ),
            row(
                "cable-4 tension error, mean / max, N",
                "0.291 / -",
                all,
                &tension_error,
            ),
        ],
        notes: vec![
            "A straight approach of 67 mm, then the circle of 65 mm: Table 7's start is not on \
             it. Platform at z = -100 mm; the planner places the tool where the platform really \
             hangs, tilted. Medians over the seeds."
                .to_owned(),
        ],
        charts: charts(
            &model,
            &ideal,
            ["Figure 19", "Figure 19", "Figure 20", "Figures 21, 22"],
        ),
    })
}

/// The line.
pub(super) fn line(bench: &Bench) -> Result<Outcome, ReproduceError> {
    let model = Model::new(&paper_robot()?)?;
    let (ideal, as_described, realistic, chip) = conditions(bench, &model, "paper:table8")?;
    let all = (&as_described, realistic.as_slice(), &chip);
    Ok(Outcome {
        id: "line",
        title: "The line (Table 8, Figures 28 to 30)",
        rows: vec![
            row(
                "cable length error, mean / sd / max, mm",
                "1.13 / 0.82 / -",
                all,
                &length_error,
            ),
            row(
                "path error of the tool, mean / max, mm",
                "- / -",
                all,
                &path_error,
            ),
            row(
                "cable-4 tension error, mean / max, N",
                "- / -",
                all,
                &tension_error,
            ),
        ],
        notes: vec![
            "500 mm from (500, 200) to (200, -200) mm, platform at z = -100 mm. Table 8 also \
             prints mean errors of (1.4, 1.6, 0.4) mm and greatest ones of (2.9, 3.1, 1.0) mm \
             without saying of what. Medians over the seeds."
                .to_owned(),
        ],
        charts: charts(
            &model,
            &ideal,
            ["Figure 29", "Figure 29", "Figure 30", "Figure 28"],
        ),
    })
}
