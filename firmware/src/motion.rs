//! The motion in progress: a buffer of knots, a path clock that can run slower than time, and the
//! stop segment for a buffer that ran empty.

use crate::fixed::{quotient, saturate};
use crate::segment::{MAX_SPACING_MS, MIN_SPACING_MS, Point, Segment, StoredKnot, StoredRow};
use heapless::Deque;
use mcdpr_protocol::{ResidualRow, TenthMicrometres};

/// Knots that the buffer holds.
// Bounded by the RAM. With knots 30 ms apart they are half a second of motion.
pub const CAPACITY: usize = 16;

/// Full speed of the path clock, ms per tick with 16 fractional bits.
const FULL_RATE_Q16: u32 = 1 << 16;

/// Slowest rate of the clock while a motor is at its limit.
// A quarter: slow enough to relieve a motor, and the robot still moves on (D4).
const EASED_RATE_Q16: u32 = FULL_RATE_Q16 / 4;

/// Result of a tick of motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Progress {
    /// The clock advances.
    Running,
    /// The last knot is reached.
    Done,
    /// The clock has come to rest on the path.
    Paused,
    /// The buffer ran empty; a stop segment was appended (K6).
    RanEmpty,
    /// The stop segment has ended at rest.
    Stopped,
}

/// Buffer, clock and current segment.
#[derive(Debug, Clone)]
pub struct Motion<const N: usize> {
    knots: Deque<StoredKnot<N>, CAPACITY>,
    /// First knot of the current segment.
    start: Option<StoredKnot<N>>,
    segment: Option<Segment<N>>,
    /// Path time, ms, with 16 fractional bits.
    clock_q16: u64,
    rate_q16: u32,
    rate_step_q16: u32,
    /// Target rate of the clock: zero while braking, full otherwise.
    braking: bool,
    /// A motor is at its limit (D4).
    eased: bool,
    stop_segment: bool,
    next_index: u16,
    /// Change of the clock's rate in the last tick.
    change_q16: i32,
    /// The segment's checks are not done yet.
    new_rows: bool,
}

impl<const N: usize> Default for Motion<N> {
    fn default() -> Self {
        Self {
            // A constant: otherwise the board builds it on its stack first.
            knots: const { Deque::new() },
            start: None,
            segment: None,
            clock_q16: 0,
            rate_q16: FULL_RATE_Q16,
            rate_step_q16: FULL_RATE_Q16,
            braking: false,
            eased: false,
            stop_segment: false,
            next_index: 0,
            change_q16: 0,
            new_rows: false,
        }
    }
}

impl<const N: usize> Motion<N> {
    /// Resets in place: a fresh one would go over the board's stack.
    pub fn clear(&mut self) {
        self.knots.clear();
        self.start = None;
        self.segment = None;
        self.clock_q16 = 0;
        self.rate_q16 = FULL_RATE_Q16;
        self.rate_step_q16 = FULL_RATE_Q16;
        self.braking = false;
        self.eased = false;
        self.stop_segment = false;
        self.next_index = 0;
        self.new_rows = false;
    }

    /// Number that the next knot must have.
    #[must_use]
    pub const fn next_index(&self) -> u16 {
        self.next_index
    }

    /// Free knots.
    #[must_use]
    pub fn free(&self) -> u8 {
        u8::try_from(CAPACITY - self.knots.len()).unwrap_or(u8::MAX)
    }

    /// Path time, ms.
    #[must_use]
    pub fn path_ms(&self) -> u32 {
        u32::try_from(self.clock_q16 >> 16).unwrap_or(u32::MAX)
    }

    /// The last knot that was appended.
    #[must_use]
    pub fn newest(&self) -> Option<&StoredKnot<N>> {
        // If the buffer is empty, it was the last one taken out.
        self.knots.back().or(self.start.as_ref())
    }

    /// Whether a motion is buffered that has not begun.
    #[must_use]
    pub(crate) fn is_fresh(&self) -> bool {
        self.segment.is_none() && self.knots.len() > 1
    }

    /// Whether a motion was held on its path and can be resumed.
    #[must_use]
    pub fn is_paused(&self) -> bool {
        self.segment.is_some() && !self.stop_segment
    }

