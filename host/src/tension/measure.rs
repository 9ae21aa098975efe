//! Figures of a trace.

use super::bench::Trace;

/// Tension over a period.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Steady {
    /// Mean error, N.
    pub mean_error_n: f64,
    /// Standard deviation, N.
    pub sd_n: f64,
    /// Mean absolute error, N.
    pub mean_abs_n: f64,
    /// Greatest absolute error, N.
    pub max_abs_n: f64,
}

/// Decay of a disturbance.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Recovery {
    /// Greatest absolute error from its start on, N.
    pub peak_n: f64,
    /// From a change of the load until the mean of 50 ms stays within 0.5 N, s: the longer of the
    /// two, of onset and release.
    pub mean_back_s: f64,
    /// The same for every single millisecond.
    pub instant_back_s: f64,
    /// Least tension of any cable, N: zero is slack.
    pub least_n: f64,
    /// Greatest tension of the watched cable, N.
    pub greatest_n: f64,
}

/// The paper's band about the set-point, N.
const BAND_N: f64 = 0.5;
/// Window of the moving mean, ticks of 1 ms.
const WINDOW: usize = 50;

/// Error statistics of the true tension between two times, s.
#[must_use]
pub fn at_rest(trace: &Trace, from_s: f64, to_s: f64) -> Steady {
    let errors: Vec<f64> = errors(trace)
        .filter(|(t, _)| (from_s..to_s).contains(t))
        .map(|(_, e)| e)
        .collect();
    #[expect(clippy::cast_precision_loss, reason = "some thousand ticks")]
    let count = errors.len().max(1) as f64;
    let mean = errors.iter().sum::<f64>() / count;
    let variance = errors.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / count;
    Steady {
        mean_error_n: mean,
        sd_n: variance.sqrt(),
        mean_abs_n: errors.iter().map(|e| e.abs()).sum::<f64>() / count,
        max_abs_n: errors.iter().map(|e| e.abs()).fold(0.0, f64::max),
    }
}

/// Recovery of the tension after a pull from `on_s` to `off_s`.
#[must_use]
pub fn recovery(trace: &Trace, on_s: f64, off_s: f64) -> Recovery {
    let errors: Vec<_> = errors(trace).collect();
    let mut means = Vec::with_capacity(errors.len());
    for window in errors.windows(WINDOW) {
        #[expect(clippy::cast_precision_loss, reason = "fifty")]
        let mean = window.iter().map(|(_, e)| e).sum::<f64>() / WINDOW as f64;
        // A mean is known at the end of its window.
        let at = window.last().map_or(0.0, |(t, _)| *t);
        means.push((at, mean));
    }
    let after = |from: f64| {
        let within = trace.time_s.iter().zip(&trace.least_n);
        within
            .filter(move |(t, _)| **t >= from)
            .map(|(_, least)| *least)
            .fold(f64::INFINITY, f64::min)
    };
    // One second past the end: the last sample counts as well.
    let end_s = trace.time_s.last().copied().unwrap_or(0.0) + 1.0;
    Recovery {
        peak_n: errors
            .iter()
            .filter(|(t, _)| *t >= on_s)
            .map(|(_, e)| e.abs())
            .fold(0.0, f64::max),
        mean_back_s: back(&means, on_s, off_s).max(back(&means, off_s, end_s)),
        instant_back_s: back(&errors, on_s, off_s).max(back(&errors, off_s, end_s)),
        least_n: after(on_s),
        greatest_n: trace.setpoint_n
            + errors
                .iter()
                .filter(|(t, _)| *t >= on_s)
                .map(|(_, e)| *e)
                .fold(f64::NEG_INFINITY, f64::max),
    }
}

/// Time from `from_s` after which the values stay in the band, up to `to_s`.
fn back(values: &[(f64, f64)], from_s: f64, to_s: f64) -> f64 {
    values
        .iter()
        .filter(|(t, e)| (from_s..to_s).contains(t) && e.abs() > BAND_N)
        .map(|(t, _)| t - from_s)
        .fold(0.0, f64::max)
}

fn errors(trace: &Trace) -> impl Iterator<Item = (f64, f64)> + '_ {
    let pairs = trace.time_s.iter().zip(&trace.tension_n);
    let rows = pairs.zip(&trace.setpoints_n);
    rows.map(|((&t, &tension), &setpoint)| (t, tension - setpoint))
}
