//! Several boards as one: behind a [`Link`] that speaks the protocol of a single board.
//!
//! The host's logic (sessions, plans, jogging, records, pages) speaks to one board with all cables.
//! [`Boards`] is that board: it takes the requests apart, speaks to each real board by a client of
//! its own, and joins what they say. All or none: a request is done when every board has done it,
//! and a board that stops, holds, faults or falls silent stops the others in the same way.
//!
//! The first board's ticks are the robot's clock. How motions start and stay together is in
//! `course.rs`, how the clocks are compared in `phase.rs`.

mod claim;
mod course;
mod fault_line;
mod layout;
mod motion;
mod phase;
mod port;
mod relay;
mod requests;
mod samples;
mod state;

use crate::link::aside::hello_query;
use crate::link::{Client, Event, Link, LinkError};
use crate::machine::{OutOfRange, configuration, hash_of};
use crate::robot::Robot;
use claim::Claim;
use course::Course;
use fault_line::LineProof;
use layout::Layout;
use mcdpr_protocol::frame::{MAX_FRAME, encode_bytes};
use mcdpr_protocol::message::{decode_command, encode_answer, encode_status};
use mcdpr_protocol::{
    Answer, BoardState, Channel, ConfigEntry, ConfigHash, Deframer, FaultId, Hello, Knot, Reject,
    Reply, Request, SequenceNumber, SessionId, Status,
};
use phase::Phase;
use port::Port;
use samples::Merger;
use std::collections::VecDeque;

/// The lines to several boards, with one clock.
pub trait Lines {
    /// Lines.
    fn count(&self) -> usize;
    /// Time at which the last call returned, µs. Never runs backwards.
    fn now_us(&self) -> u64;
    /// Sends bytes on one line now.
    ///
    /// # Errors
    /// The line is gone.
    fn send(&mut self, line: usize, bytes: &[u8]) -> Result<(), LinkError>;
    /// Waits until bytes have arrived on any line or until `until_us`; appends the bytes of each
    /// line to its place of `into`, and gives the time.
    ///
    /// # Errors
    /// A line is gone.
    fn receive(&mut self, until_us: u64, into: &mut [Vec<u8>]) -> Result<u64, LinkError>;
    /// What messages call a line.
    fn name(&self, line: usize) -> String;
    /// The robot's path begins at this path time of the first board, ms. Only simulated robots
    /// use it.
    fn path_begins(&mut self, _ms: u32) {}
    /// Whether its time runs while no call waits ([`Link::goes_on`]).
    fn goes_on(&self) -> bool {
        false
    }
}

/// A request of the host that waits for the boards.
#[derive(Debug)]
struct Waiting {
    sequence: SequenceNumber,
    /// Answers of boards that are still to come.
    left: usize,
    result: Result<Reply, Reject>,
    /// It is answered when all boards were seen to move.
    start: bool,
    /// It changes the boards' states.
    changes: bool,
}

/// A request of the host besides the sequence that waits for the boards.
#[derive(Debug)]
struct Asked {
    sequence: SequenceNumber,
    request: Request,
    replies: Vec<Option<Result<Reply, Reject>>>,
}

/// A request to one board that is to be sent, or was.
#[derive(Debug)]
struct Errand {
    request: Request,
    /// The host's request that it is a part of.
    of: Option<SequenceNumber>,
}

/// What is known of one board.
struct Member {
    client: Client<Port>,
    phase: Phase,
    /// When the heartbeat of the last answer that was looked at was sent, µs.
    seen_us: u64,
    todo: VecDeque<Errand>,
    issued: VecDeque<Option<SequenceNumber>>,
    /// Its state, and when it surely was: host time, µs.
    state: BoardState,
    state_us: u64,
}

/// Several boards behind one line.
pub struct Boards<L: Lines> {
    lines: L,
    /// The line of each board.
    line_of: Vec<usize>,
    layout: Layout,
    ids: Vec<Option<String>>,
    whole: (Vec<ConfigEntry>, ConfigHash),
    parts: Vec<(Vec<ConfigEntry>, ConfigHash)>,
    claim: Claim,
    members: Vec<Member>,
    deframer: Deframer,
    /// Bytes for the host.
    out: Vec<u8>,
    session: SessionId,
    expected: SequenceNumber,
    waiting: VecDeque<Waiting>,
    asked: Vec<Asked>,
    /// Knots of a motion that has not started.
    ahead: VecDeque<Knot>,
    /// Entries of a configuration that is being sent.
    entries: Vec<ConfigEntry>,
    course: Option<Course>,
    merger: Merger,
    /// Answers older than this say nothing about the state that was asked for, µs.
    since_us: u64,
    /// When the boards were last watched, and since when without a pause, µs.
    watched_us: u64,
    awake_us: u64,
    /// The last stop that was passed on because of a board, and when, µs.
    relayed: Option<(mcdpr_protocol::StopKind, u64)>,
    /// What the host was told last.
    told: Option<(BoardState, Option<mcdpr_protocol::FaultRecord>, u64)>,
    /// The board whose fault came first, and when a fault was first told, µs.
    culprit: Option<usize>,
    blamed_us: u64,
    /// The boards have a fault line, and its proof before they arm.
    fault_line: bool,
    line_proof: Option<LineProof>,
}

