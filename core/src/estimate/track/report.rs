//! What tracking tells.

use super::Named;
use mcdpr_kinematics::Pose;
use nalgebra::{Matrix3, Vector3};

/// What one rest taught.
#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    /// Whether it fitted what was known.
    pub fits: bool,
    /// Sum of squared innovations over the value beyond which it is doubted.
    pub doubt: f64,
    /// What moved, if one cause explains the last rests and no other does.
    pub named: Option<Named>,
}

impl Report {
    /// Of a rest that names nothing.
    pub(super) fn of(doubt: f64) -> Self {
        Self {
            fits: doubt <= 1.0,
            doubt,
            named: None,
        }
    }
}

/// A payload as tracked.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Load {
    /// Mass, kg.
    pub mass_kg: f64,
    /// Its standard deviation, kg.
    pub mass_sigma_kg: f64,
    /// Centre of mass, platform frame, m.
    pub center_m: Vector3<f64>,
    /// Its standard deviation per axis, m.
    pub center_sigma_m: Vector3<f64>,
}

/// Where the tool is, with the covariance that the states leave.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Region {
    /// The platform's pose.
    pub pose: Pose,
    /// Tool, world, m.
    pub tool_m: Vector3<f64>,
    /// Its covariance, m2.
    pub covariance_m2: Matrix3<f64>,
}

impl Region {
    /// Whether a place lies in the 95 % region (chi-square of three: 7.815).
    #[must_use]
    pub fn holds(&self, tool_m: &Vector3<f64>) -> bool {
        let off = tool_m - self.tool_m;
        self.covariance_m2
            .try_inverse()
            .is_some_and(|inverse| (off.transpose() * inverse * off).x <= 7.815)
    }
}
