//! The chip: loads a firmware file, runs it in slices of virtual time, and shows its pins.

use crate::bus::{Bus, FLASH, FLASH_BYTES, Halt, RAM_BYTES};
use crate::core::decode::decode;
use crate::core::op::Op;
use crate::core::{Cpu, Switch};
use crate::device::TICKS_PER_SECOND;
use crate::device::can_line::CanFrame;
use crate::device::encoder_line::Lines;
use crate::device::gpio::Drive;
use crate::device::rcc::{RESET_POWER, RESET_SOFTWARE, RESET_WATCHDOG};
use crate::device::supply::Supply;
use crate::device::timer::Slice;
use crate::elf;
use crate::error::{LoadError, ResetBy, Stop};
use crate::scs::SYSTICK;
use crate::trap::Trap;

mod figures;
mod power;
mod wires;

use power::Power;

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

/// Effect of the board's outputs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Pins {
    /// PB12 to PB15: high opens a brake; floating, the driver's pull-down keeps it closed.
    pub brakes: [Drive; 4],
    /// PB3: high enables the drives' power; floating, a pull-down does not.
    pub drive_enable: Drive,
    /// PA10: high closes.
    pub gripper: Drive,
    /// PC13: low lights.
    pub led: Drive,
    /// PA11: low keeps the fault line from falling.
    pub well: Drive,
}

impl Pins {
    /// Whether a brake is open.
    #[must_use]
    pub fn any_brake_open(&self) -> bool {
        self.brakes.contains(&Drive::High)
    }

    /// The outputs that are high: the brakes from bit 0, then gripper and drive enable.
    fn high(&self) -> u8 {
        let [a, b, c, d] = self.brakes;
        let outputs = [a, b, c, d, self.gripper, self.drive_enable].into_iter();
        let bits = (0..6).zip(outputs);
        bits.fold(0, |bits, (place, drive)| {
            bits | u8::from(drive == Drive::High) << place
        })
    }
}

/// How often an instruction was executed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ProfileRow {
    /// Its address.
    pub address: u32,
    /// In all ticks.
    pub all: u64,
    /// In the longest tick.
    pub longest: u64,
}

/// A frame that the chip sent and another node received.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SentFrame {
    /// When it ended, us.
    pub ends_at_us: u64,
    /// The frame.
    pub frame: CanFrame,
}

/// Error counters and states of the CAN controller.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct CanErrors {
    /// Transmit error counter.
    pub transmit: u32,
    /// Receive error counter.
    pub receive: u32,
    /// One of them is above 127: it no longer disturbs others.
    pub passive: bool,
    /// The transmit error counter has passed 255: it is off the bus.
    pub bus_off: bool,
}

/// Duration of the SysTick handler, over all its runs since power-on or [`Chip::take_tick_stats`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct TickStats {
    /// Handlers that ended.
    pub count: usize,
    /// Most instructions of a run: observed, not proven.
    pub median: u32,
    /// Most instructions of a run: seen, not proven.
    pub max: u32,
    /// Most core cycles of a run, estimated: within some 30 %.
    pub cycles_max: u64,
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

/// Jumper wires of a board on a bench, from its outputs (the brakes from 0, then gripper and drive enable) to
/// its inputs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Jumpers {
    /// To A of each encoder.
    pub a: [Option<usize>; 4],
    /// To B of each encoder.
    pub b: [Option<usize>; 4],
    /// Over 22 kOhm to each tension input, which has its 10 kOhm to 3.3 V.
    pub tension: [Option<usize>; 4],
}

impl Jumpers {
    /// Brake n to A of encoder n and to tension n, drive enable to B of all four.
    pub const COMPLETE: Self = Self {
        a: [Some(0), Some(1), Some(2), Some(3)],
        b: [Some(5); 4],
        tension: [Some(0), Some(1), Some(2), Some(3)],
    };
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
    /// Position of each encoder, and its position after the next slice, in counts.
    encoders: [(i64, i64); 4],
    /// Those encoders' lines that are not ideal.
    lines: [Option<Box<Lines>>; 4],
    tick_began: u64,
    /// Core cycles when it began.
    tick_began_at: u64,
    ticks: Vec<u32>,
    ticks_done: u32,
    latency_max: u64,
    cycles_max: u64,
    lost_before: u64,
    instructions_before: u64,
    /// Outputs that were high at any time: the brakes from bit 0, then gripper and drive enable.
    were_high: u8,
    profile: Option<Box<Profile>>,
    resets: Vec<ResetBy>,
    hangs: bool,
    /// Instructions take this many times their time.
    slowness: u64,
    pub(crate) jumpers: Option<Jumpers>,
    /// A battery keeps the backup registers without a supply.
    pub(crate) battery: bool,
    /// What the supply does to the chip.
    power: Power,
    /// The supply's voltage before it was low.
    volts_before: Option<f64>,
}

