//! The link: bytes to commands, answers and telemetry to bytes. Two tasks of embassy's executor in
//! thread mode, `receive` and `send`; each takes a turn after every interrupt, so at least once per
//! tick.
//!
//! Everything between them and the tick goes through queues with one producer and one consumer,
//! or through atomics. Answers go before state, state before samples. Where the line is slower
//! than the tick, samples are dropped and counted; the tick never waits.

use crate::fatal;
use crate::life::{self, Keeper, Part};
use crate::pins::CABLES;
use crate::uart::{self, Ring, Sender};
use core::future::poll_fn;
use core::ptr;
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use core::task::Poll;
use embassy_executor::raw::Executor;
use heapless::spsc::{Consumer, Producer, Queue};
use mcdpr_firmware::sampler::{Row, Sampler};
use mcdpr_firmware::server::{Arrived, LinkCounters, Receiver};
use mcdpr_protocol::frame::{MAX_FRAME, encode_bytes};
use mcdpr_protocol::message::{encode_answer, encode_status};
use mcdpr_protocol::{Answer, Channel, Command, Hello, SampleBlock, Status, Tick};
use static_cell::StaticCell;

/// The tick's ends of the queues.
pub struct TickEnds {
    /// What the host asks.
    pub commands: Consumer<'static, Command>,
    /// What became of it.
    pub answers: Producer<'static, Answer>,
    /// State, unasked.
    pub states: Producer<'static, Status>,
    /// What the ticks measured, unasked.
    pub rows: Producer<'static, Row<CABLES>>,
}

/// The link's ends of the queues.
pub struct LinkEnds {
    commands: Producer<'static, Command>,
    answers: Consumer<'static, Answer>,
    states: Consumer<'static, Status>,
    rows: Consumer<'static, Row<CABLES>>,
}

/// Makes the queues, once. One place of each is always empty.
pub fn queues() -> (TickEnds, LinkEnds) {
    static COMMANDS: StaticCell<Queue<Command, 3>> = StaticCell::new();
    static ANSWERS: StaticCell<Queue<Answer, 3>> = StaticCell::new();
    static STATES: StaticCell<Queue<Status, 2>> = StaticCell::new();
    static ROWS: StaticCell<Queue<Row<CABLES>, 5>> = StaticCell::new();
    let (to_tick, commands) = COMMANDS.init_with(Queue::new).split();
    let (answers, from_tick) = ANSWERS.init_with(Queue::new).split();
    let (states, states_out) = STATES.init_with(Queue::new).split();
    let (rows, rows_out) = ROWS.init_with(Queue::new).split();
    let for_tick = TickEnds {
        commands,
        answers,
        states,
        rows,
    };
    let for_link = LinkEnds {
        commands: to_tick,
        answers: from_tick,
        states: states_out,
        rows: rows_out,
    };
    (for_tick, for_link)
}

static FRAMES_OK: AtomicU32 = AtomicU32::new(0);
static FRAMES_BAD: AtomicU32 = AtomicU32::new(0);
static TELEMETRY_DROPPED: AtomicU32 = AtomicU32::new(0);
/// Damaged bytes that the tick does not know of yet.
static LINE_ERRORS: AtomicU32 = AtomicU32::new(0);
/// A damaged frame came: the core should say which number it waits for.
static DAMAGED: AtomicBool = AtomicBool::new(false);
/// Someone asked who this is.
static HELLO_DUE: AtomicBool = AtomicBool::new(false);

/// What was counted so far.
pub fn counters() -> LinkCounters {
    LinkCounters {
        frames_ok: FRAMES_OK.load(Ordering::Relaxed),
        frames_bad: FRAMES_BAD.load(Ordering::Relaxed),
        telemetry_dropped: TELEMETRY_DROPPED.load(Ordering::Relaxed),
    }
}

/// Samples found no room.
pub fn drop_telemetry() {
    TELEMETRY_DROPPED.fetch_add(1, Ordering::Relaxed);
}

/// Whether a damaged frame came that was not told of.
pub fn is_damaged() -> bool {
    DAMAGED.load(Ordering::Relaxed)
}

/// Whether a damaged frame came since the last call.
pub fn take_damaged() -> bool {
    DAMAGED.swap(false, Ordering::Relaxed)
}

/// Bytes without a stop bit, with noise, or overrun since the last call.
pub fn take_line_errors() -> u16 {
    u16::try_from(LINE_ERRORS.swap(0, Ordering::Relaxed)).unwrap_or(u16::MAX)
}

/// Both halves of the link, in thread mode for good.
pub fn run(incoming: &'static mut Incoming, outgoing: &'static mut Outgoing) -> ! {
    static EXECUTOR: StaticCell<Executor> = StaticCell::new();
    let executor = EXECUTOR.init_with(|| Executor::new(ptr::null_mut()));
    let (Ok(receive), Ok(send)) = (receive(incoming), send(outgoing)) else {
        fatal::stop("a task started twice")
    };
    executor.spawner().spawn(receive);
    executor.spawner().spawn(send);
    loop {
        #[allow(
            unsafe_code,
            reason = "the executor's entry, which is for its owner alone"
        )]
        // SAFETY: called here alone, not from within a task, and not by `pender`.
        unsafe {
            executor.poll();
        }
        // Whatever came since the last look has left its event: handlers end with SEV, since those
        // of this core set none (`interrupts`). Nothing is slept through.
        cortex_m::asm::wfe();
    }
}

#[embassy_executor::task]
async fn receive(incoming: &'static mut Incoming) {
    loop {
        incoming.receive();
        next_event().await;
    }
}

