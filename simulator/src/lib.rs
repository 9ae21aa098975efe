//! The simulated robot: everything that is not the control core.
//!
//! The [`plant`] is the physics: a rigid platform on unilateral elastic cables over swivel
//! pulleys, geared winches with drives and brakes, and the sensors a board reads. It shares no
//! geometry and no force law with the solvers that are tested against it.

pub mod plant;
