//! System control space: NVIC, system control block, SysTick, DWT (ARMv7-M Architecture Reference
//! Manual, B3).

use crate::trap::Trap;

/// Number of the hard fault.
pub(crate) const HARD_FAULT: u8 = 3;
/// Number of the supervisor call.
pub(crate) const SVC: u8 = 11;
/// Number of SysTick.
pub(crate) const SYSTICK: u8 = 15;
/// Number of the first interrupt.
pub(crate) const FIRST_IRQ: u8 = 16;
/// Interrupts of this chip (RM0008, table 63, medium density).
const IRQS: u8 = 43;

/// PRIGROUP 0 splits below the lowest bit that exists: all four bits preempt.
// ST implements the upper four bits of a priority (PM0056).
const PRIORITY_BITS: u32 = 0xF0;
const ENABLE: u32 = 1;
const TICKINT: u32 = 2;
const CORE_CLOCK: u32 = 4;
const COUNTFLAG: u32 = 1 << 16;
const ICSR_PENDNMI: u32 = 1 << 31;
const DEMCR_TRCENA: u32 = 1 << 24;
const CCR_DIV_0: u32 = 1 << 4;
const CCR_STKALIGN: u32 = 1 << 9;
const CFSR_STKERR: u32 = 1 << 12;
const HFSR_FORCED: u32 = 1 << 30;

/// SysTick, in ticks of the chip's time.
#[derive(Debug, Clone, Default)]
struct SysTick {
    control: u32,
    reload: u32,
    /// When the counter reaches zero next, while it counts.
    zero_at: u64,
    /// Its value while it does not count.
    held: u32,
}

/// The registers of the system control space, with the core state that they affect.
#[derive(Debug, Clone)]
pub(crate) struct Scs {
    pending: u64,
    enabled: u64,
    active: u64,
    priority: [u8; 64],
    /// Priorities that were written since reset.
    chosen: u64,
    pub primask: bool,
    pub faultmask: bool,
    pub basepri: u8,
    /// Something changed that may let an exception in.
    pub attention: bool,
    /// Bus faults become hard faults, as on the chip, instead of stopping the emulation.
    pub delivers_faults: bool,
    /// AIRCR asked for a reset.
    pub reset_requested: bool,
    vtor: u32,
    group: u32,
    scr: u32,
    ccr: u32,
    shcsr: u32,
    pub cfsr: u32,
    hfsr: u32,
    bfar: u32,
    demcr: u32,
    dwt_control: u32,
    /// Core cycle count at which CYCCNT was 0.
    cyccnt_zero: u64,
    systick: SysTick,
    /// When SysTick was due last.
    pub tick_due: u64,
    /// SysTick came due while the one before was still pending.
    pub ticks_lost: u64,
    /// An interrupt was taken whose priority was not set.
    pub unset_priority: Option<u8>,
}

impl Scs {
    pub fn new() -> Self {
        Self {
            pending: 0,
            // System exceptions need no enabling, but for three faults (SHCSR).
            enabled: 0xFFFF & !(0b111 << 4),
            active: 0,
            priority: [0; 64],
            chosen: 0,
            primask: false,
            faultmask: false,
            basepri: 0,
            attention: false,
            delivers_faults: false,
            reset_requested: false,
            vtor: 0,
            group: 0,
            scr: 0,
            ccr: CCR_STKALIGN,
            shcsr: 0,
            cfsr: 0,
            hfsr: 0,
            bfar: 0,
            demcr: 0,
            dwt_control: 0,
            cyccnt_zero: 0,
            systick: SysTick::default(),
            tick_due: 0,
            ticks_lost: 0,
            unset_priority: None,
        }
    }

    pub fn pend(&mut self, number: u8) {
        self.pending |= 1 << number;
        self.attention = true;
    }

    /// Pends an interrupt of the chip.
    pub(crate) fn pend_irq(&mut self, irq: u8) {
        self.pend(FIRST_IRQ + irq);
    }

    /// An interrupt's line is high. It pends unless its handler is about to serve it.
    pub fn raise(&mut self, irq: u8) {
        let bit = 1 << (FIRST_IRQ + irq);
        // A level that stays high pends again when its handler has returned.
        if self.active & bit == 0 {
            self.pending |= bit;
        }
    }

    /// Reset, NMI and hard fault have fixed priorities above all others.
    fn priority_of(&self, number: u8) -> i32 {
        match number {
            // B1.5.4: fixed priorities are negative, configurable ones begin at 0.
            1 => -3,
            2 => -2,
            3 => -1,
            _ => self.grouped(self.priority[usize::from(number & 63)]),
        }
    }

