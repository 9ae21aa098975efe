//! Printed tags on the tray's floor: where the camera is, seen against what the objects lie on.
//!
//! What lengths and tensions say of the platform's place is off by what anchors, centre of mass and
//! pulleys are off, and differently so at the look and at the grasp. Against the mat both places
//! are known to tenths of a millimetre, and what is left is the camera's place on the platform.

use crate::calibration::data::Camera as Lens;
use crate::calibration::pnp::{Square, sightings_of};
use mcdpr_vision::tag::{Options, detect};
use mcdpr_vision::{Camera, RgbImage};
use nalgebra::{Isometry3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// A sheet of tags.
#[derive(Debug, Clone, PartialEq)]
pub struct Mat {
    /// Number of each tag and its corners on the sheet, m, as [`crate::robot::Tag`] has them.
    pub tags: Vec<(u32, [Vector3<f64>; 4])>,
}

/// Fewer tags than this are not believed: a covered edge shows only against others.
const LEAST_TAGS: usize = 2;
/// Corners that fit worse than this belong to a tag that something covers in part, px.
const CORNER_PX: f64 = 0.6;
/// A view whose corners fit worse than this all together is none, px.
const FIT_PX: f64 = 0.3;
/// A tag's white rim is an eighth of it, and small tags are of use from this edge on, px.
const EDGE_MIN_PX: f64 = 16.0;

impl Mat {
    /// camera_from_mat by the tags in a picture; `None` where too few are seen.
    #[must_use]
    pub fn in_picture(&self, camera: &Camera, picture: &RgbImage) -> Option<Isometry3<f64>> {
        let options = Options {
            edge_min_px: EDGE_MIN_PX,
            ..Options::default()
        };
        let found = detect(&picture.to_gray(), Some(camera), &options);
        let mut squares: Vec<Square> = found
            .iter()
            .filter_map(|seen| {
                let (_, corners_m) = self.tags.iter().find(|(id, _)| *id == seen.id)?;
                Some((*corners_m, seen.corners_px.map(Into::into)))
            })
            .collect();
        let lens = Lens {
            focal_px: camera.focal_px,
            center_px: camera.center_px,
            size_px: camera.size_px.map(|size| size as f64),
            distortion: camera.distortion,
        };
        loop {
            if squares.len() < LEAST_TAGS {
                return None;
            }
            let seen = *sightings_of(&lens, &squares).first()?;
            let pose = seen.camera_from_body;
            let off = |(corners, pixels): &Square| {
                let each = corners.iter().zip(pixels).map(|(corner, pixel)| {
                    lens.project(&pose.transform(corner))
                        .map_or(f64::INFINITY, |said| {
                            (said.pixel.x - pixel[0]).hypot(said.pixel.y - pixel[1])
                        })
                });
                each.fold(0.0, f64::max)
            };
            let worst = (0..squares.len()).max_by(|a, b| {
                let (a, b) = (off(&squares[*a]), off(&squares[*b]));
                a.total_cmp(&b)
            })?;
            if off(&squares[worst]) > CORNER_PX {
                squares.swap_remove(worst);
                continue;
            }
            let corners = 4.0 * squares.len() as f64;
            if (seen.cost_px2 / corners).sqrt() > FIT_PX {
                return None;
            }
            let turn = Rotation3::from_matrix_unchecked(*pose.rotation.matrix());
            return Some(Isometry3::from_parts(
                Translation3::from(pose.position_m),
                UnitQuaternion::from_rotation_matrix(&turn),
            ));
        }
    }
}
