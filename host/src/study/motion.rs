//! Accuracy of the tool's position, and its swing, in the simulator.
//!
//! Every case is run on machines that differ from their description, drawn by seed; the planner
//! knows the description only. Homed: one look (thirty pictures in a second, 0.1 px) at home and
//! one at the job (its middle, or just above its target) at the printed board of nine tags, or at a
//! single one, board and camera mounting known, re-reference the lengths. Absolute: the encoders
//! know the true lengths.

use crate::calibration::simulate::Target;
use crate::calibration::target;
use crate::control::Handle;
use crate::experiment::{SimulatedRobot, in_frame};
use crate::link::SimulatedLink;
use crate::machine::Mismatch;
use crate::motion::path::Path;
use crate::motion::{Model, PlanError, PlanOptions, Planner, Shaping, Step, Task};
use crate::report;
use crate::robot::Robot;
use crate::run::{Homing, Measured, NoStore, Recorder, RunError, Session};
use crate::sight::{Scene, SimulatedTags};
use mcdpr_kinematics::Pose;
use mcdpr_protocol::SessionId;
use mcdpr_simulator::{Simulation, TracePoint};
use nalgebra::Vector3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// Noise of a tag's corners, px.
const CORNER_PX: f64 = 0.1;
/// Time that the robot rests after a motion, s: several periods of the slowest mode.
const REST_S: f64 = 3.0;
/// Swing is evaluated from this long after a motion's end, s.
const AFTER_S: f64 = 0.5;

/// Motion of the tool.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Job {
    /// Circle of 65 mm at z = -100 mm in 8 s.
    Circle8s,
    /// Circle of 65 mm at z = -100 mm in 10 s.
    Circle10s,
    /// Line of 500 mm at z = -100 mm, at 100 mm/s.
    Line,
    /// Line of 500 mm at z = -100 mm, as fast as the drives can.
    LineAtLimit,
    /// At rest at the grasp point (252, -39, -517) mm.
    Grasp,
    /// At rest at the release point (335, 100, -510) mm.
    Release,
    /// 300 mm at 0.5 m/s at z = -100 mm.
    FastMove,
}

/// Source of the lengths.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Known {
    /// By looks at the printed board of nine tags, at home and at the job.
    Homed,
    /// By looks at a single tag, at home and at the job.
    HomedByOne,
    /// By encoders that know the true lengths.
    Absolute,
}

/// One case.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Case {
    /// Motion of the tool.
    pub job: Job,
    /// Robot file.
    pub robot: &'static str,
    /// Whether every error is drawn, or that of the anchors only.
    pub every_error: bool,
    /// How the lengths are known.
    pub known: Known,
    /// Tension lost at each pulley, as a share.
    pub pulley_loss: f64,
    /// Shaping of the motion.
    pub shaping: Shaping,
    /// Whether drums are without friction.
    pub frictionless: bool,
    /// The planner.
    pub planner: Planner,
}

/// Result of one case with one seed, SI.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Outcome {
    /// Distance of the tool from its planned position, mean along the motion, m.
    pub path_mean_m: f64,
    /// The same, greatest, m.
    pub path_max_m: f64,
    /// Reversal error of the worst length-held cable, m: how far the means of its error differ between paying
    /// out and reeling in (ISO 230-2's reversal value, on the measured lengths of a motion).
    #[serde(default)]
    pub reversal_m: f64,
    /// Distance of the tool's mean position from its target while it rests, m.
    pub rest_m: f64,
    /// Greatest distance from the mean position, from half a second after the motion, m.
    pub swing_m: f64,
    /// Measured minus planned tension of the tension-held cable, mean of the absolute, N.
    pub tension_n: f64,
    /// Least tension of any cable at the platform, N.
    pub least_tension_n: f64,
    /// Duration of the motion, s.
    pub duration_s: f64,
}

impl Job {
    /// Steps from the start of the job on, and where it starts (tool, world, m).
    fn steps(self, tool_offset_z_m: f64) -> Result<(Vector3<f64>, Vec<Step>), PlanError> {
        // -100 mm is the height of the platform's origin: the tool is below it by its offset.
        let z = -0.1 + tool_offset_z_m;
        let go = |path: Path, duration_s, speed_mps| {
            vec![Step::Move {
                path,
                duration_s,
                speed_mps,
            }]
        };
        let line = |speed| -> Result<_, PlanError> {
            let from = Vector3::new(0.5, 0.2, z);
            let to = Vector3::new(0.2, -0.2, z);
            Ok((from, go(Path::through(&[from, to])?, None, speed)))
        };
        let circle = |seconds| -> Result<_, PlanError> {
            let center = Vector3::new(0.335, 0.0, z);
            let start = center + Vector3::new(-0.065, 0.0, 0.0);
            let piece = crate::motion::path::Piece::arc(center, 0.065, start, TAU)?;
            Ok((start, go(Path::new(vec![piece])?, Some(seconds), None)))
        };
        match self {
            Self::Circle8s => circle(8.0),
            Self::Circle10s => circle(10.0),
            Self::Line => line(Some(0.1)),
            Self::LineAtLimit => line(None),
            Self::Grasp => Ok((Vector3::new(0.252, -0.039, -0.517), Vec::new())),
            Self::Release => Ok((Vector3::new(0.335, 0.1, -0.51), Vec::new())),
            Self::FastMove => {
                let from = Vector3::new(0.185, 0.0, z);
                let to = Vector3::new(0.485, 0.0, z);
                Ok((from, go(Path::through(&[from, to])?, None, None)))
            }
        }
    }
}

