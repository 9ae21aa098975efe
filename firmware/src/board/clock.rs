//! Clocks of the chip, and ticks since the start.

use core::sync::atomic::{AtomicU32, Ordering};

/// Core clock, Hz.
pub const CORE_HZ: u32 = 72_000_000;
/// Clock of the slower half of the peripherals, Hz.
pub const APB1_HZ: u32 = CORE_HZ / 2;
/// Core clock cycles of one control tick.
pub const CYCLES_PER_TICK: u32 = CORE_HZ / 1000;

static NOW: AtomicU32 = AtomicU32::new(0);

/// Starts the next tick; only the tick itself calls it. Returns its number, wrapping.
pub fn advance() -> u32 {
    let tick = NOW.load(Ordering::Relaxed).wrapping_add(1);
    NOW.store(tick, Ordering::Relaxed);
    tick
}
