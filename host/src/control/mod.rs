//! Orders to a robot that is already being moved, also from other processes of the same user.

#[cfg(unix)]
mod socket;

pub use mcdpr_core::control::*;
#[cfg(unix)]
pub use socket::{Server, SocketError, call, call_all, live_sockets, runtime_dir};
