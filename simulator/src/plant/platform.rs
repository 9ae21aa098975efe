//! The platform as a free rigid body, and poses.

use super::error::PlantError;
use super::params::PlatformParams;
use super::validate::is_rotation;
use super::vec3::{
    M3, Q, V3, add, axpy, cross, mul, mul_t, norm, q_conj, q_from_matrix, q_matrix, q_mul,
    q_normalised, scale, sub, symmetric_eigen,
};

/// Position and attitude of the platform's frame in the world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Origin of the platform frame, world frame (m).
    pub position_m: [f64; 3],
    /// Unit quaternion `[w, x, y, z]` that takes platform vectors to the world.
    pub rotation_wxyz: [f64; 4],
}

impl Pose {
    /// A level pose.
    #[must_use]
    pub fn level(position_m: [f64; 3]) -> Self {
        Self {
            position_m,
            rotation_wxyz: [1.0, 0.0, 0.0, 0.0],
        }
    }

    /// From a rotation matrix `world_from_platform`, row by row.
    ///
    /// # Errors
    /// [`PlantError::Parameter`] if the matrix is not a rotation within 1e-6, or a value is not
    /// finite.
    pub fn from_matrix(position_m: [f64; 3], rotation: &[[f64; 3]; 3]) -> Result<Self, PlantError> {
        if !is_rotation(rotation, 1e-6) {
            return Err(PlantError::Parameter {
                name: "first element of the pose's rotation matrix",
                value: rotation[0][0],
                rule: "part of a right-handed orthonormal matrix",
            });
        }
        let pose = Self {
            position_m,
            rotation_wxyz: q_from_matrix(rotation),
        };
        pose.checked()
    }

    /// From roll, pitch and yaw (rad): the rotation `Rz(yaw) Ry(pitch) Rx(roll)`.
    ///
    /// ```
    /// use mcdpr_simulator::plant::Pose;
    /// let pose = Pose::from_rpy([0.0; 3], [0.0, 0.0, std::f64::consts::FRAC_PI_2]);
    /// let x = pose.point_in_world([1.0, 0.0, 0.0]);
    /// assert!((x[1] - 1.0).abs() < 1e-15); // a quarter turn of yaw takes x to y
    /// ```
    #[must_use]
    pub fn from_rpy(position_m: [f64; 3], rpy_rad: [f64; 3]) -> Self {
        let half = rpy_rad.map(|a| libm::sincos(0.5 * a));
        let x = [half[0].1, half[0].0, 0.0, 0.0];
        let y = [half[1].1, 0.0, half[1].0, 0.0];
        let z = [half[2].1, 0.0, 0.0, half[2].0];
        Self {
            position_m,
            rotation_wxyz: q_mul(z, q_mul(y, x)),
        }
    }

    /// Rotation matrix `world_from_platform`, row by row.
    #[must_use]
    pub fn matrix(&self) -> [[f64; 3]; 3] {
        q_matrix(self.rotation_wxyz)
    }

    /// Roll, pitch and yaw (rad) of `Rz(yaw) Ry(pitch) Rx(roll)`, pitch within a quarter turn.
    #[must_use]
    pub fn rpy_rad(&self) -> [f64; 3] {
        let m = self.matrix();
        // cos(pitch) as a root is never negative: pitch stays within a quarter turn.
        let level = (m[0][0] * m[0][0] + m[1][0] * m[1][0]).sqrt();
        [
            libm::atan2(m[2][1], m[2][2]),
            libm::atan2(-m[2][0], level),
            libm::atan2(m[1][0], m[0][0]),
        ]
    }

    /// A point given in the platform frame (m), in the world frame (m).
    #[must_use]
    pub fn point_in_world(&self, point_m: [f64; 3]) -> [f64; 3] {
        add(self.position_m, mul(&self.matrix(), point_m))
    }

    pub(crate) fn checked(self) -> Result<Self, PlantError> {
        for value in self.position_m {
            if !value.is_finite() {
                return Err(PlantError::Parameter {
                    name: "pose position_m",
                    value,
                    rule: "finite",
                });
            }
        }
        let q = self.rotation_wxyz;
        let length = q.iter().map(|v| v * v).sum::<f64>().sqrt();
        // A rounded quaternion is normalised; a length further off is an error in the input.
        if length.is_nan() || (length - 1.0).abs() > 1e-3 {
            return Err(PlantError::Parameter {
                name: "length of the pose's quaternion",
                value: length,
                rule: "1",
            });
        }
        Ok(Self {
            rotation_wxyz: q_normalised(q),
            ..self
        })
    }
}

/// The constants of the body, with everything attached to it in principal axes about the centre
/// of mass, so that the rotation can be split into exact turns about those axes.
#[derive(Debug, Clone)]
pub(crate) struct Body {
    pub mass_kg: f64,
    pub inverse_inertia: V3,
    pub platform_from_principal: M3,
    platform_from_principal_q: Q,
    center_of_mass_m: V3,
    pub linear_damping: f64,
    pub angular_damping: f64,
}

impl Body {
    pub(crate) fn new(p: &PlatformParams) -> Self {
        let (inertia, basis) = symmetric_eigen(&p.inertia_kg_m2);
        Self {
            mass_kg: p.mass_kg,
            inverse_inertia: inertia.map(|i| 1.0 / i),
            platform_from_principal: basis,
            platform_from_principal_q: q_from_matrix(&basis),
            center_of_mass_m: p.center_of_mass_m,
            linear_damping: p.linear_damping_ns_per_m,
            angular_damping: p.angular_damping_nms,
        }
    }

