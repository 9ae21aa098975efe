//! The host's half of the protocol: handshake, requests with retransmission, heartbeat, telemetry.
//!
//! One thread, one loop: [`Client::pump`] feeds the board, so the heartbeat stops when the feeding
//! stops, as it should. The loop reads only the link's clock.

pub(crate) mod aside;
mod asked;
mod recent;
mod upkeep;
mod wire;

pub use recent::Row;
pub(crate) use recent::unpacked;

use super::Link;
use super::clock::BoardClock;
use super::error::ClientError;
use super::receiver::{Message, Receiver};
use crate::control::Handle;
use crate::faults::request_name;
use mcdpr_protocol::{
    BoardState, Compatibility, Hello, Info, Reject, Reply, Request, SampleBlock, SequenceNumber,
    SessionId, Status, StopKind, WINDOW,
};
use std::collections::VecDeque;

/// Time between heartbeats, µs: a board warns at 20 ms and stops at 100 ms.
/// One may be lost without a warning, eleven in a row without a stop.
const HEARTBEAT_US: u64 = 8_000;
/// A request without an answer is sent again after this, µs.
const RETRY_US: u64 = 30_000;
/// A board that leaves a request unanswered for this long is lost, µs.
/// A board without heartbeats closes its brakes after 2.1 s.
const GIVE_UP_US: u64 = 1_500_000;
/// The same for arming: several boards prove their fault line first, half a second for each of eight at most.
const ARM_US: u64 = 6_000_000;
/// Time to wait for another session to end: a board keeps the session of a dead host for two
/// seconds, µs.
const CLAIM_US: u64 = 6_000_000;

/// What a board sends without being asked.
#[derive(Debug, Clone, PartialEq)]
pub enum Event {
    /// Samples of some ticks.
    Samples(SampleBlock),
    /// Its state.
    Status(Status),
}

/// The contents of the last answer to a heartbeat.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Beat {
    /// The board's tick.
    pub tick: u32,
    /// The board's state.
    pub state: BoardState,
    /// Path time, ms.
    pub path_ms: u32,
    /// Free knots.
    pub knots_free: u8,
    /// The number that the next knot must have.
    pub next_knot: u16,
    /// When the heartbeat was sent, link time, µs: the answer is no older than this.
    pub sent_us: u64,
    /// Time from sending the heartbeat to its answer, µs.
    pub round_trip_us: u64,
}

struct Pending {
    sequence: SequenceNumber,
    request: Request,
    sent_us: u64,
    first_us: u64,
    result: Option<Result<Reply, Reject>>,
}

/// Refuses a board of another version.
///
/// # Errors
/// [`ClientError::Version`].
pub(crate) fn check(hello: &Hello) -> Result<(), ClientError> {
    // Before anything else: another version may understand every later message differently
    // (L17).
    match hello.compatibility() {
        Compatibility::Full => {}
        other => {
            return Err(ClientError::Version {
                board_major: hello.major,
                board_minor: hello.minor,
                remedy: if other == Compatibility::BoardOlder {
                    "flash this program's firmware: `cargo flash-fw`"
                } else {
                    "update this program to the board's version, or flash this program's firmware: `cargo flash-fw`"
                },
            });
        }
    }
    Ok(())
}

/// A connection to one board.
pub struct Client<L: Link> {
    link: L,
    hello: Hello,
    info: Info,
    session: SessionId,
    next: SequenceNumber,
    pending: VecDeque<Pending>,
    done: VecDeque<(Request, Result<Reply, Reject>)>,
    receiver: Receiver,
    heartbeat_us: Option<u64>,
    beat: Option<Beat>,
    clock: BoardClock,
    status: Option<Status>,
    events: VecDeque<Event>,
    recent: recent::Recent,
    resent_us: u64,
    retransmissions: u64,
    handle: Handle,
    /// When a frame of the board last arrived, and when this loop last ran, µs.
    heard_us: u64,
    looped_us: u64,
    /// Requests besides the sequence, with their outcomes.
    asides: Vec<aside::Aside>,
    aside_count: u16,
    replies: VecDeque<(Request, Result<Reply, Reject>)>,
    /// Heartbeats are sent at varying times within a tick of the board; how many were.
    spread: Option<u64>,
}

