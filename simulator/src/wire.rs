//! One direction of a serial line in virtual time: byte rate, latency, and faults.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use std::collections::VecDeque;

/// Faults of a line. Probabilities are per byte, 0 for a perfect line.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct WireFaults {
    /// A byte is lost.
    pub drop: f64,
    /// One bit of a byte flips.
    pub corrupt: f64,
    /// A byte arrives twice.
    pub duplicate: f64,
    /// The line pauses before a byte, for up to [`WireFaults::longest_delay_us`].
    pub delay: f64,
    /// Longest pause, µs.
    pub longest_delay_us: u32,
    /// Bytes of noise that a receiver sees per second, between the transmitted ones: random bits,
    /// half of them without a stop bit.
    pub noise_per_s: f64,
}

/// One direction of a line. Bytes arrive in order, each after its time on the wire.
#[derive(Debug, Clone)]
pub struct Wire {
    byte_ns: u64,
    latency_ns: u64,
    faults: WireFaults,
    rng: ChaCha8Rng,
    /// Time at which the line has sent all bytes it was given, ns.
    free_ns: u64,
    bytes: VecDeque<(u64, u8)>,
    /// Arrival times of bytes whose start or stop bit was hit, ns.
    framing_errors: VecDeque<u64>,
    /// Time up to which noise has been generated, ns.
    noise_ns: u64,
}

impl Wire {
    /// A line of `baud` bit/s with ten bits a byte, and `latency_us` of bridges and drivers.
    #[must_use]
    pub fn new(baud: u32, latency_us: u32, faults: WireFaults, seed: u64) -> Self {
        Self {
            // Ten bits a byte in ns: 10.85 us at 921600 baud.
            byte_ns: 10_000_000_000 / u64::from(baud.max(1)),
            latency_ns: u64::from(latency_us) * 1000,
            faults,
            rng: ChaCha8Rng::seed_from_u64(seed),
            free_ns: 0,
            bytes: VecDeque::new(),
            framing_errors: VecDeque::new(),
            noise_ns: 0,
        }
    }

