//! Decoder: instruction bytes to [`Op`] (ARMv7-M Architecture Reference Manual, A5 and A7).

use super::decode32::decode32;
use super::op::{Alu, DISCARD, Flags, Index, Mul, Op, Shift, Unary, Width};

/// Low register in three bits at `at`.
const fn low(word: u16, at: u32) -> u8 {
    ((word >> at) & 7) as u8
}

/// Sign-extends the lowest `bits` bits.
pub(crate) const fn sign_extend(value: u32, bits: u32) -> i32 {
    ((value << (32 - bits)) as i32) >> (32 - bits)
}

/// Decodes the instruction at `pc`: its first half-word and the one that follows (used by 32-bit
/// encodings only). Returns the operation and its length in bytes.
pub fn decode(pc: u32, first: u16, second: u16) -> (Op, u8) {
    // Bits 15 to 11 of 0b11101, 0b11110 and 0b11111 begin an instruction of 32 bits (A5.1).
    if first >= 0xE800 {
        (decode32(pc, first, second), 4)
    } else {
        (decode16(pc, first), 2)
    }
}

const OUTSIDE: Flags = Flags::OutsideIt;

const fn reg(alu: Alu, flags: Flags, rd: u8, rn: u8, rm: u8) -> Op {
    Op::AluReg {
        alu,
        flags,
        rd,
        rn,
        rm,
        shift: Shift::Lsl,
        amount: 0,
    }
}

const fn imm(alu: Alu, flags: Flags, rd: u8, rn: u8, imm: u32) -> Op {
    Op::AluImm {
        alu,
        flags,
        rd,
        rn,
        imm,
        carry: None,
    }
}

fn decode16(pc: u32, w: u16) -> Op {
    let imm8 = u32::from(w & 0xFF);
    let imm5 = ((w >> 6) & 31) as u8;
    let (r0, r3, r6, r8) = (low(w, 0), low(w, 3), low(w, 6), low(w, 8));
    let here = pc.wrapping_add(4);
    match w >> 11 {
        // A shift by an immediate is a move with a shifted operand.
        0b00000..=0b00010 => {
            let (shift, amount) = immediate_shift((w >> 11) as u8, imm5);
            Op::AluReg {
                alu: Alu::Mov,
                flags: OUTSIDE,
                rd: r0,
                rn: DISCARD,
                rm: r3,
                shift,
                amount,
            }
        }
        0b00011 => match (w >> 9) & 3 {
            0 => reg(Alu::Add, OUTSIDE, r0, r3, r6),
            1 => reg(Alu::Sub, OUTSIDE, r0, r3, r6),
            2 => imm(Alu::Add, OUTSIDE, r0, r3, u32::from(r6)),
            _ => imm(Alu::Sub, OUTSIDE, r0, r3, u32::from(r6)),
        },
        0b00100 => imm(Alu::Mov, OUTSIDE, r8, DISCARD, imm8),
        0b00101 => imm(Alu::Sub, Flags::Always, DISCARD, r8, imm8),
        0b00110 => imm(Alu::Add, OUTSIDE, r8, r8, imm8),
        0b00111 => imm(Alu::Sub, OUTSIDE, r8, r8, imm8),
        0b01000 if w & 0x0400 == 0 => data_processing(w, r0, r3),
        0b01000 => special(w),
        0b01001 => Op::LoadLiteral {
            width: Width::Word,
            rt: r8,
            address: (here & !3).wrapping_add(imm8 * 4),
        },
        0b01010 | 0b01011 => {
            let (rt, rn, rm, shift) = (r0, r3, r6, 0);
            let store = |width| Op::StoreReg {
                width,
                rt,
                rn,
                rm,
                shift,
            };
            let load = |width| Op::LoadReg {
                width,
                rt,
                rn,
                rm,
                shift,
            };
            match (w >> 9) & 7 {
                0 => store(Width::Word),
                1 => store(Width::Half),
                2 => store(Width::Byte),
                3 => load(Width::SignedByte),
                4 => load(Width::Word),
                5 => load(Width::Half),
                6 => load(Width::Byte),
                _ => load(Width::SignedHalf),
            }
        }
        0b01100..=0b10001 => {
            let (width, scale) = match w >> 12 {
                6 => (Width::Word, 4),
                7 => (Width::Byte, 1),
                _ => (Width::Half, 2),
            };
            transfer(w & 0x0800 != 0, width, r0, r3, i32::from(imm5) * scale)
        }
        0b10010 | 0b10011 => transfer(w & 0x0800 != 0, Width::Word, r8, 13, imm8 as i32 * 4),
        0b10100 => Op::Address {
            rd: r8,
            address: (here & !3).wrapping_add(imm8 * 4),
        },
        0b10101 => imm(Alu::Add, Flags::Never, r8, 13, imm8 * 4),
        0b10110 | 0b10111 => miscellaneous(w, here),
        0b11000 => many(false, r8, imm8 as u16, true),
        // LDM writes back unless its base is loaded.
        0b11001 => many(true, r8, imm8 as u16, imm8 & (1 << r8) == 0),
        0b11010 | 0b11011 => match (w >> 8) & 15 {
            // Condition 14 is the permanently undefined instruction, 15 the supervisor call.
            14 => Op::Undefined,
            15 => Op::Svc,
            cond => Op::BranchIf {
                cond: cond as u8,
                target: here.wrapping_add_signed(sign_extend(imm8, 8) * 2),
            },
        },
        _ => Op::Branch {
            target: here.wrapping_add_signed(sign_extend(u32::from(w & 0x7FF), 11) * 2),
        },
    }
}

