//! The line to the simulated robot, which keeps pace with the page's clock.

use super::Stage;
use mcdpr_core::link::{Link, LinkError, Note};
use std::cell::Cell;

/// Work between two moments for the page, ms: half of a picture at 60 a second.
const SLICE_MS: f64 = 8.0;
/// A page that was hidden for longer than this does not catch up, ms.
const CATCH_UP_MS: f64 = 200.0;

/// Simulated time against the page's clock.
#[derive(Debug, Default)]
pub(crate) struct Pace {
    /// The page's time at which the present slice of work began, ms.
    slice_ms: Cell<f64>,
    /// The page's time and the simulated time from which pace is kept, ms.
    from_ms: Cell<Option<(f64, f64)>>,
}

/// A line that pauses while its time is ahead of the page's, and where the page's orders are executed.
pub(crate) struct Paced<'a, L> {
    pub(crate) inner: L,
    pub(crate) stage: &'a Stage<'a>,
}

impl<L: Link> Paced<'_, L> {
    fn keep_pace(&self, simulated_us: u64) -> Result<(), LinkError> {
        let (stage, pace) = (self.stage, &self.stage.pace);
        let simulated_ms = simulated_us as f64 * 1e-3;
        let now_ms = stage.host.now_ms();
        let (from_ms, first_ms) = pace.from_ms.get().unwrap_or((now_ms, simulated_ms));
        let ahead_ms = (simulated_ms - first_ms) - (now_ms - from_ms);
        // From here on, after a jump of either clock.
        let anew = ahead_ms.abs() > CATCH_UP_MS;
        pace.from_ms.set(Some(if anew {
            (now_ms, simulated_ms)
        } else {
            (from_ms, first_ms)
        }));
        if ahead_ms > 1.0 || now_ms - pace.slice_ms.get() > SLICE_MS {
            stage.host.pause(ahead_ms.clamp(0.0, CATCH_UP_MS));
            pace.slice_ms.set(stage.host.now_ms());
            stage.attend();
        }
        if stage.is_over() {
            return Err(LinkError::Broken {
                reason: "the simulation begins anew".to_owned(),
            });
        }
        Ok(())
    }
}

impl<L: Link> Link for Paced<'_, L> {
    fn now_us(&self) -> u64 {
        self.inner.now_us()
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.inner.send(bytes)
    }

    fn receive(&mut self, until_us: u64, into: &mut Vec<u8>) -> Result<u64, LinkError> {
        let now_us = self.inner.receive(until_us, into)?;
        self.keep_pace(now_us)?;
        Ok(now_us)
    }

    fn note(&mut self, note: Note<'_>) {
        self.inner.note(note);
    }
}
