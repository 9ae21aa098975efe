//! The drives' bus: bxCAN on PB8 and PB9, behind [`CanPort`].
//!
//! The tick never touches a mailbox and takes no lock: it puts frames into a queue and takes
//! received ones from another. The controller's interrupts, below the tick and both of one
//! priority, move them on. Mailboxes are sent in the order of their requests, so that two frames
//! with the same identifier never overtake each other. Received frames arrive through both FIFOs,
//! drive by drive, so that a burst of one drive does not cost the others their frames; lost frames
//! are counted. After bus-off the controller recovers by itself (128 times 11 recessive bits); the
//! core decides what that means for the robot (D1).
//!
//! By registers, not by embassy-stm32's `Can`: its sender and receiver are behind locks that mask interrupts, it counts
//! no frame that a full FIFO lost, and its `set_automatic_retransmit` is inverted (version 0.6, `can/bxcan`).

use crate::interrupts;
use core::ptr;
use core::sync::atomic::{AtomicPtr, AtomicU8, AtomicU32, AtomicUsize, Ordering};
use cortex_m::peripheral::NVIC;
use embassy_stm32::pac;
use embassy_stm32::pac::can::regs::{Mcr, Rfr, Tir, Tsr};
use embassy_stm32::pac::can::vals::Silm;
use embassy_stm32::pac::gpio::vals::{CnfOut, Mode};
use embassy_stm32::pac::interrupt;
use heapless::spsc::{Consumer, Producer, Queue};
use mcdpr_firmware::drives::{BusState, CanFrame, CanPort, Full};
use static_cell::StaticCell;

/// Bit rate times its prescaler: 36 MHz in bits of 18 quanta.
const QUANTA_HZ: u32 = 36_000_000 / 18;
/// Of the 18 quanta one synchronises; the sample is taken after 14 more, at 83 %.
// 1 + 14 of 18 quanta are 83 %: late, for long wires, but before the end for the oscillators'
// tolerance.
const BEFORE_SAMPLE: u8 = 14;
const AFTER_SAMPLE: u8 = 3;
/// Quanta by which an edge may shift a bit.
const JUMP: u8 = 2;
/// Bits of an identifier in a filter's registers.
const BIT_0: u32 = 1 << 21;
const BIT_4: u32 = 1 << 25;
/// Loops until the controller is ready to be set up: it finishes the current frame first, 0.3 ms at
/// most.
// A frame of 135 bits at 500 kbit/s takes 0.27 ms; a turn of the loop takes several cycles of 72
// MHz.
const PATIENCE: u32 = 5000;
/// Ticks without a single transmitted frame, while some wait, after which they are dropped. A drive
/// that returns must not follow outdated commands.
const STALE_TICKS: u32 = 10;

/// Queue of outgoing frames, one place always empty: one per drive and three that are addressed to
/// all.
type Outgoing = Queue<CanFrame, 8>;
/// Queue of received frames for one tick: 1 Mbit/s brings 8 of eight bytes, one place always empty.
type Incoming = Queue<CanFrame, 12>;

/// New bit rate; 0 for none.
static BITRATE: AtomicU32 = AtomicU32::new(0);
/// Oldest frames of the queue to be dropped.
static DROP: AtomicUsize = AtomicUsize::new(0);
/// Transmitted frames.
static DELIVERED: AtomicU32 = AtomicU32::new(0);

/// Received frames that were lost: a FIFO was overrun, or the queue to the tick was full.
static LOST: AtomicU32 = AtomicU32::new(0);

/// Frames lost since the start.
pub fn lost() -> u32 {
    LOST.load(Ordering::Relaxed)
}

/// State of the last loop-back test: 0 never requested, 1 running, 2 passed, 3 failed.
static LOOP: AtomicU8 = AtomicU8::new(0);

/// Whether the last loop-back test returned the frames sent; `None` before the first.
pub fn looped() -> Option<bool> {
    match LOOP.load(Ordering::Relaxed) {
        2 => Some(true),
        3 => Some(false),
        _ => None,
    }
}

