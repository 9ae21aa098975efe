//! Sessions, sequence numbers and telemetry in front of the controller.
//!
//! [`Server`] works on decoded messages and belongs to the control tick; [`Receiver`] and the
//! `encode_*` functions convert between bytes and messages and belong to the code that moves bytes.

use crate::controller::Controller;
use crate::io::{Inputs, Outputs};
use crate::sampler::Row;
use crate::supervisor::State;
use crate::watch::LinkHealth;
use mcdpr_protocol::{
    Answer, Channel, Command, ConfigHash, Deframer, FrameError, Reject, Reply, Request,
    SequenceNumber, SessionId, Status, StopKind, Tick, WINDOW,
};

/// Ticks between two status messages when nothing changes.
const STATUS_TICKS: u32 = 100;

/// A sequenced request's outcome, small enough to be kept.
#[derive(Debug, Clone, Copy)]
enum Outcome {
    Done,
    Queued(u8),
    Configured(ConfigHash),
    Refused(Reject),
}

impl Outcome {
    fn of(result: &Result<Reply, Reject>) -> Self {
        match result {
            Ok(Reply::Queued { free }) => Self::Queued(*free),
            Ok(Reply::Configured { hash }) => Self::Configured(*hash),
            Ok(_) => Self::Done,
            Err(reject) => Self::Refused(*reject),
        }
    }

    fn result(self) -> Result<Reply, Reject> {
        match self {
            Self::Done => Ok(Reply::Done),
            Self::Queued(free) => Ok(Reply::Queued { free }),
            Self::Configured(hash) => Ok(Reply::Configured { hash }),
            Self::Refused(reject) => Err(reject),
        }
    }
}

/// The link's counters.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
pub struct LinkCounters {
    /// Frames received intact.
    pub frames_ok: u32,
    /// Damaged frames.
    pub frames_bad: u32,
    /// Telemetry frames dropped because the link was full.
    pub telemetry_dropped: u32,
}

/// A controller behind sessions and sequence numbers.
#[derive(Debug, Clone)]
pub struct Server<const N: usize> {
    controller: Controller<N>,
    session: Option<SessionId>,
    /// The last closed session, and the number of the request that closed it.
    closed: Option<(SessionId, SequenceNumber)>,
    expected: SequenceNumber,
    outcomes: [Option<(SequenceNumber, Outcome)>; WINDOW as usize],
    sequence_errors: u32,
    /// Tick of the last stop request: nothing may start in the same tick (K10).
    stopped_at: Option<Tick>,
    /// Samples are requested; whether the first one was taken.
    sampling: Option<bool>,
    status_in: u32,
    reported_state: State,
    simulated: bool,
}

impl<const N: usize> Default for Server<N> {
    fn default() -> Self {
        Self::new(false)
    }
}

impl<const N: usize> Server<N> {
    /// A board that just started; `simulated` is reported in its identity.
    #[must_use]
    pub fn new(simulated: bool) -> Self {
        Self {
            controller: Controller::default(),
            session: None,
            closed: None,
            expected: SequenceNumber(0),
            outcomes: [None; WINDOW as usize],
            sequence_errors: 0,
            stopped_at: None,
            sampling: None,
            status_in: 0,
            reported_state: State::Boot,
            simulated,
        }
    }

    /// The controller.
    #[must_use]
    pub const fn controller(&self) -> &Controller<N> {
        &self.controller
    }

    /// The board starts after a crash, a hang or a failed supply; see
    /// [`Controller::start_in_fault`]. Must be called before the first tick.
    pub fn start_in_fault(&mut self, fault: mcdpr_protocol::FaultId) {
        self.controller.start_in_fault(fault);
    }

    /// See [`Controller::start_in_lasting_fault`]. Must be called before the first tick.
    pub fn start_in_lasting_fault(&mut self, fault: mcdpr_protocol::FaultId) {
        self.controller.start_in_lasting_fault(fault);
    }

    /// One control tick.
    pub fn step(&mut self, now: Tick, inputs: &Inputs<N>) -> Outputs<N> {
        self.tick(now, inputs);
        *self.controller.outputs()
    }

    /// As [`Self::step`], without a copy: [`Controller::outputs`] gives the outputs.
    pub fn tick(&mut self, now: Tick, inputs: &Inputs<N>) {
        self.controller.tick(now, inputs);
        self.status_in = self.status_in.saturating_sub(1);
    }

    /// The tick's measurements, if the host wants samples. Once per tick: the sending half packs
    /// the rows with a [`Sampler`](crate::sampler::Sampler).
    pub fn take_row(&mut self) -> Option<Row<N>> {
        let taken = self.sampling.as_mut()?;
        Some(Row {
            tick: self.controller.now(),
            path_ms: self.controller.path_ms(),
            first: !core::mem::replace(taken, true),
            cables: self.controller.measured(),
        })
    }

