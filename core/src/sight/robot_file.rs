//! The robot file's camera as what estimators project with.

use super::Lens;
use crate::robot;
use mcdpr_kinematics::Pose;
use nalgebra::Rotation3;

/// The camera of a robot file as a projection.
#[must_use]
pub fn lens_of(camera: &robot::Camera) -> Lens {
    Lens {
        focal_px: [camera.fx_px, camera.fy_px],
        center_px: [camera.cx_px, camera.cy_px],
        size_px: [f64::from(camera.width_px), f64::from(camera.height_px)],
        distortion: camera.distortion,
    }
}

/// A transform of a robot file as a pose: a_from_b.
#[must_use]
pub fn pose_of(transform: &robot::Transform) -> Pose {
    Pose::new(
        transform.translation_m,
        Rotation3::from_matrix_unchecked(transform.rotation),
    )
}
