//! Friction of a bare winch, and the play between its motor and its drum: the drum is turned back
//! and forth at five speeds, and motor current, motor counts and drum counts are compared on the
//! middle of each turn, where the speed is nearly constant.
//!
//! Half the difference of the currents of both directions is friction; its increase with the speed
//! is viscous. Half of the difference of motor and drum between both directions is half the play: a
//! bare drum has no load, and stays where the flank left it.

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
            let drum_nm = winch.friction_n * winch.drum_radius_m / winch.gear_ratio;
            let at_motor_nm = (found.friction_nm - drum_nm).max(0.0);
            let described_nm = gear.rotor_friction_nm + gear.gear_friction_nm;
            let share = if described_nm > 0.0 {
                gear.rotor_friction_nm / described_nm
            } else {
                0.5
            };
            gear.rotor_friction_nm = at_motor_nm * share;
            gear.gear_friction_nm = at_motor_nm * (1.0 - share);
            // The sampling of the current hides a small slope.
            if found.viscous_nm_per_rpm > 0.0 {
                gear.viscous_nm_per_rpm = found.viscous_nm_per_rpm;
            }
        }
        gear.play_rad = self.play_deg.to_radians();
    }
}

/// Turn of the drum of one way (rad), its speed as a share of that of service, and how often it goes to and fro. The
/// first two show the play, the slow ones the dry friction. A slow way is short: 11 degrees are five times the widest
/// play.
const WAYS: [(f64, f64, usize); 5] = [
    (TAU / 4.0, 0.5, 3),
    (TAU / 4.0, 0.17, 3),
    (TAU / 32.0, 0.12, 2),
    (TAU / 32.0, 0.09, 2),
    // No slower: below a hundred rpm static friction begins to be felt.
    (TAU / 32.0, 0.06, 2),
];
/// Speeding up and slowing down each take this share of the time of a way.
const RAMP: f64 = 0.3;
/// Readings begin at this share of the time: until then the drive's loops have settled.
const SETTLED: f64 = 0.42;
/// Time between two looks, ms.
const LOOK_MS: u64 = 10;
/// Step of a reported current, A.
const STEP_A: f64 = 1e-3;
/// The value at rest may differ from that of the slowest turns by this share of it. Beyond that the ripple of the
/// set-points is most of the sampled current, and no line through it leads to the friction.
const MOST_BEYOND: f64 = 0.25;
/// Greatest relative standard error of the friction: beyond it the data contradict the model.
const MOST_ERROR: f64 = 0.2;
/// A drive that reports less current than this, A, while its motor turns, does not measure it.
const NO_CURRENT_A: f64 = 1e-3;

/// The mean of one turn.
#[derive(Debug, Clone, Copy, Default)]
struct Pass {
    current_a: f64,
    rpm: f64,
    /// Motor ahead of the drum, turns of the drum.
    gap: f64,
}