    /// Whether the state is due: ten times a second and at every change.
    #[must_use]
    pub(crate) fn status_is_due(&self) -> bool {
        self.status_in == 0 || self.controller.state() != self.reported_state
    }

    /// The state, when it is due.
    pub fn take_status(&mut self, counters: &LinkCounters) -> Option<Status> {
        if !self.status_is_due() {
            return None;
        }
        self.status_in = STATUS_TICKS;
        self.reported_state = self.controller.state();
        let status = self.status(counters);
        // A warning that lasts is set again in the next tick; one that was short has been reported
        // once.
        self.controller.forget_limits();
        Some(status)
    }

    /// The state now.
    #[must_use]
    pub fn status(&self, counters: &LinkCounters) -> Status {
        let mut status = self.controller.status();
        self.add_counters(&mut status, counters);
        status
    }

    /// In place: a state is large.
    fn add_counters(&self, status: &mut Status, counters: &LinkCounters) {
        status.frames_ok = counters.frames_ok;
        status.frames_bad = counters.frames_bad;
        status.telemetry_dropped = counters.telemetry_dropped;
        status.sequence_errors = self.sequence_errors;
    }

    /// The reply to a damaged frame, so that the host need not wait for its timeout (L1, L3).
    #[must_use]
    pub fn complain(&self) -> Option<Answer> {
        // Without a session nobody waits for a number.
        self.session.map(|_| Answer {
            sequence: self.expected,
            result: Err(Reject::Sequence {
                expected: self.expected,
            }),
        })
    }

    /// Executes a stop before everything that waits; when the same stop's turn comes, it is
    /// answered.
    pub fn stop(&mut self, now: Tick, kind: StopKind) {
        self.stopped_at = Some(now);
        // It cannot be refused.
        let _ = self.controller.handle(now, &Request::Stop(kind));
    }

    /// The next received message was sent before a stop that has been executed: in this tick
    /// nothing may start (K10).
    pub(crate) const fn outrun(&mut self, now: Tick) {
        self.stopped_at = Some(now);
    }

    /// Executes a command, or returns the reason for its refusal.
    pub fn receive(&mut self, now: Tick, command: &Command, counters: &LinkCounters) -> Answer {
        let mut result = self.dispatch(now, command);
        match &mut result {
            Ok(Reply::Info(info)) => info.simulated = self.simulated,
            Ok(Reply::Status(status)) => self.add_counters(status, counters),
            _ => {}
        }
        Answer {
            sequence: command.sequence,
            result,
        }
    }

    /// Does a slice of a command that takes longer than a control tick; returns whether
    /// [`Self::receive`] can execute it now. Until then the same command must be given again in the
    /// next tick, before any other.
    pub fn prepare(&mut self, command: &Command) -> bool {
        match command.request {
            Request::ConfigCommit { hash }
                if self.session == Some(command.session) && command.sequence == self.expected =>
            {
                self.controller.prepare(hash)
            }
            _ => true,
        }
    }

    fn dispatch(&mut self, now: Tick, command: &Command) -> Result<Reply, Reject> {
        match &command.request {
            // Reading needs no session: a second host may look on (L14).
            Request::Info | Request::Status | Request::Winch { .. } | Request::Kept => {
                self.controller.handle(now, &command.request)
            }
            // Neither does a stop: whoever sees a danger may stop the robot.
            Request::Stop(_) => {
                self.stopped_at = Some(now);
                self.controller.handle(now, &command.request)
            }
            Request::Open => self.open(now, command),
            // Its answer was lost: it gets the same answer again (L4).
            Request::Close if self.closed == Some((command.session, command.sequence)) => {
                self.sequence_errors = self.sequence_errors.wrapping_add(1);
                Ok(Reply::Done)
            }
            _ if self.session != Some(command.session) => Err(Reject::NoSession),
            Request::Heartbeat { .. } => self.controller.handle(now, &command.request),
            _ => self.in_order(now, command),
        }
    }

    fn open(&mut self, now: Tick, command: &Command) -> Result<Reply, Reject> {
        // 0 is not a session (docs/protocol.md).
        if command.session == SessionId(0) {
            return Err(Reject::NoSession);
        }
        // Its answer was lost: opening again changes nothing (L4).
        if self.session == Some(command.session) {
            return Ok(Reply::Done);
        }
        // A host that has been silent for 100 ms has lost its claim, unless the robot is armed.
        let alive = self.controller.link_health(now) < LinkHealth::Lost;
        if self.session.is_some() && alive {
            return Err(Reject::SessionHeld);
        }
        let reply = self.controller.handle(now, &command.request)?;
        self.session = Some(command.session);
        self.closed = None;
        self.expected = command.sequence.next();
        // Numbers of the old session must not be answered with its outcomes.
        self.outcomes = [None; WINDOW as usize];
        self.sampling = None;
        Ok(reply)
    }

