//! Jogging: a motion that is planned while it runs, a third of a second ahead of the board.
//!
//! Each knot is a resting state at the tool's next position, so the board always has a path on
//! which it can brake. The velocity changes no faster than the robot's acceleration; if the next
//! position would break a limit, the velocity goes to zero instead.

use super::{RunError, Session, orders, stop_now};
use crate::control::Order;
use crate::link::{Client, ClientError, Link};
use crate::motion::{Model, PlanError, StaticState, judge_place, knot};
use crate::robot::Control;
use mcdpr_protocol::{BoardState, CableKnot, Knot, Request, Status, StopKind};
use nalgebra::Vector3;

/// Time between knots, s.
/// The board takes knots from 4 ms on; in 0.04 s a tool at 0.1 m/s moves 4 mm.
const STEP_S: f64 = 0.04;
/// How far ahead of the board's path clock knots are sent, s.
/// Eight of the 16 knots that a board's buffer holds.
const AHEAD_S: f64 = 0.32;
/// The longest jog, s: an operator must be present.
const LONGEST_S: f64 = 60.0;

/// Whether a jog may be asked for.
///
/// # Errors
/// [`PlanError::Step`] names what is too much.
pub fn check(model: &Model, velocity_mps: &Vector3<f64>, seconds: f64) -> Result<(), PlanError> {
    let limit = model.robot().limits.speed_mps;
    let asked = velocity_mps.norm();
    let wrong = |what: &str, asked, limit, unit| PlanError::Step {
        what: what.to_owned(),
        asked,
        limit,
        unit,
    };
    if asked.is_nan() || asked > limit {
        return Err(wrong(
            "a jog's speed (limits.speed_mps)",
            asked,
            limit,
            "m/s",
        ));
    }
    if !(seconds > 0.0 && seconds <= LONGEST_S) {
        return Err(wrong("a jog's time", seconds, LONGEST_S, "s"));
    }
    Ok(())
}

/// The motion planned so far.
struct Ahead<'m> {
    model: &'m Model,
    at_m: Vector3<f64>,
    velocity_mps: Vector3<f64>,
    rest: StaticState,
    /// Difference of the model's lengths from the board's, m: joins the motion to where the board
    /// holds.
    offsets_m: Vec<f64>,
    time_s: f64,
    /// Number of knots so far.
    made: usize,
    limit: Option<String>,
}

impl<'m> Ahead<'m> {
    /// A jog that begins where the board holds.
    fn new(model: &'m Model, at_m: Vector3<f64>, rest: StaticState, status: &Status) -> Self {
        let cables = model.robot().cables.iter();
        let offsets_m = cables
            .zip(status.setpoints.iter().zip(&rest.paid_out_m))
            .map(|(cable, (setpoint, length))| match cable.control {
                Control::Tension => 0.0,
                Control::Position => setpoint.metres() - length,
            })
            .collect();
        Self {
            model,
            at_m,
            velocity_mps: Vector3::zeros(),
            rest,
            offsets_m,
            time_s: 0.0,
            made: 0,
            limit: None,
        }
    }

