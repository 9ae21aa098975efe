//! Packs what every tick measured into sample blocks.

use mcdpr_protocol::{
    Milliamps, Millinewtons, PerCable, Sample, SampleBlock, TenthMicrometres, Tick,
};

/// Collects ticks until a block is full.
#[derive(Debug, Clone)]
pub struct Sampler<const N: usize> {
    block: SampleBlock,
    position: usize,
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
    /// Takes one tick; gives a block when one is full.
    pub fn push(
        &mut self,
        tick: Tick,
        path_ms: u32,
        rows: &[(i32, i32, i16); N],
    ) -> Option<SampleBlock> {
        let mut samples = [Sample::default(); N];
        for (sample, &(length, tension, current)) in samples.iter_mut().zip(rows) {
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
                tick,
                path_ms,
                lengths: PerCable::collect(self.previous),
                ..SampleBlock::default()
            };
        }
        let fits = self.block.append(self.position, &self.previous, &samples);
        for (previous, sample) in self.previous.iter_mut().zip(&samples) {
            *previous = sample.length;
        }
        self.position += 1;
        let full = !fits || self.position == SampleBlock::ticks(N);
        full.then(|| {
            self.position = 0;
            core::mem::take(&mut self.block)
        })
    }
}
