//! Orders to a robot that another thread is running, also from other processes of the same user.

#[cfg(unix)]
mod socket;

pub use mcdpr_core::control::*;
#[cfg(unix)]
pub(crate) use socket::call_all;
#[cfg(unix)]
pub use socket::{Server, SocketError, call};
