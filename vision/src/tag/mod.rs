//! AprilTags of the family 36h11: their corners in a picture, and their pose.
//!
//! The steps: a threshold that follows the light (`threshold`), outlines of dark regions and the
//! quadrangles among them (`quad`), the code inside (`decode`), the edges' positions to hundredths
//! of a pixel (`refine`), the pose with covariance and its mirror twin (`pose`).
//!
//! A tag's frame has its origin in the middle, x to the right, y down and z into the tag as one
//! looks at it. Corners go top left, top right, bottom right, bottom left. The tag's edge is that of
//! the black square; a white rim of an eighth of it must surround the square.
//!
//! The project has its own detector because the available ones cost too much: a first build that
//! takes a minute longer, or a C compiler. It was compared with one of them (`docs/vision.md`).

mod decode;
pub mod family;
mod pose;
mod quad;
mod refine;
mod threshold;

pub use pose::{PoseError, TagPose, pose_of_tag};

use crate::camera::Camera;
use crate::image::GrayImage;
use nalgebra::{Matrix2, Vector2};

/// Criteria for a tag.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Shortest edge, px: eight cells must be distinguishable.
    pub edge_min_px: f64,
    /// Least difference between dark and bright, grey values.
    pub contrast_min: f64,
    /// Most wrong bits that are corrected. Up to 5 are possible; each more lets more false
    /// detections pass.
    pub errors_max: u32,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            edge_min_px: 20.0,
            contrast_min: 20.0,
            errors_max: 2,
        }
    }
}

/// A tag in a picture.
#[derive(Debug, Clone, PartialEq)]
pub struct Detection {
    /// Its number in the family 36h11.
    pub id: u32,
    /// Bits that were wrong and have been corrected.
    pub errors: u32,
    /// Corners: top left, top right, bottom right, bottom left of the tag itself, px.
    pub corners_px: [Vector2<f64>; 4],
    /// Covariance of each corner from the scatter of the edges, px^2.
    pub covariance_px2: [Matrix2<f64>; 4],
    /// Difference between bright and dark, grey values.
    pub contrast: f64,
}

impl Detection {
    /// Length of the shortest edge, px.
    #[must_use]
    pub fn edge_px(&self) -> f64 {
        let next = |i: usize| (self.corners_px[(i + 1) % 4] - self.corners_px[i]).norm();
        (0..4).map(next).fold(f64::INFINITY, f64::min)
    }
}

/// Finds the tags of a picture, largest first. With a camera its lens distortion is taken into
/// account when edges are fitted; corners are still pixels of the original picture.
///
/// A tag that is partly outside the picture, or whose white rim is covered, is not found.
#[must_use]
pub fn detect(picture: &GrayImage, camera: Option<&Camera>, options: &Options) -> Vec<Detection> {
    let dark = threshold::dark(picture, options.contrast_min);
    let mut found: Vec<Detection> = Vec::new();
    for quad in quad::quads(&dark, options.edge_min_px) {
        // A first pass with rough corners rejects other quadrangles before edges are measured.
        if decode::read(picture, &quad, options).is_none() {
            continue;
        }
        let Some(edges) = refine::refine(picture, camera, &quad) else {
            continue;
        };
        let Some(code) = decode::read(picture, &edges.corners_px, options) else {
            continue;
        };
        let at = |i: usize| (i + code.first_corner) % 4;
        found.push(Detection {
            id: code.id,
            errors: code.errors,
            corners_px: [0, 1, 2, 3].map(|i| edges.corners_px[at(i)]),
            covariance_px2: [0, 1, 2, 3].map(|i| edges.covariance_px2[at(i)]),
            contrast: code.contrast,
        });
    }
    found.sort_by(|a, b| b.edge_px().total_cmp(&a.edge_px()));
    // Inner and outer outline of the same square give the same tag: the larger one is right.
    let mut kept: Vec<Detection> = Vec::new();
    for tag in found {
        let middle = |tag: &Detection| tag.corners_px.iter().sum::<Vector2<f64>>() / 4.0;
        let twin = |other: &Detection| {
            other.id == tag.id && (middle(other) - middle(&tag)).norm() < 0.25 * other.edge_px()
        };
        if !kept.iter().any(twin) {
            kept.push(tag);
        }
    }
    kept
}
