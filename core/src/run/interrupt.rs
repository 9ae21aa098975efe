//! Ctrl-C, hang-up and termination become a flag that the feeding loop reads: the robot is always
//! stopped by the same thread that moves it.

use std::sync::atomic::{AtomicBool, Ordering};

static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// Records that the user wants to stop. Returns whether a stop was already requested.
pub fn interrupt() -> bool {
    INTERRUPTED.swap(true, Ordering::SeqCst)
}

/// Whether the user wants to stop.
#[must_use]
pub fn interrupted() -> bool {
    INTERRUPTED.load(Ordering::SeqCst)
}
