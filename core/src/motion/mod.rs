//! Motion planning: paths, time laws and splines; the robot at equilibrium along them; plans.

mod allowance;
mod bent;
mod bounds;
mod curve;
mod drift;
mod fitting;
mod flank;
mod gcode;
mod grid;
pub mod knot;
pub mod knots;
mod margin;
mod model;
mod options;
pub mod path;
mod plan;
mod posed;
mod resume;
mod schedule;
mod shaper;
pub mod spline;
mod spline_solve;
#[cfg(test)]
mod spline_tests;
mod task;
pub mod time_law;
mod timed;
mod track;
mod verdict;
mod wire;

pub use drift::Drift;
pub use fitting::{PAPER, PAPER_HEIGHT_M};
pub use gcode::{GCODE_ENDINGS, is_gcode};
pub use grid::rests_on_grid;
pub use margin::Margin;
pub use model::{Model, StaticState};
pub use options::{PlanOptions, Planner, Shaping, Tensioning};
pub use plan::{Plan, PlanError};
pub(crate) use resume::remaining;
pub use resume::{Interruption, Resumed};
pub use shaper::Shaper;
pub use task::{BUILT_IN, FITTING, Task, TaskError};
pub use timed::{Action, Step, Timed, TimedAction};
pub use verdict::{Extremes, Watch, judge_place};
