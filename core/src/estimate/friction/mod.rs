//! Friction of winches while they work, from the samples of motions and rests.
//!
//! **In motion**, of winches held by tension. A drum that turns steadily tells its gear's friction: the motor's torque is
//! that friction and the cable's tension over the gear's efficiency while it reels in, and the tension times the
//! efficiency of back-driving less the friction while it pays out (the model of the robot file, as `commission`
//! identifies it). A motion is cut into stretches of a tenth of a second; a parabola through the drum's way gives speed and acceleration of each, and those in which the
//! drum turns clearly are averaged.
//!
//! Only a gear that rubs clearly shows it: one that loses a tenth more torque than its file says looks the same, in both
//! directions, so that the standard error grows with the tension over the friction.
//!
//! **At rest**, of winches held by length, from the two currents between which their drives hunt (`swing`). In motion
//! a drive that follows positions in steps of two milliseconds has a ripple in its current that grows with the speed, and
//! samples it always at the same moment of these steps: on `paper-table5` the friction of such winches reads -2 to 4 N
//! instead of 10 (docs/results/winch.md).

mod swing;

use crate::motion::Model;
use crate::robot::Winch;
use serde::{Deserialize, Serialize};

/// Ticks of one stretch, ms.
const STRETCH: usize = 100;
/// Least speed of a drum that counts, m/s, and in times of the speed at which static friction has gone: with four of
/// these exp(-16) of it is left.
const LEAST_MPS: f64 = 0.002;
const STRIBECK: f64 = 4.0;
/// What the acceleration takes may be this share of the friction at most: it is corrected, but comes from a measured
/// way.
const INERTIA: f64 = 0.5;
/// Standard deviation before anything is known: a cold gear rubs twice as much.
const PRIOR: f64 = 0.5;
/// Standard deviation of one stretch or rest, as a share of the file's friction, and its least value, N.
const STRETCH_SHARE: f64 = 0.1;
const STRETCH_N: f64 = 0.5;
/// Growth of the standard deviation with time: a tenth within five minutes, in which a gear warms up.
const DRIFT_PER_SQRT_S: f64 = 0.1 / 17.3;
/// What all of them have in common: the torque constant of the file, as a share of its friction, and the efficiency of
/// the file, as a share of the tension: a gear that loses more looks like one that rubs more, in both directions.
const CONSTANT: f64 = 0.05;
const EFFICIENCY: f64 = 0.06;
/// At rest also the ratio of static friction to Coulomb friction: 1.2 to 1.5 for greased metal (Armstrong-Helouvry et
/// al., 1994), where `paper-table5` has 1.3.
const STATIC: f64 = 0.08;
/// Friction that is planned and configured with, over that of the file: a value beyond is no change of temperature.
pub const BOUNDS: [f64; 2] = [0.5, 2.0];
/// Standard error beyond which the file's friction is kept.
const KNOWN: f64 = 0.15;

/// Friction of one winch relative to the robot file.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Friction {
    /// Coulomb friction of rotor and gear over that of the file.
    pub share: f64,
    /// Its standard error, with what all measurements have in common.
    pub share_se: f64,
}

impl Friction {
    /// What plans and the board's configuration use: within [`BOUNDS`], and 1 while it is not known.
    #[must_use]
    pub fn used(&self) -> f64 {
        if self.share_se > KNOWN {
            return 1.0;
        }
        self.share.clamp(BOUNDS[0], BOUNDS[1])
    }

    /// Whether it is beyond what is used: dirt, damage, or a file of another winch.
    #[must_use]
    pub fn is_beyond(&self) -> bool {
        let [least, most] = BOUNDS;
        self.share_se <= KNOWN && !(least..=most).contains(&self.share)
    }
}

/// A winch that shows its friction.
#[derive(Debug, Clone)]
struct Turning {
    share: f64,
    /// Standard error without what all measurements have in common.
    own_se: f64,
    /// That, as a share of the file's friction.
    common_se: f64,
    /// Held by tension: it shows its friction in motion, the others at rest.
    by_tension: bool,
    stretch: Stretch,
}

