//! Checks of a motion's knots: in range, continuous with the knot before, and no faster than the
//! winches (K3 to K7).

use super::{Control, Controller, START_TOLERANCE, State};
use crate::fixed::{division, narrow};
use crate::segment::StoredKnot;
use mcdpr_protocol::{CableKnot, Knot, Reject, Reply, TenthMicrometres};

impl<const N: usize> Controller<N> {
    pub(super) fn handle_knot(&mut self, knot: &Knot) -> Result<Reply, Reject> {
        self.only_in(&[State::Holding, State::Moving, State::Pausing])?;
        self.no_fault()?;
        // Before anything else: the zips below would silently ignore missing cables.
        Self::count(knot.cables.len())?;
        for row in knot.rows.iter() {
            Self::count(row.lengths.len())?;
            Self::count(row.tensions.len())?;
        }
        let expected = self.motion.next_index();
        // A repeated or skipped knot would shift the whole path (L3, L4).
        if knot.index != expected {
            return Err(Reject::KnotIndex { expected });
        }
        if self.motion.free() == 0 {
            return Err(Reject::BufferFull);
        }
        self.check_ranges(knot)?;
        match self.motion.newest() {
            None => self.check_first(knot)?,
            Some(newest) => self.check_joined(newest, knot)?,
        }
        // The last knot must be at rest: the path clock simply stops there.
        if knot.last && knot.cables.iter().any(|cable| cable.velocity.0 != 0) {
            return Err(Reject::KnotEnd);
        }
        let slot = self.motion.append().ok_or(Reject::BufferFull)?;
        slot.fill(knot);
        Ok(Reply::Queued {
            free: self.motion.free(),
        })
    }

    fn check_ranges(&self, knot: &Knot) -> Result<(), Reject> {
        let active = self.active.as_ref().ok_or(Reject::NotConfigured)?;
        for (cable, (value, config)) in (1_u8..).zip(knot.cables.iter().zip(&active.cables)) {
            if !(config.length_min..=config.length_max).contains(&value.length.0) {
                return Err(Reject::KnotLength { cable });
            }
            if value.velocity.0.saturating_abs() > config.max_speed_umps {
                return Err(Reject::KnotSpeed { cable });
            }
            // A cable cannot push, and a set-point over the ceiling would stop the robot (C2).
            if !(0..=config.ceiling_mn).contains(&value.tension.0) {
                return Err(Reject::KnotTension { cable });
            }
        }
        Ok(())
    }

    fn check_first(&self, knot: &Knot) -> Result<(), Reject> {
        if knot.time_ms != 0 {
            return Err(Reject::KnotTime { earliest_ms: 0 });
        }
        let active = self.active.as_ref().ok_or(Reject::NotConfigured)?;
        let starts = self.cables.iter().zip(knot.cables.iter());
        for (number, ((cable, start), config)) in (1_u8..).zip(starts.zip(&active.cables)) {
            // The length of a tension-held cable follows from its tension: it is only expected.
            let bound = config.control == Control::Length;
            let gap = start.length.0.saturating_sub(cable.target.length);
            // Compared with the set-point, not with the measurement: the drive follows the
            // set-point.
            if (bound && gap.saturating_abs() > START_TOLERANCE) || start.velocity.0 != 0 {
                return Err(Reject::KnotStart {
                    cable: number,
                    gap: TenthMicrometres(gap),
                });
            }
        }
        Ok(())
    }

    fn check_joined(&self, newest: &StoredKnot<N>, knot: &Knot) -> Result<(), Reject> {
        // A motion has one end; the next one begins with knot 0.
        if newest.last {
            return Err(Reject::KnotEnd);
        }
        let (earliest_ms, latest_ms) = self.motion.time_window_ms();
        let later = knot.time_ms > newest.time_ms;
        // At least 4 ms ahead of the path's clock: the segment before must not have ended yet.
        if !later || knot.time_ms < earliest_ms || knot.time_ms > latest_ms {
            return Err(Reject::KnotTime { earliest_ms });
        }
        let spacing = knot.time_ms - newest.time_ms;
        let active = self.active.as_ref().ok_or(Reject::NotConfigured)?;
        let pairs = newest.cables.iter().zip(knot.cables.iter());
        for (cable, ((from, to), config)) in (1_u8..).zip(pairs.zip(&active.cables)) {
            let Some(speeds) = Speeds::between(from, to, spacing) else {
                return Err(Reject::KnotSpeed { cable });
            };
            if speeds.are_over(config.max_speed_umps) {
                return Err(Reject::KnotSpeed { cable });
            }
            if speeds.accelerate_over(spacing, config.max_acceleration_umps2) {
                return Err(Reject::KnotAcceleration { cable });
            }
            if speeds.jerk_over(spacing, config.max_jerk_mmps3) {
                return Err(Reject::KnotJerk { cable });
            }
        }
        Ok(())
    }
}

