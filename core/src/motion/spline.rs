//! Cubic splines over time (the paper's Eq. 53), in the form that travels to the board: knots with
//! time, value and velocity, joined by cubics (Hermite form).
//!
//! A spline through given values is found by solving for the knots' velocities so that the
//! acceleration has no steps (de Boor, A Practical Guide to Splines, 1978). The ends matter: with
//! clamped, not-a-knot or periodic ends the error falls with the fourth power of the spacing, with
//! natural ends only with the second, because they force an acceleration that the motion has not.

/// Why a spline, or a value of it, cannot be computed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SplineError {
    /// Fewer knots than the ends need, or times and values differ in number.
    #[error(
        "a spline needs at least {least} knots, each with a time and a value: {times} times and {values} values were given"
    )]
    Count {
        /// Least number of knots.
        least: usize,
        /// Times given.
        times: usize,
        /// Values given.
        values: usize,
    },
    /// A time, value or velocity is NaN or infinite, or so large that sums overflow.
    #[error("knot {knot} of the spline is not made of finite numbers")]
    NotFinite {
        /// Which knot, from 1.
        knot: usize,
    },
    /// The times do not rise.
    #[error(
        "knot {knot} of the spline, at {time_s} s, is not later than the one before it, at {before_s} s"
    )]
    Order {
        /// Which knot, from 1.
        knot: usize,
        /// Its time, s.
        time_s: f64,
        /// The time before, s.
        before_s: f64,
    },
    /// A periodic spline whose last value is not its first.
    #[error("a periodic spline must end where it starts: it starts at {first} and ends at {last}")]
    NotPeriodic {
        /// First value.
        first: f64,
        /// Last value.
        last: f64,
    },
    /// A time outside the spline.
    #[error("{time_s} s is outside the spline, which runs from {start_s} s to {end_s} s")]
    OutsideTime {
        /// Time asked, s.
        time_s: f64,
        /// First knot, s.
        start_s: f64,
        /// Last knot, s.
        end_s: f64,
    },
    /// The tolerance is not reached with the knots allowed.
    #[error(
        "{segments} segments leave an error of {error:e}, more than the tolerance {tolerance:e}: allow more segments, or ask for a slower or smoother motion"
    )]
    Tolerance {
        /// Segments tried last.
        segments: usize,
        /// Error left.
        error: f64,
        /// Tolerance asked.
        tolerance: f64,
    },
}

/// Boundary condition at the ends of a spline.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Ends {
    /// Given velocities at the first and last knot: a motion from rest to rest has 0 and 0.
    Clamped {
        /// Velocity at the first knot.
        start: f64,
        /// Velocity at the last knot.
        end: f64,
    },
    /// The first two segments are one cubic, and so are the last two.
    NotAKnot,
    /// Value, velocity and acceleration at the end are those at the start.
    Periodic,
    /// No acceleration at the ends. For comparison only: it exceeds the tolerance for a motion that
    /// starts or ends at speed.
    Natural,
}

/// A knot: value and velocity at a time. Values in m for cables, in the caller's unit otherwise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Knot {
    /// Time, s.
    pub time_s: f64,
    /// Value.
    pub value: f64,
    /// Derivative of the value by time, per s.
    pub velocity: f64,
}

/// Value of a spline with its first two derivatives by time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Value.
    pub value: f64,
    /// First derivative, per s.
    pub velocity: f64,
    /// Second derivative, per s2; at a knot, that of the later segment.
    pub acceleration: f64,
}

/// Cubics between knots: value and velocity are continuous by construction.
///
/// ```
/// use mcdpr_core::motion::spline::{Ends, Spline};
///
/// // t^3 at 0, 1, 2, 3 s comes back exactly.
/// let spline = Spline::interpolate(&[0.0, 1.0, 2.0, 3.0], &[0.0, 1.0, 8.0, 27.0], Ends::NotAKnot)?;
/// assert!((spline.sample(1.5)?.value - 3.375).abs() < 1e-12);
/// assert!((spline.sample(1.5)?.acceleration - 9.0).abs() < 1e-12);
/// # Ok::<(), mcdpr_core::motion::spline::SplineError>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Spline {
    knots: Vec<Knot>,
}

/// Bound on times, values and velocities: products of three stay finite.
const GREATEST: f64 = 1e60;

impl Spline {
    /// The spline of given knots.
    ///
    /// # Errors
    /// [`SplineError::Count`] below two knots, [`SplineError::NotFinite`], [`SplineError::Order`].
    pub(crate) fn from_knots(knots: Vec<Knot>) -> Result<Self, SplineError> {
        if knots.len() < 2 {
            return Err(SplineError::Count {
                least: 2,
                times: knots.len(),
                values: knots.len(),
            });
        }
        for (index, knot) in knots.iter().enumerate() {
            if ![knot.time_s, knot.value, knot.velocity]
                .iter()
                .all(|number| number.abs() <= GREATEST)
            {
                return Err(SplineError::NotFinite { knot: index + 1 });
            }
        }
        check_order(knots.iter().map(|knot| knot.time_s))?;
        Ok(Self { knots })
    }

