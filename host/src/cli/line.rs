//! A line to a robot that is opened again after it was lost, for programs that serve until they are interrupted.

use super::Outcome;
use crate::link::{ClientError, Link};
use crate::record::EventBus;
use crate::record::events::{TruthTap, Watched};
use crate::run::interrupted;
use miette::Diagnostic;
use std::time::{Duration, Instant};

/// Time between two attempts to reconnect to a robot whose line was lost.
const AGAIN: Duration = Duration::from_secs(1);
/// Meanwhile an order waits no longer than this for its refusal.
const LONGEST_REFUSAL: Duration = Duration::from_millis(10);

/// What follows a round.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Next {
    /// Another round.
    Again,
    /// The program ends.
    End,
    /// Somebody else needs the line for a while.
    Release,
}

/// Executes rounds until one says that the program ends. A lost line is opened again, and `lost` receives the reason
/// before each attempt; it says whether the program continues. `released` is called while the line is closed
/// for somebody else. Only at the start the line must exist, unless `patient`.
pub(super) fn keep_open<L: Link>(
    mut open: impl FnMut() -> Result<L, ClientError>,
    patient: bool,
    mut round: impl FnMut(&mut L) -> miette::Result<Next>,
    mut lost: impl FnMut(&str) -> bool,
    mut released: impl FnMut(),
) -> Outcome {
    let mut line = loop {
        match open() {
            Ok(line) => break line,
            Err(error) if !patient => return Err(error.into()),
            Err(error) if !lost(&in_words(&error)) => return Ok(()),
            Err(_) => {}
        }
    };
    loop {
        let mut reason = match round(&mut line) {
            Ok(Next::Again) => continue,
            Ok(Next::End) => return Ok(()),
            // A port admits one program: close it before somebody else opens it.
            Ok(Next::Release) => {
                drop(line);
                released();
                match open() {
                    Ok(again) => {
                        line = again;
                        continue;
                    }
                    Err(error) => in_words(&error),
                }
            }
            Err(error) => {
                drop(line);
                in_words(error.as_ref())
            }
        };
        line = loop {
            if !lost(&reason) {
                return Ok(());
            }
            match open() {
                Ok(line) => break line,
                Err(error) => reason = in_words(&error),
            }
        };
    }
}

/// Refuses all orders for a second; returns whether the program continues.
pub(super) fn refuse_for_a_while(mut refuse: impl FnMut()) -> bool {
    let until = Instant::now() + AGAIN;
    while Instant::now() < until {
        if interrupted() {
            return false;
        }
        refuse();
        std::thread::sleep(LONGEST_REFUSAL);
    }
    true
}

/// An error with its causes and its remedy, in one line.
pub(super) fn in_words(error: &dyn Diagnostic) -> String {
    let words = causes(error);
    match error.help() {
        Some(help) => format!("{words}; {help}"),
        None => words,
    }
}

/// An error with its causes, in one line.
pub(super) fn causes(error: &dyn Diagnostic) -> String {
    let mut words = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        words = format!("{words}: {error}");
        cause = error.source();
    }
    words
}

/// A line that watchers see, with the truth where there is one.
pub(super) fn watched<'a, L: Link>(
    link: L,
    events: &'a EventBus,
    tap: Option<&TruthTap>,
) -> Watched<'a, L, EventBus> {
    let watched = Watched::new(link, events);
    match tap {
        Some(tap) => watched.with_truth(tap.clone()),
        None => watched,
    }
}
