//! The platform's position and how it hangs, from all measurements: lengths of the drum encoders,
//! tensions at the winches, tags in pictures.
//!
//! The unknowns are the tool's position and the tension of the tension-held cable, four numbers: at
//! rest statics give the attitude, every length and every tension from them. Three more describe
//! how far the attitude differs from that of statics (a centre of mass 1 mm off tilts the platform
//! by 1 to 2 mrad). They are held near zero by their own standard deviation; only pictures observe
//! them. Four lengths and four tensions are eight rows for these four unknowns, a tag adds eight
//! more. The disagreement between the rows is the redundancy residual: a cable that slipped on its
//! drum shows in it.
//!
//! A platform that six lengths hold takes any attitude (`held`): its pose is six unknowns, statics say nothing of it,
//! and the tensions only stretch the cables. Eight cables leave two rows over.
//!
//! Weighted least squares (Gauss, 1809; steps after Levenberg, 1944, and Marquardt, 1963) with the
//! rows' standard deviations, which are assumptions that a user can change.

mod fix;
pub mod friction;
mod held;
mod newton;
pub(crate) mod region;
mod rows;
mod slip;
pub mod track;
pub mod tube;

pub use fix::{Estimate, EstimateError, estimate};
pub use rows::{Measurements, Sigmas};
pub(crate) use rows::{Supposed, residuals};
pub use slip::{Slip, find_slip};
