//! Decoder of 32-bit encodings (ARMv7-M Architecture Reference Manual, A5.3).

use super::decode::{immediate_shift, sign_extend};
use super::op::{Alu, DISCARD, Flags, Index, Mul, Op, Shift, Unary, Width, ZERO};

/// The fields that most encodings share.
#[derive(Clone, Copy)]
struct Fields {
    rn: u8,
    rd: u8,
    rt: u8,
    rm: u8,
    /// imm3:imm2, a shift amount or a bit position.
    amount: u8,
}

pub(crate) fn decode32(pc: u32, a: u16, b: u16) -> Op {
    let f = Fields {
        rn: (a & 15) as u8,
        rd: ((b >> 8) & 15) as u8,
        rt: (b >> 12) as u8,
        rm: (b & 15) as u8,
        amount: (((b >> 10) & 0x1C) | ((b >> 6) & 3)) as u8,
    };
    match (a >> 11) & 3 {
        1 if a & 0x0640 == 0x0000 => multiple(a, b, f),
        1 if a & 0x0640 == 0x0040 => dual_or_exclusive(a, b, f),
        1 if a & 0x0600 == 0x0200 => shifted_register(a, b, f),
        2 if b & 0x8000 != 0 => branch_or_control(pc, a, b, f),
        2 if a & 0x0200 == 0 => modified_immediate(a, b, f),
        2 => plain_immediate(pc, a, b, f),
        3 if a & 0x0600 == 0x0000 => transfer(pc, a, b, f),
        3 if a & 0x0700 == 0x0200 => register(a, b, f),
        3 if a & 0x0780 == 0x0300 => multiply(a, b, f),
        3 if a & 0x0780 == 0x0380 => long_multiply(a, b, f),
        // Coprocessors: this core has none.
        _ => Op::Undefined,
    }
}

/// The stack pointer and the program counter are not general registers.
const fn bad(register: u8) -> bool {
    register == 13 || register == 15
}

fn multiple(a: u16, list: u16, f: Fields) -> Op {
    let (wback, load) = (a & 0x20 != 0, a & 0x10 != 0);
    let down = match (a >> 7) & 3 {
        1 => false,
        2 => true,
        _ => return Op::Undefined,
    };
    // SP in any list, and PC in a store, are unpredictable (A7.7, LDM and STM).
    let refused = if load { 0x2000 } else { 0xA000 };
    let base_in_list = wback && list & (1 << f.rn) != 0;
    if f.rn == 15 || list & refused != 0 || list.count_ones() < 2 || base_in_list {
        return Op::Undefined;
    }
    // LR and PC together are unpredictable.
    if load && list & 0xC000 == 0xC000 {
        return Op::Undefined;
    }
    let rn = f.rn;
    if load {
        Op::LoadMany {
            rn,
            list,
            down,
            wback,
        }
    } else {
        Op::StoreMany {
            rn,
            list,
            down,
            wback,
        }
    }
}

fn dual_or_exclusive(a: u16, b: u16, f: Fields) -> Op {
    let load = a & 0x10 != 0;
    let (rn, rt, rt2) = (f.rn, f.rt, f.rd);
    let imm = u32::from(b & 0xFF) * 4;
    if a & 0x0120 != 0 {
        let offset = if a & 0x80 != 0 {
            imm as i32
        } else {
            -(imm as i32)
        };
        let index = match (a & 0x100 != 0, a & 0x20 != 0) {
            (true, false) => Index::Offset,
            (true, true) => Index::Before,
            _ => Index::After,
        };
        let twice = index != Index::Offset && (rn == rt || rn == rt2 || rn == 15);
        if bad(rt) || bad(rt2) || twice || (load && rt == rt2) || (!load && rn == 15) {
            return Op::Undefined;
        }
        return if load {
            Op::LoadDual {
                index,
                rt,
                rt2,
                rn,
                offset,
            }
        } else {
            Op::StoreDual {
                index,
                rt,
                rt2,
                rn,
                offset,
            }
        };
    }
    if a & 0x80 == 0 {
        if bad(rt) || rn == 15 || (!load && (bad(rt2) || rt2 == rn || rt2 == rt)) {
            return Op::Undefined;
        }
        let (width, offset) = (Width::Word, imm);
        return if load {
            Op::LoadExclusive {
                width,
                rt,
                rn,
                offset,
            }
        } else {
            Op::StoreExclusive {
                width,
                rd: rt2,
                rt,
                rn,
                offset,
            }
        };
    }
    let width = match (b >> 4) & 15 {
        0 | 1 if load && !bad(f.rm) => {
            return Op::TableBranch {
                rn,
                rm: f.rm,
                half: b & 0x10 != 0,
            };
        }
        4 => Width::Byte,
        5 => Width::Half,
        _ => return Op::Undefined,
    };
    if bad(rt) || rn == 15 || (!load && (bad(f.rm) || f.rm == rn || f.rm == rt)) {
        return Op::Undefined;
    }
    let offset = 0;
    if load {
        Op::LoadExclusive {
            width,
            rt,
            rn,
            offset,
        }
    } else {
        Op::StoreExclusive {
            width,
            rd: f.rm,
            rt,
            rn,
            offset,
        }
    }
}

