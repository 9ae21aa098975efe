//! Rigid transforms, such as the platform's pose, and the attitude convention.

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

use crate::error::Error;
use crate::math::sin_cos;

/// A rigid transform `a_from_b`: the pose of frame b in frame a. Most are world_from_platform.
///
/// A point of frame b (the platform) has the coordinates `position_m + rotation * point` in frame a
/// (the world: z up, gravity along -z). Units: m. Transforms are named `a_from_b`, so that equal
/// letters meet where they are composed: `a_from_b.compose(&b_from_c)` is `a_from_c`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Origin of frame b (the platform's) in frame a (the world), m.
    pub position_m: Vector3<f64>,
    /// Rotation a_from_b (world_from_platform).
    pub rotation: Rotation3<f64>,
}

impl Pose {
    /// A pose from a position and a rotation.
    pub fn new(position_m: Vector3<f64>, rotation: Rotation3<f64>) -> Self {
        Self {
            position_m,
            rotation,
        }
    }

    /// A level pose (identity rotation).
    pub fn level(position_m: Vector3<f64>) -> Self {
        Self::new(position_m, Rotation3::identity())
    }

    /// A pose from a position (m) and the attitude angles `[rx, ry, rz]` (rad),
    /// R = Rz(rz) Ry(ry) Rx(rx).
    ///
    /// ```
    /// use mcdpr_kinematics::Pose;
    /// use nalgebra::Vector3;
    /// // A quarter turn about z carries the platform's x axis to the world's y axis.
    /// let pose = Pose::from_rpy(Vector3::zeros(), [0.0, 0.0, core::f64::consts::FRAC_PI_2]);
    /// assert!((pose.rotation * Vector3::x() - Vector3::y()).norm() < 1e-15);
    /// ```
    pub fn from_rpy(position_m: Vector3<f64>, attitude_rad: [f64; 3]) -> Self {
        Self::new(position_m, rotation_from_rpy(attitude_rad))
    }

    /// A pose from a position (m) and a unit quaternion world_from_platform.
    pub fn from_quaternion(position_m: Vector3<f64>, q: UnitQuaternion<f64>) -> Self {
        Self::new(position_m, q.to_rotation_matrix())
    }

    /// The attitude angles `[rx, ry, rz]` in rad; ry lies in [-pi/2, pi/2], and at ry = +-pi/2
    /// (where only rz -+ rx is defined) rx = 0.
    pub fn rpy(&self) -> [f64; 3] {
        rpy_from_rotation(&self.rotation)
    }

    /// The rotation as a unit quaternion world_from_platform.
    pub fn quaternion(&self) -> UnitQuaternion<f64> {
        UnitQuaternion::from_rotation_matrix(&self.rotation)
    }

    /// a_from_c, given a_from_b (this) and b_from_c.
    ///
    /// ```
    /// use mcdpr_kinematics::Pose;
    /// use nalgebra::Vector3;
    /// // b is at x = 1 m, turned by a quarter turn about z; c lies 2 m along b's x axis.
    /// let quarter = [0.0, 0.0, core::f64::consts::FRAC_PI_2];
    /// let a_from_b = Pose::from_rpy(Vector3::new(1.0, 0.0, 0.0), quarter);
    /// let b_from_c = Pose::level(Vector3::new(2.0, 0.0, 0.0));
    /// let a_from_c = a_from_b.compose(&b_from_c);
    /// assert!((a_from_c.position_m - Vector3::new(1.0, 2.0, 0.0)).norm() < 1e-15);
    /// ```
    #[must_use]
    pub fn compose(&self, b_from_c: &Self) -> Self {
        Self::new(
            self.transform(&b_from_c.position_m),
            self.rotation * b_from_c.rotation,
        )
    }

