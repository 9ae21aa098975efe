//! Motion between knots: Hermite cubics in fixed point (the cubic of Eq. 53 in another basis).
//!
//! With `s = (t - t0) / h` in 0..1 a cable's length is `c0 + c1 s + c2 s^2 + c3 s^3`. All four
//! coefficients are integers of 1/256 of 0.1 µm, chosen so that their sum is exactly the next knot:
//! segments join without a step, independent of rounding.

use crate::fixed::{division, half, quotient, saturate, scale_down};
use mcdpr_protocol::{
    CableKnot, Coefficient, Knot, MicrometresPerSecond, Millinewtons, ResidualRow, TenthMicrometres,
};

/// Shortest time between two knots, ms.
// 4 ms: more than a tick, so that a tick passes one knot at most, and the rate of knots on the line
// stays bounded.
pub const MIN_SPACING_MS: u32 = 4;
/// Longest time between two knots, ms.
// 4 s: under 2^12 ms, so that products with a spacing stay within their words.
pub const MAX_SPACING_MS: u32 = 4000;

/// Fractional bits of coefficients and values.
const VALUE_Q: u32 = 8;
/// Fractional bits of `s`.
const S_Q: u32 = 24;
/// Fractional bits of `1 / h` for rates.
const INVERSE_Q: u32 = 30;
/// Fractional bits of `1 / h` for `s`: with fewer, `s` would fall short of 1 at a long segment's end
/// and the cable would jump there.
// The error of 1 / h, 2^-44, times 4000 ms is 2^-32 of a segment: under half a step of s (2^-25).
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
pub(crate) struct Cubic {
    /// 0.1 µm.
    start: i32,
    /// 1/256 of 0.1 µm.
    c: [i64; 3],
}

impl Cubic {
    /// The cubic from `start` to `end` over `spacing_ms`.
    #[must_use]
    pub fn between(start: &CableKnot, end: &CableKnot, spacing_ms: u32) -> Self {
        let delta = (i64::from(end.length.0) - i64::from(start.length.0)) << VALUE_Q;
        let rise = |velocity: MicrometresPerSecond| {
            // µm/s times ms is 1e-3 µm, that is 1/100 of 0.1 µm.
            quotient::<100>((i64::from(velocity.0) * i64::from(spacing_ms)) << VALUE_Q)
        };
        let (m0, m1) = (rise(start.velocity), rise(end.velocity));
        Self {
            start: start.length.0,
            // Standard Hermite coefficients. Their sum is delta exactly, in integers.
            c: [m0, 3 * delta - 2 * m0 - m1, m0 + m1 - 2 * delta],
        }
    }

    /// Whether all sums of the coefficients fit 32 bits, and 64 where they are multiplied: then
    /// products of 32 bits give the same values.
    fn is_narrow(&self, spacing_ms: u32) -> bool {
        // No value or derivative in `s` is larger, except for rounding; times 1000 and the square
        // of 2^30 / spacing, of which 30 bits are shifted out in between, it must stay under 2^63.
        let [c1, c2, c3] = self.c.map(i64::unsigned_abs);
        let largest = c1 + 2 * c2 + 6 * c3 + 8;
        largest < (1 << 31).min(u64::from(spacing_ms) << 23)
    }

    fn at(&self, phase: &Phase) -> Point {
        let [c1, c2, c3] = self.c;
        // In both: d/ds in 1/256 of 0.1 µm; per ms that is 100 µm/s.
        let (way, slope, bend) = if phase.narrow {
            let s = phase.s_q24;
            let times_s = |value: i32| product(value, s, S_Q);
            let [c1, c2, c3] = [c1, c2, c3].map(low);
            let inverse = i64::from(phase.inverse_q30);
            let per_ms = |value: i64| (value * inverse) >> INVERSE_Q;
            (
                // Horner's scheme: three products, each shifted back to 8 fractional bits.
                i64::from(times_s(c1 + times_s(c2 + times_s(c3)))),
                per_ms(i64::from(c1 + times_s(2 * c2 + times_s(3 * c3)))),
                per_ms(per_ms(i64::from(2 * c2 + times_s(6 * c3)) * 1000)),
            )
        } else {
            wide(c1, c2, c3, phase)
        };
        Point {
            length_q8: (i64::from(self.start) << VALUE_Q) + way,
            velocity_umps: saturate((slope * 100) >> VALUE_Q),
            acceleration_umps2: saturate((bend * 100) >> VALUE_Q),
        }
    }
}

/// The same in 64 bits: for motions beyond the winches of this project.
#[inline(never)]
fn wide(c1: i64, c2: i64, c3: i64, phase: &Phase) -> (i64, i64, i64) {
    let s = i64::from(phase.s_q24);
    let times_s = |value: i64| scale_down(value, s, S_Q);
    let per_ms = |value: i64| scale_down(value, i64::from(phase.inverse_q30), INVERSE_Q);
    (
        times_s(c1 + times_s(c2 + times_s(c3))),
        per_ms(c1 + times_s(2 * c2 + times_s(3 * c3))),
        per_ms(per_ms((2 * c2 + times_s(6 * c3)) * 1000)),
    )
}

