//! Work on one unloaded winch: its drive's number, directions, brake, sensor zero, motor ratio.
//!
//! No attached cable is assumed here, and no other winch moves: the board enables a single drive
//! ([`Request::Service`]), slowly, with little current, under the usual supervision (session,
//! heartbeat, stops, limits).

mod commission;
mod differs;
mod drawing;
mod error;
mod loss;
mod purpose;
mod ratio;
mod rubbing;
mod steady;
mod windup;

pub use commission::{Asked, Commissioned, Operator, commission};
pub(crate) use drawing::figure;
pub use error::ServiceError;
pub use loss::{Lifted, Loss};
use purpose::{Purpose, RADIUS_UM, lift_ceiling_n};
pub use ratio::{Ratio, measure_ratio};
pub use rubbing::{Friction, Rubbing};
pub use windup::Stiffness;

use crate::link::{Client, Link};
use crate::machine;
use crate::motion::knot;
use crate::robot::Robot;
use crate::run::{RunError, interrupted, send_configuration, status, wait_for};
use mcdpr_protocol::{
    BoardState, CableKnot, ConfigHash, Knot, MicrometresPerSecond, Millinewtons, PerCable, Reply,
    Request, TenthMicrometres, Winch,
};

/// Share of the motor's largest speed that service uses. Accelerations grow with its square, and
/// must be far from what [`CURRENT_SHARE`] allows: a geared rotor is heavy (34 kg at the paper's
/// cable), and at half the speed the drive of most simulated machines saturated (D4).
const SPEED_SHARE: f64 = 0.25;
/// Above this tension there must be a cable, N: the board stops.
const CEILING_N: f64 = 5.0;
/// Knots of one move; the board's buffer holds 16.
const KNOTS: u32 = 12;
/// Shortest time between two knots, ms: the board takes 4.
const SPACING_MS: u32 = 20;
/// 65,536 steps of the converter are this many volts.
const REFERENCE_V: f64 = 3.3;

/// Checks that the robot has a winch (from 1).
///
/// # Errors
/// [`ServiceError::NoWinch`].
pub(crate) fn known(robot: &Robot, winch: usize) -> Result<(), ServiceError> {
    let count = robot.cables.len();
    if (1..=count).contains(&winch) {
        return Ok(());
    }
    Err(ServiceError::NoWinch { winch, count })
}

/// One winch of a connected board.
struct Bench<'a, L: Link> {
    client: &'a mut Client<L>,
    robot: &'a Robot,
    /// From 0.
    index: usize,
    node: u8,
    /// Measured zero of the tension sensor, V.
    zero_v: f64,
}

impl<'a, L: Link> Bench<'a, L> {
    fn new(
        client: &'a mut Client<L>,
        robot: &'a Robot,
        winch: usize,
    ) -> Result<Self, ServiceError> {
        let count = robot.cables.len();
        let board = client.info().cables;
        if usize::from(board) != count {
            let robot = count;
            return Err(RunError::Cables { board, robot }.into());
        }
        // 0 wraps to an index that no robot has.
        let index = winch.wrapping_sub(1);
        let Some(described) = robot.winch_of(index) else {
            return Err(ServiceError::NoWinch { winch, count });
        };
        Ok(Self {
            client,
            index,
            node: described.node,
            zero_v: described.tension_zero_v,
            robot,
        })
    }

    fn number(&self) -> u8 {
        u8::try_from(self.index + 1).unwrap_or(u8::MAX)
    }

    fn described(&self) -> &crate::robot::Winch {
        // Checked when the bench was made.
        self.robot
            .winch_of(self.index)
            .unwrap_or(&self.robot.winches[0])
    }

    fn configure(&mut self, purpose: Purpose) -> Result<ConfigHash, ServiceError> {
        if let Some(record) = status(self.client)?.fault {
            return Err(RunError::Latched { record }.into());
        }
        let entries = self.configuration(purpose)?;
        let hash = machine::hash_of(&entries);
        send_configuration(self.client, &entries, hash)?;
        Ok(hash)
    }

    /// Gives only this winch torque; with its brake open it holds when this returns.
    fn enable(&mut self, purpose: Purpose) -> Result<(), ServiceError> {
        let config_hash = self.configure(purpose)?;
        let count = self.robot.cables.len();
        let pull = Millinewtons(match purpose {
            Purpose::Turn | Purpose::Spin | Purpose::Lift { .. } => 0,
            Purpose::Press | Purpose::PressOut => 10_000,
            #[expect(clippy::cast_possible_truncation, reason = "a newton at most")]
            Purpose::Wind { .. } => (windup::BEGINS_N * 1e3) as i32,
        });
        self.client.request(Request::Reference {
            lengths: PerCable::collect((0..count).map(|_| TenthMicrometres(0))),
            tensions: PerCable::collect((0..count).map(|_| pull)),
        })?;
        let open = purpose.opens();
        let cable = self.number();
        self.client.request(Request::Service {
            config_hash,
            cable,
            open,
        })?;
        if open {
            wait_for(self.client, BoardState::Holding, 6.0)?;
        }
        Ok(())
    }

    fn disable(&mut self) -> Result<(), ServiceError> {
        self.client.request(Request::Disarm)?;
        Ok(wait_for(self.client, BoardState::Disarmed, DISABLE_S)?)
    }

    fn look(&mut self) -> Result<Winch, ServiceError> {
        let cable = self.number();
        Ok(self.client.winch(cable).map_err(RunError::from)?)
    }