/// Frames of the loop-back test: one through each FIFO.
const LOOPED: [CanFrame; 2] = [
    CanFrame {
        id: 0x7EE,
        len: 8,
        data: [0x55; 8],
    },
    CanFrame {
        id: 0x7EF,
        len: 8,
        data: [0xAA, 0, 0xFF, 0x33, 0xCC, 0, 0xFF, 0x0F],
    },
];
/// Ticks that a loop-back test may take: 0.3 ms of frames, after 11 bits of an idle bus.
// 10 ms: the set-up may have to be repeated in the next tick.
const LOOP_TICKS: u8 = 10;
/// Its bit rate.
const LOOP_BITS_PER_S: u32 = 1_000_000;

/// The tick's end of the queues.
pub struct Bus {
    outgoing: Producer<'static, CanFrame>,
    incoming: Consumer<'static, CanFrame>,
    delivered: u32,
    stale: u32,
    /// Ticks left of a loop-back test, and the frames received so far.
    loop_ticks: u8,
    came_back: u8,
}

/// The interrupts' end of the queues.
struct Controller {
    outgoing: Consumer<'static, CanFrame>,
    incoming: Producer<'static, CanFrame>,
}

static CONTROLLER: AtomicPtr<Controller> = AtomicPtr::new(ptr::null_mut());

/// Gives the controller its pins, to which it was mapped, and enables its interrupts; its clock
/// runs. It joins the bus when it is given a bit rate.
pub fn open() -> Bus {
    static OUTGOING: StaticCell<Outgoing> = StaticCell::new();
    static INCOMING: StaticCell<Incoming> = StaticCell::new();
    static PLACE: StaticCell<Controller> = StaticCell::new();
    let (outgoing, to_send) = OUTGOING.init_with(Queue::new).split();
    let (received, incoming) = INCOMING.init_with(Queue::new).split();
    let controller = PLACE.init(Controller {
        outgoing: to_send,
        incoming: received,
    });
    CONTROLLER.store(controller, Ordering::Release);

    // The receiving pin is pulled up: without a transceiver the bus reads as idle.
    pac::GPIOB.cr(1).modify(|w| {
        w.set_mode(1, Mode::OUTPUT50MHZ);
        w.set_cnf_out(1, CnfOut::ALT_PUSH_PULL);
    });
    for line in [
        interrupt::USB_HP_CAN1_TX,
        interrupt::USB_LP_CAN1_RX0,
        interrupt::CAN1_RX1,
    ] {
        interrupts::enable_link(line);
    }
    Bus {
        outgoing,
        incoming,
        delivered: 0,
        stale: 0,
        loop_ticks: 0,
        came_back: 0,
    }
}

impl Bus {
    /// Sends frames through the controller and back, disconnected from the bus. The bus must not be
    /// in use.
    pub fn begin_loop(&mut self) {
        LOOP.store(1, Ordering::Relaxed);
        (self.loop_ticks, self.came_back) = (LOOP_TICKS, 0);
        self.set_bitrate(LOOP_BITS_PER_S);
        for frame in &LOOPED {
            // The frames wait in the queue until the controller is ready.
            let _ = self.outgoing.enqueue(*frame);
        }
    }

    /// One tick of a loop-back test.
    fn watch_loop(&mut self) {
        // Each FIFO returns one frame: both filters and both interrupts are tested.
        while let Some(frame) = self.incoming.dequeue() {
            self.came_back += u8::from(LOOPED.contains(&frame));
        }
        self.loop_ticks -= 1;
        if self.loop_ticks == 0 {
            let good = usize::from(self.came_back) == LOOPED.len();
            LOOP.store(if good { 2 } else { 3 }, Ordering::Relaxed);
            // Back to sleep, until a configuration gives it a bit rate.
            let mut mode = Mcr(0);
            mode.set_reset(true);
            pac::CAN.mcr().write_value(mode);
        }
    }

    /// Once per tick: drops frames that no node has acknowledged for too long.
    pub fn watch(&mut self) {
        if self.loop_ticks > 0 {
            return self.watch_loop();
        }
        let delivered = DELIVERED.load(Ordering::Relaxed);
        let tsr = pac::CAN.tsr().read();
        // Frames that wait without being sent: no other node acknowledges, or the wires are broken.
        let waits = !(tsr.tme(0) && tsr.tme(1) && tsr.tme(2));
        self.stale = if waits && delivered == self.delivered {
            self.stale + 1
        } else {
            0
        };
        self.delivered = delivered;
        if self.stale >= STALE_TICKS {
            self.stale = 0;
            // Counted now: a frame that is queued afterwards is new and is sent.
            DROP.store(self.outgoing.len() + 1, Ordering::Relaxed);
            ring();
        }
    }
}

