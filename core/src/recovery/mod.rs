//! The robot's position after a loss of power: from the journal, the model of the drums until their brakes
//! hold, and the readings of sensors and camera; and whether the robot may continue.
//!
//! [`journal`] is the file that survives: the last states of a run in records with checksums. [`cut`]
//! models the drums between the cut and the closed brakes, with covariance. [`looks`] finds motion and
//! slack cables in the readings. `fuse` estimates by lengths, tensions and tags with least squares.
//! [`mod@reference`] is where the camera saw the tags when the robot was homed.
//! [`gentle`] locates by winding one cable after the other. [`verdict`] accepts with a bound, or refuses and
//! names the next measurement.

pub mod cut;
pub(crate) mod fuse;
pub mod gentle;
pub mod journal;
pub mod looks;
pub mod reference;
pub mod verdict;
mod weigh;

pub use journal::{Identity, Journal, JournalError, Kept, Plan};
pub use verdict::{Evidence, Source, Verdict, judge};
pub use weigh::reference_of;