impl Job {
    /// Positions from which the robot looks at its tags before the job: in its middle, or above its
    /// target as far down as the tags stay in the picture (tool, world, m).
    fn look_m(self, known: Known, tool_offset_z_m: f64) -> Vector3<f64> {
        let z_m = -0.1 + tool_offset_z_m;
        match self {
            Self::Circle8s | Self::Circle10s | Self::FastMove => Vector3::new(0.335, 0.0, z_m),
            Self::Line | Self::LineAtLimit => Vector3::new(0.35, 0.0, z_m),
            // A single tag soon leaves the picture.
            Self::Grasp if known == Known::HomedByOne => Vector3::new(0.252, -0.039, -0.3),
            Self::Release if known == Known::HomedByOne => Vector3::new(0.31, 0.0, -0.3),
            Self::Grasp => Vector3::new(0.252, -0.039, -0.4),
            Self::Release => Vector3::new(0.335, 0.06, -0.45),
        }
    }
}

/// Runs a case with a seed.
///
/// # Errors
/// As a run on the simulator.
pub fn run(case: &Case, seed: u64) -> Result<Outcome, RunError> {
    let robot = crate::robot::find(case.robot).map_err(|_| RunError::NoTag)?;
    run_as(case, robot, None, seed)
}

/// A machine that is not built as its robot is described.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Machine<'a> {
    /// As which it was built.
    pub built: &'a Robot,
    /// Its errors beyond that.
    pub mismatch: Mismatch,
    /// The simulator's world frame in the frame that a calibration of it knows, if there was one: paths are
    /// compared in the latter.
    pub known_from_true: Option<Pose>,
    /// What the robot believes of its cables' lengths at home beyond the truth, by cable, m; empty for nothing.
    pub lengths_off_m: &'a [f64],
}

