//! Two degrees of redundancy: the balanced tensions are a plane, and the limits cut a polygon out of it.
//!
//! With an orthonormal basis of the null space of A the distance from the goal is that in the plane from the
//! foot of the perpendicular, up to a constant. The nearest point of an intersection of half-planes is found one
//! half-plane after the other (Seidel, 1991): while the point so far satisfies the next one it stays, else it lies on
//! that one's border, which is a problem on a line.

use super::blocks::Normal;
use super::{Distribution, NEAR, TensionLimits, finish, times, transposed_times};
use crate::cable_vec::CableSet;
use crate::math::sqrt;

/// A border counts as parallel to a half-plane below this sine.
const PARALLEL: f64 = 1e-12;
/// Part of a cable's unit vector in the null space below which it gives no direction of its own.
const NOTHING: f64 = 1e-9;
/// A tension beyond a limit by less than this share of the limits' range is rounding.
const ROUNDING: f64 = 1e-12;

/// The optimum; `None` if there is none within the limits, or the matrix is nearly singular: [`super::dual`] tells which.
#[inline]
pub(super) fn pair<const K: usize, const N: usize>(
    a: &[[f64; N]; K],
    load: &[f64; K],
    limits: &TensionLimits<N>,
    target: &[f64; N],
) -> Option<Distribution<N>> {
    let normal = Normal::new(a)?;
    // The foot: target + A^T (A A^T)^-1 (load - A target).
    let mut v = times(a, target);
    for k in 0..K {
        v[k] = load[k] - v[k];
    }
    normal.solve(&mut v);
    let lift = transposed_times(a, &v);
    let foot: [f64; N] = core::array::from_fn(|i| target[i] + lift[i]);
    // Mostly all are well inside, which takes no branch for each.
    let (mut inside, mut clear) = (true, true);
    for i in 0..N {
        let (low, high) = (limits.min_n[i], limits.max_n[i]);
        let (above, below, near) = (foot[i] - low, high - foot[i], NEAR * high);
        inside &= (above >= 0.0) & (below >= 0.0);
        clear &= (above > near) & (below > near);
    }
    if clear {
        return Some(Distribution {
            tensions_n: foot,
            at_limit: CableSet::default(),
        });
    }
    if inside {
        return Some(finish(foot, limits));
    }
    let basis = null_space(a, &normal)?;
    let at = nearest(&basis, &foot, limits)?;
    let t: [f64; N] = core::array::from_fn(|i| foot[i] + basis[0][i] * at[0] + basis[1][i] * at[1]);
    let held = |i: usize| {
        let most = ROUNDING * (limits.max_n[i] - limits.min_n[i]);
        t[i] >= limits.min_n[i] - most && t[i] <= limits.max_n[i] + most
    };
    (0..N).all(held).then(|| finish(t, limits))
}

/// Two orthonormal vectors with A n = 0, from A A^T.
fn null_space<const K: usize, const N: usize>(
    a: &[[f64; N]; K],
    normal: &Normal<K>,
) -> Option<[[f64; N]; 2]> {
    // The part of a vector in the null space, and again: the first time leaves the rounding of A A^T.
    let project = |x: &[f64; N]| -> [f64; N] {
        let mut out = *x;
        for _ in 0..2 {
            let mut v = times(a, &out);
            normal.solve(&mut v);
            let lift = transposed_times(a, &v);
            for i in 0..N {
                out[i] -= lift[i];
            }
        }
        out
    };
    let unit = |x: [f64; N]| -> Option<[f64; N]> {
        let size = sqrt(x.iter().map(|x| x * x).sum());
        (size > NOTHING).then(|| x.map(|x| x / size))
    };
    let mut found: [[f64; N]; 2] = [[0.0; N]; 2];
    let mut count = 0;
    for first in 0..N {
        let mut e = [0.0; N];
        e[first] = 1.0;
        let mut x = project(&e);
        // The second without the part along the first.
        if count == 1 {
            let along: f64 = (0..N).map(|i| x[i] * found[0][i]).sum();
            for i in 0..N {
                x[i] -= along * found[0][i];
            }
        }
        // A small part would be mostly rounding.
        let size: f64 = x.iter().map(|x| x * x).sum();
        if size < 0.02 {
            continue;
        }
        found[count] = unit(x)?;
        count += 1;
        if count == 2 {
            return Some(found);
        }
    }
    None
}