impl<L: Link> Bench<'_, L> {
    /// Identifies friction and play; the winch is enabled and rests at `at_rad`. `same_way` says
    /// whether motor and drum encoder count in the same direction.
    pub(super) fn rubbing(&mut self, at_rad: f64, same_way: bool) -> Result<Rubbing, ServiceError> {
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

    /// One turn, and the result of its stretch of constant speed.
    fn way(
        &mut self,
        from_rad: f64,
        to_rad: f64,
        share: f64,
        same_way: bool,
    ) -> Result<Pass, ServiceError> {
        let time_s = self.begin_cruise(from_rad, to_rad, share)?;
        let start_us = self.client.now_us();
        let winch = self.described();
        let per_turn = winch.motor_counts_per_turn;
        // By the result, not by the file.
        let sign = if same_way { 1.0 } else { -1.0 };
        let drum_per_turn = f64::from(winch.encoder_counts_per_turn) * sign * per_turn.signum();
        let (mut sum, mut count) = (Pass::default(), 0.0);
        let mut ends = None;
        loop {
            self.pause(LOOK_MS)?;
            let since_s = (self.client.now_us() - start_us) as f64 * 1e-6;
            if since_s > (1.0 - RAMP) * time_s {
                break;
            }
            if since_s < SETTLED * time_s {
                continue;
            }
            let look = self.look()?;
            let motor = f64::from(look.motor_counts) / per_turn;
            sum.current_a += f64::from(look.current_ma) * 1e-3;
            sum.gap += motor - f64::from(look.drum_counts) / drum_per_turn;
            count += 1.0;
            let (first, _) = *ends.get_or_insert(((since_s, motor), (since_s, motor)));
            ends = Some((first, (since_s, motor)));
        }
        crate::run::wait_for(
            self.client,
            mcdpr_protocol::BoardState::Holding,
            time_s + 2.0,
        )?;
        let gear_ratio = self.described().gear_ratio;
        let rpm = ends.map_or(0.0, |(first, last)| {
            (last.1 - first.1) / (last.0 - first.0).max(1e-3) * 60.0 * gear_ratio
        });
        Ok(Pass {
            current_a: sum.current_a / f64::max(count, 1.0),
            rpm: rpm.abs(),
            gap: sum.gap / f64::max(count, 1.0),
        })
    }

    /// Begins a turn of constant speed between two ramps (a cubic from rest to speed); returns its
    /// duration, s.
    fn begin_cruise(
        &mut self,
        from_rad: f64,
        to_rad: f64,
        share_of_speed: f64,
    ) -> Result<f64, ServiceError> {
        let way = to_rad - from_rad;
        let time_s = way.abs() / (share_of_speed * self.service_rad_per_s() * (1.0 - RAMP));
        // Distance after a share `x` of the ramp, as a share of speed times duration.
        let ramp = |x: f64| RAMP * (x.powi(3) - 0.5 * x.powi(4));
        let speed = |x: f64| x * x * (3.0 - 2.0 * x);
        self.send_turn((from_rad, way), time_s, |share| {
            let (far, fast) = if share < RAMP {
                (ramp(share / RAMP), speed(share / RAMP))
            } else if share > 1.0 - RAMP {
                let left = (1.0 - share) / RAMP;
                (1.0 - RAMP - ramp(left), speed(left))
            } else {
                (share - 0.5 * RAMP, 1.0)
            };
            (far / (1.0 - RAMP), fast / (1.0 - RAMP))
        })
    }

    fn judge_rubbing(&self, speeds: &[Vec<(Pass, Pass)>]) -> Result<Rubbing, ServiceError> {
        let winch = self.described();
        let torque = winch.torque_constant_nm_per_a;
        // Friction from the current. The motor's sign is that of its slowest turns: in faster ones the ripple of the
        // set-points, which a drive samples always at the same moment, may exceed the friction.
        let differs = |(out, back): &(Pass, Pass)| 0.5 * (out.current_a - back.current_a);
        let slowest = speeds.last().map_or(&[][..], Vec::as_slice).iter();
        let sign = slowest.map(differs).sum::<f64>().signum();
        let rubs = |pair: &(Pass, Pass)| sign * differs(pair) * torque;
        let gap = |(out, back): &(Pass, Pass)| (out.gap - back.gap).abs() * 360.0;
        let rpm = |(out, back): &(Pass, Pass)| 0.5 * (out.rpm + back.rpm);
        let pairs = |speed: usize| speeds.get(speed).map_or(&[][..], Vec::as_slice).iter();
        let rpms = [0, 1].map(|speed| mean(pairs(speed).map(rpm)).0);
        let turns: Vec<Steady> = (0..speeds.len())
            .map(|speed| {
                let (torque_nm, torque_se_nm) = mean(pairs(speed).map(rubs));
                Steady {
                    rpm: mean(pairs(speed).map(rpm)).0,
                    torque_nm,
                    torque_se_nm,
                }
            })
            .collect();
        let gaps = [0, 1].map(|speed| mean(pairs(speed).map(gap)));
        let most_a = speeds
            .iter()
            .flatten()
            .map(|(out, back)| out.current_a.abs().max(back.current_a.abs()))
            .fold(0.0, f64::max);
        let (viscous, friction_nm, fit_nm) = dry(&turns);
        // A drive reports whole milliamperes: what it rounds away does not average out in a steady turn.
        let friction_se_nm = fit_nm.hypot(STEP_A * torque);
        if most_a < NO_CURRENT_A {
            return Err(ServiceError::Rubs {
                winch: self.index + 1,
                friction_mnm: friction_nm * 1e3,
                error_mnm: friction_se_nm * 1e3,
            });
        }
        let slowest_rpm = turns.last().map_or(0.0, |turn| turn.rpm);
        let known = friction_nm > 0.0
            && friction_se_nm <= MOST_ERROR * friction_nm
            && (viscous * slowest_rpm).abs() <= MOST_BEYOND * friction_nm;
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
        // Motor and drum are read at different times: the gap of that grows with the speed.
        let (_, play_deg, play_se_deg) = at_no_speed(rpms, gaps);
        Ok(Rubbing {
            friction,
            friction_unknown,
            turns,
            play_deg: play_deg.max(0.0),
            play_se_deg,
        })
    }
}

