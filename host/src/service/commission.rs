//! Commissioning of a winch: its drive, its direction, whether its brake holds and opens, and its
//! sensor's reading without load.

use super::ratio::check;
use super::windup::Windings;
use super::{Bench, CEILING_N, Loss, Purpose, Rubbing, ServiceError, Stiffness, volts};
use crate::link::{Client, Link};
use crate::robot::{DriveKind, Robot, Winch};
use serde::Serialize;
use std::f64::consts::TAU;

/// Drum counts by which a resting drum in its closed brake may yield under load.
pub(super) const BRAKE_GIVES: i64 = 4;
/// Drum counts by which a drum in its closed brake may turn under load and still be at rest: noise of its last count,
/// and the stretch of gear and brake.
const BRAKE_RESTS: i64 = 2;
/// Time of rest under load that shows that a brake holds, us.
const REST_US: u64 = 300_000;
/// Greatest turn of a drum in a brake that holds, degrees: a robot file accepts no more either.
pub(super) const MOST_BRAKE_PLAY_DEG: f64 = 2.0;
/// Time that the drive pushes against the closed brake, ms.
const PUSH_MS: u64 = 1500;
/// Readings of the tension sensor for its zero.
const READINGS: u32 = 50;

/// Observer of the drum.
pub trait Operator {
    /// Whether the drum has just turned so that it pays out cable; `None` if unknown.
    fn paid_out(&mut self) -> Option<bool>;

    /// Hangs a weight (N) on the drum, which is braked and without torque; whether it hangs.
    fn hang(&mut self, weight_n: f64) -> bool {
        let _ = weight_n;
        false
    }
}

/// What is asked for beyond the winch itself.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Asked {
    /// Number of its drive, if several are possible.
    pub node: Option<u8>,
    /// A weight that the operator hangs on the drum when the bare winch is known, N: the gear's loss is then identified,
    /// too.
    pub weight_n: Option<f64>,
}

/// Results.
#[derive(Debug, Clone, Serialize)]
pub struct Commissioned {
    /// Winch, 1 for the first.
    pub winch: usize,
    /// Number of its drive on the bus.
    pub node: u8,
    /// Every drive that answers.
    pub nodes_found: Vec<u8>,
    /// Motor counts per drum turn, with the sign that belongs to paying out.
    pub motor_counts_per_turn: f64,
    /// Sign of the drum encoder's count when cable is paid out.
    pub encoder_sign: i8,
    /// Voltage of the tension sensor without load, V.
    pub tension_zero_v: f64,
    /// Spread of one reading of it, V.
    pub tension_noise_v: f64,
    /// Current at which the closed brake held, A.
    pub brake_held_a: f64,
    /// How far the drum turns in its closed brake, degrees; resolved to one encoder count.
    pub brake_play_deg: f64,
    /// Friction and play.
    pub rubbing: Option<Rubbing>,
    /// Torsional stiffness between motor and drum; none without a gear that yields, or if the data do not show it.
    pub stiffness: Option<Stiffness>,
    /// Why it is not known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stiffness_unknown: Option<String>,
    /// What showed it.
    #[serde(skip)]
    pub(crate) windings: Windings,
    /// The gear's loss, if a weight was hung on the drum.
    pub loss: Option<Loss>,
    /// Temperature at the winch as the user noted it, degrees Celsius.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub temperature_c: Option<f64>,
    /// Differences from the robot file, in words.
    pub differs: Vec<String>,
}

impl Commissioned {
    /// Puts the results into the description of the winch. Rotor and gear share the friction as they did.
    pub(crate) fn describe(&self, winch: &mut Winch) {
        if let (Some(loss), Some(gear)) = (&self.loss, &mut winch.gear) {
            gear.efficiency = loss.efficiency;
            gear.backdrive_efficiency = loss.backdrive_efficiency;
        }
        if let (Some(found), Some(gear)) = (&self.stiffness, &mut winch.gear) {
            gear.stiffness_nm_per_rad = found.stiffness_nm_per_rad;
        }
        // After the loss, through which the drum's own friction reaches the motor.
        if let Some(rubs) = &self.rubbing {
            rubs.describe(winch);
        }
    }
}

