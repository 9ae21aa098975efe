//! Distances between cables, and between cables and the platform's body.
//!
//! Cables are the straight segments from the tangent point to the attachment.

use nalgebra::Vector3;

use crate::error::Error;
use crate::inverse::CablePath;
use crate::pose::Pose;
use crate::robot::Robot;

/// The platform's body as a box along the platform's axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlatformBox {
    /// Centre, platform frame, m.
    pub center_m: Vector3<f64>,
    /// Half of the edges, m.
    pub half_size_m: Vector3<f64>,
}

/// The two cables that come closest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CablePair {
    /// Cable numbers, from 1, ascending.
    pub cables: [usize; 2],
    /// Distance between their centre lines, m.
    pub distance_m: f64,
}

/// The cable that comes closest to the platform's body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CableToPlatform {
    /// Cable number, from 1.
    pub cable: usize,
    /// Distance from its centre line to the box, m; zero inside.
    pub distance_m: f64,
}

impl<const N: usize> Robot<N> {
    /// The closest pair of cables at a pose; `None` if there is no pair to compare. Pairs that share
    /// an anchor or an attachment (within 1 um) touch by design and are left out.
    ///
    /// # Errors
    /// As [`Robot::inverse`].
    pub fn closest_cables(&self, pose: &Pose) -> Result<Option<CablePair>, Error> {
        let paths = self.paths(pose)?;
        let mut best: Option<CablePair> = None;
        for i in 0..N {
            for j in i + 1..N {
                let (a, b) = (&self.cables()[i], &self.cables()[j]);
                if (a.anchor_m - b.anchor_m).norm() < 1e-6
                    || (a.attachment_m - b.attachment_m).norm() < 1e-6
                {
                    continue;
                }
                let distance_m = segment_distance(&ends(&paths[i]), &ends(&paths[j]));
                if best.is_none_or(|b| distance_m < b.distance_m) {
                    best = Some(CablePair {
                        cables: [i + 1, j + 1],
                        distance_m,
                    });
                }
            }
        }
        Ok(best)
    }

    /// The cable closest to the platform's box at a pose. The last `stub_m` of each cable before its
    /// attachment is left out, because it touches the platform by design.
    ///
    /// # Errors
    /// [`Error::InvalidInput`] for a box or stub that is not finite or negative; as
    /// [`Robot::inverse`].
    pub fn closest_to_platform(
        &self,
        pose: &Pose,
        body: &PlatformBox,
        stub_m: f64,
    ) -> Result<CableToPlatform, Error> {
        let smallest = body.half_size_m.min().min(stub_m);
        let sum = body.half_size_m.sum() + body.center_m.sum() + stub_m;
        if !(smallest >= 0.0 && sum.is_finite()) {
            return Err(Error::InvalidInput {
                what: "the platform's box and the stub must be finite, not negative",
                cable: None,
                value: smallest,
            });
        }
        let paths = self.paths(pose)?;
        let mut best = CableToPlatform {
            cable: 1,
            distance_m: f64::INFINITY,
        };
        for (i, path) in paths.iter().enumerate() {
            let [from, to] = ends(path);
            let free = (to - from).norm();
            // A cable shorter than the stub is reduced to a point.
            let to = to - path.direction * stub_m.min(free);
            let local = |p: &Vector3<f64>| {
                pose.rotation
                    .inverse_transform_vector(&(p - pose.position_m))
                    - body.center_m
            };
            let distance_m = segment_box_distance(&local(&from), &local(&to), &body.half_size_m);
            if distance_m < best.distance_m {
                best = CableToPlatform {
                    cable: i + 1,
                    distance_m,
                };
            }
        }
        Ok(best)
    }
}

fn ends(path: &CablePath) -> [Vector3<f64>; 2] {
    [path.tangent_point_m, path.attachment_m]
}

