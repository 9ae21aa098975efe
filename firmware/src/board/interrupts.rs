//! Priorities, and critical sections that never delay the tick.
//!
//! | priority | user |
//! |---|---|
//! | 0 | SysTick: the control tick |
//! | 4 | links (DMA of the UART, CAN) |
//! | 8 | every other interrupt |
//!
//! A critical section raises `BASEPRI` to 1: it masks all of these but the tick. So the tick must
//! not use one: no locks, no defmt. It passes its results through queues and atomics; the fact that
//! it ran wakes the link's loop.
//!
//! A core of this revision does not set its event register on exceptions (Arm erratum 563915, in
//! ST's ES096 for r1p1): an exception between the link's last check and its `WFE` would be missed.
//! So every handler that returns sets the event itself ([`leave_event`]).
#![allow(
    unsafe_code,
    reason = "critical sections and interrupt priorities are the processor's own registers"
)]

use core::sync::atomic::{Ordering, compiler_fence};
use cortex_m::peripheral::scb::SystemHandler;
use cortex_m::peripheral::{NVIC, SCB};
use cortex_m::register::{basepri, basepri_max};
use embassy_stm32::pac::Interrupt;

/// Priorities as the registers hold them: the upper four bits of a byte.
const TICK: u8 = 0;
/// Of `BASEPRI`: masks priority 1 and below it.
const BELOW_TICK: u8 = 1 << 4;
/// Links.
// Above `OTHER`, below the tick: a received frame waits for the tick only.
const LINK: u8 = 4 << 4;
/// Every other interrupt.
const OTHER: u8 = 8 << 4;

struct BelowTick;
critical_section::set_impl!(BelowTick);

// SAFETY: the chip has one core, and all code that uses critical sections runs at priority 1 or
// lower: `lower_all` gives every interrupt such a priority before the first is enabled. The code
// above (tick, NMI, HardFault) uses none.
unsafe impl critical_section::Impl for BelowTick {
    unsafe fn acquire() -> u8 {
        let before = basepri::read();
        // Only ever raises, so that sections nest.
        basepri_max::write(BELOW_TICK);
        // The new mask holds from the next instruction on.
        cortex_m::asm::isb();
        compiler_fence(Ordering::SeqCst);
        before
    }

    unsafe fn release(before: u8) {
        compiler_fence(Ordering::SeqCst);
        // SAFETY: restores the value that `acquire` read; the caller pairs the two.
        unsafe { basepri::write(before) }
    }
}

/// Must be the last call of a handler.
#[inline]
pub fn leave_event() {
    cortex_m::asm::sev();
}

/// Puts every interrupt below the tick: one that is not set would share priority 0 with it.
pub fn lower_all(nvic: NVIC, mut scb: SCB) {
    for priority in &nvic.ipr {
        // SAFETY: no interrupt is enabled yet, so no priority changes under a running handler.
        unsafe { priority.write(OTHER) }
    }
    for (handler, priority) in [
        (SystemHandler::SysTick, TICK),
        (SystemHandler::PendSV, OTHER),
        (SystemHandler::SVCall, OTHER),
    ] {
        // SAFETY: as above; SysTick is not yet counting.
        unsafe { scb.set_priority(handler, priority) }
    }
}

/// Enables the interrupt of a link. Everything that its handler uses must be initialised.
pub fn enable_link(line: Interrupt) {
    // SAFETY: the line is not enabled yet, so that its priority does not change under a running
    // handler; its handler uses no critical section and shares only atomics and its end of queues.
    unsafe {
        if let Some(priority) = (*NVIC::PTR).ipr.get(line as usize) {
            priority.write(LINK);
        }
        NVIC::unmask(line);
    }
}
