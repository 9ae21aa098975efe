//! The simulated CAN bus and the drives on it.
//!
//! [`CanBus`] is the wires: arbitration by identifier, the time of every stuffed bit, error
//! counters, bus-off. [`DriveNodes`] are the drives' electronics: they implement RMDS or CiA 402
//! independently of the firmware, and command the motors of a [`Plant`]. [`DriveLine`] joins the
//! two for a board in the same process; an emulated chip has its own bus and needs only the nodes.

mod bus;
mod cia402;
mod line;
mod nodes;
mod objects;
mod rmds;
#[cfg(test)]
mod tests;
mod wire;

pub use bus::{BusCounters, BusFaults, CanBus, Delivery};
pub use line::{BoardPort, DriveLine};
pub use nodes::{DriveNodes, NodeFault, ObjectAddress};
pub use wire::frame_bits;

#[cfg(doc)]
use crate::plant::Plant;
