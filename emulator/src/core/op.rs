//! Decoded instructions: one value per encoding class, fields ready to use.

/// Index of a register that is never read: the destination of compare instructions.
pub(crate) const DISCARD: u8 = 16;
/// Index of a register that is never written and is zero.
pub const ZERO: u8 = 17;

/// Two-operand arithmetic and logic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Alu {
    And,
    Bic,
    Orr,
    Orn,
    Eor,
    Mov,
    Mvn,
    Add,
    Adc,
    Sub,
    Sbc,
    Rsb,
}

/// When flags are set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Flags {
    Never,
    Always,
    /// Most 16-bit encodings: only outside of an IT block.
    OutsideIt,
}

/// Kinds of shift.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shift {
    Lsl,
    Lsr,
    Asr,
    Ror,
    Rrx,
}

/// What a load or store moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Width {
    Byte,
    Half,
    Word,
    SignedByte,
    SignedHalf,
}

/// Addressing modes of the base register.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Index {
    Offset,
    Before,
    After,
}

/// Extensions of a rotated byte or half-word, and byte orders.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unary {
    SignedByte,
    SignedHalf,
    Byte,
    Half,
    Rev,
    Rev16,
    RevSigned,
    Rbit,
    Clz,
}

/// Multiplications and divisions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mul {
    Product,
    Mla,
    Mls,
    Umull,
    Smull,
    Umlal,
    Smlal,
    Udiv,
    Sdiv,
}

/// One instruction.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Op {
    /// Not an instruction of this core, or one with unpredictable fields.
    Undefined,
    /// `carry` is what the expansion of the constant gives; `None` leaves it.
    AluImm {
        alu: Alu,
        flags: Flags,
        rd: u8,
        rn: u8,
        imm: u32,
        carry: Option<bool>,
    },
    AluReg {
        alu: Alu,
        flags: Flags,
        rd: u8,
        rn: u8,
        rm: u8,
        shift: Shift,
        amount: u8,
    },
    ShiftReg {
        shift: Shift,
        flags: Flags,
        rd: u8,
        rn: u8,
        rm: u8,
    },
    MovPc {
        rm: u8,
    },
    AddPc {
        rm: u8,
    },
    /// ADR.
    Address {
        rd: u8,
        address: u32,
    },
    Movt {
        rd: u8,
        imm: u16,
    },
    Multiply {
        mul: Mul,
        flags: Flags,
        rd: u8,
        rn: u8,
        rm: u8,
        ra: u8,
    },
    Unary {
        unary: Unary,
        rd: u8,
        rm: u8,
        rotate: u8,
    },
    Bfi {
        rd: u8,
        rn: u8,
        lsb: u8,
        mask: u32,
    },
    Bfx {
        signed: bool,
        rd: u8,
        rn: u8,
        lsb: u8,
        width: u8,
    },
    Saturate {
        signed: bool,
        rd: u8,
        rn: u8,
        bits: u8,
        shift: Shift,
        amount: u8,
    },
    LoadLiteral {
        width: Width,
        rt: u8,
        address: u32,
    },
    Load {
        width: Width,
        index: Index,
        rt: u8,
        rn: u8,
        offset: i32,
    },
    LoadReg {
        width: Width,
        rt: u8,
        rn: u8,
        rm: u8,
        shift: u8,
    },
    Store {
        width: Width,
        index: Index,
        rt: u8,
        rn: u8,
        offset: i32,
    },
    StoreReg {
        width: Width,
        rt: u8,
        rn: u8,
        rm: u8,
        shift: u8,
    },
    LoadDual {
        index: Index,
        rt: u8,
        rt2: u8,
        rn: u8,
        offset: i32,
    },
    StoreDual {
        index: Index,
        rt: u8,
        rt2: u8,
        rn: u8,
        offset: i32,
    },
    LoadMany {
        rn: u8,
        list: u16,
        down: bool,
        wback: bool,
    },
    StoreMany {
        rn: u8,
        list: u16,
        down: bool,
        wback: bool,
    },
    LoadExclusive {
        width: Width,
        rt: u8,
        rn: u8,
        offset: u32,
    },
    StoreExclusive {
        width: Width,
        rd: u8,
        rt: u8,
        rn: u8,
        offset: u32,
    },
    ClearExclusive,
    TableBranch {
        rn: u8,
        rm: u8,
        half: bool,
    },
    Branch {
        target: u32,
    },
    BranchIf {
        cond: u8,
        target: u32,
    },
    BranchLink {
        target: u32,
    },
    BranchReg {
        rm: u8,
        link: bool,
    },
    CompareBranch {
        nonzero: bool,
        rn: u8,
        target: u32,
    },
    It {
        state: u8,
    },
    Mrs {
        rd: u8,
        special: u8,
    },
    Msr {
        rn: u8,
        special: u8,
        mask: u8,
    },
    Cps {
        disable: bool,
        primask: bool,
        faultmask: bool,
    },
    Svc,
    Bkpt,
    Nop,
    Wfi,
    Wfe,
    Sev,
}
