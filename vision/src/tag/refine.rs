//! Positions of a quadrangle's edges, to hundredths of a pixel.
//!
//! Across an edge the grey values rise from black to white over a few pixels, depending on the
//! blur. The edge is where a sharp step would let the same light through: for profile I over [-r,
//! r] and plateaus B, W it is at r - integral (I - B) / (W - B). For a symmetric blur this has no
//! bias, and needs no gradient. Lines are fitted through these points, in the undistorted picture
//! if the camera is known; corners are where lines cross.

use crate::camera::Camera;
use crate::image::GrayImage;
use nalgebra::{Matrix2, Point3, Vector2};

/// Refined corners in the order of the rough ones.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Refined {
    pub corners_px: [Vector2<f64>; 4],
    pub covariance_px2: [Matrix2<f64>; 4],
}

/// Parts of an edge near corners are not measured: the other edge blurs into them.
/// 7 px at each end of an edge of 100 px.
const MARGIN: f64 = 0.07;
/// Least plausible spread of edge positions, px: the error of interpolation between pixels.
const SCATTER_FLOOR_PX: f64 = 0.02;
/// Profiles are sampled this often, px.
const STEP_PX: f64 = 0.25;

/// Places of one edge and the line through them.
struct Line {
    /// A point of the line and its direction.
    middle: Vector2<f64>,
    along: Vector2<f64>,
    /// Variance of the offset at the middle, px^2, and of the slope.
    variance: f64,
    slope_variance: f64,
}

impl Line {
    /// Variance of the line's offset near a point, px^2.
    fn variance_at(&self, point: &Vector2<f64>) -> f64 {
        let way = (point - self.middle).dot(&self.along);
        self.variance + self.slope_variance * way * way
    }
}

/// Measures the four edges. `None` if one cannot be found.
pub(super) fn refine(
    picture: &GrayImage,
    camera: Option<&Camera>,
    rough_px: &[Vector2<f64>; 4],
) -> Option<Refined> {
    let lens = camera.filter(|camera| camera.distortion != [0.0; 5]);
    let mut corners_px = *rough_px;
    let mut covariance_px2 = [Matrix2::zeros(); 4];
    for pass in 0..3 {
        let mut lines = Vec::with_capacity(4);
        for i in 0..4 {
            // The rough outline can be off by a pixel or two: search further at first.
            let reach_px = if pass == 0 { 4.0 } else { 2.5 };
            let (from, to) = (corners_px[i], corners_px[(i + 1) % 4]);
            let places = places(picture, &from, &to, reach_px)?;
            let flat: Vec<_> = places.iter().map(|place| flatten(lens, place)).collect();
            lines.push(fit(&flat)?);
        }
        for i in 0..4 {
            let (before, after) = (&lines[(i + 3) % 4], &lines[i]);
            let (corner, covariance) = crossing(before, after)?;
            corners_px[i] = unflatten(lens, &corner)?;
            covariance_px2[i] = covariance;
        }
    }
    let moved = corners_px.iter().zip(rough_px);
    let far = moved.map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
    // The outline is off by a pixel or two: 6 px away lies another edge.
    (far < 6.0).then_some(Refined {
        corners_px,
        covariance_px2,
    })
}

/// Maps a pixel to its position with an ideal lens.
fn flatten(lens: Option<&Camera>, pixel: &Vector2<f64>) -> Vector2<f64> {
    let Some(camera) = lens else { return *pixel };
    let direction = camera.direction(pixel);
    let [fx, fy] = camera.focal_px;
    Vector2::new(direction.x * fx, direction.y * fy)
}

fn unflatten(lens: Option<&Camera>, flat: &Vector2<f64>) -> Option<Vector2<f64>> {
    let Some(camera) = lens else {
        return Some(*flat);
    };
    let [fx, fy] = camera.focal_px;
    camera.project(&Point3::new(flat.x / fx, flat.y / fy, 1.0))
}