/// Triggers the transmit interrupt.
fn ring() {
    NVIC::pend(interrupt::USB_HP_CAN1_TX);
}

impl CanPort for Bus {
    fn set_bitrate(&mut self, bits_per_s: u32) {
        // Frames of the old bit rate are void.
        while self.incoming.dequeue().is_some() {}
        DROP.store(self.outgoing.len() + 1, Ordering::Relaxed);
        BITRATE.store(bits_per_s, Ordering::Relaxed);
        ring();
    }

    fn send(&mut self, frame: &CanFrame) -> Result<(), Full> {
        // First into the queue, then the interrupt: it finds the frame in any case.
        self.outgoing.enqueue(*frame).map_err(|_| Full)?;
        ring();
        Ok(())
    }

    fn receive(&mut self) -> Option<CanFrame> {
        self.incoming.dequeue()
    }

    fn state(&self) -> BusState {
        let esr = pac::CAN.esr().read();
        if esr.boff() {
            BusState::Off
        } else if esr.epvf() {
            BusState::Passive
        } else {
            BusState::Active
        }
    }
}

impl Controller {
    fn send(&mut self) {
        // One more than were queued: the mailboxes are void, too.
        let drop = DROP.swap(0, Ordering::Relaxed);
        for _ in 1..drop {
            self.outgoing.dequeue();
        }
        let bits_per_s = BITRATE.swap(0, Ordering::Relaxed);
        if bits_per_s != 0 && !set_up(bits_per_s) {
            // Repeat in the next tick, unless another drop is requested.
            BITRATE.store(bits_per_s, Ordering::Relaxed);
            return;
        }
        if drop > 0 {
            let mut give_up = Tsr(0);
            // A frame that is on the wire now still ends; the others are free at once (RM0008,
            // 24.7).
            (0..3).for_each(|mailbox| give_up.set_abrq(mailbox, true));
            pac::CAN.tsr().write_value(give_up);
        }
        let tsr = pac::CAN.tsr().read();
        let mut done = Tsr(0);
        for mailbox in 0..3 {
            // Written as ones: only the results that were read are cleared, not one that comes
            // meanwhile.
            done.set_rqcp(mailbox, tsr.rqcp(mailbox));
            if tsr.txok(mailbox) {
                DELIVERED.fetch_add(1, Ordering::Relaxed);
            }
        }
        pac::CAN.tsr().write_value(done);
        // Asleep until a configuration gives a bit rate: frames wait in the queue.
        if pac::CAN.msr().read().slak() {
            return;
        }
        for mailbox in (0..3).filter(|&mailbox| tsr.tme(mailbox)) {
            let Some(frame) = self.outgoing.dequeue() else {
                break;
            };
            let [low, high] = halves(&frame.data);
            let to = pac::CAN.tx(mailbox);
            to.tdtr().write(|w| w.set_dlc(frame.len.min(8)));
            to.tdlr().write(|w| w.0 = low);
            to.tdhr().write(|w| w.0 = high);
            let mut id = Tir(0);
            id.set_stid(frame.id);
            id.set_txrq(true);
            to.tir().write_value(id);
        }
    }

    fn receive(&mut self, number: usize) {
        let fifo = pac::CAN.rfr(number);
        if fifo.read().fovr() {
            LOST.fetch_add(1, Ordering::Relaxed);
            let mut clear = Rfr(0);
            clear.set_fovr(true);
            fifo.write_value(clear);
        }
        let mut release = Rfr(0);
        release.set_rfom(true);
        while fifo.read().fmp() > 0 {
            let from = pac::CAN.rx(number);
            let mut frame = CanFrame {
                id: from.rir().read().stid(),
                len: from.rdtr().read().dlc().min(8),
                data: [0; 8],
            };
            let words = [from.rdlr().read().0, from.rdhr().read().0];
            let bytes = words.into_iter().flat_map(u32::to_le_bytes);
            for (slot, byte) in frame.data.iter_mut().zip(bytes).take(frame.len.into()) {
                *slot = byte;
            }
            // A frame that finds no room is lost, as on the wire: drives repeat their values.
            if self.incoming.enqueue(frame).is_err() {
                LOST.fetch_add(1, Ordering::Relaxed);
            }
            fifo.write_value(release);
            // The hardware clears it when the next frame is in place, some cycles later.
            while fifo.read().rfom() {}
        }
    }
}

