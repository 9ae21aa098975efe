//! What a board measured, tick by tick.

use crate::link::client::unpacked;
use mcdpr_protocol::SampleBlock;

/// One tick of all cables, SI.
#[derive(Debug, Clone, PartialEq)]
pub struct Measured {
    /// Board tick.
    pub tick: u32,
    /// Path time of the motion, s; `None` if none is in progress.
    pub path_s: Option<f64>,
    /// Paid-out lengths by the drum encoders, m.
    pub lengths_m: Vec<f64>,
    /// Tensions at the winches, N.
    pub tensions_n: Vec<f64>,
    /// Motor currents, A.
    pub currents_a: Vec<f64>,
}

/// Collects samples.
#[derive(Debug, Default)]
pub struct Recorder {
    /// All samples, in time order.
    pub samples: Vec<Measured>,
    /// The least motion that a board had in its buffer while more was to come, s: by its clock and
    /// its last confirmation. `None` if a motion was sent whole before it started.
    pub least_buffered_s: Option<f64>,
    /// Samples are not kept.
    without_samples: bool,
}

impl Recorder {
    /// Keeps no samples: those of an hour take more than a gigabyte.
    #[must_use]
    pub fn without_samples() -> Self {
        Self {
            without_samples: true,
            ..Self::default()
        }
    }

    /// The board has this much motion left, s, and more is to come.
    pub(super) fn buffered(&mut self, seconds: f64) {
        let least = self.least_buffered_s.get_or_insert(seconds);
        *least = least.min(seconds);
    }

    /// Takes a block of samples; `duration_s` is that of the motion: past its end no path time is
    /// given.
    pub fn take(&mut self, block: &SampleBlock, duration_s: f64) {
        if self.without_samples {
            return;
        }
        let first = block.tick;
        self.samples.extend(unpacked(block).into_iter().map(|row| {
            let since_first = row.tick.since(first);
            // The path clock is zero while no motion runs.
            let path_s = (block.path_ms > 0)
                .then(|| (f64::from(block.path_ms) + f64::from(since_first)) * 1e-3)
                // A block that spans the end of a motion has ticks behind it.
                .filter(|&path| path <= duration_s);
            Measured {
                tick: row.tick.0,
                path_s,
                lengths_m: row.lengths_m,
                tensions_n: row.tensions_n,
                currents_a: row.currents_a,
            }
        }));
    }
}
