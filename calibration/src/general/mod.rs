//! Calibration with any combination of sensors.
//!
//! Every reading is one row of one weighted problem, every sensor may be missing, and the scatter
//! of every kind of reading is estimated from the data. Gains and zeros of load cells, gains of
//! drums, offsets of homings, the mounting of an inclinometer and the loss of pulleys are unknowns
//! with priors as wide as the errors of real machines; the equations of equilibrium have a
//! residual.
//!
//! | file | what it is for |
//! |---|---|
//! | [`data`], `read`, `outside_read` | samples by session, from files |
//! | `clock` | times that cannot be right |
//! | `unknowns`, [`model`] | what is unknown, and what each reading says about it |
//! | `outside` | trackers and tapes |
//! | [`solve`], [`mod@fit`] | one weighted problem; the scatter of the readings |
//! | [`mod@predict`] | readings that were left out, with intervals |
//! | [`slip`] | cables that slipped while samples were taken |
//! | [`mod@simulate`] | data of a known machine, as such machines are found |
//! | [`verdict`] | what the data do not fix, contradict or do not fit |
//! | [`first`] | the first pose from changes only |
//! | [`study`] | how well readings that were not seen are predicted |

mod clock;
pub mod data;
pub mod first;
pub mod fit;
mod group;
pub mod model;
mod outside;
mod outside_read;
pub mod predict;
mod read;
pub mod simulate;
pub mod slip;
pub mod solve;
pub mod study;
pub(crate) mod unknowns;
pub mod verdict;

pub use data::Set;
pub use fit::{Fit, Options, fit};
pub use predict::{Given, predict};
pub use unknowns::Priors;

#[cfg(test)]
mod tests;
#[cfg(test)]
mod tests_outside;
