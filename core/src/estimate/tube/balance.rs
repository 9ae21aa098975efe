//! Balance of forces and moments of a platform, and how small errors change it.

use crate::robot::Robot;
use mcdpr_kinematics::{CablePath, GRAVITY_MPS2, Pose};
use nalgebra::{Matrix3, Vector3};

/// Adds a force and a moment.
pub(super) fn put(out: &mut [f64], force: &Vector3<f64>, moment: &Vector3<f64>) {
    for (slot, value) in out.iter_mut().zip(force.iter().chain(moment.iter())) {
        *slot += value;
    }
}

/// Forces and moments about the platform's origin, and how they change.
pub(super) struct Balance<'a> {
    pub(super) robot: &'a Robot,
    pub(super) pose: &'a Pose,
    pub(super) tensions_n: &'a [f64],
    pub(super) paths: &'a [CablePath],
    /// Direction of each cable per displacement of its attachment, 1/m.
    pub(super) turning: &'a [Matrix3<f64>],
}

impl Balance<'_> {
    fn arm(&self, path: &CablePath) -> Vector3<f64> {
        path.attachment_m - self.pose.position_m
    }

    /// The platform moves and turns.
    pub(super) fn moved(&self, shift: &Vector3<f64>, turn: &Vector3<f64>, out: &mut [f64]) {
        let cables = self.paths.iter().zip(self.turning).zip(self.tensions_n);
        for ((path, turning), tension_n) in cables {
            let arm = self.arm(path);
            let swept = turn.cross(&arm);
            let pull = turning * (shift + swept) * -*tension_n;
            let moment = swept.cross(&(path.direction * -*tension_n)) + arm.cross(&pull);
            put(out, &pull, &moment);
        }
        let platform = &self.robot.platform;
        let weight = Vector3::new(0.0, 0.0, -GRAVITY_MPS2 * platform.mass_kg);
        let center = self.pose.rotation * platform.center_of_mass_m;
        put(out, &Vector3::zeros(), &turn.cross(&center).cross(&weight));
    }

    /// A cable's tension changes.
    pub(super) fn pulled(&self, i: usize, by_n: f64, out: &mut [f64]) {
        if let Some(path) = self.paths.get(i) {
            let pull = path.direction * -by_n;
            put(out, &pull, &self.arm(path).cross(&pull));
        }
    }

    /// The anchor of a cable moves by `shift`: the cable turns.
    pub(super) fn reanchored(&self, i: usize, shift: &Vector3<f64>, out: &mut [f64]) {
        let mut cables = self.paths.iter().zip(self.turning).zip(self.tensions_n);
        if let Some(((path, turning), tension_n)) = cables.nth(i) {
            let pull = turning * shift * *tension_n;
            put(out, &pull, &self.arm(path).cross(&pull));
        }
    }

    /// The direction of a cable changes by `by`, its attachment in place.
    pub(super) fn turned(&self, i: usize, by: &Vector3<f64>, out: &mut [f64]) {
        if let (Some(path), Some(tension_n)) = (self.paths.get(i), self.tensions_n.get(i)) {
            let pull = by * -*tension_n;
            put(out, &pull, &self.arm(path).cross(&pull));
        }
    }

    /// The attachment of a cable moves by `shift`: the cable turns the other way, and pulls at another place.
    pub(super) fn reattached(&self, i: usize, shift: &Vector3<f64>, out: &mut [f64]) {
        self.reanchored(i, &-shift, out);
        if let (Some(path), Some(tension_n)) = (self.paths.get(i), self.tensions_n.get(i)) {
            let moment = shift.cross(&(path.direction * -*tension_n));
            put(out, &Vector3::zeros(), &moment);
        }
    }
}
