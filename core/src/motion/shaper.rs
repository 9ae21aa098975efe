//! Input shaping: a time law convolved with impulses, so that it leaves no swing behind.

use super::options::Shaping;
use super::time_law::TimeLaw;

/// A mode slower than this is not shaped, because the motion would wait too long, Hz.
/// Half a period at 0.3 Hz is 1.7 s.
const SLOWEST_HZ: f64 = 0.3;

/// Impulses: time (s after the first) and share, summing to 1.
#[derive(Debug, Clone, PartialEq)]
pub struct Shaper {
    impulses: Vec<(f64, f64)>,
}

impl Shaper {
    /// The shaper that leaves an undamped motion as it is.
    #[must_use]
    pub fn none() -> Self {
        Self {
            impulses: vec![(0.0, 1.0)],
        }
    }

    /// A shaper against undamped modes of these frequencies, Hz; those that are not positive are
    /// left out. Source: Singer and Seering, 1990, at damping ratio 0.
    ///
    /// ```
    /// use mcdpr_core::motion::{Shaper, Shaping};
    /// let shaper = Shaper::new(Shaping::Zv, &[2.0]);
    /// assert_eq!(shaper.impulses(), [(0.0, 0.5), (0.25, 0.5)]);
    /// ```
    #[must_use]
    pub fn new(shaping: Shaping, modes_hz: &[f64]) -> Self {
        let weights: &[f64] = match shaping {
            Shaping::None => return Self::none(),
            Shaping::Zv => &[0.5, 0.5],
            Shaping::Zvd => &[0.25, 0.5, 0.25],
        };
        let mut impulses = vec![(0.0, 1.0)];
        for mode_hz in modes_hz.iter().filter(|&&hz| hz > SLOWEST_HZ) {
            // Two equal impulses half a period apart leave swings of opposite sign. Each mode
            // multiplies the number of impulses by 2 (ZV) or 3 (ZVD).
            let half_period_s = 0.5 / mode_hz;
            impulses = weights
                .iter()
                .zip(0_u8..)
                .flat_map(|(weight, count)| {
                    let later_s = f64::from(count) * half_period_s;
                    impulses
                        .iter()
                        .map(move |(at_s, share)| (at_s + later_s, share * weight))
                })
                .collect();
        }
        impulses.sort_by(|a, b| a.0.total_cmp(&b.0));
        Self { impulses }
    }

    /// The impulses, first at 0 s, shares summing to 1.
    #[must_use]
    pub fn impulses(&self) -> &[(f64, f64)] {
        &self.impulses
    }

    /// How much longer a motion gets, s.
    #[must_use]
    pub fn delay_s(&self) -> f64 {
        self.impulses.last().map_or(0.0, |last| last.0)
    }

    /// Distance and speed along a path at `time_s` after the start of the shaped motion, m and m/s.
    /// The distance along the path is what is shaped, so the tool stays on the path.
    #[must_use]
    pub fn at(&self, law: &TimeLaw, time_s: f64) -> (f64, f64) {
        let (mut way_m, mut speed_mps) = (0.0, 0.0);
        for (later_s, share) in &self.impulses {
            let state = law.at((time_s - later_s).clamp(0.0, law.duration_s()));
            way_m += share * state.position_m;
            speed_mps += share * state.velocity_mps;
        }
        // Shares sum to 1 only up to rounding: the path has no point beyond its end.
        (way_m.clamp(0.0, law.length_m()), speed_mps)
    }

    /// Residual swing at a frequency, as a share of that of the unshaped motion.
    #[must_use]
    pub fn residual(&self, mode_hz: f64) -> f64 {
        let turn = |at_s: f64| libm::sincos(std::f64::consts::TAU * mode_hz * at_s);
        let (mut across, mut along) = (0.0, 0.0);
        for (at_s, share) in &self.impulses {
            let (sin, cos) = turn(*at_s);
            across += share * sin;
            along += share * cos;
        }
        libm::hypot(across, along)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::time_law::Bounds;

    const MODES_HZ: [f64; 3] = [1.8, 1.9, 2.15];

    #[test]
    fn every_mode_is_cancelled_and_zvd_forgives_more() {
        let zv = Shaper::new(Shaping::Zv, &MODES_HZ);
        let zvd = Shaper::new(Shaping::Zvd, &MODES_HZ);
        for mode in MODES_HZ {
            assert!(zv.residual(mode) < 1e-12, "{}", zv.residual(mode));
            assert!(zvd.residual(mode * 1.1) < zv.residual(mode * 1.1));
        }
        assert!(Shaper::none().residual(1.9) > 0.999);
        let sum: f64 = zvd.impulses().iter().map(|(_, share)| share).sum();
        assert!((sum - 1.0).abs() < 1e-12);
        // Half a period of every mode; a whole one with derivative.
        let half: f64 = MODES_HZ.iter().map(|hz| 0.5 / hz).sum();
        assert!((zv.delay_s() - half).abs() < 1e-12);
        assert!((zvd.delay_s() - 2.0 * half).abs() < 1e-12);
    }

    #[test]
    fn a_shaped_motion_covers_its_way_and_is_never_faster() {
        let bounds = Bounds {
            speed_mps: 0.5,
            acceleration_mps2: 2.0,
            jerk_mps3: 40.0,
        };
        let law = TimeLaw::fastest(0.3, bounds).unwrap();
        let shaper = Shaper::new(Shaping::Zv, &MODES_HZ);
        let end_s = law.duration_s() + shaper.delay_s();
        assert_eq!(shaper.at(&law, 0.0), (0.0, 0.0));
        let (way, speed) = shaper.at(&law, end_s);
        assert!((way - 0.3).abs() < 1e-12 && speed.abs() < 1e-9);
        let mut last = 0.0;
        for step in 0..=2000 {
            let (way, speed) = shaper.at(&law, end_s * f64::from(step) / 2000.0);
            assert!(way >= last - 1e-12 && speed <= 0.5 + 1e-12);
            last = way;
        }
    }

    #[test]
    fn slow_and_unstable_modes_are_left_out() {
        assert_eq!(Shaper::new(Shaping::Zv, &[-1.0, 0.0, 0.01]), Shaper::none());
    }
}