/// Operation, destination and first operand; `None` where there is no such operation. Register 15
/// as destination makes a comparison, as first operand a move.
fn operation(a: u16, f: Fields) -> Option<(Alu, Flags, u8, u8)> {
    let sets = a & 0x10 != 0;
    let flags = if sets { Flags::Always } else { Flags::Never };
    let (alu, compares, moves) = match (a >> 5) & 15 {
        0 => (Alu::And, true, None),
        1 => (Alu::Bic, false, None),
        2 => (Alu::Orr, false, Some(Alu::Mov)),
        3 => (Alu::Orn, false, Some(Alu::Mvn)),
        4 => (Alu::Eor, true, None),
        8 => (Alu::Add, true, None),
        10 => (Alu::Adc, false, None),
        11 => (Alu::Sbc, false, None),
        13 => (Alu::Sub, true, None),
        14 => (Alu::Rsb, false, None),
        _ => return None,
    };
    // AND, EOR, ADD and SUB with destination 15 are TST, TEQ, CMN and CMP.
    let rd = if f.rd == 15 {
        if !(sets && compares) {
            return None;
        }
        DISCARD
    } else {
        f.rd
    };
    match moves {
        Some(moves) if f.rn == 15 => Some((moves, flags, rd, DISCARD)),
        _ if f.rn == 15 => None,
        _ => Some((alu, flags, rd, f.rn)),
    }
}

fn shifted_register(a: u16, b: u16, f: Fields) -> Op {
    let Some((alu, flags, rd, rn)) = operation(a, f) else {
        return Op::Undefined;
    };
    // The stack pointer may be moved, as a word.
    if f.rm == 15 || (f.rm == 13 && alu != Alu::Mov) {
        return Op::Undefined;
    }
    let (shift, amount) = immediate_shift((b >> 4) as u8, f.amount);
    Op::AluReg {
        alu,
        flags,
        rd,
        rn,
        rm: f.rm,
        shift,
        amount,
    }
}

/// ThumbExpandImm with the carry it gives.
fn expand(imm12: u16) -> (u32, Option<bool>) {
    let byte = u32::from(imm12 & 0xFF);
    match imm12 >> 8 {
        0 => (byte, None),
        1 => (byte * 0x0001_0001, None),
        2 => (byte * 0x0100_0100, None),
        3 => (byte * 0x0101_0101, None),
        _ => {
            let value = (byte | 0x80).rotate_right(u32::from(imm12 >> 7));
            (value, Some(value >> 31 != 0))
        }
    }
}

const fn imm12(a: u16, b: u16) -> u16 {
    ((a & 0x0400) << 1) | ((b >> 4) & 0x0700) | (b & 0xFF)
}

fn modified_immediate(a: u16, b: u16, f: Fields) -> Op {
    let Some((alu, flags, rd, rn)) = operation(a, f) else {
        return Op::Undefined;
    };
    let (imm, carry) = expand(imm12(a, b));
    Op::AluImm {
        alu,
        flags,
        rd,
        rn,
        imm,
        carry,
    }
}

