//! Exceptions: entry, return and priority (ARMv7-M Architecture Reference Manual, B1.5).
//!
//! According to the architecture both set the event register of `WFE`. The core of this chip, r1p1,
//! sets it on neither (Arm erratum 563915, ST ES096): software that relies on it misses events
//! between its last check and the `WFE`.

use super::{Cpu, EXCEPTION_CYCLES, Switch, Trap};
use crate::bus::Bus;
use crate::scs::HARD_FAULT;

/// Bit 9 of a stacked xPSR: the stack was aligned to eight bytes.
const PADDED: u32 = 1 << 9;
const THUMB: u32 = 1 << 24;

impl Cpu {
    /// Enters the pending exception of the highest priority, if it may preempt. Gives the core
    /// cycles that took; 0 if there was none.
    pub(crate) fn take_exception(&mut self, bus: &mut Bus) -> Result<u64, Trap> {
        // Cleared first: whatever follows may raise it again.
        bus.scs.attention = false;
        let Some((number, priority)) = bus.scs.most_urgent() else {
            return Ok(0);
        };
        // A masked exception wakes all the same, if only PRIMASK holds it back.
        // WFI under PRIMASK (B1.5.17): wakes without entering the handler.
        if self.sleeping && priority < bus.scs.unmasked_priority() {
            self.sleeping = false;
        }
        if priority >= bus.scs.execution_priority() {
            return Ok(0);
        }
        self.sleeping = false;
        self.enter(bus, number)?;
        Ok(EXCEPTION_CYCLES)
    }

    fn enter(&mut self, bus: &mut Bus, number: u8) -> Result<(), Trap> {
        let xpsr = self.xpsr();
        let on_process = self.on_process_stack();
        // The frame begins at a multiple of eight; bit 9 of the stacked xPSR says that a word was
        // skipped.
        let padded = self.regs[13] & 4 != 0 && bus.scs.aligns_stack();
        let frame = (self.regs[13].wrapping_sub(32)) & if padded { !7 } else { !3 };
        let words = [
            self.regs[0],
            self.regs[1],
            self.regs[2],
            self.regs[3],
            self.regs[12],
            self.regs[14],
            self.pc,
            xpsr | if padded { PADDED } else { 0 },
        ];
        // The exception entered may become a hard fault below.
        let mut number = number;
        let mut address = frame;
        for word in words {
            if let Err(trap) = bus.write(address, 4, word) {
                if !bus.scs.delivers_faults {
                    return Err(trap);
                }
                // Stacking failed: a hard fault takes this exception's place (it stays pending).
                bus.scs.note_stacking_error();
                number = HARD_FAULT;
                break;
            }
            address = address.wrapping_add(4);
        }
        self.set(13, frame);
        if self.regs[13] < self.lowest_sp {
            self.lowest_sp = self.regs[13];
        }
        // EXC_RETURN: to a handler, to thread mode on the main stack, or on the process stack.
        let back = match (self.ipsr != 0, on_process) {
            (true, _) => 0xFFFF_FFF1,
            (false, false) => 0xFFFF_FFF9,
            (false, true) => 0xFFFF_FFFD,
        };
        // Handlers always run on the main stack.
        if on_process {
            std::mem::swap(&mut self.regs[13], &mut self.other_sp);
            self.control &= !2;
        }
        // Activated after stacking: a fault while stacking leaves the exception pending.
        bus.scs.activate(number);
        let vector = bus.read(bus.scs.vector(number), 4)?;
        if vector & 1 == 0 {
            return Err(Trap::State { address: vector });
        }
        self.ipsr = number;
        self.regs[14] = back;
        self.pc = vector & !1;
        self.it = 0;
        // An exclusive store after an interrupt must fail, so that its loop repeats.
        self.exclusive = None;
        self.switched = Some(Switch::Enter(number));
        Ok(())
    }

    /// Returns from the exception being handled to where `code` says.
    pub fn leave(&mut self, bus: &mut Bus, code: u32) -> Result<(), Trap> {
        let number = self.ipsr;
        let refused = Trap::State { address: code };
        let nested = bus.scs.deactivate(number);
        // The value must fit what is active: a handler that returns to the wrong mode is a fault of
        // the firmware.
        let to_process = match code {
            0xFFFF_FFF1 if nested => false,
            0xFFFF_FFF9 if !nested => false,
            0xFFFF_FFFD if !nested => true,
            _ => return Err(refused),
        };
        if to_process {
            std::mem::swap(&mut self.regs[13], &mut self.other_sp);
            self.control |= 2;
        }
        let frame = self.regs[13];
        let mut words = [0; 8];
        let mut address = frame;
        for word in &mut words {
            *word = bus.read(address, 4)?;
            address = address.wrapping_add(4);
        }
        let [r0, r1, r2, r3, r12, lr, pc, xpsr] = words;
        self.regs[..4].copy_from_slice(&[r0, r1, r2, r3]);
        self.regs[12] = r12;
        self.regs[14] = lr;
        self.pc = pc & !1;
        let padding = if xpsr & PADDED != 0 { 4 } else { 0 };
        self.set(13, frame.wrapping_add(32) | padding);
        self.set_apsr(xpsr);
        self.it = ((xpsr >> 25) & 3) as u8 | ((xpsr >> 8) & 0xFC) as u8;
        self.ipsr = (xpsr & 0x1FF) as u8;
        // A frame that was overwritten by the handler shows here.
        if xpsr & THUMB == 0 || (self.ipsr != 0) != nested {
            return Err(refused);
        }
        // FAULTMASK is cleared by every return but that from NMI.
        if number != 2 {
            bus.scs.faultmask = false;
        }
        self.exclusive = None;
        self.unheard = true;
        self.switched = Some(Switch::Leave(number));
        if bus.scs.sleeps_on_exit() && !nested {
            self.sleeping = true;
        }
        Ok(())
    }

    fn xpsr(&self) -> u32 {
        let it = u32::from(self.it);
        self.apsr() | THUMB | u32::from(self.ipsr) | (it & 3) << 25 | (it & 0xFC) << 8
    }
}
