//! Tension: experiments on its loop, their figures, tuning and calibration.
//!
//! Everything here uses a [`crate::link::Link`], like a run. On the simulator the true state is
//! read independently of the client, and a simulated hand pulls.

mod bench;
pub(crate) mod calibrate;
mod hold;
mod measure;
pub mod rig;
mod study;
mod task;
pub(crate) mod tune;
pub mod winch_study;

pub use bench::{Action, Bench, Change, Hand, Script, Trace};
pub use hold::hold;
pub use measure::{Recovery, Steady, at_rest, recovery};
pub use study::{Column, Row, columns, study};
pub use task::{BUILT_IN, Experiment, ExperimentError, Prompt};
