//! Errors: a file that is not firmware, and firmware that misuses the chip.

/// Why a file cannot be loaded.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum LoadError {
    /// It does not start like an ELF file.
    #[error("this is not an ELF file: pass the file that `cargo fw` builds")]
    NotElf,
    /// It is an ELF file of 64 bits, big-endian, or not executable.
    #[error(
        "this ELF file is not a 32-bit little-endian executable: pass the file that `cargo fw` builds"
    )]
    WrongKind,
    /// It is for another processor; the number is ELF's `e_machine`.
    #[error(
        "this ELF file is for machine {0}, not for ARM (40): pass the file that `cargo fw` builds"
    )]
    WrongMachine(u16),
    /// It ends before the end given by its headers.
    #[error(
        "this ELF file ends at byte {length}, but its headers reach to byte {needed}: build or copy it again"
    )]
    Truncated {
        /// Bytes in the file.
        length: usize,
        /// Bytes according to its headers.
        needed: usize,
    },
    /// A part lies outside of flash.
    #[error(
        "{bytes} bytes at {address:#010x} lie outside of the 64 KiB of flash at 0x08000000: this file is for another chip"
    )]
    Outside {
        /// Address of the part.
        address: u32,
        /// Its size.
        bytes: u32,
    },
    /// The first two words of flash are not a stack in RAM and an entry in flash.
    #[error(
        "the vector table's stack {stack:#010x} and entry {entry:#010x} do not fit this chip's RAM and flash: this file is for another chip"
    )]
    NoVectors {
        /// First word of flash.
        stack: u32,
        /// Second word of flash.
        entry: u32,
    },
}

/// Why the chip was reset.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ResetBy {
    /// The independent watchdog was not fed in time.
    Watchdog,
    /// The firmware asked for it (SYSRESETREQ): after a panic, a fault or by intent.
    Software,
    /// The supply fell below the power-down threshold. It never ends a run: the chip starts by itself when its supply
    /// is back.
    Supply,
}

/// Why the emulation stopped. Every variant names the instruction (`pc`).
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Stop {
    /// The address is not mapped.
    #[error("{} of the unmapped address {address:#010x}, at pc {pc:#010x}", if *.write { "write" } else { "read" })]
    Unmapped {
        /// Address of the access.
        address: u32,
        /// Whether it was a write.
        write: bool,
        /// Address of the instruction.
        pc: u32,
    },
    /// The peripheral's clock is off.
    #[error("access to the peripheral at {address:#010x} while its clock is off, at pc {pc:#010x}")]
    ClockOff {
        /// Address of the access.
        address: u32,
        /// Address of the instruction.
        pc: u32,
    },
    /// Not an instruction of this core.
    #[error("undefined instruction {word:#010x} at pc {pc:#010x}")]
    Undefined {
        /// The two half-words there, the first in the upper half.
        word: u32,
        /// Address of the instruction.
        pc: u32,
    },
    /// The access must be aligned.
    #[error("unaligned access to {address:#010x} at pc {pc:#010x}")]
    Unaligned {
        /// Address of the access.
        address: u32,
        /// Address of the instruction.
        pc: u32,
    },
    /// A branch to something other than Thumb code, or a return without a matching exception.
    #[error(
        "branch to {address:#010x}, which is neither Thumb code nor an exception return, at pc {pc:#010x}"
    )]
    BadBranch {
        /// Target.
        address: u32,
        /// Address of the instruction.
        pc: u32,
    },
    /// An interrupt was taken whose priority has not been set since reset.
    #[error("exception {exception} taken with a priority that was never set, at pc {pc:#010x}")]
    UnsetPriority {
        /// Number of the exception; interrupts start at 16.
        exception: u8,
        /// Address of the instruction that it interrupted.
        pc: u32,
    },
    /// A peripheral is used in a way that does not work on the chip, or is not emulated.
    #[error("{what} (register {address:#010x}, pc {pc:#010x})")]
    Misuse {
        /// What is wrong.
        what: &'static str,
        /// Register.
        address: u32,
        /// Address of the instruction.
        pc: u32,
    },
    /// BKPT.
    #[error("breakpoint at pc {pc:#010x}")]
    Breakpoint {
        /// Address of the instruction.
        pc: u32,
    },
    /// A fault within the fault handler.
    #[error("the core locks up: a fault within a fault handler, at pc {pc:#010x}")]
    LockUp {
        /// Address of the instruction.
        pc: u32,
    },
    /// The chip was reset: `Chip::restart` continues.
    #[error("reset by {by:?} at pc {pc:#010x}")]
    Reset {
        /// The source of the reset.
        by: ResetBy,
        /// Address of the instruction.
        pc: u32,
    },
}
