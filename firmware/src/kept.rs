//! Lengths that outlive a reset of the board: stored in every tick, in registers that a reset leaves.
//!
//! Counters of incremental encoders start at zero with the chip. A board that a fault of its program has reset stopped
//! counting for some tens of microseconds only; the lengths of its last tick and the counts since its start together
//! are the lengths now. The host decides whether to use them (`mcdpr recover`).

/// Lengths of one tick, with a checksum: registers without a battery hold zeros after power-on, and a reset may
/// fall between two writes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct KeptLengths<const N: usize> {
    /// Paid-out lengths, 0.1 µm.
    pub lengths: [i32; N],
    /// Brakes that were commanded open; bit 0 is the first.
    pub brakes_open: u8,
}

impl<const N: usize> KeptLengths<N> {
    /// Checksum of 16 bits; never 0, so that 0 marks contents as invalid.
    // A product with an odd number per word (Fowler, Noll and Vo's hash): a CRC over the same bytes would take
    // a thousand cycles of every tick.
    #[must_use]
    pub fn checksum(&self) -> u16 {
        let first = BASIS ^ u32::from(self.brakes_open);
        let lengths = self.lengths.iter();
        let sum = lengths.fold(first.wrapping_mul(PRIME), |sum, length| {
            // The rotation brings high bits down: a product alone only carries upwards.
            (sum.rotate_left(15) ^ length.cast_unsigned()).wrapping_mul(PRIME)
        });
        let [a, b, c, d] = sum.to_le_bytes();
        (u16::from_le_bytes([a, b]) ^ u16::from_le_bytes([c, d])).max(1)
    }

    /// These contents, if the checksum fits. By chance it does once in 65,536.
    #[must_use]
    pub fn checked(self, checksum: u16) -> Option<Self> {
        (checksum == self.checksum()).then_some(self)
    }
}

const BASIS: u32 = 0x811C_9DC5;
const PRIME: u32 = 0x0100_0193;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_changed_bit_or_an_empty_register_is_not_taken_for_lengths() {
        let kept = KeptLengths {
            lengths: [12_345_678, 0, -1, 31_000_000],
            brakes_open: 0b1111,
        };
        let sum = kept.checksum();
        assert_eq!(kept.checked(sum), Some(kept));
        for cable in 0..4 {
            for bit in 0..32 {
                let mut other = kept;
                other.lengths[cable] ^= 1 << bit;
                assert_eq!(other.checked(sum), None, "{cable} {bit}");
            }
        }
        for bit in 0..8 {
            let brakes_open = kept.brakes_open ^ 1 << bit;
            let other = KeptLengths {
                brakes_open,
                ..kept
            };
            assert_eq!(other.checked(sum), None, "{bit}");
        }
        let swapped = KeptLengths {
            lengths: [0, 12_345_678, -1, 31_000_000],
            ..kept
        };
        assert_eq!(swapped.checked(sum), None);
        let empty = KeptLengths {
            lengths: [0; 4],
            brakes_open: 0,
        };
        assert_eq!(empty.checked(0), None);
        assert_eq!(kept.checked(0), None);
    }
}
