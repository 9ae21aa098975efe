//! A survey of the fault table: every row, in every phase of a robot's work, measured from the injection.
//!
//! A run is drawn from its seed: a machine that is off, a task that leaves home and returns, one or
//! two faults. If nothing was latched when the robot is parked, it arms again, and moves again if it
//! is at home: a fault that shows only in motion must be found there. What is measured counts from
//! the injection, not from the detection.

mod draw;
mod measure;
mod names;

pub use draw::{Drawn, Moment};
pub use names::{RightName, silent};

use super::{FaultyLink, Injection, Limits, campaign};
use crate::control::Handle;
use crate::experiment::{Experiment, SimulatedRobot};
use crate::machine::Mismatch;
use crate::motion::Model;
use crate::run::{Homing, NoStore, RunError, Session};
use mcdpr_protocol::{FaultId, FaultRecord, SessionId};
use mcdpr_simulator::{Simulation, TracePoint};
use nalgebra::Vector3;

/// Time for a robot to come to rest and to be watched while parked, µs: the two seconds of holding
/// after a lost link, a stop, and as much again.
const SETTLE_US: u64 = 4_000_000;

/// Result of a run.
#[derive(Debug, Clone)]
pub struct Outcome {
    /// What was drawn.
    pub drawn: Drawn,
    /// What the board latched first.
    pub latched: Option<FaultRecord>,
    /// Time from the first injection until then, ms.
    pub latched_after_ms: Option<usize>,
    /// The robot had been parked and was arming or moving again when it was latched.
    pub at_next_arming: bool,
    /// Nothing was latched, and the host's program ended with an error.
    pub refused: Option<String>,
    /// Whether every injection was made.
    pub injected: bool,
    /// Whether the fault is that of the table, and its cable the right one.
    pub named: RightName,
    /// Greatest distance of the tool from where its path has it, beyond that at the injection, m.
    pub deviation_m: f64,
    /// Greatest height that it lost against its path since the injection, m.
    pub drop_m: f64,
    /// Longest time over a cable's limit by 10 %, ms.
    pub over_ms: usize,
    /// Greatest tension as a share of its limit.
    pub most_share: f64,
    /// Longest time that an intact cable was slack under torque, ms.
    pub slack_ms: usize,
    /// Simulated time, s.
    pub simulated_s: f64,
    /// Broken invariants.
    pub violations: Vec<String>,
}

impl Outcome {
    /// Whether board or host reported anything.
    #[must_use]
    pub const fn is_noticed(&self) -> bool {
        self.latched.is_some() || self.refused.is_some()
    }
}

/// One run on this robot. `None` if no motion was found.
#[must_use]
pub fn run(model: &Model, seed: u64) -> Option<Outcome> {
    let drawn = draw::draw(model, seed)?;
    Some(run_drawn(model, drawn))
}

/// A run of the same machine and the same work without a fault.
#[must_use]
pub fn undisturbed(model: &Model, seed: u64) -> Option<Outcome> {
    let mut drawn = draw::draw(model, seed)?;
    drawn.injections.clear();
    Some(run_drawn(model, drawn))
}

/// Runs these seeds on all processors, with their faults or undisturbed; `None` if there was no motion.
/// `seen` is called for each as it is done, in any order.
pub fn run_all(
    model: &Model,
    seeds: std::ops::Range<u64>,
    disturbed: bool,
    seen: impl Fn(&Outcome) + Sync,
) -> Vec<Option<Outcome>> {
    campaign::on_all_processors(seeds, |seed| {
        let outcome = if disturbed {
            run(model, seed)
        } else {
            undisturbed(model, seed)
        };
        if let Some(outcome) = &outcome {
            seen(outcome);
        }
        outcome
    })
}

fn run_drawn(model: &Model, drawn: Drawn) -> Outcome {
    let mut outcome = Outcome {
        drawn,
        latched: None,
        latched_after_ms: None,
        at_next_arming: false,
        refused: None,
        injected: false,
        named: RightName::default(),
        deviation_m: 0.0,
        drop_m: 0.0,
        over_ms: 0,
        most_share: 0.0,
        slack_ms: 0,
        simulated_s: 0.0,
        violations: Vec::new(),
    };
    match work(model, &outcome.drawn) {
        Ok(seen) => judge(model, &seen, &mut outcome),
        Err(error) => outcome.violations.push(format!("no run: {error}")),
    }
    outcome
}

/// Everything that happened in a run.
struct Seen {
    trace: Vec<TracePoint>,
    /// When the faults were injected, ms.
    injected_ms: Vec<usize>,
    /// The first tick of the second arming; the trace's length if there is none.
    again: usize,
    /// The tool's path, m, for each millisecond of path time.
    path_m: Vec<Vector3<f64>>,
    refused: Option<String>,
}

