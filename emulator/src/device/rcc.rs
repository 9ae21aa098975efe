//! Reset and clock control (RM0008, 7), with the flash's wait states that belong to the clock.

use super::TICKS_PER_SECOND;

// RM0008, 7.3.1.
const CR_HSEON: u32 = 1 << 16;
const CR_CSSON: u32 = 1 << 19;
const CR_PLLON: u32 = 1 << 24;
/// The crystal and the PLL need this long to start, in ticks (1 ms and 100 us).
const CRYSTAL_TICKS: u64 = TICKS_PER_SECOND / 1000;
const PLL_TICKS: u64 = TICKS_PER_SECOND / 10_000;
/// Frequency of the internal oscillator and of the board's crystal, Hz.
const OSCILLATOR_HZ: u64 = 8_000_000;

/// CSR after power-on: power and pin.
pub(crate) const RESET_POWER: u32 = 1 << 27 | 1 << 26;
/// CSR after SYSRESETREQ.
pub(crate) const RESET_SOFTWARE: u32 = 1 << 28 | 1 << 26;
/// CSR after the independent watchdog.
pub(crate) const RESET_WATCHDOG: u32 = 1 << 29 | 1 << 26;

#[derive(Debug, Clone)]
pub(crate) struct Rcc {
    cr: u32,
    cfgr: u32,
    pub ahbenr: u32,
    pub apb1enr: u32,
    pub apb2enr: u32,
    bdcr: u32,
    csr: u32,
    crystal_at: u64,
    pll_at: u64,
    pub flash_acr: u32,
    /// The crystal, and the PLL, never start.
    pub crystal_dead: bool,
    pub pll_dead: bool,
}

/// Ticks per cycle of each clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Clocks {
    pub core: u64,
    pub apb1: u64,
    /// Timers on APB1 run twice as fast as APB1 where that is divided.
    pub timers1: u64,
    pub apb2: u64,
    pub adc: u64,
}

impl Rcc {
    pub fn new(reset_flags: u32) -> Self {
        Self {
            // The internal oscillator is on and ready; flash and RAM have their clocks.
            cr: 0x83,
            cfgr: 0,
            ahbenr: 0x14,
            apb1enr: 0,
            apb2enr: 0,
            bdcr: 0,
            csr: reset_flags,
            crystal_at: 0,
            pll_at: 0,
            flash_acr: 0x30,
            crystal_dead: false,
            pll_dead: false,
        }
    }

    pub fn read(&self, offset: u32, now: u64) -> Option<u32> {
        Some(match offset {
            0x00 => {
                let crystal =
                    self.cr & CR_HSEON != 0 && now >= self.crystal_at && !self.crystal_dead;
                // Without its crystal it has no reference.
                let fed = self.cfgr & 1 << 16 == 0 || crystal;
                let pll = self.cr & CR_PLLON != 0 && now >= self.pll_at && fed && !self.pll_dead;
                self.cr | u32::from(crystal) << 17 | u32::from(pll) << 25
            }
            // A selection takes effect at once.
            0x04 => self.cfgr | (self.cfgr & 3) << 2,
            0x08 | 0x0C | 0x10 => 0,
            0x14 => self.ahbenr,
            0x18 => self.apb2enr,
            0x1C => self.apb1enr,
            0x20 => self.bdcr,
            // The low-speed oscillator runs as soon as it is enabled.
            0x24 => self.csr | (self.csr & 1) << 1,
            _ => return None,
        })
    }