fn halves(data: &[u8; 8]) -> [u32; 2] {
    let [a, b, c, d, e, f, g, h] = *data;
    [[a, b, c, d], [e, f, g, h]].map(u32::from_le_bytes)
}

/// Restarts the controller at a bit rate; `false` if it did not get ready in time.
fn set_up(bits_per_s: u32) -> bool {
    let can = pac::CAN;
    let mut mode = Mcr(0);
    mode.set_reset(true);
    can.mcr().write_value(mode);
    let mut mode = Mcr(0);
    // Leaves bus-off by itself, and sends mailboxes in the order of their requests (TXFP).
    mode.set_abom(true);
    mode.set_txfp(true);
    mode.set_inrq(true);
    can.mcr().write_value(mode);
    let ready = |_| can.msr().read().inak() && !can.msr().read().slak();
    if !(0..PATIENCE).any(ready) {
        return false;
    }
    // The configuration accepts only bit rates that divide this (`config::BIT_RATES`).
    let prescaler = u16::try_from(QUANTA_HZ / bits_per_s.max(1)).unwrap_or(1);
    can.btr().write(|w| {
        w.set_brp(prescaler.saturating_sub(1));
        w.set_ts(0, BEFORE_SAMPLE - 1);
        w.set_ts(1, AFTER_SAMPLE - 1);
        w.set_sjw(JUMP - 1);
        let loops = LOOP.load(Ordering::Relaxed) == 1;
        w.set_lbkm(loops);
        w.set_silm(if loops { Silm::SILENT } else { Silm::NORMAL });
    });
    // Four masks of 32 bits: all data frames with 11 bits of identifier. Identifiers with equal
    // bits 0 and 4 go to FIFO 0, others to FIFO 1: the lowest bit of a drive's number is bit 4 for
    // an RMDS, whose bit 0 never changes, and bit 0 for CiA 402.
    can.fmr().modify(|w| w.set_finit(true));
    can.fs1r().write(|w| w.0 = 0b1111);
    can.fm1r().write(|w| w.0 = 0);
    // Banks 2 and 3, whose two bits differ, feed FIFO 1.
    can.ffa1r().write(|w| w.0 = 0b1100);
    for (bank, identifier) in [0, BIT_0 | BIT_4, BIT_0, BIT_4].into_iter().enumerate() {
        can.fb(bank).fr1().write(|w| w.0 = identifier);
        // 0b110: IDE and RTR must be 0, so extended and remote frames pass no filter.
        can.fb(bank).fr2().write(|w| w.0 = BIT_0 | BIT_4 | 0b110);
    }
    can.fa1r().write(|w| w.0 = 0b1111);
    can.fmr().modify(|w| w.set_finit(false));
    can.ier().write(|w| {
        w.set_tmeie(true);
        w.set_fmpie(0, true);
        w.set_fmpie(1, true);
    });
    mode.set_inrq(false);
    can.mcr().write_value(mode);
    true
}

/// The controller, from `open` on.
fn controller() -> Option<&'static mut Controller> {
    #[allow(unsafe_code, reason = "one owner, three interrupts of one priority")]
    // SAFETY: null, or the one reference that `open` made and gave up. Only the handlers below load
    // it; they have the same priority, so they never run at the same time.
    unsafe {
        CONTROLLER.load(Ordering::Acquire).as_mut()
    }
}

#[interrupt]
fn USB_HP_CAN1_TX() {
    if let Some(controller) = controller() {
        controller.send();
    }
    interrupts::leave_event();
}

#[interrupt]
fn USB_LP_CAN1_RX0() {
    if let Some(controller) = controller() {
        controller.receive(0);
    }
    interrupts::leave_event();
}

#[interrupt]
fn CAN1_RX1() {
    if let Some(controller) = controller() {
        controller.receive(1);
    }
    interrupts::leave_event();
}
