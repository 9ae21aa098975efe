//! Frames of bodies and cameras.

use crate::plant::Pose;
use crate::plant::vec3::{M3, V3, add, mul, mul_t, scale};

/// A rigid frame: a point p of it lies at `rotation p + position_m` in its parent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// Rotation to the parent, row by row.
    pub rotation: [[f64; 3]; 3],
    /// Origin in the parent, m.
    pub position_m: [f64; 3],
}

impl Default for Frame {
    fn default() -> Self {
        Self::at([0.0; 3])
    }
}

impl From<Pose> for Frame {
    fn from(pose: Pose) -> Self {
        Self {
            rotation: pose.matrix(),
            position_m: pose.position_m,
        }
    }
}

impl Frame {
    /// Parallel to its parent.
    #[must_use]
    pub const fn at(position_m: [f64; 3]) -> Self {
        Self {
            rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            position_m,
        }
    }

    /// z straight down, x along the parent's x: a camera that looks down, a tag that faces up.
    #[must_use]
    pub const fn looking_down(position_m: [f64; 3]) -> Self {
        Self {
            rotation: [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]],
            position_m,
        }
    }

    /// Turned by roll, pitch, yaw (rad): `Rz(yaw) Ry(pitch) Rx(roll)`.
    #[must_use]
    pub fn from_rpy(position_m: [f64; 3], rpy_rad: [f64; 3]) -> Self {
        Pose::from_rpy(position_m, rpy_rad).into()
    }

    /// A point of the frame in the parent, m.
    #[must_use]
    pub fn point(&self, point_m: [f64; 3]) -> [f64; 3] {
        add(self.position_m, mul(&self.rotation, point_m))
    }

    /// A direction of the frame in the parent.
    #[must_use]
    pub fn direction(&self, direction: [f64; 3]) -> [f64; 3] {
        mul(&self.rotation, direction)
    }

    /// A point of the parent in the frame, m.
    #[must_use]
    pub fn point_inside(&self, point_m: [f64; 3]) -> [f64; 3] {
        mul_t(&self.rotation, add(point_m, scale(self.position_m, -1.0)))
    }

    /// A direction of the parent in the frame.
    #[must_use]
    pub(crate) fn direction_inside(&self, direction: [f64; 3]) -> [f64; 3] {
        mul_t(&self.rotation, direction)
    }

    /// `self` composed with `inner`, a frame given in this frame.
    ///
    /// ```
    /// use mcdpr_simulator::camera::Frame;
    /// let outer = Frame::from_rpy([1.0, 0.0, 0.0], [0.0, 0.0, std::f64::consts::FRAC_PI_2]);
    /// let inner = outer.then(&Frame::at([2.0, 0.0, 0.0]));
    /// assert!((inner.position_m[1] - 2.0).abs() < 1e-12); // a quarter turn takes x to y
    /// ```
    #[must_use]
    pub fn then(&self, inner: &Self) -> Self {
        let column = |j: usize| self.direction([0, 1, 2].map(|i| inner.rotation[i][j]));
        let columns: [V3; 3] = [0, 1, 2].map(column);
        let rotation: M3 = [0, 1, 2].map(|i| [0, 1, 2].map(|j| columns[j][i]));
        Self {
            rotation,
            position_m: self.point(inner.position_m),
        }
    }

    /// The inverse: the parent in this frame.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let r = &self.rotation;
        Self {
            rotation: [0, 1, 2].map(|i| [0, 1, 2].map(|j| r[j][i])),
            position_m: mul_t(r, scale(self.position_m, -1.0)),
        }
    }
}
