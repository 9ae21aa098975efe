//! Loss of a gear in both directions of power: a known weight hangs on the drum and is raised and lowered at the speeds
//! at which the bare drum was turned before.
//!
//! Raised, the motor gives its friction and the weight's torque over the efficiency; lowered, it gets the weight's
//! torque times the efficiency, less its friction. At the same speed the bare winch's torque is that friction, so that
//! two differences are left: no model of the friction is needed. A pulley on the way adds to the weight while it rises
//! and takes from it while it sinks: the ratio of the sensor's readings shows how much, whatever the sensor's gain.

use super::rubbing::WAYS;
use super::steady::{CURRENT_STEP_A, mean};
use super::{Bench, Purpose, Rubbing, ServiceError};
use crate::link::Link;
use crate::robot::Winch;
use serde::Serialize;
use std::f64::consts::TAU;

/// Loss of a gear in both directions, with standard errors.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Loss {
    /// Share of the motor's power that reaches the drum, without the friction of the unloaded winch.
    pub efficiency: f64,
    /// Its standard error.
    pub efficiency_se: f64,
    /// Share of the drum's power that reaches the motor, likewise.
    pub backdrive_efficiency: f64,
    /// Its standard error.
    pub backdrive_efficiency_se: f64,
    /// Weight of what hung on the drum, N.
    pub weight_n: f64,
    /// The tension sensor's reading of it by the robot file's gain, N: the mean of raising and lowering.
    pub sensor_n: f64,
    /// Share of the weight that the pulley on its way adds while it is raised, and takes while it is lowered.
    pub pulley_loss: f64,
    /// The motor's torques at each speed.
    pub turns: Vec<Lifted>,
}

/// Torques of a motor that raises and lowers a weight at one speed, positive where they reel in, N m.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Lifted {
    /// Speed of the motor, rpm.
    pub rpm: f64,
    /// Turning the bare drum, either way.
    pub bare_nm: f64,
    /// Raising.
    pub raised_nm: f64,
    /// Lowering.
    pub lowered_nm: f64,
}

/// Of [`WAYS`], those on which the weight is moved: the slower ones. A weight that falls through play falls anew when a
/// brake opens, and a fast drum needs more current.
const LIFTED: [usize; 2] = [3, 4];
/// Share of the motor's current that lifting may take.
pub(super) const LIFT_SHARE: f64 = 0.9;
/// Least efficiency that a weight is accepted for.
const LEAST_EFFICIENCY: f64 = 0.5;
/// Static friction over that in motion, of the gears that a weight is accepted for.
const STATIC: f64 = 1.5;
/// An efficiency may exceed 1, and one driven that of driving, by so many standard errors.
const BEYOND: f64 = 3.0;
/// Greatest standard error of an efficiency: beyond it the data do not show it.
const MOST_ERROR: f64 = 0.05;

/// Torques at the motor that reel in, N m, with standard errors: bare, raising and lowering a weight.
#[derive(Debug, Clone, Copy)]
struct Torques {
    rpm: f64,
    bare: (f64, f64),
    raised: (f64, f64),
    lowered: (f64, f64),
    /// The sensor's readings, N.
    raised_n: f64,
    lowered_n: f64,
}

