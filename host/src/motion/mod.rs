//! Motion planning: paths, time laws and splines; the robot at equilibrium along them; plans.

pub mod knots;
mod model;
pub mod path;
mod plan;
pub mod spline;
mod spline_solve;
#[cfg(test)]
mod spline_tests;
mod task;
pub mod time_law;

pub use model::{Model, Rest};
pub use plan::{Leg, Plan, PlanError, TOLERANCE_M, Timed};
pub use task::{BUILT_IN, Task, TaskError};