    /// `Err` with what the chip does not support.
    pub fn write(&mut self, offset: u32, value: u32, now: u64) -> Result<(), &'static str> {
        match offset {
            0x00 => {
                if value & CR_HSEON != 0 && self.cr & CR_HSEON == 0 {
                    // The ready flag comes later; a firmware that does not wait for it is found.
                    self.crystal_at = now + CRYSTAL_TICKS;
                }
                if value & CR_PLLON != 0 && self.cr & CR_PLLON == 0 {
                    self.pll_at = now + PLL_TICKS;
                }
                // Ready flags are not writable; the internal oscillator stays on.
                self.cr = (value & !(1 << 17 | 1 << 25)) | 3;
            }
            0x04 => {
                // RM0008, 7.3.2: source and factor can be written only while the PLL is off.
                if self.cr & CR_PLLON != 0 && (value ^ self.cfgr) & 0x003F_0000 != 0 {
                    return Err("the PLL's settings change while it runs");
                }
                let ready = self.read(0, now).unwrap_or(0);
                match value & 3 {
                    0 => {}
                    1 if ready & 1 << 17 != 0 => {}
                    2 if ready & 1 << 25 != 0 => {}
                    _ => return Err("the system clock's source is not running"),
                }
                self.cfgr = value & !0xC;
                self.clocks()?;
            }
            // Clock interrupts are not emulated; clearing their flags is harmless.
            0x08 if value & 0x1F00 == 0 => {}
            // Reset lines: a peripheral that is being reset does nothing until it is configured.
            0x0C | 0x10 => {}
            0x14 => self.ahbenr = value,
            0x18 => self.apb2enr = value,
            0x1C => self.apb1enr = value,
            0x20 => self.bdcr = value,
            0x24 => {
                // RMVF clears all reset flags.
                if value & 1 << 24 != 0 {
                    self.csr &= 0x00FF_FFFF;
                }
                self.csr = (self.csr & !1) | (value & 1);
            }
            _ => return Err("no such register"),
        }
        Ok(())
    }

    /// The reset flags that the firmware has not cleared yet (CSR, bits 26 to 31).
    pub(crate) const fn reset_flags(&self) -> u32 {
        self.csr & 0xFC00_0000
    }

    /// BDCR: the source of the real-time clock.
    pub(crate) const fn backup(&self) -> u32 {
        self.bdcr
    }

    /// Whether a stop of the crystal is detected.
    pub(crate) const fn watches_crystal(&self) -> bool {
        self.cr & CR_CSSON != 0
    }

    /// The selected clocks; refuses settings beyond the chip's limits.
    pub fn clocks(&self) -> Result<Clocks, &'static str> {
        let source = match self.cfgr & 3 {
            2 => {
                let input = match (self.cfgr & 1 << 16 != 0, self.cfgr & 1 << 17 != 0) {
                    (false, _) | (true, true) => OSCILLATOR_HZ / 2,
                    (true, false) => OSCILLATOR_HZ,
                };
                // Codes 14 and 15 both mean a factor of 16.
                input * (u64::from((self.cfgr >> 18) & 15) + 2).min(16)
            }
            _ => OSCILLATOR_HZ,
        };
        let divided = match (self.cfgr >> 4) & 15 {
            0..8 => 0,
            code => [1, 2, 3, 4, 6, 7, 8, 9][(code & 7) as usize],
        };
        let core_hz = source >> divided;
        if core_hz == 0 || core_hz > TICKS_PER_SECOND || !TICKS_PER_SECOND.is_multiple_of(core_hz) {
            return Err("this core clock is over 72 MHz or no whole part of it");
        }
        // Wait states of the flash (RM0008, 3.3.3).
        let needed = match core_hz {
            0..=24_000_000 => 0,
            24_000_001..=48_000_000 => 1,
            _ => 2,
        };
        if self.flash_acr & 7 < needed {
            return Err("too few flash wait states for this core clock");
        }
        let core = TICKS_PER_SECOND / core_hz;
        let bus = |shift: u32| match (self.cfgr >> shift) & 7 {
            0..4 => 1,
            code => 2_u64 << (code - 4),
        };
        let (first, second) = (bus(8), bus(11));
        if core_hz / first > 36_000_000 {
            return Err("APB1 is over 36 MHz");
        }
        let adc = second * (u64::from((self.cfgr >> 14) & 3) + 1) * 2;
        Ok(Clocks {
            core,
            apb1: core * first,
            // A divided APB clock is doubled for its timers (RM0008, 7.2).
            timers1: if first == 1 { core } else { core * first / 2 },
            apb2: core * second,
            adc: core * adc,
        })
    }
}