    /// Whether knots reach further than the clock can run while it brakes over `stop_ms`.
    #[must_use]
    pub fn covers_a_stop(&self, stop_ms: u32) -> bool {
        self.newest().is_some_and(|newest| {
            // While it brakes evenly from full rate, the clock runs for half of `stop_ms`.
            newest.last || newest.time_ms.saturating_sub(self.path_ms()) >= stop_ms / 2
        })
    }

    /// Permitted times of the next knot, ms: from, to.
    #[must_use]
    pub fn time_window_ms(&self) -> (u32, u32) {
        let Some(newest) = self.newest() else {
            return (0, 0);
        };
        // Before the start the clock stands: no knot is late.
        let now = if self.segment.is_some() {
            self.path_ms()
        } else {
            0
        };
        let latest_start = newest.time_ms.max(now);
        let earliest = latest_start.saturating_add(MIN_SPACING_MS);
        (earliest, newest.time_ms.saturating_add(MAX_SPACING_MS))
    }

    /// Appends a knot that the caller has checked; `false` when full (K7).
    pub fn push(&mut self, knot: StoredKnot<N>) -> bool {
        let slot = self.append();
        slot.map(|slot| *slot = knot).is_some()
    }

    /// A new place at the buffer's end, to be filled; `None` if full (K7).
    pub fn append(&mut self) -> Option<&mut StoredKnot<N>> {
        // Behind a stop segment there is no path to which a knot could be joined.
        if self.stop_segment || self.knots.push_back(StoredKnot::EMPTY).is_err() {
            return None;
        }
        // After 65,536 knots the numbers begin again.
        self.next_index = self.next_index.wrapping_add(1);
        self.knots.back_mut()
    }

    /// Sets the clock running: at once at a motion's start, where the path is at rest, and over
    /// `stop_ms` after a hold.
    pub fn run(&mut self, stop_ms: u32) {
        self.braking = false;
        self.rate_step_q16 = rate_step_q16(stop_ms);
        // The first knot is at rest, so the full rate at once causes no jump of the speed.
        if self.start.is_none() {
            self.rate_q16 = FULL_RATE_Q16;
            self.start = self.knots.pop_front();
            self.load_next();
        }
    }

    /// Slows the clock to rest within `stop_ms`, along the path.
    pub fn brake(&mut self, stop_ms: u32) {
        self.braking = true;
        self.rate_step_q16 = rate_step_q16(stop_ms);
    }

    /// While a motor is at its limit, the clock slows down as in a stop, but only to a quarter: the
    /// path does not change, its time stretches (D4).
    pub const fn ease(&mut self, eased: bool) {
        self.eased = eased;
    }

    /// Whether there is a path: then every tick sets all targets anew.
    pub(crate) fn has_path(&self) -> bool {
        self.segment.is_some()
    }

    /// Advances the clock by one tick; `None` without a path. [`Self::evaluate`] gives the path's
    /// point then.
    pub fn tick(&mut self, stop_ms: u32) -> Option<Progress> {
        self.segment.as_ref()?;
        let before_q16 = self.rate_q16;
        // Saturating: the last step is shorter, so that the clock never runs backwards.
        self.rate_q16 = if self.braking {
            self.rate_q16.saturating_sub(self.rate_step_q16)
        } else if self.eased {
            let slower = self.rate_q16.saturating_sub(self.rate_step_q16);
            // One that is still coming up from rest keeps its rate.
            slower.max(self.rate_q16.min(EASED_RATE_Q16))
        } else {
            (self.rate_q16 + self.rate_step_q16).min(FULL_RATE_Q16)
        };
        // 64 bits: 48 of them are whole ms, which no motion exhausts.
        self.clock_q16 += u64::from(self.rate_q16);
        let mut progress = Progress::Running;
        // Knots are 4 ms apart at least and a tick advances 1 ms at most: one turn.
        while self.elapsed_q16()? >= u64::from(self.segment.as_ref()?.spacing_ms) << 16 {
            if self.stop_segment {
                progress = Progress::Stopped;
                break;
            }
            let end = self.knots.pop_front()?;
            self.start = Some(end);
            // It is at rest by its check: the clock may stop without braking.
            if end.last {
                progress = Progress::Done;
                break;
            }
            if !self.load_next() {
                self.append_stop(&end, stop_ms);
                progress = Progress::RanEmpty;
            }
        }
        // Only if nothing else ended in this tick: a motion that is done is not paused.
        if self.braking && self.rate_q16 == 0 && progress == Progress::Running {
            progress = if self.stop_segment {
                Progress::Stopped
            } else {
                Progress::Paused
            };
        }
        // At rest on the path there is no acceleration.
        self.change_q16 = if self.rate_q16 == 0 {
            0
        } else {
            self.rate_q16.cast_signed() - before_q16.cast_signed()
        };
        Some(progress)
    }

