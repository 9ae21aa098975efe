//! Signals of the system as a request to stop.

use std::sync::atomic::{AtomicBool, Ordering};

/// Whether there is no robot to stop, so that a signal ends the program at once.
static ALONE: AtomicBool = AtomicBool::new(false);

/// Starts to watch for Ctrl-C, hang-up and termination. A second one ends the program at once (the
/// board then stops by itself).
///
/// # Errors
/// If the system refuses a handler.
pub(crate) fn watch_for_interrupts() -> Result<(), ctrlc::Error> {
    ctrlc::set_handler(|| {
        if ALONE.load(Ordering::SeqCst) || mcdpr_core::run::interrupt() {
            std::process::exit(130);
        }
    })
}

/// While this exists, no robot is connected: a long computation needs no orderly end, and a signal
/// ends the program at once.
pub(crate) struct Alone(());

impl Alone {
    pub(crate) fn begin() -> Self {
        ALONE.store(true, Ordering::SeqCst);
        Self(())
    }
}

impl Drop for Alone {
    fn drop(&mut self) {
        ALONE.store(false, Ordering::SeqCst);
    }
}
