//! `Hello`: the one message whose bytes never change, so that any host can identify any board.

use crate::{PROTOCOL_MAJOR, PROTOCOL_MINOR};

/// Cause of the chip's last start.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[repr(u8)]
pub enum ResetCause {
    /// Unknown, or a number of a later version.
    #[default]
    Unknown = 0,
    /// Power came on, or dipped.
    Power = 1,
    /// The reset pin.
    Pin = 2,
    /// The firmware requested it.
    Software = 3,
    /// The watchdog.
    Watchdog = 4,
    /// A panic or a processor fault; [`crate::Info::last_panic`] has the text.
    Panic = 5,
}

impl ResetCause {
    const fn from_number(number: u8) -> Self {
        match number {
            1 => Self::Power,
            2 => Self::Pin,
            3 => Self::Software,
            4 => Self::Watchdog,
            5 => Self::Panic,
            _ => Self::Unknown,
        }
    }
}

/// The board's identity. Layout (little-endian): `"MCDPR\0"`, major u16, minor u16, board id 12
/// bytes, git hash 8 bytes, reset cause u8. Frozen for all versions: later boards append only.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Hello {
    /// Major version of the wire format.
    pub major: u16,
    /// Minor version of the wire format.
    pub minor: u16,
    /// The chip's unique number.
    pub board_id: [u8; 12],
    /// First characters of the firmware's git hash, ASCII, padded with zeros.
    pub git_hash: [u8; 8],
    /// Cause of the chip's last start.
    pub reset_cause: ResetCause,
}

/// Whether host and board are compatible.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Compatibility {
    /// Same wire format.
    Full,
    /// The board's firmware is older than the host: flash the board.
    BoardOlder,
    /// The board's firmware is newer than the host: update the host.
    BoardNewer,
}

const MAGIC: &[u8; 6] = b"MCDPR\0";

impl Hello {
    /// Bytes of the frozen layout.
    pub const SIZE: usize = 31;

    /// The frozen bytes.
    #[must_use]
    pub fn to_bytes(&self) -> [u8; Self::SIZE] {
        let mut bytes = [0; Self::SIZE];
        let fields = MAGIC
            .iter()
            .copied()
            .chain(self.major.to_le_bytes())
            .chain(self.minor.to_le_bytes())
            .chain(self.board_id)
            .chain(self.git_hash)
            .chain([self.reset_cause as u8]);
        for (byte, value) in bytes.iter_mut().zip(fields) {
            *byte = value;
        }
        bytes
    }

    /// Reads the frozen bytes; what a later version appended is ignored.
    ///
    /// Returns `None` if the bytes are too short or another device answers.
    #[must_use]
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        // Another device on the port may answer anything: only this prefix is a board.
        let rest = bytes.strip_prefix(MAGIC)?;
        let (major, rest) = rest.split_first_chunk::<2>()?;
        let (minor, rest) = rest.split_first_chunk::<2>()?;
        let (board_id, rest) = rest.split_first_chunk::<12>()?;
        let (git_hash, rest) = rest.split_first_chunk::<8>()?;
        let cause = rest.first()?;
        Some(Self {
            major: u16::from_le_bytes(*major),
            minor: u16::from_le_bytes(*minor),
            board_id: *board_id,
            git_hash: *git_hash,
            reset_cause: ResetCause::from_number(*cause),
        })
    }

    /// Whether this board may be moved by a host of this crate's version.
    #[must_use]
    pub fn compatibility(&self) -> Compatibility {
        // While the major version is 0, every minor version may change anything.
        let ours = (PROTOCOL_MAJOR, PROTOCOL_MINOR);
        let theirs = (self.major, self.minor);
        // As semantic versioning has it for versions before 1.
        let same_minor_needed = PROTOCOL_MAJOR == 0;
        if theirs == ours || (self.major == PROTOCOL_MAJOR && !same_minor_needed) {
            Compatibility::Full
        } else if theirs < ours {
            Compatibility::BoardOlder
        } else {
            Compatibility::BoardNewer
        }
    }
}
