//! A fixed obstacle that has caught the platform: the worst case of a snag.

use super::vec3::{V3, axpy, dot, scale, sub};

/// Stiffness of the hook (N/m): a steel rod of 8 mm that protrudes by 100 mm, `3 E I / L³` with
/// 210 GPa (Roark's Formulas for Stress and Strain, cantilever with an end load), 127 kN/m.
const STIFFNESS_N_PER_M: f64 = 127_000.0;
/// Its damping (N s/m): a twentieth of the critical damping of a kilogram on it.
const DAMPING_NS_PER_M: f64 = 36.0;

/// A hook that holds one point of the platform where it was caught.
#[derive(Debug, Clone)]
pub(crate) struct Hook {
    /// Where the point was caught, world (m).
    caught_m: V3,
    /// The point, in principal axes about the centre of mass (m).
    pub point: V3,
    /// Unit vector, world: it blocks motion along it and lets the platform move back. Without one
    /// it blocks motion in every direction.
    along: Option<V3>,
}

impl Hook {
    pub(crate) fn new(caught_m: V3, point: V3, along: Option<V3>) -> Self {
        Self {
            caught_m,
            point,
            along,
        }
    }

    /// Force on the platform at the point, world (N), for the point's position and velocity.
    pub(crate) fn pull(&self, at_m: V3, velocity: V3) -> V3 {
        let away = sub(at_m, self.caught_m);
        let Some(along) = self.along else {
            return axpy(scale(away, -STIFFNESS_N_PER_M), -DAMPING_NS_PER_M, velocity);
        };
        let gone = dot(along, away);
        if gone <= 0.0 {
            return [0.0; 3];
        }
        // It pulls and does not push: damping never turns the force around.
        let force = STIFFNESS_N_PER_M * gone + DAMPING_NS_PER_M * dot(along, velocity);
        scale(along, -force.max(0.0))
    }
}