    /// b_from_a, given a_from_b (this).
    ///
    /// ```
    /// use mcdpr_kinematics::Pose;
    /// use nalgebra::Vector3;
    /// let quarter = [0.0, 0.0, core::f64::consts::FRAC_PI_2];
    /// let back = Pose::from_rpy(Vector3::new(1.0, 0.0, 0.0), quarter).inverse();
    /// assert!((back.position_m - Vector3::new(0.0, 1.0, 0.0)).norm() < 1e-15);
    /// assert!((back.rpy()[2] + core::f64::consts::FRAC_PI_2).abs() < 1e-15);
    /// ```
    #[must_use]
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.inverse();
        Self::new(-(rotation * self.position_m), rotation)
    }

    /// World coordinates (m) of a point given in platform coordinates (m).
    pub fn transform(&self, point_in_platform_m: &Vector3<f64>) -> Vector3<f64> {
        self.position_m + self.rotation * point_in_platform_m
    }

    /// The angle between the platform's z axis and the world's, rad.
    pub fn tilt_rad(&self) -> f64 {
        // atan2 instead of acos: near zero tilt the arc cosine loses half of the digits.
        let m = self.rotation.matrix();
        crate::math::atan2(
            crate::math::sqrt(m[(0, 2)] * m[(0, 2)] + m[(1, 2)] * m[(1, 2)]),
            m[(2, 2)],
        )
    }

    /// The pose displaced by a twist `[dp, phi]`: the origin moves by `dp` (m, world) and the
    /// platform turns by the rotation vector `phi` (rad, world) about its own origin.
    pub fn displaced(&self, translation_m: &Vector3<f64>, rotation_rad: &Vector3<f64>) -> Self {
        let turned = small_rotation(rotation_rad) * self.rotation.matrix();
        Self::new(
            self.position_m + translation_m,
            Rotation3::from_matrix_unchecked(orthonormal(turned)),
        )
    }

    /// Refuses poses with a NaN or infinite entry.
    ///
    /// # Errors
    /// [`Error::InvalidInput`].
    pub fn check(&self) -> Result<(), Error> {
        let bad = self
            .position_m
            .iter()
            .chain(self.rotation.matrix().iter())
            .find(|x| !x.is_finite());
        match bad {
            Some(&value) => Err(Error::InvalidInput {
                what: "every number of a pose must be finite",
                cable: None,
                value,
            }),
            None => Ok(()),
        }
    }
}

/// The same transform with a quaternion, as the vision crate's interface has it.
impl From<Pose> for Isometry3<f64> {
    fn from(pose: Pose) -> Self {
        Self::from_parts(Translation3::from(pose.position_m), pose.quaternion())
    }
}

/// The same transform with a rotation matrix.
impl From<Isometry3<f64>> for Pose {
    fn from(isometry: Isometry3<f64>) -> Self {
        Self::from_quaternion(isometry.translation.vector, isometry.rotation)
    }
}

/// R = Rz(rz) Ry(ry) Rx(rx) from `[rx, ry, rz]` in rad.
pub fn rotation_from_rpy([rx, ry, rz]: [f64; 3]) -> Rotation3<f64> {
    let (sx, cx) = sin_cos(rx);
    let (sy, cy) = sin_cos(ry);
    let (sz, cz) = sin_cos(rz);
    Rotation3::from_matrix_unchecked(Matrix3::new(
        cz * cy,
        cz * sy * sx - sz * cx,
        cz * sy * cx + sz * sx,
        sz * cy,
        sz * sy * sx + cz * cx,
        sz * sy * cx - cz * sx,
        -sy,
        cy * sx,
        cy * cx,
    ))
}

/// `[rx, ry, rz]` in rad of R = Rz(rz) Ry(ry) Rx(rx). See [`Pose::rpy`].
pub fn rpy_from_rotation(rotation: &Rotation3<f64>) -> [f64; 3] {
    let m = rotation.matrix();
    let horizontal = crate::math::sqrt(m[(0, 0)] * m[(0, 0)] + m[(1, 0)] * m[(1, 0)]);
    let ry = crate::math::atan2(-m[(2, 0)], horizontal);
    // Below this the first column gives no direction any more.
    if horizontal < 1e-14 {
        return [0.0, ry, crate::math::atan2(-m[(0, 1)], m[(1, 1)])];
    }
    [
        crate::math::atan2(m[(2, 1)], m[(2, 2)]),
        ry,
        crate::math::atan2(m[(1, 0)], m[(0, 0)]),
    ]
}

/// The 3x3 matrix E with omega = E [rx', ry', rz'], omega in the world frame.
///
/// Its determinant is cos(ry): it is singular at ry = +-pi/2.
pub fn angular_velocity_from_rates([_, ry, rz]: [f64; 3]) -> Matrix3<f64> {
    let (sy, cy) = sin_cos(ry);
    let (sz, cz) = sin_cos(rz);
    // Columns: Rz Ry x, Rz y, z.
    Matrix3::new(cz * cy, -sz, 0.0, sz * cy, cz, 0.0, -sy, 0.0, 1.0)
}

/// The matrix exponential of a rotation vector (Rodrigues).
fn small_rotation(v: &Vector3<f64>) -> Matrix3<f64> {
    let t2 = v.norm_squared();
    // Series below 0.01 rad: the first neglected terms are of relative size 1e-19.
    let (a, b) = if t2 < 1e-4 {
        (
            1.0 - t2 / 6.0 * (1.0 - t2 / 20.0 * (1.0 - t2 / 42.0)),
            0.5 - t2 / 24.0 * (1.0 - t2 / 30.0 * (1.0 - t2 / 56.0)),
        )
    } else {
        let t = crate::math::sqrt(t2);
        let (s, c) = sin_cos(t);
        (s / t, (1.0 - c) / t2)
    };
    let k = v.cross_matrix();
    Matrix3::identity() + k * a + k * k * b
}

