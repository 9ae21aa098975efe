//! Wire units to SI and back.

use mcdpr_protocol::{
    Knot, Micrometres, MicrometresPerSecond, Milliamps, Millinewtons, TenthMicrometres,
};
use proptest::prelude::*;

/// Rounded like the wire, by the language's own conversion.
#[expect(
    clippy::cast_possible_truncation,
    reason = "values of the tests fit, and beyond the cast saturates"
)]
fn rounded(value: f64) -> i32 {
    value.round() as i32
}

#[test]
fn halves_go_away_from_zero_and_what_is_out_of_range_saturates() {
    let counts = |value: f64| Micrometres::from_metres(value).0;
    for value in [0.0, 2.4e-6, 2.5e-6, 2.6e-6, -2.4e-6, -2.5e-6, -2.6e-6] {
        assert_eq!(counts(value), rounded(value * 1e6), "{value}");
    }
    // The largest value below a half is not a half.
    let below = f64::from_bits(0.5_f64.to_bits() - 1);
    assert_eq!(Millinewtons::from_newtons(below / 1e3).0, 0);
    for value in [1e9, -1e9, f64::INFINITY, f64::NEG_INFINITY, f64::NAN] {
        assert_eq!(counts(value), rounded(value * 1e6), "{value}");
    }
    assert_eq!(counts(2_147.483_647_3), i32::MAX);
    assert_eq!(counts(-2_147.483_648_9), i32::MIN);
}

proptest! {
    #[test]
    fn every_wire_value_comes_back(value in any::<i32>()) {
        let length = TenthMicrometres(value);
        prop_assert_eq!(TenthMicrometres::from_metres(length.metres()), length);
        let coarse = Micrometres(value);
        prop_assert_eq!(Micrometres::from_metres(coarse.metres()), coarse);
        let speed = MicrometresPerSecond(value);
        let mps = speed.metres_per_second();
        prop_assert_eq!(MicrometresPerSecond::from_metres_per_second(mps), speed);
        let force = Millinewtons(value);
        prop_assert_eq!(Millinewtons::from_newtons(force.newtons()), force);
        let current = Milliamps(value);
        prop_assert_eq!(Milliamps::from_amperes(current.amperes()), current);
    }

    #[test]
    fn rounding_is_that_of_the_standard_library(value in -3e3..3e3_f64) {
        prop_assert_eq!(Micrometres::from_metres(value).0, rounded(value * 1e6));
        prop_assert_eq!(TenthMicrometres::from_metres(value * 0.1).0, rounded(value * 0.1 * 1e7));
    }
}

#[test]
fn the_times_of_knots_are_milliseconds() {
    let at = |time_ms| Knot {
        time_ms,
        ..Knot::default()
    };
    for (time_ms, time_s) in [(0, 0.0), (1, 0.001), (2500, 2.5), (u32::MAX, 4_294_967.295)] {
        assert!((at(time_ms).time_s() - time_s).abs() < 1e-9, "{time_ms}");
    }
}
