//! Torsional stiffness between motor and drum: the motor winds the gear up against the closed brake with a current that
//! grows slowly, in either direction, and its angle is compared with its torque while the drum stands.
//!
//! The motor's torque less its friction reaches the drum after the gear's loss, so that the slope is the stiffness over
//! the efficiency of driving. The current grows by the integral of the board's law for a force, damped by the motor's
//! speed: without damping the rotor would arrive behind the play with a knock that winds the gear up further than the
//! current does.

use super::{Bench, Purpose, Rubbing, ServiceError};
use crate::link::Link;
use crate::robot::{DriveKind, Winch};
use serde::Serialize;
use std::f64::consts::TAU;

/// How motor and drum yield to each other, with standard errors.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Stiffness {
    /// Torque per twist between motor and drum, at the drum, N m/rad: the slope times the efficiency.
    pub stiffness_nm_per_rad: f64,
    /// Its standard error, N m/rad, with that of the efficiency if it was measured.
    pub stiffness_se_nm_per_rad: f64,
    /// The slope itself: the motor's torque behind the gear's ratio but before its loss, per twist, N m/rad.
    pub before_loss_nm_per_rad: f64,
    /// Efficiency that it was multiplied with: measured with a weight, or that of the robot file.
    pub efficiency: f64,
}

/// Share of the motor's current beyond its friction that winds the gear up.
const WIND_SHARE: f64 = 0.5;
/// Share of the motor's largest current that is never exceeded.
const MOST_SHARE: f64 = 0.9;
/// Static friction over that in motion.
const STATIC: f64 = 1.4;
/// Of the current beyond friction, at most this last share is evaluated, and it must be at least the second: a rotor that
/// came through the play is wound up further than its current would do it, and sticks there until the current follows.
const LAST: f64 = 0.7;
const LEAST: f64 = 0.2;
/// Duration of the current's growth, s.
pub(super) const GROWS_S: f64 = 3.0;
/// Force at which the growth begins in the board's units of service, and by which it grows, N.
pub(super) const BEGINS_N: f64 = 0.5;
/// Time in which the damping would stop a free rotor, s: twice the delays of current and bus.
pub(super) const DAMPED_S: f64 = 0.012;
/// Turn of the drum to and fro before, rad: more than twice the widest play.
const RUN_UP: f64 = TAU / 32.0;
/// Time between two looks, ms.
const LOOK_MS: u64 = 10;
/// Both directions may differ by this share of their mean, and a slope's standard error be this share of it.
const MOST_ERROR: f64 = 0.25;
/// A drum that turns further than this in its closed brake slips, degrees.
const SLIPS_DEG: f64 = super::commission::MOST_BRAKE_PLAY_DEG;
/// Drum counts by which a drum that stands may seem to move.
const RESTS: i64 = 1;

/// What the motor showed while the gear was wound up, either way: angle of the motor, as a turn of the drum, degrees, and
/// its torque behind the ratio and before the loss, N m, both without a sign.
pub(crate) type Windings = Vec<Vec<(f64, f64)>>;

/// A look at a winch while its gear winds up: torque of the motor, N m, its counts, and those of the drum, in the
/// direction of the push.
type Look = (f64, f64, i64);

/// The slope of torque before loss over twist and its standard error, N m/rad, or why it is not known; with what was seen.
pub(super) type Wound = (Result<(f64, f64), String>, Windings);

