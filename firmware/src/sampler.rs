//! Packs the measurements of every tick into sample blocks.
//!
//! Not done in the tick: the tick leaves a [`Row`], and the sending half packs it.

use mcdpr_protocol::{
    Milliamps, Millinewtons, PerCable, Sample, SampleBlock, TenthMicrometres, Tick,
};

/// Measurements of one tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Row<const N: usize> {
    /// The tick.
    pub tick: Tick,
    /// Path time of the motion, ms.
    pub path_ms: u32,
    /// Whether the host asked for samples just before: samples collected until then are void.
    pub first: bool,
    /// Cable by cable.
    pub cables: [Measured; N],
}

/// Measurements of one cable.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
pub struct Measured {
    /// Paid-out length, 0.1 µm.
    pub length: i32,
    /// Tension, mN.
    pub tension_mn: i32,
    /// Motor current, mA.
    pub current_ma: i16,
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
    /// Takes one tick; returns a block when one is full. If ticks are missing, the block that they
    /// belong to is void: a block's ticks are consecutive.
    pub fn push(&mut self, row: &Row<N>) -> Option<SampleBlock> {
        let follows = row.tick == self.block.tick.after(self.position);
        // Changes are packed relative to the tick before: after a gap they would add up to wrong
        // lengths.
        if row.first || (self.position > 0 && !follows) {
            *self = Self::default();
        }
        let mut samples = [Sample::default(); N];
        for (sample, measured) in samples.iter_mut().zip(&row.cables) {
            *sample = Sample {
                length: TenthMicrometres(measured.length),
                tension: Millinewtons(measured.tension_mn),
                current: Milliamps(i32::from(measured.current_ma)),
            };
        }
        // The first tick has no tick before: its change is 0.
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
