//! Orders to a robot that is already being moved, also from other processes of the same user.

#[cfg(unix)]
mod socket;

pub use mcdpr_core::control::*;
#[cfg(unix)]
pub(crate) use socket::call_all;
#[cfg(unix)]
pub use socket::{Server, SocketError, call};
