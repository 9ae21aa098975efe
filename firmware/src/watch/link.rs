//! The serial line: its noise, its heartbeat, and the fault that is latched first.

use mcdpr_protocol::{FaultRecord, Tick};

/// Errors on the serial line, as a bucket that leaks one error every 20 ms (L18).
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct LineNoise {
    level: u16,
}

/// Increment per error and decrement per tick; the limit: ten errors at once, or 150 per second
/// over a tenth of a second.
const ERROR_LEVEL: u16 = 20;
// 150 errors per second add 3 and lose 1 per tick: the bucket of 200 is full after 100 ms.
const NOISE_LEVEL: u16 = 200;

impl LineNoise {
    /// One tick with this many errors; returns whether it is too much.
    pub fn update(&mut self, errors: u16) -> bool {
        let filled = errors.saturating_mul(ERROR_LEVEL);
        self.level = self
            .level
            // Leaks first, then fills: ten errors in one tick reach the limit exactly.
            .saturating_sub(1)
            .saturating_add(filled)
            // Bounded: after the longest burst the line counts as good again within 200 ms.
            .min(2 * NOISE_LEVEL);
        self.level >= NOISE_LEVEL
    }

    /// Errors in the bucket.
    #[must_use]
    pub fn errors(&self) -> i32 {
        i32::from(self.level / ERROR_LEVEL)
    }
}

/// Heartbeats: one timeline, counted from the last one (L9, L10).
#[derive(Debug, Clone, Copy, Default)]
pub struct Heartbeat {
    last: Option<Tick>,
}

/// Phase of a link on the timeline.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum LinkHealth {
    /// In time.
    Good,
    /// 20 ms or more: a warning.
    Late,
    /// 100 ms or more: decelerate and hold.
    Lost,
    /// Held for two seconds: brakes, then torque off.
    Expired,
}

impl Heartbeat {
    /// A heartbeat arrived.
    pub const fn beat(&mut self, now: Tick) {
        self.last = Some(now);
    }

    /// The present phase; lost if there never was a heartbeat.
    #[must_use]
    pub fn health(&self, now: Tick) -> LinkHealth {
        match self.last.map(|last| now.since(last)) {
            // A wrapped difference is negative and counts as fresh. `forget_expired` keeps that
            // from happening.
            Some(..20) => LinkHealth::Good,
            Some(20..100) => LinkHealth::Late,
            Some(100..2100) => LinkHealth::Lost,
            _ => LinkHealth::Expired,
        }
    }

    /// Discards a heartbeat that has expired, once per tick: otherwise it would seem new again when
    /// the tick counter has gone half around (K9).
    pub(crate) fn forget_expired(&mut self, now: Tick) {
        if self.health(now) == LinkHealth::Expired {
            self.last = None;
        }
    }

    /// Milliseconds since the last one.
    #[must_use]
    pub fn age_ms(&self, now: Tick) -> i32 {
        self.last.map_or(i32::MAX, |last| now.since(last))
    }
}

/// The latched fault: the first cause stays until it is cleared.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Latch {
    record: Option<FaultRecord>,
}

impl Latch {
    /// Latches, if nothing is latched yet.
    pub fn set(&mut self, record: FaultRecord) {
        // Consequences of a fault often trip other detectors: only the first record names the
        // cause.
        self.record.get_or_insert(record);
    }

    /// The latched fault.
    #[must_use]
    pub const fn get(&self) -> Option<FaultRecord> {
        self.record
    }

    /// Whether a fault is latched.
    pub(crate) const fn is_set(&self) -> bool {
        self.record.is_some()
    }

    /// Clears it.
    pub const fn clear(&mut self) {
        self.record = None;
    }
}
