//! Duration of a frame on the wire: its bits, stuffed, with its real checksum.

use mcdpr_firmware::drives::CanFrame;

/// Polynomial of the frame check (ISO 11898-1): x^15 + x^14 + x^10 + x^8 + x^7 + x^4 + x^3 + 1.
const CHECK: u16 = 0x4599;
/// Check delimiter, acknowledge and its delimiter, end of frame, gap to the next.
const TAIL_BITS: u64 = 1 + 2 + 7 + 3;
/// Error flag, the others' flags that it provokes, delimiter, gap.
pub(super) const ERROR_BITS: u64 = 6 + 6 + 8 + 3;

/// Checksum of one byte: `CHECKED[check's upper eight bits ^ byte]`.
const CHECKED: [u16; 256] = checked();
/// Stuffing of one byte, by what was sent before it (see [`Sent`]): 8 times the stuff bits, plus the state after it.
const STUFFED: [[u8; 256]; 8] = stuffed();

const fn checked() -> [u16; 256] {
    let mut table = [0; 256];
    let mut byte = 0_u16;
    while byte < 256 {
        let (mut check, mut bit) = (byte << 7, 0);
        while bit < 8 {
            let feed = check >> 14;
            check = ((check << 1) & 0x7FFF) ^ (feed * CHECK);
            bit += 1;
        }
        table[byte as usize] = check;
        byte += 1;
    }
    table
}

/// The last bit on the wire (4 for a one), plus how many bits before it are like it: a fifth is followed by the opposite bit,
/// which begins a new run.
#[derive(Clone, Copy)]
struct Sent(usize);

impl Sent {
    /// What was sent after one more bit, and how many stuff bits follow it.
    const fn then(self, bit: usize) -> (Self, u8) {
        let (last, run) = (self.0 / 4, self.0 % 4);
        if bit != last {
            (Self(4 * bit), 0)
        } else if run == 3 {
            (Self(4 * (1 - bit)), 1)
        } else {
            (Self(self.0 + 1), 0)
        }
    }
}

const fn stuffed() -> [[u8; 256]; 8] {
    let mut table = [[0; 256]; 8];
    let mut state = 0;
    while state < 8 {
        let mut byte = 0;
        while byte < 256 {
            let (mut sent, mut stuffs, mut place) = (Sent(state), 0, 8);
            while place > 0 {
                place -= 1;
                let (next, more) = sent.then((byte >> place) & 1);
                (sent, stuffs) = (next, stuffs + more);
            }
            table[state][byte] = 8 * stuffs + sent.0 as u8;
            byte += 1;
        }
        state += 1;
    }
    table
}

/// Bits from the start of a frame to the end of its checksum, first bit first, and how many.
fn plain(frame: &CanFrame) -> (u128, u32) {
    // Start, RTR, IDE and r0 are dominant in a data frame with 11 bits of identifier.
    let mut bits = u128::from(frame.id & 0x7FF) << 7 | u128::from(frame.len);
    let mut count = 19_u32;
    for byte in frame.data.iter().take(usize::from(frame.len)) {
        bits = (bits << 8) | u128::from(*byte);
        count += 8;
    }
    // The checksum covers all bits since the start of the frame, before stuffing. Zeros before them change nothing.
    let mut check = 0_u16;
    for place in (0..count.div_ceil(8)).rev() {
        let byte = (bits >> (8 * place)) as u8;
        let index = usize::from((check >> 7) as u8 ^ byte);
        check = ((check << 8) & 0x7FFF) ^ CHECKED[index];
    }
    ((bits << 15) | u128::from(check), count + 15)
}

/// Bits that a frame takes, gap to the next included.
///
/// ```
/// use mcdpr_firmware::drives::CanFrame;
/// // 34 bits that may be stuffed, and 13. An identifier of 0x555 needs no stuffing itself; five
/// // zeros follow each other once before the checksum.
/// let empty = CanFrame { id: 0x555, ..CanFrame::default() };
/// assert!((47..=55).contains(&mcdpr_simulator::can::frame_bits(&empty)));
/// ```
#[must_use]
pub fn frame_bits(frame: &CanFrame) -> u64 {
    let (bits, count) = plain(frame);
    // The start of the frame and the first bit of its identifier; the others are whole bytes.
    let first = (bits >> (count - 2)) & 1;
    let (mut sent, _) = Sent(0).then(first as usize);
    let mut stuffs = 0;
    for place in (0..(count - 2) / 8).rev() {
        let byte = (bits >> (8 * place)) as u8;
        let entry = STUFFED[sent.0][usize::from(byte)];
        stuffs += u64::from(entry / 8);
        sent = Sent(usize::from(entry % 8));
    }
    u64::from(count) + stuffs + TAIL_BITS
}

#[cfg(test)]
mod tests {
    use super::*;
    use mcdpr_firmware::config::schedule::worst_bits;

    #[test]
    fn an_empty_frame_of_zeros_takes_53_bits() {
        // All 34 bits are zero, and so is their checksum: a stuff bit after the first five and
        // after every further five (the stuff bit ends the run): 34 + 6 + 13.
        assert_eq!(frame_bits(&CanFrame::default()), 53);
    }

    /// Bit by bit, as ISO 11898-1 describes it.
    fn counted(frame: &CanFrame) -> u64 {
        let number = |value: u64, width: u32| (0..width).rev().map(move |k| (value >> k) & 1 == 1);
        let mut bits = vec![false];
        bits.extend(number(u64::from(frame.id), 11));
        bits.extend([false; 3]);
        bits.extend(number(u64::from(frame.len), 4));
        for byte in &frame.data[..usize::from(frame.len)] {
            bits.extend(number(u64::from(*byte), 8));
        }
        let mut check = 0_u16;
        for bit in &bits {
            let feed = *bit ^ (check & 0x4000 != 0);
            check = (check << 1) & 0x7FFF;
            if feed {
                check ^= CHECK;
            }
        }
        bits.extend(number(u64::from(check), 15));
        let (mut sent, mut run, mut last) = (0, 0, None);
        for bit in bits {
            sent += 1;
            run = if last == Some(bit) { run + 1 } else { 1 };
            last = Some(bit);
            if run == 5 {
                sent += 1;
                (run, last) = (1, Some(!bit));
            }
        }
        sent + TAIL_BITS
    }

    #[test]
    fn no_frame_takes_more_than_the_schedule_reckons_with() {
        let mut seed = 1_u64;
        let mut most = [0; 9];
        for _ in 0..200_000 {
            seed = seed
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(99);
            let len = (seed >> 60) as u8 % 9;
            // Runs of equal bits are what gets stuffed: few different bytes.
            let byte = [0x00, 0xFF, 0x0F, 0xF8, 0x87, 0x78, 0x3C, 0xC3];
            let mut data = [0; 8];
            for (place, slot) in data.iter_mut().take(usize::from(len)).enumerate() {
                *slot = byte[(seed >> (3 * place)) as usize % 8];
            }
            let id = (seed >> 33) as u16 & 0x7FF;
            let frame = CanFrame { id, len, data };
            let bits = frame_bits(&frame);
            assert_eq!(bits, counted(&frame), "{frame:?}");
            let slot = &mut most[usize::from(len)];
            *slot = bits.max(*slot);
            assert!(bits <= u64::from(worst_bits(u32::from(len))));
            assert!(bits >= 47 + 8 * u64::from(len));
        }
        // The bound is tight: some frames come near it.
        assert!(most[8] >= 125, "{most:?}");
    }
}
