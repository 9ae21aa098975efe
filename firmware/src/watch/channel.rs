//! Detectors that look at one channel over time: a frozen reading, a reversed drum.

use super::FROZEN_TICKS;

/// Natural repetition of a reading: the number of equal readings that means a frozen channel (S11).
///
/// If a channel repeats a reading with the probability p, n equal readings in a row occur by chance
/// with p to the power of n - 1. Each step of the table keeps that under 1e-9: a quiet sensor is
/// not a broken one. The probability follows from the mean number of ticks for which a reading
/// stays.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pace {
    /// Mean ticks from one change of the reading to the next, 8 fractional bits.
    pub(super) mean_q8: i32,
    /// Ticks since the last.
    pub(super) run: i32,
}

impl Default for Pace {
    fn default() -> Self {
        Self {
            mean_q8: 256,
            run: 1,
        }
    }
}

impl Pace {
    /// Up to this mean, this many ticks: p is 1 - 1 / mean.
    const TABLE: [(i32, u16); 5] = [
        // So many repetitions occur by chance with p^ticks: (1/9)^10 = 3e-10, (1/4)^16 = 2e-10,
        // (1/2)^31 = 5e-10, (3/4)^73 = 8e-10, (15/16)^322 = 9e-10.
        (256 * 9 / 8, FROZEN_TICKS),
        (256 * 4 / 3, 16),
        (256 * 2, 31),
        (256 * 4, 73),
        (256 * 16, 322),
    ];

    #[inline]
    pub(super) const fn changed(&mut self) {
        // Increase fast and decrease slowly: a limit that is too long misses little, one that is
        // too short stops a robot without cause.
        let longer = 256 * self.run - self.mean_q8;
        self.mean_q8 += if longer > 0 { longer / 8 } else { longer / 128 };
        self.run = 1;
    }

    pub(super) const fn repeated(&mut self) {
        // Bounded, so that 256 times the run fits 32 bits. 4 s are longer than any limit here.
        if self.run < 4096 {
            self.run += 1;
        }
    }

    /// Number of equal readings that means a frozen channel.
    pub(super) fn patience(&self) -> u16 {
        let mut steps = Self::TABLE.iter();
        let step = steps.find(|(mean_q8, _)| self.mean_q8 <= *mean_q8);
        // A channel that stays for more than 16 ticks on average: 2 s without a change.
        step.map_or(2000, |&(_, ticks)| ticks)
    }
}

/// Detects a drum that turns against its motor, every few encoder counts (S4).
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Polarity {
    pub(super) motor: i32,
    drum: i32,
    against: u8,
}

impl Polarity {
    /// As [`Self::update`], if they did not diverge; otherwise nothing is changed.
    #[inline(never)]
    pub(super) fn agrees(&mut self, motor: i32, drum: i32, way: i32) -> bool {
        let mut next = *self;
        let agrees = !next.update(motor, drum, way);
        if agrees {
            *self = next;
        }
        agrees
    }

    /// Lengths by motor and drum, and the distance after which they are compared, 0.1 µm; returns
    /// whether they diverged twice in a row.
    pub(super) fn update(&mut self, motor: i32, drum: i32, way: i32) -> bool {
        let by_motor = motor.wrapping_sub(self.motor);
        // The motor has not turned far enough: the drum's difference may be its quantisation.
        if by_motor.unsigned_abs() < way.unsigned_abs() {
            return false;
        }
        let by_drum = drum.wrapping_sub(self.drum);
        (self.motor, self.drum) = (motor, drum);
        let along = if by_motor < 0 {
            by_drum.saturating_neg()
        } else {
            by_drum
        };
        // Half the distance against the motor: less may be quantisation, up to one count of four.
        self.against = if along < -way / 2 {
            self.against + 1
        } else {
            0
        };
        // A single comparison may contain a replaced sample (S1). Two are eight encoder counts of
        // motion.
        self.against >= 2
    }
}
