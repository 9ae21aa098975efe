//! The tube that plans state, judged by simulated machines that it does not know.

use crate::control::Handle;
use crate::experiment::{SimulatedRobot, simulated_eyes};
use crate::link::SimulatedLink;
use crate::machine::{Controller, Mismatch};
use crate::motion::path::{Path, PathError, Piece};
use crate::motion::{Model, Plan, PlanError, Step};
use crate::report;
use crate::report::tube::{Ratio, ratios};
use crate::run::tracking::Tracking;
use crate::run::{Homing, NoStore, Recorder, RunError, Session, Sight};
use mcdpr_core::estimate::track::Prior;
use mcdpr_core::estimate::tube::{Belief, Doubts, Tube};
use mcdpr_core::random::Random;
use mcdpr_protocol::SessionId;
use mcdpr_simulator::Simulation;
use nalgebra::Vector3;
use serde::Serialize;

/// Ways that are tried before a machine counts as having none.
const TRIES: usize = 400;
/// Legs of a plan, at least and at most.
const LEGS: [usize; 2] = [1, 4];
/// Speed of a leg as a share of the robot's limit, at least.
const SLOWEST: f64 = 0.1;
/// A leg is no shorter, m.
const SHORTEST_M: f64 = 0.02;
/// Share of legs that are circles.
const CIRCLES: f64 = 0.3;

/// What one plan on one machine came to.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Audit {
    /// Its seed: of the machine, and of the plan.
    pub seed: u64,
    /// Time along the path, s.
    pub path_s: f64,
    /// Time along the path with the tool inside the tube, s.
    pub inside_s: f64,
    /// Mean radius of the tube, m.
    pub radius_mean_m: f64,
    /// Mean distance of the true tool from the planned one, m.
    pub error_mean_m: f64,
    /// The greatest, m.
    pub error_max_m: f64,
    /// Radius that would have held 95 % of this path, over the stated one.
    pub needed: f64,
    /// Why the run ended early, if it did.
    pub stopped: Option<String>,
}

/// A random plan from home, within every limit.
///
/// # Errors
/// The last refusal, where no way was found.
fn random_plan(model: &Model, random: &mut Random) -> Result<Plan, PlanError> {
    let home = model.robot().tool.home_in_world_m;
    plan_from(
        model,
        &home,
        &|steps| Plan::new(model, &home, steps),
        random,
    )
}

/// Makes a plan of steps.
type Make<'a> = dyn Fn(&[Step]) -> Result<Plan, PlanError> + 'a;

/// A random plan from a place of the tool (world, m), within every limit.
fn plan_from(
    model: &Model,
    first: &Vector3<f64>,
    make: &Make<'_>,
    random: &mut Random,
) -> Result<Plan, PlanError> {
    let mut refused = PlanError::Path(PathError::Empty);
    for _ in 0..TRIES {
        match drawn(model, first, random).and_then(|steps| make(&steps)) {
            Ok(plan) => return Ok(plan),
            Err(error) => refused = error,
        }
    }
    Err(refused)
}

fn drawn(model: &Model, first: &Vector3<f64>, random: &mut Random) -> Result<Vec<Step>, PlanError> {
    let robot = model.robot();
    let [low, high] = robot.search_box_in_world_m();
    let mut at_m = *first;
    let count = LEGS[0] + random.below(LEGS[1] - LEGS[0] + 1);
    let mut steps = Vec::new();
    for _ in 0..count {
        let speed_mps = robot.limits.speed_mps * random.between(SLOWEST, 1.0);
        let path = if random.unit() < CIRCLES {
            let radius_m = random.between(0.02, 0.1);
            let turn = random.between(0.0, std::f64::consts::TAU);
            let arm = Vector3::new(turn.cos(), turn.sin(), 0.0) * radius_m;
            let arc = Piece::arc(at_m + arm, radius_m, at_m, std::f64::consts::TAU)?;
            Path::new(vec![arc])?
        } else {
            let to_m = loop {
                let to_m = Vector3::from_fn(|axis, _| random.between(low[axis], high[axis]));
                if (to_m - at_m).norm() > SHORTEST_M {
                    break to_m;
                }
            };
            // Half of the way into the box at most: its corners are rarely reachable.
            let to_m = at_m + (to_m - at_m) * random.between(0.3, 1.0);
            let path = Path::through(&[at_m, to_m])?;
            at_m = to_m;
            path
        };
        steps.push(Step::Move {
            path,
            duration_s: None,
            speed_mps: Some(speed_mps),
        });
    }
    Ok(steps)
}

