//! The link: bytes to commands, answers and telemetry to bytes. Two tasks of embassy's executor in
//! thread mode, `receive` and `send`; each takes a turn after every interrupt, so at least once per
//! tick. What they do is the library's (`mcdpr_firmware::link`).

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

/// Damaged bytes that the tick does not know of yet.
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
    half: link::Incoming,
    commands: Producer<'static, Waiting>,
    ring: Ring,
    keeper: Keeper,
    line_errors: u32,
    /// Bytes that had come at the last of them.
    error_at: Option<u32>,
}

/// What sends.
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
    // Not on the stack: they live for good.
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
    /// Out of line, as is the other: the stack of one is gone before the other's comes.
    #[inline(never)]
    fn receive(&mut self) {
        life::show(Part::Receive);
        self.keeper.feed();
        // The flag falls with the next byte: until then it is the same error.
        let at = Some(self.ring.arrived());
        if uart::line_error() && self.error_at != at {
            self.error_at = at;
            LINE_ERRORS.fetch_add(1, Ordering::Relaxed);
            self.line_errors = self.line_errors.wrapping_add(1);
            // One line per 256 of them: a noisy line must not fill the log, too.
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
