//! The converter's supply, measured against the chip's own reference.
//!
//! The value of a converter's step is proportional to its supply: a regulator that drifts by 3 %
//! shifts every tension by 3 %. The chip converts its internal reference in every tick; readings
//! are scaled to a nominal supply. The reference is 1.16 to 1.24 V from chip to chip (data sheet of
//! the STM32F103x8, 5.3.4), which a sensor's calibration absorbs; its drift remains, 10 mV at most
//! over the whole range of temperature.

use crate::adc::{RAIL_HIGH, RAIL_LOW, is_plausible};
use core::ops::RangeInclusive;

/// Reading of the reference at 3.3 V, when it is 1.20 V: 1.20 / 3.3 * 4096, with 8 fractional bits.
pub(crate) const NOMINAL_Q8: u32 = 381_300;
/// Its reading at 3.6 V with the lowest reference, and at 3.0 V with the highest.
// 1.16 / 3.6 x 4096 = 1319.8, and 1.24 / 3.0 x 4096 = 1693.
const SUPPLIED: RangeInclusive<u16> = 1319..=1693;
/// Number of readings in the mean, as a power of two.
// 64 ms: the supply drifts slowly, and the reference's own noise is averaged out.
const MEAN_SHIFT: u32 = 6;
/// The factor is kept while the mean is within this of its value at the last update, 8 fractional
/// bits: a constant reading must not appear to change (S11).
// Half a step of 1489, that is 0.03 % of a tension.
const STAYS_Q8: u32 = 128;

/// The converter's supply.
#[derive(Debug, Clone, Copy)]
pub struct Supply {
    /// Mean of the readings, 8 + 6 fractional bits; 0 before the first.
    mean: u32,
    /// The mean at the last update of the factor, 8 fractional bits.
    used_q8: u32,
    /// What readings are multiplied with, 15 fractional bits.
    factor_q15: u32,
}

impl Default for Supply {
    fn default() -> Self {
        Self {
            mean: 0,
            used_q8: NOMINAL_Q8,
            factor_q15: 1 << 15,
        }
    }
}

impl Supply {
    /// One reading of the reference, 12 bits. Returns whether the supply is in the converter's
    /// range, 3.0 to 3.6 V.
    pub fn update(&mut self, reading: u16) -> bool {
        if !SUPPLIED.contains(&reading) {
            // A supply that comes back is measured anew, not averaged with what it was before.
            self.mean = 0;
            return false;
        }
        let now = u32::from(reading) << 8;
        if self.mean == 0 {
            self.mean = now << MEAN_SHIFT;
        }
        let mean_q8 = self.mean >> MEAN_SHIFT;
        self.mean = self.mean - mean_q8 + now;
        if mean_q8.abs_diff(self.used_q8) > STAYS_Q8 {
            self.used_q8 = mean_q8;
            // NOMINAL_Q8 x 2^11 is 7.8e8, in 32 bits; the mean loses four bits that its noise has
            // anyway.
            self.factor_q15 = (NOMINAL_Q8 << 11) / (mean_q8 >> 4);
        }
        true
    }

    /// A sum of sixteen readings as it would be at 3.3 V. A reading at a rail stays there, and any
    /// other does not reach one.
    #[must_use]
    pub fn scale(&self, sum: u16) -> u16 {
        if !is_plausible(sum) {
            return sum;
        }
        // 65,520 x 37,000 (a supply of 3.6 V, the lowest reference) is 2.4e9, under 2^32.
        let scaled = (u32::from(sum) * self.factor_q15 + (1 << 14)) >> 15;
        let (low, high) = (u32::from(RAIL_LOW) + 1, u32::from(RAIL_HIGH) - 1);
        u16::try_from(scaled.clamp(low, high)).unwrap_or(sum)
    }

    /// The supply, mV, for a reference of 1.20 V; 0 if unknown.
    #[must_use]
    pub fn millivolts(&self) -> u16 {
        let mean_q8 = self.mean >> MEAN_SHIFT;
        let millivolts = (NOMINAL_Q8 * 3300).checked_div(mean_q8).unwrap_or(0);
        u16::try_from(millivolts).unwrap_or(0)
    }
}

#[cfg(test)]
#[expect(
    clippy::float_arithmetic,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a converter's readings, worked out by hand on the host"
)]
mod tests {
    use super::*;

    /// Readings of the reference (1.20 V) and an input at a supply.
    fn read(supply_v: f64, input_v: f64) -> (u16, u16) {
        let reference = (1.20 / supply_v * 4096.0) as u16;
        (reference, (input_v / supply_v * 65_536.0) as u16)
    }

    #[test]
    fn a_tension_reading_is_the_same_at_every_supply() {
        for supply_v in [3.05, 3.2, 3.3, 3.4, 3.55] {
            let mut supply = Supply::default();
            for _ in 0..10 {
                assert!(supply.update(read(supply_v, 0.0).0));
            }
            for input_v in [0.3, 1.5, 2.9] {
                let scaled = f64::from(supply.scale(read(supply_v, input_v).1)) / 65_536.0 * 3.3;
                let off = scaled / input_v - 1.0;
                assert!(off.abs() < 1e-3, "{supply_v} V, {input_v} V: {off}");
            }
            let commanded = f64::from(supply.millivolts()) * 1e-3;
            assert!((commanded - supply_v).abs() < 0.005, "{commanded}");
        }
    }

    #[test]
    fn rails_stay_rails_and_nothing_else_becomes_one() {
        let mut supply = Supply::default();
        supply.update(1693);
        assert_eq!(supply.scale(65_520), 65_520);
        assert_eq!(supply.scale(0), 0);
        assert!(is_plausible(supply.scale(810)));
        supply = Supply::default();
        supply.update(1319);
        assert!(is_plausible(supply.scale(64_000)));
    }

    #[test]
    fn noise_of_a_step_moves_no_reading_and_a_bad_supply_is_reported() {
        let mut supply = Supply::default();
        let mut noise = 1_u32;
        let mut seen = std::collections::BTreeSet::new();
        for tick in 0..20_000 {
            noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            supply.update(1489 + (noise >> 31) as u16);
            if tick > 500 {
                seen.insert(supply.scale(30_000));
            }
        }
        assert!(seen.len() <= 2, "{seen:?}");
        assert!(!supply.update(1300) && !supply.update(1700) && !supply.update(0));
    }
}