    fn in_order(&mut self, now: Tick, command: &Command) -> Result<Reply, Reject> {
        let ahead = command.sequence.since(self.expected);
        if ahead != 0 {
            self.sequence_errors = self.sequence_errors.wrapping_add(1);
            let known = self.outcomes.iter().flatten();
            // A repeated request within the window gets its first outcome and is not executed
            // again.
            let mut known = known.filter(|(number, _)| *number == command.sequence);
            return match known.next() {
                Some((_, outcome)) if ahead < 0 => outcome.result(),
                _ => Err(Reject::Sequence {
                    expected: self.expected,
                }),
            };
        }
        // Before execution, refused or not: a refusal consumes the number, too.
        self.expected = self.expected.next();
        let result = self.execute(now, command);
        let slot = usize::from(command.sequence.0 % WINDOW);
        if let Some(slot) = self.outcomes.get_mut(slot) {
            *slot = Some((command.sequence, Outcome::of(&result)));
        }
        result
    }

    fn execute(&mut self, now: Tick, command: &Command) -> Result<Reply, Reject> {
        let request = &command.request;
        let starts = matches!(
            request,
            Request::Arm { .. } | Request::Service { .. } | Request::Start | Request::Resume
        );
        // Stop and start of one tick may come in any order on the line: the stop wins (K10).
        if starts && self.stopped_at == Some(now) {
            let state = self.controller.state();
            return Err(Reject::WrongState { state });
        }
        match request {
            Request::Samples { enabled } => {
                // The first row is marked, so that the packing half discards an unfinished block.
                self.sampling = enabled.then_some(false);
                Ok(Reply::Done)
            }
            Request::Close => {
                let reply = self.controller.handle(now, request)?;
                let closed = self.session.take();
                // Kept for a host that repeats the request because its answer was lost.
                self.closed = closed.map(|session| (session, command.sequence));
                self.sampling = None;
                Ok(reply)
            }
            _ => self.controller.handle(now, request),
        }
    }
}

/// Result of a byte.
#[derive(Debug, Clone, PartialEq, Eq)]
#[expect(clippy::large_enum_variant, reason = "no allocation on the board")]
pub enum Incoming {
    /// A host asks for the board's identity.
    HelloQuery,
    /// A command.
    Command(Command),
    /// A frame was damaged.
    Damaged(FrameError),
}

/// As [`Incoming`], after a command was handed on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Arrived {
    /// A host asks for the board's identity.
    HelloQuery,
    /// A command.
    Command,
    /// A frame was damaged.
    Damaged(FrameError),
}

/// Decodes bytes into commands.
#[derive(Debug, Default)]
pub struct Receiver {
    deframer: Deframer,
    /// Frames counted here; the link adds those that it drops.
    pub counters: LinkCounters,
}

impl Receiver {
    /// Takes one byte.
    pub fn push(&mut self, byte: u8) -> Option<Incoming> {
        let mut command = None;
        let arrived = self.push_into(byte, |whole| command = Some(whole))?;
        Some(match arrived {
            Arrived::HelloQuery => Incoming::HelloQuery,
            Arrived::Command => Incoming::Command(command?),
            Arrived::Damaged(error) => Incoming::Damaged(error),
        })
    }

    /// Takes one byte; passes a command straight to `take`. A command is large: it should not be
    /// copied to the stack by every caller.
    #[inline]
    pub(crate) fn push_into(&mut self, byte: u8, take: impl FnOnce(Command)) -> Option<Arrived> {
        let arrived = match self.deframer.push(byte)? {
            Ok((Channel::HelloQuery, _)) => Arrived::HelloQuery,
            Ok((Channel::Command, body)) => match mcdpr_protocol::message::decode_command(body) {
                Some(command) => {
                    take(command);
                    Arrived::Command
                }
                None => Arrived::Damaged(FrameError::Malformed),
            },
            // Frames of the other direction: an echo, or swapped wires.
            Ok(_) => Arrived::Damaged(FrameError::UnknownChannel),
            Err(error) => Arrived::Damaged(error),
        };
        let counter = match arrived {
            Arrived::Damaged(_) => &mut self.counters.frames_bad,
            _ => &mut self.counters.frames_ok,
        };
        *counter = counter.wrapping_add(1);
        Some(arrived)
    }
}
