//! The tube that plans state, judged by simulated machines that it does not know.

use crate::control::Handle;
use crate::experiment::SimulatedRobot;
use crate::machine::{Controller, Mismatch};
use crate::motion::path::{Path, PathError, Piece};
use crate::motion::{Model, Plan, PlanError, Step};
use crate::report;
use crate::run::{Homing, NoStore, Recorder, RunError, Session};
use mcdpr_core::estimate::tube::{Belief, Tube};
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
    let mut refused = PlanError::Path(PathError::Empty);
    for _ in 0..TRIES {
        match drawn(model, random) {
            Ok(plan) => return Ok(plan),
            Err(error) => refused = error,
        }
    }
    Err(refused)
}

fn drawn(model: &Model, random: &mut Random) -> Result<Plan, PlanError> {
    let robot = model.robot();
    let [low, high] = robot.search_box_in_world_m();
    let mut at_m = robot.tool.home_in_world_m;
    let first = at_m;
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
    Plan::new(model, &first, &steps)
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
    let followed = session.follow(&plan, &mut Recorder::default(), |_| {});
    let path = report::true_path(&link.with(Simulation::take_trace));
    let stopped = match followed {
        Ok(()) => None,
        Err(RunError::Interrupted) => return Err(RunError::Interrupted),
        Err(error) if path.is_empty() => return Err(error),
        Err(error) => Some(error.to_string()),
    };
    let ratios = ratios(&plan, tube.as_ref(), &path);
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

/// Share of a true path that lies inside a tube; 1 for an empty path.
pub(crate) fn share_inside(plan: &Plan, tube: &Tube, path: &[report::PathPoint]) -> f64 {
    let all = ratios(plan, Some(tube), path);
    let inside = all.iter().filter(|ratio| ratio.of() <= 1.0).count();
    if all.is_empty() {
        1.0
    } else {
        inside as f64 / all.len() as f64
    }
}

/// Error of the tool, and the radius that was stated there, m.
struct Ratio {
    error_m: f64,
    radius_m: f64,
}

impl Ratio {
    fn of(&self) -> f64 {
        self.error_m / self.radius_m.max(1e-9)
    }
}

/// Point by point of a true path. Without a tube every point is outside.
fn ratios(plan: &Plan, tube: Option<&Tube>, path: &[report::PathPoint]) -> Vec<Ratio> {
    let duration_s = plan.timed.duration_s();
    let points = path.iter().filter(|point| point.path_s <= duration_s);
    points
        .filter_map(|point| {
            let planned_m = plan.timed.tool_m(point.path_s).ok()?;
            Some(Ratio {
                error_m: (Vector3::from(point.tool_m) - planned_m).norm(),
                radius_m: tube.map_or(0.0, |tube| tube.radius_m(point.path_s)),
            })
        })
        .collect()
}