fn plain_immediate(pc: u32, a: u16, b: u16, f: Fields) -> Op {
    let Fields { rn, rd, .. } = f;
    let imm = u32::from(imm12(a, b));
    let wide = (imm | (u32::from(a & 15) << 12)) as u16;
    let lsb = f.amount;
    let last = (b & 31) as u8;
    if rd == 15 {
        return Op::Undefined;
    }
    let alu = |alu| Op::AluImm {
        alu,
        flags: Flags::Never,
        rd,
        rn,
        imm,
        carry: None,
    };
    let base = pc.wrapping_add(4) & !3;
    match (a >> 4) & 31 {
        0 if rn == 15 => Op::Address {
            rd,
            address: base.wrapping_add(imm),
        },
        10 if rn == 15 => Op::Address {
            rd,
            address: base.wrapping_sub(imm),
        },
        0 => alu(Alu::Add),
        10 => alu(Alu::Sub),
        4 => Op::AluImm {
            alu: Alu::Mov,
            flags: Flags::Never,
            rd,
            rn: DISCARD,
            imm: u32::from(wide),
            carry: None,
        },
        12 => Op::Movt { rd, imm: wide },
        code @ (16 | 18 | 24 | 26) if !bad(rn) => {
            if code & 2 != 0 && lsb == 0 {
                // SSAT16 and USAT16 belong to the DSP extension.
                return Op::Undefined;
            }
            let (shift, amount) = immediate_shift((code & 2) as u8, lsb);
            let signed = code < 24;
            Op::Saturate {
                signed,
                rd,
                rn,
                bits: last + u8::from(signed),
                shift,
                amount,
            }
        }
        code @ (20 | 28) if !bad(rn) && lsb + last < 32 => Op::Bfx {
            signed: code == 20,
            rd,
            rn,
            lsb,
            width: last + 1,
        },
        22 if last >= lsb && rn != 13 => Op::Bfi {
            rd,
            rn: if rn == 15 { ZERO } else { rn },
            lsb,
            mask: (u32::MAX >> (31 - (last - lsb))) << lsb,
        },
        _ => Op::Undefined,
    }
}

fn branch_or_control(pc: u32, a: u16, b: u16, f: Fields) -> Op {
    let here = pc.wrapping_add(4);
    let (s, j1, j2) = (
        u32::from((a >> 10) & 1),
        u32::from((b >> 13) & 1),
        u32::from((b >> 11) & 1),
    );
    let low = u32::from(b & 0x7FF) << 1;
    if b & 0x1000 != 0 {
        // Old encodings have both bits set: inverted with the sign, they extend the range to 16 MB.
        let (i1, i2) = (1 ^ j1 ^ s, 1 ^ j2 ^ s);
        let high = (s << 24) | (i1 << 23) | (i2 << 22) | (u32::from(a & 0x3FF) << 12);
        let target = here.wrapping_add_signed(sign_extend(high | low, 25));
        return if b & 0x4000 != 0 {
            Op::BranchLink { target }
        } else {
            Op::Branch { target }
        };
    }
    if b & 0x4000 != 0 {
        return Op::Undefined;
    }
    let cond = ((a >> 6) & 15) as u8;
    if cond < 14 {
        // Conditional branches take the two bits as they are, and in the other order.
        let high = (s << 20) | (j2 << 19) | (j1 << 18) | (u32::from(a & 0x3F) << 12);
        let target = here.wrapping_add_signed(sign_extend(high | low, 21));
        return Op::BranchIf { cond, target };
    }
    match (a >> 4) & 0x7F {
        0x38 | 0x39 if !bad(f.rn) => Op::Msr {
            rn: f.rn,
            special: b as u8,
            mask: ((b >> 10) & 3) as u8,
        },
        0x3A => match b as u8 {
            2 => Op::Wfe,
            3 => Op::Wfi,
            4 => Op::Sev,
            _ => Op::Nop,
        },
        0x3B => match (b >> 4) & 15 {
            2 => Op::ClearExclusive,
            // DSB, DMB, ISB: this core executes in order and buffers nothing.
            4..=6 => Op::Nop,
            _ => Op::Undefined,
        },
        0x3E | 0x3F if !bad(f.rd) => Op::Mrs {
            rd: f.rd,
            special: b as u8,
        },
        _ => Op::Undefined,
    }
}

