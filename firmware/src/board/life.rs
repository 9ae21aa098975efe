//! The watchdog: fed only when the tick and both halves of the link have shown life since.

use core::sync::atomic::{AtomicU8, Ordering};
use embassy_stm32::Peri;
use embassy_stm32::peripherals::IWDG;
use embassy_stm32::wdg::IndependentWatchdog;

/// Its clock is 40 kHz, but a chip's may be 30 to 60 kHz: this nominal time is 25 to 50 ms.
const TIMEOUT_US: u32 = 37_500;

/// Who must live.
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

/// A part shows life.
pub fn show(part: Part) {
    SEEN.fetch_or(part as u8, Ordering::Relaxed);
}

/// Feeds the watchdog.
pub struct Keeper(IndependentWatchdog<'static, IWDG>);

impl Keeper {
    /// Starts the watchdog; it can not be stopped again.
    pub fn new(watchdog: Peri<'static, IWDG>) -> Self {
        let mut watchdog = IndependentWatchdog::new(watchdog, TIMEOUT_US);
        watchdog.unleash();
        Self(watchdog)
    }

    /// Feeds it if every part has lived since it was last fed.
    pub fn feed(&mut self) {
        if SEEN.load(Ordering::Relaxed) == ALL {
            SEEN.store(0, Ordering::Relaxed);
            self.0.pet();
        }
    }
}
