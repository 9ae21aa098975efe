//! What may move, how far, and how it is told.

use super::gaussian::Gaussian;
use super::layout::Layout;
use super::rows::vector;
use nalgebra::Vector3;

/// A knock of an anchor is looked for within this, per axis, m.
pub(super) const ANCHOR_M: f64 = 5e-3;
/// A bent bracket: shift, m, and turn, rad.
const CAMERA_M: f64 = 5e-3;
const CAMERA_RAD: f64 = 2e-2;
/// Something that moved.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Moved {
    /// The anchor of a cable, 1 for the first. A cable that slipped looks alike from one place.
    Anchor(usize),
    /// The camera on its bracket.
    Camera,
    /// The payload: it was dropped, or slipped.
    Payload,
}

/// What moved, and by how much.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Named {
    /// What.
    pub what: Moved,
    /// By how much: world, m, for an anchor; camera frame, m, for the camera; kg in the first component for
    /// a payload.
    pub by: Vector3<f64>,
}

impl Named {
    /// What moved, and by how much, as a sentence without its full stop.
    #[must_use]
    pub fn words(&self) -> String {
        let [x, y, z]: [f64; 3] = (self.by * 1e3).into();
        let by_mm = self.by.norm() * 1e3;
        match self.what {
            Moved::Anchor(cable) => format!(
                "anchor {cable} moved by {by_mm:.1} mm ({x:+.1}, {y:+.1}, {z:+.1}), or its cable slipped"
            ),
            Moved::Camera => format!(
                "the camera moved by {by_mm:.1} mm on its bracket ({x:+.1}, {y:+.1}, {z:+.1})"
            ),
            Moved::Payload => format!("the load changed by {:+.0} g", self.by.x * 1e3),
        }
    }
}

/// What may have moved.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Hypothesis(pub(super) Moved);

impl Hypothesis {
    pub(super) fn free(self, layout: Layout, states: &mut Gaussian) {
        match self.0 {
            Moved::Anchor(cable) => {
                for axis in 0..3 {
                    states.loosen(layout.anchor(cable - 1) + axis, ANCHOR_M * ANCHOR_M);
                }
            }
            Moved::Camera => {
                for axis in 0..3 {
                    states.loosen(layout.camera() + axis, CAMERA_M * CAMERA_M);
                    states.loosen(layout.camera() + 3 + axis, CAMERA_RAD * CAMERA_RAD);
                }
            }
            Moved::Payload => {
                let first = layout.payload();
                let mass = states.mean[first].max(0.1);
                states.loosen(first, mass * mass);
                for axis in 0..3 {
                    states.loosen(first + 1 + axis, (mass * 0.05).powi(2));
                }
            }
        }
    }

    pub(super) fn change(self, layout: Layout, from: &Gaussian, to: &Gaussian) -> Vector3<f64> {
        let first = match self.0 {
            Moved::Anchor(cable) => layout.anchor(cable - 1),
            Moved::Camera => layout.camera(),
            Moved::Payload => {
                let first = layout.payload();
                return Vector3::new(to.mean[first] - from.mean[first], 0.0, 0.0);
            }
        };
        vector(&to.mean, first) - vector(&from.mean, first)
    }
}
