//! Fatal errors: brakes first, then a record that survives the reset, then the reset.
//!
//! Panics, processor faults, a stopped crystal, a falling supply and interrupts without a handler
//! all end here. The record lies in RAM that a start does not clear; magic number and checksum
//! distinguish it from the random contents of RAM at power-on.
#![allow(
    unsafe_code,
    reason = "linker sections and exception handlers; each use says why it is sound"
)]

use crate::pins;
use core::arch::naked_asm;
use core::panic::PanicInfo;
use core::sync::atomic::{AtomicU8, AtomicU32, AtomicUsize, Ordering, fence};
use cortex_m::peripheral::SCB;
use embassy_stm32::pac::interrupt;
use mcdpr_protocol::List;
use mcdpr_protocol::frame::crc32;
use mcdpr_protocol::message::PANIC_BYTES;

/// Text of the record after the supply has fallen.
pub const SUPPLY_LOW: &str = "P1: supply low";

/// A record that no start has read yet.
const NEW: u32 = 0x4D43_4450;
/// A record that an earlier start has read: kept for `Info`, but no longer the reset's cause.
const READ: u32 = 0x5052_4541;

/// Atomics may hold any bits and need no initial value, as memory after a reset requires.
struct Kept {
    magic: AtomicU32,
    length: AtomicUsize,
    checksum: AtomicU32,
    text: [AtomicU8; PANIC_BYTES],
}

#[unsafe(link_section = ".uninit.fatal")]
static KEPT: Kept = Kept {
    magic: AtomicU32::new(0),
    length: AtomicUsize::new(0),
    checksum: AtomicU32::new(0),
    text: [const { AtomicU8::new(0) }; PANIC_BYTES],
};

/// The record of the last fatal error.
pub struct Record {
    /// It happened just before this start.
    pub is_new: bool,
    /// Its text; empty if there was none since power-on.
    pub text: List<u8, PANIC_BYTES>,
}

/// Reads the record once per start.
pub fn read_record() -> Record {
    let magic = KEPT.magic.load(Ordering::Relaxed);
    let length = KEPT.length.load(Ordering::Relaxed);
    let bytes = KEPT.text.iter().map(|byte| byte.load(Ordering::Relaxed));
    let text = List::collect(bytes.take(length));
    let whole = length <= PANIC_BYTES && crc32(&text) == KEPT.checksum.load(Ordering::Relaxed);
    if whole && (magic == NEW || magic == READ) {
        // Read once: the next start, of another cause, must not report this one again.
        KEPT.magic.store(READ, Ordering::Relaxed);
        let is_new = magic == NEW;
        return Record { is_new, text };
    }
    KEPT.magic.store(0, Ordering::Relaxed);
    Record {
        is_new: false,
        text: List::new(),
    }
}

/// Collects a message, cut if it does not fit. The formatting of `core` would take 5 KB of flash
/// for the same messages.
pub struct Message(List<u8, PANIC_BYTES>);

impl Message {
    /// Starts with this text. Closes the brakes first, before anything else.
    pub fn new(text: &str) -> Self {
        cortex_m::interrupt::disable();
        // Interrupts off first: the tick would open the brakes again.
        pins::safe_off();
        Self(List::new()).text(text)
    }

    /// Adds text; text that does not fit is cut.
    pub fn text(mut self, text: &str) -> Self {
        for &byte in text.as_bytes() {
            // A full message does not change.
            let _ = self.0.push(byte);
        }
        self
    }

    /// Adds a decimal number.
    pub fn decimal(self, number: usize) -> Self {
        let shown = if number >= 10 {
            self.decimal(number / 10)
        } else {
            self
        };
        shown.digit(number % 10)
    }

    /// Adds a hexadecimal number of eight digits.
    pub fn hex(self, number: usize) -> Self {
        let nibbles = (0..8).rev().map(|place| (number >> (4 * place)) & 0xF);
        nibbles.fold(self.text("0x"), Self::digit)
    }

    fn digit(mut self, digit: usize) -> Self {
        let digit = b"0123456789abcdef".get(digit).copied();
        // A full message does not change.
        let _ = self.0.push(digit.unwrap_or(b'?'));
        self
    }

