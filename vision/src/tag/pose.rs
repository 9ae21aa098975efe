//! The pose of a tag, or of a body with several, in the camera's frame.
//!
//! A square seen in perspective nearly fits two attitudes, mirrored about the line of sight
//! (Schweighofer and Pinz, 2006). Noise alone can decide between them when the tag is small or far.
//! So both are searched, each to its own minimum, and both are returned, the better one first.

use super::Detection;
use crate::camera::Camera;
use mcdpr_kinematics::{Attempt, Damping, descend};
use nalgebra::{
    Isometry3, Matrix2, Matrix3, Point3, Rotation3, SMatrix, SVector, Translation3, Unit,
    UnitQuaternion, Vector2, Vector3,
};
use thiserror::Error;

/// A body's place seen by a camera.
#[derive(Debug, Clone, PartialEq)]
pub struct TagPose {
    /// camera_from_tag, m.
    pub camera_from_tag: Isometry3<f64>,
    /// Covariance of a small rotation vector (camera frame, rad) and of the translation (m), in
    /// this order.
    pub covariance: SMatrix<f64, 6, 6>,
    /// Sum of squared corner residuals in units of their covariance.
    pub cost: f64,
    /// Root mean square of the corner residuals, px.
    pub residual_px: f64,
}

/// Why there is no pose.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum PoseError {
    /// Fewer than four points.
    #[error("a pose needs at least four corners, got {got}")]
    TooFew {
        /// How many there were.
        got: usize,
    },
    /// The tag was not found.
    #[error("tag {id} is not wholly in the picture with its white rim; tags seen: {seen}")]
    NotSeen {
        /// The tag wanted.
        id: u32,
        /// The tags found, as text.
        seen: String,
    },
    /// The numbers do not fit any pose in front of the camera.
    #[error("the corners fit no pose in front of the camera")]
    NoFit,
}

/// The candidates for a tag's pose, best first: one or two.
///
/// # Errors
/// [`PoseError::NotSeen`] if `detections` lack the tag, [`PoseError::NoFit`].
pub fn pose_of_tag(
    camera: &Camera,
    detections: &[Detection],
    id: u32,
    size_m: f64,
) -> Result<Vec<TagPose>, PoseError> {
    let Some(tag) = detections.iter().find(|tag| tag.id == id) else {
        let ids: Vec<_> = detections.iter().map(|tag| tag.id.to_string()).collect();
        let seen = if ids.is_empty() {
            "none".to_owned()
        } else {
            ids.join(", ")
        };
        return Err(PoseError::NotSeen { id, seen });
    };
    let s = size_m / 2.0;
    let corners = [(-s, -s), (s, -s), (s, s), (-s, s)].map(|(x, y)| Point3::new(x, y, 0.0));
    pose_of_points(camera, &corners, &tag.corners_px, &tag.covariance_px2)
}

/// The candidates for the pose of a planar body from points of it (body frame with all z alike, m;
/// at least four, no three on a line) and where they appear, best first.
///
/// # Errors
/// [`PoseError::TooFew`], [`PoseError::NoFit`].
pub(crate) fn pose_of_points(
    camera: &Camera,
    points_m: &[Point3<f64>],
    pixels: &[Vector2<f64>],
    covariance_px2: &[Matrix2<f64>],
) -> Result<Vec<TagPose>, PoseError> {
    let got = points_m.len().min(pixels.len()).min(covariance_px2.len());
    if got < 4 {
        return Err(PoseError::TooFew { got });
    }
    let rows: Vec<Row> = points_m
        .iter()
        .zip(pixels)
        .zip(covariance_px2)
        .map(|((point, pixel), covariance)| {
            // A singular covariance, as of a perfect simulated corner, counts as 1 px.
            let weight = covariance.try_inverse().unwrap_or_else(Matrix2::identity);
            Row {
                point: *point,
                pixel: *pixel,
                weight,
            }
        })
        .collect();
    let start = from_homography(camera, &rows).ok_or(PoseError::NoFit)?;
    let first = polish(camera, &rows, start).ok_or(PoseError::NoFit)?;
    let twin = mirrored(&first.camera_from_tag);
    let mut found = vec![first];
    if let Some(second) = twin.and_then(|start| polish(camera, &rows, start)) {
        let apart = found[0]
            .camera_from_tag
            .rotation
            .angle_to(&second.camera_from_tag.rotation);
        // Within 1 mrad both starts have reached the same minimum.
        if apart > 1e-3 {
            found.push(second);
        }
    }
    found.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    Ok(found)
}

struct Row {
    point: Point3<f64>,
    pixel: Vector2<f64>,
    weight: Matrix2<f64>,
}