fn work(model: &Model, drawn: &Drawn) -> Result<Seen, RunError> {
    let plan = Experiment::new(model, drawn.task.clone()).plan()?;
    let mut path_m = Vec::new();
    while path_m.len() as f64 * 1e-3 <= plan.timed.duration_s() {
        path_m.push(plan.timed.tool_m(path_m.len() as f64 * 1e-3)?);
    }
    let simulated = SimulatedRobot::new(Mismatch::realistic(), drawn.seed).at_home(model)?;
    simulated.with(Simulation::record_truth);
    let link = FaultyLink::new(simulated.clone(), &drawn.injections);
    let settle = || {
        let settled = link.settle(SETTLE_US);
        settled.map_err(crate::link::ClientError::from)
    };
    let handle = Handle::new();
    let stop_s = drawn.stop_s;
    let stopper = handle.clone();
    let mut ordered = false;
    let mut outcome = Experiment::new(model, drawn.task.clone())
        .at_home()
        .session(SessionId(1))
        .handle(&handle)
        .progress(move |progress| {
            if !ordered && stop_s.is_some_and(|stop_s| progress.path_s >= stop_s) {
                stopper.stop();
                ordered = true;
            }
        })
        .run_on(link.clone())
        .map(drop);
    settle()?;
    let again = link.now_ms();
    let stopped = matches!(outcome, Err(RunError::Interrupted { .. }));
    let quiet = simulated.with(|s| s.fault()).is_none();
    if quiet && (outcome.is_ok() || stopped) {
        outcome = if stopped {
            arm_only(model, link.clone())
        } else {
            Experiment::new(model, drawn.task.clone())
                .homing(Homing::Known)
                .session(SessionId(2))
                .run_on(link.clone())
                .map(drop)
        };
        settle()?;
    }
    let refused = match outcome {
        Ok(()) => None,
        // An error of the plan, not of the robot.
        Err(error @ RunError::Plan(_)) if drawn.injections.is_empty() => return Err(error),
        Err(error) => Some(error.to_string()),
    };
    Ok(Seen {
        trace: simulated.with(Simulation::take_trace),
        injected_ms: link
            .injected_ms()
            .iter()
            .map(|ms| usize::try_from(*ms).unwrap_or(usize::MAX))
            .collect(),
        again,
        path_m,
        refused,
    })
}

fn arm_only(model: &Model, link: FaultyLink) -> Result<(), RunError> {
    let handle = Handle::new();
    let mut session = Session::open(model, link, SessionId(2), &handle, Homing::Known, &NoStore)?;
    session.arm()?;
    session.disarm()
}

fn judge(model: &Model, seen: &Seen, outcome: &mut Outcome) {
    let injections = &outcome.drawn.injections;
    let from = seen.injected_ms.first().copied().unwrap_or(0);
    outcome.simulated_s = seen.trace.len() as f64 * 1e-3;
    outcome.injected = seen.injected_ms.len() == injections.len();
    let first = seen.trace.iter().position(|point| point.fault.is_some());
    outcome.latched = first
        .and_then(|at| seen.trace.get(at))
        .and_then(|point| point.fault);
    outcome.latched_after_ms = first.map(|at| at.saturating_sub(from));
    outcome.at_next_arming = first.is_some_and(|at| at >= seen.again && from < seen.again);
    outcome.refused = seen.refused.clone().filter(|_| first.is_none());
    let limits = Limits::of(model);
    let way = measure::away(&seen.trace, from, &seen.path_m);
    (outcome.deviation_m, outcome.drop_m) = way;
    let after = seen
        .trace
        .get(from.min(seen.trace.len())..)
        .unwrap_or_default();
    (outcome.most_share, outcome.over_ms) = measure::over(after, &limits);
    let without: Vec<_> = injections
        .iter()
        .filter(|i| matches!(i.fault, FaultId::C3 | FaultId::D2 | FaultId::D7))
        .map(|i| i.cable)
        .collect();
    outcome.slack_ms = measure::slack(after, &limits, &without);
    outcome.named = names::judge(model, injections, outcome.latched.as_ref());
    let mut wrong = Vec::new();
    campaign::re_energises(&seen.trace, &mut wrong);
    let faults: Vec<_> = injections.iter().map(|injection| injection.fault).collect();
    if !measure::is_safe(&seen.trace, &limits, &faults) {
        let end = seen.trace.last().map(|point| point.state);
        wrong.push(format!("ended unsafely in {end:?}"));
    }
    if injections.is_empty() && (outcome.latched.is_some() || outcome.refused.is_some()) {
        wrong.push(format!(
            "false alarm: {:?} {:?}",
            outcome.latched, outcome.refused
        ));
    }
    if outcome.injected && !outcome.is_noticed() && !injections.is_empty() {
        let excused = injections
            .iter()
            .all(|injection| silent(injection, outcome.drawn.moment).is_some());
        if !excused {
            wrong.push("not noticed".to_owned());
        }
    }
    outcome.violations = wrong;
}

/// A fault as the command line takes it.
#[must_use]
pub fn word(injection: &Injection) -> String {
    campaign::word(injection)
}