/// One step of Newton's iteration for the polar factor: keeps products of many rotations orthonormal.
fn orthonormal(m: Matrix3<f64>) -> Matrix3<f64> {
    m * 1.5 - m * (m.transpose() * m) * 0.5
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_and_quaternions_convert_both_ways() {
        for &rpy in &[
            [0.1, -0.2, 0.3],
            [-2.9, 1.2, 3.0],
            [0.0, 0.0, 0.0],
            [3.0, -1.5, -1.0],
        ] {
            let pose = Pose::from_rpy(Vector3::new(1.0, 2.0, 3.0), rpy);
            for (a, b) in pose.rpy().iter().zip(rpy) {
                assert!((a - b).abs() < 1e-14, "{rpy:?} {:?}", pose.rpy());
            }
            let back = Pose::from_quaternion(pose.position_m, pose.quaternion());
            assert!((back.rotation.matrix() - pose.rotation.matrix()).norm() < 1e-14);
        }
    }

    #[test]
    fn composing_with_the_inverse_leaves_nothing_and_isometries_agree() {
        let a_from_b = Pose::from_rpy(Vector3::new(0.3, -0.2, 0.7), [0.4, -0.9, 2.1]);
        let b_from_c = Pose::from_rpy(Vector3::new(-0.1, 0.5, 0.2), [-1.4, 0.3, 0.6]);
        let nothing = a_from_b.compose(&a_from_b.inverse());
        assert!(nothing.position_m.norm() < 1e-14);
        assert!((nothing.rotation.matrix() - Matrix3::identity()).norm() < 1e-14);
        let a_from_c = a_from_b.compose(&b_from_c);
        let point = Vector3::new(0.2, 0.1, -0.4);
        let by_parts = a_from_b.transform(&b_from_c.transform(&point));
        assert!((a_from_c.transform(&point) - by_parts).norm() < 1e-14);
        // nalgebra's own composition, with quaternions, is an independent reference.
        let judge = Isometry3::from(a_from_b) * Isometry3::from(b_from_c);
        let back = Pose::from(judge);
        assert!((back.position_m - a_from_c.position_m).norm() < 1e-14);
        assert!((back.rotation.matrix() - a_from_c.rotation.matrix()).norm() < 1e-14);
        let undone = Pose::from(Isometry3::from(a_from_b).inverse());
        assert!((undone.position_m - a_from_b.inverse().position_m).norm() < 1e-14);
    }

    #[test]
    fn attitudes_are_those_of_nalgebra_to_the_last_bit() {
        for k in 0..2000 {
            let f = f64::from(k);
            let rpy @ [rx, ry, rz] = [0.013 * f, 0.3 + 0.007 * f, -0.02 * f];
            let ours = rotation_from_rpy(rpy);
            assert_eq!(ours, Rotation3::from_euler_angles(rx, ry, rz), "{rpy:?}");
        }
    }

    #[test]
    fn the_gimbal_pose_keeps_its_rotation() {
        let r = rotation_from_rpy([0.4, core::f64::consts::FRAC_PI_2, 0.9]);
        let again = rotation_from_rpy(rpy_from_rotation(&r));
        assert!((r.matrix() - again.matrix()).norm() < 1e-14);
    }

    #[test]
    fn rates_give_the_angular_velocity() {
        let rpy = [0.3, -0.7, 1.1];
        let rates = [0.5, -0.2, 0.9];
        let step = 1e-6;
        let at = |s: f64| {
            *rotation_from_rpy([
                rpy[0] + s * rates[0],
                rpy[1] + s * rates[1],
                rpy[2] + s * rates[2],
            ])
            .matrix()
        };
        let dot = (at(step) - at(-step)) / (2.0 * step);
        let omega = dot * at(0.0).transpose();
        let want = angular_velocity_from_rates(rpy) * Vector3::from(rates);
        let got = Vector3::new(omega[(2, 1)], omega[(0, 2)], omega[(1, 0)]);
        assert!((got - want).norm() < 1e-9);
    }

    #[test]
    fn displacement_is_the_exponential() {
        let pose = Pose::from_rpy(Vector3::zeros(), [0.2, 0.1, -0.4]);
        for scale in [1e-8, 5e-3, 9.9e-3, 1.01e-2, 1.0] {
            let v = Vector3::new(0.6, -0.3, 0.5) * scale;
            let got = pose.displaced(&Vector3::x(), &v);
            let want = Rotation3::new(v) * pose.rotation;
            assert!((got.rotation.matrix() - want.matrix()).norm() < 2e-15);
            assert_eq!(got.position_m, Vector3::x());
        }
    }

    #[test]
    fn a_pose_with_nan_is_refused() {
        let pose = Pose::level(Vector3::new(0.0, f64::NAN, 0.0));
        assert!(pose.check().is_err());
    }
}
