//! Inputs and results of the static solvers.

use crate::cable_vec::{CableSet, CableVec};
use crate::pose::Pose;

/// The quantity that a winch keeps constant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Held {
    /// The length from anchor to attachment, m, of an inextensible cable. The cable may go slack.
    Length(f64),
    /// The tension, N.
    Tension(f64),
    /// The unstretched length of an elastic cable. The cable may go slack.
    Elastic {
        /// Unstretched length from anchor to attachment, m.
        unstretched_m: f64,
        /// Axial stiffness EA, N.
        ea_n: f64,
        /// Unstretched length behind the anchor that stretches as well, m.
        routing_m: f64,
    },
}

impl Held {
    /// Whether the cable's tension is prescribed.
    pub fn is_tension(&self) -> bool {
        matches!(self, Held::Tension(_))
    }
}

/// Limits of the static solvers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StaticOptions {
    /// Largest force residual, relative to the weight (moments are divided by the lever).
    pub force_tolerance: f64,
    /// Largest violation of a held length, m.
    pub length_tolerance_m: f64,
    /// Newton steps before giving up.
    pub max_iterations: usize,
}

impl Default for StaticOptions {
    fn default() -> Self {
        Self {
            // 0.3 nN for a platform of 14 N: little above the rounding of the sums.
            force_tolerance: 2e-11,
            length_tolerance_m: 1e-12,
            max_iterations: 400,
        }
    }
}

/// Where a static solver starts.
#[derive(Clone, Copy, Debug)]
pub enum Start<'a> {
    /// No estimate: below the middle of the anchors, level.
    Cold,
    /// Near this pose.
    Pose(&'a Pose),
    /// From an equilibrium nearby (pose and tensions): the fast way along a trajectory.
    Warm(&'a Equilibrium),
}

/// A verified equilibrium.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Equilibrium {
    /// Pose world_from_platform.
    pub pose: Pose,
    /// Tension of each cable, N; zero for slack cables.
    pub tensions_n: CableVec<f64>,
    /// Taut length from anchor to attachment at the pose, m (for a slack cable: the distance along
    /// the taut path, shorter than what is paid out).
    pub lengths_m: CableVec<f64>,
    /// Cables without tension that were not commanded to zero tension.
    pub slack: CableSet,
    /// Cables whose tension was prescribed.
    pub tension_held: CableSet,
    /// Axial stiffness of each length-held cable, N/m; 0 means inextensible.
    pub axial_stiffness_n_per_m: CableVec<f64>,
    /// Largest of |force| and |moment|/lever left over, N.
    pub residual_n: f64,
    /// Largest violation of a held length, m.
    pub residual_m: f64,
    /// Newton steps taken.
    pub iterations: usize,
    /// Whether the energy is at a strict minimum (the Hessian reduced to the null space of the taut
    /// length-held cables is positive definite).
    pub stable: bool,
}
