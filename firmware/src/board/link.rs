//! The link: bytes to commands, answers and telemetry to bytes. Two tasks in thread mode.
//!
//! Everything between them and the tick goes through queues with one producer and one consumer,
//! or through atomics. Answers go before state, state before samples. Where the line is slower
//! than the tick, samples are dropped and counted; the tick never waits.

use crate::life::{self, Keeper, Part};
use crate::uart::{self, Ring, Sender};
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use embassy_executor::Spawner;
use embassy_stm32::Peri;
use embassy_stm32::peripherals::IWDG;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use heapless::spsc::{Consumer, Producer, Queue};
use mcdpr_firmware::server::{Incoming, LinkCounters, Receiver};
use mcdpr_protocol::frame::{MAX_FRAME, encode_bytes};
use mcdpr_protocol::{Answer, Channel, Command, Hello, SampleBlock, Status, Tick, encode_frame};
use static_cell::StaticCell;

/// The tick's ends of the queues.
pub struct TickEnds {
    /// What the host asks.
    pub commands: Consumer<'static, Command>,
    /// What became of it.
    pub answers: Producer<'static, Answer>,
    /// State, unasked.
    pub states: Producer<'static, Status>,
    /// Samples, unasked.
    pub samples: Producer<'static, SampleBlock>,
}

/// The link's ends of the queues.
pub struct LinkEnds {
    commands: Producer<'static, Command>,
    answers: Consumer<'static, Answer>,
    states: Consumer<'static, Status>,
    samples: Consumer<'static, SampleBlock>,
}

/// Makes the queues, once. One place of each is always empty.
pub fn queues() -> (TickEnds, LinkEnds) {
    static COMMANDS: StaticCell<Queue<Command, 3>> = StaticCell::new();
    static ANSWERS: StaticCell<Queue<Answer, 3>> = StaticCell::new();
    static STATES: StaticCell<Queue<Status, 2>> = StaticCell::new();
    static SAMPLES: StaticCell<Queue<SampleBlock, 2>> = StaticCell::new();
    let (to_tick, commands) = COMMANDS.init_with(Queue::new).split();
    let (answers, from_tick) = ANSWERS.init_with(Queue::new).split();
    let (states, states_out) = STATES.init_with(Queue::new).split();
    let (samples, samples_out) = SAMPLES.init_with(Queue::new).split();
    let for_tick = TickEnds {
        commands,
        answers,
        states,
        samples,
    };
    let for_link = LinkEnds {
        commands: to_tick,
        answers: from_tick,
        states: states_out,
        samples: samples_out,
    };
    (for_tick, for_link)
}

static FRAMES_OK: AtomicU32 = AtomicU32::new(0);
static FRAMES_BAD: AtomicU32 = AtomicU32::new(0);
static TELEMETRY_DROPPED: AtomicU32 = AtomicU32::new(0);
/// A damaged frame came: the core should say which number it waits for.
static DAMAGED: AtomicBool = AtomicBool::new(false);
/// Someone asked who this is.
static HELLO_DUE: AtomicBool = AtomicBool::new(false);

static RECEIVE: Signal<CriticalSectionRawMutex, ()> = Signal::new();
static SEND: Signal<CriticalSectionRawMutex, ()> = Signal::new();

/// Wakes both tasks: once per tick, by an interrupt below it.
pub fn wake() {
    RECEIVE.signal(());
    SEND.signal(());
}

/// What was counted so far.
pub fn counters() -> LinkCounters {
    LinkCounters {
        frames_ok: FRAMES_OK.load(Ordering::Relaxed),
        frames_bad: FRAMES_BAD.load(Ordering::Relaxed),
        telemetry_dropped: TELEMETRY_DROPPED.load(Ordering::Relaxed),
    }
}

/// A block of samples found no room.
pub fn drop_telemetry() {
    TELEMETRY_DROPPED.fetch_add(1, Ordering::Relaxed);
}

/// Whether a damaged frame came since the last call.
pub fn take_damaged() -> bool {
    DAMAGED.swap(false, Ordering::Relaxed)
}

