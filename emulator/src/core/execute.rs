//! What each instruction does (ARMv7-M Architecture Reference Manual, A7.7).

use super::op::{Alu, Flags, Mul, Op, Shift, Unary};
use super::{Cpu, Trap};
use crate::bus::Bus;

/// Shifts; gives the value and the carry out (A2.2.1). Amounts are 0 to 255.
#[inline(always)]
fn shifted(value: u32, shift: Shift, amount: u32, carry: bool) -> (u32, bool) {
    // The carry stays: a shift by a register of value 0 changes no flag but N and Z.
    if amount == 0 {
        return (value, carry);
    }
    let bit = |place: u32| value.checked_shr(place).unwrap_or(0) & 1 != 0;
    match shift {
        Shift::Lsl => (
            // Rust panics or masks beyond 31; the core gives 0.
            value.checked_shl(amount).unwrap_or(0),
            amount <= 32 && bit(32 - amount),
        ),
        Shift::Lsr => (value.checked_shr(amount).unwrap_or(0), bit(amount - 1)),
        Shift::Asr => {
            let signed = value as i32;
            (
                // Beyond 31 all bits are the sign.
                (signed >> amount.min(31)) as u32,
                (signed >> (amount - 1).min(31)) & 1 != 0,
            )
        }
        Shift::Ror => {
            let result = value.rotate_right(amount & 31);
            (result, result >> 31 != 0)
        }
        Shift::Rrx => ((u32::from(carry) << 31) | (value >> 1), value & 1 != 0),
    }
}

/// Sum, carry and overflow (AddWithCarry).
#[inline(always)]
fn add(a: u32, b: u32, carry: bool) -> (u32, bool, bool) {
    let wide = u64::from(a) + u64::from(b) + u64::from(carry);
    let sum = wide as u32;
    // Overflow: both operands have the same sign and the sum has the other.
    (sum, wide >> 32 != 0, ((a ^ sum) & (b ^ sum)) >> 31 != 0)
}

impl Cpu {
    #[inline(always)]
    fn sets(flags: Flags, in_it: bool) -> bool {
        match flags {
            Flags::Never => false,
            Flags::Always => true,
            Flags::OutsideIt => !in_it,
        }
    }

    #[inline(always)]
    fn alu(&mut self, alu: Alu, sets: bool, rd: u8, a: u32, b: u32, carry: bool) {
        let (result, carry, overflow) = match alu {
            Alu::And => (a & b, carry, self.v),
            Alu::Bic => (a & !b, carry, self.v),
            Alu::Orr => (a | b, carry, self.v),
            Alu::Orn => (a | !b, carry, self.v),
            Alu::Eor => (a ^ b, carry, self.v),
            Alu::Mov => (b, carry, self.v),
            Alu::Mvn => (!b, carry, self.v),
            Alu::Add => add(a, b, false),
            Alu::Adc => add(a, b, self.c),
            // Carry is "no borrow", as the architecture defines subtraction.
            Alu::Sub => add(a, !b, true),
            Alu::Sbc => add(a, !b, self.c),
            Alu::Rsb => add(!a, b, true),
        };
        self.set(rd, result);
        if sets {
            self.n = result >> 31 != 0;
            self.z = result == 0;
            self.c = carry;
            self.v = overflow;
        }
    }

