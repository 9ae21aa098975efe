//! What planning needs of a session, so that another thread can plan while the board is kept fed.

use super::RunError;
use super::tracking::Tracking;
use crate::estimate::tube::{Doubts, Tube};
use crate::motion::{Model, Plan, PlanError, Step, Task, TaskError};
use nalgebra::{Matrix6, Rotation3, Vector3};

/// From where, and with which model, plans are made.
pub struct Planning {
    pub(super) model: Model,
    pub(super) tool_m: Vector3<f64>,
    pub(super) attitude: Rotation3<f64>,
    pub(super) tracking: Option<Tracking>,
}

impl Planning {
    /// Plans a task.
    ///
    /// # Errors
    /// The first limit that would be broken.
    pub fn plan(&self, task: Task, speed_mps: Option<f64>) -> Result<Plan, RunError> {
        plan_turned(&self.model, task, &self.tool_m, self.attitude, speed_mps)
    }

    /// Plans steps from where the tool is.
    ///
    /// # Errors
    /// The first limit that would be broken.
    pub fn steps(&self, steps: &[Step]) -> Result<Plan, PlanError> {
        Plan::turned(&self.model, &self.tool_m, self.attitude, steps)
    }

    /// The model that plans are made with.
    #[must_use]
    pub const fn model(&self) -> &Model {
        &self.model
    }

    /// Where the tool is, world, m.
    #[must_use]
    pub const fn tool_m(&self) -> Vector3<f64> {
        self.tool_m
    }

    /// The tube of a plan by what is tracked, at the end of the plan; `before` is that of the plan that the robot followed
    /// last, whose swing is not over. `None` without tracking, and where the platform does not hang firmly enough.
    ///
    /// # Errors
    /// None for a plan that was made.
    pub fn tube(
        &self,
        plan: &Plan,
        doubts: &Doubts,
        before: Option<&Tube>,
    ) -> Result<Option<Tube>, PlanError> {
        let Some(tracking) = &self.tracking else {
            return Ok(None);
        };
        let belief = tracking.belief(plan.timed.duration_s(), doubts);
        let swings = before.map_or_else(Matrix6::zeros, |before| before.swings);
        Tube::after(plan, &belief, &swings)
    }
}

/// As [`plan_from`], from an attitude (world_from_platform).
fn plan_turned(
    model: &Model,
    task: Task,
    start_m: &Vector3<f64>,
    attitude: Rotation3<f64>,
    speed_mps: Option<f64>,
) -> Result<Plan, RunError> {
    let task = approached(task, start_m, attitude, speed_mps)?;
    Ok(Plan::turned(model, start_m, attitude, &task.steps)?)
}

/// The plan for a task from a position of the tool (world, m); the move to its start keeps
/// `speed_mps`.
///
/// # Errors
/// The first limit that would be broken.
pub fn plan_from(
    model: &Model,
    task: Task,
    start_m: &Vector3<f64>,
    speed_mps: Option<f64>,
) -> Result<Plan, RunError> {
    plan_turned(model, task, start_m, Rotation3::identity(), speed_mps)
}

/// As [`plan_from`], from an attitude (world_from_platform), without judging it: to show what a task
/// would do.
///
/// # Errors
/// Why it cannot be followed at all.
pub fn preview(
    model: &Model,
    task: Task,
    start_m: &Vector3<f64>,
    attitude: Rotation3<f64>,
) -> Result<Plan, RunError> {
    let task = approached(task, start_m, attitude, None)?;
    Ok(Plan::unjudged_turned(
        model,
        start_m,
        attitude,
        &task.steps,
    )?)
}

/// The task with the way to its start.
pub(super) fn approached(
    task: Task,
    start_m: &Vector3<f64>,
    attitude: Rotation3<f64>,
    speed_mps: Option<f64>,
) -> Result<Task, PlanError> {
    let approached = task.approached_turned(start_m, Some(attitude), speed_mps);
    approached.map_err(|error| match error {
        TaskError::Path(error) => PlanError::from(error),
        // Joining a move to a valid task can fail only in the path.
        _ => PlanError::from(crate::motion::path::PathError::Empty),
    })
}