impl<L: Lines> Boards<L> {
    /// The boards of a robot behind these lines; `None` for a robot with one board.
    ///
    /// # Errors
    /// A value of the robot does not fit a board's configuration.
    pub fn new(robot: &Robot, lines: L) -> Result<Option<Self>, OutOfRange> {
        let Some(layout) = Layout::of(robot) else {
            return Ok(None);
        };
        let entries = configuration(robot)?;
        let parts = (0..layout.len()).map(|board| {
            let part = layout.configuration(board, &entries);
            let hash = hash_of(&part);
            (part, hash)
        });
        Ok(Some(Self {
            line_of: (0..layout.len()).collect(),
            ids: robot.boards.iter().map(|board| board.id.clone()).collect(),
            parts: parts.collect(),
            whole: (entries.clone(), hash_of(&entries)),
            merger: Merger::new(layout.len()),
            layout,
            lines,
            claim: Claim::default(),
            members: Vec::new(),
            deframer: Deframer::new(),
            out: Vec::new(),
            session: SessionId(0),
            expected: SequenceNumber(0),
            waiting: VecDeque::new(),
            asked: Vec::new(),
            ahead: VecDeque::new(),
            entries: Vec::new(),
            course: None,
            since_us: 0,
            watched_us: 0,
            awake_us: 0,
            relayed: None,
            told: None,
            culprit: None,
            blamed_us: 0,
            fault_line: robot.boards.iter().any(|board| board.fault_line),
            line_proof: None,
        }))
    }

    /// What messages call a board.
    fn name(&self, board: usize) -> String {
        let line = self.line_of.get(board).copied().unwrap_or(board);
        format!("board {} ({})", board + 1, self.lines.name(line))
    }

    /// Forgets the boards and asks who is there.
    fn ask_who(&mut self) -> Result<(), LinkError> {
        self.members.clear();
        self.waiting.clear();
        self.asked.clear();
        self.ahead.clear();
        self.course = None;
        self.line_proof = None;
        (self.relayed, self.told, self.culprit) = (None, None, None);
        self.merger = Merger::new(self.layout.len());
        self.claim = Claim::begun(self.lines.count(), self.lines.now_us());
        for line in 0..self.lines.count() {
            self.lines.send(line, &hello_query())?;
        }
        Ok(())
    }

    /// A frame of the host.
    fn hear(&mut self, channel: Channel, body: &[u8]) -> Result<(), LinkError> {
        match channel {
            Channel::HelloQuery if self.claim.is_asking() => self.ask_missing(),
            Channel::HelloQuery => self.ask_who(),
            Channel::Command => match decode_command(body) {
                Some(command) => self.command(command),
                None => Ok(()),
            },
            // Only boards send these.
            _ => Ok(()),
        }
    }

    fn answer(&mut self, sequence: SequenceNumber, result: Result<Reply, Reject>) {
        let mut frame = [0; MAX_FRAME];
        let used = encode_answer(&Answer { sequence, result }, &mut frame).unwrap_or(0);
        self.out.extend(frame.iter().take(used));
    }

    fn tell_hello(&mut self, hello: &Hello) {
        let mut frame = [0; MAX_FRAME];
        let used = encode_bytes(Channel::Hello, &hello.to_bytes(), &mut frame).unwrap_or(0);
        self.out.extend(frame.iter().take(used));
    }

    fn tell_status(&mut self, status: &Status) {
        let mut frame = [0; MAX_FRAME];
        let used = encode_status(status, &mut frame).unwrap_or(0);
        self.out.extend(frame.iter().take(used));
    }

    /// Passes bytes between lines and clients, and does all that is due now.
    fn turn(&mut self) -> Result<(), LinkError> {
        if self.claim.is_asking() {
            return Ok(());
        }
        let now_us = self.lines.now_us();
        for board in 0..self.members.len() {
            let Some(member) = self.members.get_mut(board) else {
                break;
            };
            member.client.link_mut().now_us = now_us;
            while member.client.has_room()
                && let Some(errand) = member.todo.pop_front()
            {
                member.issued.push_back(errand.of);
                let sent = member.client.enqueue(errand.request);
                sent.map_err(|error| lost(&error))?;
            }
            if let Err(error) = member.client.work() {
                return Err(self.give_up(board, &error));
            }
            self.take_from(board);
        }
        self.prove_line(now_us)?;
        self.settle_asked()?;
        self.watch(now_us)?;
        self.go_on();
        self.settle_waiting(now_us);
        self.tell(now_us);
        self.flush()
    }

