//! The supply's voltage, and what watches it: power-on reset, power-down reset, voltage detector.
//!
//! The thresholds are those of the data sheet of the STM32F103x8 (DS5319), table "Embedded reset and power control
//! block characteristics"; what they do is RM0008, 5.2 (power supply supervisor). What happens to memory without a
//! supply is an assumption: no document of the chip says it.

/// Thresholds of the detector by its level (PWR_CR, PLS), rising, and how far a chip's may be from them, V.
const DETECTOR_V: [(f64, f64); 8] = [
    (2.18, 0.08),
    (2.28, 0.09),
    (2.38, 0.10),
    (2.48, 0.10),
    (2.58, 0.11),
    (2.68, 0.11),
    (2.78, 0.12),
    (2.88, 0.12),
];
/// The falling thresholds are lower by this, V.
const DETECTOR_HYSTERESIS_V: f64 = 0.10;

/// Thresholds of a chip's supply: they differ from chip to chip.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SupplyLimits {
    /// A supply that falls below this resets the chip, V.
    pub power_down_v: f64,
    /// A supply that rises above this lets the chip start, V.
    pub power_on_v: f64,
    /// From then on, the chip stays in reset for so long, us.
    pub start_us: u64,
    /// Place of the detector's thresholds in their tolerance: -1 lowest, 0 typical, 1 highest.
    pub detector: f64,
    /// Memory keeps all of its contents down to this, V. Below, it loses byte after byte.
    pub keeps_all_v: f64,
    /// At this, memory has lost all of its contents, V.
    pub keeps_none_v: f64,
}

impl SupplyLimits {
    /// A typical chip. Its memory keeps all down to 1.5 V and nothing at 0.5 V: an assumption.
    pub const TYPICAL: Self = Self {
        power_down_v: 1.88,
        power_on_v: 1.92,
        start_us: 2500,
        detector: 0.0,
        keeps_all_v: 1.5,
        keeps_none_v: 0.5,
    };
    /// The chip that runs longest and starts soonest. It keeps its memory longest, too.
    pub const LOWEST: Self = Self {
        power_down_v: 1.80,
        power_on_v: 1.84,
        start_us: 1500,
        detector: -1.0,
        keeps_all_v: 0.8,
        keeps_none_v: 0.3,
    };
    /// The chip that is reset first and starts last. It forgets as soon as it is reset.
    pub const HIGHEST: Self = Self {
        power_down_v: 1.96,
        power_on_v: 2.00,
        start_us: 4500,
        detector: 1.0,
        keeps_all_v: 1.96,
        keeps_none_v: 1.5,
    };

    /// Share of the memory that is lost at a voltage.
    pub(crate) fn lost_at(&self, volts: f64) -> f64 {
        if volts >= self.keeps_all_v {
            0.0
        } else if volts <= self.keeps_none_v {
            1.0
        } else {
            (self.keeps_all_v - volts) / (self.keeps_all_v - self.keeps_none_v)
        }
    }

    /// A voltage that is low for the detector at any level, and at which the chip starts and runs.
    pub(crate) fn low_v(&self) -> f64 {
        // The detector's lowest threshold is 2.0 V, in the chip whose power-on threshold is 1.84 V.
        self.power_on_v.max(1.98)
    }
}

/// The supply and its detector.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Supply {
    pub volts: f64,
    pub limits: SupplyLimits,
    /// The detector's output (PWR_CSR, PVDO).
    pub low: bool,
}

impl Default for Supply {
    fn default() -> Self {
        Self {
            volts: 3.3,
            limits: SupplyLimits::TYPICAL,
            low: false,
        }
    }
}

impl Supply {
    /// Updates the detector's output; `level` is `None` where it is off. Returns whether the output rose.
    ///
    /// A detector that is switched on between its two thresholds says that the supply is not low: nobody states it,
    /// and this is the worse answer.
    pub fn detect(&mut self, level: Option<u32>) -> bool {
        let was = self.low;
        self.low = level.is_some_and(|level| {
            let (typical, tolerance) = DETECTOR_V[(level & 7) as usize];
            let rising = typical + tolerance * self.limits.detector;
            let hysteresis = if was { 0.0 } else { DETECTOR_HYSTERESIS_V };
            self.volts < rising - hysteresis
        });
        self.low && !was
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whether the detector says low, along a course of the supply.
    fn course(limits: SupplyLimits, level: u32, volts: &[f64]) -> Vec<bool> {
        let mut supply = Supply {
            limits,
            ..Supply::default()
        };
        let says = volts.iter().map(|&volts| {
            supply.volts = volts;
            supply.detect(Some(level));
            supply.low
        });
        says.collect()
    }

    #[test]
    fn the_detector_has_the_thresholds_of_the_data_sheet() {
        // Level, then lowest, typical and highest threshold, rising and falling.
        let table = [
            (0, [2.10, 2.18, 2.26], [2.00, 2.08, 2.16]),
            (1, [2.19, 2.28, 2.37], [2.09, 2.18, 2.27]),
            (2, [2.28, 2.38, 2.48], [2.18, 2.28, 2.38]),
            (3, [2.38, 2.48, 2.58], [2.28, 2.38, 2.48]),
            (4, [2.47, 2.58, 2.69], [2.37, 2.48, 2.59]),
            (5, [2.57, 2.68, 2.79], [2.47, 2.58, 2.69]),
            (6, [2.66, 2.78, 2.90], [2.56, 2.68, 2.80]),
            (7, [2.76, 2.88, 3.00], [2.66, 2.78, 2.90]),
        ];
        let chips = [
            SupplyLimits::LOWEST,
            SupplyLimits::TYPICAL,
            SupplyLimits::HIGHEST,
        ];
        for (level, rising, falling) in table {
            for (chip, (up, down)) in chips.into_iter().zip(rising.into_iter().zip(falling)) {
                let volts = [3.3, down + 0.001, down - 0.001, up - 0.001, up + 0.001];
                let says = course(chip, level, &volts);
                assert_eq!(says, [false, false, true, true, false], "{level}, {chip:?}");
            }
        }
    }

    #[test]
    fn the_voltage_of_a_low_supply_is_low_for_every_detector_and_resets_no_chip() {
        for chip in [
            SupplyLimits::LOWEST,
            SupplyLimits::TYPICAL,
            SupplyLimits::HIGHEST,
        ] {
            assert!(chip.low_v() >= chip.power_on_v && chip.low_v() > chip.power_down_v);
            assert!((0..8).all(|level| course(chip, level, &[chip.low_v()]) == [true]));
        }
    }

    #[test]
    fn memory_is_lost_byte_by_byte() {
        let chip = SupplyLimits::TYPICAL;
        assert_eq!(
            [3.3, 1.5, 0.5, 0.0].map(|v| chip.lost_at(v)),
            [0.0, 0.0, 1.0, 1.0]
        );
        assert!((chip.lost_at(1.0) - 0.5).abs() < 1e-9);
    }
}
