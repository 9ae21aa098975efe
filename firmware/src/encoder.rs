//! Drum encoders: 16-bit hardware counters to 64-bit positions and lengths.

use crate::fixed::{half, narrow, products, saturate};
use mcdpr_protocol::TenthMicrometres;

/// Samples that may be rejected in a row before the encoder counts as dead.
// Two: at the third jump in a row the encoder is lost (S6), 3 ms after the first.
const MAX_REJECTED: u8 = 2;

/// Result of one sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sampled {
    /// Plausible.
    Good,
    /// A jump that a drum cannot make: ignored, the last velocity is continued (S1).
    Rejected,
    /// Jumps continued: the encoder cannot be trusted (S6). Counting continues from the new
    /// position, so that a new reference can repair it; the old reference is invalid.
    Lost,
}

/// Extends a wrapping 16-bit counter to 64 bits (S3), in either sign, and rejects glitches.
#[derive(Debug, Clone, Copy, Default)]
pub struct Encoder {
    last: u16,
    counts: i64,
    step: i16,
    rejected: u8,
}

impl Encoder {
    /// Takes the counter's value of this tick. `max_step` is the largest plausible change per tick,
    /// in counts. The origin is the counter's zero, at which it stands when its chip starts.
    ///
    /// ```
    /// use mcdpr_firmware::encoder::Encoder;
    /// let mut encoder = Encoder::default();
    /// encoder.sample(65_530, 40);
    /// assert_eq!(encoder.counts(), -6);
    /// encoder.sample(4, 40);
    /// assert_eq!(encoder.counts(), 4);
    /// ```
    #[inline]
    pub fn sample(&mut self, counter: u16, max_step: u16) -> Sampled {
        // A difference modulo 2^16 has the right sign up to 32,767 counts: the wrap needs no case
        // of its own (S3).
        let step = counter.wrapping_sub(self.last).cast_signed();
        // The most frequent case.
        if self.rejected == 0 && step.unsigned_abs() <= max_step {
            self.counts += i64::from(step);
            self.step = step;
            self.last = counter;
            return Sampled::Good;
        }
        self.doubt(counter, step, max_step)
    }

    /// A sample that is not a plain step from the last one.
    #[inline(never)]
    fn doubt(&mut self, counter: u16, step: i16, max_step: u16) -> Sampled {
        // After rejected samples the drum may have moved on for several ticks.
        let allowed = u32::from(max_step) * (u32::from(self.rejected) + 1);
        if u32::from(step.unsigned_abs()) <= allowed {
            // The prediction that was added while samples were rejected is taken back: the counter
            // knows the whole way.
            let predicted = i64::from(self.step) * i64::from(self.rejected);
            self.counts += i64::from(step) - predicted;
            self.last = counter;
            self.rejected = 0;
            return Sampled::Good;
        }
        if self.rejected >= MAX_REJECTED {
            self.last = counter;
            // The old speed says nothing about the new position.
            self.step = 0;
            self.rejected = 0;
            return Sampled::Lost;
        }
        self.rejected += 1;
        // A drum cannot stop within a tick: its last speed is the best guess.
        self.counts += i64::from(self.step);
        Sampled::Rejected
    }

    /// Position from the counter's zero, counts; predicted while samples are rejected.
    #[must_use]
    pub const fn counts(&self) -> i64 {
        self.counts
    }
}

/// Converts encoder counts to paid-out length.
#[derive(Debug, Clone, Copy, Default)]
pub struct LengthScale {
    /// Length per count in 0.1 µm with 24 fractional bits; carries the encoder's sign.
    pub per_count_q24: i64,
    /// Counts at the reference.
    pub reference_counts: i64,
    /// Length at the reference, 0.1 µm.
    pub reference: i32,
}

impl LengthScale {
    /// The length at these counts, rounded to the nearest 0.1 µm.
    #[must_use]
    #[inline]
    pub fn length(&self, counts: i64) -> TenthMicrometres {
        let moved = counts.wrapping_sub(self.reference_counts);
        // Drums make less than 2^31 counts: the product is formed of two that fit 64 bits.
        let length = match narrow(moved) {
            Some(moved) => {
                let (high, low) = products(moved, self.per_count_q24);
                (high << 8) + ((low + half(24)) >> 24)
            }
            None => self.far(moved),
        };
        TenthMicrometres(saturate(length + i64::from(self.reference)))
    }

    /// For more counts than drums make.
    #[inline(never)]
    const fn far(&self, moved: i64) -> i64 {
        let length = moved.saturating_mul(self.per_count_q24);
        length.saturating_add(half(24)) >> 24
    }
}