    /// Gives the clients what the lines bring until a time, µs; returns with the first bytes.
    fn listen(&mut self, until_us: u64) -> Result<(), LinkError> {
        let mut arrived = vec![Vec::new(); self.lines.count()];
        let now_us = self.lines.receive(until_us, &mut arrived)?;
        if self.claim.is_asking() {
            self.hear_hellos(&mut arrived)?;
        }
        for (member, line) in self.members.iter_mut().zip(&self.line_of) {
            let port = member.client.link_mut();
            port.now_us = now_us;
            if let Some(bytes) = arrived.get_mut(*line) {
                port.inbox.append(bytes);
            }
        }
        Ok(())
    }

    /// Sends what the clients have put out.
    fn flush(&mut self) -> Result<(), LinkError> {
        for (member, line) in self.members.iter_mut().zip(&self.line_of) {
            let bytes = std::mem::take(&mut member.client.link_mut().outbox);
            if !bytes.is_empty() {
                self.lines.send(*line, &bytes)?;
            }
        }
        Ok(())
    }

    /// Outcomes and events of one board.
    fn take_from(&mut self, board: usize) {
        let Some(member) = self.members.get_mut(board) else {
            return;
        };
        while let Some((_, result)) = member.client.next_outcome() {
            let Some(Some(of)) = member.issued.pop_front() else {
                continue;
            };
            let waiting = self.waiting.iter_mut().find(|w| w.sequence == of);
            if let Some(waiting) = waiting {
                waiting.left = waiting.left.saturating_sub(1);
                // The board with the cause, not one that only sees its line.
                let follower = Reject::CauseRemains {
                    fault: FaultId::L19,
                };
                if let Err(reject) = result
                    && (waiting.result.is_ok() || waiting.result == Err(follower))
                {
                    waiting.result = Err(self.layout.reject(board, reject));
                }
            }
        }
        while let Some((request, result)) = member.client.next_reply() {
            let asked = self.asked.iter_mut().find(|asked| {
                let same =
                    std::mem::discriminant(&asked.request) == std::mem::discriminant(&request);
                same && asked.replies.get(board).is_some_and(Option::is_none)
            });
            if let Some(place) = asked.and_then(|asked| asked.replies.get_mut(board)) {
                *place = Some(result);
            }
        }
        if let Some(beat) = member.client.beat()
            && beat.sent_us != member.seen_us
        {
            member.seen_us = beat.sent_us;
            let received_us = beat.sent_us + beat.round_trip_us;
            member.phase.observe(beat.tick, beat.sent_us, received_us);
            (member.state, member.state_us) = (beat.state, beat.sent_us);
            self.see_motion(board, &beat);
        }
        let Some(member) = self.members.get_mut(board) else {
            return;
        };
        let mut faults = Vec::new();
        while let Some(event) = member.client.next_event() {
            match event {
                Event::Status(status) => {
                    if let Some(proof) = &mut self.line_proof {
                        proof.hear(board, &status);
                    }
                    faults.extend(status.fault);
                }
                Event::Samples(block) => self.merger.take(board, &member.phase, &block),
            }
        }
        for record in faults {
            self.blame(board, &record);
        }
    }

    /// When something is due besides bytes from the lines, µs.
    fn due_us(&self) -> u64 {
        let clients = self.members.iter().map(|member| member.client.due_us());
        let watch_us = self.watch_due_us();
        let proof_us = self.line_proof.as_ref().map_or(u64::MAX, LineProof::due_us);
        clients
            .min()
            .unwrap_or(u64::MAX)
            .min(watch_us)
            .min(proof_us)
    }
}

impl<L: Lines> Link for Boards<L> {
    fn now_us(&self) -> u64 {
        self.lines.now_us()
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        let mut frames = Vec::new();
        for &byte in bytes {
            if let Some(Ok((channel, body))) = self.deframer.push(byte) {
                frames.push((channel, body.to_vec()));
            }
        }
        for (channel, body) in frames {
            self.hear(channel, &body)?;
        }
        // The host may have done something else for a while. What arrived meanwhile is heard before a client judges its
        // board by the time: on a serial line an answer waits until it is read.
        self.listen(self.lines.now_us())?;
        self.turn()
    }

    fn receive(&mut self, until_us: u64, into: &mut Vec<u8>) -> Result<u64, LinkError> {
        loop {
            if !self.out.is_empty() {
                into.append(&mut self.out);
                return Ok(self.lines.now_us());
            }
            let now_us = self.lines.now_us();
            if now_us >= until_us {
                return Ok(now_us);
            }
            // A heartbeat that is due now was sent by the turn before: time must pass.
            let due_us = self.due_us().max(now_us + 1);
            self.listen(until_us.min(due_us))?;
            self.turn()?;
        }
    }

    fn goes_on(&self) -> bool {
        self.lines.goes_on()
    }
}

fn lost_line(what: String) -> LinkError {
    LinkError::Boards {
        what: format!("{what}; nothing was moved"),
        help:
            "check the fault line's plugs, supply and transistors (docs/wiring.md, several boards)"
                .into(),
    }
}

fn lost(error: &crate::link::ClientError) -> LinkError {
    LinkError::Boards {
        what: error.to_string(),
        help: "check power and line of every board, then connect again".into(),
    }
}