impl<L: Link> Bench<'_, L> {
    /// Refuses a weight that the winch cannot lift, or its sensor cannot measure.
    pub(super) fn check_weight(&self, weight_n: f64, bare: &Rubbing) -> Result<(), ServiceError> {
        let winch = self.described();
        let torque_nm = STATIC * bare.slowest_nm()
            + weight_n * winch.drum_radius_m / winch.gear_ratio / LEAST_EFFICIENCY;
        let needed_a = torque_nm / winch.torque_constant_nm_per_a;
        let most_a = LIFT_SHARE * winch.max_current_a;
        let most_n = winch.trusted_tension_n();
        if needed_a > most_a || super::lift_ceiling_n(weight_n) > most_n {
            return Err(ServiceError::TooHeavy {
                winch: self.index + 1,
                weight_n,
                needed_a,
                most_a,
                most_n,
            });
        }
        Ok(())
    }

    /// Identifies the loss with `weight_n` on the drum. `pays_out` is the sign of motor counts that pays out cable.
    pub(super) fn loss(
        &mut self,
        weight_n: f64,
        bare: &Rubbing,
        pays_out: f64,
    ) -> Result<Loss, ServiceError> {
        let sensor_n = self.weighed()?;
        if !(0.5..2.0).contains(&(sensor_n / weight_n)) {
            return Err(ServiceError::NotHung {
                winch: self.index + 1,
                weight_n,
                sensor_n,
            });
        }
        let friction_n =
            bare.slowest_nm() * self.described().gear_ratio / self.described().drum_radius_m;
        self.enable(Purpose::Lift {
            weight_n,
            friction_n,
            pays_out,
        })?;
        let torques = self.lift(bare, pays_out);
        let closed = self.disable();
        let torques = torques?;
        closed?;
        judge(self.index + 1, self.described(), weight_n, &torques)
    }

    /// Tension for a reading, by the file's gain and the zero that was found, N.
    fn sensed_n(&self, reading: f64) -> f64 {
        (super::volts(reading) - self.zero_v) * self.described().tension_gain_n_per_v
    }

    /// Reading of the sensor by the file's gain and the zero that was found, N.
    fn weighed(&mut self) -> Result<f64, ServiceError> {
        let (mut sum, count) = (0.0, 20);
        for _ in 0..count {
            self.pause(10)?;
            sum += f64::from(self.look()?.tension_adc);
        }
        Ok(self.sensed_n(sum / f64::from(count)))
    }

    fn lift(&mut self, bare: &Rubbing, pays_out: f64) -> Result<Vec<Torques>, ServiceError> {
        let torque = self.described().torque_constant_nm_per_a;
        // With a weight the board is told the sign that was found: a length grows as the drum pays out.
        let up = -1.0;
        let reels = |current_a: f64| -pays_out * current_a * torque;
        // Up first: the weight is then lowered no further than to where it was hung.
        let spare = up * TAU / 32.0;
        self.turn(0.0, spare)?;
        let mut all = Vec::new();
        for at in LIFTED {
            let (Some((way_rad, share, count)), Some(turn)) = (WAYS.get(at), bare.turns.get(at))
            else {
                continue;
            };
            let far = spare + up * way_rad;
            let (mut raised, mut lowered) = (Vec::new(), Vec::new());
            let (mut high, mut low) = (Vec::new(), Vec::new());
            for _ in 0..*count {
                let pass = self.way(spare, far, *share, true)?;
                raised.push(reels(pass.current_a));
                high.push(self.sensed_n(pass.tension_adc));
                let pass = self.way(far, spare, *share, true)?;
                lowered.push(reels(pass.current_a));
                low.push(self.sensed_n(pass.tension_adc));
            }
            all.push(Torques {
                rpm: turn.rpm,
                bare: (turn.torque_nm, turn.torque_se_nm),
                raised: mean(raised.into_iter()),
                lowered: mean(lowered.into_iter()),
                raised_n: mean(high.into_iter()).0,
                lowered_n: mean(low.into_iter()).0,
            });
        }
        self.turn(spare, 0.0)?;
        Ok(all)
    }
}