impl Chip {
    /// Loads a firmware file (ELF) and powers the chip up. RAM contains arbitrary, but always the
    /// same, bytes.
    ///
    /// # Errors
    /// The file is not firmware for this chip.
    pub fn load(elf: &[u8]) -> Result<Self, LoadError> {
        let image = elf::load(elf)?;
        // Xorshift with a fixed seed: firmware must not rely on cleared RAM, and runs must repeat.
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
        // Decoded once: flash does not change while it runs, and decoding would take most of the
        // time.
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
            lines: [const { None }; 4],
            tick_began: 0,
            tick_began_at: 0,
            ticks: Vec::new(),
            ticks_done: 0,
            latency_max: 0,
            cycles_max: 0,
            lost_before: 0,
            instructions_before: 0,
            were_high: 0,
            profile: None,
            resets: Vec::new(),
            hangs: false,
            slowness: 1,
            jumpers: None,
            battery: false,
            power: Power::Up,
            volts_before: None,
        })
    }

    /// Continues after [`Stop::Reset`]: RAM is kept, everything else is as after a reset by `by`.
    /// External inputs (levels, voltages, encoders) stay.
    pub fn restart(&mut self, by: ResetBy) {
        let flags = match by {
            ResetBy::Watchdog => RESET_WATCHDOG,
            ResetBy::Software => RESET_SOFTWARE,
            ResetBy::Supply => RESET_POWER,
        };
        self.resets.push(by);
        // RM0008, 7.3.10: only a power reset clears the flags of the resets before.
        self.begin_again(flags | self.bus.rcc.reset_flags());
    }

    /// Goes on after the supply was gone: RAM holds anything, all else is as at power-on. Counters of
    /// resets and lost ticks go on.
    pub fn power_on(&mut self) {
        self.forget(1.0);
        self.begin_again(RESET_POWER);
    }

    /// Time passes without a supply: nothing is executed.
    pub fn skip_us(&mut self, us: u64) {
        self.until += us * TICKS_PER_US;
        self.bus.now = self.bus.now.max(self.until);
    }

    fn begin_again(&mut self, flags: u32) {
        self.lost_before += self.bus.scs.ticks_lost;
        self.instructions_before += self.cpu.instructions;
        let old = &mut self.bus;
        let (flash, ram) = (std::mem::take(&mut old.flash), std::mem::take(&mut old.ram));
        let mut bus = Bus::new(flash, ram, flags, old.now);
        for (new, old) in bus.gpio.iter_mut().zip(&old.gpio) {
            new.applied = old.applied;
        }
        bus.adc.applied = old.adc.applied;
        bus.adc.set_supply_v(old.adc.supply_v());
        bus.supply = Supply {
            low: false,
            ..old.supply
        };
        bus.rcc.crystal_dead = old.rcc.crystal_dead;
        bus.rcc.pll_dead = old.rcc.pll_dead;
        bus.watchdog.oscillator_hz = old.watchdog.oscillator_hz;
        bus.identity = old.identity;
        bus.backup = old.backup;
        bus.can.broken = old.can.broken;
        bus.can_line = old.can_line.clone();
        // The other nodes' frames stay: only the chip was reset.
        bus.can_line.cut_off();
        bus.usart.sent = std::mem::take(&mut old.usart.sent);
        bus.scs.delivers_faults = old.scs.delivers_faults;
        self.bus = bus;
        self.ticks_done = 0;
        // Without a supply it does not start.
        self.hangs = self.power.is_down();
        self.cpu = start(&mut self.bus);
    }

    /// Runs for a slice of virtual time. Encoders reach their set positions at its end.
    ///
    /// # Errors
    /// The firmware did something that is invalid on the chip, or was reset.
    pub fn run_us(&mut self, us: u64) -> Result<(), Stop> {
        // An instruction may have ended after the slice before: its time is not lost.
        let begin = self.until.max(self.bus.now);
        self.until += us * TICKS_PER_US;
        for timer in 0..4 {
            let (stands, goes) = self.encoders[timer];
            // TIM1 on PA8, TIM2 on PA0, TIM3 on PA6, TIM4 on PB6; B is the next pin.
            let (port, pin) = [(0, 8), (0, 0), (0, 6), (1, 6)][timer];
            let gpio = &self.bus.gpio[port];
            let wired = gpio.is_digital_input(pin) && gpio.is_digital_input(pin + 1);
            let cycle = self.bus.timer_cycle(timer);
            let ticks = self.until.saturating_sub(begin).max(1);
            let counter = &mut self.bus.timers[timer];
            match &mut self.lines[timer] {
                None => counter.turn(goes - stands, begin, ticks, cycle, wired),
                Some(lines) => {
                    let slice = Slice {
                        levels: lines.levels(),
                        edges: &lines.turn(stands, goes, begin, ticks),
                        counts: goes - stands,
                        from: begin,
                        until: begin + ticks,
                    };
                    counter.pass(slice, cycle, wired);
                }
            }
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
                // Asleep, nothing happens before the next event.
                let wakes = self.bus.next_event.min(self.until);
                self.bus.now = self.start_in_time(wakes).max(self.bus.now);
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

    /// Conditions that may let an exception in, or end the run.
    #[inline(never)]
    fn attend(&mut self) -> Result<(), Stop> {
        let pc = self.cpu.pc;
        // Before and after: an exception may end and the next begin in the same call.
        self.account();
        // Here, since every write to a peripheral calls for attention: no short pulse is missed.
        self.were_high |= self.pins().high();
        // A reset comes before everything else, even before a hang: the watchdog must end it.
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
                self.tick_began_at = self.bus.cycles();
                let latency = self.bus.now.saturating_sub(self.bus.scs.tick_due);
                self.latency_max = self.latency_max.max(latency);
            }
            Some(Switch::Leave(SYSTICK)) => {
                let taken = self.cpu.instructions - self.tick_began;
                let cycles = self.bus.cycles() - self.tick_began_at;
                self.cycles_max = self.cycles_max.max(cycles);
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
        // Misuse is a judgement of this emulation: a real chip would go on silently.
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
}

/// The core as reset leaves it.
fn start(bus: &mut Bus) -> Cpu {
    let stack = bus.read(FLASH, 4).unwrap_or(0);
    let entry = bus.read(FLASH + 4, 4).unwrap_or(0);
    Cpu::new(stack, entry)
}
