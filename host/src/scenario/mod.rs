//! Fault injection: which fault, where, and when, into a simulated robot; and its results.
//!
//! Faults act on the plant, the drive bus, the pins, the line or the host's program, never inside
//! the controller: the core that reacts is the same as on a board.

mod aftermath;
pub mod campaign;
mod inject;
mod link;
mod parse;
pub mod rows;

pub use aftermath::{Aftermath, Limits, Moment};
pub use inject::{How, how};
pub use link::FaultyLink;
pub use parse::ScenarioError;

use crate::experiment::{Experiment, SimulatedRobot};
use crate::motion::{Model, Task};
use crate::run::RunError;
use mcdpr_protocol::{FaultId, SessionId};
use mcdpr_simulator::Simulation;

/// Start of a fault.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum When {
    /// Before the host connects: the robot hangs on its brakes.
    Start,
    /// This long after the motion has begun, s.
    Motion(f64),
    /// This long after the board has entered this phase, s.
    After(Phase, f64),
}

/// Phases of a board around a motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    /// It arms for the first time.
    Arming,
    /// It holds under tension for the first time.
    Holding,
    /// It stops after the motion: brakes close under torque.
    Stopping,
    /// Its brakes are closed and its torque is off after the motion.
    Parked,
    /// It arms for the second time.
    Rearming,
}

impl Phase {
    /// Every phase.
    pub const ALL: [Self; 5] = [
        Self::Arming,
        Self::Holding,
        Self::Stopping,
        Self::Parked,
        Self::Rearming,
    ];

    /// Its name, as the command line takes it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Arming => "arming",
            Self::Holding => "holding",
            Self::Stopping => "stopping",
            Self::Parked => "parked",
            Self::Rearming => "rearming",
        }
    }
}

/// One fault to inject.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Injection {
    /// The row of `docs/faults.md`.
    pub fault: FaultId,
    /// The cable, 0 for the first; ignored if the whole robot fails.
    pub cable: usize,
    /// When.
    pub when: When,
    /// Strength, 1 as described by [`How`]: slips, offsets and rates are multiplied by it.
    pub strength: f64,
    /// After this time the cause disappears by itself, s; `None` for never.
    pub lasts_s: Option<f64>,
    /// A stiff hook catches the platform, which is a realistic cause of C2: instead of the
    /// injection that [`How`] describes for that row.
    pub snag: Option<Snag>,
    /// A supply is gone: instead of what [`How`] says of the row.
    pub supply: Option<Supply>,
}

/// Whose supply is gone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Supply {
    /// The board's; drives and brakes keep theirs, and the brakes close because nothing holds them
    /// open.
    Board,
    /// That of drives and brakes; the board keeps its own.
    Drives,
    /// The computer's: the host falls silent.
    Host,
    /// All of them.
    All,
}

impl Supply {
    /// Every supply, with its name on the command line.
    pub const ALL: [(Self, &'static str); 4] = [
        (Self::Board, "board"),
        (Self::Drives, "drives"),
        (Self::Host, "host"),
        (Self::All, "all"),
    ];
}

/// Where a hook holds the platform.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Snag {
    /// It holds the tool where it is.
    Fast,
    /// It holds the tool against motion along this direction, world.
    Against([f64; 3]),
}

/// Some faults, in one run.
#[derive(Debug, Clone, PartialEq)]
pub struct Scenario {
    /// Its name.
    pub name: String,
    /// The faults.
    pub injections: Vec<Injection>,
}

/// Greatest size of a scenario.
pub(crate) const MOST_INJECTIONS: usize = 32;

/// Time for a stopped robot to come to rest, µs: the two seconds of holding after a lost link, and
/// a stop.
const SETTLE_US: u64 = 4_000_000;

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
    let planned_height_m = planned_heights(model, task.clone())?;
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
        planned_height_m,
    ))
}

/// Height of the tool at each millisecond of the task's path time, m.
fn planned_heights(model: &Model, task: Task) -> Result<Vec<f64>, RunError> {
    let plan = Experiment::new(model, task).plan()?;
    let mut heights = Vec::new();
    while heights.len() as f64 * 1e-3 <= plan.timed.duration_s() {
        heights.push(plan.timed.tool_m(heights.len() as f64 * 1e-3)?.z);
    }
    Ok(heights)
}
