//! Why an instruction stopped.

/// Why an instruction did not complete.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Trap {
    /// No such instruction.
    Undefined,
    /// The address is not mapped.
    Bus { address: u32, write: bool },
    /// The peripheral at this address has no clock.
    ClockOff { address: u32 },
    /// The address must be a multiple of the size.
    Unaligned { address: u32 },
    /// A branch to an address without the Thumb bit.
    State { address: u32 },
    /// BKPT.
    Breakpoint,
    /// A peripheral is used in a way that does not work on the chip.
    Misuse { address: u32, what: &'static str },
}
