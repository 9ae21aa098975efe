//! The pose of a body of tags in the camera's frame, from its corners in one picture: a homography
//! of the largest tag as a start (and its mirror image, the second minimum of a small planar
//! target; Schweighofer and Pinz, 2006), then Gauss-Newton over all corners.

use super::data::{Data, Observation, View};
use mcdpr_kinematics::{Attempt, Damping, Pose, descend};
use mcdpr_vision::Camera;
use nalgebra::{Matrix3, Rotation3, SMatrix, SVector, Unit, Vector2, Vector3, Vector6};

/// A body's pose seen by the camera, best first, with its sum of squared residuals.
#[derive(Debug, Clone, Copy)]
pub struct Sighting {
    /// camera_from_body.
    pub camera_from_body: Pose,
    /// Sum of squared corner residuals, px^2.
    pub cost_px2: f64,
}

/// A square tag in a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Square {
    /// Its corners on the body that carries it, m.
    pub corners_in_body_m: [Vector3<f64>; 4],
    /// Where they appear, px.
    pub corners_px: [[f64; 2]; 4],
}

/// The candidates (one or two, best first) for a body's pose in one picture. Empty if the body is
/// not in view or the corners are invalid.
#[must_use]
pub(crate) fn sightings(data: &Data, pose: &Observation, body: usize) -> Vec<Sighting> {
    let on_body = |view: &&View| data.tags.get(view.tag).is_some_and(|tag| tag.body == body);
    let squares: Vec<Square> = (pose.views.iter().filter(on_body))
        .map(|view| Square {
            corners_in_body_m: data.tags[view.tag].corners_in_body_m,
            corners_px: view.corners_px,
        })
        .collect();
    sightings_of(&data.camera, &squares)
}

/// The candidates (one or two, best first) for the pose of the body that carries these tags. Empty
/// without tags, or if the corners are invalid.
#[must_use]
pub fn sightings_of(camera: &Camera, squares: &[Square]) -> Vec<Sighting> {
    let largest = squares.iter().max_by(|a, b| area(a).total_cmp(&area(b)));
    let Some(largest) = largest else {
        return Vec::new();
    };
    let Some(start) = from_square(camera, largest) else {
        return Vec::new();
    };
    let points: Vec<_> = (squares.iter())
        .flat_map(|square| square.corners_in_body_m.into_iter().zip(square.corners_px))
        .collect();
    let corners = &largest.corners_in_body_m;
    let center = corners.iter().sum::<Vector3<f64>>() / 4.0;
    let normal = (corners[1] - corners[0]).cross(&(corners[3] - corners[0]));
    let mut found: Vec<Sighting> = [start, mirrored(&start, &center, &normal)]
        .iter()
        .filter_map(|start| refined(camera, &points, start))
        .collect();
    found.sort_by(|a, b| a.cost_px2.total_cmp(&b.cost_px2));
    // Both starts have ended in the same minimum.
    if let [a, b] = found.as_slice()
        && angle(&a.camera_from_body.rotation, &b.camera_from_body.rotation) < 1e-4
    {
        found.pop();
    }
    found
}

fn area(square: &Square) -> f64 {
    let [a, b, c, d] = &square.corners_px;
    ((c[0] - a[0]) * (d[1] - b[1]) - (d[0] - b[0]) * (c[1] - a[1])).abs()
}

/// The pose of the body from one tag's four corners.
fn from_square(camera: &Camera, square: &Square) -> Option<Pose> {
    let (corners, pixels) = (&square.corners_in_body_m, &square.corners_px);
    let size_m = (corners[1] - corners[0]).norm();
    let x = (corners[1] - corners[0]).normalize();
    let normal = x.cross(&(corners[3] - corners[0])).normalize();
    let body_from_tag = Matrix3::from_columns(&[x, normal.cross(&x), normal]);
    let center = corners.iter().sum::<Vector3<f64>>() / 4.0;
    let mut seen = [[0.0; 2]; 4];
    for (slot, pixel) in seen.iter_mut().zip(pixels) {
        let q = camera.direction(&Vector2::from(*pixel));
        *slot = [q.x, q.y];
    }
    let mut h = square_to(&seen)?;
    if h[(2, 2)] < 0.0 {
        h = -h;
    }
    let scale = (h.column(0).norm() * h.column(1).norm()).sqrt();
    if scale.is_nan() || scale <= 1e-12 {
        return None;
    }
    h /= scale;
    let (r1, r2) = (h.column(0).into_owned(), h.column(1).into_owned());
    let rotation = nearest_rotation(&Matrix3::from_columns(&[r1, r2, r1.cross(&r2)]))?;
    let rotation = rotation * Rotation3::from_matrix_unchecked(body_from_tag).inverse();
    let at = h.column(2).into_owned() * size_m;
    Some(Pose::new(at - rotation * center, rotation))
}

/// Angle between two rotations, rad. Computed from sine and cosine: the arc cosine of the trace is
/// NaN if rounding lifts it over 1.
#[must_use]
pub fn angle(a: &Rotation3<f64>, b: &Rotation3<f64>) -> f64 {
    let turn = a.matrix().tr_mul(b.matrix());
    let twice_sin = Vector3::new(
        turn[(2, 1)] - turn[(1, 2)],
        turn[(0, 2)] - turn[(2, 0)],
        turn[(1, 0)] - turn[(0, 1)],
    );
    twice_sin.norm().atan2(turn.trace() - 1.0)
}