/// Slope (N m per rpm), dry friction (N m) and the standard error of the latter: the straight line through the torques
/// over speed, weighted by 1/speed^2. What disturbs a torque is mostly the ripple of the set-points in the sampled
/// current, which grows with the speed; the slope may be negative for it.
fn dry(turns: &[Steady]) -> (f64, f64, f64) {
    let weight = |turn: &Steady| turn.rpm.max(1.0).powi(-2);
    let sum =
        |value: &dyn Fn(&Steady) -> f64| turns.iter().map(|t| weight(t) * value(t)).sum::<f64>();
    let (one, rpm, rpm2) = (sum(&|_| 1.0), sum(&|t| t.rpm), sum(&|t| t.rpm * t.rpm));
    let (nm, rpm_nm) = (sum(&|t| t.torque_nm), sum(&|t| t.rpm * t.torque_nm));
    let determinant = one * rpm2 - rpm * rpm;
    if determinant <= 0.0 {
        return (0.0, 0.0, f64::INFINITY);
    }
    let slope = (one * rpm_nm - rpm * nm) / determinant;
    let dry_nm = (nm - slope * rpm) / one;
    let residual = sum(&|t| (t.torque_nm - dry_nm - slope * t.rpm).powi(2));
    let freedom = turns.len().saturating_sub(2).max(1) as f64;
    let by_residual = (residual / freedom * rpm2 / determinant).sqrt();
    let by_spread = sum(&|t| weight(t) * t.torque_se_nm.powi(2)).sqrt() / one;
    (slope, dry_nm, by_residual.hypot(by_spread))
}

/// The straight line through the results at two speeds (mean and standard error), extrapolated to
/// zero speed: its slope per rpm, its value, and the value's standard error.
fn at_no_speed([fast_rpm, slow_rpm]: [f64; 2], [fast, slow]: [(f64, f64); 2]) -> (f64, f64, f64) {
    let span = (fast_rpm - slow_rpm).max(1e-9);
    let slope = (fast.0 - slow.0) / span;
    // The value is (fast_rpm slow - slow_rpm fast) / span: independent errors add in squares.
    let error = (slow_rpm / span * fast.1).hypot(fast_rpm / span * slow.1);
    (slope, slow.0 - slope * slow_rpm, error)
}

/// Mean of some numbers and its standard error.
fn mean(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let values: Vec<f64> = values.collect();
    let count = values.len().max(1) as f64;
    let mean = values.iter().sum::<f64>() / count;
    let squares = values
        .iter()
        .map(|value| (value - mean).powi(2))
        .sum::<f64>();
    // Standard error: s / sqrt(n), with s by n - 1.
    (mean, (squares / (count - 1.0).max(1.0) / count).sqrt())
}
