//! Self-calibration on a robot: measuring the poses, and the calibration as a file.
//!
//! The estimators are a crate of their own, `mcdpr_calibration`.

pub mod at_rest;
pub mod collect;
pub(crate) mod history;
pub mod result;

pub use mcdpr_calibration::*;