/// The point nearest to zero at which every tension `foot + basis x` is within its limits; `None` if there is none.
fn nearest<const N: usize>(
    basis: &[[f64; N]; 2],
    foot: &[f64; N],
    limits: &TensionLimits<N>,
) -> Option<[f64; 2]> {
    // Half-plane h: g.x <= b; the first N from above, the others from below.
    let half = |h: usize| -> ([f64; 2], f64) {
        let i = h % N;
        if h < N {
            ([basis[0][i], basis[1][i]], limits.max_n[i] - foot[i])
        } else {
            ([-basis[0][i], -basis[1][i]], foot[i] - limits.min_n[i])
        }
    };
    let mut x = [0.0, 0.0];
    for h in 0..2 * N {
        let (g, b) = half(h);
        let size2 = g[0] * g[0] + g[1] * g[1];
        if g[0] * x[0] + g[1] * x[1] <= b {
            continue;
        }
        if size2 < NOTHING * NOTHING {
            // This cable's tension is given: no point of the plane helps.
            return None;
        }
        // The border, from its point nearest to zero along its direction.
        let near = [g[0] * b / size2, g[1] * b / size2];
        let along = [-g[1], g[0]];
        let (mut low, mut high) = (f64::NEG_INFINITY, f64::INFINITY);
        for earlier in 0..h {
            let (g, b) = half(earlier);
            let slope = g[0] * along[0] + g[1] * along[1];
            let room = b - (g[0] * near[0] + g[1] * near[1]);
            if slope > PARALLEL {
                high = high.min(room / slope);
            } else if slope < -PARALLEL {
                low = low.max(room / slope);
            } else if room < 0.0 {
                return None;
            }
        }
        if low > high {
            return None;
        }
        let s = 0.0_f64.max(low).min(high);
        x = [near[0] + s * along[0], near[1] + s * along[1]];
    }
    Some(x)
}

#[cfg(test)]
mod tests {
    use super::super::dual;
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn the_closed_form_is_the_dual_methods_optimum() {
        let mut random = ChaCha8Rng::seed_from_u64(2);
        let (mut inside, mut at_limits) = (0, 0);
        for _ in 0..3000 {
            let a: [[f64; 8]; 6] =
                core::array::from_fn(|_| core::array::from_fn(|_| random.random_range(-1.0..1.0)));
            let limits = TensionLimits::uniform(1.0, 10.0);
            let target: [f64; 8] = core::array::from_fn(|_| random.random_range(0.0..12.0));
            // Some tensions within the limits, so that there is an answer.
            let some: [f64; 8] = core::array::from_fn(|_| random.random_range(1.0..10.0));
            let load = times(&a, &some);
            let Some(ours) = pair(&a, &load, &limits, &target) else {
                panic!("no tensions, but {some:?} are some");
            };
            let theirs = dual(&a, &load, &limits, &target).unwrap();
            for (x, y) in ours.tensions_n.iter().zip(&theirs.tensions_n) {
                assert!((x - y).abs() < 1e-6, "{ours:?} {theirs:?}");
            }
            let got = times(&a, &ours.tensions_n);
            assert!(got.iter().zip(&load).all(|(x, y)| (x - y).abs() < 1e-9));
            if ours.at_limit.is_empty() {
                inside += 1;
            } else {
                at_limits += 1;
            }
        }
        assert!(inside > 100 && at_limits > 1000, "{inside} {at_limits}");
    }

    #[test]
    fn where_no_tensions_are_within_the_limits_there_is_none() {
        let a = [[1.0, 1.0, 1.0]];
        let limits = TensionLimits::uniform(1.0, 2.0);
        assert!(pair(&a, &[7.0], &limits, &[1.5; 3]).is_none());
        assert!(pair(&a, &[f64::NAN], &limits, &[1.5; 3]).is_none());
        assert!(pair(&[[0.0; 3]], &[1.0], &limits, &[1.5; 3]).is_none());
        let found = pair(&a, &[5.5], &limits, &[1.0, 1.0, 2.0]).unwrap();
        assert_eq!(
            found.tensions_n.map(|t| (t * 1e6).round()),
            [1.75e6, 1.75e6, 2e6]
        );
    }
}