    /// The next knot towards a wanted velocity; the last one when the tool has come to rest.
    fn next(&mut self, wanted_mps: Vector3<f64>) -> Result<Knot, PlanError> {
        let limits = &self.model.robot().limits;
        let most = limits.acceleration_mps2 * STEP_S;
        // The tool must be able to stop inside the limits: check the position where it would come
        // to rest.
        // Twice the braking distance v^2 / (2 a), and the two knots until the brake takes effect.
        let stop_s = wanted_mps.norm() / limits.acceleration_mps2 + 2.0 * STEP_S;
        let stop_m = self.at_m + wanted_mps * stop_s;
        let mut wanted = wanted_mps;
        if wanted.norm() > 0.0
            && let Err(error) = self.place(&stop_m)
        {
            self.limit = Some(error.to_string());
            wanted = Vector3::zeros();
        }
        let change = wanted - self.velocity_mps;
        let share = (most / change.norm().max(1e-12)).min(1.0);
        let mut velocity = self.velocity_mps + change * share;
        // Rounding: only an exact zero ends the jog with its last knot.
        if velocity.norm() < 1e-6 {
            velocity = Vector3::zeros();
        }
        let to_m = self.at_m + (self.velocity_mps + velocity) * (0.5 * STEP_S);
        let rest = self.place(&to_m)?;
        // The knot's velocities: change of the lengths over the next millisecond.
        let ahead = self.place(&(to_m + velocity * 1e-3))?;
        let speeds: Vec<f64> = ahead
            .paid_out_m
            .iter()
            .zip(&rest.paid_out_m)
            .map(|(b, a)| (b - a) / 1e-3)
            .collect();
        self.time_s += STEP_S;
        self.at_m = to_m;
        self.velocity_mps = velocity;
        self.rest = rest;
        Ok(self.knot(&speeds, velocity.norm() == 0.0 && wanted.norm() == 0.0))
    }

    fn place(&self, at_m: &Vector3<f64>) -> Result<StaticState, PlanError> {
        let rest = self.model.rest(at_m, Some(&self.rest))?;
        judge_place(self.model, at_m, &rest, Some(&self.rest))?;
        Ok(rest)
    }

    fn knot(&mut self, speeds: &[f64], last: bool) -> Knot {
        let lengths = self.rest.paid_out_m.iter().zip(&self.offsets_m);
        let rows = lengths.zip(speeds).zip(self.rest.tensions_n());
        let cables = rows.map(|(((length, offset), speed), tension)| {
            CableKnot::from_si(length + offset, *speed, *tension)
        });
        let number = self.made;
        self.made += 1;
        Knot {
            last,
            ..knot::knot(number, knot::milliseconds(self.time_s), cables)
        }
    }
}

/// The motion that the user wants.
struct Wish {
    /// Velocity of the tool, world, m/s.
    velocity_mps: Vector3<f64>,
    /// Its end by the path's time, s: the part planned ahead of the board counts.
    until_s: f64,
}

impl Wish {
    /// Takes the orders that have come: a jog replaces this one, a pause ends it.
    fn obey<L: Link>(
        &mut self,
        client: &mut Client<L>,
        ahead: &Ahead<'_>,
        ended: bool,
    ) -> Result<(), RunError> {
        while let Some((ticket, order)) = client.handle().take() {
            let done = match order {
                Order::Jog {
                    velocity_mps,
                    valid_s,
                } => match check(ahead.model, &velocity_mps.into(), valid_s) {
                    Ok(()) if !ended => {
                        self.velocity_mps = velocity_mps.into();
                        self.until_s = ahead.time_s + valid_s;
                        Ok(())
                    }
                    // Its last knot is sent: a motion cannot be prolonged after that.
                    Ok(()) => Err("the jog has ended".to_owned()),
                    Err(error) => Err(error.to_string()),
                },
                Order::Pause => {
                    self.until_s = 0.0;
                    Ok(())
                }
                Order::Gripper { closed } => {
                    orders::refusable(client, Request::Gripper { closed })?
                }
                other => Err(format!("{} is not possible while jogging", other.name())),
            };
            client.handle().done(ticket, done);
        }
        Ok(())
    }
}

