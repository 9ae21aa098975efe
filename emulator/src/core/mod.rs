//! An ARMv7-M integer core (Cortex-M3): registers, and one instruction at a time.

#[cfg(test)]
mod coverage;
pub(crate) mod decode;
mod decode32;
mod exception;
mod execute;
pub(crate) mod op;
#[cfg(test)]
mod oracle;
mod special;
#[cfg(test)]
mod tests;
mod transfer;

use crate::bus::Bus;
use crate::trap::Trap;
use op::Op;

/// The exception that a return goes to or an entry came from, for statistics.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Switch {
    Enter(u8),
    Leave(u8),
}

/// Registers and state that only instructions see.
#[derive(Debug, Clone)]
pub(crate) struct Cpu {
    /// 0 to 15 as named; the others are for the decoder (see [`op::DISCARD`], [`op::ZERO`]).
    /// Register 15 reads as the instruction's address plus 4.
    pub regs: [u32; 32],
    /// Address of the instruction to be executed next.
    pub pc: u32,
    pub n: bool,
    pub z: bool,
    pub c: bool,
    pub v: bool,
    pub q: bool,
    /// ITSTATE as in the EPSR.
    pub it: u8,
    /// Number of the exception being handled; 0 in thread mode.
    pub ipsr: u8,
    /// CONTROL: bit 1 chooses the process stack.
    pub control: u8,
    /// The stack pointer that is not in use.
    pub other_sp: u32,
    pub exclusive: Option<u32>,
    /// The event register of WFE.
    pub event: bool,
    /// A handler has returned since the last WFE, and the number of WFEs that slept despite that.
    unheard: bool,
    pub slept_through: u64,
    pub sleeping: bool,
    pub instructions: u64,
    /// Lowest stack pointer since it was last taken.
    pub lowest_sp: u32,
    pub switched: Option<Switch>,
}

/// Core cycles of an exception's entry and of the return from it (Cortex-M3 TRM, no waits).
// Estimated cycles are good to some 30 % (docs/chip.md): wait states of the flash are not counted.
const EXCEPTION_CYCLES: u64 = 12;

impl Cpu {
    pub fn new(stack: u32, entry: u32) -> Self {
        let mut regs = [0; 32];
        regs[13] = stack & !3;
        // LR after a reset (ARMv7-M ARM, B1.5.5): a return to it is an error.
        regs[14] = u32::MAX;
        Self {
            regs,
            pc: entry & !1,
            n: false,
            z: false,
            c: false,
            v: false,
            q: false,
            it: 0,
            ipsr: 0,
            control: 0,
            other_sp: 0,
            exclusive: None,
            event: false,
            unheard: false,
            slept_through: 0,
            sleeping: false,
            instructions: 0,
            lowest_sp: stack,
            switched: None,
        }
    }

    #[inline(always)]
    pub(crate) fn reg(&self, register: u8) -> u32 {
        self.regs[usize::from(register & 31)]
    }

    #[inline(always)]
    pub fn set(&mut self, register: u8, value: u32) {
        // The stack pointer's lowest bits are always zero.
        let value = if register == 13 { value & !3 } else { value };
        self.regs[usize::from(register & 31)] = value;
    }

    /// Executes one instruction and gives the core cycles it took.
    #[inline(always)]
    pub fn step(&mut self, bus: &mut Bus, op: Op, length: u32) -> Result<u64, Trap> {
        let at = self.pc;
        // An instruction reads the program counter two half-words ahead.
        self.regs[15] = at.wrapping_add(4);
        self.pc = at.wrapping_add(length);
        self.instructions += 1;
        let it = self.it;
        if it != 0 {
            // A mask of 0 ends no block: such an ITSTATE is not valid, and is dropped.
            if it & 0xF == 0 {
                self.it = 0;
            } else {
                // ITAdvance: the mask shifts left, and the condition's lowest bit takes its top
                // bit.
                self.it = if it & 7 == 0 {
                    0
                } else {
                    (it & 0xE0) | ((it << 1) & 0x1F)
                };
                // A skipped instruction takes a cycle and changes nothing else.
                if !self.holds(it >> 4) {
                    return Ok(1);
                }
            }
        }
        let result = self.execute(bus, op, it & 0xF != 0);
        if result.is_err() {
            // A faulting instruction has not run: it is executed again after the handler.
            self.it = it;
            self.pc = at;
        }
        // After every instruction: the deepest stack is one of the measured figures.
        if self.regs[13] < self.lowest_sp {
            self.lowest_sp = self.regs[13];
        }
        result
    }

    /// Whether a condition holds.
    #[inline(always)]
    pub fn holds(&self, cond: u8) -> bool {
        let basic = match cond >> 1 {
            0 => self.z,
            1 => self.c,
            2 => self.n,
            3 => self.v,
            4 => self.c && !self.z,
            5 => self.n == self.v,
            6 => self.n == self.v && !self.z,
            _ => return true,
        };
        // Odd conditions are the negations of the even ones.
        basic != (cond & 1 != 0)
    }

    pub(crate) fn apsr(&self) -> u32 {
        u32::from(self.n) << 31
            | u32::from(self.z) << 30
            | u32::from(self.c) << 29
            | u32::from(self.v) << 28
            | u32::from(self.q) << 27
    }

    pub(crate) fn set_apsr(&mut self, value: u32) {
        self.n = value >> 31 != 0;
        self.z = value & 1 << 30 != 0;
        self.c = value & 1 << 29 != 0;
        self.v = value & 1 << 28 != 0;
        self.q = value & 1 << 27 != 0;
    }

    /// A branch that may leave an exception, by BX, POP or LDR.
    pub(crate) fn branch_exchange(&mut self, bus: &mut Bus, target: u32) -> Result<u64, Trap> {
        // EXC_RETURN values are no addresses; in thread mode they are an ordinary, invalid branch.
        if self.ipsr != 0 && target >= 0xF000_0000 {
            self.leave(bus, target)?;
            return Ok(EXCEPTION_CYCLES);
        }
        // This core has no ARM state: bit 0 must be set.
        if target & 1 == 0 {
            return Err(Trap::State { address: target });
        }
        self.pc = target & !1;
        Ok(3)
    }
}