    /// The part of a priority that decides on preemption.
    fn grouped(&self, priority: u8) -> i32 {
        let mask = PRIORITY_BITS & (0xFF_u32 << (self.group + 1)) & 0xFF;
        (u32::from(priority) & mask) as i32
    }

    /// The pending exception that comes first.
    pub(crate) fn most_urgent(&self) -> Option<(u8, i32)> {
        let mut left = self.pending & self.enabled;
        let mut best: Option<(u8, i32, u8)> = None;
        while left != 0 {
            let number = left.trailing_zeros() as u8;
            left &= left - 1;
            let group = self.priority_of(number);
            let whole = self.priority[usize::from(number & 63)];
            // Equal priorities: the lower number comes first, which is the order of this search.
            if best.is_none_or(|(_, first, sub)| (group, whole) < (first, sub)) {
                best = Some((number, group, whole));
            }
        }
        best.map(|(number, group, _)| (number, group))
    }

    /// The current execution priority, without masks.
    fn active_priority(&self) -> i32 {
        let mut left = self.active;
        // Below every configurable priority: thread mode.
        let mut priority = 256;
        while left != 0 {
            priority = priority.min(self.priority_of(left.trailing_zeros() as u8));
            left &= left - 1;
        }
        priority
    }

    /// As [`Self::execution_priority`], but for PRIMASK.
    pub(crate) fn unmasked_priority(&self) -> i32 {
        let mut priority = self.active_priority();
        if self.basepri != 0 {
            priority = priority.min(self.grouped(self.basepri));
        }
        if self.faultmask {
            priority = priority.min(-1);
        }
        priority
    }

    /// Only an exception with a lower number may preempt.
    pub(crate) fn execution_priority(&self) -> i32 {
        let priority = self.unmasked_priority();
        if self.primask {
            priority.min(0)
        } else {
            priority
        }
    }

    pub(crate) fn activate(&mut self, number: u8) {
        self.pending &= !(1 << number);
        self.active |= 1 << number;
        // Reset, NMI and hard fault need no priority. Any other one would share 0 with the control
        // tick.
        if number >= 4 && self.chosen & 1 << number == 0 && self.unset_priority.is_none() {
            self.unset_priority = Some(number);
        }
    }

    /// Ends an exception; returns whether another one is still active.
    pub(crate) fn deactivate(&mut self, number: u8) -> bool {
        self.active &= !(1 << number);
        self.attention = true;
        self.active != 0
    }

    pub fn vector(&self, number: u8) -> u32 {
        self.vtor + 4 * u32::from(number)
    }

    pub(crate) const fn aligns_stack(&self) -> bool {
        self.ccr & CCR_STKALIGN != 0
    }

    pub(crate) const fn traps_division(&self) -> bool {
        self.ccr & CCR_DIV_0 != 0
    }

    pub(crate) const fn sleeps_on_exit(&self) -> bool {
        self.scr & 2 != 0
    }

    pub(crate) fn note_stacking_error(&mut self) {
        self.cfsr |= CFSR_STKERR;
        self.hfsr |= HFSR_FORCED;
    }

    /// A fault becomes a hard fault, as no other fault is ever enabled here. Within a hard fault
    /// the core locks up: `false`.
    pub(crate) fn escalate(&mut self, trap: Trap) -> bool {
        self.cfsr |= match trap {
            Trap::Bus { address, .. } | Trap::ClockOff { address } => {
                self.bfar = address;
                1 << 15 | 1 << 9
            }
            Trap::Undefined => 1 << 16,
            Trap::State { .. } => 1 << 17,
            Trap::Unaligned { .. } => 1 << 24,
            Trap::Breakpoint | Trap::Misuse { .. } => 0,
        };
        self.hfsr |= HFSR_FORCED;
        // Judged before the hard fault is pending: a fault at its priority or above cannot be
        // delivered.
        let locked = self.execution_priority() <= -1;
        self.pend(HARD_FAULT);
        !locked
    }

    /// When SysTick is due next.
    pub const fn next_event(&self) -> u64 {
        if self.systick.control & ENABLE != 0 && self.systick.reload != 0 {
            self.systick.zero_at
        } else {
            u64::MAX
        }
    }

