//! Following the circle and the line: Tables 7 and 8, Figures 19 to 22 and 28 to 30.

use super::{Bench, Origin, Outcome, ReproduceError, Row, none, paper_robot};
use crate::calibration::study::median;
use crate::chart::{Chart, Curve};
use crate::experiment::{Experiment, Run, SimulatedRobot};
use crate::machine::{Controller, Firmware, Mismatch};
use crate::motion::{Model, PlanOptions, StaticState, Task, Tensioning};
use crate::report::{Figures, true_path, true_pose};
use crate::run::Measured;
use mcdpr_kinematics::Pose;
use mcdpr_protocol::SessionId;
use mcdpr_simulator::Simulation;
use rayon::prelude::*;

/// Height of a level platform's origin, m: the paper's 24 mm is out of the sensors' range.
const HEIGHT_M: f64 = -0.1;

/// Path time (s), position (m) and attitude (rad) of the true platform.
type TruePose = (f64, [f64; 3], [f64; 3]);

/// Result of one run.
pub(super) struct Ran {
    pub(super) run: Run,
    pub(super) figures: Figures,
    /// Absolute length error of each cable: mean and greatest, m.
    by_cable_m: Vec<(f64, f64)>,
    /// True path of the platform.
    poses: Vec<TruePose>,
}

/// A task at the height of the report, or one from a text.
pub(super) fn task(model: &Model, name: &str, text: Option<&str>) -> Result<Task, ReproduceError> {
    let height_m = HEIGHT_M + model.robot().tool.tcp_in_platform_m.z;
    let found = match text {
        Some(text) => Task::parse(text, name.into()),
        None => crate::motion::find_task(name, height_m),
    };
    found.map_err(|error| ReproduceError::Service(error.to_string()))
}

pub(super) fn run(
    model: &Model,
    task: Task,
    mismatch: &Mismatch,
    seed: u64,
    firmware: Option<&Firmware>,
) -> Result<Ran, ReproduceError> {
    let link = SimulatedRobot::new(*mismatch, seed)
        .controller(&Controller::of(firmware))
        .at_home(model)?;
    link.with(Simulation::record_truth);
    let mut run = Experiment::new(model, task)
        .at_home()
        .session(SessionId(1))
        .run_on(link.clone())?;
    let trace = link.with(Simulation::take_trace);
    let path = true_path(&trace);
    // Only the motion's own points: those before it belong to the move to its start.
    let moving: Vec<_> = trace.iter().filter(|point| point.path_ms > 0).collect();
    let moving = moving.get(moving.len().saturating_sub(path.len())..);
    let poses = moving.unwrap_or_default().iter().map(|point| {
        let pose = true_pose(&point.truth);
        (
            f64::from(point.path_ms) * 1e-3,
            pose.position_m.into(),
            pose.rpy(),
        )
    });
    let poses = poses.collect();
    run.true_path = Some(path);
    let figures = run.figures(model)?;
    let by_cable_m = by_cable_m(&run, model.robot().cables.len());
    Ok(Ran {
        run,
        figures,
        by_cable_m,
        poses,
    })
}

fn by_cable_m(run: &Run, cables: usize) -> Vec<(f64, f64)> {
    let mut all = vec![(0.0, 0.0_f64); cables];
    let mut count = 0.0;
    for sample in &run.samples {
        let Some(state) = sample.path_s.and_then(|time_s| run.plan.state(time_s)) else {
            continue;
        };
        count += 1.0;
        let pairs = sample.lengths_m.iter().zip(&state.paid_out_m);
        for (slot, (measured, planned)) in all.iter_mut().zip(pairs) {
            let error = (measured - planned).abs();
            slot.0 += error;
            slot.1 = slot.1.max(error);
        }
    }
    for slot in &mut all {
        slot.0 /= f64::max(count, 1.0);
    }
    all
}

/// The emulated chip's run, or why it failed; `None` without a firmware file.
pub(super) type Chip = Option<Result<Ran, String>>;

