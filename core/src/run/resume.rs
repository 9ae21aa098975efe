//! Continuing a task that a loss of power interrupted.

use super::RunError;
use super::planning::approached;
use crate::motion::{Action, Interruption, Model, Plan, Planner, Resumed, Step, Task, remaining};
use crate::recovery::{Journal, JournalError};
use mcdpr_protocol::{BoardState, Status};
use miette::Diagnostic;
use nalgebra::{Rotation3, Vector3};
use thiserror::Error;

/// The same task makes a plan of the same duration, within this, s.
const SAME_S: f64 = 1.5e-3;
/// The journal's last state before the end of a motion is at most so old, s.
const LAST_S: f64 = 0.1;
/// Longest way back to the path, m. The space between is not known to be free over a longer one.
const MOST_WAY_BACK_M: f64 = 0.05;

/// Why a task is not continued. Nothing has moved.
#[derive(Debug, Clone, PartialEq, Error, Diagnostic)]
pub enum ResumeError {
    /// There is no valid journal.
    #[error("the task is not continued: {0}")]
    #[diagnostic(code(mcdpr::resume::journal), help("run the task from its start"))]
    Journal(JournalError),
    /// Another task was interrupted.
    #[error("the journal is of the task {journal}, or of another version of {asked}")]
    #[diagnostic(
        code(mcdpr::resume::task),
        help(
            "name the task that was interrupted, with the same file and options; or run this one from its start"
        )
    )]
    Task {
        /// The task in the journal.
        journal: String,
        /// The task that is to be continued.
        asked: String,
    },
    /// The plan cannot be made again.
    #[error(
        "the interrupted motion took {journal_s:.3} s, this plan takes {now_s:.3} s: limits or options have changed"
    )]
    #[diagnostic(
        code(mcdpr::resume::changed),
        help("continue with the same robot file and options, or run the task from its start")
    )]
    Changed {
        /// Duration in the journal, s.
        journal_s: f64,
        /// Duration now, s.
        now_s: f64,
    },
    /// No motion was interrupted.
    #[error("no motion was interrupted: {state}")]
    #[diagnostic(code(mcdpr::resume::no_motion), help("run the task from its start"))]
    NoMotion {
        /// The state in the journal.
        state: &'static str,
    },
    /// The tool is far from the path.
    #[error(
        "the tool is {far_mm:.1} mm from the point of the path where it continues, {} mm are allowed",
        MOST_WAY_BACK_M * 1e3
    )]
    #[diagnostic(
        code(mcdpr::resume::far),
        help("jog the tool back, or run the task from its start")
    )]
    Far {
        /// The distance, mm.
        far_mm: f64,
    },
    /// The gripper is in another state than the path needs.
    #[error("the path continues with a gripper that {expected}, but {found}")]
    #[diagnostic(
        code(mcdpr::resume::gripper),
        help("put the object back where the task takes it, and run the task from its start")
    )]
    Gripper {
        /// The state that the path needs.
        expected: &'static str,
        /// The present state.
        found: &'static str,
    },
    /// Plans for a level platform begin with a move that no plan contains.
    #[error("a motion of the planner for a level platform is not continued")]
    #[diagnostic(code(mcdpr::resume::level), help("run the task from its start"))]
    Level,
}

impl From<ResumeError> for RunError {
    fn from(error: ResumeError) -> Self {
        Self::Resume(error)
    }
}

/// The rest of the journal's task, for a robot with its tool at `tool_m` (world, m): judged like
/// any plan.
///
/// # Errors
/// [`ResumeError`]; [`RunError::Plan`] where the rest breaks a limit.
pub(super) fn plan_rest(
    model: &Model,
    task: Task,
    journal: &Journal,
    status: &Status,
    tool_m: &Vector3<f64>,
) -> Result<Plan, RunError> {
    if model.options().planner == Planner::Level {
        return Err(ResumeError::Level.into());
    }
    let kept = journal.plan.as_ref().ok_or(ResumeError::NoMotion {
        state: "the journal has no plan",
    })?;
    if journal.path_ms == 0 {
        let state = "the motion had not begun";
        return Err(ResumeError::NoMotion { state }.into());
    }
    let start_m = Vector3::from(kept.start_m);
    let (mut steps, mut plan) = whole(model, task, &start_m)?;
    // The journal's path time counts from the last continuation: each is planned again, unjudged,
    // because it was judged before it moved.
    for interruption in &kept.interruptions {
        steps = remaining(model, &plan.timed, &steps, interruption)?.steps;
        plan = Plan::unjudged(model, &interruption.tool_m.into(), &steps)?;
    }
    let now_s = plan.timed.duration_s();
    if (now_s - kept.duration_s).abs() > SAME_S {
        return Err(ResumeError::Changed {
            journal_s: kept.duration_s,
            now_s,
        }
        .into());
    }
    let path_s = f64::from(journal.path_ms) * 1e-3;
    let rests = journal
        .last
        .as_ref()
        .is_some_and(|last| matches!(last.state, BoardState::Holding | BoardState::Disarmed));
    // A robot that rests at the end was sampled up to a tenth of a second before it.
    if path_s >= now_s || (rests && path_s > now_s - LAST_S) {
        let state = "the motion had reached its end";
        return Err(ResumeError::NoMotion { state }.into());
    }
    let interruption = Interruption {
        path_s,
        tool_m: (*tool_m).into(),
    };
    let rest = remaining(model, &plan.timed, &steps, &interruption)?;
    if rest.way_back_m > MOST_WAY_BACK_M {
        let far_mm = rest.way_back_m * 1e3;
        return Err(ResumeError::Far { far_mm }.into());
    }
    check_gripper(&plan, rest.from_s, journal, status)?;
    let mut interruptions = kept.interruptions.clone();
    interruptions.push(interruption);
    let plan = Plan::new(model, tool_m, &rest.steps)?;
    Ok(plan.resuming(Resumed {
        start_m: kept.start_m,
        interruptions,
    }))
}

/// The whole task from `start_m`, not judged again: it was, before it began.
fn whole(model: &Model, task: Task, start_m: &Vector3<f64>) -> Result<(Vec<Step>, Plan), RunError> {
    let task = approached(task, start_m, Rotation3::identity(), None)?;
    let plan = Plan::unjudged(model, start_m, &task.steps)?;
    Ok((task.steps, plan))
}

/// A gripper that lost its object, or holds one that the path does not expect, ends the task.
fn check_gripper(
    plan: &Plan,
    from_s: f64,
    journal: &Journal,
    status: &Status,
) -> Result<(), ResumeError> {
    let before = plan.timed.actions().iter().rev();
    let mut before = before.filter(|action| action.time_s < from_s);
    let planned = before.next().map(|timed| {
        let Action::Gripper { closed } = timed.action;
        closed
    });
    // Without a planned action before that point the last command in the journal counts.
    let kept = journal.last.as_ref().map(|last| last.gripper_closed);
    let closed = planned.or(kept).unwrap_or(false);
    let wrong = |expected, found| Err(ResumeError::Gripper { expected, found });
    match (closed, status.gripper_closed) {
        (true, false) => wrong("holds an object", "it is open"),
        (true, true) if status.gripper_switch => wrong("holds an object", "its jaws meet"),
        (false, true) => wrong("is open", "it is closed"),
        _ => Ok(()),
    }
}
