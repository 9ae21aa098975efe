//! Byte streams to a board that need an operating system or the simulator, and background work.

mod meanwhile;
mod paced;
mod serial;
mod simulated;

pub use mcdpr_core::faults::{advice, describe_fault, describe_reject};
pub use mcdpr_core::link::*;
pub(crate) use meanwhile::meanwhile;
pub(crate) use paced::Paced;
pub(crate) use serial::list_ports;
pub use serial::{BAUD, SerialLink};
pub use simulated::SimulatedLink;
pub(crate) use simulated::plant_failed;
