//! Waiting for what somebody asks of an idle robot, and jogging.

use crate::feed::Feed;
use mcdpr_core::control::{Handle, Order, Outcome as Answered, Ticket};
use mcdpr_core::link::{Client, ClientError, Link};
use mcdpr_core::motion::Model;
use mcdpr_core::run::{self, Homing, LengthStore, RunError, Session, interrupted};
use mcdpr_protocol::{Request, SessionId};
use std::sync::atomic::{AtomicBool, Ordering};

/// A robot that was armed for jogging holds this long after the last jog, s.
const JOG_HOLD_S: f64 = 3.0;
/// Polling interval of an idle board, µs.
const LOOK_US: u64 = 40_000;

/// A request to an idle robot, and whether its lengths are known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wanted {
    /// The program ends.
    Nothing,
    /// The task.
    Task {
        /// Whether the board knows its lengths.
        referenced: bool,
    },
    /// Jogs.
    Jogs {
        /// Whether the board knows its lengths.
        referenced: bool,
    },
    /// The line, for another program.
    Line,
}

/// Attends to a robot between motions.
#[derive(Clone, Copy)]
pub struct Attendant<'a> {
    /// The robot.
    pub model: &'a Model,
    /// What viewers see.
    pub feed: &'a Feed,
    /// Orders come through this.
    pub handle: &'a Handle,
    /// Whether Start was pressed.
    pub start: &'a AtomicBool,
    /// Whether another program shall have the robot.
    pub hands_over: &'a dyn Fn() -> bool,
}

impl Attendant<'_> {
    /// Arms, and executes jogs until none has come for a while.
    pub fn jog(
        &self,
        link: impl Link,
        session: SessionId,
        homing: Homing<'_>,
        kept: &dyn LengthStore,
    ) -> Result<(), RunError> {
        let mut session = Session::open(self.model, link, session, self.handle, homing, kept)?;
        session.arm()?;
        self.feed.say("armed: hold a jog button to move the tool");
        loop {
            let before_m = session.tool_m();
            session.hold(Some(JOG_HOLD_S))?;
            if session.tool_m() == before_m {
                break;
            }
        }
        session.disarm()
    }

    /// Makes a request for an order: done, or the board's refusal in words.
    ///
    /// # Errors
    /// The line's; the order is answered with it.
    fn ask<L: Link>(
        &self,
        client: &mut Client<L>,
        ticket: Ticket,
        request: Request,
    ) -> Result<Answered, ClientError> {
        match client.request(request) {
            Ok(_) => Ok(Ok(())),
            Err(refused @ ClientError::Refused { .. }) => Ok(Err(refused.to_string())),
            Err(error) => {
                self.handle.done(ticket, Err(error.to_string()));
                Err(error)
            }
        }
    }

    /// Polls the idle robot until there is a request.
    pub fn wait<L: Link>(
        &self,
        link: L,
        session: SessionId,
        greeted: impl FnOnce(&mut Client<L>) -> Result<(), RunError>,
    ) -> Result<Wanted, RunError> {
        let mut client = Client::connect(link, session)?;
        greeted(&mut client)?;
        let outcome = loop {
            if interrupted() {
                break Wanted::Nothing;
            }
            let mut jogs = false;
            while let Some((ticket, order)) = self.handle.take() {
                let outcome = match order {
                    Order::Clear => {
                        let outcome = self.ask(&mut client, ticket, Request::ClearFault)?;
                        match &outcome {
                            Ok(()) => self.feed.clear_trouble(),
                            Err(reason) => self.feed.set_trouble(reason),
                        }
                        outcome
                    }
                    Order::Stop | Order::Emergency => {
                        jogs = false;
                        Ok(())
                    }
                    // Jogs that arrive once the robot is armed are executed.
                    Order::Jog { velocity_mps, .. } => {
                        jogs |= velocity_mps != [0.0; 3];
                        Ok(())
                    }
                    Order::Gripper { closed } => {
                        self.ask(&mut client, ticket, Request::Gripper { closed })?
                    }
                    other => Err(format!("{} is not possible: nothing moves", other.name())),
                };
                self.handle.done(ticket, outcome);
            }
            // The last task has been stopped by now, also if Start followed at once.
            self.handle.start_anew();
            if (self.hands_over)() {
                break Wanted::Line;
            }
            let status = run::status(&mut client)?;
            let referenced = status.referenced;
            let starts = self.start.swap(false, Ordering::SeqCst);
            if starts || jogs {
                match status.fault {
                    None if starts => break Wanted::Task { referenced },
                    None => break Wanted::Jogs { referenced },
                    Some(_) => self
                        .feed
                        .set_trouble("a fault is latched; remove its cause, then clear it"),
                }
            }
            let look = client.now_us() + LOOK_US;
            client.pump(look)?;
        };
        client.request(Request::Close)?;
        Ok(outcome)
    }
}
