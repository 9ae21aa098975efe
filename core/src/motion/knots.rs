//! Choosing knots.

use super::spline::{Ends, Spline, SplineError};

/// Ticks of the board's clock in a second.
const TICKS_PER_S: f64 = 1e3;

/// Points inside a segment at which a fit is compared with its function.
const PLACES_PER_SEGMENT: u32 = 8;

/// Allowed positions of the knots of a fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Spacing {
    /// At equal distances.
    Equal,
    /// At the whole milliseconds nearest to equal distances, as the wire needs them; start and end
    /// are not moved.
    Ticks,
}

/// Requirements of a fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FitOptions {
    /// The ends of every channel.
    pub ends: Ends,
    /// Allowed positions of the knots.
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
/// starts at its minimum and grows by the fourth root of the ratio of error to tolerance, so it
/// ends close to the fewest possible.
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
            // The error at the knots is zero: check between them.
            for place in 0..PLACES_PER_SEGMENT {
                let share = (f64::from(place) + 0.5) / f64::from(PLACES_PER_SEGMENT);
                let time_s = a + share * (b - a);
                function(time_s, &mut values)?;
                for (spline, value) in splines.iter().zip(&values) {
                    let miss = (spline.sample(time_s)?.value - value).abs();
                    // `max` drops NaN: a function without a value must not pass as close.
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
        let factor = libm::pow(error / options.tolerance, 0.25).clamp(1.0, 2.0);
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
