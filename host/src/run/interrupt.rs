//! Signals of the system as a request to stop.

/// Starts to watch for Ctrl-C, hang-up and termination. A second one ends the program at once (the
/// board then stops by itself).
///
/// # Errors
/// If the system refuses a handler.
pub(crate) fn watch_for_interrupts() -> Result<(), ctrlc::Error> {
    ctrlc::set_handler(|| {
        if mcdpr_core::run::interrupt() {
            std::process::exit(130);
        }
    })
}