/// As [`run`], by this description of the robot; the machine is built as `machine` says, or as described.
///
/// # Errors
/// As [`run`].
pub(crate) fn run_as(
    case: &Case,
    mut robot: Robot,
    machine: Option<Machine<'_>>,
    seed: u64,
) -> Result<Outcome, RunError> {
    if case.job == Job::FastMove {
        // As measured beforehand: 0.5 m/s with 2 m/s^2.
        robot.limits.speed_mps = 0.5;
        robot.limits.acceleration_mps2 = 2.0;
        robot.limits.jerk_mps3 = 40.0;
    }
    if case.frictionless {
        for winch in &mut robot.winches {
            winch.friction_n = 0.0;
        }
    }
    if case.known == Known::Homed {
        robot.tags = target::tags(Target::Board);
    }
    let model = Model::new(&robot).map_err(RunError::Plan)?;
    let everything = Mismatch {
        pulley_loss: case.pulley_loss,
        ..Mismatch::realistic()
    };
    let mismatch = if case.every_error {
        everything
    } else {
        Mismatch {
            anchors_m: everything.anchors_m,
            pulley_loss: case.pulley_loss,
            ..Mismatch::default()
        }
    };
    let simulated = match machine {
        Some(of) => SimulatedRobot::new(of.mismatch, seed).machine(of.built),
        None => SimulatedRobot::new(mismatch, seed),
    };
    let link = simulated.at_home(&model)?;
    let planned = model.clone().with_options(PlanOptions {
        planner: case.planner,
        shaping: case.shaping,
        ..PlanOptions::default()
    });
    let scene = Scene::on_floor(&robot, 0.0, 0.0, seed);
    let places = scene.places.clone();
    let mut camera = SimulatedTags::new(link.clone(), scene, CORNER_PX, seed);
    let homing = match case.known {
        Known::Homed | Known::HomedByOne => Homing::Tags {
            camera: &mut camera,
            places: places.clone(),
        },
        Known::Absolute => {
            let mut lengths_m = true_lengths_m(&link, robot.cables.len())?;
            let off_m = machine.map_or(&[][..], |machine| machine.lengths_off_m);
            for (length_m, off_m) in lengths_m.iter_mut().zip(off_m) {
                *length_m += off_m;
            }
            Homing::Lengths(lengths_m)
        }
    };
    let handle = Handle::new();
    let mut session = Session::open(
        &planned,
        link.clone(),
        SessionId(1),
        &handle,
        homing,
        &NoStore,
    )?;
    session.arm()?;
    let speed_mps = Some(0.15_f64.min(robot.limits.speed_mps));
    if case.known != Known::Absolute {
        let there = case.job.look_m(case.known, robot.tool.tcp_in_platform_m.z);
        let way = session.plan(Task::go_to("look", there)?, speed_mps)?;
        session.follow(&way, &mut Recorder::default(), |_| {})?;
        rest(&mut session, 1.0)?;
        session.look(&mut camera, places)?;
    }
    let (start_m, steps) = case.job.steps(robot.tool.tcp_in_platform_m.z)?;
    let approach = session.plan(Task::go_to("approach", start_m)?, speed_mps)?;
    let mut recorder = Recorder::default();
    session.follow(&approach, &mut recorder, |_| {})?;
    rest(&mut session, 1.0)?;
    link.with(Simulation::record_truth);
    link.with(Simulation::take_trace);
    let mut recorder = Recorder::default();
    let (plan, path) = if steps.is_empty() {
        (approach, Vec::new())
    } else {
        let plan = crate::motion::Plan::new(&planned, &session.tool_m(), &steps)?;
        session.follow(&plan, &mut recorder, |_| {})?;
        let path = report::true_path(&link.with(Simulation::take_trace));
        let known_from_true = machine.and_then(|machine| machine.known_from_true);
        match known_from_true {
            Some(known_from_true) => (plan, in_frame(&known_from_true, path)),
            None => (plan, path),
        }
    };
    rest(&mut session, REST_S)?;
    let resting = link.with(Simulation::take_trace);
    session.disarm()?;
    let target_m = plan.timed.tool_m(plan.timed.duration_s())?;
    let figures = report::measure(&planned, &plan, &recorder.samples, Some(&path))?;
    let (rest_m, swing_m) = rested(&resting, &target_m);
    let cables = robot.cables.len();
    let tensions = resting
        .iter()
        .filter_map(|point| point.truth.tensions_platform_n.get(..cables));
    let least = tensions.flatten().copied().fold(f64::MAX, f64::min);
    Ok(Outcome {
        path_mean_m: figures.path_error_m.map_or(f64::NAN, |e| e.mean),
        path_max_m: figures.path_error_m.map_or(f64::NAN, |e| e.max),
        reversal_m: reversal_m(&planned, &plan, &recorder.samples),
        rest_m,
        swing_m,
        tension_n: figures.tension_error_n.mean_abs,
        least_tension_n: least,
        duration_s: plan.timed.duration_s(),
    })
}

/// See [`Outcome::reversal_m`]; 0 for a motion in which no cable reverses.
fn reversal_m(model: &Model, plan: &crate::motion::Plan, samples: &[Measured]) -> f64 {
    /// A cable below this speed is about to reverse: it counts for neither direction.
    const MOVING_MPS: f64 = 1e-3;
    /// Half of the time over which a planned speed is taken, s.
    const HALF_S: f64 = 5e-3;
    // Of each cable, sum and count of its errors while it pays out and while it is reeled in.
    let mut cables = vec![[(0.0, 0.0); 2]; model.robot().cables.len()];
    for sample in samples {
        let planned = |ahead_s: f64| plan.state(sample.path_s? + ahead_s);
        let (Some(before), Some(at), Some(after)) =
            (planned(-HALF_S), planned(0.0), planned(HALF_S))
        else {
            continue;
        };
        let planned = before
            .paid_out_m
            .iter()
            .zip(&at.paid_out_m)
            .zip(&after.paid_out_m);
        let rows = planned.zip(&sample.lengths_m).zip(&mut cables);
        for ((((before_m, at_m), after_m), measured_m), directions) in rows {
            let speed_mps = (after_m - before_m) / (2.0 * HALF_S);
            if speed_mps.abs() > MOVING_MPS {
                let [out, back] = directions;
                let (sum, count) = if speed_mps > 0.0 { out } else { back };
                *sum += measured_m - at_m;
                *count += 1.0;
            }
        }
    }
    let held = model.holding().by_length().iter();
    held.filter_map(|&cable| cables.get(cable))
        .filter(|[out, back]| out.1 > 0.0 && back.1 > 0.0)
        .map(|[out, back]| (out.0 / out.1 - back.0 / back.1).abs())
        .fold(0.0, f64::max)
}

/// Lets the robot hold for a while.
pub(super) fn rest<L: crate::link::Link>(
    session: &mut Session<'_, L>,
    seconds: f64,
) -> Result<(), RunError> {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "some seconds"
    )]
    let until_us = session.client().now_us() + (seconds * 1e6) as u64;
    Ok(session.client().pump(until_us)?)
}

