//! The chip: loads a firmware file, runs it in slices of virtual time, and shows its pins.

use crate::bus::{Bus, FLASH, FLASH_BYTES, Halt, RAM, RAM_BYTES};
use crate::core::decode::decode;
use crate::core::op::Op;
use crate::core::{Cpu, Switch, Trap};
use crate::device::TICKS_PER_SECOND;
use crate::device::can_line::{CanFrame, CanWiring};
use crate::device::gpio::Drive;
use crate::device::rcc::{RESET_POWER, RESET_SOFTWARE, RESET_WATCHDOG};
use crate::elf;
use crate::error::{LoadError, ResetBy, Stop};
use crate::scs::{HARD_FAULT, SYSTICK};

/// Ticks of a microsecond.
const TICKS_PER_US: u64 = TICKS_PER_SECOND / 1_000_000;

/// A port.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Port {
    /// GPIOA.
    A,
    /// GPIOB.
    B,
    /// GPIOC.
    C,
    /// GPIOD.
    D,
}

/// What the board's outputs do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Pins {
    /// PB12 to PB15: high opens a brake; floating, the driver's pull-down keeps it closed.
    pub brakes: [Drive; 4],
    /// PA10: high closes.
    pub gripper: Drive,
    /// PC13: low lights.
    pub led: Drive,
}

impl Pins {
    /// Whether a brake is open.
    #[must_use]
    pub fn any_brake_open(&self) -> bool {
        self.brakes.contains(&Drive::High)
    }
}

/// Error counters and states of the CAN controller.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct CanErrors {
    /// Transmit error counter.
    pub transmit: u32,
    /// Receive error counter.
    pub receive: u32,
    /// One of them is over 127: it no longer disturbs others.
    pub passive: bool,
    /// The transmit error counter has passed 255: it is off the bus.
    pub bus_off: bool,
}

/// What the SysTick handler took, over all its runs since power-on or
/// [`Chip::take_tick_stats`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct TickStats {
    /// Handlers that ended.
    pub count: usize,
    /// Median of the instructions of a run.
    pub median: u32,
    /// Most instructions of a run: seen, not proven.
    pub max: u32,
    /// Longest time from SysTick's zero to its handler's first instruction, in ticks of 1/72 us;
    /// estimated, as the cycles are.
    pub latency_max: u64,
    /// SysTick came while the one before was still waiting.
    pub lost: u64,
}

/// Where the SysTick handler spends its instructions.
#[derive(Debug, Clone, Default)]
struct Profile {
    all: std::collections::HashMap<u32, u64>,
    now: Vec<u32>,
    longest: Vec<u32>,
}

impl Profile {
    fn end_tick(&mut self) {
        for pc in &self.now {
            *self.all.entry(*pc).or_default() += 1;
        }
        if self.now.len() > self.longest.len() {
            std::mem::swap(&mut self.now, &mut self.longest);
        }
        self.now.clear();
    }
}

/// An STM32F103C8 with a firmware file in its flash.
#[derive(Debug, Clone)]
pub struct Chip {
    cpu: Cpu,
    bus: Bus,
    decoded: Vec<(Op, u8)>,
    rtt: Option<u32>,
    /// End of the slice, in ticks.
    until: u64,
    /// Where each encoder stands, and where it is to stand after the next slice, in counts.
    encoders: [(i64, i64); 4],
    tick_began: u64,
    ticks: Vec<u32>,
    ticks_done: u32,
    latency_max: u64,
    lost_before: u64,
    instructions_before: u64,
    brakes_opened: bool,
    profile: Option<Box<Profile>>,
    resets: Vec<ResetBy>,
    hangs: bool,
    /// Instructions take this many times their time.
    slowness: u64,
}

impl Chip {
    /// Takes a firmware file (ELF) and powers the chip up. RAM holds arbitrary, but always the
    /// same, bytes.
    ///
    /// # Errors
    /// The file is no firmware for this chip.
    pub fn load(elf: &[u8]) -> Result<Self, LoadError> {
        let image = elf::load(elf)?;
        let mut noise = 0x2545_F491_u32;
        let ram = (0..RAM_BYTES).map(|_| {
            noise ^= noise << 13;
            noise ^= noise >> 17;
            noise ^= noise << 5;
            noise as u8
        });
        let half = |at: usize| {
            let bytes = image.flash.get(at..at + 2).unwrap_or(&[0xFF, 0xFF]);
            u16::from_le_bytes([bytes[0], bytes[1]])
        };
        let decoded = (0..FLASH_BYTES as usize)
            .step_by(2)
            .map(|at| decode(FLASH + at as u32, half(at), half(at + 2)))
            .collect();
        let mut bus = Bus::new(image.flash, ram.collect(), RESET_POWER, 0);
        let cpu = start(&mut bus);
        Ok(Self {
            cpu,
            bus,
            decoded,
            rtt: image.rtt,
            until: 0,
            encoders: [(0, 0); 4],
            tick_began: 0,
            ticks: Vec::new(),
            ticks_done: 0,
            latency_max: 0,
            lost_before: 0,
            instructions_before: 0,
            brakes_opened: false,
            profile: None,
            resets: Vec::new(),
            hangs: false,
            slowness: 1,
        })
    }

