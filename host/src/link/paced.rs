//! Virtual time that keeps pace with real time: a simulated robot to watch and to jog.

use super::{Link, LinkError, Note};
use std::time::{Duration, Instant};

/// A link in virtual time that waits, so that its time never runs ahead of real time times a scale.
/// The bytes on it are the same as without; only the pace differs.
#[derive(Debug)]
pub(crate) struct Paced<L> {
    inner: L,
    began: Instant,
    first_us: u64,
    scale: f64,
}

impl<L: Link> Paced<L> {
    /// Starts to keep pace now; `scale` is simulated seconds per second, over 0.
    #[must_use]
    pub fn new(inner: L, scale: f64) -> Self {
        Self {
            first_us: inner.now_us(),
            inner,
            began: Instant::now(),
            scale,
        }
    }
}

impl<L: Link> Link for Paced<L> {
    fn now_us(&self) -> u64 {
        self.inner.now_us()
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.inner.send(bytes)
    }

    fn receive(&mut self, until_us: u64, into: &mut Vec<u8>) -> Result<u64, LinkError> {
        let now_us = self.inner.receive(until_us, into)?;
        let since_s = now_us.saturating_sub(self.first_us) as f64 * 1e-6 / self.scale;
        let ahead = since_s - self.began.elapsed().as_secs_f64();
        // A sleep is not accurate to half a millisecond anyway.
        if ahead > 5e-4 && ahead.is_finite() {
            // At most a second at once: a jump of the clock must not block the link for long.
            std::thread::sleep(Duration::from_secs_f64(ahead.min(1.0)));
        }
        Ok(now_us)
    }

    fn note(&mut self, note: Note<'_>) {
        self.inner.note(note);
    }
}
