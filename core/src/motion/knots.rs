//! Choosing knots, and rounding them to the integers that the wire carries.

use super::spline::{Ends, Spline, SplineError};

/// Ticks of the board's clock in a second.
const TICKS_PER_S: f64 = 1e3;

/// Units of the wire's length in a metre: 0.1 um.
const LENGTHS_PER_M: f64 = 1e7;

/// Units of the wire's velocity in a metre per second: 1 um/s.
const VELOCITIES_PER_MPS: f64 = 1e6;

/// Places inside a segment at which a fit is compared with its function.
const PLACES_PER_SEGMENT: u32 = 8;

/// A knot of one cable in the integers of the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WireKnot {
    /// Time, ms since the start of the motion.
    pub tick_ms: u32,
    /// Cable length, 0.1 um.
    pub length_tenth_um: i32,
    /// Cable velocity, um/s.
    pub velocity_um_per_s: i32,
}

/// Rounds a spline of lengths in m to wire knots.
///
/// A knot that does not lie on a tick moves to the nearest one, with the spline's own value and
/// velocity there. (A last knot that would move beyond the spline keeps its value and velocity:
/// the motion ends up to half a tick later.)
///
/// # Errors
/// [`SplineError::Unrepresentable`] for a negative time or a value beyond the integer's range,
/// [`SplineError::Order`] if two knots meet on one tick.
pub fn quantise(spline: &Spline) -> Result<Vec<WireKnot>, SplineError> {
    let (start_s, end_s) = spline.span_s();
    let mut wire: Vec<WireKnot> = Vec::with_capacity(spline.knots().len());
    for (index, knot) in spline.knots().iter().enumerate() {
        let tick = (knot.time_s * TICKS_PER_S).round();
        let at = spline.sample((tick / TICKS_PER_S).clamp(start_s, end_s))?;
        let knot = WireKnot {
            tick_ms: u32::try_from(integer(index, "time (ms)", tick)?)
                .map_err(|_| unrepresentable(index, "time (ms)", tick))?,
            length_tenth_um: i32_of(index, "length (0.1 um)", at.value * LENGTHS_PER_M)?,
            velocity_um_per_s: i32_of(index, "velocity (um/s)", at.velocity * VELOCITIES_PER_MPS)?,
        };
        if let Some(before) = wire.last()
            && before.tick_ms >= knot.tick_ms
        {
            return Err(SplineError::Order {
                knot: index + 1,
                time_s: f64::from(knot.tick_ms) / TICKS_PER_S,
                before_s: f64::from(before.tick_ms) / TICKS_PER_S,
            });
        }
        wire.push(knot);
    }
    Ok(wire)
}

/// The spline that wire knots stand for, lengths in m: what the board plays, but for its own
/// rounding.
///
/// # Errors
/// [`SplineError::Count`], [`SplineError::Order`].
pub fn reconstruct(wire: &[WireKnot]) -> Result<Spline, SplineError> {
    Spline::from_knots(
        wire.iter()
            .map(|knot| super::spline::Knot {
                time_s: f64::from(knot.tick_ms) / TICKS_PER_S,
                value: f64::from(knot.length_tenth_um) / LENGTHS_PER_M,
                velocity: f64::from(knot.velocity_um_per_s) / VELOCITIES_PER_MPS,
            })
            .collect(),
    )
}

fn integer(index: usize, what: &'static str, value: f64) -> Result<i64, SplineError> {
    let rounded = value.round();
    if rounded.abs() < 9e15 {
        // Whole and far inside i64: the cast is exact.
        Ok(rounded as i64)
    } else {
        Err(unrepresentable(index, what, value))
    }
}

fn i32_of(index: usize, what: &'static str, value: f64) -> Result<i32, SplineError> {
    i32::try_from(integer(index, what, value)?).map_err(|_| unrepresentable(index, what, value))
}

fn unrepresentable(index: usize, what: &'static str, value: f64) -> SplineError {
    SplineError::Unrepresentable {
        knot: index + 1,
        what,
        value,
    }
}

