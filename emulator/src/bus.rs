//! Memory map, time and scheduled events.

use crate::device::TICKS_PER_SECOND;
use crate::device::adc::Adc;
use crate::device::can::Can;
use crate::device::can_line::{CanLine, CanWiring};
use crate::device::dma::Dma;
use crate::device::gpio::Gpio;
use crate::device::rcc::{Clocks, Rcc};
use crate::device::supply::Supply;
use crate::device::timer::Timer;
use crate::device::usart::Usart;
use crate::device::watchdog::Watchdog;
use crate::scs::Scs;
use crate::trap::Trap;

mod registers;

/// Where flash begins.
pub(crate) const FLASH: u32 = 0x0800_0000;
/// Its size in bytes.
pub(crate) const FLASH_BYTES: u32 = 64 * 1024;
/// Where RAM begins.
pub(crate) const RAM: u32 = 0x2000_0000;
/// Its size in bytes.
pub(crate) const RAM_BYTES: u32 = 20 * 1024;
/// Unique id, words.
const UID: [u32; 3] = [0x0042_0031, 0x3431_5104, 0x3530_3832];

const ADC_CHANNEL: usize = 0;
const SEND_CHANNEL: usize = 1;
const RECEIVE_CHANNEL: usize = 2;
/// Interrupt of DMA1 channel 1.
const DMA_IRQ: u8 = 11;
/// The supply has fallen under its threshold (EXTI line 16).
const PVD_IRQ: u8 = 1;
const PVD_LINE: u32 = 1 << 16;
/// PWR_CR: the supply is watched, and at which level; PWR_CSR: it is low.
const PVDE: u32 = 1 << 4;
const PLS_SHIFT: u32 = 5;
const PVDO: u32 = 1 << 2;
const USART3_IRQ: u8 = 39;
/// Transmit; FIFO 0, FIFO 1 and status follow.
const CAN_IRQ: u8 = 19;
/// Field of AFIO_MAPR that says where CAN's pins are, and its value for PB8 and PB9.
const CAN_REMAP: u32 = 3 << 13;
const CAN_ON_B: u32 = 2 << 13;
/// Field of AFIO_MAPR that cannot be read.
const SWJ_CFG: u32 = 7 << 24;

/// Requests of the chip for a reset.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Halt {
    Watchdog,
    Software,
}

#[derive(Debug, Clone)]
pub(crate) struct Bus {
    pub flash: Vec<u8>,
    pub ram: Vec<u8>,
    /// Time since power-on, in ticks.
    pub now: u64,
    pub clocks: Clocks,
    /// Core cycles when the core clock last changed, and when that was.
    cycles_then: u64,
    changed_at: u64,
    pub next_event: u64,
    pub halt: Option<Halt>,
    pub scs: Scs,
    pub rcc: Rcc,
    pub gpio: [Gpio; 4],
    pub timers: [Timer; 4],
    pub adc: Adc,
    dma: Dma,
    pub usart: Usart,
    pub can: Can,
    pub can_line: CanLine,
    pub watchdog: Watchdog,
    /// Its identification.
    pub identity: Identity,
    /// The real-time clock's divider: what it was loaded with, and when.
    rtc: (u32, u64),
    /// The backup registers, which a reset leaves.
    pub(crate) backup: [u16; 10],
    afio: [u32; 8],
    exti: [u32; 6],
    debug: u32,
    power: u32,
    pub supply: Supply,
    /// A failed DMA transfer; reported at the next opportunity.
    pub dma_trap: Option<Trap>,
}

/// A chip's identification: an STM32F103C8, unless changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Identity {
    /// DBGMCU_IDCODE: revision above, device below.
    pub id_code: u32,
    /// Maker of the chip in the core's table of components (JEP106 code).
    pub maker: u32,
    /// Factory's register of the flash's size, KiB.
    pub flash_kib: u32,
    /// Tells the chips of one robot apart: it is added to the words of the chip's number.
    pub number: u32,
}

impl Default for Identity {
    fn default() -> Self {
        Self {
            id_code: 0x2003_6410,
            maker: 0x20,
            flash_kib: 64,
            number: 0,
        }
    }
}

impl Identity {
    /// The identification registers at the end of the table of components.
    const fn component(&self, address: u32) -> u32 {
        match address & 0xFFF {
            0xFE0 => self.id_code & 0xFF,
            0xFE4 => (self.id_code >> 8 & 0xF) | (self.maker & 0xF) << 4,
            0xFE8 => 8 | self.maker >> 4 & 7,
            _ => 0,
        }
    }
}

