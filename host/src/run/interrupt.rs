//! Ctrl-C, hang-up and termination become a flag that the feeding loop reads: the robot is always
//! stopped by the same thread that moves it.

use std::sync::atomic::{AtomicBool, Ordering};

static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// Starts to watch. A second interrupt ends the program at once (the board then stops by itself).
///
/// # Errors
/// Where the system refuses a handler.
pub fn watch_for_interrupts() -> Result<(), ctrlc::Error> {
    ctrlc::set_handler(|| {
        if INTERRUPTED.swap(true, Ordering::SeqCst) {
            std::process::exit(130);
        }
    })
}

/// Whether the user wants to stop.
#[must_use]
pub fn interrupted() -> bool {
    INTERRUPTED.load(Ordering::SeqCst)
}