/// The homography that takes the square of side 1 about the origin, its corners in the order of a
/// tag's, to four points (Heckbert, 1989, section 2.2.3). `None` where three lie on a line.
fn square_to([p0, p1, p2, p3]: &[[f64; 2]; 4]) -> Option<Matrix3<f64>> {
    let [dx1, dy1] = [p1[0] - p2[0], p1[1] - p2[1]];
    let [dx2, dy2] = [p3[0] - p2[0], p3[1] - p2[1]];
    let [sx, sy] = [0, 1].map(|k| p0[k] - p1[k] + p2[k] - p3[k]);
    let area = dx1 * dy2 - dx2 * dy1;
    let (g, h) = ((sx * dy2 - dx2 * sy) / area, (dx1 * sy - sx * dy1) / area);
    let column = |p: &[f64; 2], w: f64| [0, 1].map(|k| p[k] - p0[k] + w * p[k]);
    let (u, v) = (column(p1, g), column(p3, h));
    // From corner (0, 0) to the middle.
    let at = [0, 1].map(|k| p0[k] + (u[k] + v[k]) / 2.0);
    let out = Matrix3::new(
        u[0],
        v[0],
        at[0],
        u[1],
        v[1],
        at[1],
        g,
        h,
        1.0 + (g + h) / 2.0,
    );
    out.iter().all(|x| x.is_finite()).then_some(out)
}

/// The rotation nearest to a matrix (Frobenius norm).
pub(crate) fn nearest_rotation(m: &Matrix3<f64>) -> Option<Rotation3<f64>> {
    if m.iter().any(|x| !x.is_finite()) {
        return None;
    }
    let svd = m.svd(true, true);
    let (mut u, v_t) = (svd.u?, svd.v_t?);
    if (u * v_t).determinant() < 0.0 {
        // A reflection: turning its weakest direction over changes the matrix least.
        let last = svd.singular_values.imin();
        let flipped = -u.column(last).into_owned();
        u.set_column(last, &flipped);
    }
    Some(Rotation3::from_matrix_unchecked(u * v_t))
}

/// The pose whose plane is mirrored about the line of sight: it looks nearly the same.
fn mirrored(pose: &Pose, center: &Vector3<f64>, normal: &Vector3<f64>) -> Pose {
    let at = pose.transform(center);
    let pi = std::f64::consts::PI;
    let about_sight = Rotation3::from_axis_angle(&Unit::new_normalize(at), pi);
    let about_normal = Rotation3::from_axis_angle(&Unit::new_normalize(*normal), pi);
    let rotation = about_sight * pose.rotation * about_normal;
    Pose::new(at - rotation * center, rotation)
}

/// Damping relative to the diagonal.
const DAMPING: Damping = Damping {
    start: 1e-6,
    least: 1e-12,
    most: 1e6,
    after_success: 0.1,
    after_failure: 10.0,
    steps: 40,
};

/// Levenberg-Marquardt over the pose.
fn refined(camera: &Camera, points: &[(Vector3<f64>, [f64; 2])], start: &Pose) -> Option<Sighting> {
    let evaluate = |pose: &Pose| {
        let mut h = SMatrix::<f64, 6, 6>::zeros();
        let mut g = SVector::<f64, 6>::zeros();
        let mut cost = 0.0;
        for (point, pixel) in points {
            let arm = pose.rotation * point;
            let seen = camera.projection(&(pose.position_m + arm).into())?;
            for (k, measured) in pixel.iter().enumerate() {
                let residual = seen.pixel[k] - measured;
                let d = seen.by_point.row(k).transpose();
                let m = arm.cross(&d);
                let row = Vector6::new(d.x, d.y, d.z, m.x, m.y, m.z);
                cost += residual * residual;
                g += row * residual;
                h += row * row.transpose();
            }
        }
        Some((cost, g, h))
    };
    let found = descend(*start, evaluate(start)?, &DAMPING, |pose, now, damping| {
        let (cost, g, h) = now;
        let mut damped = *h;
        for k in 0..6 {
            damped[(k, k)] *= 1.0 + damping;
        }
        let step = damped.cholesky()?.solve(&-g);
        let trial = pose.displaced(
            &step.fixed_rows::<3>(0).into_owned(),
            &step.fixed_rows::<3>(3).into_owned(),
        );
        if damping < 1e-5 && -g.dot(&step) <= 1e-9 * cost + 1e-12 {
            // The gain is below the rounding of the cost.
            return Some(Attempt::Unseen(trial));
        }
        Some(match evaluate(&trial) {
            Some(next) if next.0 <= *cost => {
                if cost - next.0 <= 1e-12 * cost + 1e-14 {
                    Attempt::Last(trial, next)
                } else {
                    Attempt::Better(trial, next)
                }
            }
            _ => Attempt::Worse,
        })
    })?;
    Some(Sighting {
        camera_from_body: found.at,
        cost_px2: found.linear.0,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_angle_of_rotations_that_are_nearly_equal_is_a_number() {
        for k in 0..2000 {
            let f = f64::from(k);
            let a = Rotation3::from_euler_angles(0.1 + 0.013 * f, 0.3 + 0.007 * f, -0.02 * f);
            for off in [0.0, 1e-9, 0.5] {
                let b = Rotation3::from_euler_angles(0.0, off, 0.0) * a;
                assert!((angle(&a, &b) - off).abs() < 1e-14, "{k} {off}");
            }
        }
    }

    #[test]
    fn a_square_goes_to_any_four_points() {
        let points = [[0.1, 0.2], [0.5, 0.25], [0.47, 0.61], [0.05, 0.7]];
        let h = square_to(&points).unwrap();
        let square = [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]];
        for ([x, y], [u, v]) in square.iter().zip(points) {
            let p = h * Vector3::new(*x, *y, 1.0);
            assert!((p.x / p.z - u).abs() < 1e-14 && (p.y / p.z - v).abs() < 1e-14);
        }
        assert!(square_to(&[[0.0, 0.0], [1.0, 1.0], [2.0, 2.0], [3.0, 3.0]]).is_none());
    }
}