/// Commissions one bare winch.
///
/// # Errors
/// The first failed check; the brake is closed and torque is off then.
pub fn commission<L: Link>(
    client: &mut Client<L>,
    robot: &Robot,
    winch: usize,
    asked: &Asked,
    operator: &mut impl Operator,
) -> Result<Commissioned, ServiceError> {
    let mut bench = Bench::new(client, robot, winch)?;
    let nodes_found = bench.scan()?;
    bench.node = bench.choose(&nodes_found, asked.node)?;
    let noise_v = bench.find_zero()?;
    let (held_a, pulled) = bench.push_against_brake(Purpose::Press)?;
    let (_, pushed) = bench.push_against_brake(Purpose::PressOut)?;
    bench.enable(Purpose::Turn)?;
    let turned = bench.turn_and_ask(operator);
    let closed = bench.disable();
    let (motor, drum, paid_out) = turned?;
    closed?;
    bench.enable(Purpose::Spin)?;
    let rubs = bench.rubbing(motor * drum > 0);
    let closed = bench.disable();
    let rubs = rubs?;
    closed?;
    // By the motor's own counts: the sign in the file has no effect.
    let out = if paid_out { 1 } else { -1 };
    let motor_sign = if motor * out > 0 { 1.0 } else { -1.0 };
    let geared = bench.described().gear.as_ref().map(|gear| gear.efficiency);
    let (wound, windings) = match geared {
        Some(_) => {
            let (wound, windings) = bench.windup(&rubs)?;
            (Some(wound), windings)
        }
        None => (None, Windings::new()),
    };
    let loss = match asked.weight_n.filter(|_| geared.is_some()) {
        Some(weight_n) => {
            bench.check_weight(weight_n, &rubs)?;
            if !operator.hang(weight_n) {
                return Err(ServiceError::NoAnswer { winch });
            }
            Some(bench.loss(weight_n, &rubs, motor_sign)?)
        }
        None => None,
    };
    let efficiency = loss
        .as_ref()
        .map_or(geared.unwrap_or(1.0), |loss| loss.efficiency);
    let (stiffness, stiffness_unknown) = match wound {
        Some(Ok((before, error))) => {
            let stiffness = Stiffness {
                stiffness_nm_per_rad: before * efficiency,
                stiffness_se_nm_per_rad: (error * efficiency)
                    .hypot(before * loss.as_ref().map_or(0.0, |loss| loss.efficiency_se)),
                before_loss_nm_per_rad: before,
                efficiency,
            };
            (Some(stiffness), None)
        }
        Some(Err(why)) => (None, Some(why)),
        None => (None, None),
    };
    let described = bench.described();
    let per_turn = f64::from(described.encoder_counts_per_turn);
    let brake_play_deg = 360.0 * (pushed - pulled).abs() as f64 / per_turn;
    let encoder_sign = if drum * out > 0 { 1 } else { -1 };
    let rho = (motor as f64 / drum as f64).abs();
    let measured = rho * f64::from(described.encoder_counts_per_turn);
    // A sixteenth of a turn gives the ratio to a percent; `calibrate winch` is more accurate.
    let near = (measured / described.motor_counts_per_turn.abs() - 1.0).abs() < 0.02;
    let size = if near {
        described.motor_counts_per_turn.abs()
    } else {
        measured.round()
    };
    let mut found = Commissioned {
        winch,
        node: bench.node,
        nodes_found,
        motor_counts_per_turn: size * motor_sign,
        encoder_sign,
        tension_zero_v: (bench.zero_v * 1e4).round() / 1e4,
        tension_noise_v: noise_v,
        brake_held_a: held_a,
        brake_play_deg,
        rubbing: Some(rubs),
        stiffness,
        stiffness_unknown,
        windings,
        loss,
        temperature_c: None,
        differs: Vec::new(),
    };
    found.differs = super::differs::differences(&found, described);
    Ok(found)
}

