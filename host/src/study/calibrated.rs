//! A robot after its calibration, at places that were not measured: how far off it is, and whether it says so.
//!
//! A machine collects poses over the board of tags, the joint estimate describes it, and it drives to random
//! places, from where it stands: with the cable lengths that the calibration found. It is judged in the frame of its
//! tags, since a calibration cannot determine another (of a robot in a plane across that plane in the frame of its anchors,
//! on average), against the region in which the platform should be with 95 %
//! probability: what the calibration leaves open, and the statics of how it hangs.

use super::motion::{rest, true_lengths_m};
use crate::calibration::Data;
use crate::calibration::collect::Options as Collecting;
use crate::control::Handle;
use crate::experiment::{self, SimulatedRobot, over_board};
use crate::machine::Mismatch;
use crate::motion::{Model, PlanOptions, Shaping, Task};
use crate::report::true_pose;
use crate::robot::Robot;
use crate::run::{Homing, NoStore, Recorder, RunError, Session};
use crate::sight::Scene;
use mcdpr_core::estimate::tube::{Belief, Doubts, Tube};
use mcdpr_core::random::Random;
use mcdpr_kinematics::Pose;
use mcdpr_protocol::SessionId;
use nalgebra::{Matrix3, Matrix6, Rotation3, Vector3};
use serde::Serialize;

/// Candidates for the poses.
const CANDIDATES: usize = 100;
/// Drawn places that are tried before a robot counts as having none.
const TRIES: usize = 400;
/// Time at rest before it is judged, s.
const REST_S: f64 = 1.0;
/// The simulated platform swings for minutes after a motion, about where it hangs: it is judged by its mean over a
/// dozen swings of 0.65 s.
const WATCH_S: f64 = 8.0;
/// Interval at which it is looked at, s.
const LOOK_S: f64 = 0.02;
/// Speed between the places, m/s.
const SPEED_MPS: f64 = 0.15;
/// Square of the radius that holds 95 % of three normal coordinates (chi-square, 3 degrees of freedom).
const CHI2_3_95: f64 = 7.815;
/// Salt of the places in a seed: they are not those of the calibration.
const PLACES: u64 = 0x706C_6163;

/// A calibrated robot, and what it believes.
pub(crate) struct Known {
    /// By its calibration.
    pub robot: Robot,
    /// Cable lengths at home as the calibration has them beyond the true ones, m: the robot goes on from where it was
    /// calibrated.
    pub lengths_off_m: Vec<f64>,
    /// The simulator's world frame in the frame that the calibration knows.
    pub known_from_true: Option<Pose>,
}

/// Poses of this machine over the board of tags, whose places the seed draws.
///
/// # Errors
/// In words.
pub(crate) fn collected(
    robot: &Robot,
    machine: &SimulatedRobot,
    poses: usize,
    seed: u64,
) -> Result<Data, String> {
    let words = |error: &dyn std::fmt::Display| error.to_string();
    let model = Model::new(&over_board(robot)).map_err(|error| words(&error))?;
    let options = Collecting {
        poses,
        candidates: CANDIDATES,
        seed,
        described: Some(robot.content_hash()),
        session: Some(SessionId(1)),
        ..Collecting::default()
    };
    experiment::collected(&model, machine, seed, &options).map_err(|error| words(&error))
}

/// The robot by what the data of this machine say.
///
/// # Errors
/// In words.
pub(crate) fn known(
    robot: &Robot,
    machine: &SimulatedRobot,
    seed: u64,
    data: &Data,
) -> Result<Known, String> {
    let words = |error: &dyn std::fmt::Display| error.to_string();
    let over_board = over_board(robot);
    let model = Model::new(&over_board).map_err(|error| words(&error))?;
    let link = machine.at_home(&model).map_err(|error| words(&error))?;
    let true_m = true_lengths_m(&link, robot.cables.len()).map_err(|error| words(&error))?;
    let built = link.with(|simulation| simulation.plant().params().cables.clone());
    let anchors_m: Vec<_> = built.iter().map(|cable| cable.anchor_m.into()).collect();
    let (robot, answer) = experiment::calibrated(robot, data)?;
    let found_m = answer.initial_length_m.iter();
    let lengths_off_m = found_m.zip(&true_m).map(|(found, truth)| found - truth);
    let lengths_off_m = lengths_off_m.collect();
    Ok(Known {
        lengths_off_m,
        known_from_true: Scene::of(&over_board, seed).known_from_this(&robot, &anchors_m),
        robot,
    })
}