/// Samples of one stretch.
#[derive(Debug, Clone, Default)]
struct Stretch {
    last_tick: Option<u32>,
    lengths_m: Vec<f64>,
    tension_n: f64,
    current_a: f64,
}

/// The frictions of a robot's winches, cable by cable; `None` for those that do not show theirs.
#[derive(Debug, Clone)]
pub(crate) struct Frictions {
    cables: Vec<Option<Turning>>,
}

impl Frictions {
    /// Nothing measured yet.
    #[must_use]
    pub fn new(model: &Model) -> Self {
        let by_tension = model.holding().by_tension();
        let cables = (0..model.robot().cables.len()).map(|cable| {
            let winch = model.robot().winch_of(cable)?;
            (rubs_n(winch) > 0.0).then(|| Turning {
                share: 1.0,
                own_se: PRIOR,
                common_se: 0.0,
                by_tension: by_tension.contains(&cable),
                stretch: Stretch::default(),
            })
        });
        Self {
            cables: cables.collect(),
        }
    }

    /// Goes on from what was kept, `seconds` later. Ignored where it does not belong to these cables.
    pub fn resume(&mut self, kept: &[Option<Friction>], seconds: f64) {
        for (cable, kept) in self.cables.iter_mut().zip(kept) {
            let valid = |found: &&Friction| found.share.is_finite() && found.share_se > 0.0;
            if let (Some(turning), Some(found)) = (cable, kept.as_ref().filter(valid)) {
                let drift = DRIFT_PER_SQRT_S * seconds.max(0.0).sqrt();
                turning.share = found.share;
                turning.own_se = libm::hypot(found.share_se, drift).min(PRIOR);
            }
        }
    }

    /// What is known, cable by cable.
    #[must_use]
    pub fn all(&self) -> Vec<Option<Friction>> {
        let of = |turning: &Turning| Friction {
            share: turning.share,
            share_se: libm::hypot(turning.own_se, turning.common_se),
        };
        let cables = self.cables.iter();
        cables
            .map(|cable| {
                let shown = cable.as_ref().filter(|turning| turning.own_se < PRIOR);
                shown.map(of)
            })
            .collect()
    }

    /// Friction to use over that of the file, cable by cable.
    #[must_use]
    pub fn used(&self) -> Vec<f64> {
        let all = self.all().into_iter();
        all.map(|found| found.map_or(1.0, |found| found.used()))
            .collect()
    }

    /// Takes one tick of a motion: lengths by the drum encoders (m), tensions (N) and motor currents (A).
    pub fn take(
        &mut self,
        model: &Model,
        tick: u32,
        lengths_m: &[f64],
        tensions_n: &[f64],
        currents_a: &[f64],
    ) {
        for (index, cable) in self.cables.iter_mut().enumerate() {
            let Some(turning) = cable.as_mut().filter(|turning| turning.by_tension) else {
                continue;
            };
            let stretch = &mut turning.stretch;
            let values = (
                lengths_m.get(index),
                tensions_n.get(index),
                currents_a.get(index),
            );
            let ((Some(length_m), Some(tension_n), Some(current_a)), Some(winch)) =
                (values, model.robot().winch_of(index))
            else {
                continue;
            };
            if stretch
                .last_tick
                .is_some_and(|last| last.wrapping_add(1) != tick)
            {
                *stretch = Stretch::default();
            }
            stretch.last_tick = Some(tick);
            stretch.lengths_m.push(*length_m);
            stretch.tension_n += tension_n / STRETCH as f64;
            stretch.current_a += current_a / STRETCH as f64;
            if stretch.lengths_m.len() < STRETCH {
                continue;
            }
            let whole = std::mem::take(stretch);
            stretch.last_tick = Some(tick);
            if let Some(rubs_n) = measured_n(winch, &whole) {
                let seconds = STRETCH as f64 * 1e-3;
                let common = libm::hypot(
                    CONSTANT,
                    EFFICIENCY * whole.tension_n.abs() / self::rubs_n(winch),
                );
                turning.pass(seconds);
                turning.learn(rubs_n, self::rubs_n(winch), STRETCH_N);
                turning.common_se = common;
            }
        }
    }