impl<L: Link> Bench<'_, L> {
    /// Every drive that answers.
    fn scan(&mut self) -> Result<Vec<u8>, ServiceError> {
        self.configure(Purpose::Turn)?;
        // On a bus that cannot send the scan does not end: then no drive answers.
        Ok(super::scan(self.client)?.unwrap_or_default())
    }

    fn choose(&self, found: &[u8], asked: Option<u8>) -> Result<u8, ServiceError> {
        let described = self.described();
        let wanted = asked.unwrap_or(described.node);
        if found.is_empty() {
            let bitrate = self.robot.bus.bitrate;
            return Err(ServiceError::NoDrive { bitrate });
        }
        if found.contains(&wanted) {
            return Ok(wanted);
        }
        let claimed = |node: u8| {
            let mut others = (0..self.robot.cables.len()).filter(|index| *index != self.index);
            others.any(|index| self.robot.winch_of(index).is_some_and(|w| w.node == node))
        };
        let mut free = found.iter().copied().filter(|node| !claimed(*node));
        match (free.next(), free.next(), asked) {
            (Some(node), None, None) => Ok(node),
            _ => {
                let names: Vec<_> = found.iter().map(u8::to_string).collect();
                Err(ServiceError::Ambiguous {
                    winch: self.index + 1,
                    expected: wanted,
                    found: names.join(", "),
                })
            }
        }
    }

    /// Zero of the tension sensor; returns the spread of one reading, V.
    pub(super) fn find_zero(&mut self) -> Result<f64, ServiceError> {
        let (mut sum, mut squares) = (0.0, 0.0);
        for _ in 0..READINGS {
            self.pause(10)?;
            let reading = f64::from(self.look()?.tension_adc);
            sum += reading;
            squares += reading * reading;
        }
        let count = f64::from(READINGS);
        let mean = sum / count;
        let spread = (squares / count - mean * mean).max(0.0).sqrt();
        let described = self.described();
        let read_v = volts(mean);
        let newtons = (read_v - described.tension_zero_v) * described.tension_gain_n_per_v;
        // An amplifier's zero may be far off; a rail is not a zero, nor is a loaded sensor.
        let plausible = (0.02..2.0).contains(&read_v) && newtons.abs() < 2.0 * CEILING_N;
        if !plausible {
            return Err(ServiceError::Loaded {
                winch: self.index + 1,
                volts: read_v,
                newtons,
            });
        }
        self.zero_v = read_v;
        Ok(volts(spread))
    }

    /// Lets the drive push against the closed brake; returns the current at which it held, A, and
    /// the drum's counts then.
    fn push_against_brake(&mut self, purpose: Purpose) -> Result<(f64, i64), ServiceError> {
        let before = self.look()?.drum_counts;
        self.enable(purpose)?;
        let enable_ms = match self.described().drive {
            DriveKind::Rmds => 2200,
            DriveKind::Cia402 => 1500,
        };
        let outcome = self.watch_brake(before, enable_ms + PUSH_MS);
        let closed = self.disable();
        let held = outcome?;
        closed?;
        Ok(held)
    }

    fn watch_brake(&mut self, before: i32, most_ms: u64) -> Result<(f64, i64), ServiceError> {
        let asked_a = self.current_a();
        let per_turn = f64::from(self.described().encoder_counts_per_turn);
        let most = BRAKE_GIVES as f64 + per_turn * MOST_BRAKE_PLAY_DEG / 360.0;
        let give_up = self.client.now_us() + most_ms * 1000;
        let number = self.index + 1;
        let slips = |counted: i64, current_a: f64| ServiceError::BrakeSlips {
            winch: number,
            counted,
            current_a,
        };
        let (mut held_from, mut most_a) = (None::<(u64, i64)>, 0.0_f64);
        let mut counted = 0;
        while self.client.now_us() < give_up {
            self.pause(20)?;
            if let Some(record) = crate::run::status(self.client)?.fault {
                return Err(crate::run::RunError::Fault { record, why: None }.into());
            }
            let winch = self.look()?;
            let current_a = f64::from(winch.current_ma).abs() * 1e-3;
            most_a = most_a.max(current_a);
            counted = i64::from(winch.drum_counts) - i64::from(before);
            // The push takes up the play of gear and brake first, and the rotor arrives with a knock. A drum that
            // continues to turn after that slips.
            if counted.abs() as f64 > most {
                return Err(slips(counted, current_a));
            }
            let now_us = self.client.now_us();
            if current_a <= 0.5 * asked_a {
                held_from = None;
            } else {
                let rested = held_from.filter(|(_, from)| (counted - from).abs() <= BRAKE_RESTS);
                let (since, _) = *held_from.insert(rested.unwrap_or((now_us, counted)));
                // A current that has just begun, and a drum that has just stopped, do not show that the brake holds.
                if now_us - since > REST_US {
                    return Ok((most_a, i64::from(winch.drum_counts)));
                }
            }
        }
        if most_a > 0.5 * asked_a {
            return Err(slips(counted, most_a));
        }
        Err(ServiceError::NoCurrent {
            winch: self.index + 1,
            current_a: most_a,
            asked_a,
        })
    }

    /// Turns an eighth of a turn and back: motor and drum counts of its second half, and whether that paid out.
    fn turn_and_ask(
        &mut self,
        operator: &mut impl Operator,
    ) -> Result<(i64, i64, bool), ServiceError> {
        let way = TAU / 16.0;
        // The first turn takes up the play: a play of 2 degrees would be 9 % of it.
        let first = self.at_rest()?;
        self.turn(0.0, way)?;
        let start = self.at_rest()?;
        check(self, first, start, way)?;
        self.turn(way, 2.0 * way)?;
        let end = self.at_rest()?;
        check(self, start, end, way)?;
        // The answer may take time: the board's heartbeat comes from this loop, so the drum is
        // braked before the user is asked.
        self.turn(2.0 * way, 0.0)?;
        let back = self.at_rest()?;
        check(self, end, back, way)?;
        self.turn(0.0, way)?;
        let winch = self.index + 1;
        let paid_out = operator
            .paid_out()
            .ok_or(ServiceError::NoAnswer { winch })?;
        Ok((end.0 - start.0, end.1 - start.1, paid_out))
    }
}
