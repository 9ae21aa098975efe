//! The simulated robot: everything that is not the control core.
//!
//! The [`plant`] is the physics: a rigid platform on unilateral elastic cables over swivel
//! pulleys, geared winches with drives and brakes, and the sensors a board reads. It shares no
//! geometry and no force law with the solvers that are tested against it.
//!
//! The [`camera`] renders what a camera on the platform would see: tags, a tray, objects.
//!
//! Around it stand the virtual board, which is the real control core on simulated pins, and the
//! serial line to a host: [`Simulation`] has all three in virtual time. The board
//! reaches its drives over the [`can`] bus.

mod board;
pub mod camera;
pub mod can;
pub mod plant;
mod simulation;
mod wire;

pub use board::VirtualBoard;
pub use simulation::{LinkOptions, Simulation, TracePoint};
pub use wire::{Wire, WireFaults};
