//! The figures of merit of a run.

use super::PathPoint;
use crate::motion::{Model, Plan, PlanError};
use crate::run::Measured;
use nalgebra::{Rotation3, UnitQuaternion, Vector3};
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

/// Figures of a run. SI, the unit in the key.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Figures {
    /// Distance between the tool's true and planned positions at that time. True positions of the
    /// simulated tool; `None` on hardware without a camera.
    pub path_error_m: Option<MeanMax>,
    /// Angle between the platform's true and planned attitudes at that time, rad, where the lengths hold
    /// the attitude; `None` for other robots and on hardware.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub attitude_error_rad: Option<MeanMax>,
    /// Absolute difference of measured (drum encoder) and planned lengths, all cables.
    pub cable_length_error_m: MeanSdMax,
    /// Tension-held cables: measured minus planned.
    pub tension_error_n: TensionError,
}

/// Judges a run: the measurements against the plan, and the true path if there is one.
///
/// # Errors
/// [`PlanError::Path`]: never for a plan that was run.
pub fn measure(
    model: &Model,
    plan: &Plan,
    samples: &[Measured],
    true_path: Option<&[PathPoint]>,
) -> Result<Figures, PlanError> {
    let duration_s = plan.timed.duration_s();
    let path_error_m = match true_path {
        None => None,
        Some(points) => {
            let mut errors = Vec::new();
            for point in points.iter().filter(|point| point.path_s <= duration_s) {
                let planned_m = plan.timed.tool_m(point.path_s)?;
                errors.push((Vector3::from(point.tool_m) - planned_m).norm());
            }
            Some(MeanMax {
                mean: mean(&errors),
                max: greatest(&errors),
            })
        }
    };
    let mut lengths = Vec::new();
    let mut tensions = Vec::new();
    for sample in samples {
        let Some(state) = sample.path_s.and_then(|time_s| plan.state(time_s)) else {
            continue;
        };
        let pairs = sample.lengths_m.iter().zip(&state.paid_out_m);
        lengths.extend(pairs.map(|(measured, planned)| (measured - planned).abs()));
        for &held in model.holding().by_tension() {
            let measured = sample.tensions_n.get(held);
            if let Some((tension, planned)) = measured.zip(state.tensions_n().get(held)) {
                tensions.push((tension - planned).abs());
            }
        }
    }
    let length_mean = mean(&lengths);
    let spread: Vec<_> = lengths.iter().map(|l| (l - length_mean).powi(2)).collect();
    Ok(Figures {
        path_error_m,
        attitude_error_rad: None,
        cable_length_error_m: MeanSdMax {
            mean: length_mean,
            sd: mean(&spread).sqrt(),
            max: greatest(&lengths),
        },
        tension_error_n: TensionError::of(tensions),
    })
}

impl Figures {
    /// The same figures with the error of the attitude, where lengths hold it.
    #[must_use]
    pub(crate) fn with_attitude(
        mut self,
        model: &Model,
        plan: &Plan,
        turns: Option<&[(f64, Rotation3<f64>)]>,
    ) -> Self {
        if !model.holding().freedom().turns() {
            return self;
        }
        let duration_s = plan.timed.duration_s();
        self.attitude_error_rad = turns.map(|turns| {
            let along = turns.iter().filter(|(time_s, _)| *time_s <= duration_s);
            let errors: Vec<f64> = along
                .filter_map(|(time_s, turned)| {
                    let planned = plan.state(*time_s)?.equilibrium.pose.rotation;
                    // By a quaternion: rounding takes the angle from the trace out of its domain.
                    let off = planned.inverse() * turned;
                    Some(UnitQuaternion::from_rotation_matrix(&off).angle())
                })
                .collect();
            MeanMax {
                mean: mean(&errors),
                max: greatest(&errors),
            }
        });
        self
    }
}

impl TensionError {
    /// Of absolute differences, N; NaN if there are none.
    pub(super) fn of(mut differences_n: Vec<f64>) -> Self {
        differences_n.sort_unstable_by(f64::total_cmp);
        let at = (differences_n.len() * 999 / 1000).min(differences_n.len().saturating_sub(1));
        Self {
            mean_abs: mean(&differences_n),
            p999_abs: differences_n.get(at).copied().unwrap_or(f64::NAN),
            max_abs: greatest(&differences_n),
        }
    }
}

#[expect(clippy::cast_precision_loss, reason = "far fewer than 2^52 samples")]
pub(super) fn mean(values: &[f64]) -> f64 {
    if values.is_empty() {
        return f64::NAN;
    }
    values.iter().sum::<f64>() / values.len() as f64
}

pub(super) fn greatest(values: &[f64]) -> f64 {
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
