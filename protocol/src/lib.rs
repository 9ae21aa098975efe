//! The wire format between a host and a winch board, and its only definition.
//!
//! A byte stream (UART, USB-UART bridge, pseudo-terminal or memory) carries frames in both
//! directions. A frame is `COBS(channel, body, CRC-32) 0x00`, at most [`frame::MAX_FRAME`] bytes;
//! see [`frame`]. What the body means depends on the channel:
//!
//! | channel | direction | body |
//! |---|---|---|
//! | [`Channel::HelloQuery`] | host to board | empty |
//! | [`Channel::Hello`] | board to host | [`Hello`], frozen byte layout for all versions |
//! | [`Channel::Command`] | host to board | [`Command`], postcard |
//! | [`Channel::Answer`] | board to host | [`Answer`], postcard |
//! | [`Channel::Samples`] | board to host | [`SampleBlock`], postcard, best effort |
//! | [`Channel::Status`] | board to host | [`Status`], postcard, best effort |
//!
//! # Lifecycle of a command
//! Requests that change something carry a sequence number; the board executes them strictly in
//! order and exactly once ([`Request::is_sequenced`]). The host may have [`WINDOW`] of them in
//! progress. A repeated frame is answered from the board's cache, a frame out of order is refused
//! with [`Reject::Sequence`], which names the number that the board waits for. Queries, heartbeats
//! and stops are idempotent: they are executed whenever they arrive, and a stop needs no session.
//!
//! # Refusals, faults and warnings
//! [`Reject`] refuses one request and changes nothing. [`FaultId`] is latched on the board with its
//! first cause and tick, has a stable number and needs an explicit clear. [`Limit`] is a warning: a
//! value is near its limit.
//!
//! # Versions
//! Enums and structs are append-only. While the major version is 0 the minor version must be equal,
//! too; see [`Hello::compatibility`]. Golden bytes are in `tests/golden.rs`.
#![no_std]

pub mod config;
mod faults;
pub mod frame;
mod hello;
mod list;
pub mod message;
mod motion;
pub mod stop;
pub mod telemetry;
mod units;

pub use config::{BoardKey, CableKey, ConfigEntry, ConfigHash, ConfigKey, KeyMeaning, config_hash};
pub use faults::{FaultId, FaultRecord, Limit, Limits};
pub use frame::{Channel, Deframer, FrameError, encode_frame};
pub use hello::{Compatibility, Hello, ResetCause};
pub use list::{List, PerCable};
pub use message::{
    Answer, BENCH_FAULT_LINE, BENCH_OUTPUT_MS, BENCH_OUTPUTS, Bench, BenchTest, CanErrors, Command,
    Info, Kept, Reject, Reply, Request, SequenceNumber, SessionId, StopKind, Winch,
};
pub use motion::{CableKnot, Coefficient, Knot, ResidualRow};
pub use telemetry::{BoardState, Sample, SampleBlock, Status};
pub use units::{
    Micrometres, MicrometresPerSecond, Milliamps, Millinewtons, TenthMicrometres, Tick,
};

/// Version of the wire format: a board is never moved by a host of another major version.
pub const PROTOCOL_MAJOR: u16 = 0;
/// Minor version: additions only, once the major version is 1.
pub const PROTOCOL_MINOR: u16 = 4;

/// Most cables that one board can drive.
pub const MAX_CABLES: usize = 8;

/// Most sequenced requests in progress at once.
pub const WINDOW: u16 = 8;