/// One place.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Place {
    /// Mean distance of the platform from where it should be, its swing averaged out, m.
    pub position_m: f64,
    /// Mean angle to the attitude that it should have, its swing averaged out, rad.
    pub attitude_rad: f64,
    /// Swing of the platform's position about its mean, root mean square, m.
    pub swing_m: f64,
    /// Swing of its attitude, root mean square, rad.
    pub swing_rad: f64,
    /// Distance that is expected there, root mean square, m.
    pub expected_m: f64,
    /// Angle that is expected there, root mean square, rad.
    pub expected_rad: f64,
    /// Whether the platform's position is in the region of 95 %.
    pub inside: bool,
    /// Whether its attitude is in the region of 95 %.
    pub turned_inside: bool,
    /// Mean distance of the tool from where it should be, m.
    pub tool_m: f64,
    /// Radius of the plan's tube of 95 % there, m.
    pub tube_m: f64,
}

/// What was seen at a place.
struct Visit {
    /// Shift (m) and rotation (rad) of the platform from where it should be, at every look.
    off: Vec<(Vector3<f64>, Vector3<f64>)>,
    /// Mean shift of the tool, m.
    tool_off_m: Vector3<f64>,
    tube_m: f64,
    /// Covariance of the platform's position (m) and rotation (rad).
    expected: Matrix6<f64>,
}

/// What a machine came to.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Judged {
    /// Its seed.
    pub seed: u64,
    /// Poses that were collected.
    pub poses: usize,
    /// Whether they calibrated it.
    pub calibrated: bool,
    /// The places that it reached.
    pub places: Vec<Place>,
    /// Why it ended before the last of them, if so.
    pub stopped: Option<String>,
}

/// What is done with each machine.
#[derive(Debug, Clone, Copy)]
pub struct Work {
    /// Poses that calibrate it.
    pub poses: usize,
    /// Places that it drives to.
    pub places: usize,
    /// How these motions are shaped.
    pub shaping: Shaping,
}

/// Calibrates one machine with these errors, and drives it to random places.
#[must_use]
pub fn judge(robot: &Robot, mismatch: Mismatch, work: &Work, seed: u64) -> Judged {
    let mut judged = Judged {
        seed,
        poses: 0,
        calibrated: false,
        places: Vec::new(),
        stopped: None,
    };
    let machine = SimulatedRobot::new(mismatch, seed).machine(robot);
    judged.stopped = done(robot, &machine, work, &mut judged).err();
    judged
}

fn done(
    robot: &Robot,
    machine: &SimulatedRobot,
    work: &Work,
    judged: &mut Judged,
) -> Result<(), String> {
    let seed = judged.seed;
    let data = collected(robot, machine, work.poses, seed);
    let data = data.map_err(|error| format!("collecting: {error}"))?;
    judged.poses = data.poses.len();
    let known = known(robot, machine, seed, &data);
    let known = known.map_err(|error| format!("calibrating: {error}"))?;
    let known_from_true = known.known_from_true.as_ref().ok_or("no tag was found")?;
    judged.calibrated = true;
    let mut visited = Vec::new();
    let ended = visit(&known, known_from_true, machine, work, seed, &mut visited);
    for visit in &visited {
        let part = |at: usize| Matrix3::from_fn(|i, j| visit.expected[(at + i, at + j)]);
        let (position_m2, rotation_rad2) = (part(0), part(3));
        let (off_m, swing_m) = mean(visit.off.iter().map(|off| off.0));
        let (turned_rad, swing_rad) = mean(visit.off.iter().map(|off| off.1));
        judged.places.push(Place {
            position_m: off_m.norm(),
            attitude_rad: turned_rad.norm(),
            swing_m,
            swing_rad,
            expected_m: position_m2.trace().sqrt(),
            expected_rad: rotation_rad2.trace().sqrt(),
            inside: within(&position_m2, &off_m),
            turned_inside: within(&rotation_rad2, &turned_rad),
            tool_m: visit.tool_off_m.norm(),
            tube_m: visit.tube_m,
        });
    }
    ended.map_err(|error| format!("on the way to place {}: {error}", visited.len() + 1))
}

