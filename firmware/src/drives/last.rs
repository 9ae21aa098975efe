//! The data with which a board stops its drives after a reset: kind, bit rate, numbers.
//!
//! An RMDS continues its last command until it gets another one or a reset; a CiA 402 drive until
//! it misses the board's heartbeat, if it monitors that at all. A board that was reset (watchdog,
//! panic, supply) has no configuration any more, so it keeps these data in memory that a reset does
//! not clear.

use crate::config::{Active, DriveKind};
use mcdpr_protocol::frame::crc32;

/// Words that it takes in memory.
pub const WORDS: usize = 4;

/// The drives of a configuration; 0 for no drive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LastDrives<const N: usize> {
    /// Their protocol.
    pub kind: DriveKind,
    /// Bit rate of their bus, bit/s.
    pub bits_per_s: u32,
    /// Their numbers.
    pub nodes: [u8; N],
}

impl<const N: usize> LastDrives<N> {
    /// Those of a configuration in use.
    #[must_use]
    pub fn of(active: &Active<N>) -> Self {
        let mut nodes = [0; N];
        for (node, cable) in nodes.iter_mut().zip(&active.cables) {
            *node = cable.node;
        }
        Self {
            kind: active.drive_kind,
            bits_per_s: active.bus_bitrate,
            nodes,
        }
    }

    /// With a checksum, for memory with undefined contents. Four drives at most.
    #[must_use]
    pub fn to_words(&self) -> [u32; WORDS] {
        let mut nodes = [0; 4];
        for (to, node) in nodes.iter_mut().zip(self.nodes) {
            *to = node;
        }
        let kind = self.kind as u32;
        let nodes = u32::from_le_bytes(nodes);
        let sum = checksum([kind, self.bits_per_s, nodes]);
        [kind, self.bits_per_s, nodes, sum]
    }

    /// `None` if the memory does not contain valid data.
    #[must_use]
    pub fn from_words(&[kind, bits_per_s, nodes, sum]: &[u32; WORDS]) -> Option<Self> {
        // RAM at power-on is random: by chance a checksum of 32 bits fits once in 4e9 starts.
        if sum != checksum([kind, bits_per_s, nodes]) || bits_per_s == 0 {
            return None;
        }
        let kind = match kind {
            1 => DriveKind::Rmds,
            2 => DriveKind::Cia402,
            _ => return None,
        };
        let mut all = [0; N];
        for (to, node) in all.iter_mut().zip(nodes.to_le_bytes()) {
            *to = node;
        }
        Some(Self {
            kind,
            bits_per_s,
            nodes: all,
        })
    }
}

fn checksum(words: [u32; 3]) -> u32 {
    let mut bytes = [0; 12];
    for (to, word) in bytes.chunks_exact_mut(4).zip(words) {
        to.copy_from_slice(&word.to_le_bytes());
    }
    crc32(&bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_kept_comes_back_and_noise_does_not() {
        let last = LastDrives {
            kind: DriveKind::Rmds,
            bits_per_s: 1_000_000,
            nodes: [1, 2, 3, 15],
        };
        let words = last.to_words();
        assert_eq!(LastDrives::from_words(&words), Some(last));
        for place in 0..WORDS {
            for bit in 0..32 {
                let mut words = words;
                words[place] ^= 1 << bit;
                assert_eq!(LastDrives::<4>::from_words(&words), None, "{place} {bit}");
            }
        }
        assert_eq!(LastDrives::<4>::from_words(&[0; WORDS]), None);
    }
}
