//! Printed tags on the tray's floor: the camera's pose relative to the surface that the objects lie
//! on.
//!
//! The platform's pose from lengths and tensions has errors from anchors, centre of mass and
//! pulleys, which differ between the look and the grasp. Relative to the mat both poses are known
//! to tenths of a millimetre, and only the error of the camera's pose on the platform remains.

use crate::calibration::pnp::{Square, sightings_of};
use mcdpr_vision::tag::{Options, detect};
use mcdpr_vision::{Camera, RgbImage};
use nalgebra::{Isometry3, Matrix6, Point3, Vector3, Vector6};

/// A sheet of tags.
#[derive(Debug, Clone, PartialEq)]
pub struct Mat {
    /// Its tags.
    pub tags: Vec<SheetTag>,
}

/// A tag on a sheet.
#[derive(Debug, Clone, PartialEq)]
pub struct SheetTag {
    /// Its number.
    pub id: u32,
    /// Its corners on the sheet, m, in the order of [`crate::robot::Tag`].
    pub corners_m: [Vector3<f64>; 4],
}

/// Fewer tags than this are not used: a covered edge is detected only by comparison with others.
const LEAST_TAGS: usize = 2;
/// Corners that fit worse than this belong to a partly covered tag, px.
const CORNER_PX: f64 = 0.6;
/// A view whose corners fit worse than this all together is not used, px.
const FIT_PX: f64 = 0.3;
/// A tag's white rim is an eighth of it, and small tags are of use from this edge on, px.
const EDGE_MIN_PX: f64 = 16.0;

/// Least standard deviation assumed for corners, px: errors that the scatter in one picture does
/// not show.
const CORNER_SIGMA_MIN_PX: f64 = 0.02;

/// The mat in one picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MatSight {
    /// Its pose.
    pub camera_from_mat: Isometry3<f64>,
    /// Covariance of the origin's shift (m) and of the turn (rad), camera frame.
    covariance: Matrix6<f64>,
}

impl MatSight {
    /// A mat whose pose is known.
    #[cfg(test)]
    pub(super) fn sure(camera_from_mat: Isometry3<f64>) -> Self {
        Self {
            camera_from_mat,
            covariance: Matrix6::zeros(),
        }
    }

    /// One standard deviation of the position error of a point of the mat's frame (m) in the
    /// camera's, or vice versa, m.
    #[must_use]
    pub fn error_m(&self, point_in_mat_m: &Vector3<f64>) -> f64 {
        let arm = self.camera_from_mat.rotation * point_in_mat_m;
        let shift = self.covariance.fixed_view::<3, 3>(0, 0);
        let turn = self.covariance.fixed_view::<3, 3>(3, 3);
        let both = self.covariance.fixed_view::<3, 3>(0, 3);
        // The point moves by the shift and by turn x arm.
        let by_turn = -arm.cross_matrix();
        let moved = shift
            + both * by_turn.transpose()
            + by_turn * both.transpose()
            + by_turn * turn * by_turn.transpose();
        moved.trace().max(0.0).sqrt()
    }

    /// The distance along the camera's axis to the mat's plane, m.
    #[must_use]
    pub(crate) fn ahead_m(&self) -> f64 {
        let up = self.camera_from_mat.rotation * Vector3::z();
        up.dot(&self.camera_from_mat.translation.vector) / up.z
    }
}

