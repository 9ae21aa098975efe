//! A command that the page of `mcdpr serve` has started: it ends with the page's program, and gives the reason of
//! a failure in a form that the page can read.

use super::line::causes;
use crate::run::interrupted;
use miette::Diagnostic;
use serde_json::{Value, json};
use std::time::{Duration, Instant};

/// Begins the line on standard error that has the reason of a failure.
const FAILED: &str = "mcdpr-failed: ";
/// How often a command looks whether the page's program is still there.
#[cfg(unix)]
const LOOK: Duration = Duration::from_millis(50);
/// A command that was interrupted has this long to stop its robot. Without the command the board stops it.
#[cfg(unix)]
const STOPPED: Duration = Duration::from_secs(10);

/// Interrupts this program when the page's program (`page`) ends, however it ends: a robot must not be moved by a
/// program that nobody sees.
#[cfg(unix)]
pub(super) fn watch(page: u32) {
    let watching = move || {
        while std::os::unix::process::parent_id() == page {
            std::thread::sleep(LOOK);
        }
        eprintln!("the program of the page has ended: this one stops, too");
        let began = Instant::now();
        mcdpr_core::run::interrupt();
        while began.elapsed() < STOPPED && interrupted() {
            std::thread::sleep(LOOK);
        }
        std::process::exit(130);
    };
    let thread = std::thread::Builder::new().name("page's program".to_owned());
    if let Err(error) = thread.spawn(watching) {
        eprintln!("warning: this command may outlast the program of its page: {error}");
    }
}

/// The reason of a failure and what to do, in one line.
pub(super) fn in_one_line(error: &dyn Diagnostic) -> String {
    let next = error.help().map(|help| help.to_string());
    let reason = causes(error);
    format!("{FAILED}{}", json!({ "reason": reason, "next": next }))
}

/// Reason and next step of such a line.
pub(super) fn reason_of(line: &str) -> Option<(String, Option<String>)> {
    let value: Value = serde_json::from_str(line.strip_prefix(FAILED)?).ok()?;
    let next = value["next"].as_str().map(str::to_owned);
    Some((value["reason"].as_str()?.to_owned(), next))
}

#[cfg(test)]
mod tests {
    use super::super::line::in_words;
    use super::*;

    #[derive(Debug, thiserror::Error, Diagnostic)]
    #[error("cable {cable} is slack")]
    #[diagnostic(help("wind it"))]
    struct Slack {
        cable: usize,
    }

    #[test]
    fn a_reason_survives_the_line() {
        let line = in_one_line(&Slack { cable: 2 });
        assert!(!line.contains('\n'));
        let found = reason_of(&line);
        let wanted = ("cable 2 is slack".to_owned(), Some("wind it".to_owned()));
        assert_eq!(found, Some(wanted));
        assert_eq!(in_words(&Slack { cable: 2 }), "cable 2 is slack; wind it");
        assert_eq!(reason_of("cable 2 is slack"), None);
    }
}
