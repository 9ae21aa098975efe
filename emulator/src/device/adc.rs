//! ADC1: calibration, scans, DMA requests (RM0008, 11).

const CR2_ADON: u32 = 1;
const CR2_CONT: u32 = 2;
const CR2_CAL: u32 = 4;
const CR2_RSTCAL: u32 = 8;
const CR2_DMA: u32 = 1 << 8;
const CR2_EXTTRIG: u32 = 1 << 20;
const CR2_SWSTART: u32 = 1 << 22;
const CR1_SCAN: u32 = 1 << 8;
const EOC: u32 = 2;
const STRT: u32 = 16;
/// Sampling times, in half cycles.
const SAMPLING: [u64; 8] = [3, 15, 27, 57, 83, 111, 143, 479];
/// Conversion after sampling, in half cycles.
const CONVERSION: u64 = 25;
/// Cycles of a calibration.
const CALIBRATION: u64 = 83;
/// The supply limits the converter's clock to 14 MHz: at least this many ticks.
const SHORTEST_CYCLE: u64 = 6;

#[derive(Debug, Clone, Default)]
pub(crate) struct Adc {
    sr: u32,
    cr1: u32,
    cr2: u32,
    smpr: [u32; 2],
    /// JOFR, HTR, LTR, JSQR: kept, without effect.
    others: [u32; 20],
    sqr: [u32; 3],
    data: u32,
    position: u32,
    calibrated_at: u64,
    pub done_at: Option<u64>,
    /// What lies at each channel, in sixteenths of a step.
    pub applied: [u16; 18],
    /// What conversions have not told yet, in sixteenths.
    rest: [u16; 18],
}

impl Adc {
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

    fn duration(&self, cycle: u64) -> u64 {
        let channel = u32::from(self.channel(self.position));
        let code = if channel < 10 {
            self.smpr[1] >> (3 * channel)
        } else {
            self.smpr[0] >> (3 * (channel - 10).min(7))
        };
        (SAMPLING[(code & 7) as usize] + CONVERSION) * cycle / 2
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
            0x4C => self.take(),
            0x14..0x4C => self.others[(offset / 4) as usize],
            _ => return None,
        })
    }

    /// The data register, as DMA reads it.
    pub fn take(&mut self) -> u32 {
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
                self.cr2 = value & !CR2_SWSTART;
                let software = value >> 17 & 7 == 7 && value & CR2_EXTTRIG != 0;
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

    /// Ends the conversion that is due. Gives its channel and whether DMA shall fetch it.
    pub fn finish(&mut self, cycle: u64) -> (u8, bool) {
        let channel = self.channel(self.position);
        let index = usize::from(channel).min(17);
        let whole = self.applied[index] + self.rest[index];
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
