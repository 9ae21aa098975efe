//! The range of the tension channels: 0 to 65520 steps for 0 V to 3.3 V.

/// Steps of the tension channels that mean an open sensor: within 1 % of the rail (S7).
pub const RAIL_HIGH: u16 = 64_900;
/// Steps that mean a short: under 40 mV (S8).
pub const RAIL_LOW: u16 = 800;

/// Whether a reading can be one of a sensor that is connected.
#[must_use]
pub(crate) const fn is_plausible(adc: u16) -> bool {
    adc > RAIL_LOW && adc < RAIL_HIGH
}
