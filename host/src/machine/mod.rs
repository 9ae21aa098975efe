//! The robot description as physics for the simulator, with the board in front of it.

mod boarded;
mod firmware;

use crate::robot::Robot;
pub(crate) use boarded::line_to;
pub use boarded::{simulate_unloaded, with_board};
pub use firmware::{Controller, Firmware, FirmwareError};
pub use mcdpr_core::machine::*;
pub use mcdpr_twin::plant::{GearMismatch, Mismatch, Source, at_rest, hang, plant_params};

/// The machine of a robot that was calibrated on the simulator: as it was designed, with the errors and the seed
/// that it was calibrated with. Homed anew since, and its cells have drifted, unless `session` is 0. `None` for any
/// other robot.
pub(crate) fn of_calibration(robot: &Robot, session: u64) -> Option<(&Robot, Mismatch, u64)> {
    let calibrated = robot.calibrated.as_deref()?;
    let seed = calibrated.simulated_seed?;
    let kind = calibrated.simulated_machine.as_deref();
    let built = kind
        .and_then(Mismatch::named)
        .unwrap_or(Mismatch::as_built());
    Some((&calibrated.designed, built.in_session(session), seed))
}