/// Places of the edge from dark (right of the way from `from` to `to` on the screen, the inside of
/// a clockwise quadrangle) to bright.
fn places(
    picture: &GrayImage,
    from: &Vector2<f64>,
    to: &Vector2<f64>,
    reach_px: f64,
) -> Option<Vec<Vector2<f64>>> {
    let length = (to - from).norm();
    let along = (to - from) / length;
    let outward = Vector2::new(along.y, -along.x);
    // Half a cell on either side contains only black frame and white rim.
    let reach = reach_px.min(0.45 * length / 8.0).max(1.0);
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    let steps = (2.0 * reach / STEP_PX).round() as usize;
    let step = 2.0 * reach / steps as f64;
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    let count = (length * (1.0 - 2.0 * MARGIN)).clamp(8.0, 160.0) as usize;
    let mut profiles = Vec::with_capacity(count);
    let (mut black, mut white) = (0.0, 0.0);
    for k in 0..count {
        let share = MARGIN + (1.0 - 2.0 * MARGIN) * (k as f64 + 0.5) / count as f64;
        let foot = from + along * (share * length);
        let sample = |t: f64| {
            let p = foot + outward * t;
            picture.sample(p.x, p.y)
        };
        let sum: f64 = (0..steps)
            .map(|j| sample(-reach + (j as f64 + 0.5) * step))
            .sum();
        black += sample(-reach) + sample(-reach - 0.5);
        white += sample(reach) + sample(reach + 0.5);
        profiles.push((foot, sum * step));
    }
    let samples = 2.0 * count as f64;
    let (black, white) = (black / samples, white / samples);
    // The edge's place is divided by this contrast: below ten grey values it is mostly noise.
    if white - black < 10.0 {
        return None;
    }
    let places = profiles.into_iter().map(|(foot, light)| {
        let bright = (light - 2.0 * reach * black) / (white - black);
        foot + outward * (reach - bright).clamp(-reach, reach)
    });
    Some(places.collect())
}

/// Least squares line with outliers weighed down (Huber, 1964).
fn fit(points: &[Vector2<f64>]) -> Option<Line> {
    let mut weights = vec![1.0; points.len()];
    let mut line = None;
    for _ in 0..3 {
        let total: f64 = weights.iter().sum();
        let weighted = points.iter().zip(&weights);
        let middle = weighted.clone().map(|(p, w)| p * *w).sum::<Vector2<f64>>() / total;
        let spread: Matrix2<f64> = weighted
            .map(|(p, w)| (p - middle) * (p - middle).transpose() * *w)
            .sum();
        let (xx, xy, yy) = (spread[(0, 0)], spread[(0, 1)], spread[(1, 1)]);
        let angle = 0.5 * (2.0 * xy).atan2(xx - yy);
        let along = Vector2::new(angle.cos(), angle.sin());
        let across = Vector2::new(-along.y, along.x);
        let off = |p: &Vector2<f64>| (p - middle).dot(&across);
        let mut sizes: Vec<f64> = points.iter().map(|p| off(p).abs()).collect();
        sizes.sort_by(f64::total_cmp);
        // Median to standard deviation of a normal distribution.
        let scatter = (1.4826 * sizes.get(sizes.len() / 2)?).max(SCATTER_FLOOR_PX);
        for (weight, p) in weights.iter_mut().zip(points) {
            let size = off(p).abs() / (1.5 * scatter);
            *weight = if size <= 1.0 { 1.0 } else { 1.0 / size };
        }
        let lengthwise = along.dot(&(spread * along));
        if !(lengthwise > 0.0 && lengthwise.is_finite()) {
            return None;
        }
        line = Some(Line {
            middle,
            along,
            variance: scatter * scatter / total,
            slope_variance: scatter * scatter / lengthwise,
        });
    }
    line
}

fn crossing(a: &Line, b: &Line) -> Option<(Vector2<f64>, Matrix2<f64>)> {
    let normal = |line: &Line| Vector2::new(-line.along.y, line.along.x);
    let (na, nb) = (normal(a), normal(b));
    let rows = Matrix2::new(na.x, na.y, nb.x, nb.y);
    let inverse = rows.try_inverse()?;
    let corner = inverse * Vector2::new(na.dot(&a.middle), nb.dot(&b.middle));
    let offsets = Matrix2::from_diagonal(&Vector2::new(
        a.variance_at(&corner),
        b.variance_at(&corner),
    ));
    let covariance = inverse * offsets * inverse.transpose();
    corner
        .iter()
        .all(|value| value.is_finite())
        .then_some((corner, covariance))
}
