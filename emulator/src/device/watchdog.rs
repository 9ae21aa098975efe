//! The independent watchdog (RM0008, 19).

use super::TICKS_PER_SECOND;

/// Its oscillator (LSI), nominally. A chip's has 30 to 60 kHz (data sheet, 5.3.7).
pub(crate) const OSCILLATOR_HZ: u64 = 40_000;

#[derive(Debug, Clone)]
pub(crate) struct Watchdog {
    open: bool,
    prescaler: u32,
    reload: u32,
    pub oscillator_hz: u64,
    /// When it resets the chip, once started.
    pub barks_at: Option<u64>,
}

impl Watchdog {
    pub const fn new() -> Self {
        Self {
            open: false,
            prescaler: 0,
            reload: 0xFFF,
            oscillator_hz: OSCILLATOR_HZ,
            barks_at: None,
        }
    }

    const fn period(&self) -> u64 {
        // Divided by 4 to 256; code 7 is the same as 6.
        let prescaler = 4_u64
            << if self.prescaler > 6 {
                6
            } else {
                self.prescaler
            };
        (self.reload as u64 + 1) * prescaler * TICKS_PER_SECOND / self.oscillator_hz
    }

    pub const fn read(&self, offset: u32) -> Option<u32> {
        match offset {
            0x00 | 0x0C => Some(0),
            0x04 => Some(self.prescaler),
            0x08 => Some(self.reload),
            _ => None,
        }
    }

    pub fn write(&mut self, offset: u32, value: u32, now: u64) -> Result<(), &'static str> {
        match (offset, value) {
            (0x00, 0x5555) => self.open = true,
            (0x00, 0xAAAA) => {
                self.open = false;
                // A feed before the start has no effect. Afterwards nothing can stop the watchdog.
                self.barks_at = self.barks_at.map(|_| now + self.period());
            }
            (0x00, 0xCCCC) => self.barks_at = Some(now + self.period()),
            (0x00, _) => self.open = false,
            (0x04, value) if self.open => self.prescaler = value & 7,
            (0x08, value) if self.open => self.reload = value & 0xFFF,
            (0x04 | 0x08, _) => return Err("the watchdog's registers are locked"),
            _ => return Err("no such register"),
        }
        Ok(())
    }
}