/// The loss from what the motor gave; refused if no gear behaves so.
fn judge(
    number: usize,
    winch: &Winch,
    weight_n: f64,
    torques: &[Torques],
) -> Result<Loss, ServiceError> {
    let per_n = winch.drum_radius_m / winch.gear_ratio;
    let (raised_n, _) = mean(torques.iter().map(|t| t.raised_n));
    let (lowered_n, _) = mean(torques.iter().map(|t| t.lowered_n));
    let sensor_n = 0.5 * (raised_n + lowered_n);
    // A pulley only takes power.
    let pulley_loss = (0.5 * (raised_n - lowered_n) / sensor_n).max(0.0);
    let loads_nm = [1.0 + pulley_loss, 1.0 - pulley_loss].map(|share| share * weight_n * per_n);
    // A drive rounds its current; two values are compared.
    let step_nm = CURRENT_STEP_A * winch.torque_constant_nm_per_a;
    let error = |a: f64, b: f64| a.hypot(b).hypot(step_nm);
    // What the motor gives for a weight, over the weight.
    let gives = torques
        .iter()
        .map(|t| (t.raised.0 - t.bare.0) / loads_nm[0]);
    let (inverse, inverse_spread) = mean(gives);
    let gives_se = torques
        .iter()
        .map(|t| error(t.raised.1, t.bare.1) / loads_nm[0]);
    let inverse_se = inverse_spread.hypot(mean(gives_se).0);
    let efficiency = 1.0 / inverse;
    let efficiency_se = inverse_se / (inverse * inverse);
    // The drum's own friction helps to hold the weight; in the bare winch's torque it is over the efficiency.
    let gets = torques
        .iter()
        .map(|t| (t.lowered.0 + t.bare.0) / loads_nm[1]);
    let (got, got_spread) = mean(gets);
    let share = winch.friction_n * per_n / loads_nm[1];
    // got = b + share (1 / e - b), with b driven and e driving.
    let backdrive = (got - share * inverse) / (1.0 - share);
    let gets_se = torques
        .iter()
        .map(|t| error(t.lowered.1, t.bare.1) / loads_nm[1]);
    // The file's friction of the drum is not measured: a third of it is taken as unknown.
    let unknown = share * (inverse - backdrive).abs() / 3.0;
    let backdrive_se = got_spread.hypot(mean(gets_se).0).hypot(unknown);
    let found = Loss {
        efficiency,
        efficiency_se,
        backdrive_efficiency: backdrive.clamp(0.0, 1.0),
        backdrive_efficiency_se: backdrive_se,
        weight_n,
        sensor_n,
        pulley_loss,
        turns: torques
            .iter()
            .map(|t| Lifted {
                rpm: t.rpm,
                bare_nm: t.bare.0,
                raised_nm: t.raised.0,
                lowered_nm: t.lowered.0,
            })
            .collect(),
    };
    let possible = inverse > 0.0
        && efficiency_se.max(backdrive_se) <= MOST_ERROR
        && efficiency <= 1.0 + BEYOND * efficiency_se
        && backdrive >= -BEYOND * backdrive_se
        && backdrive <= efficiency + BEYOND * efficiency_se.hypot(backdrive_se);
    if possible {
        return Ok(Loss {
            efficiency: efficiency.min(1.0),
            ..found
        });
    }
    Err(ServiceError::Loses {
        winch: number,
        efficiency,
        efficiency_se,
        backdrive,
        backdrive_se,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The paper's winch with 0.7 N on its drum, and what its motor gives with this loss.
    fn given(efficiency: f64, driven: f64, weight_n: f64) -> (Winch, Vec<Torques>) {
        let mut winch = crate::robot::Robot::built_in("paper-table5")
            .unwrap()
            .winches[0]
            .clone();
        winch.friction_n = 0.7;
        let per_n = winch.drum_radius_m / winch.gear_ratio;
        let rotor_nm = 4e-4;
        let torques = [1.0, 1.1].map(|more| Torques {
            rpm: 300.0 * more,
            bare: (more * rotor_nm + winch.friction_n * per_n / efficiency, 0.0),
            // Over a pulley that takes 3 %, by a sensor that shows a tenth too little.
            raised: (
                more * rotor_nm + (winch.friction_n + 1.03 * weight_n) * per_n / efficiency,
                0.0,
            ),
            lowered: (
                (0.97 * weight_n - winch.friction_n) * per_n * driven - more * rotor_nm,
                0.0,
            ),
            raised_n: 0.9 * 1.03 * weight_n,
            lowered_n: 0.9 * 0.97 * weight_n,
        });
        (winch, torques.to_vec())
    }

    #[test]
    fn both_directions_of_loss_come_from_raising_and_lowering() {
        for (efficiency, driven) in [(0.55, 0.18), (0.85, 0.82), (0.7, 0.3), (1.0, 1.0)] {
            let (winch, torques) = given(efficiency, driven, 12.0);
            let found = judge(1, &winch, 12.0, &torques).unwrap();
            assert!((found.efficiency - efficiency).abs() < 1e-9, "{found:?}");
            assert!(
                (found.backdrive_efficiency - driven).abs() < 1e-9,
                "{found:?}"
            );
            assert!(found.efficiency_se > 0.0 && found.backdrive_efficiency_se > 0.0);
        }
    }

    #[test]
    fn torques_of_no_gear_are_refused_with_their_numbers() {
        // More than all of the power arrives; the weight gives more than it has; the sign is wrong.
        for (efficiency, driven) in [(1.3, 0.9), (0.6, 0.9), (0.6, -0.4), (-0.6, 0.3)] {
            let (winch, torques) = given(efficiency, driven, 12.0);
            let error = judge(3, &winch, 12.0, &torques).unwrap_err();
            let words = error.to_string();
            assert!(words.contains("winch 3") && words.contains('%'), "{words}");
        }
        // A weight of a gram shows nothing.
        let (winch, torques) = given(0.7, 0.5, 0.8);
        assert!(judge(3, &winch, 0.8, &torques).is_err());
    }
}