impl<L: Link> Client<L> {
    /// Finds the board, checks its version and claims it for this session.
    ///
    /// # Errors
    /// [`ClientError::Silent`], [`ClientError::Version`], [`ClientError::Refused`] where another
    /// host holds the board, or the link's errors. Nothing has moved then.
    pub fn connect(mut link: L, session: SessionId) -> Result<Self, ClientError> {
        let mut receiver = Receiver::default();
        let hello = wire::find(&mut link, &mut receiver)?;
        check(&hello)?;
        let mut client = Self::idle(link, session, hello);
        client.info = client.ask_info()?;
        client.claim()?;
        Ok(client)
    }

    /// A client of the board that said this hello, which it has not claimed yet.
    pub(crate) fn idle(link: L, session: SessionId, hello: Hello) -> Self {
        let mut client = Self {
            link,
            hello,
            info: Info {
                cables: 0,
                knot_capacity: 0,
                ticks_per_second: 1000,
                drive_kinds: 0,
                simulated: false,
                last_panic: mcdpr_protocol::List::new(),
            },
            session,
            next: SequenceNumber(0),
            pending: VecDeque::new(),
            done: VecDeque::new(),
            receiver: Receiver::default(),
            heartbeat_us: None,
            beat: None,
            clock: BoardClock::default(),
            status: None,
            events: VecDeque::new(),
            recent: recent::Recent::default(),
            resent_us: 0,
            retransmissions: 0,
            handle: Handle::new(),
            heard_us: 0,
            looped_us: 0,
            asides: Vec::new(),
            aside_count: 0,
            replies: VecDeque::new(),
            spread: None,
        };
        // Silence counts from now on, not from the link's zero.
        (client.heard_us, client.looped_us) = (client.link.now_us(), client.link.now_us());
        client
    }

    fn claim(&mut self) -> Result<(), ClientError> {
        let give_up = self.link.now_us() + CLAIM_US;
        loop {
            match self.request(Request::Open) {
                Ok(_) => break,
                Err(ClientError::Refused {
                    reject: Reject::SessionHeld,
                    ..
                }) if self.link.now_us() < give_up => {
                    let pause = self.link.now_us() + 100_000;
                    self.pump(pause)?;
                }
                Err(error) => return Err(error),
            }
        }
        self.claimed();
        Ok(())
    }

    /// Takes orders from this handle from now on, and shows its observers what the board says.
    pub fn obey(&mut self, handle: Handle) {
        self.handle = handle;
    }

    /// The handle that gives orders to the user of this client.
    pub const fn handle(&self) -> &Handle {
        &self.handle
    }

    /// The board's identity.
    pub const fn hello(&self) -> &Hello {
        &self.hello
    }

    /// The board's properties.
    pub const fn info(&self) -> &Info {
        &self.info
    }

    /// The last status, if one came.
    pub const fn status(&self) -> Option<&Status> {
        self.status.as_ref()
    }

    /// The contents of the last answer to a heartbeat.
    pub const fn beat(&self) -> Option<Beat> {
        self.beat
    }

    /// The board's clock, estimated from its answers to heartbeats.
    pub const fn clock(&self) -> &BoardClock {
        &self.clock
    }

    /// Path time of the motion in progress by the board's clock now, s: the value in the last
    /// answer to a heartbeat, plus the time that has passed on the board since. `None` before the
    /// first answer.
    pub fn path_s(&self) -> Option<f64> {
        let beat = self.beat?;
        let since_ms = match beat.state {
            BoardState::Moving => self.clock.ticks_since(beat.tick, self.link.now_us()),
            _ => 0.0,
        };
        Some((f64::from(beat.path_ms) + since_ms) * 1e-3)
    }

    /// The link's time, µs.
    pub fn now_us(&self) -> u64 {
        self.link.now_us()
    }

    /// Frames that were sent again, and frames that arrived damaged.
    pub const fn link_errors(&self) -> (u64, u64) {
        (self.retransmissions, self.receiver.frames_bad)
    }

    /// Requests in progress.
    pub(crate) fn in_flight(&self) -> usize {
        self.pending.len()
    }

    /// Whether another sequenced request may be sent now.
    pub fn has_room(&self) -> bool {
        self.pending.len() < usize::from(WINDOW)
    }

    /// The next message that the board sent without being asked.
    pub fn next_event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    /// What the board has measured in the last eight seconds, tick by tick.
    pub fn recent(&self) -> Vec<Row> {
        self.recent.rows()
    }

