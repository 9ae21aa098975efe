//! Running a plan on a board: bring it up, stream the motion, keep what was measured, shut down.

mod explained;
mod interrupt;
pub mod jog;
mod orders;
mod planning;
mod record;
mod resting;
mod resume;
pub mod saved;
mod session;
mod stream;
pub mod tracking;

pub use explained::explained;
pub use interrupt::{interrupt, interrupted};
pub use orders::stop_wanted;
pub use planning::{plan_from, preview};
pub use record::{Measured, Recorder};
pub use resume::ResumeError;
pub use saved::{LengthStore, NoStore};
pub use session::{Homing, Session, Sight};
pub(crate) use stream::follow_plan;
pub use stream::{Halt, Progress, follow, follow_watched};

use crate::control::Order;
use crate::diagnosis::Diagnosis;
use crate::faults::{advice, describe_fault};
use crate::link::{Client, ClientError, Link};
use crate::machine::{self, OutOfRange};
use crate::motion::{Model, Plan, PlanError, Planner};
use crate::robot::{Control, Robot};
use mcdpr_protocol::message::CONFIG_CHUNK;
use mcdpr_protocol::{
    BoardState, ConfigEntry, ConfigHash, FaultId, FaultRecord, Knot, List, Request, Status,
    StopKind, TenthMicrometres,
};
use miette::Diagnostic;
use thiserror::Error;

/// Why a run ended early.
#[derive(Debug, Error, Diagnostic)]
pub enum RunError {
    /// The board, or the line to it.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Client(#[from] ClientError),
    /// The robot file does not fit a board.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Config(#[from] OutOfRange),
    /// The board latched a fault.
    #[error("stopped by fault {}{}", describe_fault(record), told(why.as_deref()))]
    #[diagnostic(code(mcdpr::run::fault), help("{}", advice(cause(record, why.as_deref()))))]
    Fault {
        /// The fault.
        record: FaultRecord,
        /// What the samples around it show, where they show another cause.
        why: Option<Box<Diagnosis>>,
    },
    /// The board still has the fault of an earlier run.
    #[error("the board has a latched fault, {}", describe_fault(record))]
    #[diagnostic(
        code(mcdpr::run::latched),
        help("{}; then `mcdpr clear --on PORT` acknowledges it", advice(record.fault))
    )]
    Latched {
        /// The fault.
        record: FaultRecord,
    },
    /// The user asked to stop.
    #[error("interrupted: the robot was stopped along its path, brakes are closed")]
    #[diagnostic(code(mcdpr::run::interrupted))]
    Interrupted,
    /// The user ordered an emergency stop.
    #[error("emergency stop: brakes and torque went off at once")]
    #[diagnostic(
        code(mcdpr::run::emergency),
        help("look at the robot, then acknowledge it with `mcdpr clear --on PORT`")
    )]
    Emergency,
    /// The board drives another number of cables than the robot has.
    #[error("the board drives {board} cables, the robot file describes {robot}")]
    #[diagnostic(code(mcdpr::run::cables), help("use the robot file of this machine"))]
    Cables {
        /// The board's number.
        board: u8,
        /// The file's number.
        robot: usize,
    },
    /// The board did not reach a state in time.
    #[error("the board did not become {wanted:?} within {seconds} s, it is {state:?}")]
    #[diagnostic(
        code(mcdpr::run::state),
        help("check the supplies of board and drives, then connect again")
    )]
    NoChange {
        /// The expected state.
        wanted: BoardState,
        /// The board's state.
        state: BoardState,
        /// How long was waited.
        seconds: f64,
    },
    /// The robot's position is unknown.
    #[error("the board does not know its cable lengths, and {reason}")]
    #[diagnostic(
        code(mcdpr::run::not_homed),
        help(
            "home the robot: `mcdpr home --at X Y Z` with its tool at a known place, or with a tag in view"
        )
    )]
    NotHomed {
        /// Why the saved lengths do not help.
        reason: saved::Implausible,
    },
    /// The camera sees no tag whose place is known.
    #[error("the camera sees no tag whose place is known")]
    #[diagnostic(
        code(mcdpr::run::no_tag),
        help("light the tag, or home at a taught place: `mcdpr home --at X Y Z`")
    )]
    NoTag,
    /// The camera gives no picture.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Sight(crate::sight::SightError),
    /// The measurements do not belong to any pose.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Estimate(crate::estimate::EstimateError),
    /// An interrupted task is not continued.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Resume(ResumeError),
    /// The task is invalid.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Task(#[from] crate::motion::TaskError),
    /// The plan cannot be made from where the robot is.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Plan(#[from] PlanError),
}

/// The addition to a fault's description; empty where nothing more is known.
fn told(why: Option<&Diagnosis>) -> String {
    why.map_or_else(String::new, |why| format!("; {why}"))
}

/// The fault to give advice about.
fn cause(record: &FaultRecord, why: Option<&Diagnosis>) -> FaultId {
    why.map_or(record.fault, |why| why.fault)
}

