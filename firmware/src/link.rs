//! Both halves of the link below the tick: bytes to commands, answers and telemetry to bytes.
//!
//! On the chip they run in thread mode and the tick preempts them, so they communicate through
//! queues with one producer and one consumer, or through atomics. A simulated board runs the same
//! code before and after its tick. Answers go before state, state before samples. If the line is
//! slower than the tick, samples are dropped and counted; the tick never waits.

use crate::io::{Line, RING};
use crate::sampler::{Row, Sampler};
use crate::server::{Arrived, LinkCounters, Receiver};
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use heapless::spsc::{Consumer, Producer, Queue};
use mcdpr_protocol::frame::{MAX_FRAME, encode_bytes};
use mcdpr_protocol::message::{encode_answer, encode_status};
use mcdpr_protocol::{Answer, Channel, Command, Hello, SampleBlock, Status};

/// Data shared by tick and link besides the queues.
#[derive(Debug, Default)]
pub struct LinkState {
    frames_ok: AtomicU32,
    frames_bad: AtomicU32,
    telemetry_dropped: AtomicU32,
    /// A damaged frame arrived: the core should report which number it waits for.
    damaged: AtomicBool,
    /// A host asked for the board's identity.
    hello_due: AtomicBool,
}

impl LinkState {
    /// Initial state.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            frames_ok: AtomicU32::new(0),
            frames_bad: AtomicU32::new(0),
            telemetry_dropped: AtomicU32::new(0),
            damaged: AtomicBool::new(false),
            hello_due: AtomicBool::new(false),
        }
    }

    /// The counts so far.
    #[must_use]
    pub fn counters(&self) -> LinkCounters {
        LinkCounters {
            frames_ok: self.frames_ok.load(Ordering::Relaxed),
            frames_bad: self.frames_bad.load(Ordering::Relaxed),
            telemetry_dropped: self.telemetry_dropped.load(Ordering::Relaxed),
        }
    }

    /// Samples were dropped.
    pub(crate) fn drop_telemetry(&self) {
        self.telemetry_dropped.fetch_add(1, Ordering::Relaxed);
    }

    /// Whether a damaged frame arrived that was not answered.
    pub(crate) fn is_damaged(&self) -> bool {
        self.damaged.load(Ordering::Relaxed)
    }

    /// Whether a damaged frame arrived since the last call.
    pub(crate) fn take_damaged(&self) -> bool {
        self.damaged.swap(false, Ordering::Relaxed)
    }
}

/// A command, and where on the line it ended.
#[derive(Debug)]
pub struct Waiting {
    /// The command.
    pub command: Command,
    /// Number of the byte after its frame; see [`Line`].
    pub at: u32,
}

/// The queues between tick and link. One place of each is always empty.
#[derive(Debug)]
pub struct Queues<const N: usize> {
    commands: Queue<Waiting, 3>,
    answers: Queue<Answer, 3>,
    states: Queue<Status, 2>,
    rows: Queue<Row<N>, 5>,
}

impl<const N: usize> Default for Queues<N> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const N: usize> Queues<N> {
    /// Empty queues.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            commands: Queue::new(),
            answers: Queue::new(),
            states: Queue::new(),
            rows: Queue::new(),
        }
    }

    /// Their ends, the tick's and the link's.
    pub fn split<'a>(&'a mut self, state: &'a LinkState) -> (TickEnds<'a, N>, LinkEnds<'a, N>) {
        let (to_tick, commands) = self.commands.split();
        let (answers, from_tick) = self.answers.split();
        let (states, states_out) = self.states.split();
        let (rows, rows_out) = self.rows.split();
        let tick = TickEnds {
            commands,
            answers,
            states,
            rows,
            state,
        };
        let link = LinkEnds {
            commands: to_tick,
            outgoing: OutgoingEnds {
                answers: from_tick,
                states: states_out,
                rows: rows_out,
                state,
            },
            state,
        };
        (tick, link)
    }
}

/// The tick's ends of the queues.
pub struct TickEnds<'a, const N: usize> {
    /// The host's requests.
    pub(crate) commands: Consumer<'a, Waiting>,
    /// Their outcomes.
    pub(crate) answers: Producer<'a, Answer>,
    /// State, sent without a request.
    pub(crate) states: Producer<'a, Status>,
    /// Samples of the ticks, sent without a request.
    pub(crate) rows: Producer<'a, Row<N>>,
    /// Counters.
    pub(crate) state: &'a LinkState,
}

