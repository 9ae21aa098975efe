//! One cable's set-points: motor counts for a length, trimmed by the drum encoder, and rpm limits
//! (Eqs. 50 and 54 with the units of `docs/paper-notes.md`).

use crate::config::CableConfig;
use crate::fixed::{floor_q32, mul_q32, quotient, saturate};
use crate::io::DriveInput;

/// A gap between motor and drum encoder is closed within about this many milliseconds.
const TRIM_TIME_MS: i32 = 1 << TRIM_BITS;
// 512 ms: the trim follows backlash and a wrong ratio, not single counts of the encoder.
const TRIM_BITS: u32 = 9;
/// Greatest trim, 0.1 µm: more is not backlash or a wrong ratio, but a fault.
const TRIM_MAX: i32 = 50_000;
/// The drive's lag beyond its stated lead is compensated within about this many milliseconds: slow
/// against any drive's position loop, fast against any path.
const LAG_TIME_MS: i32 = 1 << LAG_BITS;
const LAG_BITS: u32 = 6;
/// Greatest lag that is compensated, 0.1 µm.
// 2 mm: at 100 mm/s a lag of 20 ms beyond the stated lead.
const LAG_MAX: i32 = 20_000;
/// A position command may exceed the plan's speed by this share of the largest, in percent.
// Behind 371:1 (45 mm/s of cable) 20 % are 9 mm/s to catch up with the plan.
const CATCH_UP_PERCENT: i32 = 20;

/// Set-point of a position-held cable in a tick.
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
///
/// The motor's counts are fine but do not measure the drum; the drum's measure it but are coarse.
/// So the difference of the two is learnt slowly (`trim_q9`), and with it the motor's counts give
/// the drum's lag behind its set-point.
#[derive(Debug, Clone, Copy, Default)]
pub struct Axis {
    /// Motor counts when the axis was enabled.
    zero_counts: i32,
    /// Length when the axis was enabled, 0.1 µm.
    zero_length: i32,
    /// Length by the drum encoder minus length by the motor, in the fractions of 0.1 µm that a tick
    /// can correct: 1/512.
    trim_q9: i32,
    /// Lead that compensates the drive's lag, likewise: 1/64 of 0.1 µm.
    lag_q6: i32,
}

impl Axis {
    /// Ties motor counts to a length, at rest.
    #[must_use]
    pub const fn zeroed(counts: i32, length: i32) -> Self {
        Self {
            zero_counts: counts,
            zero_length: length,
            trim_q9: 0,
            lag_q6: 0,
        }
    }

    /// The motor carries its load this far from where it was zeroed, 0.1 µm: from here on that is the set-point.
    pub(crate) const fn shift(&mut self, by: i32) {
        self.zero_length = self.zero_length.saturating_sub(by);
    }

    /// Learns from one tick under torque: lengths by the motor and by the drum encoder, 0.1 µm.
    #[inline]
    pub fn learn(&mut self, config: &CableConfig, target: &Target, by_motor: i32, length: i32) {
        // Within half an encoder count the difference is quantisation and carries no information.
        let half_count = config.half_count;
        let with_trim = by_motor.saturating_add(self.trim_q9 >> TRIM_BITS);
        let gap = length.saturating_sub(with_trim);
        // Half a count is 15 um on the paper's drum: below it the drum may not have moved at all.
        let beyond = gap - gap.clamp(-half_count, half_count);
        let most = const { TRIM_MAX * TRIM_TIME_MS };
        self.trim_q9 = self.trim_q9.saturating_add(beyond).clamp(-most, most);
        let with_trim = by_motor.saturating_add(self.trim_q9 >> TRIM_BITS);
        // By the motor with its trim: the drum's own counts are too coarse for a lag of
        // micrometres.
        let behind = target.length.saturating_sub(with_trim);
        let most = const { LAG_MAX * LAG_TIME_MS };
        self.lag_q6 = self.lag_q6.saturating_add(behind).clamp(-most, most);
    }

    /// How far the motor is behind the target, 0.1 µm, independent of the drum encoder:
    /// distinguishes a dead drive from a dead encoder.
    #[must_use]
    pub fn motor_error(&self, target: &Target, by_motor: i32) -> i32 {
        let by_motor = i64::from(by_motor) + i64::from(self.trim_q9 >> TRIM_BITS);
        saturate(i64::from(target.length) - by_motor)
    }