/// The peripherals on the bus, with the bit of the clock that each needs.
#[derive(Debug, Clone, Copy)]
enum Place {
    Timer(usize),
    Usart,
    Can,
    Watchdog,
    Afio,
    Exti,
    Gpio(usize),
    Adc,
    Dma,
    Rcc,
    Flash,
    Debug,
    Power,
    Backup,
    Clock,
}

impl Bus {
    pub fn new(flash: Vec<u8>, ram: Vec<u8>, reset_flags: u32, now: u64) -> Self {
        Self {
            flash,
            ram,
            now,
            clocks: Clocks {
                // 8 MHz after a reset: nine ticks of 72 MHz per cycle.
                core: 9,
                apb1: 9,
                timers1: 9,
                apb2: 9,
                adc: 18,
            },
            cycles_then: 0,
            changed_at: now,
            next_event: u64::MAX,
            halt: None,
            scs: Scs::new(),
            rcc: Rcc::new(reset_flags),
            gpio: [(); 4].map(|()| Gpio::new([None; 16])),
            timers: [(); 4].map(|()| Timer::new()),
            adc: Adc::default(),
            dma: Dma::default(),
            usart: Usart::new(),
            can: Can::new(),
            can_line: CanLine::new(),
            watchdog: Watchdog::new(),
            identity: Identity::default(),
            rtc: (0x8000, 0),
            backup: [0; 10],
            afio: [0; 8],
            exti: [0; 6],
            debug: 0,
            power: 0,
            supply: Supply::default(),
            dma_trap: None,
        }
    }

    /// Core cycles since reset.
    pub const fn cycles(&self) -> u64 {
        self.cycles_then + (self.now - self.changed_at) / self.clocks.core
    }

    /// Ticks of a timer's clock.
    pub(crate) const fn timer_cycle(&self, timer: usize) -> u64 {
        if timer == 0 {
            self.clocks.apb2
        } else {
            self.clocks.timers1
        }
    }

    #[inline(always)]
    pub fn read(&mut self, address: u32, size: u32) -> Result<u32, Trap> {
        let in_ram = address.wrapping_sub(RAM);
        // One comparison with wrapping: addresses below RAM become large.
        if in_ram <= RAM_BYTES - size {
            return Ok(fetch(&self.ram, in_ram, size));
        }
        let in_flash = address.wrapping_sub(FLASH);
        if in_flash <= FLASH_BYTES - size {
            return Ok(fetch(&self.flash, in_flash, size));
        }
        self.read_slow(address, size)
    }

    #[inline(always)]
    pub fn write(&mut self, address: u32, size: u32, value: u32) -> Result<(), Trap> {
        let in_ram = address.wrapping_sub(RAM);
        if in_ram <= RAM_BYTES - size {
            let at = in_ram as usize;
            if let Some(slot) = self.ram.get_mut(at..at + size as usize) {
                slot.copy_from_slice(&value.to_le_bytes()[..size as usize]);
            }
            return Ok(());
        }
        self.write_slow(address, size, value)
    }

    /// Word and bit behind an address of a bit-band region.
    fn bit_band(address: u32) -> Option<(u32, u32)> {
        let base = match address {
            0x2200_0000..=0x23FF_FFFF => 0x2000_0000,
            0x4200_0000..=0x43FF_FFFF => 0x4000_0000,
            _ => return None,
        };
        // Each bit has a word of its own (ARMv7-M, bit-banding): 32 words per byte times four.
        let offset = address & 0x01FF_FFFF;
        Some((base + (offset / 128) * 4, offset / 4 % 32))
    }

    #[inline(never)]
    fn read_slow(&mut self, address: u32, size: u32) -> Result<u32, Trap> {
        if let Some((word, bit)) = Self::bit_band(address) {
            return Ok(self.read(word, 4)? >> bit & 1);
        }
        let trap = Trap::Bus {
            address,
            write: false,
        };
        match address {
            // Boot pins choose flash: it appears at zero too.
            0..FLASH_BYTES => self.read(address + FLASH, size),
            0xE00F_F000..0xE010_0000 if size == 4 => Ok(self.identity.component(address)),
            0x4000_0000..0x4002_4000 | 0xE000_0000..=0xE00F_FFFF => {
                if address & (size - 1) != 0 {
                    return Err(Trap::Unaligned { address });
                }
                let word = self.read_register(address & !3)?;
                let mask = if size == 4 {
                    u32::MAX
                } else {
                    (1 << (8 * size)) - 1
                };
                Ok(word >> (8 * (address & 3)) & mask)
            }
            0x1FFF_F7E0 if size == 2 || size == 4 => Ok(self.identity.flash_kib),
            0x1FFF_F7E8..0x1FFF_F7F4 if size == 4 && address & 3 == 0 => {
                let word = ((address - 0x1FFF_F7E8) / 4) as usize;
                Ok(UID[word].wrapping_add(self.identity.number))
            }
            _ => Err(trap),
        }
    }