#[embassy_executor::task]
async fn send(outgoing: &'static mut Outgoing) {
    loop {
        outgoing.send();
        next_event().await;
    }
}

/// Ends the task's turn. Its next one comes after the next interrupt: the executor takes what is
/// woken within a pass up in the next pass.
async fn next_event() {
    let mut waited = false;
    poll_fn(|context| {
        if waited {
            return Poll::Ready(());
        }
        waited = true;
        context.waker().wake_by_ref();
        Poll::Pending
    })
    .await;
}

/// Called where a task is woken. All wake themselves, in thread mode: there is nobody to tell, and
/// the tick has no part in it.
#[allow(unsafe_code, reason = "the executor asks for it by this name")]
#[unsafe(export_name = "__pender")]
fn pender(_: *mut ()) {}

/// What receives, with all it needs.
pub struct Incoming {
    commands: Producer<'static, Command>,
    ring: Ring,
    receiver: Receiver,
    keeper: Keeper,
    line_errors: u32,
    /// Where the ring was at the last of them.
    error_at: Option<usize>,
}

/// What sends.
pub struct Outgoing {
    out: Out,
    sender: Sender,
}

/// Both halves from their parts.
pub fn open(
    ends: LinkEnds,
    sender: Sender,
    ring: Ring,
    keeper: Keeper,
    hello: Hello,
) -> (&'static mut Incoming, &'static mut Outgoing) {
    // Not on the stack: they live for good.
    static INCOMING: StaticCell<Incoming> = StaticCell::new();
    static OUTGOING: StaticCell<Outgoing> = StaticCell::new();
    let incoming = INCOMING.init_with(|| Incoming {
        commands: ends.commands,
        ring,
        receiver: Receiver::default(),
        keeper,
        line_errors: 0,
        error_at: None,
    });
    let outgoing = OUTGOING.init_with(|| Outgoing {
        out: Out {
            hello,
            answers: ends.answers,
            states: ends.states,
            rows: ends.rows,
            sampler: Sampler::default(),
            block: None,
        },
        sender,
    });
    (incoming, outgoing)
}

impl Incoming {
    /// Out of line, as is the other: the stack of one is gone before the other's comes.
    #[inline(never)]
    fn receive(&mut self) {
        life::show(Part::Receive);
        self.keeper.feed();
        if !self.ring.look(Tick(crate::tick::now())) {
            defmt::warn!("received faster than executed: bytes dropped");
        }
        // The flag falls with the next byte: until then it is the same error.
        let at = Some(self.ring.seen());
        if uart::line_error() && self.error_at != at {
            self.error_at = at;
            LINE_ERRORS.fetch_add(1, Ordering::Relaxed);
            self.line_errors = self.line_errors.wrapping_add(1);
            // One line per 256 of them: a noisy line must not fill the log, too.
            if self.line_errors % 256 == 1 {
                defmt::warn!("line errors: {=u32}", self.line_errors);
            }
        }
        // Bytes wait in the ring while the tick is behind.
        while self.commands.ready() {
            let Some(byte) = self.ring.take() else { break };
            let commands = &mut self.commands;
            // Room was just seen, and nobody else fills it.
            let arrived = self.receiver.push_into(byte, |command| {
                let _ = commands.enqueue(command);
            });
            match arrived {
                None => continue,
                Some(Arrived::HelloQuery) => HELLO_DUE.store(true, Ordering::Relaxed),
                Some(Arrived::Damaged(_)) => DAMAGED.store(true, Ordering::Relaxed),
                Some(Arrived::Command) => {}
            }
            let counters = &self.receiver.counters;
            FRAMES_OK.store(counters.frames_ok, Ordering::Relaxed);
            FRAMES_BAD.store(counters.frames_bad, Ordering::Relaxed);
        }
    }
}

impl Outgoing {
    #[inline(never)]
    fn send(&mut self) {
        life::show(Part::Send);
        self.out.pack();
        if let Some(frame) = self.sender.free() {
            let used = self.out.next(frame);
            self.sender.start(used);
        }
    }
}

/// What waits to be sent.
struct Out {
    hello: Hello,
    answers: Consumer<'static, Answer>,
    states: Consumer<'static, Status>,
    rows: Consumer<'static, Row<CABLES>>,
    sampler: Sampler<CABLES>,
    /// Full, and not sent yet.
    block: Option<SampleBlock>,
}

impl Out {
    /// Packs what the ticks measured; where the line is too slow, whole blocks are dropped.
    fn pack(&mut self) {
        while let Some(row) = self.rows.dequeue() {
            let Some(block) = self.sampler.push(&row) else {
                continue;
            };
            if self.block.is_some() {
                drop_telemetry();
            } else {
                self.block = Some(block);
            }
        }
    }

    /// Encodes the most urgent message; its size, or 0 where nothing waits.
    fn next(&mut self, frame: &mut [u8; MAX_FRAME]) -> usize {
        let used = if HELLO_DUE.swap(false, Ordering::Relaxed) {
            encode_bytes(Channel::Hello, &self.hello.to_bytes(), frame)
        } else if let Some(answer) = self.answers.peek() {
            let used = encode_answer(answer, frame);
            self.answers.dequeue();
            used
        } else if let Some(status) = self.states.peek() {
            let used = encode_status(status, frame);
            self.states.dequeue();
            used
        } else if let Some(block) = &self.block {
            let used = block.encode(frame);
            self.block = None;
            used
        } else {
            Ok(0)
        };
        // Every message fits a frame: the protocol asserts it when it is compiled.
        used.unwrap_or(0)
    }
}