/// Shortest distance between two segments (units of the points). Source: Eberly, 2001 (clamped
/// minimisation of the quadratic distance).
pub(crate) fn segment_distance(a: &[Vector3<f64>; 2], b: &[Vector3<f64>; 2]) -> f64 {
    let (u, v, w) = (a[1] - a[0], b[1] - b[0], a[0] - b[0]);
    let (uu, uv, vv) = (u.norm_squared(), u.dot(&v), v.norm_squared());
    let (uw, vw) = (u.dot(&w), v.dot(&w));
    let along = |s: f64, t: f64| (w + u * s - v * t).norm();
    // A segment without length gives 0 / 0: any of its points is its end.
    let unit = |x: f64| {
        if x.is_finite() {
            x.clamp(0.0, 1.0)
        } else {
            0.0
        }
    };
    let det = uu * vv - uv * uv;
    // If the lines are not parallel, the inner minimum is one candidate; the others are each end of
    // a segment against the best point of the other.
    let mut best = f64::INFINITY;
    if det > 1e-14 * uu * vv {
        let (s, t) = ((uv * vw - vv * uw) / det, (uu * vw - uv * uw) / det);
        if (0.0..=1.0).contains(&s) && (0.0..=1.0).contains(&t) {
            best = along(s, t);
        }
    }
    for end in [0.0, 1.0] {
        best = best.min(along(end, unit((vw + uv * end) / vv)));
        best = best.min(along(unit((uv * end - uw) / uu), end));
    }
    best
}

/// Distance from a segment to a box about the origin: the distance of a point is convex along the
/// segment, so golden-section search finds its minimum.
fn segment_box_distance(from: &Vector3<f64>, to: &Vector3<f64>, half: &Vector3<f64>) -> f64 {
    let at = |s: f64| {
        let p = from + (to - from) * s;
        Vector3::from_fn(|k, _| (p[k].abs() - half[k]).max(0.0)).norm()
    };
    const RATIO: f64 = 0.618_033_988_749_894_9;
    let (mut low, mut high) = (0.0, 1.0);
    let (mut a, mut b) = (high - RATIO, RATIO);
    let (mut fa, mut fb) = (at(a), at(b));
    // 0.618^80 = 2e-17: the interval is then below rounding.
    for _ in 0..80 {
        if fa <= fb {
            (high, b, fb) = (b, a, fa);
            a = high - RATIO * (high - low);
            fa = at(a);
        } else {
            (low, a, fa) = (a, b, fb);
            b = low + RATIO * (high - low);
            fb = at(b);
        }
    }
    fa.min(fb).min(at(0.0)).min(at(1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn segments_agree_with_a_dense_search() {
        let mut seed = 7_u64;
        let mut next = || {
            seed = seed
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            (seed >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
        };
        for _ in 0..50 {
            let mut point = || Vector3::new(next(), next(), next());
            let (a, b) = ([point(), point()], [point(), point()]);
            let got = segment_distance(&a, &b);
            let mut want = f64::INFINITY;
            for i in 0..=300 {
                for j in 0..=300 {
                    let (s, t) = (f64::from(i) / 300.0, f64::from(j) / 300.0);
                    let d = a[0] + (a[1] - a[0]) * s - b[0] - (b[1] - b[0]) * t;
                    want = want.min(d.norm());
                }
            }
            assert!(got <= want + 1e-12 && want - got < 6e-3, "{got} {want}");
        }
    }

    #[test]
    fn parallel_and_degenerate_segments_have_a_distance() {
        let o = Vector3::zeros();
        let x = Vector3::x();
        let up = Vector3::z() * 0.3;
        assert!((segment_distance(&[o, x], &[up, up + x]) - 0.3).abs() < 1e-15);
        assert!((segment_distance(&[o, x], &[x * 3.0, x * 4.0]) - 2.0).abs() < 1e-15);
        assert!((segment_distance(&[o, o], &[up, up]) - 0.3).abs() < 1e-15);
    }

    #[test]
    fn the_box_distance_is_exact_for_simple_cases() {
        let half = Vector3::new(1.0, 1.0, 1.0);
        let d = segment_box_distance(
            &Vector3::new(3.0, -5.0, 0.0),
            &Vector3::new(3.0, 5.0, 0.0),
            &half,
        );
        assert!((d - 2.0).abs() < 1e-12);
        // Through a corner region: the nearest point is the edge (1, 1).
        let d = segment_box_distance(
            &Vector3::new(4.0, 0.0, 0.0),
            &Vector3::new(0.0, 4.0, 0.0),
            &half,
        );
        assert!((d - core::f64::consts::SQRT_2).abs() < 1e-9, "{d}");
        let d = segment_box_distance(
            &Vector3::new(-4.0, 0.1, 0.0),
            &Vector3::new(4.0, 0.0, 0.2),
            &half,
        );
        assert_eq!(d, 0.0);
    }
}
