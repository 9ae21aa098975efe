//! The link: bytes to commands, answers and telemetry to bytes. Two tasks of embassy's executor in
//! thread mode, `receive` and `send`; each runs once after every interrupt, so at least once per
//! tick. Their logic is in the library (`mcdpr_firmware::link`).

use crate::fatal;
use crate::life::{self, Keeper, Part};
use crate::pins::CABLES;
use crate::uart::{self, Ring, Sender};
use core::future::poll_fn;
use core::ptr;
use core::sync::atomic::{AtomicU32, Ordering};
use core::task::Poll;
use embassy_executor::raw::Executor;
use heapless::spsc::Producer;
use mcdpr_firmware::io::Line;
use mcdpr_firmware::link::{self, LinkEnds, LinkState, OutgoingEnds, Queues, TickEnds, Waiting};
use mcdpr_protocol::Hello;
use static_cell::StaticCell;

static STATE: LinkState = LinkState::new();

/// Makes the queues, once.
pub fn queues() -> (TickEnds<'static, CABLES>, LinkEnds<'static, CABLES>) {
    static QUEUES: StaticCell<Queues<CABLES>> = StaticCell::new();
    QUEUES.init_with(Queues::new).split(&STATE)
}

/// Damaged bytes not yet reported to the tick.
static LINE_ERRORS: AtomicU32 = AtomicU32::new(0);

/// Bytes without a stop bit, with noise, or overrun since the last call.
pub fn take_line_errors() -> u16 {
    u16::try_from(LINE_ERRORS.swap(0, Ordering::Relaxed)).unwrap_or(u16::MAX)
}

/// Both halves of the link, in thread mode for good.
pub fn run(incoming: &'static mut Incoming, outgoing: &'static mut Outgoing) -> ! {
    static EXECUTOR: StaticCell<Executor> = StaticCell::new();
    let executor = EXECUTOR.init_with(|| Executor::new(ptr::null_mut()));
    let (Ok(receive), Ok(send)) = (receive(incoming), send(outgoing)) else {
        // Each task has room for one instance.
        fatal::stop("a task started twice")
    };
    executor.spawner().spawn(receive);
    executor.spawner().spawn(send);
    loop {
        #[allow(
            unsafe_code,
            reason = "the executor's entry, which is for its owner alone"
        )]
        // SAFETY: called only here, not from within a task, and not by `pender`.
        unsafe {
            executor.poll();
        }
        // Anything that arrived since the last check has set the event: handlers end with SEV,
        // since those of this core do not set it (`interrupts`). So no event is missed.
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

/// Ends the task's turn. Its next one follows the next interrupt: a task that is woken within a
/// pass runs in the next pass.
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

/// Called when a task is woken. All tasks wake themselves, in thread mode: there is nothing to
/// notify, and the tick is not involved.
#[allow(unsafe_code, reason = "the executor asks for it by this name")]
#[unsafe(export_name = "__pender")]
fn pender(_: *mut ()) {}

/// The receiving task's state.
pub struct Incoming {
    half: link::Incoming,
    commands: Producer<'static, Waiting>,
    ring: Ring,
    keeper: Keeper,
    line_errors: u32,
    /// Byte count at the last of them.
    error_at: Option<u32>,
}

/// The sending task's state.
pub struct Outgoing {
    half: link::Outgoing<CABLES>,
    ends: OutgoingEnds<'static, CABLES>,
    sender: Sender,
}

/// Both halves from their parts.
pub fn open(
    ends: LinkEnds<'static, CABLES>,
    sender: Sender,
    ring: Ring,
    keeper: Keeper,
    hello: Hello,
) -> (&'static mut Incoming, &'static mut Outgoing) {
    // Not on the stack: they are never dropped.
    static INCOMING: StaticCell<Incoming> = StaticCell::new();
    static OUTGOING: StaticCell<Outgoing> = StaticCell::new();
    let incoming = INCOMING.init_with(|| Incoming {
        half: link::Incoming::default(),
        commands: ends.commands,
        ring,
        keeper,
        line_errors: 0,
        error_at: None,
    });
    let outgoing = OUTGOING.init_with(|| Outgoing {
        half: link::Outgoing::new(hello),
        ends: ends.outgoing,
        sender,
    });
    (incoming, outgoing)
}

impl Incoming {
    /// Out of line, like the other: the stack of one is released before the other's is used.
    #[inline(never)]
    fn receive(&mut self) {
        life::show(Part::Receive);
        // Here, in thread mode: a tick that floods the processor starves it, and the watchdog
        // resets the board.
        self.keeper.feed();
        // The flag is cleared with the next byte: until then it is the same error.
        let at = Some(self.ring.arrived());
        if uart::line_error() && self.error_at != at {
            self.error_at = at;
            LINE_ERRORS.fetch_add(1, Ordering::Relaxed);
            self.line_errors = self.line_errors.wrapping_add(1);
            // One line per 256 of them: a noisy line must not flood the log as well.
            if self.line_errors % 256 == 1 {
                defmt::warn!("line errors: {=u32}", self.line_errors);
            }
        }
        if !self
            .half
            .receive(&mut self.ring, &mut self.commands, &STATE)
        {
            defmt::warn!("received faster than executed: bytes dropped");
        }
    }
}

impl Outgoing {
    #[inline(never)]
    fn send(&mut self) {
        life::show(Part::Send);
        self.half.pack(&mut self.ends);
        if let Some(frame) = self.sender.free() {
            let used = self.half.next(&mut self.ends, frame);
            self.sender.start(used);
        }
    }
}
