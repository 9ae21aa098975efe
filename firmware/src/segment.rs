//! Motion between knots: Hermite cubics in fixed point (the cubic of Eq. 53 in another basis).
//!
//! With `s = (t - t0) / h` in 0..1 a cable's length is `c0 + c1 s + c2 s^2 + c3 s^3`. All four
//! coefficients are integers of 1/256 of 0.1 µm, formed so that their sum is the next knot exactly:
//! segments join without a step, whatever the rounding.

use crate::fixed::{half, saturate, scale_down};
use mcdpr_protocol::{CableKnot, Coefficient, Knot, MicrometresPerSecond, ResidualRow};

/// Shortest time between two knots, ms.
pub const MIN_SPACING_MS: u32 = 4;
/// Longest time between two knots, ms.
pub const MAX_SPACING_MS: u32 = 4000;

/// Fractional bits of coefficients and values.
const VALUE_Q: u32 = 8;
/// Fractional bits of `s`.
const S_Q: u32 = 24;
/// Fractional bits of `1 / h` for rates.
const INVERSE_Q: u32 = 30;
/// Fractional bits of `1 / h` for `s`: with fewer, `s` would fall short of 1 at a long segment's end
/// and the cable would jump there.
const FINE_INVERSE_Q: u32 = 44;

/// Position, velocity and acceleration of one cable at one time.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Point {
    /// Length, 1/256 of 0.1 µm.
    pub length_q8: i64,
    /// Rate of path time, µm/s.
    pub velocity_umps: i32,
    /// Second derivative, µm/s².
    pub acceleration_umps2: i32,
}

impl Point {
    /// The length, 0.1 µm, rounded.
    #[must_use]
    pub fn length(&self) -> i32 {
        saturate((self.length_q8 + half(VALUE_Q)) >> VALUE_Q)
    }
}

/// One cable's cubic over one segment.
#[derive(Debug, Clone, Copy, Default)]
pub struct Cubic {
    c: [i64; 4],
}

impl Cubic {
    /// The cubic from `start` to `end` over `spacing_ms`.
    #[must_use]
    pub fn between(start: &CableKnot, end: &CableKnot, spacing_ms: u32) -> Self {
        let delta = (i64::from(end.length.0) - i64::from(start.length.0)) << VALUE_Q;
        let rise = |velocity: MicrometresPerSecond| {
            // µm/s times ms is 1e-3 µm, that is 1/100 of 0.1 µm.
            ((i64::from(velocity.0) * i64::from(spacing_ms)) << VALUE_Q) / 100
        };
        let (m0, m1) = (rise(start.velocity), rise(end.velocity));
        Self {
            c: [
                i64::from(start.length.0) << VALUE_Q,
                m0,
                3 * delta - 2 * m0 - m1,
                m0 + m1 - 2 * delta,
            ],
        }
    }

    fn at(&self, phase: Phase) -> Point {
        let [c0, c1, c2, c3] = self.c;
        let s = phase.s_q24;
        let times_s = |value: i64| scale_down(value, s, S_Q);
        let per_ms = |value: i64| scale_down(value, phase.inverse_q30, INVERSE_Q);
        let length_q8 = c0 + times_s(c1 + times_s(c2 + times_s(c3)));
        // d/ds in 1/256 of 0.1 µm; per ms that is 100 µm/s.
        let slope = per_ms(c1 + times_s(2 * c2 + times_s(3 * c3)));
        let bend = per_ms(per_ms((2 * c2 + times_s(6 * c3)) * 1000));
        Point {
            length_q8,
            velocity_umps: saturate((slope * 100) >> VALUE_Q),
            acceleration_umps2: saturate((bend * 100) >> VALUE_Q),
        }
    }
}

/// Where in a segment a time lies.
#[derive(Debug, Clone, Copy)]
struct Phase {
    s_q24: i64,
    inverse_q30: i64,
}

/// A knot as the board keeps it.
#[derive(Debug, Clone, Copy)]
pub struct StoredKnot<const N: usize> {
    /// Path time, ms.
    pub time_ms: u32,
    /// Whether the motion ends here.
    pub last: bool,
    /// Cable by cable.
    pub cables: [CableKnot; N],
    /// Consistency checks.
    pub rows: [StoredRow<N>; ResidualRow::PER_KNOT],
}

/// A residual row as the board keeps it; a limit of 0 means no row.
#[derive(Debug, Clone, Copy)]
pub struct StoredRow<const N: usize> {
    /// Coefficients of lengths.
    pub lengths: [i16; N],
    /// Coefficients of tensions.
    pub tensions: [i16; N],
    /// Limit, µm.
    pub limit_um: i32,
}

