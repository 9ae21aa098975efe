//! Special registers, sleep and software exceptions.

use super::op::Op;
use super::{Cpu, Trap};
use crate::bus::Bus;
use crate::scs::SVC;

impl Cpu {
    pub(super) fn system(&mut self, bus: &mut Bus, op: Op) -> Result<u64, Trap> {
        match op {
            Op::Mrs { rd, special } => {
                let value = self.special(bus, special)?;
                self.set(rd, value);
                return Ok(2);
            }
            Op::Msr { rn, special, mask } => {
                self.set_special(bus, special, mask, self.reg(rn))?;
                return Ok(2);
            }
            Op::Cps {
                disable,
                primask,
                faultmask,
            } => {
                if primask {
                    bus.scs.primask = disable;
                }
                if faultmask {
                    bus.scs.faultmask = disable;
                }
                // A mask that falls may let in an exception that has been pending.
                bus.scs.attention = true;
            }
            Op::Svc => bus.scs.pend(SVC),
            Op::Bkpt => return Err(Trap::Breakpoint),
            Op::Wfi => {
                self.sleeping = true;
                bus.scs.attention = true;
            }
            Op::Wfe => {
                // The event is consumed: WFE returns at once and clears it.
                if self.event {
                    self.event = false;
                    self.unheard = false;
                } else {
                    // Firmware that relies on exceptions setting the event is counted here (erratum
                    // 563915).
                    self.slept_through += u64::from(std::mem::take(&mut self.unheard));
                    self.sleeping = true;
                    bus.scs.attention = true;
                }
            }
            Op::Sev => self.event = true,
            _ => return Err(Trap::Undefined),
        }
        Ok(1)
    }

    /// Whether the process stack is in use.
    pub(super) const fn on_process_stack(&self) -> bool {
        self.ipsr == 0 && self.control & 2 != 0
    }

    fn special(&self, bus: &Bus, special: u8) -> Result<u32, Trap> {
        let on_process = self.on_process_stack();
        Ok(match special {
            // xPSR: bit 0 asks for IPSR, bit 1 for EPSR (reads as zero), bit 2 leaves APSR out.
            0..=3 | 5..=7 => {
                let apsr = if special & 4 == 0 { self.apsr() } else { 0 };
                let ipsr = if special & 1 != 0 {
                    u32::from(self.ipsr)
                } else {
                    0
                };
                apsr | ipsr
            }
            // MSP and PSP: register 13 holds the one in use.
            8 if on_process => self.other_sp,
            8 => self.regs[13],
            9 if on_process => self.regs[13],
            9 => self.other_sp,
            16 => u32::from(bus.scs.primask),
            17 | 18 => u32::from(bus.scs.basepri),
            19 => u32::from(bus.scs.faultmask),
            20 => u32::from(self.control),
            _ => return Err(Trap::Undefined),
        })
    }

    fn set_special(
        &mut self,
        bus: &mut Bus,
        special: u8,
        mask: u8,
        value: u32,
    ) -> Result<(), Trap> {
        let on_process = self.on_process_stack();
        // Four bits of priority exist.
        let priority = value as u8 & 0xF0;
        match special {
            0..=3 if mask & 2 != 0 => self.set_apsr(value),
            0..=3 | 5..=7 => {}
            8 | 9 if (special == 9) == on_process => self.set(13, value),
            8 | 9 => self.other_sp = value & !3,
            16 => bus.scs.primask = value & 1 != 0,
            17 => bus.scs.basepri = priority,
            // BASEPRI_MAX only raises the mask, so that critical sections nest.
            18 if priority != 0 && (bus.scs.basepri == 0 || priority < bus.scs.basepri) => {
                bus.scs.basepri = priority;
            }
            18 => {}
            19 => bus.scs.faultmask = value & 1 != 0,
            20 => {
                let control = value as u8 & 3;
                // In handlers the choice of the stack is ignored.
                if self.ipsr == 0 && (control ^ self.control) & 2 != 0 {
                    std::mem::swap(&mut self.regs[13], &mut self.other_sp);
                }
                self.control = if self.ipsr == 0 {
                    control
                } else {
                    (self.control & 2) | (control & 1)
                };
            }
            _ => return Err(Trap::Undefined),
        }
        bus.scs.attention = true;
        Ok(())
    }
}