fn many(load: bool, rn: u8, list: u16, wback: bool) -> Op {
    let down = false;
    // An empty list is unpredictable: reported, not guessed.
    if list == 0 {
        Op::Undefined
    } else if load {
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

const fn transfer(load: bool, width: Width, rt: u8, rn: u8, offset: i32) -> Op {
    let index = Index::Offset;
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

/// Kind and amount of a shift as encoded: zero means 32, or for RRX.
pub(crate) const fn immediate_shift(kind: u8, amount: u8) -> (Shift, u8) {
    match (kind & 3, amount) {
        (0, amount) => (Shift::Lsl, amount),
        (1, 0) => (Shift::Lsr, 32),
        (1, amount) => (Shift::Lsr, amount),
        (2, 0) => (Shift::Asr, 32),
        (2, amount) => (Shift::Asr, amount),
        (_, 0) => (Shift::Rrx, 1),
        (_, amount) => (Shift::Ror, amount),
    }
}

fn data_processing(w: u16, rd: u8, rm: u8) -> Op {
    let shift = |shift| Op::ShiftReg {
        shift,
        flags: OUTSIDE,
        rd,
        rn: rd,
        rm,
    };
    match (w >> 6) & 15 {
        0 => reg(Alu::And, OUTSIDE, rd, rd, rm),
        1 => reg(Alu::Eor, OUTSIDE, rd, rd, rm),
        2 => shift(Shift::Lsl),
        3 => shift(Shift::Lsr),
        4 => shift(Shift::Asr),
        5 => reg(Alu::Adc, OUTSIDE, rd, rd, rm),
        6 => reg(Alu::Sbc, OUTSIDE, rd, rd, rm),
        7 => shift(Shift::Ror),
        8 => reg(Alu::And, Flags::Always, DISCARD, rd, rm),
        // NEG is 0 minus the register.
        9 => imm(Alu::Rsb, OUTSIDE, rd, rm, 0),
        10 => reg(Alu::Sub, Flags::Always, DISCARD, rd, rm),
        11 => reg(Alu::Add, Flags::Always, DISCARD, rd, rm),
        12 => reg(Alu::Orr, OUTSIDE, rd, rd, rm),
        13 => Op::Multiply {
            mul: Mul::Product,
            flags: OUTSIDE,
            rd,
            rn: rm,
            rm: rd,
            ra: DISCARD,
        },
        14 => reg(Alu::Bic, OUTSIDE, rd, rd, rm),
        _ => reg(Alu::Mvn, OUTSIDE, rd, DISCARD, rm),
    }
}

/// High registers and branches through a register.
fn special(w: u16) -> Op {
    let rm = ((w >> 3) & 15) as u8;
    let rd = (((w >> 4) & 8) | (w & 7)) as u8;
    match (w >> 8) & 3 {
        0 if rd == 15 => Op::AddPc { rm },
        0 => reg(Alu::Add, Flags::Never, rd, rd, rm),
        // Unpredictable encodings end the run: a compiler never emits them.
        1 if rd == 15 || rm == 15 => Op::Undefined,
        1 => reg(Alu::Sub, Flags::Always, DISCARD, rd, rm),
        2 if rd == 15 => Op::MovPc { rm },
        2 => reg(Alu::Mov, Flags::Never, rd, DISCARD, rm),
        _ if w & 7 != 0 || (w & 0x80 != 0 && rm == 15) => Op::Undefined,
        _ => Op::BranchReg {
            rm,
            link: w & 0x80 != 0,
        },
    }
}

fn miscellaneous(w: u16, here: u32) -> Op {
    let (rd, rm) = (low(w, 0), low(w, 3));
    let unary = |unary| Op::Unary {
        unary,
        rd,
        rm,
        rotate: 0,
    };
    match (w >> 8) & 15 {
        0 => {
            let alu = if w & 0x80 == 0 { Alu::Add } else { Alu::Sub };
            imm(alu, Flags::Never, 13, 13, u32::from(w & 0x7F) * 4)
        }
        1 | 3 | 9 | 11 => Op::CompareBranch {
            nonzero: w & 0x0800 != 0,
            rn: rd,
            target: here.wrapping_add(u32::from(((w >> 3) & 0x1F) | ((w >> 4) & 0x20)) * 2),
        },
        2 => unary(match (w >> 6) & 3 {
            0 => Unary::SignedHalf,
            1 => Unary::SignedByte,
            2 => Unary::Half,
            _ => Unary::Byte,
        }),
        4 | 5 => Op::StoreMany {
            rn: 13,
            // Bit 8 stands for LR (14) in PUSH.
            list: (w & 0xFF) | ((w & 0x100) << 6),
            down: true,
            wback: true,
        },
        6 if w & 0xE8 == 0x60 => Op::Cps {
            disable: w & 0x10 != 0,
            primask: w & 2 != 0,
            faultmask: w & 1 != 0,
        },
        10 => match (w >> 6) & 3 {
            0 => unary(Unary::Rev),
            1 => unary(Unary::Rev16),
            3 => unary(Unary::RevSigned),
            _ => Op::Undefined,
        },
        12 | 13 => Op::LoadMany {
            rn: 13,
            // Bit 8 stands for PC (15) in POP.
            list: (w & 0xFF) | ((w & 0x100) << 7),
            down: false,
            wback: true,
        },
        14 => Op::Bkpt,
        15 if w & 15 != 0 => Op::It { state: w as u8 },
        15 => match (w >> 4) & 15 {
            2 => Op::Wfe,
            3 => Op::Wfi,
            4 => Op::Sev,
            // NOP, YIELD and hints of later cores.
            _ => Op::Nop,
        },
        _ => Op::Undefined,
    }
}