    /// Takes a rest, `seconds` after the one before: tensions (N) and motor currents (A) of its ticks. Ticks without the
    /// value of a cable are left out.
    pub fn rested(&mut self, model: &Model, ticks: &[Ticked<'_>], seconds: f64) {
        for (index, cable) in self.cables.iter_mut().enumerate() {
            let Some(turning) = cable.as_mut().filter(|turning| !turning.by_tension) else {
                continue;
            };
            turning.pass(seconds.max(0.0));
            let tensions = ticks.iter().filter_map(|tick| tick.tensions_n.get(index));
            let currents = ticks.iter().filter_map(|tick| tick.currents_a.get(index));
            let (tension_n, scatter_n) = mean_and_deviation(tensions.copied());
            let currents_a: Vec<f64> = currents.copied().collect();
            let found = swing::ends_a(&currents_a).and_then(|ends_a| {
                let winch = model.robot().winch_of(index)?;
                Some((swing::rubs_n(winch, ends_a, tension_n)?, rubs_n(winch)))
            });
            if let Some((rubs_n, file_n)) = found {
                turning.learn(rubs_n, file_n, STRETCH_N.max(scatter_n));
                let known = libm::hypot(CONSTANT, STATIC);
                turning.common_se = libm::hypot(known, EFFICIENCY * tension_n.abs() / file_n);
            }
        }
    }
}

/// One tick at rest, a value a cable.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ticked<'a> {
    /// Tensions, N.
    pub tensions_n: &'a [f64],
    /// Motor currents, A.
    pub currents_a: &'a [f64],
}

/// Mean and standard deviation; zeros of nothing.
fn mean_and_deviation(values: impl Iterator<Item = f64> + Clone) -> (f64, f64) {
    let count = values.clone().count().max(1) as f64;
    let mean = values.clone().sum::<f64>() / count;
    let squares: f64 = values.map(|value| (value - mean).powi(2)).sum();
    (mean, (squares / count).sqrt())
}

impl Turning {
    /// So many seconds pass, in which a gear warms up or cools down.
    fn pass(&mut self, seconds: f64) {
        let drift = DRIFT_PER_SQRT_S * seconds.sqrt();
        self.own_se = libm::hypot(self.own_se, drift).min(PRIOR);
    }

    /// One more friction, N, with this standard deviation, N, of a winch with `file_n`.
    fn learn(&mut self, rubs_n: f64, file_n: f64, deviation_n: f64) {
        let before = self.own_se * self.own_se;
        let noise = (deviation_n / file_n).max(STRETCH_SHARE).powi(2);
        let gain = before / (before + noise);
        self.share += gain * (rubs_n / file_n - self.share);
        self.own_se = ((1.0 - gain) * before).sqrt();
    }
}

/// Coulomb friction of rotor and gear by the file, at the cable, N.
fn rubs_n(winch: &Winch) -> f64 {
    winch.total_friction_n() - winch.friction_n
}

/// Coulomb friction of rotor and gear that a stretch shows, at the cable, N; `None` if its drum did not turn clearly.
fn measured_n(winch: &Winch, stretch: &Stretch) -> Option<f64> {
    let gear = winch.gear.as_ref()?;
    let (speed_mps, rate_mps2) = parabola(&stretch.lengths_m);
    let per_rpm = winch.max_cable_speed_mps() / winch.max_motor_rpm;
    let least_mps = LEAST_MPS.max(STRIBECK * gear.stribeck_rpm * per_rpm);
    let inertia_n = winch.effective_mass_kg() * rate_mps2;
    if speed_mps.abs() < least_mps || inertia_n.abs() > INERTIA * rubs_n(winch) {
        return None;
    }
    // Positive where the motor reels in.
    let motor_n = -winch.motor_counts_per_turn.signum()
        * stretch.current_a
        * winch.force_per_current_n_per_a();
    let reels = speed_mps < 0.0;
    let drum_n = stretch.tension_n - winch.friction_n.copysign(speed_mps);
    let load_n = if reels {
        drum_n / gear.efficiency
    } else {
        drum_n * gear.backdrive_efficiency
    };
    let viscous_n = gear.viscous_nm_per_rpm * speed_mps.abs() / per_rpm * winch.gear_ratio
        / winch.drum_radius_m;
    // A drum that pays out ever faster takes less from the motor.
    let taken_n = motor_n - load_n + inertia_n;
    Some(taken_n * if reels { 1.0 } else { -1.0 } - viscous_n)
}