impl RunError {
    /// The program's exit code for this error.
    #[must_use]
    pub const fn exit_code(&self) -> i32 {
        match self {
            Self::Fault { .. } | Self::Latched { .. } => 3,
            Self::Interrupted | Self::Emergency => 130,
            _ => 1,
        }
    }
}

/// Reads the board's state.
///
/// # Errors
/// The client's.
pub fn status<L: Link>(client: &mut Client<L>) -> Result<Status, RunError> {
    Ok(client.ask_status()?)
}

/// Makes sure that the board has this robot's configuration. A board that has it keeps its
/// reference lengths.
///
/// # Errors
/// [`RunError::Cables`], [`RunError::Config`] or the client's.
pub fn configure<L: Link>(client: &mut Client<L>, robot: &Robot) -> Result<ConfigHash, RunError> {
    let board = client.info().cables;
    if usize::from(board) != robot.cables.len() {
        return Err(RunError::Cables {
            board,
            robot: robot.cables.len(),
        });
    }
    let entries = machine::configuration(robot)?;
    let hash = machine::hash_of(&entries);
    if status(client)?.config == Some(hash) {
        return Ok(hash);
    }
    send_configuration(client, &entries, hash)?;
    Ok(hash)
}

/// Sends a configuration and activates it on the board.
///
/// # Errors
/// The client's, where the board refuses it.
pub fn send_configuration<L: Link>(
    client: &mut Client<L>,
    entries: &[ConfigEntry],
    hash: ConfigHash,
) -> Result<(), RunError> {
    let count = u16::try_from(entries.len()).unwrap_or(u16::MAX);
    client.request(Request::ConfigBegin { entries: count })?;
    for chunk in entries.chunks(CONFIG_CHUNK) {
        let entries = List::collect(chunk.iter().copied());
        client.request(Request::ConfigPut { entries })?;
    }
    client.request(Request::ConfigCommit { hash })?;
    Ok(())
}

/// Enables drives, lets the board check itself, opens the brakes; returns when it holds.
///
/// # Errors
/// [`RunError::Fault`] names the check that failed; the brakes are closed then.
pub fn arm<L: Link>(client: &mut Client<L>, config_hash: ConfigHash) -> Result<(), RunError> {
    client.request(Request::Samples { enabled: true })?;
    client.request(Request::Arm { config_hash })?;
    // Arming takes 1.85 s on the paper's robot, and longer with more drums or with play in gears: 7 s with eight slack
    // cables. The board itself limits each of its steps.
    wait_for(client, BoardState::Holding, 12.0)
}

/// Closes the brakes under torque, switches torque off and gives the board back.
///
/// # Errors
/// The client's, or [`RunError::NoChange`].
pub fn disarm<L: Link>(client: &mut Client<L>) -> Result<(), RunError> {
    ask_to_disarm(client)?;
    // A stop takes 0.3 s, after a snag up to 2 s; then the brakes close and are tested.
    wait_for(client, BoardState::Disarmed, PARKS_S)?;
    // Given back: the next program is not refused as a second host (L14).
    client.request(Request::Close)?;
    Ok(())
}

/// Asks the board to disarm. One that has latched a fault refuses, and the fault is the news.
///
/// # Errors
/// [`RunError::Fault`], or the client's.
pub(super) fn ask_to_disarm<L: Link>(client: &mut Client<L>) -> Result<(), RunError> {
    let Err(refused) = client.request(Request::Disarm) else {
        return Ok(());
    };
    match status(client).ok().and_then(|status| status.fault) {
        Some(record) => Err(RunError::Fault { record, why: None }),
        None => Err(refused.into()),
    }
}

/// Waits until the board is in a state; a latched fault ends the wait.
///
/// # Errors
/// [`RunError::Fault`], [`RunError::NoChange`], [`RunError::Interrupted`].
pub fn wait_for<L: Link>(
    client: &mut Client<L>,
    wanted: BoardState,
    seconds: f64,
) -> Result<(), RunError> {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "some seconds"
    )]
    let give_up = client.now_us() + (seconds * 1e6) as u64;
    loop {
        let status = status(client)?;
        // Before the state: a board that stopped by a fault may also have reached the state in
        // question.
        if let Some(record) = status.fault {
            return Err(RunError::Fault { record, why: None });
        }
        if status.state == wanted {
            return Ok(());
        }
        if wanted == BoardState::Disarmed {
            orders::refuse_while(client, "the robot stops", true)?;
        } else if let Some(kind) = orders::stop_wanted(client) {
            return Err(stop_now(client, kind));
        } else {
            orders::refuse_while(client, "the robot gets ready", false)?;
        }
        if client.now_us() >= give_up {
            return Err(RunError::NoChange {
                wanted,
                state: status.state,
                seconds,
            });
        }
        let pause = client.now_us() + 10_000;
        client.pump(pause)?;
    }
}

/// Stops along the path, waits until the brakes are closed, gives the board back.
pub fn stop_now<L: Link>(client: &mut Client<L>, kind: StopKind) -> RunError {
    let stopped = client
        .stop(kind)
        .map_err(RunError::from)
        // Nobody executes waiting orders any more: they are refused before the wait for the brakes.
        .map(|()| client.handle().close("the robot was stopped"))
        .and_then(|()| torque_off(client))
        .and_then(|()| Ok(client.request(Request::Close)?));
    match stopped {
        Ok(_) if kind == StopKind::Emergency => RunError::Emergency,
        Ok(_) => RunError::Interrupted,
        Err(error) => error,
    }
}