/// Both tasks, ready to run.
pub struct Tasks {
    ends: LinkEnds,
    sender: Sender,
    ring: Ring,
    hello: Hello,
    watchdog: Peri<'static, IWDG>,
}

impl Tasks {
    /// From their parts.
    pub const fn new(
        ends: LinkEnds,
        sender: Sender,
        ring: Ring,
        hello: Hello,
        watchdog: Peri<'static, IWDG>,
    ) -> Self {
        Self {
            ends,
            sender,
            ring,
            hello,
            watchdog,
        }
    }

    /// Starts them, and the watchdog with them.
    pub fn spawn(self, spawner: Spawner) {
        let LinkEnds {
            commands,
            answers,
            states,
            samples,
        } = self.ends;
        let out = Out {
            hello: self.hello,
            answers,
            states,
            samples,
        };
        let receiving = receive(self.ring, commands, Keeper::new(self.watchdog));
        let sending = send(self.sender, out);
        let (Ok(receiving), Ok(sending)) = (receiving, sending) else {
            crate::fatal::stop("no room for the link's tasks")
        };
        spawner.spawn(receiving);
        spawner.spawn(sending);
    }
}

#[embassy_executor::task]
async fn receive(
    mut ring: Ring,
    mut commands: Producer<'static, Command>,
    mut keeper: Keeper,
) -> ! {
    let mut receiver = Receiver::default();
    let mut line_errors = 0_u32;
    loop {
        RECEIVE.wait().await;
        life::show(Part::Receive);
        keeper.feed();
        if uart::line_error() {
            line_errors = line_errors.wrapping_add(1);
            // One line per 256 of them: a noisy line must not fill the log, too.
            if line_errors % 256 == 1 {
                defmt::warn!("line errors: {=u32}", line_errors);
            }
        }
        if !ring.look(Tick(crate::tick::now())) {
            defmt::warn!("received faster than executed: bytes dropped");
        }
        // Bytes wait in the ring while the tick is behind.
        while commands.ready() {
            let Some(byte) = ring.take() else { break };
            match receiver.push(byte) {
                None => continue,
                Some(Incoming::HelloQuery) => HELLO_DUE.store(true, Ordering::Relaxed),
                Some(Incoming::Damaged(_)) => DAMAGED.store(true, Ordering::Relaxed),
                Some(Incoming::Command(command)) => {
                    // Room was just seen, and nobody else fills it.
                    let _ = commands.enqueue(command);
                }
            }
            FRAMES_OK.store(receiver.counters.frames_ok, Ordering::Relaxed);
            FRAMES_BAD.store(receiver.counters.frames_bad, Ordering::Relaxed);
        }
    }
}

/// What waits to be sent.
struct Out {
    hello: Hello,
    answers: Consumer<'static, Answer>,
    states: Consumer<'static, Status>,
    samples: Consumer<'static, SampleBlock>,
}

impl Out {
    /// Encodes the most urgent message; its size, or 0 where nothing waits.
    fn next(&mut self, frame: &mut [u8; MAX_FRAME]) -> usize {
        let used = if HELLO_DUE.swap(false, Ordering::Relaxed) {
            encode_bytes(Channel::Hello, &self.hello.to_bytes(), frame)
        } else if let Some(answer) = self.answers.peek() {
            let used = encode_frame(Channel::Answer, answer, frame);
            self.answers.dequeue();
            used
        } else if let Some(status) = self.states.peek() {
            let used = encode_frame(Channel::Status, status, frame);
            self.states.dequeue();
            used
        } else if let Some(block) = self.samples.peek() {
            let used = encode_frame(Channel::Samples, block, frame);
            self.samples.dequeue();
            used
        } else {
            Ok(0)
        };
        // Every message fits a frame: the protocol asserts it when it is compiled.
        used.unwrap_or(0)
    }
}

#[embassy_executor::task]
async fn send(mut sender: Sender, mut out: Out) -> ! {
    let mut frame = [0; MAX_FRAME];
    loop {
        life::show(Part::Send);
        let used = out.next(&mut frame);
        match frame.get(..used) {
            // A write can only fail where flow control is in use.
            Some(bytes) if used > 0 => drop(sender.write(bytes).await),
            _ => SEND.wait().await,
        }
    }
}
