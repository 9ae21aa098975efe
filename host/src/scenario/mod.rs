//! Fault injection: which fault, where, and when, into a simulated robot; and its results.
//!
//! Faults act on the plant, the drive bus, the pins, the line or the host's program, never inside
//! the controller: the core that reacts is the same as on a board.

mod aftermath;
pub mod campaign;

pub use aftermath::{Aftermath, Limits, Moment};
pub use mcdpr_twin::faults::{
    FaultyLink, How, Injection, Phase, Scenario, ScenarioError, Snag, Supply, When, how, rows,
};

use crate::experiment::{Experiment, SimulatedRobot};
use crate::motion::{Model, Task};
use crate::run::RunError;
use mcdpr_protocol::SessionId;
use mcdpr_simulator::Simulation;
use nalgebra::Vector3;
use std::path::Path;

/// Time for a stopped robot to come to rest, µs: the two seconds of holding after a lost link, and
/// a stop.
const SETTLE_US: u64 = 4_000_000;

/// Most bytes of a scenario file.
const MOST_BYTES: u64 = 64 << 10;

/// Reads a scenario file (TOML, at most 64 KB).
///
/// # Errors
/// [`ScenarioError`].
pub fn load(path: &Path, cables: usize) -> Result<Scenario, ScenarioError> {
    let shown = path.display().to_string();
    let unreadable = |reason: String| ScenarioError::Unreadable {
        path: shown.clone(),
        reason,
    };
    let text = crate::files::read_bytes(path, MOST_BYTES)
        .and_then(|bytes| String::from_utf8(bytes).map_err(std::io::Error::other))
        .map_err(|error| unreadable(error.to_string()))?;
    Scenario::parse(&text, &shown, cables)
}

/// Runs a task on a simulated robot at home with these faults, and returns the results.
///
/// # Errors
/// If the task cannot be planned or the plant leaves the region in which its physics is valid;
/// faults are not errors.
pub fn run(
    model: &Model,
    task: Task,
    robot: &SimulatedRobot,
    scenario: &Scenario,
) -> Result<Aftermath, RunError> {
    let simulated = robot.at_home(model)?;
    simulated.with(Simulation::record_truth);
    let planned_m = planned(model, task.clone())?;
    let link = FaultyLink::new(simulated.clone(), &scenario.injections);
    let mut outcome = Experiment::new(model, task.clone())
        .at_home()
        .session(SessionId(1))
        .run_on(link.clone());
    let settle = || {
        let settled = link.settle(SETTLE_US);
        settled.map_err(crate::link::ClientError::from)
    };
    settle()?;
    let again = |injection: &Injection| matches!(injection.when, When::After(Phase::Rearming, _));
    // Only a fault while it arms again needs a second run, and only after a good first one.
    if scenario.injections.iter().any(again) && outcome.is_ok() {
        outcome = Experiment::new(model, task)
            .at_home()
            .session(SessionId(2))
            .run_on(link.clone());
        settle()?;
    }
    let error = match outcome {
        Ok(_) => None,
        // An error of the plan, not of the robot.
        Err(error @ (RunError::Plan(_) | RunError::Config(_))) => return Err(error),
        Err(error) => Some(error),
    };
    let trace = simulated.with(Simulation::take_trace);
    Ok(Aftermath::new(
        trace,
        link.injected_ms(),
        error,
        Limits::of(model),
        planned_m,
    ))
}

/// Place of the tool at each millisecond of the task's path time, world, m.
fn planned(model: &Model, task: Task) -> Result<Vec<Vector3<f64>>, RunError> {
    let plan = Experiment::new(model, task).plan()?;
    let mut places_m = Vec::new();
    while places_m.len() as f64 * 1e-3 <= plan.timed.duration_s() {
        places_m.push(plan.timed.tool_m(places_m.len() as f64 * 1e-3)?);
    }
    Ok(places_m)
}
