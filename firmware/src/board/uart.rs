//! The host link: USART3 at 921600 baud, DMA in both directions.
//!
//! Only DMA reads the data register: reading it to clear a flag could take a byte away from DMA. It
//! fills a ring without end and without interrupts. The tick checks its progress, 92 bytes at most
//! of 512, and searches the new bytes for stops; the link takes all of it at its own pace.
//!
//! By registers, not by embassy-stm32's `RingBufferedUartRx`: that is read from one place by an exclusive reference, and
//! here the tick, which preempts everything, reads the ring beside the link. It also wants an interrupt at every idle
//! line, which is not needed: the tick looks every millisecond anyway.

use crate::clock::APB1_HZ;
use crate::interrupts;
use core::sync::atomic::{AtomicBool, AtomicU8, AtomicU32, Ordering, fence};
use embassy_stm32::pac;
use embassy_stm32::pac::bdma::vals::{Dir, Pl, Size};
use embassy_stm32::pac::gpio::vals::{CnfOut, Mode};
use embassy_stm32::pac::interrupt;
use mcdpr_firmware::io::{Line, RING};
use mcdpr_protocol::frame::MAX_FRAME;
use static_cell::StaticCell;

const BAUD: u32 = 921_600;
/// The line's clock per bit: 39.06, so the line is 0.16 % fast.
const DIVISOR: u16 = 39;
const _: () = assert!(APB1_HZ / BAUD == DIVISOR as u32 && APB1_HZ % BAUD < BAUD / 10);
/// [`RING`] for the DMA's counter.
const TRANSFERS: u16 = 512;
const _: () = assert!(TRANSFERS as usize == RING);
/// Channels of DMA1 that USART3's transmitter and receiver are wired to, counted from 0.
const SEND_CHANNEL: usize = 1;
const RECEIVE_CHANNEL: usize = 2;
/// Written by DMA.
static BYTES: [AtomicU8; RING] = [const { AtomicU8::new(0) }; RING];

/// Number of bytes at the last tick, wrapping. The line cannot fill the ring from one tick to the
/// next, so with the DMA's position in the ring it gives the total.
static ARRIVED: AtomicU32 = AtomicU32::new(0);
/// A counter that wraps must wrap where the ring does.
const _: () = assert!(RING.is_power_of_two());

/// DMA reads the frame that is being sent.
static SENDING: AtomicBool = AtomicBool::new(false);

/// Sends frames.
pub struct Sender {
    /// Read by DMA while `SENDING`.
    frame: &'static mut [u8; MAX_FRAME],
}

/// Received bytes, for the tick.
pub struct Tap(());

/// Received bytes, for the link.
pub struct Ring(());

/// Opens the line and starts receiving. The clocks of USART and DMA must run.
pub fn open() -> (Sender, Ring, Tap) {
    let usart = pac::USART3;
    usart.brr().write(|w| w.set_brr(DIVISOR));
    usart.cr1().write(|w| {
        w.set_ue(true);
        w.set_te(true);
    });
    // The transmitter idles high by now. The receiving pin is pulled up: a line that is not
    // connected idles instead of receiving noise.
    pac::GPIOB.cr(1).modify(|w| {
        w.set_mode(2, Mode::OUTPUT10MHZ);
        w.set_cnf_out(2, CnfOut::ALT_PUSH_PULL);
    });

    let channel = pac::DMA1.ch(RECEIVE_CHANNEL);
    channel.par().write_value(usart.dr().as_ptr() as u32);
    channel.mar().write_value(BYTES.as_ptr() as u32);
    channel.ndtr().write(|w| w.set_ndt(TRANSFERS));
    fence(Ordering::SeqCst);
    channel.cr().write(|w| {
        w.set_dir(Dir::FROM_PERIPHERAL);
        w.set_circ(true);
        w.set_minc(true);
        w.set_psize(Size::BITS8);
        w.set_msize(Size::BITS8);
        // Above the converter's and the transmitter's channels: the next byte arrives 10.9 us
        // later.
        w.set_pl(Pl::VERY_HIGH);
        w.set_en(true);
    });
    usart.cr3().modify(|w| {
        w.set_dmar(true);
        w.set_dmat(true);
    });
    usart.cr1().modify(|w| w.set_re(true));
    let channel = pac::DMA1.ch(SEND_CHANNEL);
    channel.par().write_value(usart.dr().as_ptr() as u32);
    static FRAME: StaticCell<[u8; MAX_FRAME]> = StaticCell::new();
    // Static: DMA reads it after this function has returned.
    let frame = FRAME.init_with(|| [0; MAX_FRAME]);
    interrupts::enable_link(interrupt::DMA1_CHANNEL2);
    (Sender { frame }, Ring(()), Tap(()))
}

