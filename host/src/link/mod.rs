//! Byte streams to a board that need an operating system or the simulator, and work beside them.

mod meanwhile;
mod paced;
mod serial;
mod simulated;

pub use mcdpr_core::faults::{advice, describe_fault, describe_reject};
pub use mcdpr_core::link::*;
pub use meanwhile::meanwhile;
pub use paced::Paced;
pub use serial::{BAUD, PortInfo, SerialLink, list_ports};
pub use simulated::{SimulatedLink, plant_failed};