/// `value * factor / 2^bits`, rounded down; the factor is 2^bits at most.
#[inline]
fn product(value: i32, factor: i32, bits: u32) -> i32 {
    low((i64::from(value) * i64::from(factor)) >> bits)
}

/// A value known to fit.
#[inline]
#[expect(clippy::cast_possible_truncation, reason = "the caller knows its size")]
const fn low(value: i64) -> i32 {
    value as i32
}

/// Position of a time in a segment.
#[derive(Debug, Clone, Copy)]
struct Phase {
    s_q24: i32,
    inverse_q30: u32,
    /// Every cubic is narrow.
    narrow: bool,
}

/// A knot in the board's form.
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

/// A residual row in the board's form; a limit of 0 means no row.
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
        Self::NONE
    }
}

impl<const N: usize> StoredRow<N> {
    const NONE: Self = Self {
        lengths: [0; N],
        tensions: [0; N],
        limit_um: 0,
    };
}

impl<const N: usize> StoredKnot<N> {
    /// A knot to be filled.
    pub(crate) const EMPTY: Self = Self {
        time_ms: 0,
        last: false,
        cables: [CableKnot {
            length: TenthMicrometres(0),
            velocity: MicrometresPerSecond(0),
            tension: Millinewtons(0),
        }; N],
        rows: [StoredRow::NONE; ResidualRow::PER_KNOT],
    };

    /// Fills an empty knot with one from the wire; missing cables stay zero (the caller has checked
    /// the count).
    pub fn fill(&mut self, knot: &Knot) {
        self.time_ms = knot.time_ms;
        self.last = knot.last;
        for (slot, value) in self.cables.iter_mut().zip(knot.cables.iter()) {
            *slot = *value;
        }
        let plain = |(slot, value): (&mut i16, &Coefficient)| *slot = value.0;
        for (row, wire) in self.rows.iter_mut().zip(knot.rows.iter()) {
            row.lengths
                .iter_mut()
                .zip(wire.lengths.iter())
                .for_each(plain);
            row.tensions
                .iter_mut()
                .zip(wire.tensions.iter())
                .for_each(plain);
            row.limit_um = wire.limit.0;
        }
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
    narrow: bool,
}

impl<const N: usize> Segment<N> {
    /// The segment between two knots; `end` is at least one millisecond later.
    #[must_use]
    pub fn between(start: &StoredKnot<N>, end: &StoredKnot<N>) -> Self {
        // Never 0: a division by it must not be possible, whatever the caller sends.
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
            tension_start: tensions(start),
            tension_end: tensions(end),
            inverse_q44: division(1 << FINE_INVERSE_Q, i64::from(spacing_ms)),
            narrow: cubics.iter().all(|cubic| cubic.is_narrow(spacing_ms)),
            cubics,
        }
    }

    /// Evaluates every cable at `elapsed_q16` ms (16 fractional bits) after the segment's start.
    #[must_use]
    pub fn at(&self, elapsed_q16: u64) -> [Point; N] {
        let mut points = [Point::default(); N];
        self.evaluate(elapsed_q16, |index, point, _| {
            if let Some(slot) = points.get_mut(index) {
                *slot = point;
            }
        });
        points
    }

    /// Expected tensions at that time, mN: linear between the knots.
    #[must_use]
    pub fn tensions(&self, elapsed_q16: u64) -> [i32; N] {
        let mut tensions = [0; N];
        self.evaluate(elapsed_q16, |index, _, tension| {
            if let Some(slot) = tensions.get_mut(index) {
                *slot = tension;
            }
        });
        tensions
    }

    /// Calls back with point and expected tension (mN) of each cable.
    #[inline]
    pub fn evaluate(&self, elapsed_q16: u64, mut take: impl FnMut(usize, Point, i32)) {
        let phase = self.phase(elapsed_q16);
        let ends = self.tension_start.iter().zip(&self.tension_end);
        for (index, (cubic, (&start, &end))) in self.cubics.iter().zip(ends).enumerate() {
            let change = i64::from(end.saturating_sub(start));
            let change = (change * i64::from(phase.s_q24) + half(S_Q)) >> S_Q;
            take(index, cubic.at(&phase), start + low(change));
        }
    }

    fn phase(&self, elapsed_q16: u64) -> Phase {
        let inverse_q30 = low(self.inverse_q44 >> (FINE_INVERSE_Q - INVERSE_Q)).cast_unsigned();
        // Exactly 1 at the end, so that a segment ends on its knot.
        if elapsed_q16 >> 16 >= u64::from(self.spacing_ms) {
            return Phase {
                s_q24: 1 << S_Q,
                inverse_q30,
                narrow: self.narrow,
            };
        }
        // 16 + 44 fractional bits down to 24; the product stays under 2^60.
        let s = (elapsed_q16.cast_signed() * self.inverse_q44 + half(36)) >> 36;
        Phase {
            s_q24: low(s),
            inverse_q30,
            narrow: self.narrow,
        }
    }
}