/// Waits until a stop has ended. A fault on the way is reported; the board keeps it.
fn torque_off<L: Link>(client: &mut Client<L>) -> Result<(), RunError> {
    let emergency = client.handle().stop_ordered() == Some(Order::Emergency);
    match wait_for(client, BoardState::Disarmed, PARKS_S) {
        Err(
            RunError::Fault { .. }
            | RunError::NoChange {
                state: BoardState::Fault,
                ..
            },
        ) if emergency => Ok(()),
        outcome => outcome,
    }
}

/// The longest stop until torque is off, s: its path, the brakes and repeated tests of a brake behind the widest play.
pub const PARKS_S: f64 = 5.0;

/// A plan's start may differ from the board's set-points by this, m: elasticity at a tension that
/// is not quite the expected one.
/// 1 N stretches a metre of cable with EA = 50 kN by 0.02 mm.
const START_GAP_M: f64 = 1e-3;

/// A level plan may start this far from where the robot really hangs, m.
const LEVEL_GAP_M: f64 = 0.08;
/// Mean cable speed of the move to a level plan's start, m/s.
const LEAD_IN_MPS: f64 = 0.01;

/// The move from where the board holds the cables to the start of a plan for a level platform,
/// which differs because the platform does not hang level. `None` if there is no distance to move.
pub(crate) fn lead_in(plan: &Plan, status: &Status, model: &Model) -> Option<Vec<Knot>> {
    let level = model.options().planner == Planner::Level;
    level.then(|| settling(plan, status, model)).flatten()
}

/// The move from where the board holds the cables to the start of a plan, up to 80 mm of cable: after a load has
/// changed, the same place of the tool has other lengths. `None` if there is no distance to move, or too much.
#[must_use]
pub fn settling(plan: &Plan, status: &Status, model: &Model) -> Option<Vec<Knot>> {
    let wanted = plan.knots.first()?;
    let mut far_m: f64 = 0.0;
    let mut from = wanted.clone();
    let mut to = wanted.clone();
    for (index, setpoint) in status.setpoints.iter().enumerate() {
        let (Some(start), Some(end)) = (from.cables.get_mut(index), to.cables.get_mut(index))
        else {
            continue;
        };
        start.length = *setpoint;
        let held = model.robot().cables.get(index)?.control == Control::Tension;
        if !held {
            far_m = far_m.max(TenthMicrometres(end.length.0 - setpoint.0).metres().abs());
        }
        start.velocity.0 = 0;
        end.velocity.0 = 0;
    }
    // A small gap becomes an offset in `joined_to`; a large one is refused there, with its cable.
    if far_m <= START_GAP_M || far_m > LEVEL_GAP_M {
        return None;
    }
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "at most some seconds"
    )]
    // The board takes knots at most 4000 ms apart: over 39 mm this move is faster, up to 20 mm/s.
    let time_ms = ((far_m / LEAD_IN_MPS * 1e3) as u32).clamp(500, 3900);
    from.time_ms = 0;
    from.last = false;
    to.index = 1;
    to.time_ms = time_ms;
    to.last = true;
    Some(vec![from, to])
}

/// The plan's knots, moved so that each length-held cable starts exactly where the board holds it:
/// the difference between model and machine at rest stays a constant offset.
///
/// # Errors
/// [`PlanError::Limit`] where a cable is more than a millimetre from where the plan starts.
pub fn joined_to(
    plan: &Plan,
    status: &Status,
    model: &Model,
) -> Result<Vec<mcdpr_protocol::Knot>, RunError> {
    let mut knots = plan.knots.clone();
    let first = knots
        .first()
        .map(|knot| knot.cables.clone())
        .unwrap_or_default();
    let cables = model.robot().cables.iter();
    for (index, ((start, setpoint), cable)) in first
        .iter()
        .zip(status.setpoints.iter())
        .zip(cables)
        .enumerate()
    {
        if cable.control == Control::Tension {
            continue;
        }
        let gap = setpoint.0 - start.length.0;
        // The wire counts lengths in 0.1 um.
        let gap_m = f64::from(gap) * 1e-7;
        if gap_m.abs() > START_GAP_M {
            let tool_m = model.tool_m(&plan.start);
            return Err(PlanError::Limit {
                time_s: 0.0,
                x_mm: tool_m.x * 1e3,
                y_mm: tool_m.y * 1e3,
                z_mm: tool_m.z * 1e3,
                what: format!(
                    "the start of cable {}, from where the board holds it,",
                    index + 1
                ),
                value: gap_m * 1e3,
                limit: START_GAP_M * 1e3,
                unit: "mm",
            }
            .into());
        }
        for knot in &mut knots {
            if let Some(cable) = knot.cables.get_mut(index) {
                cable.length.0 += gap;
            }
        }
    }
    Ok(knots)
}
