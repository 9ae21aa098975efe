//! The watchdog: it runs before anything that could hang, the clocks included, and is fed only if
//! the tick and both halves of the link have reported in since.
//!
//! Four writes to registers: embassy-stm32's `IndependentWatchdog` (version 0.6) does the same and makes the image 380
//! bytes larger, as it searches the prescaler at run time; the budget has no room for them.

use core::sync::atomic::{AtomicU8, Ordering};
use embassy_stm32::pac;
use embassy_stm32::pac::iwdg::vals::{Key, Pr};

/// Its clock is 40 kHz divided by four, but a chip's may be 30 to 60 kHz: these 37.5 ms are 25 to
/// 50 ms.
// 375 x 4 / 40 kHz = 37.5 ms; at 60 kHz 25 ms, at 30 kHz 50 ms.
const RELOAD: u16 = 375 - 1;

/// Parts that must report in.
#[derive(Debug, Clone, Copy)]
#[repr(u8)]
pub enum Part {
    /// The control tick.
    Tick = 1,
    /// The receiving task.
    Receive = 2,
    /// The sending task.
    Send = 4,
}

const ALL: u8 = Part::Tick as u8 | Part::Receive as u8 | Part::Send as u8;

static SEEN: AtomicU8 = AtomicU8::new(0);

/// A part reports in.
pub fn show(part: Part) {
    SEEN.fetch_or(part as u8, Ordering::Relaxed);
}

/// Feeds the watchdog.
pub struct Keeper(());

impl Keeper {
    /// Starts the watchdog; it cannot be stopped again.
    pub fn new() -> Self {
        let watchdog = pac::IWDG;
        watchdog.kr().write(|w| w.set_key(Key::ENABLE));
        // Registers are unlocked by the key above and locked again by the start.
        watchdog.pr().write(|w| w.set_pr(Pr::DIVIDE_BY4));
        watchdog.rlr().write(|w| w.set_rl(RELOAD));
        watchdog.kr().write(|w| w.set_key(Key::START));
        Self(())
    }

    /// Feeds it while the board starts: each step of the start has its own timeout.
    pub fn feed_at_start(&mut self) {
        pac::IWDG.kr().write(|w| w.set_key(Key::RESET));
    }

    /// Feeds it if every part has reported in since it was last fed.
    pub fn feed(&mut self) {
        // One part that hangs is enough: the others alone do not feed it.
        if SEEN.load(Ordering::Relaxed) == ALL {
            SEEN.store(0, Ordering::Relaxed);
            pac::IWDG.kr().write(|w| w.set_key(Key::RESET));
        }
    }
}
