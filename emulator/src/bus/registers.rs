//! Address decoding of the peripherals, their clocks, and the effects of their registers.

use super::*;

impl Bus {
    pub(super) fn place(&self, address: u32) -> Result<(Place, u32), Trap> {
        let (apb1, apb2, ahb) = (self.rcc.apb1enr, self.rcc.apb2enr, self.rcc.ahbenr);
        let always = 1;
        // RM0008, 3.3 (memory map) and 7.3 (clock enables): each peripheral has 1 KB and one bit.
        let (place, clocked) = match address & !0x3FF {
            0x4000_0000 => (Place::Timer(1), apb1),
            0x4000_0400 => (Place::Timer(2), apb1 >> 1),
            0x4000_0800 => (Place::Timer(3), apb1 >> 2),
            0x4000_2800 => (Place::Clock, apb1 >> 27),
            0x4000_3000 => (Place::Watchdog, always),
            0x4000_4800 => (Place::Usart, apb1 >> 18),
            0x4000_6400 => (Place::Can, apb1 >> 25),
            0x4000_6C00 => (Place::Backup, apb1 >> 27),
            0x4000_7000 => (Place::Power, apb1 >> 28),
            0x4001_0000 => (Place::Afio, apb2),
            0x4001_0400 => (Place::Exti, always),
            0x4001_0800 => (Place::Gpio(0), apb2 >> 2),
            0x4001_0C00 => (Place::Gpio(1), apb2 >> 3),
            0x4001_1000 => (Place::Gpio(2), apb2 >> 4),
            0x4001_1400 => (Place::Gpio(3), apb2 >> 5),
            0x4001_2400 => (Place::Adc, apb2 >> 9),
            0x4001_2C00 => (Place::Timer(0), apb2 >> 11),
            0x4002_0000 => (Place::Dma, ahb),
            0x4002_1000 => (Place::Rcc, always),
            0x4002_2000 => (Place::Flash, always),
            0xE004_2000 => (Place::Debug, always),
            _ => {
                return Err(Trap::Bus {
                    address,
                    write: false,
                });
            }
        };
        // A real peripheral without its clock reads as zero and ignores writes: a fault that is
        // hard to find.
        if clocked & 1 == 0 {
            return Err(Trap::ClockOff { address });
        }
        Ok((place, address & 0x3FF))
    }

    pub(super) fn read_register(&mut self, address: u32) -> Result<u32, Trap> {
        let missing = Trap::Bus {
            address,
            write: false,
        };
        let now = self.now;
        if (0xE000_0000..0xE000_F000).contains(&address) {
            let (cost, cycles) = (self.clocks.core, self.cycles());
            return self.scs.read(address, now, cost, cycles).ok_or(missing);
        }
        let (place, offset) = self.place(address)?;
        let index = (offset / 4) as usize;
        let value = match place {
            Place::Timer(timer) => {
                let cycle = self.timer_cycle(timer);
                self.timers[timer].read(offset, now, cycle)
            }
            Place::Watchdog => self.watchdog.read(offset),
            Place::Usart => self.usart.read(offset),
            Place::Can => self.can.read(offset),
            // The configuration of the debug pins can only be written.
            Place::Afio if index == 1 => Some(self.afio[1] & !SWJ_CFG),
            Place::Afio => self.afio.get(index).copied(),
            Place::Exti => self.exti.get(index).copied(),
            Place::Gpio(port) => self.gpio[port].read(offset),
            Place::Adc => self.adc.read(offset, now),
            Place::Dma => self.dma.read(offset),
            Place::Rcc => self.rcc.read(offset, now),
            Place::Flash => {
                // The prefetch status follows its enable.
                (offset == 0).then_some(self.rcc.flash_acr | self.rcc.flash_acr << 1 & 32)
            }
            Place::Power => {
                let low = if self.supply.low { PVDO } else { 0 };
                [self.power, low].get(index).copied()
            }
            // DR1 to DR10 (RM0008, 6.4.1); the rest is not emulated.
            Place::Backup => Some(index.checked_sub(1).map_or(0, |place| {
                self.backup.get(place).copied().unwrap_or(0).into()
            })),
            Place::Clock => {
                let (from, since) = self.rtc;
                let hz = self.watchdog.oscillator_hz;
                // Source LSI, enabled.
                // RTCEN, and RTCSEL = 10.
                let runs = self.rcc.backup() & 0x8300 == 0x8200;
                let passed = if runs {
                    (now - since) * hz / TICKS_PER_SECOND
                } else {
                    0
                };
                // Counts down, and is reloaded after zero.
                let left = u64::from(from) - passed % (u64::from(from) + 1);
                match offset {
                    // Synchronised, and ready for a write.
                    0x04 => Some(0x28),
                    0x10 => Some((left >> 16) as u32 & 15),
                    0x14 => Some(left as u32 & 0xFFFF),
                    _ => Some(0),
                }
            }
            Place::Debug => match offset {
                0 => Some(self.identity.id_code),
                4 => Some(self.debug),
                _ => None,
            },
        };
        value.ok_or(missing)
    }