fn transfer(pc: u32, a: u16, b: u16, f: Fields) -> Op {
    let (rn, rt) = (f.rn, f.rt);
    let load = a & 0x10 != 0;
    let width = match ((a >> 5) & 3, a & 0x100 != 0) {
        (0, false) => Width::Byte,
        (1, false) => Width::Half,
        (2, false) => Width::Word,
        (0, true) if load => Width::SignedByte,
        (1, true) if load => Width::SignedHalf,
        _ => return Op::Undefined,
    };
    if rt == 15 && (!load || width != Width::Word) {
        // Loads of less than a word to the program counter are hints (PLD, PLI).
        return if load { Op::Nop } else { Op::Undefined };
    }
    let imm = i32::from(b & 0xFFF);
    if rn == 15 {
        let sign = if a & 0x80 != 0 { 1 } else { -1 };
        let base = pc.wrapping_add(4) & !3;
        let address = base.wrapping_add_signed(sign * imm);
        return if load {
            Op::LoadLiteral { width, rt, address }
        } else {
            Op::Undefined
        };
    }
    if a & 0x80 == 0 && b & 0x0FC0 == 0 {
        let (rm, shift) = (f.rm, ((b >> 4) & 3) as u8);
        return match (bad(rm), load) {
            (true, _) => Op::Undefined,
            (_, true) => Op::LoadReg {
                width,
                rt,
                rn,
                rm,
                shift,
            },
            _ => Op::StoreReg {
                width,
                rt,
                rn,
                rm,
                shift,
            },
        };
    }
    let byte = i32::from(b & 0xFF);
    let (index, offset) = if a & 0x80 != 0 {
        (Index::Offset, imm)
    } else {
        let signed = if b & 0x200 != 0 { byte } else { -byte };
        match (b >> 8) & 15 {
            12 => (Index::Offset, signed),
            // LDRT and STRT: all here is privileged.
            14 => (Index::Offset, byte),
            13 | 15 => (Index::Before, signed),
            9 | 11 => (Index::After, signed),
            _ => return Op::Undefined,
        }
    };
    if index != Index::Offset && rn == rt {
        return Op::Undefined;
    }
    if load {
        Op::Load {
            width,
            index,
            rt,
            rn,
            offset,
        }
    } else {
        Op::Store {
            width,
            index,
            rt,
            rn,
            offset,
        }
    }
}

fn register(a: u16, b: u16, f: Fields) -> Op {
    let Fields { rn, rd, rm, .. } = f;
    if b & 0xF000 != 0xF000 || bad(rd) || bad(rm) {
        return Op::Undefined;
    }
    let code = (a >> 4) & 15;
    let operation = (b >> 4) & 15;
    if operation == 0 && code < 8 {
        if bad(rn) {
            return Op::Undefined;
        }
        let shift = [Shift::Lsl, Shift::Lsr, Shift::Asr, Shift::Ror][usize::from(code / 2)];
        let flags = if code & 1 != 0 {
            Flags::Always
        } else {
            Flags::Never
        };
        return Op::ShiftReg {
            shift,
            flags,
            rd,
            rn,
            rm,
        };
    }
    let unary = match (code, operation) {
        // With a base register these would belong to the DSP extension.
        (0, 8..12) if rn == 15 => Unary::SignedHalf,
        (1, 8..12) if rn == 15 => Unary::Half,
        (4, 8..12) if rn == 15 => Unary::SignedByte,
        (5, 8..12) if rn == 15 => Unary::Byte,
        (9, 8) => Unary::Rev,
        (9, 9) => Unary::Rev16,
        (9, 10) => Unary::Rbit,
        (9, 11) => Unary::RevSigned,
        (11, 8) => Unary::Clz,
        _ => return Op::Undefined,
    };
    if code >= 8 && rn != rm {
        return Op::Undefined;
    }
    let rotate = if code < 8 {
        (operation & 3) as u8 * 8
    } else {
        0
    };
    Op::Unary {
        unary,
        rd,
        rm,
        rotate,
    }
}

fn multiply(a: u16, b: u16, f: Fields) -> Op {
    let ra = f.rt;
    let mul = match ((a >> 4) & 7, (b >> 4) & 15) {
        (0, 0) if ra == 15 => Mul::Product,
        (0, 0) => Mul::Mla,
        (0, 1) if ra != 15 => Mul::Mls,
        _ => return Op::Undefined,
    };
    if bad(f.rn) || bad(f.rd) || bad(f.rm) || ra == 13 {
        return Op::Undefined;
    }
    Op::Multiply {
        mul,
        flags: Flags::Never,
        rd: f.rd,
        rn: f.rn,
        rm: f.rm,
        ra: if ra == 15 { DISCARD } else { ra },
    }
}

fn long_multiply(a: u16, b: u16, f: Fields) -> Op {
    let (mul, long) = match ((a >> 4) & 7, (b >> 4) & 15) {
        (0, 0) => (Mul::Smull, true),
        (1, 15) if f.rt == 15 => (Mul::Sdiv, false),
        (2, 0) => (Mul::Umull, true),
        (3, 15) if f.rt == 15 => (Mul::Udiv, false),
        (4, 0) => (Mul::Smlal, true),
        (6, 0) => (Mul::Umlal, true),
        _ => return Op::Undefined,
    };
    let low = if long { f.rt } else { DISCARD };
    if bad(f.rn) || bad(f.rd) || bad(f.rm) || bad(low) || low == f.rd {
        return Op::Undefined;
    }
    Op::Multiply {
        mul,
        flags: Flags::Never,
        rd: f.rd,
        rn: f.rn,
        rm: f.rm,
        ra: low,
    }
}
