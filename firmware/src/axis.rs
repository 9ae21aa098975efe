//! One cable's set-points: motor counts for a length, trimmed by the drum encoder, and rpm limits
//! (Eqs. 50 and 54 with the units of `docs/paper-notes.md`).

use crate::config::CableConfig;
use crate::fixed::{mul_shift, saturate};
use crate::io::DriveInput;

/// Trim closes a gap between motor and drum encoder within about this many milliseconds.
const TRIM_TIME_MS: i64 = 512;
/// Most trim, 0.1 µm: more is not backlash or a wrong ratio, but a fault.
const TRIM_MAX: i64 = 50_000;
/// Speed that a position command may exceed the plan by, as a share of the largest, in percent.
const CATCH_UP_PERCENT: i32 = 20;

/// What a position-held cable shall do in a tick.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Target {
    /// Length now, 0.1 µm.
    pub length: i32,
    /// Rate now, µm/s.
    pub speed_umps: i32,
    /// Second derivative now, µm/s².
    pub acceleration_umps2: i32,
}

/// State of one cable's position command.
#[derive(Debug, Clone, Copy, Default)]
pub struct Axis {
    /// Motor counts when the axis was enabled.
    zero_counts: i32,
    /// Length when the axis was enabled, 0.1 µm.
    zero_length: i32,
    /// Length that the encoder is short of the motor, 1/2^16 of 0.1 µm.
    trim_q16: i64,
}

impl Axis {
    /// Ties motor counts to a length, at rest.
    #[must_use]
    pub const fn zeroed(counts: i32, length: i32) -> Self {
        Self {
            zero_counts: counts,
            zero_length: length,
            trim_q16: 0,
        }
    }

    /// Learns from one tick: `error` is set-point minus measured length, 0.1 µm. Errors within
    /// half an encoder count are quantisation and teach nothing.
    pub fn trim(&mut self, config: &CableConfig, error: i32) {
        let half_count = saturate(config.scale.per_count_q24.abs() >> 25);
        let beyond = if error > half_count {
            error - half_count
        } else if error < -half_count {
            error + half_count
        } else {
            0
        };
        let most = TRIM_MAX << 16;
        self.trim_q16 += (i64::from(beyond) << 16) / TRIM_TIME_MS;
        self.trim_q16 = self.trim_q16.clamp(-most, most);
    }

    /// Whether the trim is at its bound.
    #[must_use]
    pub fn trim_saturated(&self) -> bool {
        self.trim_q16.abs() >= TRIM_MAX << 16
    }

    /// Motor counts for the target, led by the drive's lag.
    #[must_use]
    pub fn counts(&self, config: &CableConfig, target: &Target) -> i32 {
        let lead = i64::from(config.lead_us);
        // µm/s times µs is 1e-6 µm; 1e5 of them are 0.1 µm. The square term carries another 2e6.
        let by_speed = i64::from(target.speed_umps) * lead / 100_000;
        let by_acceleration =
            i64::from(target.acceleration_umps2) * (lead * lead / 1000) / 200_000_000;
        let ahead = by_speed + by_acceleration + (self.trim_q16 >> 16);
        let change = i64::from(target.length) - i64::from(self.zero_length) + ahead;
        let counts = mul_shift(saturate(change), config.motor_per_length_q32, 32);
        self.zero_counts.wrapping_add(counts)
    }

    /// Speed limit for the drive: what the plan needs and some to catch up.
    #[must_use]
    pub fn rpm(config: &CableConfig, target: &Target) -> u16 {
        let planned = mul_shift(
            saturate(i64::from(target.speed_umps).abs()),
            config.rpm_per_speed_q32,
            32,
        );
        let catch_up = i32::from(config.max_rpm) * CATCH_UP_PERCENT / 100;
        let wanted = planned.saturating_add(catch_up.max(1));
        u16::try_from(wanted).map_or(config.max_rpm, |rpm| rpm.min(config.max_rpm))
    }
}

/// The drum's surface speed by the motor, µm/s, positive as the cable pays out.
#[must_use]
pub fn motor_speed_umps(config: &CableConfig, drive: &DriveInput) -> i32 {
    let per_rpm = config.rpm_per_speed_q32.max(1);
    let speed = saturate((i64::from(drive.rpm) << 32) / per_rpm);
    if config.motor_reversed { -speed } else { speed }
}
