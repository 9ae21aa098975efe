//! Colour and depth pictures taken together, and the cameras that took them.

use crate::camera::{Camera, CameraError};
use crate::image::{DepthImage, Image, RgbImage, SizeError};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// A colour camera and a depth camera that are fixed to each other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cameras {
    /// The colour camera.
    pub color: Camera,
    /// The depth camera.
    pub depth: Camera,
    /// Takes points of the depth camera's frame to the colour camera's, m.
    pub color_from_depth: Isometry3<f64>,
}

/// What is wrong with a pair of pictures.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum FrameError {
    /// A picture does not fit its camera.
    #[error(transparent)]
    Size(#[from] SizeError),
    /// A camera's numbers are invalid.
    #[error("{which} {source}")]
    Camera {
        /// Which camera.
        which: &'static str,
        /// Why.
        source: CameraError,
    },
    /// The depth picture is empty.
    #[error(
        "the depth picture holds no distance at all: is the depth camera covered, too near, or switched off?"
    )]
    NoDepth,
    /// The distances are implausible for this camera.
    #[error(
        "half of the distances are over {median_m:.3} m, which is outside {least_m} to {most_m} m: is the depth unit {unit_m} m right?"
    )]
    Unit {
        /// Median distance, m.
        median_m: f64,
        /// Least plausible distance, m.
        least_m: f64,
        /// Greatest plausible distance, m.
        most_m: f64,
        /// Unit of the picture, m.
        unit_m: f64,
    },
}

/// Median distances that a camera on a robot of this kind can have, m.
const PLAUSIBLE_M: [f64; 2] = [0.05, 10.0];

/// A colour and a depth picture of the same moment.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// The colour picture.
    pub color: RgbImage,
    /// The depth picture, as its own camera sees it.
    pub depth: DepthImage,
    /// The cameras.
    pub cameras: Cameras,
}

impl Frame {
    /// Checks sizes, intrinsics and distances.
    ///
    /// # Errors
    /// What is wrong, with advice on what to check.
    pub fn checked(self) -> Result<Self, FrameError> {
        for (camera, which) in [
            (&self.cameras.color, "colour"),
            (&self.cameras.depth, "depth"),
        ] {
            camera
                .validate()
                .map_err(|source| FrameError::Camera { which, source })?;
        }
        fits(&self.color, &self.cameras.color, "colour")?;
        fits(&self.depth.steps, &self.cameras.depth, "depth")?;
        let mut seen: Vec<u16> = self.depth.steps.pixels().to_vec();
        seen.retain(|&steps| steps > 0);
        if seen.is_empty() {
            return Err(FrameError::NoDepth);
        }
        // The median: some far pixels of the background do not make a unit wrong.
        let middle = seen.len() / 2;
        let (_, median, _) = seen.select_nth_unstable(middle);
        let median_m = f64::from(*median) * self.depth.unit_m;
        let [least_m, most_m] = PLAUSIBLE_M;
        if !(least_m..=most_m).contains(&median_m) {
            return Err(FrameError::Unit {
                median_m,
                least_m,
                most_m,
                unit_m: self.depth.unit_m,
            });
        }
        Ok(self)
    }
}

fn fits<T: Copy>(picture: &Image<T>, camera: &Camera, what: &'static str) -> Result<(), SizeError> {
    let [camera_width, camera_height] = camera.size_px;
    let (width, height) = (picture.width(), picture.height());
    if [width, height] == camera.size_px {
        return Ok(());
    }
    Err(SizeError::Camera {
        what,
        width,
        height,
        camera_width,
        camera_height,
    })
}

/// The cameras as stored in a file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct CamerasFile {
    pub color: Camera,
    pub depth: Camera,
    /// Quaternion w, x, y, z and translation in m.
    pub color_from_depth: Place,
    /// One step of the depth pictures, m.
    pub depth_unit_m: f64,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Place {
    rotation_wxyz: [f64; 4],
    translation_m: [f64; 3],
}

impl CamerasFile {
    pub(crate) fn new(cameras: &Cameras, depth_unit_m: f64) -> Self {
        let place = &cameras.color_from_depth;
        let q = &place.rotation;
        Self {
            color: cameras.color,
            depth: cameras.depth,
            color_from_depth: Place {
                rotation_wxyz: [q.w, q.i, q.j, q.k],
                translation_m: place.translation.vector.into(),
            },
            depth_unit_m,
        }
    }

    /// The cameras; `Err` names the invalid number.
    pub(crate) fn cameras(&self) -> Result<Cameras, String> {
        let [w, i, j, k] = self.color_from_depth.rotation_wxyz;
        let q = Quaternion::new(w, i, j, k);
        if (q.norm() - 1.0).abs() > 1e-3 || !q.norm().is_finite() {
            return Err(format!(
                "color_from_depth.rotation_wxyz has length {}, it must be 1",
                q.norm()
            ));
        }
        // Two lenses of one device are centimetres apart: a metre and more is a wrong unit.
        if !self
            .color_from_depth
            .translation_m
            .iter()
            .all(|v| v.abs() < 1.0)
        {
            return Err("color_from_depth.translation_m must be below 1 m".to_owned());
        }
        if !(1e-5..=1e-2).contains(&self.depth_unit_m) {
            return Err(format!(
                "depth_unit_m is {}, it must be 0.00001 to 0.01",
                self.depth_unit_m
            ));
        }
        for (camera, name) in [(&self.color, "color"), (&self.depth, "depth")] {
            camera
                .validate()
                .map_err(|error| format!("{name}: {error}"))?;
        }
        Ok(Cameras {
            color: self.color,
            depth: self.depth,
            color_from_depth: Isometry3::from_parts(
                Translation3::from(nalgebra::Vector3::from(self.color_from_depth.translation_m)),
                UnitQuaternion::from_quaternion(q),
            ),
        })
    }
}
