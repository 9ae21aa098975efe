//! The drives' share of the bus, with worst-case bit stuffing.

use super::DriveKind;

/// SYNCs from one report of the mode to the next.
// A wrong mode is noticed within 20 ms at the usual period of 2 ms.
pub(crate) const MODE_SYNCS: u8 = 10;
/// Greatest share of the bus for cyclic frames, in thousandths: the rest is for other frames and
/// repetitions.
pub(crate) const MOST_LOAD_PERMILLE: u32 = 700;

/// Bits of a data frame with an 11-bit identifier and `bytes` of data, gap between frames
/// included, when every stuff bit that can be is there: the 34 bits from start to checksum that are
/// not data, the data, one stuff bit for the first five and every four after them, and 13 that are
/// never stuffed (Tindell and Burns, 1994).
#[must_use]
pub const fn worst_bits(bytes: u32) -> u32 {
    let stuffed = 34 + 8 * bytes;
    // Eight bytes: 98 + 24 + 13 = 135 bits. The 13 are delimiters, acknowledge, end of frame and
    // interframe space.
    stuffed + (stuffed - 1) / 4 + 13
}

/// Bits on the bus per cycle of one drive: its command and its answer.
#[must_use]
pub(crate) const fn bits_per_cycle(kind: DriveKind, by_tension: bool) -> u32 {
    match kind {
        DriveKind::None => 0,
        DriveKind::Rmds => 2 * worst_bits(8),
        // Control word with a position, a speed or a torque; status word, position and torque.
        DriveKind::Cia402 => worst_bits(if by_tension { 4 } else { 6 }) + worst_bits(8),
    }
}

/// Bits per second other than commands and their answers: the SYNC of every shortest period, and
/// from each drive the mode ([`MODE_SYNCS`] SYNCs apart) and ten heartbeats.
#[must_use]
pub(crate) const fn overhead_bits_per_s(kind: DriveKind, drives: u32, shortest_us: u32) -> u32 {
    match kind {
        DriveKind::None | DriveKind::Rmds => 0,
        DriveKind::Cia402 => {
            let syncs_per_s = 1_000_000 / shortest_us;
            let modes_per_s = drives * syncs_per_s / MODE_SYNCS as u32;
            // One heartbeat in 50 ms is the board's own.
            let beats_per_s = drives * 10 + 20;
            syncs_per_s * worst_bits(0) + (modes_per_s + beats_per_s) * worst_bits(1)
        }
    }
}

/// Share of the bus that the drives take, thousandths, rounded up. `cycles` gives each drive's
/// period (µs, 500 at least) and whether it is commanded by force; `bits_per_s` is 1000 at least.
///
/// ```
/// use mcdpr_firmware::config::DriveKind;
/// use mcdpr_firmware::config::schedule::load_permille;
/// let four = [(2000, false), (2000, false), (2000, false), (2000, true)];
/// // 4 drives, 2 frames of 135 bits, 500 times a second: 540 kbit/s.
/// assert_eq!(load_permille(DriveKind::Rmds, 1_000_000, four), 540);
/// ```
#[must_use]
pub fn load_permille(
    kind: DriveKind,
    bits_per_s: u32,
    cycles: impl IntoIterator<Item = (u32, bool)>,
) -> u32 {
    let (mut bits, mut drives, mut shortest_us) = (0, 0, u32::MAX);
    for (period_us, by_tension) in cycles {
        // Rounded up throughout: the result is a worst case.
        bits += 1_000_000_u32.div_ceil(period_us) * bits_per_cycle(kind, by_tension);
        drives += 1;
        shortest_us = shortest_us.min(period_us);
    }
    bits += overhead_bits_per_s(kind, drives, shortest_us);
    bits.div_ceil(bits_per_s / 1000)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_longest_frame_takes_135_bits_and_an_empty_one_55() {
        // 8 bytes: 98 bits stuffed, 24 stuff bits, 13 more.
        assert_eq!(worst_bits(8), 135);
        // 0 bytes: 34, 8, 13.
        assert_eq!(worst_bits(0), 55);
        assert_eq!(worst_bits(1), 65);
    }

    fn load(kind: DriveKind, bits_per_s: u32, period_us: u32, tension_us: u32) -> u32 {
        let held = (period_us, false);
        load_permille(kind, bits_per_s, [held, held, held, (tension_us, true)])
    }

    #[test]
    fn the_defaults_fit_and_twice_as_fast_does_not() {
        for kind in [DriveKind::Rmds, DriveKind::Cia402] {
            assert!(load(kind, 1_000_000, 2000, 2000) <= MOST_LOAD_PERMILLE);
            assert!(load(kind, 500_000, 4000, 4000) <= MOST_LOAD_PERMILLE);
            assert!(load(kind, 1_000_000, 1000, 1000) > MOST_LOAD_PERMILLE);
            assert!(load(kind, 500_000, 2000, 2000) > MOST_LOAD_PERMILLE);
            // One tension axis may have 1 kHz at 1 Mbit/s, two may not.
            assert!(load(kind, 1_000_000, 2000, 1000) <= MOST_LOAD_PERMILLE);
            let two = [(2000, false), (2000, false), (1000, true), (1000, true)];
            assert!(load_permille(kind, 1_000_000, two) > MOST_LOAD_PERMILLE);
        }
    }

    #[test]
    fn the_load_is_that_of_a_sum_by_hand() {
        // RMDS at 1 kHz: 4 * 2 * 135 * 1000.
        assert_eq!(load(DriveKind::Rmds, 1_000_000, 1000, 1000), 1080);
        // CiA 402 at 500 Hz: 500 (3 (115 + 135) + 95 + 135 + 55) + (4 * 50 + 60) * 65
        //   = 517,500 + 16,900 = 534.4.
        assert_eq!(load(DriveKind::Cia402, 1_000_000, 2000, 2000), 535);
    }
}
