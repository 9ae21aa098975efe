//! The control core of a winch board, free of hardware.
//!
//! [`Controller::step`] is called once per millisecond with the board's measurements and returns
//! its outputs; [`Controller::handle`] answers requests between steps. Time is an argument, numbers
//! are fixed-point integers; the code does not allocate, block or panic. The same code runs inside
//! the simulator, inside an emulated chip and on the STM32F103.
//!
//! | module | what it is for |
//! |---|---|
//! | [`supervisor`] | states, events and their transition table |
//! | `controller` | one tick: measure, monitor, move, command |
//! | [`config`] | physical units from the wire, machine units for the tick |
//! | [`drives`] | bringing a drive into its mode |
//! | [`encoder`] | 16-bit counters to 64-bit positions, glitches rejected |
//! | [`segment`] | motion buffer and Hermite cubics in fixed point |
//! | [`adc`] | valid readings of a tension channel |
//! | [`supply`] | effect of the converter's supply on a reading |
//! | [`tension`] | sensor law and tension laws (Eq. 1, Eq. 52) |
//! | `arming`, `proof` | checks before brakes open, and before torque is switched off |
//! | [`watch`] | fault detectors |
//! | [`server`] | sessions, sequence numbers and frames in front of the controller |
//! | [`cycle`] | the steps of a board in each millisecond, in one order on chip and simulator |
//! | [`link`] | bytes to commands, answers and telemetry to bytes, below the tick |
//! | [`io`] | inputs and outputs of a tick |
//! | [`kept`] | lengths that outlive a reset |
#![no_std]

#[cfg(test)]
extern crate std;

pub mod adc;
mod arming;
pub mod axis;
pub mod config;
mod controller;
pub mod cycle;
pub mod drives;
pub mod encoder;
mod fixed;
pub mod io;
pub mod kept;
pub mod link;
pub mod motion;
mod proof;
pub mod sampler;
pub mod segment;
pub mod server;
pub mod supervisor;
pub mod supply;
pub mod tension;
pub mod watch;

pub use config::{Active, CableConfig, ConfigStore};
pub use controller::Controller;
pub use cycle::Cycle;
pub use io::{Brake, DriveDemand, DriveInput, Inputs, Outputs};
pub use server::Server;
pub use supervisor::{Event, Reaction, State};
