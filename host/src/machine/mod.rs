//! The robot description as physics for the simulator, with the board that stands in front of it.

mod firmware;
mod plant;

pub use firmware::{Firmware, FirmwareError, choose_firmware, chosen_firmware};
pub use mcdpr_core::machine::*;
pub use plant::{
    GearMismatch, Mismatch, hang, plant_params, simulate, simulate_unloaded, simulate_unloaded_on,
    with_board,
};
