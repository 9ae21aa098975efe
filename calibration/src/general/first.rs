//! The first pose of a robot from changes of its readings only.

use super::data::Set;
use super::fit::{Fit, Options, fit};
use super::unknowns::Priors;
use mcdpr_kinematics::Pose;
use nalgebra::Matrix6;

/// Pose of the platform at the first sample.
#[derive(Debug, Clone)]
pub struct First {
    /// world_from_platform.
    pub pose: Pose,
    /// Covariance of its displacement, position then rotation.
    pub covariance: Matrix6<f64>,
}

/// The pose of the first sample, without homing: lengths, swivel angles, tilt and tensions are used
/// only through their changes, since their offsets are unknown to 1 m, 0.5 rad, 3 degrees and 100
/// N. The scatter is the stated or expected one; it is not estimated.
///
/// # Errors
/// In words, if the samples do not determine the pose.
pub(crate) fn first_pose(set: &Set) -> Result<First, String> {
    let options = Options {
        priors: Priors::changes_only(),
        rounds: 0,
        slips: 0,
    };
    let found = fit(&set.alone(), &options)?;
    pose_of(&found, 0).ok_or_else(|| "there are no samples".to_owned())
}

/// The pose of a sample of an estimate with its covariance.
#[must_use]
pub fn pose_of(fit: &Fit, k: usize) -> Option<First> {
    let block = fit.solution.blocks.get(k)?;
    let all = &block.inverse + &block.follow * &fit.solution.covariance * block.follow.transpose();
    Some(First {
        pose: fit.solution.state.poses[k],
        covariance: all.fixed_view::<6, 6>(0, 0).into_owned(),
    })
}
