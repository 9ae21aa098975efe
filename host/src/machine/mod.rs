//! The robot description as physics for the simulator, with the board in front of it.

mod boarded;
mod firmware;

pub(crate) use boarded::line_to;
pub use boarded::{simulate_unloaded, with_board};
pub use firmware::{Controller, Firmware, FirmwareError};
pub use mcdpr_core::machine::*;
pub use mcdpr_twin::plant::{GearMismatch, Mismatch, at_rest, hang, plant_params};