    pub fn service(&mut self, now: u64, ticks_per_cycle: u64) {
        while self.next_event() <= now {
            let due = self.systick.zero_at;
            // From the time it was due, not from now: periods do not drift with the emulation's
            // slices.
            self.systick.zero_at += (u64::from(self.systick.reload) + 1) * ticks_per_cycle;
            self.systick.control |= COUNTFLAG;
            if self.systick.control & TICKINT != 0 {
                // The one before was never served: two ticks have become one.
                if self.pending & 1 << SYSTICK != 0 {
                    self.ticks_lost += 1;
                }
                self.tick_due = due;
                self.pend(SYSTICK);
            }
        }
    }

    /// Reads a word; `cycles` is the core cycle count.
    pub fn read(&mut self, address: u32, now: u64, cost: u64, cycles: u64) -> Option<u32> {
        let banked = |bits: u64, word: u32| (bits >> FIRST_IRQ >> (32 * word)) as u32;
        let word = (address & 0x7F) / 4;
        Some(match address {
            0xE000_1000 => self.dwt_control,
            0xE000_1004 if self.dwt_control & 1 != 0 => {
                cycles.wrapping_sub(self.cyccnt_zero) as u32
            }
            0xE000_1004 => 0,
            0xE000_E004 => 1,
            0xE000_E008 => 0,
            0xE000_E010 => {
                let value = self.systick.control;
                self.systick.control &= !COUNTFLAG;
                value
            }
            0xE000_E014 => self.systick.reload,
            0xE000_E018 => self.current(now, cost),
            // 1 ms of a SysTick clock of 9 MHz (RM0008, 10.1.1).
            0xE000_E01C => 9000,
            0xE000_E100..=0xE000_E107 | 0xE000_E180..=0xE000_E187 => banked(self.enabled, word),
            0xE000_E200..=0xE000_E207 | 0xE000_E280..=0xE000_E287 => banked(self.pending, word),
            0xE000_E300..=0xE000_E307 => banked(self.active, word),
            0xE000_E108..=0xE000_E3FF => 0,
            0xE000_E400..=0xE000_E42B => self.priorities(FIRST_IRQ + (address - 0xE000_E400) as u8),
            0xE000_E42C..=0xE000_E5EF => 0,
            // Cortex-M3 r1p1.
            0xE000_ED00 => 0x411F_C231,
            0xE000_ED04 => self.icsr(),
            0xE000_ED08 => self.vtor,
            0xE000_ED0C => 0xFA05_0000 | self.group << 8,
            0xE000_ED10 => self.scr,
            0xE000_ED14 => self.ccr,
            0xE000_ED18..=0xE000_ED23 => self.priorities(4 + (address - 0xE000_ED18) as u8),
            0xE000_ED24 => self.shcsr,
            0xE000_ED28 => self.cfsr,
            0xE000_ED2C => self.hfsr,
            0xE000_ED30 | 0xE000_ED34 | 0xE000_ED3C => 0,
            0xE000_ED38 => self.bfar,
            // No MPU, no debugger.
            0xE000_ED90 | 0xE000_EDF0 => 0,
            0xE000_EDFC => self.demcr,
            _ => return None,
        })
    }

