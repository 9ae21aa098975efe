//! Friction of a bare winch, and the play between its motor and its drum: the drum is turned back
//! and forth at five speeds, and motor current, motor counts and drum counts are compared on the
//! middle of each turn, where the speed is constant. The drive is commanded by speed: a position that is commanded in
//! steps makes its current ripple, and as the drive samples it always at the same moment between two steps, no mean of
//! the samples is free of it (docs/results/winch.md).
//!
//! Half the difference of the currents of both directions is friction; its increase with the speed
//! is viscous. Half of the difference of motor and drum between both directions is half the play: a
//! bare drum has no load, and stays where the flank left it.

use super::steady::{CURRENT_STEP_A, Pass, mean};
use super::{Bench, ServiceError};
use crate::link::Link;
use crate::robot::Winch;
use serde::Serialize;
use std::f64::consts::TAU;

/// Friction and play of a bare winch, with standard errors.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Rubbing {
    /// Friction; `None` if the current does not show it.
    #[serde(flatten)]
    pub friction: Option<Friction>,
    /// Why friction is not known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub friction_unknown: Option<String>,
    /// The motor's torque in steady turns, the fastest first.
    pub turns: Vec<Steady>,
    /// Play, as a turn of the drum, degrees.
    pub play_deg: f64,
    /// Its standard error, degrees.
    pub play_se_deg: f64,
    /// Increase of the gap with the motor's speed, degrees per rpm.
    #[serde(skip)]
    pub(super) gap_deg_per_rpm: f64,
}

/// Torque of a motor in steady turns of its bare drum.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Steady {
    /// Speed of the motor, rpm.
    pub rpm: f64,
    /// Half of the difference between both directions, N m.
    pub torque_nm: f64,
    /// Its standard error, N m.
    pub torque_se_nm: f64,
    /// How far the motor is ahead of the drum in one direction less the same in the other, degrees of the drum: the play,
    /// and the way between two readings.
    pub gap_deg: f64,
    /// Its standard error, degrees.
    pub gap_se_deg: f64,
}

/// Friction of a bare winch.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Friction {
    /// Coulomb friction of rotor, gear and bare drum, at the motor, N m.
    pub friction_nm: f64,
    /// Its standard error, N m.
    pub friction_se_nm: f64,
    /// Viscous friction at the motor, N m per rpm.
    pub viscous_nm_per_rpm: f64,
    /// Coulomb friction, felt at the cable, N.
    pub friction_n: f64,
}

impl Rubbing {
    /// Torque of the motor in the slowest turns, N m: friction, known or not.
    pub(super) fn slowest_nm(&self) -> f64 {
        self.turns.last().map_or(0.0, |turn| turn.torque_nm.abs())
    }

    /// Puts the results into the description of the winch. On a bare winch the drum's own friction cannot be
    /// separated from the motor's: the description's value is kept. Rotor and gear share the rest as they did.
    pub(crate) fn describe(&self, winch: &mut Winch) {
        let Some(gear) = &mut winch.gear else {
            if let Some(found) = &self.friction {
                winch.friction_n = found.friction_n;
            }
            return;
        };
        if let Some(found) = &self.friction {
            // It reaches the motor through the gear's loss.
            let drum_nm =
                winch.friction_n * winch.drum_radius_m / winch.gear_ratio / gear.efficiency;
            let at_motor_nm = (found.friction_nm - drum_nm).max(0.0);
            let described_nm = gear.rotor_friction_nm + gear.gear_friction_nm;
            let share = if described_nm > 0.0 {
                gear.rotor_friction_nm / described_nm
            } else {
                0.5
            };
            gear.rotor_friction_nm = at_motor_nm * share;
            gear.gear_friction_nm = at_motor_nm * (1.0 - share);
            // Rounding may hide a small slope.
            if found.viscous_nm_per_rpm > 0.0 {
                gear.viscous_nm_per_rpm = found.viscous_nm_per_rpm;
            }
        }
        gear.play_rad = self.play_deg.to_radians();
    }
}

/// Turn of the drum of one way (rad), its speed as a share of that of service, and how often it goes to and fro. The
/// first two show the play. A slow way is short: 22 degrees are eleven times the widest play.
pub(super) const WAYS: [(f64, f64, usize); 5] = [
    (TAU / 4.0, 0.5, 3),
    (TAU / 4.0, 0.17, 3),
    (TAU / 8.0, 0.35, 3),
    (TAU / 8.0, 0.25, 3),
    // No slower: below a hundred rpm static friction begins to be felt.
    (TAU / 16.0, 0.12, 2),
];
/// Greatest relative standard error of the friction: beyond it the data contradict the model.
const MOST_ERROR: f64 = 0.2;
/// A drive that reports less current than this, A, while its motor turns, does not measure it.
const NO_CURRENT_A: f64 = 1e-3;