    /// Keeps the message and resets.
    pub fn stop(self) -> ! {
        let text = self.0;
        for (slot, &byte) in KEPT.text.iter().zip(text.iter()) {
            slot.store(byte, Ordering::Relaxed);
        }
        KEPT.length.store(text.len(), Ordering::Relaxed);
        KEPT.checksum.store(crc32(&text), Ordering::Relaxed);
        // Last: a record that is cut off by a reset keeps its old magic, and its checksum fails.
        KEPT.magic.store(NEW, Ordering::Relaxed);
        // All words are in memory before the reset.
        fence(Ordering::SeqCst);
        SCB::sys_reset()
    }
}

/// Closes the brakes, keeps the message, resets.
pub fn stop(message: &str) -> ! {
    Message::new(message).stop()
}

#[panic_handler]
fn panic(info: &PanicInfo) -> ! {
    let mut message = Message::new("");
    if let Some(place) = info.location() {
        let file = place.file();
        // The end of the path is enough: crate, folder, file.
        // Half of the record for the path: the rest is for the line.
        let start = file.len().saturating_sub(PANIC_BYTES / 2);
        let end = file.get(start..).unwrap_or_default();
        message = message.text(end).text(":").decimal(place.line() as usize);
    }
    message.stop()
}

unsafe extern "C" {
    /// Ends of the stack, from memory.x; only their addresses mean anything.
    static _stack_start: u32;
    static _stack_end: u32;
}

/// Bytes of stack that the handler may need.
// The handler builds a message of 96 bytes; the rest is room for its calls.
const HANDLER_BYTES: u32 = 1024;

/// Switches to a fresh stack, before anything is pushed, if the old one is used up: its overflow
/// may be the fault. In that case the old stack was deep, so the fresh one does not overwrite the
/// frame of the fault.
///
/// # Safety
/// Called only by the processor.
#[unsafe(naked)]
#[unsafe(no_mangle)]
unsafe extern "C" fn HardFault() -> ! {
    naked_asm!(
        "mrs r0, msp",
        "sub r2, r0, #{needed}",
        "movw r1, #:lower16:{low}",
        "movt r1, #:upper16:{low}",
        "cmp r2, r1",
        // Signed, which is correct: RAM lies at 0x2000_0000, where addresses are positive.
        "bgt 1f",
        "movw r1, #:lower16:{high}",
        "movt r1, #:upper16:{high}",
        "msr msp, r1",
        "1:",
        "b {fault}",
        needed = const HANDLER_BYTES,
        low = sym _stack_end,
        high = sym _stack_start,
        fault = sym hard_fault,
    )
}

extern "C" fn hard_fault(stack: usize) -> ! {
    pins::safe_off();
    let low = &raw const _stack_end as usize;
    let high = &raw const _stack_start as usize;
    // SAFETY: a register that can be read at any time without effect.
    // Names the kind of fault: invalid access, instruction or state (ARMv7-M, CFSR).
    let status = unsafe { (*SCB::PTR).cfsr.read() };
    // The processor pushes eight words: r0 to r3, r12, lr, pc, xpsr.
    if stack < low || stack > high - 32 {
        let message = Message::new("stack overflow, sp ").hex(stack);
        message.text(", cfsr ").hex(status as usize).stop()
    }
    let word = |index: usize| {
        // SAFETY: the eight words from `stack` on lie within the stack, as just checked.
        unsafe { core::ptr::read_volatile((stack + 4 * index) as *const usize) }
    };
    // Words 6 and 5 of the frame: the faulting address and the caller's (lr).
    let message = Message::new("fault at ").hex(word(6));
    let message = message.text(" from ").hex(word(5));
    message.text(", cfsr ").hex(status as usize).stop()
}

#[cortex_m_rt::exception]
unsafe fn NonMaskableInt() -> ! {
    // The clock security system is its only source here (P6).
    stop("P6: crystal stopped")
}

/// The supply falls (P1).
#[interrupt]
fn PVD() {
    stop(SUPPLY_LOW)
}

#[cortex_m_rt::exception]
unsafe fn DefaultHandler(number: i16) -> ! {
    let message = Message::new("no handler for interrupt ");
    message.decimal(usize::from(number.unsigned_abs())).stop()
}
