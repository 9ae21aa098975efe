//! Attitude by an inclinometer or inertial unit on the platform, and its derivatives.

use mcdpr_kinematics::{Pose, angular_velocity_from_rates, rpy_from_rotation};
use nalgebra::{Matrix3, Rotation3, Vector3};

/// What an inclinometer reads that is turned on the platform by the rotation vector `mount_rad`
/// (platform_from_sensor, platform frame, rad).
#[derive(Debug, Clone, Copy)]
pub(crate) struct Attitude {
    /// Roll, pitch and yaw of R = Rz Ry Rx, rad.
    pub rpy_rad: [f64; 3],
    /// Their derivatives with respect to a small rotation of the platform about world axes.
    pub by_turn: Matrix3<f64>,
    /// The same with respect to `mount_rad`.
    pub by_mount: Matrix3<f64>,
}

impl Attitude {
    /// At this pose (world_from_platform). `None` at a pitch of 90 degrees: roll and yaw are one angle there, and have
    /// no derivatives.
    #[must_use]
    pub(crate) fn of(pose: &Pose, mount_rad: Vector3<f64>) -> Option<Self> {
        let rpy_rad = rpy_from_rotation(&(pose.rotation * Rotation3::new(mount_rad)));
        let by_turn = angular_velocity_from_rates(rpy_rad).try_inverse()?;
        Some(Self {
            rpy_rad,
            by_turn,
            by_mount: by_turn * pose.rotation.matrix() * left_jacobian(mount_rad),
        })
    }
}

/// Small rotation before a rotation vector's rotation per change of the vector (the left Jacobian of SO(3); Chirikjian,
/// 2012, section 10.3).
fn left_jacobian(vector: Vector3<f64>) -> Matrix3<f64> {
    let angle = vector.norm();
    // Below this the series' next terms are rounding.
    let (first, second) = if angle < 1e-4 {
        (0.5, 1.0 / 6.0)
    } else {
        (
            (1.0 - angle.cos()) / angle.powi(2),
            (angle - angle.sin()) / angle.powi(3),
        )
    };
    let cross = vector.cross_matrix();
    Matrix3::identity() + cross * first + cross * cross * second
}
