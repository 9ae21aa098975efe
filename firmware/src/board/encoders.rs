//! Drum encoders: the four timers as quadrature decoders, every edge counted from the first instructions on.
//!
//! By registers, not by embassy-stm32's `Qei`: that exists only after RAM is initialised and the clocks run, and the drums
//! of a robot whose board was reset turn until then. It also sets no input filter (version 0.6).
#![allow(
    unsafe_code,
    reason = "runs before RAM is initialised, which no Rust code may; one timer by the registers that all four share"
)]

use crate::pins::CABLES;
use core::arch::naked_asm;
use embassy_stm32::pac;
use embassy_stm32::pac::timer::TimGp16;

/// Both inputs of a timer as they are (CCMR1, CCxS = 1), filtered (ICxF = 12): eight equal samples at the core's clock
/// / 16. At 72 MHz pulses shorter than 1.8 us are filtered out, and edges may follow each other at 560 kHz; in the
/// first milliseconds, at 8 MHz, at 62 kHz. A drum gives less: 1024 lines at 10 turns per second are 41 kHz.
const FILTERED: u32 = 0xC1C1;
/// Every edge of both inputs is counted (SMCR, encoder mode 3): 4096 counts of 1024 lines.
const EVERY_EDGE: u32 = 3;

/// Cable 1 first.
fn timers() -> [TimGp16; CABLES] {
    // SAFETY: TIM1 has all registers of the others at the same offsets, and further ones behind
    // them.
    let first = unsafe { TimGp16::from_ptr(pac::TIM1.as_ptr()) };
    [first, pac::TIM2, pac::TIM3, pac::TIM4]
}

/// Starts counting, called by the reset handler before it initialises RAM: that takes some milliseconds at 8 MHz, in
/// which drums turn after a reset, until their brakes have closed. The pins are inputs after a reset.
///
/// # Safety
/// Called only by the reset handler.
#[unsafe(naked)]
#[unsafe(no_mangle)]
unsafe extern "C" fn __pre_init() {
    naked_asm!(
        // Clocks (RM0008, 7.3): TIM2 to TIM4 by APB1ENR; ports A and B, and TIM1, by APB2ENR.
        "movw r0, #0x1000",
        "movt r0, #0x4002",
        "movs r1, #7",
        "str r1, [r0, #0x1C]",
        "movw r1, #0x080C",
        "str r1, [r0, #0x18]",
        "mov r3, lr",
        "movw r1, #{filtered}",
        "movw r2, #0xFFFF",
        // TIM1, then TIM2 to TIM4, 0x400 apart.
        "movw r0, #0x2C00",
        "movt r0, #0x4001",
        "bl 2f",
        "movs r0, #0",
        "movt r0, #0x4000",
        "bl 2f",
        "add.w r0, r0, #0x400",
        "bl 2f",
        "add.w r0, r0, #0x400",
        "bl 2f",
        "bx r3",
        // CCMR1; ARR, whose value after a reset differs between manuals and makers of the chip: at 0 the counter
        // stops; SMCR; CR1.
        "2:",
        "str r1, [r0, #0x18]",
        "str r2, [r0, #0x2C]",
        "mov.w r12, #{every_edge}",
        "str.w r12, [r0, #0x08]",
        "mov.w r12, #1",
        "str.w r12, [r0]",
        "bx lr",
        filtered = const FILTERED,
        every_edge = const EVERY_EDGE,
    )
}

/// The counters.
pub fn read() -> [u16; CABLES] {
    // One by one: a loop over them would first build a table of their addresses.
    let [a, b, c, d] = timers();
    let count = |timer: TimGp16| timer.cnt().read().cnt();
    [count(a), count(b), count(c), count(d)]
}
