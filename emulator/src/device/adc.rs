//! ADC1: calibration, scans, DMA requests (RM0008, 11).

const CR2_ADON: u32 = 1;
const CR2_CONT: u32 = 2;
const CR2_CAL: u32 = 4;
const CR2_RSTCAL: u32 = 8;
const CR2_DMA: u32 = 1 << 8;
const CR2_JEXTTRIG: u32 = 1 << 15;
const CR2_EXTTRIG: u32 = 1 << 20;
const CR2_JSWSTART: u32 = 1 << 21;
const CR2_SWSTART: u32 = 1 << 22;
/// The internal channels, temperature and reference, are connected.
const CR2_TSVREFE: u32 = 1 << 23;
const CR1_SCAN: u32 = 1 << 8;
const EOC: u32 = 2;
const JEOC: u32 = 4;
const JSTRT: u32 = 8;
/// The first of the internal channels, and the code of the one sampling time that is long enough for
/// them at any clock (17.1 us).
const INTERNAL: u8 = 16;
const LONGEST: u32 = 7;
/// Channel of the reference.
const REFERENCE: usize = 17;
/// The reference, V (data sheet of the STM32F103x8, 5.3.4).
const REFERENCE_V: f64 = 1.20;
const STRT: u32 = 16;
/// Sampling times, in half cycles.
// 1.5, 7.5, 13.5, 28.5, 41.5, 55.5, 71.5 and 239.5 cycles.
const SAMPLING: [u64; 8] = [3, 15, 27, 57, 83, 111, 143, 479];
/// Conversion after sampling, in half cycles.
// 12.5 cycles.
const CONVERSION: u64 = 25;
/// Cycles of a calibration.
const CALIBRATION: u64 = 83;
/// The supply limits the converter's clock to 14 MHz: at least this many ticks.
// 72 MHz / 14 MHz is 5.14; dividers are even, so 6 is the shortest that is allowed.
const SHORTEST_CYCLE: u64 = 6;

#[derive(Debug, Clone)]
pub(crate) struct Adc {
    sr: u32,
    cr1: u32,
    cr2: u32,
    smpr: [u32; 2],
    /// JOFR, HTR, LTR: kept, without effect. JSQR: its one conversion.
    others: [u32; 20],
    sqr: [u32; 3],
    data: u32,
    position: u32,
    calibrated_at: u64,
    pub done_at: Option<u64>,
    /// An injected conversion's end and result.
    injected_at: Option<u64>,
    injected: u32,
    /// Voltage at each channel, in sixteenths of a step of a supply of 3.3 V.
    pub applied: [u16; 18],
    /// Remainder of the conversions so far, in sixteenths.
    rest: [u16; 18],
    /// The supply, which is the converter's full scale, V.
    supply_v: f64,
}

impl Default for Adc {
    fn default() -> Self {
        let mut adc = Self {
            sr: 0,
            cr1: 0,
            cr2: 0,
            smpr: [0; 2],
            others: [0; 20],
            sqr: [0; 3],
            data: 0,
            position: 0,
            calibrated_at: 0,
            done_at: None,
            injected_at: None,
            injected: 0,
            applied: [0; 18],
            rest: [0; 18],
            supply_v: 3.3,
        };
        adc.set_supply_v(3.3);
        adc
    }
}

