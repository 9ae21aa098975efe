//! A survey of the fault table: every row, in every phase of a robot's work, measured from the injection.
//!
//! A run is drawn from its seed: a machine that is off, a task that leaves home and returns, one or
//! two faults. If nothing was latched when the robot is parked, it arms again, and moves again if it
//! is at home: a fault that shows only in motion must be found there. What is measured counts from
//! the injection, not from the detection.

mod draw;
mod measure;
mod names;

pub use measure::{away, re_energises};

pub use draw::{Drawn, Moment};
pub use names::RightName;
use names::silent;

use super::{FaultyLink, Injection, Phase, When};
use crate::line::{SimulatedLink, plant_failed};
use crate::plant::{Mismatch, at_rest};
use mcdpr_core::control::Handle;
use mcdpr_core::diagnosis::Diagnosis;
use mcdpr_core::link::ClientError;
use mcdpr_core::motion::Model;
use mcdpr_core::run::{Homing, NoStore, Recorder, RunError, Session};
use mcdpr_protocol::{FaultId, FaultRecord, SessionId};
use mcdpr_simulator::{LinkOptions, Simulation, TracePoint};
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
    /// The probable cause that the host's program gave beyond that, and whether that is right.
    pub diagnosed: Option<Diagnosis>,
    /// Whether the last of both is right: what a user is told.
    pub told: RightName,
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
    /// docs/faults.md says of each injected fault that it need not be noticed in this phase.
    pub may_be_silent: bool,
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

fn run_drawn(model: &Model, drawn: Drawn) -> Outcome {
    let mut outcome = Outcome {
        drawn,
        latched: None,
        latched_after_ms: None,
        at_next_arming: false,
        refused: None,
        injected: false,
        may_be_silent: true,
        named: RightName::default(),
        diagnosed: None,
        told: RightName::default(),
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
        Err(error) => outcome.violations.push(format!("no run: {error:?}")),
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
    /// The tool's path, m, for each millisecond of path time: of the first motion and of the second.
    paths_m: [Vec<Vector3<f64>>; 2],
    refused: Option<RunError>,
}

fn work(model: &Model, drawn: &Drawn) -> Result<Seen, RunError> {
    let home = model.robot().tool.home_in_world_m;
    let robot = model.robot();
    let plant = at_rest(model, robot, &Mismatch::realistic(), drawn.seed, None)?;
    let simulation = Simulation::new(plant, &LinkOptions::default(), drawn.seed);
    let simulation = simulation.map_err(|error| ClientError::from(plant_failed(error)))?;
    let simulated = SimulatedLink::new(simulation);
    simulated.with(Simulation::record_truth);
    let link = FaultyLink::new(simulated.clone(), &drawn.injections);
    let settle = || link.settle(SETTLE_US).map_err(ClientError::from);
    let mut paths_m = [Vec::new(), Vec::new()];
    let [first_m, second_m] = &mut paths_m;
    let mut outcome = day(model, &link, drawn, Homing::Place(home), first_m);
    settle()?;
    let again = link.now_ms();
    let stopped = matches!(outcome, Err(RunError::Interrupted));
    let quiet = simulated.with(|s| s.fault()).is_none();
    if quiet && (outcome.is_ok() || stopped) {
        // From where it stopped it first goes to where its task begins.
        outcome = day(model, &link, drawn, Homing::Known, second_m);
        settle()?;
    }
    let injected_ms = link.injected_ms().into_iter();
    Ok(Seen {
        trace: simulated.with(Simulation::take_trace),
        injected_ms: injected_ms
            .map(|ms| usize::try_from(ms).unwrap_or(usize::MAX))
            .collect(),
        again,
        paths_m,
        refused: outcome.err(),
    })
}

/// What a program does with the robot: it arms, follows the task, parks. The tool's path goes to `path_m`; of two days,
/// the first is the one that has none yet and may be stopped.
fn day(
    model: &Model,
    link: &FaultyLink,
    drawn: &Drawn,
    homing: Homing<'_>,
    path_m: &mut Vec<Vector3<f64>>,
) -> Result<(), RunError> {
    let handle = Handle::new();
    let first = matches!(homing, Homing::Place(_));
    let number = SessionId(if first { 1 } else { 2 });
    let mut session = Session::open(model, link.clone(), number, &handle, homing, &NoStore)?;
    // Planned before arming: a task that is refused must not leave an armed robot without a host.
    let plan = session.plan(drawn.task.clone(), None)?;
    while path_m.len() as f64 * 1e-3 <= plan.timed.duration_s() {
        path_m.push(plan.timed.tool_m(path_m.len() as f64 * 1e-3)?);
    }
    session.arm()?;
    let stop_s = drawn.stop_s.filter(|_| first);
    let mut ordered = false;
    session.follow(&plan, &mut Recorder::default(), |progress| {
        if !ordered && stop_s.is_some_and(|stop_s| progress.path_s >= stop_s) {
            handle.stop();
            ordered = true;
        }
    })?;
    session.disarm()
}

fn judge(model: &Model, seen: &Seen, outcome: &mut Outcome) {
    let injections = &outcome.drawn.injections;
    let moment = outcome.drawn.moment;
    outcome.may_be_silent = injections
        .iter()
        .all(|injection| silent(model, injection, moment).is_some());
    let from = seen.injected_ms.first().copied().unwrap_or(0);
    outcome.simulated_s = seen.trace.len() as f64 * 1e-3;
    outcome.injected = seen.injected_ms.len() == injections.len();
    let first = seen.trace.iter().position(|point| point.fault.is_some());
    outcome.latched = first
        .and_then(|at| seen.trace.get(at))
        .and_then(|point| point.fault);
    outcome.latched_after_ms = first.map(|at| at.saturating_sub(from));
    outcome.at_next_arming = first.is_some_and(|at| at >= seen.again && from < seen.again);
    let refused = seen.refused.as_ref().filter(|_| first.is_none());
    outcome.refused = refused.map(ToString::to_string);
    let limits = measure::Limits::of(model);
    let [first_m, second_m] = &seen.paths_m;
    let way = away(&seen.trace, from, seen.again, [first_m, second_m]);
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
    outcome.named = match (&outcome.latched, refused) {
        (Some(record), _) => names::judge(model, &outcome.drawn, (record.fault, record.cable)),
        (None, Some(error)) => names::judge_refusal(injections, error),
        (None, None) => RightName::default(),
    };
    outcome.told = outcome.named;
    if let Some(RunError::Fault { why: Some(why), .. }) = &seen.refused {
        outcome.told = names::judge(model, &outcome.drawn, (why.fault, why.cable));
        outcome.diagnosed = Some((**why).clone());
    }
    let mut wrong = Vec::new();
    re_energises(&seen.trace, &mut wrong);
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
    if outcome.injected && !outcome.is_noticed() && !outcome.may_be_silent {
        wrong.push("not noticed".to_owned());
    }
    outcome.violations = wrong;
}

/// A fault as the command line takes it.
#[must_use]
pub fn word(injection: &Injection) -> String {
    let when = match injection.when {
        When::Start => "start".to_owned(),
        When::Motion(at_s) => format!("{at_s:.3}s"),
        When::After(phase, at_s) => format!("{}+{at_s:.3}s", Phase::name(phase)),
    };
    let (id, cable) = (injection.fault.name(), injection.cable + 1);
    format!("{id}:{cable}@{when}")
}
