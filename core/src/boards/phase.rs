//! When each tick of a board begins, by the host's clock, to some ten microseconds.
//!
//! A board takes a heartbeat in the first tick after its arrival and answers at once. So the answer
//! leaves right after the beginning of the tick that it names, and arrives at the earliest the
//! line's least delay later; the heartbeat was sent at the latest the line's least delay before the
//! beginning of that tick. The least of many such differences in both directions, with the drift
//! of the crystals taken out, bound the beginning of the ticks; the middle of the bounds is right
//! where both directions have the same least delay. An asymmetry of the line is half an error here:
//! nothing that a host can measure shows it (D. L. Mills, RFC 5905).

use std::collections::VecDeque;

/// The best of each interval of this length is kept, µs.
const WINDOW_US: u64 = 250_000;
/// Intervals that are kept: half a minute.
const KEPT: usize = 120;
/// Two crystals differ by this share, standard deviation, before anything was measured.
const DRIFT_PRIOR: f64 = 100e-6;
/// Scatter of the best of an interval, µs.
const SCATTER_US: f64 = 20.0;
/// An interval whose best is later than the line through the others by this much was disturbed, µs.
const LATE_US: f64 = 150.0;
/// A tick, µs of the board's time.
const TICK_US: f64 = 1000.0;

/// One difference and when it was measured, µs.
#[derive(Debug, Clone, Copy)]
struct Least {
    at_us: f64,
    value_us: f64,
}

#[derive(Debug, Clone, Copy, Default)]
struct Window {
    /// Arrival of the answer minus the tick's time.
    back: Option<Least>,
    /// The tick's time minus the sending of the heartbeat.
    there: Option<Least>,
}

/// The ticks of a board by the host's clock.
#[derive(Debug, Clone, Default)]
pub(super) struct Phase {
    last: Option<(u32, u64)>,
    /// Host time of the first answer, µs: differences stay small.
    origin_us: u64,
    windows: VecDeque<Window>,
    begun_us: u64,
    /// Host time of tick n is `origin + offset + 1000 n (1 + slope)` with n from the first answer.
    fit: Option<(f64, f64)>,
}