impl Adc {
    /// The supply, the reference of all conversions.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "saturates"
    )]
    pub fn set_supply_v(&mut self, volts: f64) {
        self.supply_v = volts;
        self.applied[REFERENCE] = (REFERENCE_V / 3.3 * 65_536.0) as u16;
    }

    pub const fn supply_v(&self) -> f64 {
        self.supply_v
    }

    /// The conversion result of a channel, in sixteenths.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "saturates"
    )]
    fn share(&self, index: usize) -> u16 {
        // Exactly the default: no rounding may change results of a supply that was never set.
        if self.supply_v == 3.3 {
            return self.applied[index];
        }
        // The result is relative to the supply: a lower one makes the same voltage read higher.
        let sum = f64::from(self.applied[index]) * (3.3 / self.supply_v);
        sum.min(4095.0 * 16.0) as u16
    }

    /// When a conversion ends next.
    pub fn next_event(&self) -> u64 {
        let ends = [self.done_at, self.injected_at].into_iter().flatten();
        ends.min().unwrap_or(u64::MAX)
    }

    /// Starts the injected sequence, of one conversion: it interrupts a regular one, which then is
    /// done anew.
    fn inject(&mut self, now: u64, cycle: u64) -> Result<(), &'static str> {
        let sequence = self.others[0x38 / 4];
        if sequence >> 20 & 3 != 0 {
            return Err("an injected sequence of more than one conversion is not emulated");
        }
        let channel = (sequence >> 15 & 31) as u8;
        // Data sheet, 5.3.4: a shorter sampling time gives a wrong voltage without any error flag.
        if channel >= INTERNAL {
            if self.cr2 & CR2_TSVREFE == 0 {
                return Err("an internal channel is converted that is not connected (TSVREFE)");
            }
            if self.code(channel) != LONGEST {
                return Err("an internal channel is sampled for less than 17.1 us");
            }
        }
        self.sr |= JSTRT;
        let end = now + self.takes(channel, cycle);
        self.injected_at = Some(end);
        let again = end + self.duration(cycle);
        // The interrupted conversion begins anew after the injected one.
        self.done_at = self.done_at.map(|_| again);
        Ok(())
    }

    /// Ends an injected conversion that is due.
    pub(crate) fn finish_injected(&mut self, now: u64) {
        if self.injected_at.is_some_and(|at| at <= now) {
            self.injected_at = None;
            let channel = usize::from((self.others[0x38 / 4] >> 15 & 31) as u8).min(17);
            self.injected = u32::from(self.share(channel) >> 4);
            self.sr |= JEOC;
        }
    }

    fn length(&self) -> u32 {
        if self.cr1 & CR1_SCAN != 0 {
            (self.sqr[0] >> 20 & 15) + 1
        } else {
            1
        }
    }

    /// Channel at a position of the sequence.
    fn channel(&self, position: u32) -> u8 {
        let word = self.sqr[2 - (position / 6).min(2) as usize];
        (word >> (5 * (position % 6)) & 31) as u8
    }

    /// Code of a channel's sampling time.
    fn code(&self, channel: u8) -> u32 {
        let channel = u32::from(channel);
        let word = if channel < 10 {
            self.smpr[1] >> (3 * channel)
        } else {
            self.smpr[0] >> (3 * (channel - 10).min(7))
        };
        word & 7
    }

    fn takes(&self, channel: u8, cycle: u64) -> u64 {
        // Both are in half cycles.
        (SAMPLING[self.code(channel) as usize] + CONVERSION) * cycle / 2
    }

    fn duration(&self, cycle: u64) -> u64 {
        self.takes(self.channel(self.position), cycle)
    }

    pub fn read(&mut self, offset: u32, now: u64) -> Option<u32> {
        Some(match offset {
            0x00 => self.sr,
            0x04 => self.cr1,
            0x08 => {
                let busy = now < self.calibrated_at;
                self.cr2 & !if busy { 0 } else { CR2_CAL | CR2_RSTCAL }
            }
            0x0C => self.smpr[0],
            0x10 => self.smpr[1],
            0x2C => self.sqr[0],
            0x30 => self.sqr[1],
            0x34 => self.sqr[2],
            0x3C => self.injected,
            0x4C => self.take(),
            0x14..0x4C => self.others[(offset / 4) as usize],
            _ => return None,
        })
    }

    /// The data register, as DMA reads it.
    pub fn take(&mut self) -> u32 {
        // Reading the data clears EOC (RM0008, 11.12.1).
        self.sr &= !EOC;
        self.data
    }

    pub fn write(
        &mut self,
        offset: u32,
        value: u32,
        now: u64,
        cycle: u64,
    ) -> Result<(), &'static str> {
        match offset {
            // Flags are cleared by writing 0.
            0x00 => self.sr &= value,
            0x04 if value & 0xE0 != 0 => return Err("interrupts of the ADC are not emulated"),
            0x04 => self.cr1 = value,
            0x08 => {
                if value & CR2_ADON != 0 && cycle < SHORTEST_CYCLE - 1 {
                    return Err("the ADC's clock is over 14 MHz");
                }
                if value & (CR2_CAL | CR2_RSTCAL) & !self.cr2 != 0 {
                    self.calibrated_at = now + CALIBRATION * cycle;
                }
                let was = self.cr2;
                self.cr2 = value & !(CR2_SWSTART | CR2_JSWSTART);
                let software = value >> 17 & 7 == 7 && value & CR2_EXTTRIG != 0;
                // ADON written once more without any other change starts a conversion (RM0008,
                // 11.3.1).
                let again = was & value & CR2_ADON != 0 && was == value;
                if value & CR2_ADON == 0 {
                    self.done_at = None;
                } else if (value & CR2_SWSTART != 0 && software) || again {
                    if now < self.calibrated_at {
                        return Err("a conversion starts during calibration");
                    }
                    self.position = 0;
                    self.sr |= STRT;
                    self.done_at = Some(now + self.duration(cycle));
                }
                let injects = value >> 12 & 7 == 7 && value & CR2_JEXTTRIG != 0;
                if value & CR2_ADON == 0 {
                    self.injected_at = None;
                } else if value & CR2_JSWSTART != 0 && injects {
                    self.inject(now, cycle)?;
                }
            }
            0x0C => self.smpr[0] = value,
            0x10 => self.smpr[1] = value,
            0x2C => self.sqr[0] = value,
            0x30 => self.sqr[1] = value,
            0x34 => self.sqr[2] = value,
            0x14..0x4C => self.others[(offset / 4) as usize] = value,
            _ => return Err("no such register"),
        }
        Ok(())
    }

    /// Ends the conversion that is due. Returns its channel and whether DMA must fetch it.
    pub fn finish(&mut self, cycle: u64) -> (u8, bool) {
        let channel = self.channel(self.position);
        let index = usize::from(channel).min(17);
        // The fraction is carried on: sixteen conversions add up to the applied sum, as a little
        // noise does it on a real chip.
        let whole = self.share(index) + self.rest[index];
        self.data = u32::from((whole >> 4).min(4095));
        self.rest[index] = whole & 15;
        self.sr |= EOC;
        self.position += 1;
        let ended = self.position >= self.length();
        if ended {
            self.position = 0;
        }
        let goes_on = !ended || self.cr2 & CR2_CONT != 0;
        let next = self.duration(cycle);
        self.done_at = self.done_at.filter(|_| goes_on).map(|at| at + next);
        (channel, self.cr2 & CR2_DMA != 0)
    }
}
