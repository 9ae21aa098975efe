//! The board's identity, and the cause of its start.

use crate::fatal::Record;
use embassy_stm32::pac;
use mcdpr_protocol::message::PANIC_BYTES;
use mcdpr_protocol::{FaultId, Hello, Info, List, PROTOCOL_MAJOR, PROTOCOL_MINOR, ResetCause};

/// First characters of the git hash, from the build script; empty without git.
const GIT_HASH: &[u8] = env!("MCDPR_GIT_HASH").as_bytes();

/// The last start.
pub struct Reset {
    /// Its cause.
    pub cause: ResetCause,
    /// The chip's reset flags, as in the upper byte of RCC_CSR.
    pub flags: u8,
    /// Text of the last fatal error since power-on.
    pub last_panic: List<u8, PANIC_BYTES>,
}

impl Reset {
    /// The fault that this start has to report: the board crashed, hung, or lost its supply or its
    /// crystal. It stays until it is cleared.
    pub fn fault(&self) -> Option<FaultId> {
        match self.cause {
            ResetCause::Watchdog => Some(FaultId::P3),
            // Only these two messages begin with the number of their row.
            ResetCause::Panic => Some(match &*self.last_panic {
                [b'P', b'1', ..] => FaultId::P1,
                [b'P', b'6', ..] => FaultId::P6,
                _ => FaultId::P4,
            }),
            _ => None,
        }
    }
}

/// Reads and clears the chip's reset flags. Every reset pulls the reset pin, so that flag is
/// checked last.
pub fn reset_cause(record: Record) -> Reset {
    let flags = pac::RCC.csr().read();
    pac::RCC.csr().modify(|w| w.set_rmvf(true));
    // Power first: after power-on the record in RAM is random, and other flags may be set, too.
    let cause = if flags.porrstf() || flags.lpwrrstf() {
        ResetCause::Power
    } else if flags.iwdgrstf() || flags.wwdgrstf() {
        ResetCause::Watchdog
    } else if flags.sftrstf() && record.is_new {
        ResetCause::Panic
    } else if flags.sftrstf() {
        ResetCause::Software
    } else if flags.pinrstf() {
        ResetCause::Pin
    } else {
        ResetCause::Unknown
    };
    Reset {
        cause,
        flags: flags.0.to_le_bytes()[3],
        last_panic: record.text,
    }
}

/// The greeting, whose layout is frozen.
pub fn hello(reset: &Reset) -> Hello {
    let mut git_hash = [0; 8];
    for (byte, character) in git_hash.iter_mut().zip(GIT_HASH) {
        *byte = *character;
    }
    let mut board_id = [0; 12];
    // 96 bits of the factory's unique number (RM0008, 30.2).
    for (index, word) in board_id.chunks_exact_mut(4).enumerate() {
        word.copy_from_slice(&pac::UID.uid(index).read().to_le_bytes());
    }
    Hello {
        major: PROTOCOL_MAJOR,
        minor: PROTOCOL_MINOR,
        board_id,
        git_hash,
        reset_cause: reset.cause,
    }
}

/// Adds board-specific values to the core's answer.
pub fn complete(info: &mut Info, last_panic: &List<u8, PANIC_BYTES>) {
    // RMDS and CiA 402.
    info.drive_kinds = 0b110;
    info.last_panic.clone_from(last_panic);
}