/// The same pose with the plane's normal mirrored about the line of sight.
fn mirrored(pose: &Isometry3<f64>) -> Option<Isometry3<f64>> {
    let sight = Unit::try_new(pose.translation.vector, 1e-9)?;
    let normal = pose.rotation * Vector3::z();
    let other = sight.into_inner() * (2.0 * sight.dot(&normal)) - normal;
    let turn = UnitQuaternion::rotation_between(&normal, &other)?;
    Some(Isometry3::from_parts(
        pose.translation,
        turn * pose.rotation,
    ))
}

fn from_homography(camera: &Camera, rows: &[Row]) -> Option<Isometry3<f64>> {
    let z = rows[0].point.z;
    // Coordinates of the order of one: the entries of the homography are then comparable (Hartley,
    // 1997).
    let scale = rows
        .iter()
        .map(|r| r.point.coords.norm())
        .fold(1e-9, f64::max);
    let mut normal = SMatrix::<f64, 9, 9>::zeros();
    for row in rows {
        let d = camera.direction(&row.pixel);
        let (x, y) = (row.point.x / scale, row.point.y / scale);
        let a = SVector::<f64, 9>::from_row_slice(&[
            x,
            y,
            1.0,
            0.0,
            0.0,
            0.0,
            -d.x * x,
            -d.x * y,
            -d.x,
        ]);
        let b = SVector::<f64, 9>::from_row_slice(&[
            0.0,
            0.0,
            0.0,
            x,
            y,
            1.0,
            -d.y * x,
            -d.y * y,
            -d.y,
        ]);
        normal += a * a.transpose() + b * b.transpose();
    }
    let eigen = normal.symmetric_eigen();
    let least = eigen.eigenvalues.imin();
    let h = eigen.eigenvectors.column(least);
    let whole = Matrix3::new(h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], h[8]);
    let (x, y) = (whole.column(0) / scale, whole.column(1) / scale);
    let size = (x.norm() * y.norm()).sqrt();
    if size.is_nan() || size < 1e-12 {
        return None;
    }
    // The plane lies in front of the camera.
    let size = if whole[(2, 2)] < 0.0 { -size } else { size };
    let (x, y, t) = (x / size, y / size, whole.column(2) / size);
    let rough = Matrix3::from_columns(&[x, y, x.cross(&y)]);
    // Noise makes the columns oblique: the nearest rotation in the least-squares sense.
    let svd = rough.svd(true, true);
    let mut rotation = svd.u? * svd.v_t?;
    if rotation.determinant() < 0.0 {
        rotation = -rotation;
    }
    let rotation = Rotation3::from_matrix_unchecked(rotation);
    let t = t - rotation * Vector3::new(0.0, 0.0, z);
    (t.z > 0.0).then(|| Isometry3::from_parts(Translation3::from(t), rotation.into()))
}

const DAMPING: Damping = Damping {
    start: 1e-4,
    least: 1e-12,
    most: 1e8,
    after_success: 0.2,
    after_failure: 8.0,
    steps: 60,
};

/// The nearest minimum of the weighted squares, with its covariance.
fn polish(camera: &Camera, rows: &[Row], start: Isometry3<f64>) -> Option<TagPose> {
    let linear = linearise(camera, rows, &start)?;
    let found = descend(start, linear, &DAMPING, |pose, linear, damping| {
        let mut left = linear.normal;
        for i in 0..6 {
            left[(i, i)] *= 1.0 + damping;
        }
        let step = left.cholesky()?.solve(&linear.right);
        let moved = moved(pose, &step);
        Some(match linearise(camera, rows, &moved) {
            Some(next) if next.cost <= linear.cost => {
                let gained = linear.cost - next.cost;
                if step.norm() < 1e-12 || gained < 1e-14 * next.cost {
                    Attempt::Last(moved, next)
                } else {
                    Attempt::Better(moved, next)
                }
            }
            _ => Attempt::Worse,
        })
    })?;
    let pose = found.at;
    let squares: f64 = rows
        .iter()
        .filter_map(|row| Some((row.pixel - camera.project(&(pose * row.point))?).norm_squared()))
        .sum();
    Some(TagPose {
        camera_from_tag: pose,
        covariance: found.linear.normal.try_inverse()?,
        cost: found.linear.cost,
        residual_px: (squares / rows.len() as f64).sqrt(),
    })
}

fn moved(pose: &Isometry3<f64>, step: &SVector<f64, 6>) -> Isometry3<f64> {
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(step[0], step[1], step[2]));
    let shift = Vector3::new(step[3], step[4], step[5]);
    Isometry3::from_parts(
        Translation3::from(pose.translation.vector + shift),
        turn * pose.rotation,
    )
}

/// Normal equations of a step at a pose.
struct Linear {
    normal: SMatrix<f64, 6, 6>,
    right: SVector<f64, 6>,
    /// Sum of the weighted squares.
    cost: f64,
}

