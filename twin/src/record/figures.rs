//! Statistics that figures of a run are made of.

use serde::Serialize;

/// Mean and greatest value, m or rad.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct MeanMax {
    /// Mean.
    pub mean: f64,
    /// Greatest.
    pub max: f64,
}

/// Mean, standard deviation and greatest value, m.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct MeanSdMax {
    /// Mean.
    pub mean: f64,
    /// Standard deviation.
    pub sd: f64,
    /// Greatest.
    pub max: f64,
}

/// Deviation of the measured tension from its set-point, N.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TensionError {
    /// Mean of the absolute value.
    pub mean_abs: f64,
    /// Exceeded by one sample in a thousand: the greatest of many samples is mostly sensor noise.
    pub p999_abs: f64,
    /// Greatest absolute value.
    pub max_abs: f64,
}

impl TensionError {
    /// Of absolute differences, N; NaN if there are none.
    #[must_use]
    pub fn of(mut differences_n: Vec<f64>) -> Self {
        differences_n.sort_unstable_by(f64::total_cmp);
        let at = (differences_n.len() * 999 / 1000).min(differences_n.len().saturating_sub(1));
        Self {
            mean_abs: mean(&differences_n),
            p999_abs: differences_n.get(at).copied().unwrap_or(f64::NAN),
            max_abs: greatest(&differences_n),
        }
    }
}

/// The mean; NaN of nothing.
#[must_use]
#[expect(clippy::cast_precision_loss, reason = "far fewer than 2^52 samples")]
pub fn mean(values: &[f64]) -> f64 {
    if values.is_empty() {
        return f64::NAN;
    }
    values.iter().sum::<f64>() / values.len() as f64
}

/// The greatest, NaN left out; NaN of nothing.
#[must_use]
pub fn greatest(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::NAN, f64::max)
}

#[cfg(test)]
mod tests {
    use super::TensionError;

    #[test]
    fn the_largest_of_a_thousand_is_beyond_the_percentile() {
        let of = |count: u32| TensionError::of((0..count).map(f64::from).rev().collect());
        let error = of(1000);
        assert_eq!(
            (error.mean_abs, error.p999_abs, error.max_abs),
            (499.5, 999.0, 999.0)
        );
        let error = of(2000);
        assert_eq!((error.p999_abs, error.max_abs), (1998.0, 1999.0));
        let error = of(0);
        assert!(error.mean_abs.is_nan() && error.p999_abs.is_nan() && error.max_abs.is_nan());
    }
}
