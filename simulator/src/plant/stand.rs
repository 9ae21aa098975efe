//! A stand under the platform, for mounting the cables.

use super::vec3::{V3, add, axpy, cross, mul, scale};

/// Stiffness of the stand's pads (N/m) and their damping (N s/m).
const STIFFNESS_N_PER_M: f64 = 20_000.0;
const DAMPING_NS_PER_M: f64 = 150.0;
/// The same against tilting (N m/rad, N m s/rad).
const TILT_NM_PER_RAD: f64 = 40.0;
const TILT_DAMPING_NMS: f64 = 0.3;

/// Pads that carry the platform at its pose when the stand was put under it. They push and do not
/// pull: a platform that is lifted leaves them.
#[derive(Debug, Clone)]
pub(crate) struct Stand {
    /// Centre of mass with the pads unloaded, world (m).
    center_m: V3,
    /// Rotation from platform's principal axes to world.
    rotation: [[f64; 3]; 3],
}

impl Stand {
    /// Under a platform at rest that weighs `weight_n`.
    pub(crate) fn under(center_m: V3, rotation: [[f64; 3]; 3], weight_n: f64) -> Self {
        Self {
            // Higher by the pads' own compression, 13.7 N / 20 kN/m = 0.7 mm: the platform stays.
            center_m: axpy(center_m, weight_n / STIFFNESS_N_PER_M, [0.0, 0.0, 1.0]),
            rotation,
        }
    }

    /// Force and torque on the platform, world.
    pub(crate) fn push(
        &self,
        center_m: V3,
        velocity: V3,
        rotation: &[[f64; 3]; 3],
        spin_in_body: V3,
    ) -> (V3, V3) {
        let away = axpy(center_m, -1.0, self.center_m);
        if away[2] >= 0.0 {
            return ([0.0; 3], [0.0; 3]);
        }
        let mut force = axpy(scale(away, -STIFFNESS_N_PER_M), -DAMPING_NS_PER_M, velocity);
        // Damping must not turn the push of a leaving platform into a pull.
        force[2] = force[2].max(0.0);
        // Half the sum of the cross products of the axes is the small rotation between two frames.
        let column = |m: &[[f64; 3]; 3], i: usize| [m[0][i], m[1][i], m[2][i]];
        let turned = (0..3).fold([0.0; 3], |sum, i| {
            axpy(
                sum,
                0.5,
                cross(column(&self.rotation, i), column(rotation, i)),
            )
        });
        let spin = mul(rotation, spin_in_body);
        let torque = add(
            scale(turned, -TILT_NM_PER_RAD),
            scale(spin, -TILT_DAMPING_NMS),
        );
        (force, torque)
    }
}