fn linearise(camera: &Camera, rows: &[Row], pose: &Isometry3<f64>) -> Option<Linear> {
    let mut out = Linear {
        normal: SMatrix::zeros(),
        right: SVector::zeros(),
        cost: 0.0,
    };
    for row in rows {
        let seen = camera.projection(&(pose * row.point))?;
        let slope = seen.by_point;
        let arm = pose.rotation * row.point.coords;
        let mut by = SMatrix::<f64, 2, 6>::zeros();
        by.fixed_columns_mut::<3>(0)
            .copy_from(&(-slope * arm.cross_matrix()));
        by.fixed_columns_mut::<3>(3).copy_from(&slope);
        let off = row.pixel - seen.pixel;
        out.normal += by.transpose() * row.weight * by;
        out.right += by.transpose() * row.weight * off;
        out.cost += off.dot(&(row.weight * off));
    }
    out.cost.is_finite().then_some(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> Camera {
        Camera {
            size_px: [1280, 720],
            focal_px: [920.0; 2],
            center_px: [640.0, 360.0],
            distortion: [0.03, -0.01, 0.0005, -0.0003, 0.0],
        }
    }

    fn seen(pose: &Isometry3<f64>, size_m: f64) -> Vec<Detection> {
        let s = size_m / 2.0;
        let corners = [(-s, -s), (s, -s), (s, s), (-s, s)];
        let corners_px = corners.map(|(x, y)| camera().project(&(pose * Point3::new(x, y, 0.0))));
        vec![Detection {
            id: 3,
            errors: 0,
            corners_px: corners_px.map(|corner| corner.unwrap()),
            covariance_px2: [Matrix2::identity() * 0.01; 4],
            contrast: 200.0,
        }]
    }

    #[test]
    fn exact_corners_give_the_exact_pose_and_a_worse_twin() {
        let turn = UnitQuaternion::from_euler_angles(0.4, -0.3, 1.1);
        let pose = Isometry3::from_parts(Translation3::new(0.05, -0.04, 0.6), turn);
        let found = pose_of_tag(&camera(), &seen(&pose, 0.1), 3, 0.1).unwrap();
        assert!(found[0].cost < 1e-12, "{}", found[0].cost);
        assert!(found[0].camera_from_tag.rotation.angle_to(&turn) < 1e-8);
        let off = found[0].camera_from_tag.translation.vector - pose.translation.vector;
        assert!(off.norm() < 1e-9);
        assert_eq!(found.len(), 2);
        assert!(found[1].cost > 1.0, "{}", found[1].cost);
    }

    #[test]
    fn the_covariance_is_that_of_scattered_poses() {
        // A change of one corner by its standard deviation moves the pose as the covariance says:
        // the sum over all eight coordinates of the outer products is the covariance.
        let turn = UnitQuaternion::from_euler_angles(2.9, 0.2, 0.5);
        let pose = Isometry3::from_parts(Translation3::new(-0.05, 0.02, 0.5), turn);
        let exact = seen(&pose, 0.1);
        let found = pose_of_tag(&camera(), &exact, 3, 0.1).unwrap();
        let mut sum = SMatrix::<f64, 6, 6>::zeros();
        for corner in 0..4 {
            for axis in 0..2 {
                let mut shifted = exact.clone();
                shifted[0].corners_px[corner][axis] += 0.001;
                let moved = &pose_of_tag(&camera(), &shifted, 3, 0.1).unwrap()[0].camera_from_tag;
                let turn = (moved.rotation * found[0].camera_from_tag.rotation.inverse())
                    .scaled_axis()
                    * 100.0;
                let shift = (moved.translation.vector
                    - found[0].camera_from_tag.translation.vector)
                    * 100.0;
                let d = SVector::<f64, 6>::from_row_slice(&[
                    turn.x, turn.y, turn.z, shift.x, shift.y, shift.z,
                ]);
                sum += d * d.transpose();
            }
        }
        for i in 0..6 {
            let (reported, seen) = (found[0].covariance[(i, i)], sum[(i, i)]);
            assert!(
                (reported / seen - 1.0).abs() < 0.02,
                "{i}: {reported} {seen}"
            );
        }
    }

    #[test]
    fn a_missing_tag_is_reported_with_those_seen() {
        let pose = Isometry3::translation(0.0, 0.0, 0.5);
        let error = pose_of_tag(&camera(), &seen(&pose, 0.1), 7, 0.1).unwrap_err();
        assert_eq!(
            error.to_string(),
            "tag 7 is not wholly in the picture with its white rim; tags seen: 3"
        );
        assert_eq!(
            pose_of_points(&camera(), &[], &[], &[]).unwrap_err(),
            PoseError::TooFew { got: 0 }
        );
    }
}