impl Mat {
    /// The mat from the tags in a picture; `None` if too few are seen.
    #[must_use]
    pub(crate) fn in_picture(&self, camera: &Camera, picture: &RgbImage) -> Option<MatSight> {
        let options = Options {
            edge_min_px: EDGE_MIN_PX,
            ..Options::default()
        };
        let found = detect(&picture.to_gray(), Some(camera), &options);
        let mut squares: Vec<Square> = found
            .iter()
            .filter_map(|seen| {
                let tag = self.tags.iter().find(|tag| tag.id == seen.id)?;
                Some(Square {
                    corners_in_body_m: tag.corners_m,
                    corners_px: seen.corners_px.map(Into::into),
                })
            })
            .collect();
        loop {
            if squares.len() < LEAST_TAGS {
                return None;
            }
            let seen = *sightings_of(camera, &squares).first()?;
            let pose = seen.camera_from_body;
            let off = |square: &Square| {
                let corners = square.corners_in_body_m.iter().zip(&square.corners_px);
                let each = corners.map(|(corner, pixel)| {
                    camera
                        .projection(&pose.transform(corner).into())
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
            // One bad tag moves the pose of all: the worst is removed, and the rest fitted again.
            if off(&squares[worst]) > CORNER_PX {
                squares.swap_remove(worst);
                continue;
            }
            let corners = 4.0 * squares.len() as f64;
            if (seen.cost_px2 / corners).sqrt() > FIT_PX {
                return None;
            }
            let camera_from_mat = Isometry3::from(pose);
            let points = squares.iter().flat_map(|square| &square.corners_in_body_m);
            let covariance = covariance(camera, &camera_from_mat, points, seen.cost_px2)?;
            return Some(MatSight {
                camera_from_mat,
                covariance,
            });
        }
    }
}

/// Covariance of a pose from corners on a body (m) whose squared residuals sum up to `cost_px2`: the
/// inverse of the normal matrix times the variance of a coordinate.
fn covariance<'a>(
    camera: &Camera,
    camera_from_body: &Isometry3<f64>,
    points_m: impl Iterator<Item = &'a Vector3<f64>>,
    cost_px2: f64,
) -> Option<Matrix6<f64>> {
    let (mut normal, mut rows) = (Matrix6::zeros(), 0.0);
    for point in points_m {
        let arm = camera_from_body.rotation * point;
        let at = camera_from_body * Point3::from(*point);
        let by_point = camera.projection(&at)?.by_point;
        for k in 0..2 {
            let by_shift = by_point.row(k).transpose();
            // A turn about the mat's origin moves a point by turn x arm.
            let by_turn = arm.cross(&by_shift);
            let row = Vector6::new(
                by_shift.x, by_shift.y, by_shift.z, by_turn.x, by_turn.y, by_turn.z,
            );
            normal += row * row.transpose();
            rows += 1.0;
        }
    }
    // Six coordinates of the residuals are taken up by the pose.
    let variance_px2 = (cost_px2 / f64::max(rows - 6.0, 1.0)).max(CORNER_SIGMA_MIN_PX.powi(2));
    normal.try_inverse().map(|inverse| inverse * variance_px2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn more_tags_and_a_nearer_camera_make_a_point_surer() {
        let camera = Camera {
            size_px: [640, 480],
            focal_px: [600.0; 2],
            center_px: [320.0, 240.0],
            distortion: [0.0; 5],
        };
        let sight = |tags: usize, away_m: f64| {
            let corners: Vec<Vector3<f64>> = (0..tags)
                .flat_map(|k| {
                    let x = 0.02 * k as f64;
                    [[0.0, 0.0], [0.016, 0.0], [0.016, 0.016], [0.0, 0.016]]
                        .map(|[i, j]| Vector3::new(x + i, j, 0.0))
                })
                .collect();
            let camera_from_mat = Isometry3::new(
                Vector3::new(0.0, 0.0, away_m),
                Vector3::new(std::f64::consts::PI - 0.1, 0.0, 0.0),
            );
            // Residuals of 0.1 px each.
            let cost_px2 = 0.01 * (8 * tags - 6) as f64;
            let covariance = covariance(&camera, &camera_from_mat, corners.iter(), cost_px2);
            MatSight {
                camera_from_mat,
                covariance: covariance.unwrap(),
            }
        };
        let middle = Vector3::new(0.05, 0.008, 0.0);
        let (few, many, near) = (sight(2, 0.4), sight(6, 0.4), sight(6, 0.2));
        assert!(many.error_m(&middle) < 0.5 * few.error_m(&middle));
        assert!(near.error_m(&middle) < 0.5 * many.error_m(&middle));
        // A tenth of a pixel at 0.4 m is 0.07 mm in one corner's coordinate.
        assert!((1e-5..5e-4).contains(&many.error_m(&middle)));
        // Beside the visible part, a turn has an effect.
        assert!(many.error_m(&Vector3::new(0.05, 0.3, 0.0)) > 2.0 * many.error_m(&middle));
        assert!((many.ahead_m() - 0.4).abs() < 1e-9);
    }
}