    fn pause(&mut self, ms: u64) -> Result<(), ServiceError> {
        let until = self.client.now_us() + ms * 1000;
        self.client.pump(until)?;
        if interrupted() {
            // The brake closes and torque is switched off, whatever was in progress.
            self.client.stop(mcdpr_protocol::StopKind::Stop)?;
            return Err(RunError::Interrupted.into());
        }
        Ok(())
    }

    /// Motor and drum, at rest.
    fn at_rest(&mut self) -> Result<(i64, i64), ServiceError> {
        self.pause(100)?;
        let winch = self.look()?;
        Ok((winch.motor_counts.into(), winch.drum_counts.into()))
    }

    /// Turns the drum by the file's ratio from where it is (`from` rad since it was enabled) to `to`
    /// rad, by the motor alone, and waits until it rests.
    fn turn(&mut self, from_rad: f64, to_rad: f64) -> Result<(), ServiceError> {
        let time_s = self.begin_turn(from_rad, to_rad, 1.0)?;
        Ok(wait_for(self.client, BoardState::Holding, time_s + 2.0)?)
    }

    /// Begins such a turn at a share of the speed of service; returns its duration, s.
    fn begin_turn(
        &mut self,
        from_rad: f64,
        to_rad: f64,
        share_of_speed: f64,
    ) -> Result<f64, ServiceError> {
        let top = share_of_speed * self.service_rad_per_s();
        let way = to_rad - from_rad;
        // A quintic from rest to rest peaks at 15/8 of its mean speed.
        let time_s = way.abs() / top * 1.875;
        self.send_turn((from_rad, way), time_s, |share| {
            let done = share.powi(3) * (10.0 - 15.0 * share + 6.0 * share * share);
            (done, 30.0 * share * share * (1.0 - share).powi(2))
        })
    }

    /// Greatest speed of the drum in service, rad/s.
    fn service_rad_per_s(&self) -> f64 {
        let winch = self.described();
        winch.max_motor_rpm * SPEED_SHARE / winch.gear_ratio * std::f64::consts::TAU / 60.0
    }

    /// Sends and starts a turn by `way_rad` that takes `time_s` or longer; `profile` gives the
    /// share of the distance and its derivative at a share of the time. Returns its duration, s.
    fn send_turn(
        &mut self,
        (from_rad, way_rad): (f64, f64),
        time_s: f64,
        profile: impl Fn(f64) -> (f64, f64),
    ) -> Result<f64, ServiceError> {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "some seconds"
        )]
        let spacing_ms =
            (((time_s * 1e3).ceil() / f64::from(KNOTS)) as u32 + 1).clamp(SPACING_MS, 4000);
        let time_s = f64::from(spacing_ms * KNOTS) * 1e-3;
        // A fault explains more than the refusal of a request in its state.
        if let Some(record) = status(self.client)?.fault {
            return Err(RunError::Fault { record, why: None }.into());
        }
        // Knots of an earlier turn must not stay in the buffer.
        self.client.request(Request::Discard)?;
        for number in 0..=KNOTS {
            let (done, slope) = profile(f64::from(number) / f64::from(KNOTS));
            // In 0.1 um on a drum of 10 mm: a radian is 100 000.
            let at = (from_rad + way_rad * done) * RADIUS_UM * 10.0;
            let speed = way_rad * slope / time_s * RADIUS_UM;
            #[expect(clippy::cast_possible_truncation, reason = "checked by the board")]
            let (at, speed) = (at.round() as i32, speed.round() as i32);
            let cables = (0..self.robot.cables.len()).map(|index| {
                let mine = index == self.index;
                CableKnot {
                    length: TenthMicrometres(if mine { at } else { 0 }),
                    velocity: MicrometresPerSecond(if mine { speed } else { 0 }),
                    tension: Millinewtons(0),
                }
            });
            let knot = Knot {
                last: number == KNOTS,
                ..knot::knot(number as usize, number * spacing_ms, cables)
            };
            self.client.request(Request::Knot(knot))?;
        }
        self.client.request(Request::Start)?;
        Ok(time_s)
    }
}
/// Time in which a board has proved its brakes and switched torque off, s: stop, closing time and proof take 2.5 s with
/// the play of every gear, and each of ten retries of a brake that slips as much as its waiting time more.
const DISABLE_S: f64 = 6.0;
/// Time for drives that were just reset to answer again, µs.
const RESET_US: u64 = 700_000;
/// Time for a board to ask every number on the bus, µs.
const SCAN_US: u64 = 5_000_000;

/// Every drive that answers; `None` if the board's scan does not end because it cannot send.
pub(crate) fn scan<L: Link>(client: &mut Client<L>) -> Result<Option<Vec<u8>>, RunError> {
    let until = client.now_us() + RESET_US;
    client.pump(until)?;
    client.request(Request::Scan { restart: true })?;
    let give_up = client.now_us() + SCAN_US;
    while client.now_us() < give_up {
        let until = client.now_us() + 50_000;
        client.pump(until)?;
        if let Reply::Drives { done: true, nodes } =
            client.request(Request::Scan { restart: false })?
        {
            // A bit for each number, 32 to a word.
            let answers = |node: &u8| {
                let word = nodes.get(usize::from(*node >> 5));
                word.is_some_and(|word| word & (1 << (node & 31)) != 0)
            };
            return Ok(Some((1..=126).filter(answers).collect()));
        }
    }
    Ok(None)
}

/// Volts at the converter for a reading of it.
pub(crate) fn volts(reading: f64) -> f64 {
    reading / 65_536.0 * REFERENCE_V
}