impl<L: Link> Bench<'_, L> {
    /// Current to which the gear is wound up, A.
    fn wind_a(&self, bare: &Rubbing) -> f64 {
        let winch = self.described();
        let friction_a = bare.slowest_nm() / winch.torque_constant_nm_per_a;
        let most_a = winch.max_current_a;
        (STATIC * friction_a + WIND_SHARE * most_a).min(MOST_SHARE * most_a)
    }

    /// Identifies the stiffness before loss, and its standard error, N m/rad; in words why it is not known. With what
    /// was measured.
    pub(super) fn windup(&mut self, bare: &Rubbing) -> Result<Wound, ServiceError> {
        let most_a = self.wind_a(bare);
        let (mut slopes, mut windings) = (Vec::new(), Windings::new());
        for out in [false, true] {
            // The motor is left on the flank that it pushes next, not wound up: its friction may be more than the
            // current that follows. A set-point grows as the drum pays out.
            let way = if out { -RUN_UP } else { RUN_UP };
            self.enable(Purpose::Turn)?;
            let turned = self.turn(0.0, way).and_then(|()| self.turn(way, 0.0));
            let closed = self.disable();
            turned?;
            closed?;
            self.enable(Purpose::Wind { most_a, out })?;
            let looks = self.wind(most_a);
            let closed = self.disable();
            let looks = looks?;
            closed?;
            let winch = self.described();
            windings.push(wound(winch, &looks));
            match slope(winch, &looks, bare.slowest_nm(), most_a) {
                Ok(found) => slopes.push(found),
                Err(why) => return Ok((Err(why), windings)),
            }
        }
        Ok((both_ways(&slopes), windings))
    }

    fn wind(&mut self, most_a: f64) -> Result<Vec<Look>, ServiceError> {
        let enable_ms = match self.described().drive {
            DriveKind::Rmds => 2200,
            DriveKind::Cia402 => 1500,
        };
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "some seconds"
        )]
        let grows_ms = (GROWS_S * 1e3) as u64;
        let give_up = self.client.now_us() + (enable_ms + grows_ms + 500) * 1000;
        let torque = self.described().torque_constant_nm_per_a;
        let per_turn = f64::from(self.described().encoder_counts_per_turn);
        // A brake that slips is not pushed any further.
        let most = SLIPS_DEG / 360.0 * per_turn + 4.0;
        let (mut looks, mut began) = (Vec::new(), None);
        while self.client.now_us() < give_up {
            self.pause(LOOK_MS)?;
            if let Some(record) = crate::run::status(self.client)?.fault {
                return Err(crate::run::RunError::Fault { record, why: None }.into());
            }
            let look = self.look()?;
            let current_a = f64::from(look.current_ma) * 1e-3;
            looks.push((
                current_a * torque,
                f64::from(look.motor_counts),
                i64::from(look.drum_counts),
            ));
            let drum = i64::from(look.drum_counts);
            let turned = drum - *began.get_or_insert(drum);
            if current_a.abs() >= 0.98 * most_a || turned.abs() as f64 > most {
                break;
            }
        }
        Ok(looks)
    }
}

/// Angles and torques of looks.
fn wound(winch: &Winch, looks: &[Look]) -> Vec<(f64, f64)> {
    let Some(first) = looks.first() else {
        return Vec::new();
    };
    let at = |look: &Look| {
        let turned = (look.1 - first.1).abs() / winch.motor_counts_per_turn.abs();
        (turned * 360.0, look.0.abs() * winch.gear_ratio)
    };
    looks.iter().map(at).collect()
}

/// The mean of the slopes of both ways and its standard error, or why they are no slopes of one gear.
fn both_ways(slopes: &[(f64, f64)]) -> Result<(f64, f64), String> {
    let (Some(pulled), Some(pushed)) = (slopes.first(), slopes.last()) else {
        return Err("nothing was measured".to_owned());
    };
    let both = 0.5 * (pulled.0 + pushed.0);
    let differs = 0.5 * (pulled.0 - pushed.0).abs();
    let error = (0.5 * pulled.1.hypot(pushed.1)).hypot(differs);
    if error > MOST_ERROR * both {
        return Err(format!(
            "wound up one way it is {:.0} N m/rad before loss, the other way {:.0} (standard error {error:.0})",
            pulled.0, pushed.0
        ));
    }
    Ok((both, error))
}

/// Torque before loss per twist at the drum, N m/rad, and its standard error; in words why it is not known.
fn slope(
    winch: &Winch,
    looks: &[Look],
    friction_nm: f64,
    most_a: f64,
) -> Result<(f64, f64), String> {
    let most_nm = most_a * winch.torque_constant_nm_per_a;
    let range_nm = most_nm - friction_nm;
    let from_nm = (most_nm - LAST * range_nm).max(resumes_nm(looks));
    if from_nm > most_nm - LEAST * range_nm {
        return Err(format!(
            "the motor stuck until {:.2} A of {most_a:.2} A",
            from_nm / winch.torque_constant_nm_per_a
        ));
    }
    let late: Vec<_> = looks
        .iter()
        .filter(|look| look.0.abs() >= from_nm)
        .collect();
    let (Some(first), Some(last)) = (late.first(), late.last()) else {
        return Err("the motor did not take its current".to_owned());
    };
    if (last.2 - first.2).abs() > RESTS {
        let counted = (last.2 - first.2).abs();
        return Err(format!(
            "the closed brake let the drum turn by {counted} encoder counts at {most_a:.2} A"
        ));
    }
    let per_count = TAU / winch.motor_counts_per_turn.abs();
    let points = late.iter().map(|look| {
        let twist = (look.1 - first.1).abs() * per_count;
        (look.0.abs() * winch.gear_ratio, twist)
    });
    let points: Vec<(f64, f64)> = points.collect();
    let count = points.len() as f64;
    let mean = |of: &dyn Fn(&(f64, f64)) -> f64| points.iter().map(of).sum::<f64>() / count;
    let (torque, twist) = (mean(&|p| p.0), mean(&|p| p.1));
    let squares = mean(&|p| (p.0 - torque).powi(2));
    // The angle follows the torque, in steps where it sticks: a line of the angle over the torque.
    let compliance = mean(&|p| (p.0 - torque) * (p.1 - twist)) / squares;
    let residual = mean(&|p| (p.1 - twist - compliance * (p.0 - torque)).powi(2));
    // Looks in a row are no independent measurements: an angle that sticks is the same for many. Ten of them count.
    let error = (residual / squares / 10.0).sqrt();
    if compliance.is_nan() || compliance <= 0.0 || error > MOST_ERROR * compliance {
        return Err(format!(
            "the motor turned by {:.2} degrees of the drum (standard error {:.2}) for {:.2} N m",
            (compliance * (most_nm - from_nm) * winch.gear_ratio).to_degrees(),
            (error * (most_nm - from_nm) * winch.gear_ratio).to_degrees(),
            (most_nm - from_nm) * winch.gear_ratio
        ));
    }
    Ok((1.0 / compliance, error / (compliance * compliance)))
}