/// Plans at random and runs the plan on the machine of this seed. A machine that a fault stops counts as far
/// as it came.
///
/// # Errors
/// As a run on the simulator, where it did not begin to move.
pub fn audit(
    model: &Model,
    belief: &Belief,
    mismatch: Mismatch,
    seed: u64,
    controller: &Controller,
    handle: &Handle,
) -> Result<Audit, RunError> {
    let mut random = Random::new(seed ^ 0x7475_6265);
    let plan = random_plan(model, &mut random)?;
    let tube = Tube::along(&plan, belief)?;
    let robot = SimulatedRobot::new(mismatch, seed).controller(controller);
    let link = robot.at_home(model)?;
    let homing = Homing::Place(model.robot().tool.home_in_world_m);
    let mut session = Session::open(model, link.clone(), SessionId(1), handle, homing, &NoStore)?;
    session.arm()?;
    link.with(Simulation::record_truth);
    judged(&mut session, &link, &plan, tube.as_ref(), seed)
}

/// A tracked robot, at its rests: what is assumed at its start, and whether it sees its tags.
#[derive(Debug, Clone, Copy)]
pub(crate) struct AtRests<'a> {
    /// What is assumed before the first rest.
    pub(crate) prior: &'a Prior,
    /// Whether the simulated camera looks at every rest.
    pub(crate) looks: bool,
}

/// Plans at random, again and again, on one machine that is tracked: each plan follows a rest, starts where the one before
/// ended, and states its tube by what is tracked then. A fault ends it; its plan counts as far as it came.
///
/// # Errors
/// As a run on the simulator, where it did not begin to move.
pub(crate) fn audit_tracked(
    model: &Model,
    rests: AtRests<'_>,
    mismatch: Mismatch,
    seed: u64,
    plans: usize,
    (controller, handle): (&Controller, &Handle),
) -> Result<Vec<Audit>, RunError> {
    let mut random = Random::new(seed ^ 0x7475_6265);
    let robot = SimulatedRobot::new(mismatch, seed).controller(controller);
    let link = robot.at_home(model)?;
    let homing = Homing::Place(model.robot().tool.home_in_world_m);
    let mut eyes = rests
        .looks
        .then(|| simulated_eyes(model.robot(), &link, seed));
    let mut session = Session::open(model, link.clone(), SessionId(1), handle, homing, &NoStore)?;
    session.track(Tracking::new(model, rests.prior), None)?;
    session.arm()?;
    link.with(Simulation::record_truth);
    let mut audits: Vec<Audit> = Vec::new();
    let mut before: Option<Tube> = None;
    for _ in 0..plans {
        let sight = eyes.as_mut().map(|(camera, places)| Sight {
            camera: camera.as_mut(),
            places,
        });
        if let Some(noticed) = session.notice(sight)? {
            session.learnt(noticed.learn()?);
        }
        let planning = session.planning();
        let make = |steps: &[Step]| planning.steps(steps);
        let plan = plan_from(planning.model(), &planning.tool_m(), &make, &mut random)?;
        let tube = planning.tube(&plan, &Doubts::by_tape(), before.as_ref())?;
        link.with(Simulation::take_trace);
        match judged(&mut session, &link, &plan, tube.as_ref(), seed) {
            Ok(audit) => {
                let ended = audit.stopped.is_some();
                audits.push(audit);
                before = tube;
                if ended {
                    return Ok(audits);
                }
            }
            Err(RunError::Interrupted) => return Err(RunError::Interrupted),
            Err(_) if !audits.is_empty() => return Ok(audits),
            Err(error) => return Err(error),
        }
    }
    session.disarm()?;
    Ok(audits)
}

/// Follows a plan and judges its tube by the tool's true path.
fn judged(
    session: &mut Session<'_, SimulatedLink>,
    link: &SimulatedLink,
    plan: &Plan,
    tube: Option<&Tube>,
    seed: u64,
) -> Result<Audit, RunError> {
    let followed = session.follow(plan, &mut Recorder::default(), |_| {});
    let path = report::true_path(&link.with(Simulation::take_trace));
    let stopped = match followed {
        Ok(()) => None,
        Err(RunError::Interrupted) => return Err(RunError::Interrupted),
        Err(error) if path.is_empty() => return Err(error),
        Err(error) => Some(error.to_string()),
    };
    let ratios = ratios(plan, tube, &path);
    let count = ratios.len().max(1) as f64;
    let mean = |of: &dyn Fn(&Ratio) -> f64| ratios.iter().map(of).sum::<f64>() / count;
    let (radius_mean_m, error_mean_m) = (mean(&|r| r.radius_m), mean(&|r| r.error_m));
    let error_max_m = ratios.iter().map(|r| r.error_m).fold(0.0, f64::max);
    let inside = ratios.iter().filter(|r| r.of() <= 1.0).count() as f64;
    Ok(Audit {
        seed,
        path_s: ratios.len() as f64 * 1e-3,
        inside_s: inside * 1e-3,
        radius_mean_m,
        error_mean_m,
        error_max_m,
        needed: super::quantile(ratios.iter().map(Ratio::of).collect(), 0.95),
        stopped,
    })
}
