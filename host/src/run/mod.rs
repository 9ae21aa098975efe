//! Running a plan on a board, with the parts that need the system: signals, files, numbers.

mod interrupt;
mod kept;

pub(crate) use interrupt::{Alone, watch_for_interrupts};
pub use kept::LengthFiles;
pub(crate) use kept::{TAG_VIEW, state_folder};
pub use mcdpr_core::run::*;

use mcdpr_protocol::SessionId;

/// A session number that differs from the last ones: from the time of day and the process.
#[must_use]
pub fn new_session() -> SessionId {
    let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    let nanos = since.map_or(1, |since| since.subsec_nanos() ^ low_half(since.as_secs()));
    // Two programs in the same nanosecond differ by their process number.
    SessionId((nanos ^ std::process::id().rotate_left(16)).max(1))
}

fn low_half(value: u64) -> u32 {
    u32::try_from(value & u64::from(u32::MAX)).unwrap_or(0)
}
