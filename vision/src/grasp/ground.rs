//! The plane on which the objects lie.

use super::NoGrasp;
use crate::align::Aligned;
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, Vector2, Vector3};

/// Share of the distances that the ground must hold.
const GROUND_SHARE: f64 = 0.2;
/// Points closer to a plane than this share of the distance belong to it.
/// 2 mm at half a metre.
const NEAR: f64 = 0.004;
/// Pixels between the points that vote for a plane.
/// Some 11 000 points of 1280 x 720 px.
const VOTE_STEP: usize = 9;
/// Planes that are tried.
const TRIES: usize = 48;

/// The plane that holds most distances. In inverse distance a plane is linear in the directions,
/// 1/z = a x + b y + c, and the noise of a stereo camera is the same everywhere.
pub(super) fn ground(picture: &Aligned) -> Result<Isometry3<f64>, NoGrasp> {
    let [width, height] = picture.camera.size_px;
    let mut points = Vec::new();
    for y in (VOTE_STEP / 2..height).step_by(VOTE_STEP) {
        for x in (VOTE_STEP / 2..width).step_by(VOTE_STEP) {
            if let Some(depth_m) = picture.depth.depth_m(x, y) {
                let pixel = Vector2::new(x as f64 + 0.5, y as f64 + 0.5);
                let ray = picture.camera.direction(&pixel);
                points.push(Vector3::new(ray.x, ray.y, 1.0 / depth_m));
            }
        }
    }
    let near = |plane: &Vector3<f64>, p: &Vector3<f64>| {
        let on = plane.x * p.x + plane.y * p.y + plane.z;
        (on - p.z).abs() < NEAR * p.z
    };
    // The many counts go over single numbers in rows of their own, several at a time.
    #[allow(clippy::cast_possible_truncation)]
    let row = |i: usize| points.iter().map(|p| p[i] as f32).collect::<Vec<f32>>();
    let (xs, ys, inverses) = (row(0), row(1), row(2));
    let votes = |plane: &Vector3<f64>| {
        #[allow(clippy::cast_possible_truncation)]
        let [a, b, c] = [plane.x as f32, plane.y as f32, plane.z as f32];
        #[allow(clippy::cast_possible_truncation)]
        let near = NEAR as f32;
        let all = xs.iter().zip(&ys).zip(&inverses);
        all.map(|((x, y), w)| u32::from((a * x + b * y + c - w).abs() < near * w))
            .sum::<u32>()
    };
    let mut best = (0, Vector3::zeros());
    // A fixed sequence of triples: the same picture gives the same plane.
    let mut state = 0x9E37_79B9_7F4A_7C15_u64;
    let mut draw = || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        let high = usize::try_from(state >> 33).unwrap_or(0);
        high % points.len().max(1)
    };
    // If 60 % of the points lie on the ground, 48 triples miss it in one of 100 000 pictures.
    for _ in 0..TRIES {
        let three = [draw(), draw(), draw()].map(|i| points.get(i).copied().unwrap_or_default());
        if let Some(plane) = through(&three) {
            let count = votes(&plane);
            if count > best.0 {
                best = (count, plane);
            }
        }
    }
    let share = f64::from(best.0) / points.len().max(1) as f64;
    if share < GROUND_SHARE || points.len() < 50 {
        return Err(NoGrasp::NoPlane {
            best: share,
            wanted: GROUND_SHARE,
        });
    }
    let mut plane = best.1;
    for _ in 0..3 {
        let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for p in points.iter().filter(|p| near(&plane, p)) {
            let row = Vector3::new(p.x, p.y, 1.0);
            normal += row * row.transpose();
            right += row * p.z;
        }
        if let Some(inverse) = normal.try_inverse() {
            plane = inverse * right;
        }
    }
    frame_of(&plane).ok_or(NoGrasp::NoPlane {
        best: share,
        wanted: GROUND_SHARE,
    })
}

fn through(three: &[Vector3<f64>; 3]) -> Option<Vector3<f64>> {
    let rows = Matrix3::from_rows(&three.map(|p| Vector3::new(p.x, p.y, 1.0).transpose()));
    // Three points near one line: any plane through the line would fit.
    if rows.determinant().abs() < 1e-4 {
        return None;
    }
    Some(rows.try_inverse()? * Vector3::new(three[0].z, three[1].z, three[2].z))
}

/// camera_from_map of a plane a x + b y + c = 1/z, that is a X + b Y + c Z = 1.
fn frame_of(plane: &Vector3<f64>) -> Option<Isometry3<f64>> {
    // 1/z on the optical axis: a plane further than 1 km, or behind the camera.
    if plane.z < 1e-3 {
        return None;
    }
    let up = -plane / plane.norm();
    let origin = Vector3::new(0.0, 0.0, 1.0 / plane.z);
    let x = (Vector3::x() - up * up.x).normalize();
    let rotation = Matrix3::from_columns(&[x, up.cross(&x), up]);
    Some(Isometry3::from_parts(
        Translation3::from(origin),
        Rotation3::from_matrix_unchecked(rotation).into(),
    ))
}