    /// Goes on after [`Stop::Reset`]: RAM keeps what it holds, all else is as after a reset by
    /// `by`. What the world applies (levels, voltages, encoders) stays.
    pub fn restart(&mut self, by: ResetBy) {
        let flags = match by {
            ResetBy::Watchdog => RESET_WATCHDOG,
            ResetBy::Software => RESET_SOFTWARE,
        };
        self.resets.push(by);
        self.lost_before += self.bus.scs.ticks_lost;
        self.instructions_before += self.cpu.instructions;
        let old = &mut self.bus;
        let (flash, ram) = (std::mem::take(&mut old.flash), std::mem::take(&mut old.ram));
        let mut bus = Bus::new(flash, ram, flags, old.now);
        for (new, old) in bus.gpio.iter_mut().zip(&old.gpio) {
            new.applied = old.applied;
        }
        bus.adc.applied = old.adc.applied;
        bus.can_line = old.can_line.clone();
        bus.can_line.cut_off();
        bus.usart.sent = std::mem::take(&mut old.usart.sent);
        bus.scs.delivers_faults = old.scs.delivers_faults;
        bus.supply_low = old.supply_low;
        self.bus = bus;
        self.ticks_done = 0;
        self.hangs = false;
        self.cpu = start(&mut self.bus);
    }

    /// Runs for a slice of virtual time. Encoders reach their set positions at its end.
    ///
    /// # Errors
    /// The firmware did something that the chip does not forgive, or was reset.
    pub fn run_us(&mut self, us: u64) -> Result<(), Stop> {
        let begin = self.until.max(self.bus.now);
        self.until += us * TICKS_PER_US;
        for timer in 0..4 {
            let (stands, goes) = self.encoders[timer];
            let (port, pin) = [(0, 8), (0, 0), (0, 6), (1, 6)][timer];
            let gpio = &self.bus.gpio[port];
            let wired = gpio.is_digital_input(pin) && gpio.is_digital_input(pin + 1);
            let cycle = self.bus.timer_cycle(timer);
            let ticks = self.until.saturating_sub(begin).max(1);
            self.bus.timers[timer].turn(goes - stands, begin, ticks, cycle, wired);
            self.encoders[timer].0 = goes;
        }
        while self.bus.now < self.until {
            if self.bus.now >= self.bus.next_event {
                self.bus.service();
            }
            if self.bus.scs.attention {
                self.attend()?;
            }
            if self.cpu.sleeping || self.hangs {
                self.bus.now = self.bus.next_event.min(self.until).max(self.bus.now);
                continue;
            }
            let index = (self.cpu.pc.wrapping_sub(FLASH) >> 1) as usize;
            let (op, length) = match self.decoded.get(index) {
                Some(decoded) => *decoded,
                None => self.fetch()?,
            };
            if let Some(profile) = &mut self.profile
                && self.cpu.ipsr == SYSTICK
            {
                profile.now.push(self.cpu.pc);
            }
            match self.cpu.step(&mut self.bus, op, u32::from(length)) {
                Ok(cycles) => self.bus.now += cycles * self.bus.clocks.core * self.slowness,
                Err(trap) => self.fault(trap)?,
            }
        }
        Ok(())
    }

    /// Instructions outside of flash are decoded each time: RAM may change.
    #[inline(never)]
    fn fetch(&mut self) -> Result<(Op, u8), Stop> {
        let pc = self.cpu.pc;
        let first = self.bus.read(pc, 2);
        let halves = first.and_then(|first| Ok((first, self.bus.read(pc.wrapping_add(2), 2)?)));
        match halves {
            Ok((first, second)) => Ok(decode(pc, first as u16, second as u16)),
            Err(trap) => {
                self.fault(trap)?;
                Ok((Op::Nop, 0))
            }
        }
    }