impl Sender {
    /// Buffer for the next frame; `None` while one is being sent.
    pub fn free(&mut self) -> Option<&mut [u8; MAX_FRAME]> {
        let busy = SENDING.load(Ordering::Acquire);
        (!busy).then_some(&mut *self.frame)
    }

    /// Sends this many bytes of it.
    pub fn start(&mut self, used: usize) {
        // Never more than the buffer: DMA would send what lies behind it.
        let count = u16::try_from(used.min(MAX_FRAME)).unwrap_or(0);
        if count == 0 || SENDING.load(Ordering::Relaxed) {
            return;
        }
        SENDING.store(true, Ordering::Relaxed);
        // All bytes are in memory before DMA reads them.
        fence(Ordering::SeqCst);
        let channel = pac::DMA1.ch(SEND_CHANNEL);
        channel.mar().write_value(self.frame.as_ptr() as u32);
        channel.ndtr().write(|w| w.set_ndt(count));
        channel.cr().write(|w| {
            w.set_dir(Dir::FROM_MEMORY);
            w.set_minc(true);
            w.set_psize(Size::BITS8);
            w.set_msize(Size::BITS8);
            w.set_pl(Pl::MEDIUM);
            w.set_tcie(true);
            w.set_en(true);
        });
    }
}

#[interrupt]
fn DMA1_CHANNEL2() {
    pac::DMA1.ifcr().write(|w| w.set_tcif(SEND_CHANNEL, true));
    // Off, so that address and count can be written again.
    pac::DMA1.ch(SEND_CHANNEL).cr().write(|_| ());
    SENDING.store(false, Ordering::Release);
    interrupts::leave_event();
}

/// Number of bytes received so far, wrapping.
fn arrived() -> u32 {
    let known = ARRIVED.load(Ordering::Relaxed);
    let left = pac::DMA1.ch(RECEIVE_CHANNEL).ndtr().read().ndt();
    fence(Ordering::SeqCst);
    let written = u32::from(TRANSFERS.wrapping_sub(left));
    // The distance modulo 512 is unambiguous while less than a ring's worth arrives between two
    // calls.
    known.wrapping_add(written.wrapping_sub(known) % u32::from(TRANSFERS))
}

fn byte(number: u32) -> u8 {
    let place = (number % u32::from(TRANSFERS)) as usize;
    BYTES
        .get(place)
        .map_or(0, |byte| byte.load(Ordering::Relaxed))
}

impl Line for Tap {
    fn arrived(&mut self) -> u32 {
        let arrived = arrived();
        ARRIVED.store(arrived, Ordering::Relaxed);
        arrived
    }

    #[inline]
    fn byte(&self, number: u32) -> u8 {
        byte(number)
    }
}

impl Line for Ring {
    fn arrived(&mut self) -> u32 {
        arrived()
    }

    #[inline]
    fn byte(&self, number: u32) -> u8 {
        byte(number)
    }
}

/// Whether the receiver has met noise, a missing stop bit or an overrun. Reading the flags arms
/// their clearing, and the next byte that DMA reads completes it.
pub fn line_error() -> bool {
    let flags = pac::USART3.sr().read();
    flags.ne() || flags.fe() || flags.ore()
}