    /// Generates the noise up to `now_us`, if the line is noisy.
    pub(crate) fn make_noise(&mut self, now_us: u64) {
        let now_ns = now_us * 1000;
        let rate = self.faults.noise_per_s;
        if rate <= 0.0 || rate.is_nan() {
            self.noise_ns = now_ns;
            return;
        }
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "positive, and saturates"
        )]
        let step_ns = ((1e9 / rate) as u64).max(self.byte_ns);
        while self.noise_ns + step_ns <= now_ns {
            self.noise_ns += step_ns;
            // Bytes stay in the order of arrival: the receiver takes them from the front.
            let last = self.bytes.back().map_or(0, |(arrival, _)| *arrival);
            let arrival = last.max(self.noise_ns);
            let bits = self.rng.next_u32();
            if bits & 0x100 != 0 {
                self.framing_errors.push_back(arrival);
            }
            self.bytes.push_back((arrival, bits.to_le_bytes()[0]));
        }
    }

    /// Puts bytes on the line at `now_us`.
    pub fn send(&mut self, now_us: u64, bytes: &[u8]) {
        for &byte in bytes {
            let start = self.free_ns.max(now_us * 1000) + self.pause_ns();
            self.free_ns = start + self.byte_ns;
            // A byte that is lost has taken its time on the wire.
            if self.happens(self.faults.drop) {
                continue;
            }
            let mut byte = byte;
            let arrival = self.free_ns + self.latency_ns;
            if self.happens(self.faults.corrupt) {
                // Ten bits are on the line: a start or stop bit that flips is a framing error for
                // the receiver, and the byte is wrong as well.
                let bit = self.rng.next_u32() % 10;
                if bit >= 8 {
                    self.framing_errors.push_back(arrival);
                }
                byte ^= 1 << (bit % 8);
            }
            self.bytes.push_back((arrival, byte));
            if self.happens(self.faults.duplicate) {
                self.bytes.push_back((arrival, byte));
            }
        }
    }

    /// Takes the bytes that have arrived by `now_us`.
    pub fn receive(&mut self, now_us: u64, into: &mut Vec<u8>) {
        while let Some(&(arrival, byte)) = self.bytes.front()
            && arrival <= now_us * 1000
        {
            self.bytes.pop_front();
            into.push(byte);
        }
    }

    /// Framing errors that a receiver has seen by `now_us` since the last call.
    pub(crate) fn take_framing_errors(&mut self, now_us: u64) -> u16 {
        let due = |arrival: &u64| *arrival <= now_us * 1000;
        let count = self.framing_errors.iter().take_while(|a| due(a)).count();
        self.framing_errors.drain(..count);
        u16::try_from(count).unwrap_or(u16::MAX)
    }

    /// When the next byte arrives, µs, rounded up.
    #[must_use]
    pub(crate) fn next_arrival_us(&self) -> Option<u64> {
        let (arrival, _) = self.bytes.front()?;
        Some(arrival.div_ceil(1000))
    }

    /// Bytes given to the line that are not sent yet.
    #[must_use]
    pub(crate) fn backlog(&self, now_us: u64) -> usize {
        let left_ns = self.free_ns.saturating_sub(now_us * 1000);
        usize::try_from(left_ns / self.byte_ns).unwrap_or(usize::MAX)
    }

    /// Changes the faults from now on.
    pub(crate) fn set_faults(&mut self, faults: WireFaults) {
        self.faults = faults;
    }

    fn happens(&mut self, probability: f64) -> bool {
        // A perfect line draws no random numbers, so that faults elsewhere do not change its run.
        probability > 0.0 && f64::from(self.rng.next_u32()) < probability * 2f64.powi(32)
    }

    fn pause_ns(&mut self) -> u64 {
        if !self.happens(self.faults.delay) {
            return 0;
        }
        let longest = u64::from(self.faults.longest_delay_us) * 1000;
        self.rng.next_u64() % (longest + 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_take_their_time_and_keep_their_order() {
        let mut wire = Wire::new(1_000_000, 500, WireFaults::default(), 1);
        wire.send(0, &[1, 2, 3]);
        let mut got = Vec::new();
        wire.receive(509, &mut got);
        assert_eq!(got, []);
        wire.receive(520, &mut got);
        assert_eq!(got, [1, 2]);
        assert_eq!(wire.next_arrival_us(), Some(530));
        wire.receive(530, &mut got);
        assert_eq!(got, [1, 2, 3]);
    }

    #[test]
    fn noise_fills_a_silent_line_at_its_rate_and_half_of_it_has_no_stop_bit() {
        let mut wire = Wire::new(921_600, 0, WireFaults::default(), 5);
        wire.make_noise(1000);
        wire.set_faults(WireFaults {
            noise_per_s: 20_000.0,
            ..WireFaults::default()
        });
        let (mut got, mut errors) = (Vec::new(), 0);
        for ms in 2..=101 {
            wire.make_noise(ms * 1000);
            wire.receive(ms * 1000, &mut got);
            errors += wire.take_framing_errors(ms * 1000);
        }
        assert_eq!(got.len(), 2000);
        assert!((900..1100).contains(&errors), "{errors}");
    }

    #[test]
    fn faults_come_as_often_as_asked_and_alike_for_a_seed() {
        let faults = WireFaults {
            drop: 0.1,
            corrupt: 0.05,
            duplicate: 0.02,
            delay: 0.01,
            longest_delay_us: 1000,
            noise_per_s: 0.0,
        };
        let run = |seed| {
            let mut wire = Wire::new(921_600, 0, faults, seed);
            wire.send(0, &[0xA5; 10_000]);
            let mut got = Vec::new();
            wire.receive(10_000_000, &mut got);
            got
        };
        let got = run(3);
        assert_eq!(got, run(3));
        assert_ne!(got, run(4));
        let expected = 10_000.0 * 0.9 * 1.02;
        assert!((got.len() as f64 - expected).abs() < 150.0, "{}", got.len());
        let damaged = got.iter().filter(|&&byte| byte != 0xA5).count() as f64;
        assert!(
            (damaged / got.len() as f64 - 0.05).abs() < 0.01,
            "{damaged}"
        );
    }
}

/// Version of a wire format and of the firmware that speaks it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WireVersion {
    /// Boards and hosts of different major versions do not understand each other.
    pub major: u16,
    /// Raised by every change.
    pub minor: u16,
    /// Commit that the firmware is of: its first eight digits, or zeros.
    pub git_hash: [u8; 8],
}

/// Properties of the line to the board.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinkOptions {
    /// Bit/s.
    pub baud: u32,
    /// One-way latency of bridges and drivers, µs.
    pub latency_us: u32,
    /// Faults on the way to the board.
    pub to_board: WireFaults,
    /// Faults on the way to the host.
    pub to_host: WireFaults,
    /// The board's tick when it starts (a test of the counter's wrap starts near the end).
    pub first_tick: u32,
    /// Wire format and firmware that the board reports, if not these.
    pub version: Option<WireVersion>,
}

impl Default for LinkOptions {
    fn default() -> Self {
        Self {
            baud: 921_600,
            latency_us: 1000,
            to_board: WireFaults::default(),
            to_host: WireFaults::default(),
            first_tick: 0,
            version: None,
        }
    }
}
