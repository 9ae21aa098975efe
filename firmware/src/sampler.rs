//! Packs what every tick measured into sample blocks.
//!
//! Not in the tick: that leaves a [`Row`], and whatever sends telemetry packs it.

use mcdpr_protocol::{
    Milliamps, Millinewtons, PerCable, Sample, SampleBlock, TenthMicrometres, Tick,
};

/// What one tick measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Row<const N: usize> {
    /// The tick.
    pub tick: Tick,
    /// Path time of the motion, ms.
    pub path_ms: u32,
    /// Whether the host asked for samples just before: what was collected until then is void.
    pub first: bool,
    /// Cable by cable: paid-out length (0.1 µm), tension (mN), motor current (mA).
    pub cables: [(i32, i32, i16); N],
}

/// Collects ticks until a block is full.
#[derive(Debug, Clone)]
pub struct Sampler<const N: usize> {
    block: SampleBlock,
    position: u32,
    previous: [TenthMicrometres; N],
    primed: bool,
}

impl<const N: usize> Default for Sampler<N> {
    fn default() -> Self {
        Self {
            block: SampleBlock::default(),
            position: 0,
            previous: [TenthMicrometres(0); N],
            primed: false,
        }
    }
}

impl<const N: usize> Sampler<N> {
    /// Takes one tick; gives a block when one is full. Where ticks are missing, the block that
    /// they would have been in is void: a block's ticks follow each other.
    pub fn push(&mut self, row: &Row<N>) -> Option<SampleBlock> {
        let follows = row.tick == self.block.tick.after(self.position);
        if row.first || (self.position > 0 && !follows) {
            *self = Self::default();
        }
        let mut samples = [Sample::default(); N];
        for (sample, &(length, tension, current)) in samples.iter_mut().zip(&row.cables) {
            *sample = Sample {
                length: TenthMicrometres(length),
                tension: Millinewtons(tension),
                current: Milliamps(i32::from(current)),
            };
        }
        if !core::mem::replace(&mut self.primed, true) {
            for (previous, sample) in self.previous.iter_mut().zip(&samples) {
                *previous = sample.length;
            }
        }
        if self.position == 0 {
            self.block = SampleBlock {
                tick: row.tick,
                path_ms: row.path_ms,
                lengths: PerCable::collect(self.previous),
                ..SampleBlock::default()
            };
        }
        let fits = self
            .block
            .append(self.position as usize, &self.previous, &samples);
        for (previous, sample) in self.previous.iter_mut().zip(&samples) {
            *previous = sample.length;
        }
        self.position += 1;
        let full = !fits || self.position as usize == SampleBlock::ticks(N);
        full.then(|| {
            self.position = 0;
            core::mem::take(&mut self.block)
        })
    }
}
