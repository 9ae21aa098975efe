//! Accuracy of the estimators: errors that do not depend on the frame, over simulated data.

use super::answer::Answer;
use super::data::Data;
use super::joint::{Options, joint};
use super::predict::displacement;
use super::simulate::{Setup, Truth, simulate};
use mcdpr_kinematics::{Platform, Robot};
use nalgebra::Vector3;

/// Errors of a calibration over the held-out poses.
#[derive(Debug, Clone)]
pub struct Errors {
    /// Position error at each pose, world axes, m.
    pub position_m: Vec<Vector3<f64>>,
    /// Root mean square of the position error, m.
    pub rms_m: f64,
    /// Root mean square of the yaw error, rad.
    pub yaw_rms_rad: f64,
    /// Yaw error at each pose, rad.
    pub yaw_rad: Vec<f64>,
    /// Mean absolute error of the predicted lengths (since the first pose), m.
    pub length_mean_m: f64,
    /// Share of the poses whose error lies in the 95 % region of the stated covariance.
    pub inside_95: f64,
}

/// 95 % quantile of chi-square with three degrees of freedom.
const CHI2_3_95: f64 = 7.8147;

/// Compares predicted readings at the held-out poses with the truth.
#[must_use]
pub fn errors(truth: &Truth, predicted_m: &[Vec<f64>], answer: Option<&Answer>) -> Option<Errors> {
    let platform = Platform {
        mass_kg: 1.0,
        center_of_mass_m: Vector3::zeros(),
        inertia_kg_m2: None,
    };
    let singles: Vec<Robot<1>> = truth
        .robot
        .cables()
        .iter()
        .filter_map(|cable| Robot::new([*cable], platform).ok())
        .collect();
    let (mut position_m, mut yaw_rad, mut lengths_m) = (Vec::new(), Vec::new(), Vec::new());
    let mut inside = 0usize;
    for (k, (pose, predicted)) in truth.holdout.iter().zip(predicted_m).enumerate() {
        let lengths = truth.robot.lengths_m(pose).ok()?;
        let wrong: Vec<f64> = (0..4)
            .map(|i| {
                let paid_out_m = lengths[i] * (1.0 - truth.stretch[i]);
                predicted[i] * truth.drum_scales[i] - (paid_out_m - truth.initial_length_m[i])
            })
            .collect();
        let (moved, yaw) = displacement(&singles, pose, &wrong).ok()?;
        yaw_rad.push(yaw);
        lengths_m.extend(wrong.iter().map(|w| w.abs()));
        if let Some(covariance) = answer.and_then(|a| a.holdout_covariance_m2.get(k)) {
            let distance = covariance.cholesky().map(|c| moved.dot(&c.solve(&moved)));
            inside += usize::from(distance.is_some_and(|d| d <= CHI2_3_95));
        }
        position_m.push(moved);
    }
    let n = position_m.len().max(1) as f64;
    let squares: f64 = position_m.iter().map(Vector3::norm_squared).sum();
    let yaws: f64 = yaw_rad.iter().map(|yaw| yaw * yaw).sum();
    Some(Errors {
        position_m,
        rms_m: (squares / n).sqrt(),
        yaw_rms_rad: (yaws / n).sqrt(),
        yaw_rad,
        length_mean_m: lengths_m.iter().sum::<f64>() / lengths_m.len().max(1) as f64,
        inside_95: inside as f64 / n,
    })
}

/// Predicted readings of the robot as designed, without calibration. The initial lengths are taken
/// from the first pose's picture.
#[must_use]
pub fn uncalibrated(data: &Data) -> Option<Vec<Vec<f64>>> {
    let usable = super::check::usable(data).ok()?;
    let platform = Platform {
        mass_kg: 1.0,
        center_of_mass_m: Vector3::zeros(),
        inertia_kg_m2: None,
    };
    let mut out = vec![Vec::new(); data.holdout.len()];
    for (i, cable) in data.robot.cables.iter().enumerate() {
        let cable = Robot::new([*cable], platform).ok()?;
        let mut offsets = Vec::new();
        for (pose, seen) in usable.start.iter().zip(&usable.data.poses) {
            let [length] = cable.lengths_m(pose).ok()?;
            offsets.extend(seen.encoder_m[i].map(|dl| length - dl));
        }
        let offset = offsets.iter().sum::<f64>() / offsets.len().max(1) as f64;
        for (slot, pose) in out.iter_mut().zip(&data.holdout) {
            let [length] = cable
                .lengths_m(&data.world_from_body[0].compose(pose))
                .ok()?;
            slot.push(length - offset);
        }
    }
    Some(out)
}

/// One simulated calibration by each method.
#[derive(Debug, Clone)]
pub struct Trial {
    /// Errors of the joint method.
    pub joint: Errors,
    /// Chi-square per degree of freedom of the joint method.
    pub chi_ratio: f64,
    /// Its predicted error, m.
    pub predicted_m: f64,
    /// Number of measurements that it rejected.
    pub rejected: usize,
    /// Errors of the paper's method, if it found an answer.
    pub paper: Option<Errors>,
    /// Errors without calibration.
    pub none: Option<Errors>,
}

/// Simulates and calibrates once.
///
/// # Errors
/// The refusal of the joint method, or of the simulation, in words.
pub fn trial(setup: &Setup, options: &Options) -> Result<Trial, String> {
    let (data, truth) = simulate(setup).ok_or("the simulation has no robot")?;
    let answer = joint(&data, options).map_err(|refusal| refusal.to_string())?;
    let failed = || "a held-out pose is outside the robot's domain".to_owned();
    let paper = super::paper::paper(&data, &super::paper::Weights::default()).ok();
    Ok(Trial {
        joint: errors(&truth, &answer.holdout_encoder_m, Some(&answer)).ok_or_else(failed)?,
        chi_ratio: answer.chi_square.unwrap_or(f64::NAN)
            / answer.degrees_of_freedom.unwrap_or(f64::NAN),
        predicted_m: answer.predicted_error_m,
        rejected: answer.rejected.len(),
        paper: paper.and_then(|answer| errors(&truth, &answer.holdout_encoder_m, None)),
        none: uncalibrated(&data).and_then(|lengths| errors(&truth, &lengths, None)),
    })
}

/// The median of some numbers.
#[must_use]
pub fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let n = values.len();
    match (values.get(n.wrapping_sub(1) / 2), values.get(n / 2)) {
        (Some(a), Some(b)) => (a + b) / 2.0,
        _ => f64::NAN,
    }
}
