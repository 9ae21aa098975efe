//! Byte streams to a board that need an operating system or the simulator, and background work.

mod meanwhile;
mod paced;
mod serial;
mod several;

pub use mcdpr_core::faults::{advice, describe_fault, describe_reject};
pub use mcdpr_core::link::*;
pub use mcdpr_twin::SimulatedLink;
pub(crate) use mcdpr_twin::line::plant_failed;
pub(crate) use meanwhile::meanwhile;
pub(crate) use paced::Paced;
pub(crate) use serial::list_ports;
pub use serial::{BAUD, SerialLink};
pub(crate) use several::{PortLink, SerialLines};
