//! An input of the converter whose wire is open: the voltage that results from its pull-up, its
//! capacitor, the pin's leakage and the converter's sampling.
//!
//! Every conversion connects the sampling capacitor, charged to the voltage of the channel before,
//! with the pin (data sheet of the STM32F103x8, table 46: 8 pF at most; leakage of a pin 1 uA at
//! most). So a weak pull-up does not hold an open input at its rail.

use super::sensors::ADC_REFERENCE_V;

/// Sampling capacitor, F.
const SAMPLING_F: f64 = 8e-12;
/// Conversions of one channel a second: four channels of 84 cycles at 12 MHz.
const CONVERSIONS_HZ: f64 = 12e6 / 84.0 / 4.0;
/// Voltage of the channel that is converted before, V: a cable at a few newtons.
const BEFORE_V: f64 = 0.8;
/// Capacitor at the pin (docs/wiring.md), F.
const PIN_F: f64 = 10e-9;
/// Leakage of a warm pin to ground, A.
const LEAKAGE_A: f64 = 0.1e-6;
/// The pull-up of docs/wiring.md, ohm.
pub(super) const WIRED_OHM: u32 = 10_000;

/// The voltage of an open input after `passed_s`, from `from_v`, with a pull-up to the supply.
pub(super) fn open_v(from_v: f64, pull_up_ohm: f64, passed_s: f64) -> f64 {
    // A switched capacitor conducts C f: 8 pF at 36 kHz are a resistor of 3.5 MOhm.
    let sampling = SAMPLING_F * CONVERSIONS_HZ;
    let conducts = 1.0 / pull_up_ohm + sampling;
    // Currents into the pin at rest: pull-up, leakage, charge of the channel before.
    let rests = (ADC_REFERENCE_V / pull_up_ohm - LEAKAGE_A + sampling * BEFORE_V) / conducts;
    // With the wired pull-up the time constant is 10 kOhm x 10 nF = 0.1 ms.
    rests + (from_v - rests) * libm::exp(-passed_s * conducts / PIN_F)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_weak_pull_up_leaves_an_open_input_among_good_readings() {
        let weak = open_v(1.0, 1e6, 10.0);
        assert!((2.5..2.9).contains(&weak), "{weak} V");
        // The board takes 3.268 V for open.
        let wired = open_v(1.0, f64::from(WIRED_OHM), 10.0);
        assert!(wired > 3.28, "{wired} V");
    }

    #[test]
    fn the_wired_one_is_at_its_rail_within_a_tick() {
        let after = open_v(0.5, f64::from(WIRED_OHM), 1e-3);
        assert!(after > 3.268, "{after} V");
        let meanwhile = open_v(0.5, f64::from(WIRED_OHM), 50e-6);
        assert!((1.0..2.5).contains(&meanwhile), "{meanwhile} V");
    }
}
