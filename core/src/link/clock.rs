//! The board's clock, seen from the host: offset and drift from the answers to heartbeats.
//!
//! An answer gives the board's tick at some moment between sending and receiving; the shorter the
//! round trip, the smaller the uncertainty (Cristian, 1989). The shortest of every quarter of a
//! second is kept, and a line fitted through half a minute of them gives offset and drift: least
//! squares, each point weighted by the uncertainty of its round trip.

use std::collections::VecDeque;

/// The best answer of each interval of this length is kept, µs.
const WINDOW_US: u64 = 250_000;
/// Answers that are kept: half a minute.
const KEPT: usize = 120;
/// Assumed difference between two crystals before anything was measured, as a share (standard
/// deviation).
/// 100 ppm are 3 ms in the half minute of the fit.
const DRIFT_PRIOR: f64 = 100e-6;
/// The board's clock jumped if it is this far from the estimate beyond the round trip, µs. A
/// restarted board is detected by ticks that run backwards, independent of this limit. A simulator
/// on a busy machine falls behind and catches up; that does not count as a jump.
const JUMP_US: f64 = 700_000.0;

/// One answer.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Point {
    /// Middle of the round trip, link time, µs.
    at_us: u64,
    /// The board's time then, µs since its first answer; a tick lasts a millisecond, so its middle.
    board_us: f64,
    /// Uncertainty, µs (standard deviation).
    sigma_us: f64,
}

/// The board's clock ran backwards or jumped: the board restarted or was exchanged.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Jump {
    /// Board time minus the time expected, ms.
    pub by_ms: f64,
}

/// An estimate of a board's clock.
#[derive(Debug, Clone, Default)]
pub struct BoardClock {
    /// Last tick, and ticks since the first answer.
    last: Option<(u32, u64)>,
    first_tick: u32,
    kept: VecDeque<Point>,
    best: Option<Point>,
    window_us: u64,
    line: Option<Line>,
}

/// board_us = offset + (1 + drift) (at - origin).
#[derive(Debug, Clone, Copy)]
struct Line {
    origin_us: u64,
    offset_us: f64,
    drift: f64,
    /// Uncertainty of its best point, µs (standard deviation).
    sigma_us: f64,
}

impl Line {
    fn at(&self, time_us: u64) -> f64 {
        self.offset_us + (1.0 + self.drift) * difference(time_us, self.origin_us)
    }
}

#[expect(clippy::cast_precision_loss, reason = "differences of link times")]
fn difference(a: u64, b: u64) -> f64 {
    if a >= b {
        (a - b) as f64
    } else {
        -((b - a) as f64)
    }
}