/// Largest speed that is checked exactly, µm/s: sums of three of them fit 32 bits.
// 100 m/s. `start - 2 (3 mean - start - end) + end` is at most 12 times that: 1.2e9, under 2^31.
const FAR_TOO_FAST: i32 = 100_000_000;

/// Speeds of one cable's cubic between two knots, µm/s, each [`FAR_TOO_FAST`] at most; a fifth of
/// it for acceleration and jerk, where no configuration allows more. The chip multiplies 32 bits in
/// one instruction, and a knot is checked within a control tick.
struct Speeds {
    start: i32,
    mean: i32,
    end: i32,
}

impl Speeds {
    /// `None` if one is far above any limit. The mean is rounded towards zero.
    fn between(from: &CableKnot, to: &CableKnot, spacing_ms: u32) -> Option<Self> {
        // 0.1 µm per ms is 100 µm/s.
        let way = (i64::from(to.length.0) - i64::from(from.length.0)) * 100;
        // A way of up to 2.1 m takes one division of 32 bits; others take the long one.
        let mean = match narrow(way) {
            Some(way) => way / spacing_ms.cast_signed().max(1),
            None => narrow(division(way, i64::from(spacing_ms.max(1))))?,
        };
        let (start, end) = (from.velocity.0, to.velocity.0);
        let is_slow = |speed: &i32| speed.unsigned_abs() <= FAR_TOO_FAST.unsigned_abs();
        [start, mean, end]
            .iter()
            .all(is_slow)
            .then_some(Self { start, mean, end })
    }

    /// Whether the cubic is anywhere faster than a limit, µm/s. Its derivative is the quadratic
    /// with the Bézier values `start, middle, end`; its extremum, if it lies inside, is exact.
    fn are_over(&self, limit_umps: i32) -> bool {
        let &Self { start, mean, end } = self;
        if start.abs() > limit_umps || end.abs() > limit_umps {
            return true;
        }
        // From the Hermite cubic: the derivative's Bezier values are v0, 3 mean - v0 - v1, v1.
        let middle = 3 * mean - start - end;
        // The quadratic's leading coefficient: 0 for a straight line, which is largest at an end.
        let bend = start - 2 * middle + end;
        // The extremum is at s = (start - middle) / bend: inside if 0 < s < 1.
        let along = (start - middle) * bend.signum();
        // The extremum is (start * end - middle²) / bend; if the middle is within the limit, too,
        // it cannot exceed it.
        // The limit plus 1 um/s: the rounded mean must not refuse a plan at exactly the limit.
        bend != 0
            && middle.abs() > limit_umps
            && along > 0
            && along < bend.abs()
            && (times(start, end) - times(middle, middle)).abs()
                >= times(bend.abs(), limit_umps.saturating_add(1))
    }

    /// Whether the acceleration, which is largest at an end, is over a limit, µm/s².
    fn accelerate_over(&self, spacing_ms: u32, limit_umps2: i32) -> bool {
        let &Self { start, mean, end } = self;
        let most = times(limit_umps2, spacing_ms.cast_signed());
        // um/s per ms, times 1000, are um/s^2. Example: 50 mm/s in 10 ms are 5 m/s^2.
        let over = |change: i32| times(change.abs(), 1000) > most;
        // The second derivative of the Hermite cubic at s = 0 and s = 1, times the spacing.
        over(6 * mean - 4 * start - 2 * end) || over(6 * mean - 2 * start - 4 * end)
    }

    /// Whether the jerk, which is one all along, is over a limit, mm/s³.
    fn jerk_over(&self, spacing_ms: u32, limit_mmps3: i32) -> bool {
        let &Self { start, mean, end } = self;
        let square = (spacing_ms * spacing_ms).cast_signed();
        // The third derivative times the spacing squared; um/s per ms^2, times 1000, are mm/s^3.
        let change = 6 * (start + end) - 12 * mean;
        times(change.abs(), 1000) > times(limit_mmps3, square)
    }
}

const fn times(a: i32, b: i32) -> i64 {
    a as i64 * b as i64
}

#[cfg(test)]
#[expect(
    clippy::cast_possible_truncation,
    clippy::float_arithmetic,
    reason = "a reference in f64, of values that are bounded"
)]
mod tests {
    use super::*;
    use mcdpr_protocol::{MicrometresPerSecond, Millinewtons};

