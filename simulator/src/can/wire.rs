//! Duration of a frame on the wire: its bits, stuffed, with its real checksum.

use mcdpr_firmware::drives::CanFrame;

/// Polynomial of the frame check (ISO 11898-1): x^15 + x^14 + x^10 + x^8 + x^7 + x^4 + x^3 + 1.
const CHECK: u16 = 0x4599;
/// Check delimiter, acknowledge and its delimiter, end of frame, gap to the next.
const TAIL_BITS: u64 = 1 + 2 + 7 + 3;
/// Error flag, the others' flags that it provokes, delimiter, gap.
pub(super) const ERROR_BITS: u64 = 6 + 6 + 8 + 3;

/// Bits from the start of a frame to the end of its checksum, first bit first, and how many.
fn plain(frame: &CanFrame) -> (u128, u32) {
    let mut bits = 0_u128;
    let mut count = 0_u32;
    let mut push = |value: u32, width: u32| {
        bits = (bits << width) | u128::from(value);
        count += width;
    };
    push(0, 1);
    push(u32::from(frame.id & 0x7FF), 11);
    // RTR, IDE and r0 are dominant in a data frame with 11 bits of identifier.
    push(0, 3);
    push(u32::from(frame.len), 4);
    for byte in frame.data.iter().take(usize::from(frame.len)) {
        push(u32::from(*byte), 8);
    }
    let mut check = 0_u16;
    // The checksum covers all bits since the start of the frame, before stuffing.
    for place in (0..count).rev() {
        let bit = u16::from((bits >> place) & 1 == 1);
        let feed = bit ^ (check >> 14);
        check = (check << 1) & 0x7FFF;
        if feed == 1 {
            check ^= CHECK;
        }
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
    let (mut sent, mut run, mut last) = (0_u64, 0, None);
    for place in (0..count).rev() {
        let bit = (bits >> place) & 1 == 1;
        sent += 1;
        run = if last == Some(bit) { run + 1 } else { 1 };
        last = Some(bit);
        if run == 5 {
            // The opposite bit, which begins a new run.
            sent += 1;
            (run, last) = (1, Some(!bit));
        }
    }
    sent + TAIL_BITS
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
            let bits = frame_bits(&CanFrame { id, len, data });
            let slot = &mut most[usize::from(len)];
            *slot = bits.max(*slot);
            assert!(bits <= u64::from(worst_bits(u32::from(len))));
            assert!(bits >= 47 + 8 * u64::from(len));
        }
        // The bound is tight: some frames come near it.
        assert!(most[8] >= 125, "{most:?}");
    }
}