    /// The spline through `values` at `times_s` with continuous acceleration (C2).
    ///
    /// Clamped and natural ends need 2 knots, not-a-knot ends 2 (a line; with 3, a parabola), and
    /// periodic ones 3, the last value equal to the first within 1e-9.
    ///
    /// # Errors
    /// [`SplineError::Count`], [`SplineError::NotFinite`], [`SplineError::Order`],
    /// [`SplineError::NotPeriodic`].
    pub fn interpolate(times_s: &[f64], values: &[f64], ends: Ends) -> Result<Self, SplineError> {
        let least = if ends == Ends::Periodic { 3 } else { 2 };
        if times_s.len() != values.len() || times_s.len() < least {
            return Err(SplineError::Count {
                least,
                times: times_s.len(),
                values: values.len(),
            });
        }
        // Knots at rest first: this checks times and values before they are used.
        let mut knots: Vec<Knot> = times_s
            .iter()
            .zip(values)
            .map(|(time_s, value)| Knot {
                time_s: *time_s,
                value: *value,
                velocity: 0.0,
            })
            .collect();
        knots = Self::from_knots(knots)?.knots;
        if let (Ends::Periodic, Some(first), Some(last)) = (ends, values.first(), values.last())
            && (last - first).abs() > 1e-9
        {
            return Err(SplineError::NotPeriodic {
                first: *first,
                last: *last,
            });
        }
        let velocities = super::spline_solve::velocities(times_s, values, ends);
        for (knot, velocity) in knots.iter_mut().zip(velocities) {
            knot.velocity = velocity;
        }
        Self::from_knots(knots)
    }

    /// The knots, at least two.
    pub fn knots(&self) -> &[Knot] {
        &self.knots
    }

    /// Times of the first and the last knot, s.
    pub(crate) fn span_s(&self) -> (f64, f64) {
        match (self.knots.first(), self.knots.last()) {
            (Some(first), Some(last)) => (first.time_s, last.time_s),
            // There are at least two knots.
            _ => (0.0, 0.0),
        }
    }

    /// Value, velocity and acceleration at `time_s`.
    ///
    /// # Errors
    /// [`SplineError::OutsideTime`].
    pub fn sample(&self, time_s: f64) -> Result<Sample, SplineError> {
        // NaN is after no knot: it ends as a time outside the spline.
        let after = self.knots.partition_point(|knot| knot.time_s <= time_s);
        // The last knot belongs to the segment before it.
        let after = after.min(self.knots.len() - 1);
        let (start_s, end_s) = self.span_s();
        match (
            after.checked_sub(1).and_then(|index| self.knots.get(index)),
            self.knots.get(after),
        ) {
            (Some(a), Some(b)) if time_s <= end_s => Ok(hermite(a, b, time_s)),
            _ => Err(SplineError::OutsideTime {
                time_s,
                start_s,
                end_s,
            }),
        }
    }

    /// Coefficients s0 to s3 of each segment in powers of the time since its start: the paper's
    /// Eq. 53.
    pub fn coefficients(&self) -> Vec<[f64; 4]> {
        self.knots
            .windows(2)
            .filter_map(|pair| match pair {
                [a, b] => Some(coefficients(a, b)),
                _ => None,
            })
            .collect()
    }

    /// Greatest difference to `function` over the span, sought at `per_segment` places inside each
    /// segment.
    #[cfg(test)]
    pub(crate) fn greatest_error(&self, per_segment: u32, function: impl Fn(f64) -> f64) -> f64 {
        let mut greatest: f64 = 0.0;
        for pair in self.knots.windows(2) {
            let [a, b] = pair else { continue };
            for step in 0..=per_segment {
                let share = f64::from(step) / f64::from(per_segment.max(1));
                let time_s = a.time_s + share * (b.time_s - a.time_s);
                let error = (hermite(a, b, time_s).value - function(time_s)).abs();
                // A function that returns NaN anywhere must not pass as close.
                greatest = if error.is_nan() {
                    f64::INFINITY
                } else {
                    greatest.max(error)
                };
            }
        }
        greatest
    }
}

fn check_order(times: impl Iterator<Item = f64>) -> Result<(), SplineError> {
    let mut before_s = f64::NEG_INFINITY;
    for (index, time_s) in times.enumerate() {
        if time_s <= before_s {
            return Err(SplineError::Order {
                knot: index + 1,
                time_s,
                before_s,
            });
        }
        before_s = time_s;
    }
    Ok(())
}

fn coefficients(a: &Knot, b: &Knot) -> [f64; 4] {
    let h = b.time_s - a.time_s;
    let slope = (b.value - a.value) / h;
    [
        a.value,
        a.velocity,
        (3.0 * slope - 2.0 * a.velocity - b.velocity) / h,
        (a.velocity + b.velocity - 2.0 * slope) / (h * h),
    ]
}

fn hermite(a: &Knot, b: &Knot, time_s: f64) -> Sample {
    let [s0, s1, s2, s3] = coefficients(a, b);
    let t = time_s - a.time_s;
    Sample {
        value: s0 + t * (s1 + t * (s2 + t * s3)),
        velocity: s1 + t * (2.0 * s2 + t * 3.0 * s3),
        acceleration: 2.0 * s2 + t * 6.0 * s3,
    }
}