    /// Whatever may let an exception in, or ends the run.
    #[inline(never)]
    fn attend(&mut self) -> Result<(), Stop> {
        let pc = self.cpu.pc;
        self.account();
        self.brakes_opened |= self.pins().any_brake_open();
        if let Some(halt) = self.bus.halt {
            let by = match halt {
                Halt::Watchdog => ResetBy::Watchdog,
                Halt::Software => ResetBy::Software,
            };
            return Err(Stop::Reset { by, pc });
        }
        if self.hangs {
            return Ok(());
        }
        if let Some(trap) = self.bus.dma_trap.take() {
            return Err(self.stop_of(trap));
        }
        self.bus.raise_lines();
        match self.cpu.take_exception(&mut self.bus) {
            Ok(cycles) => self.bus.now += cycles * self.bus.clocks.core,
            Err(trap) => return Err(self.stop_of(trap)),
        }
        self.account();
        match self.bus.scs.unset_priority.take() {
            Some(exception) => Err(Stop::UnsetPriority { exception, pc }),
            None => Ok(()),
        }
    }

    /// Notes entries to and exits from the tick.
    fn account(&mut self) {
        match self.cpu.switched.take() {
            Some(Switch::Enter(SYSTICK)) => {
                self.tick_began = self.cpu.instructions;
                let latency = self.bus.now.saturating_sub(self.bus.scs.tick_due);
                self.latency_max = self.latency_max.max(latency);
            }
            Some(Switch::Leave(SYSTICK)) => {
                let taken = self.cpu.instructions - self.tick_began;
                if let Some(profile) = &mut self.profile {
                    profile.end_tick();
                }
                self.ticks_done = self.ticks_done.wrapping_add(1);
                self.ticks.push(u32::try_from(taken).unwrap_or(u32::MAX));
            }
            _ => {}
        }
    }

    #[inline(never)]
    fn fault(&mut self, trap: Trap) -> Result<(), Stop> {
        let deliverable = !matches!(trap, Trap::Misuse { .. } | Trap::Breakpoint);
        if !self.bus.scs.delivers_faults || !deliverable {
            return Err(self.stop_of(trap));
        }
        if self.bus.scs.escalate(trap) {
            Ok(())
        } else {
            Err(Stop::LockUp { pc: self.cpu.pc })
        }
    }

    fn stop_of(&mut self, trap: Trap) -> Stop {
        let pc = self.cpu.pc;
        match trap {
            Trap::Undefined => {
                let first = self.bus.read(pc, 2).unwrap_or(0);
                let second = self.bus.read(pc.wrapping_add(2), 2).unwrap_or(0);
                let word = first << 16 | second;
                Stop::Undefined { word, pc }
            }
            Trap::Bus { address, write } => Stop::Unmapped { address, write, pc },
            Trap::ClockOff { address } => Stop::ClockOff { address, pc },
            Trap::Unaligned { address } => Stop::Unaligned { address, pc },
            Trap::State { address } => Stop::BadBranch { address, pc },
            Trap::Breakpoint => Stop::Breakpoint { pc },
            Trap::Misuse { address, what } => Stop::Misuse { what, address, pc },
        }
    }

    /// Whether faults go to the firmware's handler, as on the chip, instead of stopping the run.
    pub fn deliver_faults(&mut self, deliver: bool) {
        self.bus.scs.delivers_faults = deliver;
    }

    /// Raises a hard fault at the present instruction, as broken hardware might.
    pub fn inject_hard_fault(&mut self) {
        self.bus.scs.pend(HARD_FAULT);
    }

    /// The processor executes nothing more until a reset: firmware that hangs with its interrupts
    /// masked. Its peripherals go on.
    pub fn hang(&mut self) {
        self.hangs = true;
    }

    /// From now on every instruction takes `factor` times its time, 1 for as it should: a tick
    /// that has too much to do.
    pub fn slow_down(&mut self, factor: u32) {
        self.slowness = u64::from(factor.max(1));
    }

    /// The supply falls under the threshold of the chip's voltage detector, or recovers. Gives
    /// whether the firmware watches it.
    pub fn set_supply_low(&mut self, low: bool) -> bool {
        self.bus.set_supply_low(low)
    }

    /// Writes a word of RAM, as a debugger does: to begin where a run would take weeks to come to.
    /// Gives whether there is such a word.
    pub fn write_ram(&mut self, address: u32, value: u32) -> bool {
        let in_ram = (RAM..=RAM + RAM_BYTES - 4).contains(&address);
        in_ram && self.bus.write(address, 4, value).is_ok()
    }

