//! Timers as quadrature decoders with input filters (RM0008, 14.3.12 and 15.3.12).

use super::encoder_line::Edge;
use super::quadrature::{Decoder, Sampling};

/// The encoder's motion during a slice: evenly spaced edges.
#[derive(Debug, Clone, Copy, Default)]
struct Travel {
    counts: i64,
    from: u64,
    ticks: u64,
}

#[derive(Debug, Clone, Default)]
pub(crate) struct Timer {
    registers: [u32; 20],
    /// The count at the beginning of the travel.
    count: i64,
    travel: Travel,
    /// Where the encoder's lines are not ideal.
    decoder: Option<Decoder>,
    /// What the encoder has turned, and the decoder has not counted.
    owed: i64,
    /// Edges that were filtered out, or that came while the counter was off.
    lost: u64,
}

/// A slice of an encoder whose lines are not ideal.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Slice<'a> {
    /// Levels at its beginning.
    pub levels: [bool; 2],
    /// In their order.
    pub edges: &'a [Edge],
    /// What the encoder turns.
    pub counts: i64,
    /// Beginning and end, in ticks.
    pub from: u64,
    pub until: u64,
}

const CR1: usize = 0;
const SMCR: usize = 2;
const CCMR1: usize = 6;
const CCER: usize = 8;
const ARR: usize = 11;

impl Timer {
    pub fn new() -> Self {
        // RM0008 gives 0xFFFF or 0 for the reload register after a reset, by revision, and clones
        // have either. Use the worse one: at 0 nothing is counted (15.3.1).
        Self::default()
    }

    /// Counts per count of the encoder: 1 or -1; `None` where no edges count.
    fn sense(&self) -> Option<i64> {
        // Both channels are inputs from their own pins.
        let inputs = self.registers[CCMR1] & 0x0303 == 0x0101;
        let counts = self.registers[CR1] & 1 != 0 && self.registers[SMCR] & 7 == 3;
        let counts = counts && self.registers[ARR] & 0xFFFF != 0;
        // The polarity of one inverted input reverses the direction; of two it does not.
        let turned = (self.registers[CCER] >> 1 ^ self.registers[CCER] >> 5) & 1 != 0;
        (inputs && counts).then_some(if turned { -1 } else { 1 })
    }

    /// Filters of both inputs, in cycles of the timer's clock.
    fn filters(&self) -> [Sampling; 2] {
        let divider = self.registers[CR1] >> 8 & 3;
        [4, 12].map(|shift| Sampling::new(self.registers[CCMR1] >> shift & 15, divider))
    }

    /// Time that an input must stay, in cycles of the timer's clock.
    fn filter(&self) -> u64 {
        let [first, second] = self.filters().map(Sampling::length);
        first.max(second)
    }

    /// Counts of the encoder that were not counted. The last ones may still be in the filters of lines that are not
    /// ideal.
    pub const fn lost(&self) -> u64 {
        self.lost + self.owed.unsigned_abs()
    }

    /// The slice before has ended.
    fn settle(&mut self) {
        // Its filter delay is not carried over to the next slice.
        self.count += self.travel.counts;
        self.travel = Travel::default();
        if let Some(decoder) = &mut self.decoder {
            self.count += decoder.counted.drain(..).map(|(_, step)| step).sum::<i64>();
        }
    }

    fn counted(&self, now: u64, cycle: u64) -> i64 {
        let Travel {
            counts,
            from,
            ticks,
        } = self.travel;
        // A filtered edge arrives as much later as the filter is long.
        let passed = now.saturating_sub(from + self.filter() * cycle).min(ticks);
        let decoded = self.decoder.iter().flat_map(|decoder| &decoder.counted);
        let decoded = decoded.filter(|(at, _)| *at <= now);
        let decoded: i64 = decoded.map(|(_, step)| step).sum();
        // 128 bits: a travel of many counts times many ticks may pass 2^63.
        self.count
            + decoded
            + (i128::from(counts) * i128::from(passed) / i128::from(ticks.max(1))) as i64
    }

    /// Lets the encoder turn by `counts` in the next `ticks`. `wired`: both pins are inputs.
    pub fn turn(&mut self, counts: i64, now: u64, ticks: u64, cycle: u64, wired: bool) {
        self.settle();
        self.decoder = None;
        let Some(sense) = self.sense().filter(|_| wired) else {
            self.lost += counts.unsigned_abs();
            return;
        };
        // Each of the two inputs changes with every second count.
        let width = 2 * ticks / counts.unsigned_abs().max(1);
        // All edges of the slice are too short for the filter.
        if width <= self.filter() * cycle {
            self.lost += counts.unsigned_abs();
            return;
        }
        self.travel = Travel {
            counts: sense * counts,
            from: now,
            ticks,
        };
    }

    /// As [`Self::turn`], of an encoder whose lines are not ideal.
    pub fn pass(&mut self, slice: Slice<'_>, cycle: u64, wired: bool) {
        self.settle();
        let Some(sense) = self.sense().filter(|_| wired) else {
            // The filters follow their inputs from when the counter starts.
            self.decoder = None;
            self.lost += slice.counts.unsigned_abs();
            return;
        };
        let by = self.filters().map(|filter| filter.scaled(cycle));
        let decoder = self
            .decoder
            .get_or_insert_with(|| Decoder::new(slice.levels, slice.from));
        let counted = decoder.pass(slice.edges, slice.until, by);
        self.owed += slice.counts - counted;
        if sense < 0 {
            decoder
                .counted
                .iter_mut()
                .for_each(|(_, step)| *step = -*step);
        }
    }

    pub fn read(&self, offset: u32, now: u64, cycle: u64) -> Option<u32> {
        match offset {
            0x24 => Some(self.counted(now, cycle) as u32 & 0xFFFF),
            0..=0x4C => self.registers.get((offset / 4) as usize).copied(),
            _ => None,
        }
    }

    /// The counter is written.
    fn restart(&mut self, count: u32, now: u64) {
        self.count = i64::from(count & 0xFFFF);
        self.travel = Travel::default();
        if let Some(decoder) = &mut self.decoder {
            decoder.counted.retain(|(at, _)| *at > now);
        }
    }

    pub fn write(&mut self, offset: u32, value: u32, now: u64) -> Result<(), &'static str> {
        let index = (offset / 4) as usize;
        match offset {
            0x24 => self.restart(value, now),
            // An update event restarts the count.
            0x14 if value & 1 != 0 => self.restart(0, now),
            0x14 => {}
            0..=0x4C => {
                if let Some(register) = self.registers.get_mut(index) {
                    *register = value;
                }
                if self.registers[CR1] & 1 != 0 && self.registers[SMCR] & 7 != 3 {
                    return Err("only quadrature decoding is emulated");
                }
                if self.registers[CR1] & 1 != 0
                    && !matches!(self.registers[ARR] & 0xFFFF, 0 | 0xFFFF)
                {
                    return Err("only counting through all 16 bits is emulated");
                }
            }
            _ => return Err("no such register"),
        }
        Ok(())
    }
}