/// Mean of some vectors, and the root mean square of their distances from it.
fn mean(of: impl Iterator<Item = Vector3<f64>> + Clone) -> (Vector3<f64>, f64) {
    let count = of.clone().count().max(1) as f64;
    let mean = of.clone().sum::<Vector3<f64>>() / count;
    let square = of.map(|one| (one - mean).norm_squared()).sum::<f64>() / count;
    (mean, square.sqrt())
}

/// Whether an error lies in the region of 95 % of a covariance.
fn within(covariance: &Matrix3<f64>, off: &Vector3<f64>) -> bool {
    let root = covariance.cholesky();
    root.is_some_and(|root| off.dot(&root.solve(off)) <= CHI2_3_95)
}

/// Drives to random places; those that were reached are in `visited`, also where it fails on the way.
fn visit(
    known: &Known,
    known_from_true: &Pose,
    machine: &SimulatedRobot,
    work: &Work,
    seed: u64,
    visited: &mut Vec<Visit>,
) -> Result<(), RunError> {
    let options = PlanOptions {
        shaping: work.shaping,
        ..PlanOptions::default()
    };
    let model = Model::new(&known.robot).map_err(RunError::Plan)?;
    let model = model.with_options(options);
    let link = machine.at_home(&model)?;
    let mut lengths_m = true_lengths_m(&link, known.robot.cables.len())?;
    for (length_m, off_m) in lengths_m.iter_mut().zip(&known.lengths_off_m) {
        *length_m += off_m;
    }
    let handle = Handle::new();
    let homing = Homing::Lengths(lengths_m);
    let mut session = Session::open(
        &model,
        link.clone(),
        SessionId(2),
        &handle,
        homing,
        &NoStore,
    )?;
    session.arm()?;
    let speed_mps = Some(SPEED_MPS.min(known.robot.limits.speed_mps));
    let [low, high] = known.robot.search_box_in_world_m();
    let mut random = Random::new(seed ^ PLACES);
    let belief = Belief::of(&known.robot, &Doubts::by_tape());
    for _ in 0..TRIES {
        if visited.len() == work.places {
            break;
        }
        let to_m = Vector3::from_fn(|axis, _| random.between(low[axis], high[axis]));
        // Where it cannot go is no place.
        let Ok(plan) = session.plan(Task::go_to("place", to_m)?, speed_mps) else {
            continue;
        };
        session.follow(&plan, &mut Recorder::default(), |_| {})?;
        let end_s = plan.timed.duration_s();
        let Some(wanted) = plan.state(end_s) else {
            continue;
        };
        let expected = belief.platform_at(&model, &wanted);
        let Some(expected) = expected.map_err(RunError::Plan)? else {
            continue;
        };
        let tool_wanted_m = plan.timed.tool_m(end_s)?;
        let pose = wanted.equilibrium.pose;
        rest(&mut session, REST_S)?;
        let looks = (WATCH_S / LOOK_S) as usize;
        let mut off = Vec::with_capacity(looks);
        let mut tools_m = Vec::with_capacity(looks);
        for _ in 0..looks {
            rest(&mut session, LOOK_S)?;
            let truth = link.with(|simulation| simulation.plant().truth());
            let failed = crate::link::plant_failed;
            let truth = truth.map_err(|error| RunError::Client(failed(error).into()))?;
            let seen = known_from_true.compose(&true_pose(&truth));
            let turned: Rotation3<f64> = seen.rotation * pose.rotation.inverse();
            off.push((seen.position_m - pose.position_m, turned.scaled_axis()));
            tools_m.push(known_from_true.transform(&truth.tool_position_m.into()) - tool_wanted_m);
        }
        let tube = Tube::along(&plan, &belief).map_err(RunError::Plan)?;
        visited.push(Visit {
            off,
            tool_off_m: mean(tools_m.iter().copied()).0,
            tube_m: tube.map_or(0.0, |tube| tube.radius_m(end_s)),
            expected,
        });
    }
    session.disarm()
}
