//! Grasps for a gripper with two parallel jaws.
//!
//! A [`Detector`] gives grasps in the colour camera's frame, best first. [`Antipodal`] needs no
//! weights: it finds the ground plane, makes a map of heights over it and looks for opposite
//! edges with room for fingers. With the feature `onnx` a network in a file finds them (`network`).

mod antipodal;
mod fit;
mod ground;
mod map;
#[cfg(feature = "onnx")]
pub mod network;
mod rays;
mod regions;
mod walk;

pub use antipodal::Antipodal;
pub use fit::Fit;
pub use map::HeightMap;

use crate::align::Aligned;
use nalgebra::{Isometry3, Point3, Vector2, Vector3};
use thiserror::Error;

/// The jaws.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hand {
    /// Distance between the open pads, m.
    pub opening_m: f64,
    /// Half of a pad's width, m.
    pub pad_half_width_m: f64,
    /// How far the pads reach below the tool point, m.
    pub below_m: f64,
    /// How far the pads reach above the tool point, m.
    pub above_m: f64,
    /// How far a finger reaches above the tool point before it meets the gripper's body, m.
    pub shaft_m: f64,
    /// Thickness of a finger, m.
    pub finger_m: f64,
    /// Room that is kept between a finger and everything else, m.
    pub margin_m: f64,
    /// Greatest angle between a surface and the pad that grips it, rad.
    pub slope_max_rad: f64,
    /// How far a pad's rubber can be compressed, m.
    pub soft_m: f64,
}

impl Default for Hand {
    fn default() -> Self {
        Self {
            opening_m: 0.06,
            pad_half_width_m: 0.006,
            below_m: 0.005,
            above_m: 0.02,
            shaft_m: 0.05,
            finger_m: 0.006,
            margin_m: 0.003,
            slope_max_rad: 0.22,
            soft_m: 5e-4,
        }
    }
}

impl Hand {
    /// Height over which a pad lies on an upright wall when the jaws close along a direction that
    /// rises by `lean_rad`, m: the rest of the pad is further from the wall than its rubber gives
    /// way.
    #[must_use]
    pub fn lies_on_m(&self, lean_rad: f64) -> f64 {
        let whole_m = self.below_m + self.above_m;
        (self.soft_m / lean_rad.tan().abs().max(1e-9)).min(whole_m)
    }
}

/// Directions in which the jaws can close.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Closing {
    /// Any: the gripper turns about its axis.
    Any,
    /// Along this direction of the camera's frame, either way round.
    Along(Vector3<f64>),
}

/// The part of the ground on which objects are looked for: a rectangle about an origin, with sides
/// along x and y.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Area {
    /// The rectangle's frame in the colour camera's, m.
    pub camera_from_area: Isometry3<f64>,
    /// Half of its sides, m.
    pub half_m: [f64; 2],
}

/// The request to a detector.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wanted {
    /// The jaws.
    pub hand: Hand,
    /// How they can close.
    pub closing: Closing,
    /// Area to search; `None`: everywhere.
    pub area: Option<Area>,
}

impl Wanted {
    /// Any direction, everywhere.
    #[must_use]
    pub const fn anywhere(hand: Hand) -> Self {
        Self {
            hand,
            closing: Closing::Any,
            area: None,
        }
    }

    /// Whether a point (camera frame, m) lies over the area.
    #[must_use]
    pub fn holds(&self, point_m: &Point3<f64>) -> bool {
        self.area.is_none_or(|area| {
            let p = area.camera_from_area.inverse_transform_point(point_m);
            p.x.abs() < area.half_m[0] && p.y.abs() < area.half_m[1]
        })
    }
}

/// A grasp.
#[derive(Debug, Clone, PartialEq)]
pub struct Grasp {
    /// Middle of the grasp in the colour picture, px.
    pub pixel: Vector2<f64>,
    /// Tool point, colour camera's frame, m.
    pub point_m: Point3<f64>,
    /// Direction in which the jaws close, colour camera's frame, a unit vector in the ground plane.
    pub closing: Vector3<f64>,
    /// Distance between the pads when closed, m.
    pub width_m: f64,
    /// Room between the open fingers and what they could touch, m.
    pub clearance_m: f64,
    /// Height of the object's top over the ground, m.
    pub top_m: f64,
    /// Height of the tool point over the ground, m.
    pub height_m: f64,
    /// Rank: 0 useless to 1 best.
    pub quality: f64,
}

/// Why there is no grasp.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum NoGrasp {
    /// Too few distances.
    #[error("only {share:.0} % of the picture has a distance: no ground plane can be found", share = 100.0 * share)]
    NoDepth {
        /// Share of the pixels that have one.
        share: f64,
    },
    /// No plane.
    #[error("no plane holds {wanted:.0} % of the distances (the best {best:.0} %): is the tray in view?", wanted = 100.0 * wanted, best = 100.0 * best)]
    NoPlane {
        /// Share that the best plane holds.
        best: f64,
        /// Share that is wanted.
        wanted: f64,
    },
    /// Nothing on the ground.
    #[error("nothing stands over the ground: the tray is empty")]
    Empty,
    /// Objects, but too wide.
    #[error(
        "the narrowest object is {narrowest_mm:.0} mm wide where it could be taken, the jaws open {opening_mm:.0} mm with room to spare"
    )]
    TooWide {
        /// Least width found, mm.
        narrowest_mm: f64,
        /// Width that fits, mm.
        opening_mm: f64,
    },
    /// Objects, but the fingers have no room beside them.
    #[error(
        "objects are there, but the fingers have no room beside them in any direction that the jaws can close"
    )]
    NoRoom,
    /// The network gives something else than it should.
    #[error("grasp network: {0}")]
    Network(String),
}

/// Finds grasps, on any thread: the link to a hanging robot must be served meanwhile.
pub trait Detector: Send {
    /// Its description for users.
    fn name(&self) -> String;

    /// The grasps of a picture, best first.
    ///
    /// # Errors
    /// Why there is no grasp.
    fn detect(&mut self, picture: &Aligned, wanted: &Wanted) -> Result<Vec<Grasp>, NoGrasp>;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pad_that_leans_lies_on_less_of_a_wall() {
        let hand = Hand::default();
        assert_eq!(hand.lies_on_m(0.0), hand.below_m + hand.above_m);
        // A slope of 1 in 10 uses half a millimetre of rubber up over 5 mm.
        let lean = 0.1_f64.atan();
        assert!((hand.lies_on_m(lean) - 0.005).abs() < 1e-9);
        assert_eq!(hand.lies_on_m(-lean), hand.lies_on_m(lean));
    }
}