    /// The next outcome of a request sent by [`Client::enqueue`].
    pub(crate) fn next_outcome(&mut self) -> Option<(Request, Result<Reply, Reject>)> {
        self.done.pop_front()
    }

    /// Sends a request and waits for its outcome; everything else goes on meanwhile.
    ///
    /// # Errors
    /// [`ClientError::Refused`] where the board refuses it.
    pub fn request(&mut self, request: Request) -> Result<Reply, ClientError> {
        let name = request_name(&request);
        if !request.is_sequenced() {
            return self.ask(request);
        }
        while !self.has_room() {
            self.step()?;
        }
        let number = self.enqueue(request)?;
        loop {
            // Earlier outcomes stay in order for their own readers.
            if self
                .pending
                .front()
                .is_none_or(|first| first.sequence.since(number) > 0)
                && let Some((_, result)) = self.done.pop_back()
            {
                return result.map_err(|reject| ClientError::Refused {
                    request: name,
                    reject,
                });
            }
            self.step()?;
        }
    }

    /// Sends a sequenced request without waiting; its outcome comes by `Client::next_outcome`.
    /// Call only while [`Client::has_room`].
    ///
    /// # Errors
    /// The link's.
    pub fn enqueue(&mut self, request: Request) -> Result<SequenceNumber, ClientError> {
        let sequence = self.next;
        self.next = sequence.next();
        let now = self.link.now_us();
        self.transmit(sequence, &request)?;
        self.pending.push_back(Pending {
            sequence,
            request,
            sent_us: now,
            first_us: now,
            result: None,
        });
        Ok(sequence)
    }

    /// Asks to stop: sent before all other requests, and repeated until it is confirmed.
    ///
    /// # Errors
    /// The link's, or [`ClientError::Lost`].
    pub fn stop(&mut self, kind: StopKind) -> Result<(), ClientError> {
        self.ask(Request::Stop(kind)).map(|_| ())
    }

    /// An idempotent request: sent again until it is answered.
    fn ask(&mut self, request: Request) -> Result<Reply, ClientError> {
        let name = request_name(&request);
        // Opening sets the first number of the sequence. Other numbers only distinguish answers.
        let sequence = match request {
            Request::Open => {
                let first = self.next;
                self.next = first.next();
                first
            }
            _ => self.number_beside(),
        };
        let give_up = self.link.now_us() + GIVE_UP_US;
        loop {
            self.transmit(sequence, &request)?;
            let retry = self.link.now_us() + RETRY_US;
            while self.link.now_us() < retry {
                for message in self.receiver.take(&mut self.link, retry)? {
                    match message {
                        Message::Answer(answer) if answer.sequence == sequence => {
                            return answer.result.map_err(|reject| ClientError::Refused {
                                request: name,
                                reject,
                            });
                        }
                        other => self.accept(other)?,
                    }
                }
                self.upkeep()?;
            }
            if self.link.now_us() >= give_up {
                return Err(ClientError::Lost { waiting: name });
            }
        }
    }

    /// Keeps the connection alive and handles what arrives, until `until_us`.
    ///
    /// # Errors
    /// The link's, or [`ClientError::Lost`].
    pub fn pump(&mut self, until_us: u64) -> Result<(), ClientError> {
        loop {
            self.upkeep()?;
            let due = self.next_due_us().min(until_us);
            for message in self.receiver.take(&mut self.link, due)? {
                self.accept(message)?;
            }
            if self.link.now_us() >= until_us {
                return Ok(());
            }
        }
    }

    /// Like [`Client::pump`], but returns as soon as something arrived or is due.
    ///
    /// # Errors
    /// The link's, or [`ClientError::Lost`].
    pub fn step(&mut self) -> Result<(), ClientError> {
        self.upkeep()?;
        let due = self.next_due_us();
        for message in self.receiver.take(&mut self.link, due)? {
            self.accept(message)?;
        }
        Ok(())
    }

    /// Passes what the host knows to the observers of the line.
    pub fn note(&mut self, note: super::Note<'_>) {
        self.link.note(note);
    }

    /// Whether the link's time runs while no call waits on it ([`Link::goes_on`]).
    pub fn goes_on(&self) -> bool {
        self.link.goes_on()
    }

    /// Returns the line.
    pub fn into_link(self) -> L {
        self.link
    }
}