/// Torque at the end of the longest time in which the motor stood, once it had turned by a tenth of its way, N m.
fn resumes_nm(looks: &[Look]) -> f64 {
    let (Some(first), Some(last)) = (looks.first(), looks.last()) else {
        return 0.0;
    };
    let way = (last.1 - first.1).abs();
    let (mut stood, mut began) = (f64::NAN, 0.0);
    let (mut longest, mut resumes) = (0.0, 0.0);
    for look in looks
        .iter()
        .filter(|look| (look.1 - first.1).abs() > 0.1 * way)
    {
        let torque = look.0.abs();
        if stood != look.1 {
            (stood, began) = (look.1, torque);
        } else if torque - began > longest {
            (longest, resumes) = (torque - began, torque);
        }
    }
    resumes
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Looks at a gear of this stiffness before loss, N m/rad, that winds up to 0.5 A behind 0.5 mN m of friction.
    fn looks(winch: &Winch, stiffness: f64) -> Vec<Look> {
        let per_rad = winch.motor_counts_per_turn.abs() / TAU;
        let torques =
            (0..200).map(|step| f64::from(step) * 0.0025 * winch.torque_constant_nm_per_a);
        let look = |torque: f64| {
            let twist = (torque - 5e-4).max(0.0) * winch.gear_ratio / stiffness;
            (-torque, (-twist * per_rad).floor(), 12)
        };
        torques.map(look).collect()
    }

    #[test]
    fn stiffness_is_the_slope_of_torque_over_twist_while_the_drum_stands() {
        let winch = crate::robot::Robot::built_in("paper-table5")
            .unwrap()
            .winches[0]
            .clone();
        for stiffness in [100.0, 450.0, 1500.0] {
            let (found, error) = slope(&winch, &looks(&winch, stiffness), 5e-4, 0.5).unwrap();
            assert!((found / stiffness - 1.0).abs() < 0.01, "{found} +- {error}");
            assert!(error < 0.05 * found, "{error}");
        }
    }

    #[test]
    fn a_rotor_that_arrived_too_far_counts_only_when_its_current_has_followed() {
        let winch = crate::robot::Robot::built_in("paper-table5")
            .unwrap()
            .winches[0]
            .clone();
        let mut jammed = looks(&winch, 300.0);
        // It stands where 0.27 A would hold it, from 0.1 A on.
        let at = jammed
            .iter()
            .find(|look| look.0.abs() > 0.27 * 0.006)
            .unwrap()
            .1;
        let early = jammed
            .iter_mut()
            .filter(|look| look.0.abs() > 0.1 * 0.006 && look.1 > at);
        early.for_each(|look| look.1 = at);
        let (found, _) = slope(&winch, &jammed, 5e-4, 0.5).unwrap();
        assert!((found / 300.0 - 1.0).abs() < 0.02, "{found}");
    }

    #[test]
    fn a_drum_that_slips_in_its_brake_shows_no_stiffness() {
        let winch = crate::robot::Robot::built_in("paper-table5")
            .unwrap()
            .winches[0]
            .clone();
        let mut slips = looks(&winch, 300.0);
        for (number, look) in slips.iter_mut().enumerate().skip(150) {
            look.2 += i64::try_from(number).unwrap() - 150;
        }
        let why = slope(&winch, &slips, 5e-4, 0.5).unwrap_err();
        assert!(why.contains("brake"), "{why}");
        // A motor that does not turn at all.
        let mut stands = looks(&winch, 300.0);
        stands.iter_mut().for_each(|look| look.1 = 7.0);
        assert!(slope(&winch, &stands, 5e-4, 0.5).is_err());
    }
}