/// Where the knots of a fit may lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Spacing {
    /// At equal distances.
    Equal,
    /// At the whole milliseconds nearest to equal distances, as the wire needs them; start and end
    /// stay where they are.
    Ticks,
}

/// What a fit has to reach.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FitOptions {
    /// The ends of every channel.
    pub ends: Ends,
    /// Where the knots may lie.
    pub spacing: Spacing,
    /// Greatest error of any channel, in the unit of the values.
    pub tolerance: f64,
    /// Segments to start with.
    pub least_segments: usize,
    /// Most segments to use.
    pub most_segments: usize,
}

/// Splines of several channels over common knot times.
#[derive(Debug, Clone, PartialEq)]
pub struct Fit {
    /// One spline per channel.
    pub splines: Vec<Spline>,
    /// Number of segments of each.
    pub segments: usize,
    /// Greatest error of any channel found at eight places per segment.
    pub error: f64,
}

/// Fits splines to functions of time, with as many knots as the tolerance takes.
///
/// `function(t, values)` writes the value of every channel at `t` seconds. The number of segments
/// starts at the least one and grows by the fourth root of what is missing, so it ends close to the least one.
///
/// # Errors
/// What the function returns; [`SplineError::Tolerance`] if `most_segments` do not suffice, and
/// the errors of [`Spline::interpolate`].
pub fn fit<E: From<SplineError>>(
    channels: usize,
    (start_s, end_s): (f64, f64),
    options: FitOptions,
    mut function: impl FnMut(f64, &mut [f64]) -> Result<(), E>,
) -> Result<Fit, E> {
    let mut segments = options.most_segments.min(options.least_segments);
    loop {
        let times_s = knot_times(start_s, end_s, segments, options.spacing);
        let mut columns = vec![Vec::with_capacity(times_s.len()); channels];
        let mut values = vec![0.0; channels];
        for time_s in &times_s {
            function(*time_s, &mut values)?;
            for (column, value) in columns.iter_mut().zip(&values) {
                column.push(*value);
            }
        }
        let splines: Result<Vec<Spline>, SplineError> = columns
            .iter()
            .map(|column| Spline::interpolate(&times_s, column, options.ends))
            .collect();
        let splines = splines?;

        let mut error: f64 = 0.0;
        for pair in times_s.windows(2) {
            let [a, b] = pair else { continue };
            // The knots themselves are met: look between them.
            for place in 0..PLACES_PER_SEGMENT {
                let share = (f64::from(place) + 0.5) / f64::from(PLACES_PER_SEGMENT);
                let time_s = a + share * (b - a);
                function(time_s, &mut values)?;
                for (spline, value) in splines.iter().zip(&values) {
                    let miss = (spline.sample(time_s)?.value - value).abs();
                    error = if miss.is_nan() {
                        f64::INFINITY
                    } else {
                        error.max(miss)
                    };
                }
            }
        }
        if error <= options.tolerance {
            return Ok(Fit {
                splines,
                segments,
                error,
            });
        }
        if segments >= options.most_segments {
            return Err(SplineError::Tolerance {
                segments,
                error,
                tolerance: options.tolerance,
            }
            .into());
        }
        // A fourth-order method: the error falls with the fourth power of the number.
        let factor = (error / options.tolerance).powf(0.25).clamp(1.0, 2.0);
        let predicted = (segments as f64 * factor).ceil() as usize;
        segments = predicted.max(segments + 1).min(options.most_segments);
    }
}

fn knot_times(start_s: f64, end_s: f64, segments: usize, spacing: Spacing) -> Vec<f64> {
    let mut times_s: Vec<f64> = (0..=segments)
        .map(|index| {
            let time_s = start_s + (end_s - start_s) * index as f64 / segments.max(1) as f64;
            match spacing {
                Spacing::Equal => time_s,
                Spacing::Ticks => (time_s * TICKS_PER_S).round() / TICKS_PER_S,
            }
        })
        .collect();
    if let Some(first) = times_s.first_mut() {
        *first = start_s;
    }
    if let Some(last) = times_s.last_mut() {
        *last = end_s;
    }
    times_s
}
