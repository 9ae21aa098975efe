//! The figures of merit of a run.

use super::PathPoint;
use crate::motion::{Model, Plan, PlanError};
use crate::run::Measured;
use mcdpr_twin::record::figures::{MeanMax, MeanSdMax, TensionError, greatest, mean};
use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use serde::Serialize;

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