    #[inline(never)]
    fn write_slow(&mut self, address: u32, size: u32, value: u32) -> Result<(), Trap> {
        if let Some((word, bit)) = Self::bit_band(address) {
            // Read, change, write: as the bus matrix does it, in one access of the core.
            let old = self.read(word, 4)?;
            return self.write(word, 4, old & !(1 << bit) | (value & 1) << bit);
        }
        if address & (size - 1) != 0 {
            return Err(Trap::Unaligned { address });
        }
        let lane = 1 << (address & 3);
        let shifted = value << (8 * (address & 3));
        // Priorities are the only registers that this firmware writes by bytes.
        let first = match address {
            0xE000_E400..=0xE000_E42B => 16 + (address - 0xE000_E400) as u8,
            0xE000_ED18..=0xE000_ED23 => 4 + (address - 0xE000_ED18) as u8,
            _ => 0,
        };
        if first != 0 && size == 1 {
            self.scs.set_priorities(first, shifted, lane);
            return Ok(());
        }
        // Priorities of interrupts that this chip lacks.
        if (0xE000_E42C..=0xE000_E5EF).contains(&address) {
            return Ok(());
        }
        match address {
            0x4000_0000..0x4002_4000 | 0xE000_0000..=0xE00F_FFFF if size == 4 => {
                self.write_register(address, value)
            }
            // Registers of 16 bits in a word of their own.
            0x4000_0000..0x4001_0000 if size == 2 && address & 3 == 0 => {
                self.write_register(address, value & 0xFFFF)
            }
            _ => Err(Trap::Bus {
                address,
                write: true,
            }),
        }
    }

    /// The supply's voltage from now on.
    pub fn set_supply_v(&mut self, volts: f64) {
        self.supply.volts = volts;
        self.adc.set_supply_v(volts);
        self.detect_supply();
    }

    /// Whether a fall of the supply interrupts: detector on, EXTI line unmasked, and its rising edge selected.
    pub(crate) const fn watches_supply(&self) -> bool {
        self.power & PVDE != 0 && self.exti[0] & PVD_LINE != 0 && self.exti[2] & PVD_LINE != 0
    }

    /// Brings the voltage detector up to date.
    fn detect_supply(&mut self) {
        let level = (self.power & PVDE != 0).then_some(self.power >> PLS_SHIFT);
        // An edge: a supply that was low before the line was set up gives none.
        if self.supply.detect(level) && self.watches_supply() {
            self.scs.pend_irq(PVD_IRQ);
        }
    }

    /// Feeds the transmitter while DMA has bytes for it.
    fn serve_sender(&mut self) {
        while self.usart.wants_byte() && self.dma.is_ready(SEND_CHANNEL) {
            self.transfer(SEND_CHANNEL);
        }
    }

    /// A bit of the chip's CAN, in ticks.
    const fn can_bit(&self) -> u64 {
        self.can.bit_cycles() * self.clocks.apb1
    }

    /// Whether CAN has its receive pin and its transmit pin.
    fn can_wired(&self) -> (bool, bool) {
        let remapped = self.afio[1] & CAN_REMAP == CAN_ON_B;
        let sends = self.gpio[1].drive(9) == crate::device::gpio::Drive::Peripheral;
        (
            remapped && self.gpio[1].is_digital_input(8),
            remapped && sends,
        )
    }

