//! Tension: experiments on its loop, their figures, and what tunes and calibrates it.
//!
//! Everything here goes through a [`crate::link::Link`], as a run does. On the simulator the truth
//! is read behind the client's back, and a simulated hand pulls.

mod bench;
pub(crate) mod calibrate;
mod draw;
mod hold;
mod measure;
pub mod rig;
mod study;
mod task;
pub(crate) mod tune;
pub mod winch_study;

pub use bench::{Bench, Change, Hand, Script, Trace};
pub use draw::{Curve, draw};
pub use hold::hold;
pub use measure::{Recovery, Steady, at_rest, recovery};
pub use study::{Column, Row, columns, study};
pub use task::{BUILT_IN, Experiment, ExperimentError};
