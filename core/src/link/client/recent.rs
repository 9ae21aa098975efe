//! The last seconds of a board's samples, kept to find out what failed.

use mcdpr_protocol::{SampleBlock, Tick};
use std::collections::VecDeque;

/// Time that is kept, ticks of a millisecond: a stop, the closing of brakes and a test of them, with what was before.
const KEPT_TICKS: i32 = 8_000;

/// One tick of one board: lengths (m) by the drum encoders, tensions (N) at the winches, motor currents (A).
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// Board tick.
    pub tick: Tick,
    /// Paid-out length of each cable, m.
    pub lengths_m: Vec<f64>,
    /// Tension of each cable, N.
    pub tensions_n: Vec<f64>,
    /// Current of each motor, A; of odd ticks, that of the tick before.
    pub currents_a: Vec<f64>,
}

/// Blocks of samples in the order of arrival.
#[derive(Debug, Default)]
pub(super) struct Recent {
    blocks: VecDeque<SampleBlock>,
}

impl Recent {
    pub(super) fn take(&mut self, block: &SampleBlock) {
        self.blocks.push_back(block.clone());
        let now = block.tick;
        while self
            .blocks
            .front()
            .is_some_and(|first| !(0..=KEPT_TICKS).contains(&now.since(first.tick)))
        {
            // Too old, or of before the board started anew.
            self.blocks.pop_front();
        }
    }

    /// Every tick, in order.
    pub(super) fn rows(&self) -> Vec<Row> {
        self.blocks.iter().flat_map(unpacked).collect()
    }
}

/// The ticks of a block, SI.
pub(crate) fn unpacked(block: &SampleBlock) -> Vec<Row> {
    let mut rows = Vec::new();
    block.unpack(|tick, samples| {
        rows.push(Row {
            tick,
            lengths_m: samples.iter().map(|s| s.length.metres()).collect(),
            tensions_n: samples.iter().map(|s| s.tension.newtons()).collect(),
            currents_a: samples.iter().map(|s| s.current.amperes()).collect(),
        });
    });
    rows
}