impl<L: Link> Session<'_, L> {
    /// Moves the tool at a velocity (world, m/s) for some seconds, or until an order of the handle
    /// changes it: a jog replaces this one, a pause ends it. Returns at rest, with the limit that
    /// ended it early, if one did.
    ///
    /// # Errors
    /// [`RunError::Interrupted`] after a stop, [`RunError::Fault`], or the client's errors.
    pub fn jog(
        &mut self,
        velocity_mps: Vector3<f64>,
        seconds: f64,
    ) -> Result<Option<String>, RunError> {
        check(self.model(), &velocity_mps, seconds)?;
        let status = super::status(self.client())?;
        let model = self.model();
        let mut ahead = Ahead::new(model, self.tool_m(), self.at().clone(), &status);
        let still = vec![0.0; ahead.rest.paid_out_m.len()];
        let first = ahead.knot(&still, false);
        let client = self.client();
        client.enqueue(Request::Knot(first))?;
        let mut wish = Wish {
            velocity_mps,
            until_s: seconds,
        };
        let (mut started, mut ended) = (false, false);
        let outcome = loop {
            if let Some(kind) = orders::stop_wanted(client) {
                break Err(stop_now(client, kind));
            }
            wish.obey(client, &ahead, ended)?;
            let path_s = client.path_s().filter(|_| started).unwrap_or(0.0);
            while !ended && ahead.time_s < path_s + AHEAD_S && client.has_room() {
                // Sums of 0.04 s do not meet the end exactly.
                if ahead.time_s >= wish.until_s - 0.5 * STEP_S {
                    wish.velocity_mps = Vector3::zeros();
                }
                let knot = ahead.next(wish.velocity_mps)?;
                ended = knot.last;
                client.enqueue(Request::Knot(knot))?;
            }
            client.step()?;
            while let Some((request, result)) = client.next_outcome() {
                if let Err(reject) = result {
                    client.stop(StopKind::Stop)?;
                    return Err(ClientError::Refused {
                        request: format!("{request:?}"),
                        reject,
                    }
                    .into());
                }
            }
            // A jog that ends at once has only this knot.
            let enough = ended || ahead.time_s >= AHEAD_S.min(2.0 * STEP_S);
            if !started && client.in_flight() == 0 && enough {
                client.request(Request::Start)?;
                started = true;
                continue;
            }
            while client.next_event().is_some() {}
            if let Some(record) = client.status().and_then(|status| status.fault) {
                break Err(RunError::Fault { record, why: None });
            }
            let resting = client.beat().is_some_and(|beat| {
                beat.state == BoardState::Holding && beat.next_knot == 0 && ended
            });
            if started && resting && client.in_flight() == 0 {
                break Ok(ahead.limit.clone());
            }
        };
        let rest = ahead.rest;
        self.set_at(rest);
        outcome.map_err(|error| self.explain(error))
    }

    /// Holds under tension for some seconds, or until a stop; executes jogs that are ordered
    /// meanwhile.
    ///
    /// # Errors
    /// [`RunError::Interrupted`] after a stop, [`RunError::Fault`], or the client's errors.
    pub fn hold(&mut self, seconds: Option<f64>) -> Result<(), RunError> {
        let until_us = seconds.map(|s| self.client().now_us() + micros(s));
        loop {
            let client = self.client();
            if let Some(kind) = orders::stop_wanted(client) {
                return Err(stop_now(client, kind));
            }
            if until_us.is_some_and(|until| client.now_us() >= until) {
                return Ok(());
            }
            client.step()?;
            while client.next_event().is_some() {}
            if let Some(record) = client.status().and_then(|status| status.fault) {
                return Err(self.explain(RunError::Fault { record, why: None }));
            }
            let Some((ticket, order)) = client.handle().take() else {
                continue;
            };
            let done = match order {
                Order::Jog {
                    velocity_mps,
                    valid_s,
                } => {
                    let wanted = velocity_mps.into();
                    let may = check(self.model(), &wanted, valid_s);
                    let refused = may.map_err(|error| error.to_string());
                    let good = refused.is_ok();
                    self.client().handle().done(ticket, refused);
                    // A released button is not a motion if nothing moves any more.
                    if good && wanted != Vector3::zeros() {
                        self.jog(wanted, valid_s)?;
                    }
                    continue;
                }
                Order::Gripper { closed } => {
                    orders::refusable(client, Request::Gripper { closed })?
                }
                Order::Stop | Order::Emergency => continue,
                other => Err(format!("{} is not possible: nothing moves", other.name())),
            };
            client.handle().done(ticket, done);
        }
    }
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "checked times of some seconds"
)]
fn micros(seconds: f64) -> u64 {
    (seconds * 1e6) as u64
}