impl Phase {
    /// A tick counted on from that of the first answer, across the wrap of the counter. Ticks
    /// before the first answer are negative.
    #[expect(
        clippy::cast_precision_loss,
        reason = "years of milliseconds are exact"
    )]
    pub(super) fn count(&self, tick: u32) -> Option<f64> {
        let (last, count) = self.last?;
        Some(count as f64 + f64::from(tick.wrapping_sub(last).cast_signed()))
    }

    /// The board's own number of a counted tick.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "wraps as the board's counter does"
    )]
    pub(super) fn number(&self, count: f64) -> u32 {
        let Some((last, at)) = self.last else {
            return 0;
        };
        let ahead = count as i64 - at as i64;
        last.wrapping_add(ahead as u32)
    }

    /// Takes an answer: the tick that it names, when its heartbeat was sent and when it arrived,
    /// host time, µs.
    #[expect(
        clippy::cast_precision_loss,
        reason = "hours of microseconds are exact"
    )]
    pub(super) fn observe(&mut self, tick: u32, sent_us: u64, received_us: u64) {
        let count = match self.last {
            None => {
                self.origin_us = sent_us;
                self.begun_us = sent_us;
                0
            }
            Some((last, count)) => {
                let step = tick.wrapping_sub(last).cast_signed();
                // An answer that was overtaken says nothing new.
                let Ok(step) = u64::try_from(step) else {
                    return;
                };
                count + step
            }
        };
        self.last = Some((tick, count));
        let own_us = count as f64 * TICK_US;
        let since = |time_us: u64| time_us as f64 - self.origin_us as f64;
        let (sent, received) = (since(sent_us), since(received_us));
        let slope = self.fit.map_or(0.0, |(_, slope)| slope);
        let full = self.windows.is_empty() || sent_us >= self.begun_us + WINDOW_US;
        if full {
            self.begun_us = sent_us;
            self.windows.push_back(Window::default());
            while self.windows.len() > KEPT {
                self.windows.pop_front();
            }
        }
        let Some(window) = self.windows.back_mut() else {
            return;
        };
        // Compared at the same time: within a window the drift is up to 30 us.
        let better = |old: &mut Option<Least>, new: Least, sign: f64| {
            let flat = |least: &Least| least.value_us - sign * slope * least.at_us;
            if old.as_ref().is_none_or(|old| flat(&new) < flat(old)) {
                *old = Some(new);
            }
        };
        let back = Least {
            at_us: own_us,
            value_us: received - own_us,
        };
        let there = Least {
            at_us: own_us,
            value_us: own_us - sent,
        };
        better(&mut window.back, back, 1.0);
        better(&mut window.there, there, -1.0);
        self.fit();
    }

    fn fit(&mut self) {
        let backs: Vec<Least> = self.windows.iter().filter_map(|w| w.back).collect();
        let theres = self.windows.iter().filter_map(|w| w.there);
        let least = |slope: f64| {
            let flat = backs.iter().map(|b| b.value_us - slope * b.at_us);
            flat.fold(f64::MAX, f64::min)
        };
        let mut slope = self.fit.map_or(0.0, |(_, slope)| slope);
        // Twice: the second time without the intervals that the first line shows as disturbed.
        for _ in 0..2 {
            let floor_us = least(slope);
            let good = || {
                backs.iter().filter(|b| {
                    self.fit.is_none() || b.value_us - slope * b.at_us < floor_us + LATE_US
                })
            };
            #[expect(clippy::cast_precision_loss, reason = "at most 120")]
            let count = good().count().max(1) as f64;
            let mean_x = good().map(|b| b.at_us).sum::<f64>() / count;
            let mean_y = good().map(|b| b.value_us).sum::<f64>() / count;
            let xx: f64 = good().map(|b| (b.at_us - mean_x).powi(2)).sum();
            let xy: f64 = good()
                .map(|b| (b.at_us - mean_x) * (b.value_us - mean_y))
                .sum();
            slope = xy / (xx + (SCATTER_US / DRIFT_PRIOR).powi(2));
        }
        let back_us = least(slope);
        let there_us = theres
            .map(|t| t.value_us + slope * t.at_us)
            .fold(f64::MAX, f64::min);
        self.fit = Some((f64::midpoint(back_us, -there_us), slope));
    }

    /// Host time at which a counted tick begins, µs.
    #[expect(
        clippy::cast_precision_loss,
        reason = "hours of microseconds are exact"
    )]
    pub(super) fn host_us(&self, count: f64) -> Option<f64> {
        let (offset, slope) = self.fit?;
        Some(self.origin_us as f64 + offset + TICK_US * count * (1.0 + slope))
    }

    /// The counted tick, with its fraction, at a host time, µs.
    #[expect(
        clippy::cast_precision_loss,
        reason = "hours of microseconds are exact"
    )]
    pub(super) fn count_at(&self, host_us: f64) -> Option<f64> {
        let (offset, slope) = self.fit?;
        Some((host_us - self.origin_us as f64 - offset) / (TICK_US * (1.0 + slope)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    /// A board's clock and line, seen only through its answers.
    struct Board {
        slow: f64,
        begins_us: f64,
        latency_us: f64,
        random: Random,
        phase: Phase,
    }

    impl Board {
        fn new(slow_ppm: f64, begins_us: f64, latency_us: f64, seed: u64) -> Self {
            Self {
                slow: slow_ppm * 1e-6,
                begins_us,
                latency_us,
                random: Random::new(seed),
                phase: Phase::default(),
            }
        }

        /// True time of the beginning of a tick, us.
        fn begins_at(&self, tick: f64) -> f64 {
            self.begins_us + tick * 1e3 * (1.0 + self.slow)
        }

        /// One heartbeat over a line with up to 0.4 ms of jitter each way, and a stall of up to
        /// 30 ms in one of twenty.
        fn beat(&mut self, sent_us: u64) {
            let mut share = || 0.5 + self.random.within(0.5);
            let there = self.latency_us + 400.0 * share() * share();
            let stall = if share() < 0.05 { 30e3 * share() } else { 0.0 };
            let back = self.latency_us + 400.0 * share() * share() + stall;
            let arrives = sent_us as f64 + there;
            let tick = ((arrives - self.begins_us) / (1e3 * (1.0 + self.slow))).ceil();
            let received = self.begins_at(tick) + back;
            self.phase.observe(tick as u32, sent_us, received as u64);
        }
    }

    /// Greatest error of the time between the two boards' ticks as the host finds it, us, from two
    /// seconds on.
    fn worst_us(mut boards: [Board; 2], seconds: u64) -> f64 {
        let (mut now, mut count, mut worst) = (5_000_u64, 0_u64, 0.0_f64);
        while now < seconds * 1_000_000 {
            for board in &mut boards {
                board.beat(now);
            }
            count += 1;
            now += 8_000 + count * 377 % 1000;
            if now > 2_000_000 && count.is_multiple_of(50) {
                let [first, second] = &boards;
                // When does the second board's tick at this moment begin by the first board's?
                let off = |board: &Board| {
                    let tick = (now as f64 * 1e-3).floor();
                    let counted = board.phase.count(tick as u32).unwrap();
                    board.phase.host_us(counted).unwrap() - board.begins_at(tick)
                };
                worst = worst.max((off(first) - off(second)).abs());
            }
        }
        worst
    }

    #[test]
    fn ticks_of_two_boards_are_known_to_a_tenth_of_a_millisecond_for_an_hour() {
        let boards = [
            Board::new(60.0, 137.0, 1300.0, 1),
            Board::new(-60.0, 861.0, 1300.0, 2),
        ];
        let worst = worst_us(boards, 3600);
        assert!(worst < 100.0, "{worst} us");
        assert!(worst > 0.0, "nothing was compared");
    }

    #[test]
    fn lines_of_different_length_do_not_matter_if_both_ways_are_alike() {
        let boards = [
            Board::new(-40.0, 930.0, 400.0, 3),
            Board::new(55.0, 20.0, 2600.0, 4),
        ];
        let worst = worst_us(boards, 60);
        assert!(worst < 100.0, "{worst} us");
    }

    #[test]
    fn a_counter_that_wraps_counts_on() {
        let mut phase = Phase::default();
        phase.observe(u32::MAX - 3, 1000, 3000);
        phase.observe(4, 9000, 11000);
        assert_eq!(phase.count(4), Some(8.0));
        assert_eq!(phase.count(u32::MAX), Some(3.0));
        assert_eq!(phase.number(3.0), u32::MAX);
    }
}
