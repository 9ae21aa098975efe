//! Robots of every kind on a path that fits them.
//!
//! Every machine differs from its description, drawn by seed; the planner knows the description only.
//! The encoders know the true lengths, and no camera is used: absolute accuracy.

use super::motion::true_lengths_m;
use crate::control::Handle;
use crate::experiment::SimulatedRobot;
use crate::machine::Mismatch;
use crate::motion::{Model, Task};
use crate::report;
use crate::run::{Homing, NoStore, Recorder, RunError, Session};
use mcdpr_protocol::SessionId;
use mcdpr_simulator::Simulation;
use rayon::prelude::*;
use serde::Serialize;

/// The shipped robots of other kinds than the paper's.
pub(crate) const KINDS: [&str; 6] = [
    "eight-cable",
    "eight-suspended",
    "six-cable",
    "three-point",
    "planar-four",
    "planar-vertical",
];

/// Result of one seed, SI.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(crate) struct Outcome {
    /// Distance of the tool from its planned position, mean along the motion, m.
    pub path_mean_m: f64,
    /// The same, greatest, m.
    pub path_max_m: f64,
    /// Angle to the planned attitude, mean, rad; `None` for a robot without attitude.
    pub attitude_mean_rad: Option<f64>,
    /// The same, greatest, rad.
    pub attitude_max_rad: Option<f64>,
    /// Least tension of any cable at the platform, N.
    pub tension_least_n: f64,
    /// Greatest tension, N.
    pub tension_greatest_n: f64,
}

/// Figures of one robot over seeds 1 to some number.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct Row {
    /// Robot file.
    pub robot: String,
    /// Whether the machine is as described.
    pub exact: bool,
    /// Completed runs, in the order of their seeds.
    pub runs: Vec<Outcome>,
    /// Why the first incomplete run failed.
    pub failed: Option<String>,
}

/// Runs the task on one machine.
fn run(model: &Model, task: &Task, mismatch: Mismatch, seed: u64) -> Result<Outcome, RunError> {
    let cables = model.robot().cables.len();
    let link = SimulatedRobot::new(mismatch, seed).at_home(model)?;
    let homing = Homing::Lengths(true_lengths_m(&link, cables)?);
    let handle = Handle::new();
    let line = link.clone();
    let mut session = Session::open(model, line, SessionId(1), &handle, homing, &NoStore)?;
    session.arm()?;
    let plan = session.plan(task.clone(), None)?;
    link.with(Simulation::record_truth);
    let mut recorder = Recorder::default();
    session.follow(&plan, &mut recorder, |_| {})?;
    let trace = link.with(Simulation::take_trace);
    session.disarm()?;
    let path = report::true_path(&trace);
    let turns = report::true_turns(&trace);
    let figures = report::measure(model, &plan, &recorder.samples, Some(&path))?.with_attitude(
        model,
        &plan,
        Some(&turns),
    );
    let tensions = trace
        .iter()
        .filter_map(|point| point.truth.tensions_platform_n.get(..cables))
        .flatten()
        .copied();
    let path = figures.path_error_m;
    Ok(Outcome {
        path_mean_m: path.map_or(f64::NAN, |e| e.mean),
        path_max_m: path.map_or(f64::NAN, |e| e.max),
        attitude_mean_rad: figures.attitude_error_rad.map(|e| e.mean),
        attitude_max_rad: figures.attitude_error_rad.map(|e| e.max),
        tension_least_n: tensions.clone().fold(f64::MAX, f64::min),
        tension_greatest_n: tensions.fold(0.0, f64::max),
    })
}

/// Runs one robot over seeds 1 to `seeds`: as described (one seed shows all), or realistic.
///
/// # Errors
/// Where no path fits it.
pub(crate) fn row(model: &Model, exact: bool, seeds: u64) -> Result<Row, RunError> {
    let task = crate::motion::find_task_for(model, crate::motion::FITTING, 0.0)?;
    let mismatch = if exact {
        Mismatch::default()
    } else {
        Mismatch::realistic()
    };
    let outcomes: Vec<_> = (1..=seeds)
        .into_par_iter()
        .map(|seed| run(model, &task, mismatch, seed))
        .collect();
    let mut row = Row {
        robot: model.robot().name.clone(),
        exact,
        runs: Vec::new(),
        failed: None,
    };
    for (seed, outcome) in (1..).zip(outcomes) {
        match outcome {
            Ok(outcome) => row.runs.push(outcome),
            Err(error) => {
                row.failed
                    .get_or_insert_with(|| format!("seed {seed}: {error}"));
            }
        }
    }
    Ok(row)
}