    pub(super) fn write_register(&mut self, address: u32, value: u32) -> Result<(), Trap> {
        let missing = Trap::Bus {
            address,
            write: true,
        };
        let now = self.now;
        if (0xE000_0000..0xE000_F000).contains(&address) {
            let (cost, cycles) = (self.clocks.core, self.cycles());
            self.scs
                .write(address, value, now, cost, cycles)
                .ok_or(missing)?;
            // Only requested: the run ends at the next opportunity, not inside a write.
            if self.scs.reset_requested {
                self.halt = Some(Halt::Software);
            }
            self.plan();
            return Ok(());
        }
        let (place, offset) = self.place(address)?;
        let index = (offset / 4) as usize;
        let done = match place {
            Place::Timer(timer) => self.timers[timer].write(offset, value, now),
            Place::Watchdog => self.watchdog.write(offset, value, now),
            Place::Usart => self.usart.write(offset, value, now, self.clocks.apb1),
            Place::Can => self.write_can(offset, value),
            Place::Adc => self.adc.write(offset, value, now, self.clocks.adc),
            Place::Dma => self.dma.write(offset, value),
            Place::Rcc => self.rcc.write(offset, value, now),
            Place::Flash if offset == 0 => {
                self.rcc.flash_acr = value & 0x1F;
                Ok(())
            }
            Place::Gpio(port) => self.gpio[port]
                .write(offset, value)
                .ok_or("no such register"),
            Place::Afio if index < self.afio.len() => {
                self.afio[index] = value;
                Ok(())
            }
            // Pending bits are cleared by writing them.
            Place::Exti if index == 5 => Ok(()),
            // The supply's line is the only one that is emulated: others would seem to work.
            Place::Exti if index < self.exti.len() && value & !PVD_LINE == 0 => {
                self.exti[index] = value;
                Ok(())
            }
            Place::Power if offset == 0 => {
                self.power = value;
                self.detect_supply();
                Ok(())
            }
            // PWR_CR, bit 8 (RM0008, 5.4.1).
            Place::Backup | Place::Clock if self.power & 1 << 8 == 0 => {
                Err("the backup domain is write-protected (DBP)")
            }
            Place::Backup => {
                let place = index.checked_sub(1);
                if let Some(register) = place.and_then(|place| self.backup.get_mut(place)) {
                    // Registers of 16 bits.
                    *register = value as u16;
                }
                Ok(())
            }
            Place::Clock => {
                let from = self.rtc.0;
                match offset {
                    0x08 => self.rtc = ((from & 0xFFFF) | (value & 15) << 16, now),
                    0x0C => self.rtc = ((from & 0xF_0000) | (value & 0xFFFF), now),
                    _ => {}
                }
                Ok(())
            }
            Place::Debug if offset == 4 => {
                self.debug = value;
                Ok(())
            }
            _ => return Err(missing),
        };
        done.map_err(|what| Trap::Misuse { address, what })?;
        // Wait states and clock belong together: either write may make the other invalid.
        if matches!(place, Place::Rcc | Place::Flash) {
            let clocks = self
                .rcc
                .clocks()
                .map_err(|what| Trap::Misuse { address, what })?;
            self.cycles_then = self.cycles();
            self.changed_at = now;
            self.clocks = clocks;
        }
        self.serve_sender();
        self.scs.attention = true;
        self.plan();
        Ok(())
    }
}