    /// Stops the crystal. Where the clock security system watches it, the core gets its NMI and
    /// goes on with the internal oscillator.
    pub fn stop_crystal(&mut self) -> bool {
        let watched = self.bus.rcc.watches_crystal();
        if watched {
            self.bus.scs.pend(2);
        }
        watched
    }

    /// Virtual time since power-on, microseconds.
    #[must_use]
    pub fn now_us(&self) -> u64 {
        self.bus.now / TICKS_PER_US
    }

    /// What the outputs do now.
    #[must_use]
    pub fn pins(&self) -> Pins {
        Pins {
            brakes: [12, 13, 14, 15].map(|pin| self.bus.gpio[1].drive(pin)),
            gripper: self.bus.gpio[0].drive(10),
            led: self.bus.gpio[2].drive(13),
        }
    }

    /// Whether any brake was open at any time since power-on, as seen after every write to a
    /// peripheral.
    #[must_use]
    pub fn brakes_ever_opened(&self) -> bool {
        self.brakes_opened
    }

    /// Applies a level to a pin; `None` leaves it to its pull.
    pub fn set_input(&mut self, port: Port, pin: u8, level: Option<bool>) {
        self.bus.gpio[port as usize].applied[usize::from(pin & 15)] = level;
    }

    /// Turns the encoder of TIM1 to TIM4 (`timer` 1 to 4) to a position in counts, during the next
    /// slice. Edges that the input filter swallows are lost, as on the chip.
    pub fn set_encoder(&mut self, timer: usize, position: i64) {
        if let Some(encoder) = timer.checked_sub(1).and_then(|i| self.encoders.get_mut(i)) {
            encoder.1 = position;
        }
    }

    /// Counts of an encoder that its timer did not see.
    #[must_use]
    pub fn lost_counts(&self, timer: usize) -> u64 {
        let timer = timer.checked_sub(1).and_then(|i| self.bus.timers.get(i));
        timer.map_or(0, |timer| timer.lost)
    }

    /// Applies a voltage to an ADC channel, as the 12 bits that it converts to.
    pub fn set_adc(&mut self, channel: u8, raw: u16) {
        self.set_adc_sixteenths(channel, raw.min(4095) * 16);
    }

    /// The supply as the ADC sees it, V: its internal reference is a share of it. The pins' voltages
    /// are given as shares anyhow, and the voltage detector has [`Self::set_supply_low`].
    pub fn set_supply_v(&mut self, volts: f64) {
        self.bus.adc.set_supply_v(volts);
    }

    /// Applies a voltage to an ADC channel, in sixteenths of a conversion's step (0 to 65520): as
    /// with a little noise, sixteen conversions add up to it.
    pub fn set_adc_sixteenths(&mut self, channel: u8, sum: u16) {
        if let Some(applied) = self.bus.adc.applied.get_mut(usize::from(channel)) {
            *applied = sum.min(4095 * 16);
        }
    }

    /// Puts bytes on the line to USART3. They arrive one after the other, at its baud rate.
    pub fn uart_send(&mut self, bytes: &[u8]) {
        let (now, cycle) = (self.bus.now, self.bus.clocks.apb1);
        self.bus.usart.send(bytes, now, cycle);
        self.bus.plan();
    }

    /// So many of the next bytes to USART3 arrive without a stop bit.
    pub fn uart_damage(&mut self, bytes: u16) {
        let damaged = &mut self.bus.usart.damaged;
        *damaged = damaged.saturating_add(bytes);
    }