pub(crate) fn true_lengths_m(link: &SimulatedLink, cables: usize) -> Result<Vec<f64>, RunError> {
    let truth = link.with(|simulation| simulation.plant().truth());
    let truth = truth.map_err(|error| RunError::Client(crate::link::plant_failed(error).into()))?;
    Ok(truth
        .unstretched_lengths_m
        .iter()
        .take(cables)
        .copied()
        .collect())
}

/// Distance of the mean position from the target, and the greatest distance from the mean position.
fn rested(trace: &[TracePoint], target_m: &Vector3<f64>) -> (f64, f64) {
    let skip = (AFTER_S * 1e3) as usize;
    let places: Vec<Vector3<f64>> = trace
        .iter()
        .skip(skip)
        .map(|point| Vector3::from(point.truth.tool_position_m))
        .collect();
    let mean = places.iter().sum::<Vector3<f64>>() / places.len().max(1) as f64;
    let swing = places
        .iter()
        .map(|at| (at - mean).norm())
        .fold(0.0, f64::max);
    ((mean - target_m).norm(), swing)
}

/// Every case of the table, for one planner and one pulley loss.
#[must_use]
pub fn cases(planner: Planner, pulley_loss: f64) -> Vec<Case> {
    let base = Case {
        job: Job::Circle8s,
        robot: "lab-fast",
        every_error: false,
        known: Known::Homed,
        pulley_loss,
        shaping: if planner == Planner::Equilibrium {
            Shaping::Zv
        } else {
            Shaping::None
        },
        frictionless: false,
        planner,
    };
    let mut cases = Vec::new();
    for (every_error, known) in [
        (false, Known::Homed),
        (true, Known::Homed),
        (true, Known::HomedByOne),
        (false, Known::Absolute),
    ] {
        for (job, robot) in [
            (Job::Circle8s, "lab-fast"),
            (Job::Line, "lab-fast"),
            (Job::Circle10s, "paper-optimistic"),
            (Job::LineAtLimit, "paper-optimistic"),
        ] {
            cases.push(Case {
                job,
                robot,
                every_error,
                known,
                ..base
            });
        }
    }
    for known in [Known::Homed, Known::HomedByOne, Known::Absolute] {
        for job in [Job::Grasp, Job::Release] {
            cases.push(Case {
                job,
                known,
                every_error: known != Known::Absolute,
                ..base
            });
        }
    }
    if planner == Planner::Equilibrium {
        for frictionless in [false, true] {
            for shaping in [Shaping::None, Shaping::Zv] {
                cases.push(Case {
                    job: Job::FastMove,
                    every_error: true,
                    shaping,
                    frictionless,
                    ..base
                });
            }
        }
    }
    cases
}

/// One row of the table.
#[derive(Debug, Clone, Serialize)]
pub struct Row {
    /// The case.
    pub case: Case,
    /// Completed runs.
    pub runs: usize,
    /// Why the first incomplete run failed.
    pub failed: Option<String>,
    /// Medians over the seeds.
    pub median: Option<Outcome>,
    /// 95th percentile of the resting error, m.
    pub rest_p95_m: Option<f64>,
    /// Greatest of the greatest path errors, m.
    pub worst_max_m: Option<f64>,
}

/// Runs a case for seeds 1 to `seeds`.
#[must_use]
pub fn row(case: &Case, seeds: u64) -> Row {
    let outcomes: Vec<_> = (1..=seeds)
        .into_par_iter()
        .map(|seed| run(case, seed))
        .collect();
    let mut good = Vec::new();
    let mut failed = None;
    for (seed, outcome) in (1..).zip(outcomes) {
        match outcome {
            Ok(outcome) => good.push(outcome),
            Err(error) => {
                failed.get_or_insert_with(|| format!("seed {seed}: {error}"));
            }
        }
    }
    let at = |pick: fn(&Outcome) -> f64, share: f64| {
        super::quantile(good.iter().map(pick).collect(), share)
    };
    let median = (!good.is_empty()).then(|| Outcome {
        path_mean_m: at(|o| o.path_mean_m, 0.5),
        path_max_m: at(|o| o.path_max_m, 0.5),
        reversal_m: at(|o| o.reversal_m, 0.5),
        rest_m: at(|o| o.rest_m, 0.5),
        swing_m: at(|o| o.swing_m, 0.5),
        tension_n: at(|o| o.tension_n, 0.5),
        least_tension_n: at(|o| o.least_tension_n, 0.5),
        duration_s: at(|o| o.duration_s, 0.5),
    });
    Row {
        case: *case,
        runs: good.len(),
        failed,
        rest_p95_m: median.map(|_| at(|o| o.rest_m, 0.95)),
        worst_max_m: median.map(|_| at(|o| o.path_max_m, 1.0)),
        median,
    }
}