    fn knot(length: i32, velocity: i32) -> CableKnot {
        CableKnot {
            length: TenthMicrometres(length),
            velocity: MicrometresPerSecond(velocity),
            tension: Millinewtons(0),
        }
    }

    fn is_faster(from: &CableKnot, to: &CableKnot, spacing_ms: u32, limit_umps: i32) -> bool {
        Speeds::between(from, to, spacing_ms).is_none_or(|speeds| speeds.are_over(limit_umps))
    }

    /// Asserts the largest speed, µm/s, over 1 s.
    fn peaks_at(from: &CableKnot, to: &CableKnot, speed: i32) {
        assert!(!is_faster(from, to, 1000, speed), "more than {speed} µm/s");
        assert!(is_faster(from, to, 1000, speed - 1), "under {speed} µm/s");
    }

    #[test]
    fn a_rest_to_rest_cubic_peaks_at_one_and_a_half_times_its_mean() {
        // 10 mm in 1 s: mean 10 mm/s.
        peaks_at(&knot(0, 0), &knot(100_000, 0), 15_000);
        peaks_at(&knot(100_000, 0), &knot(0, 0), 15_000);
    }

    #[test]
    fn constant_speed_and_out_and_back_are_exact() {
        peaks_at(&knot(0, 10_000), &knot(100_000, 10_000), 10_000);
        // Out and back over 1 s: D = v (1 - 2 s), largest at the ends.
        peaks_at(&knot(0, 8000), &knot(0, -8000), 8000);
        // Same ends, no net distance: D = v (1 - 6 s (1 - s)), -v/2 in the middle.
        peaks_at(&knot(0, 8000), &knot(0, 8000), 8000);
    }

    #[test]
    fn a_speed_that_only_the_inside_of_a_segment_has_is_found_over_any_time() {
        // From rest to rest the peak is one and a half times the mean, for any time.
        for spacing_ms in [4_u32, 7, 100, 999, 4000] {
            let way = 30 * spacing_ms.cast_signed();
            let (from, to) = (knot(0, 0), knot(way, 0));
            assert!(!is_faster(&from, &to, spacing_ms, 4500), "{spacing_ms}");
            assert!(is_faster(&from, &to, spacing_ms, 4499), "{spacing_ms}");
        }
        // 2^31 of 0.1 µm in 4 ms.
        assert!(is_faster(
            &knot(i32::MIN, 0),
            &knot(i32::MAX, 0),
            4,
            i32::MAX
        ));
    }

    #[test]
    fn k3_acceleration_and_jerk_are_those_of_eq_53() {
        let mut state: u64 = 1;
        let mut any = |most: i64| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            (state >> 33).cast_signed() % (2 * most + 1) - most
        };
        for spacing_ms in [4_u32, 7, 21, 100, 999, 4000] {
            for speed in [1000, 50_000, 2_000_000, 20_000_000] {
                let (start, end, mean) = (any(speed) as i32, any(speed) as i32, any(speed));
                let way = (mean * i64::from(spacing_ms) / 100) as i32;
                let (from, to) = (knot(-way / 2, start), knot(way - way / 2, end));
                let speeds = Speeds::between(&from, &to, spacing_ms).unwrap();
                let h = f64::from(spacing_ms) * 1e-3;
                let [v0, v1] = [start, end].map(f64::from);
                let mean = f64::from(way) * 0.1 / h;
                let at = |s: f64| {
                    (6.0 * mean - 4.0 * v0 - 2.0 * v1 + s * (6.0 * (v0 + v1) - 12.0 * mean)) / h
                };
                let (most, jerk) = (
                    at(0.0).abs().max(at(1.0).abs()),
                    (at(1.0) - at(0.0)).abs() / h,
                );
                // The mean is good to 1 µm/s.
                holds_over(most, 6.0 / h, 1e9, |limit| {
                    speeds.accelerate_over(spacing_ms, limit)
                });
                let (jerk, near) = (jerk * 1e-3, 12e-3 / (h * h));
                holds_over(jerk, near, 1e7, |limit| speeds.jerk_over(spacing_ms, limit));
            }
        }
    }

    /// Asserts that the check holds for limits below a value, and not for those above it.
    fn holds_over(value: f64, near: f64, largest: f64, over: impl Fn(i32) -> bool) {
        let above = value + near + 1.0;
        assert!(above > largest || !over(above as i32), "{value}");
        let below = (value - near - 1.0).min(largest);
        assert!(below < 1.0 || over(below as i32), "{value}");
    }
}
