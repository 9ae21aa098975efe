//! Where the robot is after a loss of power: what a journal kept, what the drums did until their
//! brakes held, what sensors and camera show now, and whether that is enough to go on.
//!
//! [`journal`] is what survives: the last states of a run, record by record, each with its own
//! checksum. [`cut`] is the model of what a drum does between the cut and the closed brake, with
//! covariance. [`fuse`] weighs lengths, tensions and tags by least squares. [`verdict`] accepts with
//! a bound, or refuses and says what to measure.

pub mod cut;
pub mod fuse;
pub mod journal;
pub mod looks;
pub mod verdict;
mod weigh;

pub use journal::{Identity, Journal, JournalError, Kept, Plan};
pub use verdict::{Evidence, Source, Verdict, judge};
