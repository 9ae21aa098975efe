//! The range of the tension channels: 0 to 65520 steps for 0 V to 3.3 V.

/// Steps of a tension channel at or above which the sensor counts as open: within 1 % of the rail
/// (S7).
// 64,900 of 65,536 are 3.268 V of 3.3 V. An open input is pulled up to the supply by 10 kOhm.
pub const RAIL_HIGH: u16 = 64_900;
/// Steps at or below which it counts as shorted: under 40 mV (S8).
// 800 steps are 40.3 mV. The paper's sensor gives 235.5 mV without load.
pub const RAIL_LOW: u16 = 800;

/// Whether a reading is possible for a connected sensor.
#[must_use]
pub(crate) const fn is_plausible(adc: u16) -> bool {
    adc > RAIL_LOW && adc < RAIL_HIGH
}