    /// Calls back with point and expected tension (mN) of each cable: velocities and accelerations
    /// in real time, the clock's rate included.
    #[inline]
    pub fn evaluate(&self, mut take: impl FnMut(usize, &Point, i32)) {
        let (Some(segment), Some(elapsed)) = (&self.segment, self.elapsed_q16()) else {
            return;
        };
        // At full rate path time is real time: the factors would all be 1.
        let slows = self.rate_q16 != FULL_RATE_Q16 || self.change_q16 != 0;
        segment.evaluate(elapsed, |index, mut point, tension| {
            if slows {
                self.slow(&mut point);
            }
            take(index, &point, tension);
        });
    }

    /// Chain rule: the path clock runs slower than real time while it brakes, and its change of
    /// rate, per second, adds an acceleration along the path.
    // Out of line, because a motion nearly always runs at full rate.
    #[inline(never)]
    fn slow(&self, point: &mut Point) {
        let rate = i64::from(self.rate_q16);
        let slowed = |value: i32| (i64::from(value) * rate) >> 16;
        // The second derivative scales with the square of the clock's rate.
        let twice = (slowed(point.acceleration_umps2) * rate) >> 16;
        // Change per tick of 1 ms, to per second.
        let change_q16 = i64::from(self.change_q16) * 1000;
        let along = (i64::from(point.velocity_umps) * change_q16) >> 16;
        point.velocity_umps = crate::fixed::saturate(slowed(point.velocity_umps));
        point.acceleration_umps2 = crate::fixed::saturate(twice + along);
    }

    /// The checks of the current segment, once for each segment.
    pub(crate) fn take_rows(&mut self) -> Option<&[StoredRow<N>; ResidualRow::PER_KNOT]> {
        let is_new = core::mem::take(&mut self.new_rows);
        let knot = self.start.as_ref().filter(|_| is_new);
        knot.map(|knot| &knot.rows)
    }

    fn elapsed_q16(&self) -> Option<u64> {
        let start = u64::from(self.segment.as_ref()?.start_ms) << 16;
        Some(self.clock_q16.saturating_sub(start))
    }

    fn load_next(&mut self) -> bool {
        let (Some(start), Some(end)) = (&self.start, self.knots.front()) else {
            return false;
        };
        self.segment = Some(Segment::between(start, end));
        self.new_rows = true;
        true
    }

    /// The stop segment: the tangent of the path, run with a braking clock, so that a buffer that
    /// ran empty decelerates like any stop, and a stop in progress continues as it began.
    // Out of line: rare, and its temporaries would be on the stack of every tick.
    #[inline(never)]
    fn append_stop(&mut self, from: &StoredKnot<N>, stop_ms: u32) {
        let mut end = *from;
        let stop_ms = stop_ms.max(1);
        end.time_ms = from.time_ms.saturating_add(stop_ms);
        for cable in &mut end.cables {
            // v[µm/s] * t[ms] in 0.1 µm; the clock comes to rest halfway.
            let way = quotient::<100>(i64::from(cable.velocity.0) * i64::from(stop_ms));
            let way = saturate(way);
            cable.length = TenthMicrometres(cable.length.0.saturating_add(way));
        }
        self.segment = Some(Segment::between(from, &end));
        self.start = Some(*from);
        self.new_rows = true;
        self.stop_segment = true;
        self.brake(stop_ms);
    }
}

fn rate_step_q16(stop_ms: u32) -> u32 {
    // Rounded up: the clock rests after `stop_ms` ticks, not one later. Example: 300 ms give 219.
    FULL_RATE_Q16 / stop_ms.max(1) + 1
}