/// Speed (m/s) and acceleration (m/s2) in the middle of a way that was read every millisecond: least squares.
fn parabola(way_m: &[f64]) -> (f64, f64) {
    let count = way_m.len() as f64;
    let middle = 0.5 * (count - 1.0);
    let at = |index: usize| (index as f64 - middle) * 1e-3;
    let sum = |of: &dyn Fn(f64, f64) -> f64| -> f64 {
        let points = way_m.iter().enumerate();
        points.map(|(index, way)| of(at(index), *way)).sum()
    };
    let (second, fourth) = (sum(&|t, _| t * t) / count, sum(&|t, _| t.powi(4)) / count);
    let speed = sum(&|t, way| t * way) / count / second;
    let half = sum(&|t, way| (t * t - second) * way) / count / (fourth - second * second);
    (speed, 2.0 * half)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Robot;

    fn model() -> Model {
        Model::new(&Robot::built_in("paper-table5").unwrap()).unwrap()
    }

    /// A motion of cable 4 to and fro at 20 mm/s, of a winch that rubs `share` times as much as the file says.
    fn work(frictions: &mut Frictions, model: &Model, share: f64, seconds: u32) {
        let winch = model.robot().winch_of(3).unwrap();
        let gear = winch.gear.as_ref().unwrap();
        let per_rpm = winch.max_cable_speed_mps() / winch.max_motor_rpm;
        let viscous_n =
            gear.viscous_nm_per_rpm * 0.02 / per_rpm * winch.gear_ratio / winch.drum_radius_m;
        for tick in 0..seconds * 1000 {
            let second = tick / 1000;
            let since_m = f64::from(tick % 1000) * 2e-5;
            let out = second % 2 == 0;
            let length_m = 0.4 + if out { since_m } else { 0.02 - since_m };
            let rubs_n = share * rubs_n(winch) + viscous_n;
            let motor_n = if out {
                (9.0 - winch.friction_n) * gear.backdrive_efficiency - rubs_n
            } else {
                (9.0 + winch.friction_n) / gear.efficiency + rubs_n
            };
            let current_a = -motor_n / winch.force_per_current_n_per_a();
            frictions.take(model, tick, &[length_m; 4], &[9.0; 4], &[current_a; 4]);
        }
    }

    #[test]
    fn friction_of_the_tension_held_winch_is_followed_and_the_others_do_not_show_theirs() {
        let model = model();
        let mut frictions = Frictions::new(&model);
        assert_eq!(frictions.used(), [1.0; 4], "nothing is known yet");
        work(&mut frictions, &model, 1.6, 10);
        let all = frictions.all();
        assert!(all[..3].iter().all(Option::is_none), "{all:?}");
        let found = all[3].unwrap();
        assert!(
            (found.share - 1.6).abs() < 0.05 && found.share_se < 0.1,
            "{found:?}"
        );
        assert!((frictions.used()[3] - found.share).abs() < 1e-12);
        // It warms up.
        work(&mut frictions, &model, 0.9, 60);
        let found = frictions.all()[3].unwrap();
        assert!((found.share - 0.9).abs() < 0.1, "{found:?}");
    }

    #[test]
    fn a_light_gear_under_a_large_tension_does_not_show_its_friction() {
        // 2 N of friction under 25 N: a tenth of its loss is as much.
        let mut robot = Robot::built_in("paper-table5").unwrap();
        for winch in &mut robot.winches {
            let gear = winch.gear.as_mut().unwrap();
            (gear.rotor_friction_nm, gear.gear_friction_nm) = (6e-5, 5e-5);
        }
        let model = Model::new(&robot).unwrap();
        let mut frictions = Frictions::new(&model);
        work(&mut frictions, &model, 1.4, 20);
        let found = frictions.all()[3].unwrap();
        assert!((found.share - 1.4).abs() < 0.1, "{found:?}");
        assert!(found.share_se > 0.2 && found.used() == 1.0, "{found:?}");
    }

    #[test]
    fn what_is_used_stays_within_its_bounds_and_a_drum_at_rest_teaches_nothing() {
        let model = model();
        let mut frictions = Frictions::new(&model);
        work(&mut frictions, &model, 5.0, 20);
        let found = frictions.all()[3].unwrap();
        assert!(found.share > 4.0 && found.is_beyond(), "{found:?}");
        assert_eq!(frictions.used()[3], BOUNDS[1]);
        let before = frictions.all();
        for tick in 0..5000 {
            frictions.take(&model, tick, &[0.4; 4], &[9.0; 4], &[0.3; 4]);
        }
        assert_eq!(frictions.all(), before);
    }

    #[test]
    fn rests_at_which_a_winch_shows_nothing_make_its_friction_uncertain_again() {
        fn ticks(currents_a: &[Vec<f64>]) -> Vec<Ticked<'_>> {
            let tick = |currents_a| Ticked {
                tensions_n: &[13.8; 4],
                currents_a,
            };
            currents_a.iter().map(|a| tick(a.as_slice())).collect()
        }
        let model = model();
        let mut frictions = Frictions::new(&model);
        // As measured on cable 1 under 13.8 N, 900 ms from end to end and back, with the file's friction.
        let swing = |tick: usize| {
            let phase = (tick % 900) as f64 / 450.0;
            let share = (1.25 * (1.0 - phase).abs() - 0.125).clamp(0.0, 1.0);
            vec![-0.316 + share * 0.378; 4]
        };
        let currents: Vec<Vec<f64>> = (0..2000).map(swing).collect();
        for _ in 0..3 {
            frictions.rested(&model, &ticks(&currents), 20.0);
        }
        let found = frictions.all()[0].unwrap();
        assert!((found.share - 1.0).abs() < 0.1, "{found:?}");
        assert_eq!(frictions.all()[3], None, "held by tension");
        let still = vec![vec![-0.1; 4]; 2000];
        frictions.rested(&model, &ticks(&still), 600.0);
        let later = frictions.all()[0].unwrap();
        assert!((later.share - found.share).abs() < 1e-12);
        assert!(
            later.share_se > found.share_se + 0.03,
            "{found:?} {later:?}"
        );
    }

    #[test]
    fn a_kept_friction_grows_uncertain_and_a_damaged_one_is_ignored() {
        let model = model();
        let mut frictions = Frictions::new(&model);
        work(&mut frictions, &model, 1.6, 10);
        let kept = frictions.all();
        let resumed = |kept: &[Option<Friction>], seconds: f64| {
            let mut frictions = Frictions::new(&model);
            frictions.resume(kept, seconds);
            frictions
        };
        assert_eq!(
            resumed(&kept, 0.0).all()[3].unwrap().share,
            kept[3].unwrap().share
        );
        assert!(resumed(&kept, 0.0).used()[3] > 1.5);
        // A day later the gear is cold again, or not: the file's value is as good.
        assert_eq!(resumed(&kept, 86_400.0).used(), [1.0; 4]);
        let broken = Friction {
            share: f64::NAN,
            share_se: 0.1,
        };
        assert_eq!(
            resumed(&[None, None, None, Some(broken)], 0.0).used(),
            [1.0; 4]
        );
    }
}
