//! First and second derivatives of the cable lengths (paper, Eq. 12, and those needed by
//! calibration).
//!
//! With t the cable's direction and u = R A the arm: the row of the twist Jacobian is
//! `[t, u x t]`. Further, per cable: dL/d(anchor) = -t, dL/d(attachment) = R^T t,
//! dL/d(radius) = theta - sin(theta), dL/d(axis) = (rho cos(theta) - h sin(theta)) e.

use nalgebra::{Matrix3, Matrix6, SMatrix, Vector3, Vector6};

use crate::error::Error;
use crate::inverse::Inverse;
use crate::pose::{Pose, angular_velocity_from_rates};
use crate::robot::Robot;

/// Derivatives of one cable's length with respect to its own parameters.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LengthDerivatives {
    /// d(length)/d(anchor), world frame, dimensionless.
    pub anchor: Vector3<f64>,
    /// d(length)/d(pulley radius), dimensionless.
    pub pulley_radius: f64,
    /// d(length)/d(swivel axis), m: the gradient projected on the tangent plane of the unit sphere
    /// (perpendicular to the axis). For any change of the unit axis, its dot product with that
    /// change is the change of length.
    pub swivel_axis: Vector3<f64>,
    /// d(length)/d(attachment), platform frame, dimensionless.
    pub attachment: Vector3<f64>,
}

impl<const N: usize> Inverse<N> {
    /// The twist Jacobian, N x 6: d(lengths)/dt = J `[v, omega]` (m/s from m/s and rad/s, world,
    /// v of the platform's origin). Row i is `[t_i^T, (u_i x t_i)^T]`.
    pub fn twist_jacobian(&self) -> SMatrix<f64, N, 6> {
        SMatrix::from_fn(|i, j| self.twist_row(i)[j])
    }

    /// One row of the twist Jacobian.
    ///
    /// # Panics
    /// If `cable >= N`.
    #[inline(always)]
    pub fn twist_row(&self, cable: usize) -> Vector6<f64> {
        lifted(&self.direction(cable), &self.arm_m(cable))
    }

    /// The Jacobian with respect to `[x, y, z, rx, ry, rz]`, N x 6, at the attitude
    /// `[rx, ry, rz]` (rad) of the pose that this inverse belongs to. Units: 1 and m/rad.
    pub fn euler_jacobian(&self, attitude_rad: [f64; 3]) -> SMatrix<f64, N, 6> {
        let e = angular_velocity_from_rates(attitude_rad);
        let mut jacobian = self.twist_jacobian();
        let rates = jacobian.fixed_view::<N, 3>(0, 3) * e;
        jacobian.fixed_view_mut::<N, 3>(0, 3).copy_from(&rates);
        jacobian
    }

    /// The Hessian (3 x 3, 1/m, world) of one cable's length with respect to its attachment point:
    /// n n^T/s + (sin(theta)/rho) b b^T, with n in the swivel plane and b across it.
    ///
    /// # Panics
    /// If `cable >= N`.
    pub fn point_hessian(&self, robot: &Robot<N>, cable: usize) -> Matrix3<f64> {
        let f = self.frame(robot, cable);
        f.n * f.n.transpose() * f.n_curvature + f.b * f.b.transpose() * f.b_curvature
    }

    /// The Hessian (6 x 6, world) of one cable's length with respect to a displacement
    /// `[dp, phi]` of the platform as in [`Pose::displaced`]. Units: 1/m, 1, m.
    ///
    /// # Panics
    /// If `cable >= N`.
    pub fn twist_hessian(&self, robot: &Robot<N>, cable: usize) -> Matrix6<f64> {
        let f = self.frame(robot, cable);
        let u = self.arm_m(cable);
        let t = self.direction(cable);
        let (n, b) = (lifted(&f.n, &u), lifted(&f.b, &u));
        let mut h = n * n.transpose() * f.n_curvature + b * b.transpose() * f.b_curvature;
        let tu = t * u.transpose();
        let rotation = (tu + tu.transpose()) * 0.5 - Matrix3::identity() * t.dot(&u);
        let sum = h.fixed_view::<3, 3>(3, 3) + rotation;
        h.fixed_view_mut::<3, 3>(3, 3).copy_from(&sum);
        h
    }

    #[inline(always)]
    pub(crate) fn frame(&self, robot: &Robot<N>, i: usize) -> PathFrame {
        let e = self.swivel_direction(i);
        let a = robot.cables()[i].swivel_axis;
        PathFrame {
            n: e * self.wrap_cos[i] - a * self.wrap_sin[i],
            b: a.cross(&e),
            n_curvature: 1.0 / self.free_lengths_m[i],
            b_curvature: self.wrap_sin[i] / self.axis_distances_m[i],
        }
    }
}

/// The two directions across a cable, and how fast its direction turns when the end moves there.
pub(crate) struct PathFrame {
    pub n: Vector3<f64>,
    pub b: Vector3<f64>,
    pub n_curvature: f64,
    pub b_curvature: f64,
}

/// The twist row `[v, u x v]` of a world vector v at an arm u.
#[inline(always)]
pub(crate) fn lifted(v: &Vector3<f64>, u: &Vector3<f64>) -> Vector6<f64> {
    let m = u.cross(v);
    Vector6::new(v.x, v.y, v.z, m.x, m.y, m.z)
}

impl<const N: usize> Robot<N> {
    /// Twist Jacobian at a pose, N x 6. See [`Inverse::twist_jacobian`].
    ///
    /// # Errors
    /// As [`Robot::inverse`].
    pub fn twist_jacobian(&self, pose: &Pose) -> Result<SMatrix<f64, N, 6>, Error> {
        Ok(self.inverse(pose)?.twist_jacobian())
    }

    /// Derivatives of every length with respect to its cable's own parameters.
    ///
    /// # Errors
    /// As [`Robot::inverse`].
    pub fn length_derivatives(&self, pose: &Pose) -> Result<[LengthDerivatives; N], Error> {
        let inverse = self.inverse(pose)?;
        Ok(core::array::from_fn(|i| {
            let cable = &self.cables()[i];
            let t = inverse.direction(i);
            let d = pose.position_m + inverse.arm_m(i) - cable.anchor_m;
            let h = d.dot(&cable.swivel_axis);
            let (sin, cos) = (inverse.wrap_sin[i], inverse.wrap_cos[i]);
            LengthDerivatives {
                anchor: -t,
                pulley_radius: inverse.wraps_rad[i] - sin,
                swivel_axis: inverse.swivel_direction(i)
                    * (inverse.axis_distances_m[i] * cos - h * sin),
                attachment: pose.rotation.inverse_transform_vector(&t),
            }
        }))
    }
}