/// A task's runs under all conditions.
pub(super) struct Conditions {
    pub(super) as_described: Ran,
    pub(super) realistic: Vec<Ran>,
    pub(super) chip: Chip,
}

/// Runs a task under all conditions, on all processors.
pub(super) fn conditions(
    bench: &Bench,
    model: &Model,
    task: &Task,
) -> Result<Conditions, ReproduceError> {
    let real = Mismatch::realistic();
    let go = |mismatch: &Mismatch, seed: u64, firmware: Option<&Firmware>| {
        run(model, task.clone(), mismatch, seed, firmware)
    };
    let ((as_described, chip), realistic) = rayon::join(
        || {
            let as_described = go(&Mismatch::default(), bench.seed, None);
            // A failure of the chip's firmware is a result, and must not lose the others.
            let chip = bench.firmware.as_ref().map(|firmware| {
                let outcome = go(&real, bench.seed, Some(firmware));
                outcome.map_err(|error| format!("failed: {error}"))
            });
            (as_described, chip)
        },
        || -> Result<Vec<_>, _> {
            let seeds = bench.seed..bench.seed + bench.seeds;
            seeds
                .into_par_iter()
                .map(|seed| go(&real, seed, None))
                .collect()
        },
    );
    Ok(Conditions {
        as_described: as_described?,
        realistic: realistic?,
        chip,
    })
}

/// One row: a list of figures, joined by slashes, in every column.
pub(super) fn row(
    quantity: &str,
    paper: &str,
    all: &Conditions,
    of: &dyn Fn(&Ran) -> Vec<f64>,
) -> Row {
    let text = |values: &[f64]| {
        let cells: Vec<_> = values.iter().map(|v| format!("{v:.3}")).collect();
        cells.join(" / ")
    };
    let real: Vec<_> = all.realistic.iter().map(of).collect();
    let columns = real.first().map_or(0, Vec::len);
    let medians: Vec<_> = (0..columns)
        .map(|c| median(real.iter().filter_map(|v| v.get(c).copied()).collect()))
        .collect();
    Row {
        quantity: quantity.to_owned(),
        paper: paper.to_owned(),
        origin: Origin::Hardware,
        as_described: text(&of(&all.as_described)),
        realistic: text(&medians),
        chip: match &all.chip {
            None => none(),
            Some(Ok(ran)) => text(&of(ran)),
            Some(Err(reason)) => reason.clone(),
        },
    }
}

pub(super) fn length_error(ran: &Ran) -> Vec<f64> {
    let e = ran.figures.cable_length_error_m;
    vec![e.mean * 1e3, e.sd * 1e3, e.max * 1e3]
}

/// Of the cables that are held by their length: mean of each, or the greatest of each, mm.
fn length_errors(ran: &Ran, greatest: bool) -> Vec<f64> {
    // The paper's robot holds cables 1 to 3 by their lengths.
    let held = ran.by_cable_m.iter().take(3);
    held.map(|(mean, max)| if greatest { max } else { mean } * 1e3)
        .collect()
}

pub(super) fn path_error(ran: &Ran) -> Vec<f64> {
    let error = ran.figures.path_error_m;
    error.map_or_else(Vec::new, |e| vec![e.mean * 1e3, e.max * 1e3])
}

pub(super) fn tension_error(ran: &Ran) -> Vec<f64> {
    let e = ran.figures.tension_error_n;
    vec![e.mean_abs, e.max_abs]
}

/// Measured and planned values of a cable (from 0).
type OfCable<'a> = dyn Fn(&Measured, &StaticState, usize) -> [Option<f64>; 2] + 'a;

/// Curves over path time, one per cable; `of` returns measured and planned values of a cable.
fn by_time(ran: &Ran, cables: &[usize], of: &OfCable<'_>) -> Vec<Curve> {
    let mut curves = Vec::new();
    for &cable in cables {
        let (mut measured, mut planned) = (Vec::new(), Vec::new());
        for sample in &ran.run.samples {
            let Some(path_s) = sample.path_s else {
                continue;
            };
            let Some(state) = ran.run.plan.state(path_s) else {
                continue;
            };
            let [is, shall] = of(sample, &state, cable);
            measured.extend(is.map(|value| (path_s, value)));
            planned.extend(shall.map(|value| (path_s, value)));
        }
        if !planned.is_empty() {
            let name = if curves.is_empty() { "planned" } else { "" };
            curves.push(Curve::new(name, 4, planned).dashed());
        }
        curves.push(Curve::new(format!("{}", cable + 1), cable, measured));
    }
    curves
}

