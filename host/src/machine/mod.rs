//! The robot description as physics for the simulator, with the board in front of it.

mod firmware;
mod plant;

pub use firmware::{Controller, Firmware, FirmwareError};
pub use mcdpr_core::machine::*;
pub use plant::{GearMismatch, Mismatch, hang, plant_params, simulate_unloaded, with_board};