    fn write_can(&mut self, offset: u32, value: u32) -> Result<(), &'static str> {
        let idle_at = self.can_line.idle_from(self.now);
        let bit = self.can_bit();
        self.can.write(offset, value, idle_at, bit)?;
        self.can.abort_waiting(self.can_line.busy());
        self.serve_can();
        Ok(())
    }

    /// Changes the connection of the CAN pins.
    pub(crate) fn rewire_can(&mut self, wiring: CanWiring) {
        self.can_line.wiring = wiring;
        // Nodes that waited for a shorted bus to be idle start waiting anew.
        if self.can.joins_at == Some(u64::MAX) && !wiring.shorted {
            self.can.joins_at = Some(self.now + self.can.join_bits() * self.can_bit());
        }
        self.plan();
    }

    /// Brings the CAN bus up to date.
    pub(crate) fn serve_can(&mut self) {
        let (now, bit, wired) = (self.now, self.can_bit(), self.can_wired());
        self.can_line.service(&mut self.can, now, bit, wired);
        self.can.loop_back();
    }

    /// One DMA transfer.
    fn transfer(&mut self, channel: usize) {
        let Some(transfer) = self.dma.request(channel) else {
            return;
        };
        let moved = self.move_one(
            transfer.from,
            transfer.from_bytes,
            transfer.to,
            transfer.to_bytes,
        );
        if let Err(trap) = moved {
            self.dma.fail(channel);
            self.dma_trap = Some(trap);
        }
        self.scs.attention = true;
    }

    fn move_one(&mut self, from: u32, from_bytes: u32, to: u32, to_bytes: u32) -> Result<(), Trap> {
        // DMA reads whole registers; their side effects happen as for the core.
        let value = if from >= 0x4000_0000 {
            self.read_register(from & !3)?
        } else {
            self.read(from, from_bytes.min(4))?
        };
        if to >= 0x4000_0000 {
            // Not through `write_register`: that would feed the transmitter from within.
            let address = to & !3;
            let (Place::Usart, offset) = self.place(address)? else {
                return Err(Trap::Misuse {
                    address,
                    what: "DMA writes to a peripheral that sends nothing",
                });
            };
            self.usart
                .write(offset, value, self.now, self.clocks.apb1)
                .map_err(|what| Trap::Misuse { address, what })
        } else {
            self.write(to, to_bytes.min(4), value)
        }
    }

    /// Brings all peripherals up to date.
    pub fn service(&mut self) {
        let now = self.now;
        self.adc.finish_injected(now);
        while self.adc.done_at.is_some_and(|at| at <= now) {
            let (channel, fetch) = self.adc.finish(self.clocks.adc);
            // PA0 to PA7, PB0 and PB1, PC0 to PC5.
            let analog = match channel {
                0..8 => self.gpio[0].is_analog(channel),
                8 | 9 => self.gpio[1].is_analog(channel - 8),
                10..16 => self.gpio[2].is_analog(channel - 10),
                _ => true,
            };
            if !analog {
                self.dma_trap = Some(Trap::Misuse {
                    address: 0x4001_2400,
                    what: "the ADC converts a pin that is not analog",
                });
                self.scs.attention = true;
            }
            if fetch {
                self.transfer(ADC_CHANNEL);
            }
        }
        while self.usart.sent_at.is_some_and(|at| at <= now) {
            let wired = self.gpio[1].drive(10) == crate::device::gpio::Drive::Peripheral;
            self.usart.leave(self.clocks.apb1, wired);
            self.serve_sender();
            self.scs.attention = true;
        }
        while self.usart.arrives_at.is_some_and(|at| at <= now) {
            let wired = self.gpio[1].is_digital_input(11);
            self.usart.arrive(self.clocks.apb1, wired);
            if self.usart.offers_byte() {
                self.transfer(RECEIVE_CHANNEL);
            }
            self.scs.attention = true;
        }
        if self.can_line.next_event(&self.can, now) <= now {
            self.serve_can();
            self.scs.attention = true;
        }
        if self.watchdog.barks_at.is_some_and(|at| at <= now) {
            self.halt = Some(Halt::Watchdog);
            self.scs.attention = true;
        }
        self.scs.service(now, self.clocks.core);
        self.plan();
    }

    /// Time of the next event.
    pub fn plan(&mut self) {
        let never = u64::MAX;
        self.next_event = self
            .scs
            .next_event()
            .min(self.adc.next_event())
            .min(self.usart.sent_at.unwrap_or(never))
            .min(self.usart.arrives_at.unwrap_or(never))
            .min(self.can_line.next_event(&self.can, self.now))
            .min(self.watchdog.barks_at.unwrap_or(never));
    }

    /// Shows the interrupt lines to the NVIC.
    pub(crate) fn raise_lines(&mut self) {
        for (irq, channel) in (DMA_IRQ..).zip(0..7) {
            if self.dma.interrupts(channel) {
                self.scs.raise(irq);
            }
        }
        if self.usart.interrupts() {
            self.scs.raise(USART3_IRQ);
        }
        for (irq, raised) in (CAN_IRQ..).zip(self.can.interrupts()) {
            if raised {
                self.scs.raise(irq);
            }
        }
    }
}

#[inline(always)]
fn fetch(memory: &[u8], offset: u32, size: u32) -> u32 {
    let rest = memory.get(offset as usize..).unwrap_or_default();
    match size {
        1 => rest.first().copied().map_or(0, u32::from),
        2 => rest
            .first_chunk::<2>()
            .map_or(0, |b| u32::from(u16::from_le_bytes(*b))),
        _ => rest
            .first_chunk::<4>()
            .map_or(0, |b| u32::from_le_bytes(*b)),
    }
}