impl BoardClock {
    /// Takes an answer: the tick that it reports, when its request was sent and when it arrived,
    /// link time, µs.
    ///
    /// # Errors
    /// [`Jump`] if the board's clock ran backwards, or is 0.7 s away from the expected value; the
    /// estimate stays as it was.
    pub fn observe(&mut self, tick: u32, sent_us: u64, received_us: u64) -> Result<(), Jump> {
        #[expect(
            clippy::cast_precision_loss,
            reason = "round trips of some milliseconds"
        )]
        let round_trip_us = received_us.saturating_sub(sent_us) as f64;
        let ticks = match self.last {
            None => {
                self.first_tick = tick;
                0
            }
            Some((last, ticks)) => {
                // Ticks wrap after 49 days; a board that restarted counts from zero, so its step is
                // negative.
                let step = tick.wrapping_sub(last).cast_signed();
                let Ok(step) = u64::try_from(step) else {
                    let by_ms = f64::from(step);
                    return Err(Jump { by_ms });
                };
                ticks + step
            }
        };
        #[expect(
            clippy::cast_precision_loss,
            reason = "years of milliseconds are exact"
        )]
        let board_us = ticks as f64 * 1e3 + 500.0;
        let at_us = sent_us + received_us.saturating_sub(sent_us) / 2;
        if let Some(line) = &self.line {
            let off_us = board_us - line.at(at_us);
            // The whole round trip may have been spent in one direction.
            if off_us.abs() > JUMP_US + round_trip_us + 2.0 * line.sigma_us {
                let by_ms = off_us * 1e-3;
                return Err(Jump { by_ms });
            }
        }
        self.last = Some((tick, ticks));
        let point = Point {
            at_us,
            board_us,
            // Uniform over the round trip, and over the tick.
            sigma_us: (round_trip_us.powi(2) + 1e6).sqrt() / 12_f64.sqrt(),
        };
        let full = at_us >= self.window_us + WINDOW_US;
        if full {
            self.kept.extend(self.best.take());
            while self.kept.len() > KEPT {
                self.kept.pop_front();
            }
            self.window_us = at_us;
        }
        if self.best.is_none_or(|best| point.sigma_us < best.sigma_us) {
            self.best = Some(point);
        }
        if full || self.kept.is_empty() {
            self.fit();
        }
        Ok(())
    }

    fn fit(&mut self) {
        let points = || self.kept.iter().chain(&self.best);
        let Some(first) = points().next() else { return };
        let weight = |point: &Point| point.sigma_us.powi(-2);
        let x = |point: &Point| difference(point.at_us, first.at_us);
        // How far the board's clock is ahead: small numbers.
        let y = |point: &Point| point.board_us - x(point);
        let sum: f64 = points().map(weight).sum();
        let mean_x = points().map(|p| weight(p) * x(p)).sum::<f64>() / sum;
        let mean_y = points().map(|p| weight(p) * y(p)).sum::<f64>() / sum;
        let xx: f64 = points().map(|p| weight(p) * (x(p) - mean_x).powi(2)).sum();
        let xy: f64 = points()
            .map(|p| weight(p) * (x(p) - mean_x) * (y(p) - mean_y))
            .sum();
        // The prior keeps the drift within some 100 ppm as long as few points are kept.
        let drift = xy / (xx + DRIFT_PRIOR.powi(-2));
        self.line = Some(Line {
            origin_us: first.at_us,
            offset_us: mean_y - drift * mean_x,
            drift,
            sigma_us: points().map(|p| p.sigma_us).fold(f64::MAX, f64::min),
        });
    }

    /// The board's tick at a link time, µs, with its fraction: ticks since tick 0, not wrapped.
    /// `None` before the first answer.
    #[must_use]
    pub fn tick_at(&self, time_us: u64) -> Option<f64> {
        let line = self.line.as_ref()?;
        Some(f64::from(self.first_tick) + line.at(time_us) * 1e-3)
    }

    /// Ticks from `tick`, reported in an answer, to a link time, µs; never below zero.
    #[must_use]
    pub(crate) fn ticks_since(&self, tick: u32, time_us: u64) -> f64 {
        let (Some(line), Some((last, ticks))) = (&self.line, self.last) else {
            return 0.0;
        };
        let earlier = f64::from(last.wrapping_sub(tick).cast_signed());
        #[expect(
            clippy::cast_precision_loss,
            reason = "years of milliseconds are exact"
        )]
        let of_tick = ticks as f64 - earlier;
        (line.at(time_us) * 1e-3 - of_tick).max(0.0)
    }

    /// How much faster the board's clock runs than the host's, as a share; about 1e-4 at most for
    /// two crystals.
    #[must_use]
    pub fn drift(&self) -> f64 {
        self.line.map_or(0.0, |line| line.drift)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    /// A minute of heartbeats to a board whose clock is off by `drift`, over a line with a latency
    /// of 1 to 3 ms each way and one stall of 200 ms in ten; `first_tick` may wrap.
    fn minute(drift: f64, first_tick: u32) -> (BoardClock, impl Fn(u64) -> f64) {
        let mut clock = BoardClock::default();
        let mut random = Random::new(5);
        let mut share = || 0.5 + random.within(0.5);
        let truth = move |time_us: u64| {
            f64::from(first_tick) + (1.0 + drift) * (time_us as f64 - 1e6) * 1e-3
        };
        for beat in 0..7500_u64 {
            let sent = 1_000_000 + beat * 8000 + (share() * 900.0) as u64;
            let stall = if share() < 0.1 { 200e3 } else { 0.0 };
            let there = sent + 1000 + (share() * 2e3) as u64;
            let back = there + 1000 + (share() * 2e3 + stall) as u64;
            let tick = (truth(there).floor() as u64 & u64::from(u32::MAX)) as u32;
            clock.observe(tick, sent, back).unwrap();
        }
        (clock, truth)
    }

    #[test]
    fn offset_and_drift_are_found_through_jitter_and_stalls() {
        for (drift, first_tick) in [(0.0, 7), (80e-6, 7), (-120e-6, u32::MAX - 5000)] {
            let (clock, truth) = minute(drift, first_tick);
            assert!((clock.drift() - drift).abs() < 15e-6, "{}", clock.drift());
            for time_us in [40_000_000, 61_000_000, 62_000_000] {
                let off = clock.tick_at(time_us).unwrap() - truth(time_us);
                assert!(off.abs() < 0.5, "{off} ms at {time_us}");
            }
            let (tick, now) = (truth(60_500_000).floor(), 60_700_000);
            let wrapped = (tick as u64 & u64::from(u32::MAX)) as u32;
            let since = clock.ticks_since(wrapped, now);
            assert!((since - (truth(now) - tick)).abs() < 0.5, "{since}");
        }
    }

    #[test]
    fn a_clock_that_leaps_or_runs_back_is_refused() {
        let (mut clock, truth) = minute(50e-6, 100);
        let now = 61_500_000;
        let tick = truth(now) as u32;
        let back = clock.observe(tick - 2000, now, now + 2000).unwrap_err();
        assert!(back.by_ms < 0.0, "{back:?}");
        let leap = clock.observe(tick + 900, now, now + 2000).unwrap_err();
        assert!((leap.by_ms - 900.0).abs() < 5.0, "{leap:?}");
        // A refused answer has changed nothing.
        clock.observe(tick, now, now + 2000).unwrap();
        assert!((clock.drift() - 50e-6).abs() < 15e-6);
        assert_eq!(BoardClock::default().tick_at(5), None);
    }
}
