//! What the thread of a session holds: the board's client, and what stands behind it.

use crate::failure::Failure;
use mcdpr::link::SimulatedLink;
use mcdpr::run::LengthFiles;
use mcdpr::scenario::FaultyLink;
use mcdpr_core::control::Handle;
use mcdpr_core::link::Link;
use mcdpr_core::motion::Model;
use mcdpr_core::run::{Homing, RunError, Session};
use mcdpr_protocol::{BoardState, SessionId};
use mcdpr_simulator::Simulation;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::Duration;

/// A stop takes this long at most, µs.
const MOST_STOPPING_US: u64 = 3_000_000;
/// How often an idle line is served.
const SERVE: Duration = Duration::from_millis(2);

/// What the thread holds.
pub(crate) struct World<'m> {
    pub(crate) model: &'m Model,
    pub(crate) handle: &'m Handle,
    pub(crate) session: Option<Session<'m, Box<dyn Link>>>,
    /// Of a simulated robot.
    pub(crate) simulated: Option<(SimulatedLink, FaultyLink)>,
    pub(crate) sessions: u32,
    /// What the line came to while nobody asked.
    pub(crate) lost: Option<Failure>,
    pub(crate) armed: bool,
}

/// What Python asks for.
pub(crate) type Job = Box<dyn for<'m> FnOnce(&mut World<'m>) + Send>;

/// A line, what is simulated behind it, and how its robot learns where it is.
pub(crate) type Opened = (
    Box<dyn Link>,
    Option<(SimulatedLink, FaultyLink)>,
    Homing<'static>,
);

impl<'m> World<'m> {
    /// The session; a simulated robot's is opened again where it was given back.
    pub(crate) fn session(&mut self) -> Result<&mut Session<'m, Box<dyn Link>>, Failure> {
        if let Some(lost) = self.lost.take() {
            return Err(lost);
        }
        if self.session.is_none() {
            let Some((_, line)) = &self.simulated else {
                let words = "the board was given back; connect again";
                return Err(Failure::new("RunError", words));
            };
            self.sessions += 1;
            let link: Box<dyn Link> = Box::new(line.clone());
            self.handle.start_anew();
            self.session = Some(Session::open(
                self.model,
                link,
                SessionId(self.sessions),
                self.handle,
                Homing::Known,
                &LengthFiles,
            )?);
        }
        let session = self.session.as_mut();
        session.ok_or_else(|| Failure::new("RunError", "there is no session"))
    }

    pub(crate) fn arm(&mut self) -> Result<(), Failure> {
        if !self.armed {
            self.session()?.arm()?;
            self.armed = true;
        }
        Ok(())
    }

    /// After a failure the session may be no more, and the robot no longer armed.
    pub(crate) fn settle<T>(&mut self, done: Result<T, RunError>) -> Result<T, Failure> {
        if let Err(error) = &done {
            self.armed = false;
            if matches!(
                error,
                RunError::Interrupted | RunError::Emergency | RunError::Client(_)
            ) {
                self.session = None;
            }
        }
        Ok(done?)
    }

    /// Waits until a robot that stopped by itself has come to rest: before, a board gives nothing up.
    pub(crate) fn come_to_rest(&mut self) -> Result<(), Failure> {
        let client = self.session()?.client();
        let until_us = client.now_us() + MOST_STOPPING_US;
        while client.now_us() < until_us {
            let status = mcdpr_core::run::status(client)?;
            if status.state != BoardState::Stopping {
                break;
            }
            let pause_us = client.now_us() + 20_000;
            client.pump(pause_us).map_err(RunError::from)?;
        }
        Ok(())
    }

    /// Ends the session: brakes closed, the board given back.
    pub(crate) fn give_back(&mut self) -> Result<(), Failure> {
        if self.session.is_none() {
            return Ok(());
        }
        if !self.armed {
            self.come_to_rest()?;
        }
        let Some(session) = self.session.take() else {
            return Ok(());
        };
        if std::mem::take(&mut self.armed) {
            session.disarm()?;
        } else {
            session.close()?;
        }
        Ok(())
    }

    pub(crate) fn simulation<T>(
        &self,
        look: impl FnOnce(&mut Simulation) -> T,
    ) -> Result<T, Failure> {
        match &self.simulated {
            Some((link, _)) => Ok(link.with(look)),
            None => Err(Failure::new(
                "RunError",
                "only a simulated robot can be looked at or broken from outside",
            )),
        }
    }
}

/// Works until nobody asks any more.
pub(crate) fn serve(mut world: World<'_>, queue: &Receiver<Job>) {
    loop {
        let live = world.simulated.is_none() && world.session.is_some();
        let job = if live {
            queue.recv_timeout(SERVE)
        } else {
            queue.recv().map_err(|_| RecvTimeoutError::Disconnected)
        };
        match job {
            Ok(job) => job(&mut world),
            Err(RecvTimeoutError::Disconnected) => break,
            Err(RecvTimeoutError::Timeout) => idle(&mut world),
        }
    }
    // Nobody is left to hear of a failure; a board that loses its host stops by itself.
    let _ = world.give_back();
}

/// Serves a real line while Python does something else.
fn idle(world: &mut World<'_>) {
    let Some(session) = world.session.as_mut() else {
        return;
    };
    let client = session.client();
    let stepped = client.step();
    while client.next_event().is_some() {}
    if let Err(error) = stepped {
        world.lost = Some(RunError::from(error).into());
        world.session = None;
        world.armed = false;
        return;
    }
    let status = client.status();
    let fault = status.and_then(|status| status.fault);
    let down = status.is_some_and(|status| status.state == BoardState::Disarmed);
    if fault.is_some() || down {
        world.armed = false;
    }
}