impl<const N: usize> Default for StoredRow<N> {
    fn default() -> Self {
        Self {
            lengths: [0; N],
            tensions: [0; N],
            limit_um: 0,
        }
    }
}

impl<const N: usize> StoredKnot<N> {
    /// Copies a knot from the wire; missing cables stay zero (the caller has checked the count).
    #[must_use]
    pub fn from_wire(knot: &Knot) -> Self {
        let mut stored = Self {
            time_ms: knot.time_ms,
            last: knot.last,
            cables: [CableKnot::default(); N],
            rows: [StoredRow::default(); ResidualRow::PER_KNOT],
        };
        copy(&mut stored.cables, &knot.cables);
        for (row, wire) in stored.rows.iter_mut().zip(knot.rows.iter()) {
            let plain = |value: &Coefficient| value.0;
            for (slot, value) in row.lengths.iter_mut().zip(wire.lengths.iter().map(plain)) {
                *slot = value;
            }
            for (slot, value) in row.tensions.iter_mut().zip(wire.tensions.iter().map(plain)) {
                *slot = value;
            }
            row.limit_um = wire.limit.0;
        }
        stored
    }
}

fn copy<T: Copy>(slots: &mut [T], values: &[T]) {
    for (slot, value) in slots.iter_mut().zip(values) {
        *slot = *value;
    }
}

/// One segment, ready to be evaluated.
#[derive(Debug, Clone, Copy)]
pub struct Segment<const N: usize> {
    /// Path time of its start, ms.
    pub start_ms: u32,
    /// Its duration, ms.
    pub spacing_ms: u32,
    cubics: [Cubic; N],
    tension_start: [i32; N],
    tension_end: [i32; N],
    inverse_q44: i64,
    /// Checks that hold here.
    pub rows: [StoredRow<N>; ResidualRow::PER_KNOT],
}

impl<const N: usize> Segment<N> {
    /// The segment between two knots; `end` is at least one millisecond later.
    #[must_use]
    pub fn between(start: &StoredKnot<N>, end: &StoredKnot<N>) -> Self {
        let spacing_ms = end.time_ms.wrapping_sub(start.time_ms).max(1);
        let mut cubics = [Cubic::default(); N];
        for (cubic, (a, b)) in cubics
            .iter_mut()
            .zip(start.cables.iter().zip(end.cables.iter()))
        {
            *cubic = Cubic::between(a, b, spacing_ms);
        }
        let tensions = |knot: &StoredKnot<N>| {
            let mut values = [0; N];
            for (value, cable) in values.iter_mut().zip(knot.cables.iter()) {
                *value = cable.tension.0;
            }
            values
        };
        Self {
            start_ms: start.time_ms,
            spacing_ms,
            cubics,
            tension_start: tensions(start),
            tension_end: tensions(end),
            inverse_q44: (1 << FINE_INVERSE_Q) / i64::from(spacing_ms),
            rows: start.rows,
        }
    }

    /// Evaluates every cable at `elapsed_q16` ms (16 fractional bits) after the segment's start.
    #[must_use]
    pub fn at(&self, elapsed_q16: u64) -> [Point; N] {
        let phase = self.phase(elapsed_q16);
        let mut points = [Point::default(); N];
        for (point, cubic) in points.iter_mut().zip(self.cubics.iter()) {
            *point = cubic.at(phase);
        }
        points
    }

    /// Expected tensions at that time, mN: linear between the knots.
    #[must_use]
    pub fn tensions(&self, elapsed_q16: u64) -> [i32; N] {
        let s = self.phase(elapsed_q16).s_q24;
        let mut values = self.tension_start;
        for (value, end) in values.iter_mut().zip(self.tension_end) {
            *value += saturate(((i64::from(end) - i64::from(*value)) * s + half(S_Q)) >> S_Q);
        }
        values
    }

    fn phase(&self, elapsed_q16: u64) -> Phase {
        let elapsed = elapsed_q16.min(u64::from(self.spacing_ms) << 16);
        // 16 + 44 fractional bits down to 24; the product stays under 2^60.
        let s = (elapsed.cast_signed() * self.inverse_q44 + half(36)) >> 36;
        Phase {
            s_q24: if elapsed >> 16 == u64::from(self.spacing_ms) {
                1 << S_Q
            } else {
                s
            },
            inverse_q30: self.inverse_q44 >> (FINE_INVERSE_Q - INVERSE_Q),
        }
    }
}
