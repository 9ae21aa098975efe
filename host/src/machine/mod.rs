//! The robot description as physics for the simulator, with the board in front of it.

mod firmware;
mod plant;

pub(crate) use firmware::chosen_firmware;
pub use firmware::{Firmware, FirmwareError, choose_firmware};
pub use mcdpr_core::machine::*;
pub(crate) use plant::simulate_unloaded_on;
pub use plant::{
    GearMismatch, Mismatch, hang, plant_params, simulate, simulate_unloaded, with_board,
};
