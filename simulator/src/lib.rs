//! The simulated robot: everything except the control core.
//!
//! The [`plant`] is the physics: a rigid platform on unilateral elastic cables over swivel pulleys,
//! geared winches with drives and brakes, and the sensors that a board reads. It shares no geometry
//! and no force law with the solvers that are tested against it.
//!
//! The [`camera`] renders the pictures of a camera on the platform: tags, a tray, objects.
//!
//! The virtual board is the real control core with simulated pins; a serial line connects it to a
//! host: [`Simulation`] has all three in virtual time. The board reaches its drives over the
//! [`can`] bus.

mod board;
pub mod camera;
pub mod can;
mod overheard;
pub mod plant;
mod simulation;
mod wire;

pub use board::{BoardFailure, VirtualBoard};
pub use overheard::{BEHIND_TICKS, Overheard, Positions};
pub use simulation::several::{BoardPlace, BoardPoint, BoardTime, FaultLineTap};
pub use simulation::{Simulation, TracePoint};
pub use wire::{LinkOptions, Wire, WireFaults, WireVersion};