impl<L: Link> Bench<'_, L> {
    /// Identifies friction and play; the winch is enabled for [`super::Purpose::Spin`] and at rest. `same_way` says
    /// whether motor and drum encoder count in the same direction.
    pub(super) fn rubbing(&mut self, same_way: bool) -> Result<Rubbing, ServiceError> {
        let at_rad = 0.0;
        // The first turn takes up the play, in either direction.
        let [(first_rad, ..), ..] = WAYS;
        self.turn(at_rad, at_rad + first_rad)?;
        let mut now_rad = first_rad;
        let mut speeds = Vec::new();
        for (way_rad, share, count) in WAYS {
            if way_rad < now_rad {
                // To the end of the shorter way, in the direction in which it is travelled last.
                self.turn(at_rad + now_rad, at_rad)?;
                self.turn(at_rad, at_rad + way_rad)?;
            }
            now_rad = way_rad;
            let mut pairs = Vec::new();
            for _ in 0..count {
                let back = self.way(at_rad + way_rad, at_rad, share, same_way)?;
                let out = self.way(at_rad, at_rad + way_rad, share, same_way)?;
                pairs.push((out, back));
            }
            speeds.push(pairs);
        }
        self.turn(at_rad + now_rad, at_rad)?;
        self.judge_rubbing(&speeds)
    }

    fn judge_rubbing(&self, speeds: &[Vec<(Pass, Pass)>]) -> Result<Rubbing, ServiceError> {
        let winch = self.described();
        let torque = winch.torque_constant_nm_per_a;
        // Friction from the current; the sign of the winding is that of the slowest turns.
        let differs = |(out, back): &(Pass, Pass)| 0.5 * (out.current_a - back.current_a);
        let slowest = speeds.last().map_or(&[][..], Vec::as_slice).iter();
        let sign = slowest.map(differs).sum::<f64>().signum();
        let rubs = |pair: &(Pass, Pass)| sign * differs(pair) * torque;
        // With its sign: at a speed a drum is read later than its motor, which may be more than the play.
        let gap = |(out, back): &(Pass, Pass)| (out.gap - back.gap) * 360.0;
        let rpm = |(out, back): &(Pass, Pass)| 0.5 * (out.rpm + back.rpm);
        let pairs = |speed: usize| speeds.get(speed).map_or(&[][..], Vec::as_slice).iter();
        // Motor and drum are read at different times: the gap of that grows with the speed. It is a mean of readings in
        // whole counts of the drum, over each of the turns.
        let count_deg = 360.0 / f64::from(winch.encoder_counts_per_turn);
        let turns: Vec<Steady> = (0..speeds.len())
            .map(|speed| {
                let (torque_nm, torque_se_nm) = mean(pairs(speed).map(rubs));
                let (gap_deg, spread_deg) = mean(pairs(speed).map(gap));
                let whole_deg = count_deg / (12.0 * pairs(speed).len().max(1) as f64).sqrt();
                Steady {
                    rpm: mean(pairs(speed).map(rpm)).0,
                    torque_nm,
                    torque_se_nm,
                    gap_deg,
                    gap_se_deg: spread_deg.hypot(whole_deg),
                }
            })
            .collect();
        let most_a = speeds
            .iter()
            .flatten()
            .map(|(out, back)| out.current_a.abs().max(back.current_a.abs()))
            .fold(0.0, f64::max);
        // A drive reports whole milliamperes: what it rounds away does not average out in a steady turn.
        let rounding_nm = CURRENT_STEP_A * torque / 12.0_f64.sqrt();
        let torques = turns
            .iter()
            .map(|t| (t.rpm, t.torque_nm, t.torque_se_nm.hypot(rounding_nm)));
        let (viscous, friction_nm, friction_se_nm) = line(&torques.collect::<Vec<_>>());
        if most_a < NO_CURRENT_A {
            return Err(ServiceError::Rubs {
                winch: self.index + 1,
                friction_mnm: friction_nm * 1e3,
                error_mnm: friction_se_nm * 1e3,
            });
        }
        let known = friction_nm > 0.0 && friction_se_nm <= MOST_ERROR * friction_nm;
        let friction = known.then(|| Friction {
            friction_nm,
            friction_se_nm,
            viscous_nm_per_rpm: viscous.max(0.0),
            friction_n: friction_nm * winch.gear_ratio / winch.drum_radius_m,
        });
        let friction_unknown = (!known).then(|| {
            let taken = turns.iter();
            let taken = taken.map(|t| format!("{:.3} mN m at {:.0} rpm", t.torque_nm * 1e3, t.rpm));
            let taken = taken.collect::<Vec<_>>().join(", ");
            format!("the motor takes {taken}: these do not show its dry friction")
        });
        let gaps = turns.iter().map(|t| (t.rpm, t.gap_deg, t.gap_se_deg));
        let (gap_deg_per_rpm, play_deg, play_se_deg) = line(&gaps.collect::<Vec<_>>());
        Ok(Rubbing {
            friction,
            friction_unknown,
            turns,
            play_deg: play_deg.max(0.0),
            play_se_deg,
            gap_deg_per_rpm,
        })
    }
}