fn over_time(title: String, unit: &str, curves: Vec<Curve>) -> Chart {
    Chart::new(title, "path time, s", unit).with(curves)
}

/// Lengths and their errors.
pub(super) fn length_charts(ran: &Ran, cables: usize, figure: &str) -> [Chart; 2] {
    let all: Vec<_> = (0..cables).collect();
    let lengths = by_time(ran, &all, &|sample, state, i| {
        let is = sample.lengths_m.get(i).map(|l| l * 1e3);
        [is, state.paid_out_m.get(i).map(|l| l * 1e3)]
    });
    let errors = by_time(ran, &all, &|sample, state, i| {
        let pair = sample.lengths_m.get(i).zip(state.paid_out_m.get(i));
        [pair.map(|(is, shall)| (is - shall) * 1e3), None]
    });
    [
        over_time(format!("{figure}: cable lengths"), "mm", lengths),
        over_time(format!("{figure}: cable length errors"), "mm", errors),
    ]
}

/// Tensions of these cables (from 0).
pub(super) fn tension_chart(ran: &Ran, cables: &[usize], title: &str) -> Chart {
    let curves = by_time(ran, cables, &|sample, state, i| {
        let is = sample.tensions_n.get(i).copied();
        [is, state.tensions_n().get(i).copied()]
    });
    over_time(title.to_owned(), "N", curves)
}

/// Place and attitude of the platform, planned and true.
pub(super) fn pose_charts(ran: &Ran, figure: &str) -> [Chart; 2] {
    let planned = |time_s: f64| Some(ran.run.plan.state(time_s)?.equilibrium.pose);
    let axes = |names: [&str; 3],
                shall: &dyn Fn(&Pose, usize) -> f64,
                is: &dyn Fn(&TruePose, usize) -> f64| {
        let mut curves = Vec::new();
        for (axis, name) in names.iter().enumerate() {
            let plan = ran.poses.iter().filter_map(|point| {
                let pose = planned(point.0)?;
                Some((point.0, shall(&pose, axis)))
            });
            let label = if axis == 0 { "planned" } else { "" };
            curves.push(Curve::new(label, 4, plan).dashed());
            let truth = ran.poses.iter().map(|point| (point.0, is(point, axis)));
            curves.push(Curve::new(*name, axis, truth));
        }
        curves
    };
    let place = axes(
        ["x", "y", "z"],
        &|pose, axis| pose.position_m[axis] * 1e3,
        &|point, axis| point.1[axis] * 1e3,
    );
    let turn = axes(
        ["rx", "ry", "rz"],
        &|pose, axis| pose.rpy()[axis].to_degrees(),
        &|point, axis| point.2[axis].to_degrees(),
    );
    [
        over_time(format!("{figure}: place of the platform"), "mm", place),
        over_time(
            format!("{figure}: attitude of the platform"),
            "degrees",
            turn,
        ),
    ]
}

/// The tool's path, projected on two axes of the world.
pub(super) fn path_chart(ran: &Ran, title: &str, [across, up]: [usize; 2]) -> Chart {
    let names = ["x, mm", "y, mm", "z, mm"];
    let truth = ran.run.true_path.as_deref().unwrap_or_default();
    let wanted = truth.iter().filter_map(|point| {
        let at = ran.run.plan.timed.tool_m(point.path_s).ok()?;
        Some((at[across] * 1e3, at[up] * 1e3))
    });
    let actual = truth
        .iter()
        .map(|point| (point.tool_m[across] * 1e3, point.tool_m[up] * 1e3));
    Chart::new(title, names[across], names[up])
        .with([
            Curve::new("planned", 4, wanted).dashed(),
            Curve::new("simulated tool", 0, actual),
        ])
        .square()
}

