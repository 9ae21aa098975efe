//! Bin picking: look, choose, take, carry, release, repeat.
//!
//! The `Picker` works on any board behind a [`Link`](crate::link::Link) and any camera behind
//! [`Source`](mcdpr_vision::Source). The camera's pose follows from the state of the robot:
//! measured lengths and tensions give the platform's pose with its tilt, and the robot file has the
//! camera's pose on it. A grasp is a point and a closing direction in the picture; the tool moves
//! there with the attitude that the robot has when it hangs there, as low as its fingers have room
//! at that attitude.

mod arm;
mod budget;
mod calibrated;
mod choose;
mod error;
mod mat;
mod news;
pub(crate) mod place;
mod report;
mod resume;
pub mod study;
mod task;
pub(crate) mod workcell;

pub use arm::Arm;
pub use budget::{Budget, Uncertainty};
pub use calibrated::{calibrated, calibrated_by};
pub use choose::Choice;
pub use error::PickError;
pub use mat::{Mat, MatSight};
pub(crate) use news::{Chosen, News, Phase, Refusal, Tell};
pub use report::{Attempt, End, Jaws, Outcome, Report, Resumed};
pub(crate) use task::Picker;
pub use task::{Options, Watcher};
pub(crate) use workcell::SimulatedEye;