    /// How far motor and drum are apart beyond a sixty-fourth of the distance travelled (a drum
    /// that is not exactly as described), 0.1 µm: detects a stuck encoder on a cable that is not
    /// held by length (S2).
    #[must_use]
    pub fn slipped(&self, by_motor: i32, length: i32) -> i32 {
        // 1/64 is 1.6 %: an error of the drum's ratio grows with the distance and is not a slip.
        let way = by_motor.saturating_sub(self.zero_length).saturating_abs();
        let gap = by_motor.saturating_sub(length);
        gap.signum() * (gap.saturating_abs() - way / 64).max(0)
    }

    /// Length by the motor's counts alone, since the axis was enabled, 0.1 µm, carried on from the
    /// time of the feedback to now by its speed (µm/s).
    #[must_use]
    #[inline]
    pub(crate) fn by_motor(
        &self,
        config: &CableConfig,
        drive: &DriveInput,
        speed_umps: i32,
    ) -> i32 {
        // Wrapping: a drive's counter of 32 bits may pass its end between two ticks.
        let counts = drive.counts.wrapping_sub(self.zero_counts);
        let moved = floor_q32(counts, config.length_per_motor_q32);
        // Besides whole ticks half a one: the drive read its encoder at some time between two ticks, the
        // drum is read at their beginning. At 200 mm/s that is 0.1 mm, which the trim would learn, and keep
        // for half a second after the drum has turned round.
        // µm/s times ms is 1e-3 µm, that is 1/100 of 0.1 µm.
        let halves = 2 * i64::from(drive.age_ms) + 1;
        let since = quotient::<200>(i64::from(speed_umps) * halves);
        saturate(i64::from(self.zero_length) + moved + since)
    }

    /// Whether the trim is at its bound.
    #[must_use]
    pub(crate) const fn trim_saturated(&self) -> bool {
        self.trim_q9.abs() >= TRIM_MAX * TRIM_TIME_MS
    }

    /// Motor counts for the target, led by the drive's lag.
    #[must_use]
    pub fn counts(&self, config: &CableConfig, target: &Target) -> i32 {
        // µm/s times µs is 1e-6 µm; 1e5 of them are 0.1 µm. The square term carries another 2e6, of
        // which the configuration has already taken 1e3.
        let by_speed =
            quotient::<100_000>(i64::from(target.speed_umps) * i64::from(config.lead_us));
        // Half of a t^2, the next term of the series.
        let by_acceleration = quotient::<200>(quotient::<1_000_000>(
            i64::from(target.acceleration_umps2) * i64::from(config.lead_square),
        ));
        // Both in 1/512 of 0.1 um: the lag leads, the trim is taken back.
        let trims = ((self.lag_q6 << (TRIM_BITS - LAG_BITS)) - self.trim_q9) >> TRIM_BITS;
        let ahead = by_speed + by_acceleration + i64::from(trims);
        let change = i64::from(target.length) - i64::from(self.zero_length) + ahead;
        let counts = mul_q32(saturate(change), config.motor_per_length_q32);
        self.zero_counts.wrapping_add(counts)
    }

    /// Speed limit for the drive: the plan's speed and a reserve to catch up.
    #[must_use]
    pub fn rpm(config: &CableConfig, target: &Target) -> u16 {
        let speed = target.speed_umps.saturating_abs();
        let planned = mul_q32(speed, config.rpm_per_speed_q32);
        // At least 1 rpm: a limit of 0 would forbid a drive to hold its position.
        let catch_up = i32::from(config.max_rpm) * CATCH_UP_PERCENT / 100;
        let wanted = planned.saturating_add(catch_up.max(1));
        u16::try_from(wanted).map_or(config.max_rpm, |rpm| rpm.min(config.max_rpm))
    }
}

/// The drum's surface speed by the motor, µm/s, positive as the cable pays out.
#[must_use]
pub fn motor_speed_umps(config: &CableConfig, drive: &DriveInput) -> i32 {
    // Motor speeds are coarse: 1 rpm is 5.6 um/s behind 371:1, and 78 um/s behind 27:1.
    let speed = saturate((i64::from(drive.rpm) * config.speed_per_rpm_q16) >> 16);
    if config.motor_reversed { -speed } else { speed }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_drives_reading_is_carried_on_by_half_a_tick_beside_whole_ones() {
        let axis = Axis::zeroed(1000, 5_000_000);
        let config = CableConfig::NOTHING;
        for (age_ms, ahead) in [(0, 1_000), (3, 7_000)] {
            let drive = DriveInput {
                counts: 1000,
                age_ms,
                ..DriveInput::default()
            };
            // 200 mm/s times half a millisecond are 0.1 mm; three and a half are 0.7.
            let length = axis.by_motor(&config, &drive, 200_000);
            assert_eq!(length - 5_000_000, ahead);
            assert_eq!(axis.by_motor(&config, &drive, -200_000) - 5_000_000, -ahead);
        }
    }
}