    /// A point of the platform frame in principal axes about the centre of mass.
    pub(crate) fn principal(&self, point_m: V3) -> V3 {
        mul_t(
            &self.platform_from_principal,
            sub(point_m, self.center_of_mass_m),
        )
    }

    /// A point in principal axes about the centre of mass in the platform frame (m).
    pub(super) fn in_platform(&self, principal: V3) -> V3 {
        add(
            mul(&self.platform_from_principal, principal),
            self.center_of_mass_m,
        )
    }
}

/// The moving state: centre of mass, attitude of the principal axes, their momenta.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Motion {
    pub center_m: V3,
    pub velocity: V3,
    /// `world_from_principal`.
    pub attitude: Q,
    /// Angular momentum in principal axes.
    pub momentum: V3,
}

impl Motion {
    pub(crate) fn at_rest(body: &Body, pose: &Pose) -> Self {
        Self {
            center_m: pose.point_in_world(body.center_of_mass_m),
            velocity: [0.0; 3],
            attitude: q_normalised(q_mul(pose.rotation_wxyz, body.platform_from_principal_q)),
            momentum: [0.0; 3],
        }
    }

    pub(crate) fn pose(&self, body: &Body) -> Pose {
        let rotation_wxyz =
            q_normalised(q_mul(self.attitude, q_conj(body.platform_from_principal_q)));
        let m = q_matrix(rotation_wxyz);
        Pose {
            position_m: sub(self.center_m, mul(&m, body.center_of_mass_m)),
            rotation_wxyz,
        }
    }

    /// Angular velocity in principal axes (rad/s).
    #[inline(always)]
    pub(crate) fn spin(&self, body: &Body) -> V3 {
        [
            self.momentum[0] * body.inverse_inertia[0],
            self.momentum[1] * body.inverse_inertia[1],
            self.momentum[2] * body.inverse_inertia[2],
        ]
    }

    /// Velocity of the platform frame's origin and angular velocity, world frame.
    pub(crate) fn twist(&self, body: &Body) -> (V3, V3) {
        let m = q_matrix(self.attitude);
        let spin = self.spin(body);
        let origin = scale(
            mul_t(&body.platform_from_principal, body.center_of_mass_m),
            -1.0,
        );
        let velocity = add(self.velocity, mul(&m, cross(spin, origin)));
        (velocity, mul(&m, spin))
    }

    pub(crate) fn kinetic_energy(&self, body: &Body) -> f64 {
        let spin = self.spin(body);
        0.5 * (body.mass_kg * norm(self.velocity).powi(2)
            + spin[0] * self.momentum[0]
            + spin[1] * self.momentum[1]
            + spin[2] * self.momentum[2])
    }

    /// Free flight for `h` seconds. The rotation is split into turns about the principal axes,
    /// x y z y x (Dullweber, Leimkuhler and McLachlan 1997), each by a Cayley map: world angular
    /// momentum is kept exactly, the map is symplectic and reversible, and needs no trigonometry.
    #[inline(always)]
    pub(crate) fn drift(&mut self, body: &Body, h: f64) {
        self.center_m = axpy(self.center_m, h, self.velocity);
        // Arguments are half times: x and y turn twice by h / 2 each, z once by h.
        let quarter = 0.25 * h;
        self.turn::<1, 2>(body, 0, quarter);
        self.turn::<2, 0>(body, 1, quarter);
        self.turn::<0, 1>(body, 2, 0.5 * h);
        self.turn::<2, 0>(body, 1, quarter);
        self.turn::<1, 2>(body, 0, quarter);
        self.attitude = q_normalised(self.attitude);
    }

    /// Turn about principal axis `axis` by the angle `2 atan(half_time * rate)`; `J` and `K` are
    /// the next two axes in cyclic order.
    #[inline(always)]
    fn turn<const J: usize, const K: usize>(&mut self, body: &Body, axis: usize, half_time: f64) {
        let t = half_time * self.momentum[axis] * body.inverse_inertia[axis];
        let inverse = 1.0 / (1.0 + t * t);
        let (sine, cosine) = (2.0 * t * inverse, (1.0 - t * t) * inverse);
        let (j, k) = (self.momentum[J], self.momentum[K]);
        self.momentum[J] = cosine * j + sine * k;
        self.momentum[K] = cosine * k - sine * j;
        // The length is normalised once per drift.
        let q = self.attitude;
        let mut twist = [1.0, 0.0, 0.0, 0.0];
        twist[axis + 1] = t;
        self.attitude = q_mul(q, twist);
    }

    /// Adds the impulse of `force` (world) and `torque` (principal axes, about the centre of
    /// mass) over `h` seconds, then drag, implicitly so that any drag is stable.
    #[inline(always)]
    pub(crate) fn kick(&mut self, body: &Body, force: V3, torque: V3, h: f64) {
        self.velocity = axpy(self.velocity, h / body.mass_kg, force);
        self.momentum = axpy(self.momentum, h, torque);
        if body.linear_damping > 0.0 {
            let keep = 1.0 / (1.0 + h * body.linear_damping / body.mass_kg);
            self.velocity = scale(self.velocity, keep);
        }
        if body.angular_damping > 0.0 {
            for i in 0..3 {
                self.momentum[i] /= 1.0 + h * body.angular_damping * body.inverse_inertia[i];
            }
        }
    }
}