/// The link's ends of the queues.
pub struct LinkEnds<'a, const N: usize> {
    /// Filled by the receiving half.
    pub commands: Producer<'a, Waiting>,
    /// Emptied by the sending half.
    pub outgoing: OutgoingEnds<'a, N>,
    /// Counters.
    pub state: &'a LinkState,
}

/// The queues that the sending half empties.
pub struct OutgoingEnds<'a, const N: usize> {
    answers: Consumer<'a, Answer>,
    states: Consumer<'a, Status>,
    rows: Consumer<'a, Row<N>>,
    state: &'a LinkState,
}

/// The receiving half.
#[derive(Debug, Default)]
pub struct Incoming {
    receiver: Receiver,
    /// Number of the next byte to be taken.
    next: u32,
}

impl Incoming {
    /// Decodes the received bytes into commands, as long as there is room for one. Bytes wait on
    /// the line while the tick is behind. Returns `false` if bytes were lost because they arrived
    /// faster than they were taken: then all bytes not taken are dropped.
    pub fn receive(
        &mut self,
        line: &mut impl Line,
        commands: &mut Producer<'_, Waiting>,
        state: &LinkState,
    ) -> bool {
        let arrived = line.arrived();
        // The ring keeps 512 bytes: beyond that the oldest are overwritten, and frames would be
        // mixed.
        let kept_up = (arrived.wrapping_sub(self.next) as usize) < RING;
        if !kept_up {
            self.next = arrived;
        }
        // Room was checked first, and there is no other producer.
        while commands.ready() && self.next != arrived {
            let byte = line.byte(self.next);
            self.next = self.next.wrapping_add(1);
            let at = self.next;
            let came = self.receiver.push_into(byte, |command| {
                let _ = commands.enqueue(Waiting { command, at });
            });
            match came {
                None => continue,
                Some(Arrived::HelloQuery) => state.hello_due.store(true, Ordering::Relaxed),
                Some(Arrived::Damaged(_)) => state.damaged.store(true, Ordering::Relaxed),
                Some(Arrived::Command) => {}
            }
            let counters = &self.receiver.counters;
            state.frames_ok.store(counters.frames_ok, Ordering::Relaxed);
            state
                .frames_bad
                .store(counters.frames_bad, Ordering::Relaxed);
        }
        kept_up
    }
}

/// The sending half.
#[derive(Debug)]
pub struct Outgoing<const N: usize> {
    hello: Hello,
    sampler: Sampler<N>,
    /// Full, and not sent yet.
    block: Option<SampleBlock>,
}

impl<const N: usize> Outgoing<N> {
    /// With this greeting.
    #[must_use]
    pub fn new(hello: Hello) -> Self {
        Self {
            hello,
            sampler: Sampler::default(),
            block: None,
        }
    }

    /// Packs the samples of the ticks; if the line is too slow, whole blocks are dropped.
    pub fn pack(&mut self, ends: &mut OutgoingEnds<'_, N>) {
        while let Some(row) = ends.rows.dequeue() {
            let Some(block) = self.sampler.push(&row) else {
                continue;
            };
            // A whole block is dropped: blocks stay consecutive inside, and the host sees the gap
            // by its tick.
            if self.block.is_some() {
                ends.state.drop_telemetry();
            } else {
                self.block = Some(block);
            }
        }
    }

    /// Encodes the most urgent message; returns its size, or 0 if there is none.
    pub fn next(&mut self, ends: &mut OutgoingEnds<'_, N>, frame: &mut [u8; MAX_FRAME]) -> usize {
        // Short answers first: a host waits for them, while telemetry only fills the line.
        let used = if ends.state.hello_due.swap(false, Ordering::Relaxed) {
            encode_bytes(Channel::Hello, &self.hello.to_bytes(), frame)
        } else if let Some(answer) = ends.answers.peek() {
            let used = encode_answer(answer, frame);
            ends.answers.dequeue();
            used
        } else if let Some(status) = ends.states.peek() {
            let used = encode_status(status, frame);
            ends.states.dequeue();
            used
        } else if let Some(block) = &self.block {
            let used = block.encode(frame);
            self.block = None;
            used
        } else {
            Ok(0)
        };
        // Every message fits a frame: the protocol crate asserts it at compile time.
        used.unwrap_or(0)
    }
}