/// The paper's robot with its constant 10 N in cable 4.
fn holding_10_n() -> Result<Model, ReproduceError> {
    let options = PlanOptions {
        tensioning: Tensioning::Setpoint,
        ..PlanOptions::default()
    };
    Ok(Model::new(&paper_robot()?)?.with_options(options))
}

/// The circle.
pub(super) fn circle(bench: &Bench) -> Result<Outcome, ReproduceError> {
    let model = holding_10_n()?;
    let all = conditions(bench, &model, &task(&model, "paper:table7", None)?)?;
    let ran = &all.as_described;
    let cables = model.robot().cables.len();
    let held: Vec<_> = (0..cables).collect();
    let mut charts = length_charts(ran, cables, "Figure 19").to_vec();
    charts.push(tension_chart(ran, &held, "Figure 20: cable tensions"));
    charts.extend(pose_charts(ran, "Figure 21"));
    charts.push(path_chart(ran, "Figure 22: the path from above", [0, 1]));
    Ok(Outcome {
        id: "circle",
        title: "The circle (Table 7, Figures 19 to 22)",
        rows: vec![
            row(
                "path error of the tool, mean / max, mm",
                "3.425 / 7.044",
                &all,
                &path_error,
            ),
            row(
                "cable length error, mean / sd / max, mm",
                "1.240 / 1.062 / 4.105",
                &all,
                &length_error,
            ),
            row(
                "cable-4 tension error, mean / max, N",
                "0.291 / -",
                &all,
                &tension_error,
            ),
        ],
        notes: vec![
            "A straight approach of 67 mm, then the circle of 65 mm: Table 7's start is not on \
             it. Platform at z = -100 mm; the planner places the tool where the platform really \
             hangs, tilted; cable 4 is held at 10 N. \
             The circle takes 10 s: the paper gives no time, and its own gear allows no less. \
             Lengths are those that the drums' encoders tell, as on the prototype; the path error \
             is the true tool's. Medians over the seeds; plots of the run as described."
                .to_owned(),
        ],
        charts,
        pictures: Vec::new(),
    })
}

/// The line.
pub(super) fn line(bench: &Bench) -> Result<Outcome, ReproduceError> {
    let model = holding_10_n()?;
    let all = conditions(bench, &model, &task(&model, "paper:table8", None)?)?;
    let ran = &all.as_described;
    let cables = model.robot().cables.len();
    let mut charts = vec![path_chart(ran, "Figure 28: the path from above", [0, 1])];
    charts.extend(length_charts(ran, cables, "Figure 29"));
    let held = model.holding().by_tension();
    charts.push(tension_chart(ran, held, "Figure 30: tension of cable 4"));
    Ok(Outcome {
        id: "line",
        title: "The line (Table 8, Figures 28 to 30)",
        rows: vec![
            row(
                "cable length error, mean / sd / max, mm",
                "1.13 / 0.82 / -",
                &all,
                &length_error,
            ),
            row(
                "mean cable length error of cables 1 / 2 / 3, mm",
                "1.4 / 1.6 / 0.4",
                &all,
                &|ran| length_errors(ran, false),
            ),
            row(
                "greatest cable length error of cables 1 / 2 / 3, mm",
                "2.9 / 3.1 / 1.0",
                &all,
                &|ran| length_errors(ran, true),
            ),
            row(
                "path error of the tool, mean / max, mm",
                "- / -",
                &all,
                &path_error,
            ),
            row(
                "cable-4 tension error, mean / max, N",
                "- / -",
                &all,
                &tension_error,
            ),
        ],
        notes: vec![
            "500 mm from (500, 200) to (200, -200) mm, platform at z = -100 mm, as fast as the \
             limits allow, cable 4 held at 10 N. Table 8 prints three average and three greatest errors without saying \
             of what; read here as the three cables that are held by their lengths. Medians over \
             the seeds; plots of the run as described."
                .to_owned(),
        ],
        charts,
        pictures: Vec::new(),
    })
}