/// The straight line through values at speeds (rpm) with their standard errors: its slope per rpm, its value at rest, and
/// the standard error of that, with what the line leaves.
fn line(points: &[(f64, f64, f64)]) -> (f64, f64, f64) {
    let sum = |of: &dyn Fn(&(f64, f64, f64)) -> f64| points.iter().map(of).sum::<f64>();
    let (one, rpm, rpm2) = (sum(&|_| 1.0), sum(&|p| p.0), sum(&|p| p.0 * p.0));
    let (value, both) = (sum(&|p| p.1), sum(&|p| p.0 * p.1));
    let determinant = one * rpm2 - rpm * rpm;
    if determinant <= 0.0 {
        return (0.0, 0.0, f64::INFINITY);
    }
    let slope = (one * both - rpm * value) / determinant;
    let at_rest = (value - slope * rpm) / one;
    let residual = sum(&|p| (p.1 - at_rest - slope * p.0).powi(2));
    let freedom = points.len().saturating_sub(2).max(1) as f64;
    let by_residual = (residual / freedom * rpm2 / determinant).sqrt();
    // The value at rest is a sum of the values with these weights.
    let weight = |p: &(f64, f64, f64)| (rpm2 - rpm * p.0) / determinant;
    let by_value = sum(&|p| (weight(p) * p.2).powi(2)).sqrt();
    (slope, at_rest, by_residual.hypot(by_value))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Torques of 0.1 mN m and 0.05 more per 1000 rpm, each off by one of these, mN m, with this standard error, N m.
    fn torques(off: [f64; 5], error: f64) -> Vec<(f64, f64, f64)> {
        let speeds = [1000.0, 340.0, 700.0, 500.0, 240.0];
        let turn = |(rpm, off): (f64, f64)| (rpm, 1e-4 + 5e-8 * rpm + off * 1e-3, error);
        speeds.into_iter().zip(off).map(turn).collect()
    }

    #[test]
    fn dry_friction_is_the_line_of_the_torques_at_rest() {
        let (slope, dry_nm, error) = line(&torques([0.0; 5], 0.0));
        assert!((slope / 5e-8 - 1.0).abs() < 1e-9, "{slope}");
        assert!((dry_nm / 1e-4 - 1.0).abs() < 1e-9, "{dry_nm}");
        assert!(error < 1e-12, "{error}");
    }

    #[test]
    fn the_error_of_dry_friction_grows_with_rounding_and_with_what_no_line_explains() {
        let (_, _, rounded) = line(&torques([0.0; 5], 2e-6));
        // About that of one torque: five of them, extrapolated.
        assert!((1e-6..4e-6).contains(&rounded), "{rounded}");
        // A motor that sticks in its slowest turns.
        let (_, dry_nm, error) = line(&torques([0.0, 0.0, 0.0, 0.0, 0.1], 0.0));
        assert!((dry_nm - 1e-4).abs() < 2.0 * error, "{dry_nm} {error}");
        assert!(error > MOST_ERROR * dry_nm, "{dry_nm} {error}: refused");
    }

    /// A drum that is read 4 ms after its motor, at 218 degrees per second: 0.9 degrees, with a play of 0.7.
    #[test]
    fn a_play_below_the_way_between_two_readings_is_found() {
        let gap = |rpm: f64| (rpm, 0.7 - 0.9 * rpm / 1000.0, 0.01);
        let gaps = [1000.0, 340.0, 700.0, 500.0, 240.0].map(gap);
        let (_, play_deg, error) = line(&gaps);
        assert!(
            (play_deg - 0.7).abs() < 1e-9 && error < 0.02,
            "{play_deg} {error}"
        );
    }
}