    /// Bytes that USART3 has sent since the last call.
    pub fn uart_take(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.bus.usart.sent)
    }

    /// Bytes that came to USART3 before the one before them was read.
    #[must_use]
    pub fn uart_overruns(&self) -> u64 {
        self.bus.usart.overruns
    }

    /// What is connected to the CAN pins. After power-on: nothing.
    pub fn set_can_wiring(&mut self, wiring: CanWiring) {
        self.bus.rewire_can(wiring);
    }

    /// Destroys the next frames on the bus, whoever sends them.
    pub fn destroy_can_frames(&mut self, count: u32) {
        self.bus.can_line.destroy = count;
    }

    /// Another node wants to send a frame from `at_us` on (at once, where that is past). It goes
    /// over the bus when that is free and nothing more urgent waits, and again until it passes.
    pub fn can_send(&mut self, at_us: u64, frame: CanFrame) {
        let at = (at_us * TICKS_PER_US).max(self.bus.now);
        self.bus.can_line.offer(at, frame);
        self.bus.plan();
    }

    /// Frames of the chip that the other nodes have received since the last call, each with the
    /// time of its end in microseconds.
    pub fn can_take(&mut self) -> Vec<(u64, CanFrame)> {
        let taken = std::mem::take(&mut self.bus.can_line.delivered);
        let taken = taken.into_iter();
        taken
            .map(|(at, frame)| (at / TICKS_PER_US, frame))
            .collect()
    }

    /// What the CAN controller counts.
    #[must_use]
    pub fn can_errors(&self) -> CanErrors {
        CanErrors {
            transmit: self.bus.can.tec,
            receive: self.bus.can.rec,
            passive: self.bus.can.is_passive(),
            bus_off: self.bus.can.is_bus_off(),
        }
    }

    /// Instructions since power-on.
    #[must_use]
    pub fn instructions(&self) -> u64 {
        self.instructions_before + self.cpu.instructions
    }

    /// The resets since power-on, in their order.
    #[must_use]
    pub fn resets(&self) -> &[ResetBy] {
        &self.resets
    }

    /// Runs of the SysTick handler since the last reset that have ended.
    #[must_use]
    pub const fn ticks_since_reset(&self) -> u32 {
        self.ticks_done
    }

    /// From now on keeps where the SysTick handler's instructions lie.
    pub fn profile_ticks(&mut self) {
        self.profile = Some(Box::default());
    }

    /// Addresses of the SysTick handler's instructions since [`Self::profile_ticks`], each with
    /// how often it was executed in all ticks, and in the longest one.
    #[must_use]
    pub fn tick_profile(&self) -> Vec<(u32, u64, u64)> {
        let Some(profile) = &self.profile else {
            return Vec::new();
        };
        let mut counts: std::collections::BTreeMap<u32, (u64, u64)> = profile
            .all
            .iter()
            .map(|(&pc, &all)| (pc, (all, 0)))
            .collect();
        for pc in &profile.longest {
            counts.entry(*pc).or_default().1 += 1;
        }
        let counts = counts.into_iter();
        counts
            .map(|(pc, (all, longest))| (pc, all, longest))
            .collect()
    }

    /// What the SysTick handler took so far.
    #[must_use]
    pub fn tick_stats(&self) -> TickStats {
        let mut sorted = self.ticks.clone();
        sorted.sort_unstable();
        TickStats {
            count: sorted.len(),
            median: sorted.get(sorted.len() / 2).copied().unwrap_or(0),
            max: sorted.last().copied().unwrap_or(0),
            latency_max: self.latency_max,
            lost: self.lost_before + self.bus.scs.ticks_lost,
        }
    }

    /// As [`Self::tick_stats`], and begins anew.
    pub fn take_tick_stats(&mut self) -> TickStats {
        let stats = self.tick_stats();
        self.ticks.clear();
        self.latency_max = 0;
        self.lost_before = 0;
        self.bus.scs.ticks_lost = 0;
        stats
    }

    /// Lowest stack pointer since the last reset: an address.
    #[must_use]
    pub fn stack_low_water(&self) -> u32 {
        self.cpu.lowest_sp
    }

    /// Takes what lies in the first up-channel of the RTT block, as a probe would.
    pub fn rtt_take(&mut self) -> Vec<u8> {
        let mut taken = Vec::new();
        let Some(block) = self
            .rtt
            .filter(|at| (RAM..RAM + RAM_BYTES - 48).contains(at))
        else {
            return taken;
        };
        let mut word = |offset: u32| self.bus.read(block + offset, 4).unwrap_or(0);
        let (id, buffer, size, write, mut read) = (word(0), word(28), word(32), word(36), word(40));
        let initialised = id.to_le_bytes() == *b"SEGG";
        if !initialised || size > RAM_BYTES || write >= size || read >= size {
            return taken;
        }
        while read != write {
            taken.push(self.bus.read(buffer + read, 1).unwrap_or(0) as u8);
            read = (read + 1) % size;
        }
        // The place was just read, so it can be written.
        let _ = self.bus.write(block + 40, 4, read);
        taken
    }
}

/// The core as reset leaves it.
fn start(bus: &mut Bus) -> Cpu {
    let stack = bus.read(FLASH, 4).unwrap_or(0);
    let entry = bus.read(FLASH + 4, 4).unwrap_or(0);
    Cpu::new(stack, entry)
}