    #[inline(always)]
    pub(super) fn execute(&mut self, bus: &mut Bus, op: Op, in_it: bool) -> Result<u64, Trap> {
        match op {
            Op::AluImm {
                alu,
                flags,
                rd,
                rn,
                imm,
                carry,
            } => {
                // An immediate that is rotated gives a carry of its own; others leave it.
                let carry = carry.unwrap_or(self.c);
                let sets = Self::sets(flags, in_it);
                self.alu(alu, sets, rd, self.reg(rn), imm, carry);
            }
            Op::AluReg {
                alu,
                flags,
                rd,
                rn,
                rm,
                shift,
                amount,
            } => {
                let (b, carry) = shifted(self.reg(rm), shift, u32::from(amount), self.c);
                let sets = Self::sets(flags, in_it);
                self.alu(alu, sets, rd, self.reg(rn), b, carry);
            }
            Op::ShiftReg {
                shift,
                flags,
                rd,
                rn,
                rm,
            } => {
                let amount = self.reg(rm) & 0xFF;
                let (value, carry) = shifted(self.reg(rn), shift, amount, self.c);
                let sets = Self::sets(flags, in_it);
                self.alu(Alu::Mov, sets, rd, 0, value, carry);
            }
            Op::MovPc { rm } => {
                self.pc = self.reg(rm) & !1;
                return Ok(3);
            }
            Op::AddPc { rm } => {
                self.pc = self.regs[15].wrapping_add(self.reg(rm)) & !1;
                return Ok(3);
            }
            Op::Address { rd, address } => self.set(rd, address),
            Op::Movt { rd, imm } => {
                self.set(rd, (self.reg(rd) & 0xFFFF) | u32::from(imm) << 16);
            }
            Op::Multiply {
                mul,
                flags,
                rd,
                rn,
                rm,
                ra,
            } => return self.multiply(bus, mul, Self::sets(flags, in_it), [rd, rn, rm, ra]),
            Op::Unary {
                unary,
                rd,
                rm,
                rotate,
            } => {
                let value = self.reg(rm).rotate_right(u32::from(rotate));
                self.set(rd, unary_of(unary, value));
            }
            Op::Bfi { rd, rn, lsb, mask } => {
                let inserted = (self.reg(rn) << lsb) & mask;
                self.set(rd, (self.reg(rd) & !mask) | inserted);
            }
            Op::Bfx {
                signed,
                rd,
                rn,
                lsb,
                width,
            } => {
                // The field at the top of the word: the shift back extends its sign or zeros.
                let top = self.reg(rn) << (32 - lsb - width);
                let value = if signed {
                    (top as i32 >> (32 - width)) as u32
                } else {
                    top >> (32 - width)
                };
                self.set(rd, value);
            }
            Op::Saturate {
                signed,
                rd,
                rn,
                bits,
                shift,
                amount,
            } => {
                let (value, _) = shifted(self.reg(rn), shift, u32::from(amount), self.c);
                let value = i64::from(value as i32);
                let (low, high) = if signed {
                    (-(1_i64 << (bits - 1)), (1_i64 << (bits - 1)) - 1)
                } else {
                    (0, (1_i64 << bits) - 1)
                };
                let result = value.clamp(low, high);
                // Sticky: only software clears it.
                self.q |= result != value;
                self.set(rd, result as u32);
            }
            Op::Branch { target } => {
                self.pc = target;
                return Ok(3);
            }
            Op::BranchIf { cond, target } => {
                if self.holds(cond) {
                    self.pc = target;
                    return Ok(3);
                }
            }
            Op::BranchLink { target } => {
                self.regs[14] = self.pc | 1;
                self.pc = target;
                return Ok(3);
            }
            Op::BranchReg { rm, link } => {
                let target = self.reg(rm);
                let back = self.pc | 1;
                // LR after the branch: one that fails must not change it.
                let cycles = self.branch_exchange(bus, target)?;
                if link {
                    self.regs[14] = back;
                }
                return Ok(cycles);
            }
            Op::CompareBranch {
                nonzero,
                rn,
                target,
            } => {
                if (self.reg(rn) != 0) == nonzero {
                    self.pc = target;
                    return Ok(3);
                }
            }
            Op::It { state } => self.it = state,
            Op::Nop => {}
            Op::Undefined => return Err(Trap::Undefined),
            Op::Mrs { .. }
            | Op::Msr { .. }
            | Op::Cps { .. }
            | Op::Svc
            | Op::Bkpt
            | Op::Wfi
            | Op::Wfe
            | Op::Sev => return self.system(bus, op),
            _ => return self.transfer(bus, op),
        }
        Ok(1)
    }

    fn multiply(&mut self, bus: &mut Bus, mul: Mul, sets: bool, r: [u8; 4]) -> Result<u64, Trap> {
        let [rd, rn, rm, ra] = r;
        let (n, m, a) = (self.reg(rn), self.reg(rm), self.reg(ra));
        let (signed_n, signed_m) = (n as i32, m as i32);
        // `rd` is the upper and `ra` the lower half of a long result.
        let sum = u64::from(self.reg(rd)) << 32 | u64::from(a);
        let unsigned = u64::from(n) * u64::from(m);
        let signed = (i64::from(signed_n) * i64::from(signed_m)) as u64;
        let product = n.wrapping_mul(m);
        let long = match mul {
            Mul::Umull => unsigned,
            Mul::Smull => signed,
            Mul::Umlal => sum.wrapping_add(unsigned),
            Mul::Smlal => sum.wrapping_add(signed),
            short => {
                // Only if the firmware enabled the trap (DIV_0_TRP): else the quotient is 0.
                if m == 0 && matches!(short, Mul::Udiv | Mul::Sdiv) && bus.scs.traps_division() {
                    return Err(Trap::Undefined);
                }
                let (value, cycles) = match short {
                    Mul::Product => (product, 1),
                    Mul::Mla => (a.wrapping_add(product), 2),
                    Mul::Mls => (a.wrapping_sub(product), 2),
                    // 2 to 12 cycles on the core, by the operands: 6 is a mean (Cortex-M3 TRM).
                    Mul::Udiv => (n.checked_div(m).unwrap_or(0), 6),
                    _ if m == 0 => (0, 6),
                    // Wrapping: -2^31 / -1 is -2^31 on the core.
                    _ => (signed_n.wrapping_div(signed_m) as u32, 6),
                };
                self.set(rd, value);
                if sets {
                    self.n = value >> 31 != 0;
                    self.z = value == 0;
                }
                return Ok(cycles);
            }
        };
        self.set(ra, long as u32);
        self.set(rd, (long >> 32) as u32);
        Ok(4)
    }
}

const fn unary_of(unary: Unary, value: u32) -> u32 {
    match unary {
        Unary::SignedByte => value as i8 as u32,
        Unary::SignedHalf => value as i16 as u32,
        Unary::Byte => value & 0xFF,
        Unary::Half => value & 0xFFFF,
        Unary::Rev => value.swap_bytes(),
        Unary::Rev16 => value.swap_bytes().rotate_left(16),
        Unary::RevSigned => (value as u16).swap_bytes() as i16 as u32,
        Unary::Rbit => value.reverse_bits(),
        Unary::Clz => value.leading_zeros(),
    }
}