    /// Writes a word. `None` if there is no such register.
    pub fn write(
        &mut self,
        address: u32,
        value: u32,
        now: u64,
        cost: u64,
        cycles: u64,
    ) -> Option<()> {
        let bank = |word: u32| {
            let all = ((1_u64 << IRQS) - 1) << FIRST_IRQ;
            (u64::from(value) << (32 * word) << FIRST_IRQ) & all
        };
        let word = (address & 0x7F) / 4;
        self.attention = true;
        match address {
            0xE000_1000 => {
                // Without trace enabled the DWT has no clock: firmware that forgets it would count
                // nothing.
                if self.demcr & DEMCR_TRCENA == 0 {
                    return None;
                }
                self.dwt_control = value;
            }
            0xE000_1004 => self.cyccnt_zero = cycles.wrapping_sub(u64::from(value)),
            0xE000_E010 => {
                let held = self.current(now, cost);
                let was = self.systick.control & ENABLE != 0;
                // The external reference is not connected.
                if value & ENABLE != 0 && value & CORE_CLOCK == 0 {
                    return None;
                }
                self.systick.control = (self.systick.control & COUNTFLAG) | (value & 7);
                self.systick.held = held;
                if value & ENABLE != 0 && !was {
                    // A counter of 0 is reloaded with the first cycle.
                    let first = if held == 0 {
                        self.systick.reload + 1
                    } else {
                        held
                    };
                    self.systick.zero_at = now + u64::from(first) * cost;
                }
            }
            0xE000_E014 => self.systick.reload = value & 0xFF_FFFF,
            0xE000_E018 => {
                self.systick.held = 0;
                self.systick.control &= !COUNTFLAG;
                self.systick.zero_at = now + (u64::from(self.systick.reload) + 1) * cost;
            }
            0xE000_E100..=0xE000_E107 => self.enabled |= bank(word),
            0xE000_E180..=0xE000_E187 => self.enabled &= !bank(word),
            0xE000_E200..=0xE000_E207 => self.pending |= bank(word),
            0xE000_E280..=0xE000_E287 => self.pending &= !bank(word),
            0xE000_E400..=0xE000_E42B => {
                self.set_priorities(FIRST_IRQ + (address - 0xE000_E400) as u8, value, 0xF);
            }
            // Registers of interrupts that this chip lacks read as zero and ignore writes.
            0xE000_E108..=0xE000_E17F | 0xE000_E188..=0xE000_E1FF => {}
            0xE000_E208..=0xE000_E27F | 0xE000_E288..=0xE000_E2FF => {}
            0xE000_E42C..=0xE000_E5EF => {}
            0xE000_ED04 => self.set_icsr(value),
            0xE000_ED08 => self.vtor = value & 0x3FFF_FF80,
            // Writes without the key are ignored.
            0xE000_ED0C if value >> 16 == 0x05FA => {
                self.group = (value >> 8) & 7;
                self.reset_requested |= value & 4 != 0;
            }
            0xE000_ED0C => {}
            0xE000_ED10 => self.scr = value & 0x16,
            // Traps of unaligned access are not emulated: report it instead of ignoring it.
            0xE000_ED14 if value & 8 == 0 => self.ccr = value & 0x313,
            0xE000_ED18..=0xE000_ED23 => {
                self.set_priorities(4 + (address - 0xE000_ED18) as u8, value, 0xF);
            }
            0xE000_ED24 => {
                self.shcsr = value;
                let faults = u64::from((value >> 16) & 7) << 4;
                self.enabled = (self.enabled & !(7 << 4)) | faults;
            }
            0xE000_ED28 => self.cfsr &= !value,
            0xE000_ED2C => self.hfsr &= !value,
            0xE000_ED30 => {}
            0xE000_EDFC => self.demcr = value,
            // Software trigger.
            0xE000_EF00 if (value & 0x1FF) < u32::from(IRQS) => self.pend_irq(value as u8),
            _ => return None,
        }
        Some(())
    }

    /// Four priorities from this number on.
    fn priorities(&self, first: u8) -> u32 {
        let at = usize::from(first & !3);
        u32::from_le_bytes([
            self.priority[at],
            self.priority[at + 1],
            self.priority[at + 2],
            self.priority[at + 3],
        ])
    }

    /// Sets those of four priorities that `lanes` names.
    pub(crate) fn set_priorities(&mut self, first: u8, value: u32, lanes: u8) {
        let at = usize::from(first & !3);
        for (lane, byte) in value.to_le_bytes().into_iter().enumerate() {
            if lanes & 1 << lane != 0 {
                self.priority[at + lane] = byte & PRIORITY_BITS as u8;
                self.chosen |= 1 << (at + lane);
            }
        }
        self.attention = true;
    }

    fn current(&self, now: u64, cost: u64) -> u32 {
        if self.systick.control & ENABLE == 0 {
            return self.systick.held;
        }
        let left = self.systick.zero_at.saturating_sub(now) / cost;
        (left as u32).min(self.systick.reload)
    }

    fn icsr(&self) -> u32 {
        let pending = |number: u8| u32::from(self.pending & 1 << number != 0);
        let active = if self.active == 0 {
            0
        } else {
            let mut best = (i32::MAX, 0);
            let mut left = self.active;
            while left != 0 {
                let number = left.trailing_zeros() as u8;
                best = best.min((self.priority_of(number), u32::from(number)));
                left &= left - 1;
            }
            best.1
        };
        let next = self
            .most_urgent()
            .map_or(0, |(number, _)| u32::from(number));
        pending(2) << 31 | pending(14) << 28 | pending(SYSTICK) << 26 | next << 12 | active
    }

    fn set_icsr(&mut self, value: u32) {
        if value & ICSR_PENDNMI != 0 {
            self.pend(2);
        }
        for (bit, number) in [(28, 14_u8), (26, SYSTICK)] {
            if value & 1 << bit != 0 {
                self.pend(number);
            }
            if value & 1 << (bit - 1) != 0 {
                self.pending &= !(1 << number);
            }
        }
    }
}
