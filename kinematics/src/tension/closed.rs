//! One degree of redundancy: the balanced tensions are a line.

use super::{Distribution, TensionLimits, gram, not_finite, singular, times, transposed_times};
use crate::cable_vec::CableSet;
use crate::error::{Bound, Error};
use crate::linear::{cholesky, cholesky_solve};

/// The closed form for three equations and four cables by Cramer's rule, with the fourth tension as
/// the parameter of the line. `None` leaves ill-conditioned and infeasible cases, and bad input, to
/// [`closed_form`].
#[inline(always)]
pub(super) fn three_forces<const K: usize, const N: usize>(
    a: &[[f64; N]; K],
    load: &[f64; K],
    limits: &TensionLimits<N>,
    target: &[f64; N],
) -> Option<Distribution<N>> {
    let (a, load): (&[[f64; N]; 3], &[f64; 3]) =
        (a[..].try_into().ok()?, load[..].try_into().ok()?);
    let target: &[f64; 4] = target[..].try_into().ok()?;
    let min: &[f64; 4] = limits.min_n[..].try_into().ok()?;
    let max: &[f64; 4] = limits.max_n[..].try_into().ok()?;
    let c = |i: usize| [a[0][i % N], a[1][i % N], a[2][i % N]];
    let cross = |p: [f64; 3], q: [f64; 3]| {
        [
            p[1] * q[2] - p[2] * q[1],
            p[2] * q[0] - p[0] * q[2],
            p[0] * q[1] - p[1] * q[0],
        ]
    };
    let dot = |p: [f64; 3], q: [f64; 3]| p[0] * q[0] + p[1] * q[1] + p[2] * q[2];
    let crosses = [cross(c(1), c(2)), cross(c(2), c(0)), cross(c(0), c(1))];
    let det = dot(c(2), crosses[2]);
    let inv = 1.0 / det;
    let (mut base, mut slope) = ([0.0; 4], [1.0; 4]);
    for i in 0..3 {
        base[i] = dot(*load, crosses[i]) * inv;
        slope[i] = -dot(c(3), crosses[i]) * inv;
    }
    let (mut top, mut bottom, mut steepest) = (0.0, 0.0, 0.0);
    for i in 0..4 {
        top += (target[i] - base[i]) * slope[i];
        bottom += slope[i] * slope[i];
        steepest = if slope[i].abs() > steepest {
            slope[i].abs()
        } else {
            steepest
        };
    }
    let best = top / bottom;
    let (mut low, mut high) = (min[3], max[3]);
    for i in 0..3 {
        // A flat cable (slope 0) bounds nothing: the offset gives huge ends instead of 0 times
        // infinity.
        let inv = 1.0 / (slope[i] + 1e-280);
        let (p, q) = ((min[i] - base[i]) * inv, (max[i] - base[i]) * inv);
        let (p, q) = if p < q { (p, q) } else { (q, p) };
        low = if p > low { p } else { low };
        high = if q < high { q } else { high };
    }
    let s = if best < low { low } else { best };
    let s = if s > high { high } else { s };
    let mut out = Distribution {
        tensions_n: [0.0; N],
        at_limit: CableSet::default(),
    };
    // NaN and crossed or negative limits fail one of these; so does a nearly flat set of cables.
    let mut valid = (low <= high) & (steepest < 20.0) & best.is_finite();
    for i in 0..4 {
        let t = base[i] + s * slope[i];
        // Rounding must not carry a tension past its limit.
        let t = if t < min[i] { min[i] } else { t };
        out.tensions_n[i % N] = if t > max[i] { max[i] } else { t };
        valid &= (0.0 <= min[i]) & (min[i] <= max[i]) & (max[i] < f64::INFINITY);
    }
    if !valid {
        return None;
    }
    if s != best {
        for i in 0..4 {
            let (t, lo, hi) = (out.tensions_n[i % N], min[i], max[i]);
            if t - lo <= 1e-12 * hi || hi - t <= 1e-12 * hi {
                out.at_limit.insert(i);
            }
        }
    }
    Some(out)
}

#[inline(always)]
pub(super) fn closed_form<const K: usize, const N: usize>(
    a: &[[f64; N]; K],
    load: &[f64; K],
    limits: &TensionLimits<N>,
    target: &[f64; N],
) -> Result<Distribution<N>, Error> {
    let mut factor = gram(a, &[1.0; N]);
    if !cholesky(&mut factor) {
        return Err(if a.iter().flatten().all(|x| x.is_finite()) {
            singular()
        } else {
            not_finite()
        });
    }
    let mut v = times(a, target);
    for k in 0..K {
        v[k] = load[k] - v[k];
    }
    cholesky_solve(&factor, &mut v);
    let correction = transposed_times(a, &v);
    let null = null_vector(a, &factor);
    // T(s) = base + s null, s = 0 being nearest to the target.
    let mut base = [0.0; N];
    let (mut low, mut high) = (f64::NEG_INFINITY, f64::INFINITY);
    let mut crossed = false;
    for i in 0..N {
        base[i] = target[i] + correction[i];
        // The offset avoids 0 / 0; it is far below the rounding of any other entry.
        let inverse = 1.0 / (null[i] + 1e-280);
        let (p, q) = (
            (limits.min_n[i] - base[i]) * inverse,
            (limits.max_n[i] - base[i]) * inverse,
        );
        low = low.max(p.min(q));
        high = high.min(p.max(q));
        crossed |= !((0.0 <= limits.min_n[i])
            & (limits.min_n[i] <= limits.max_n[i])
            & (limits.max_n[i] < f64::INFINITY));
    }
    // The nearest point of the interval to the target: no search is needed on a line.
    let s = 0.0_f64.max(low).min(high);
    let mut out = Distribution {
        tensions_n: [0.0; N],
        at_limit: CableSet::default(),
    };
    let mut total = 0.0;
    for i in 0..N {
        let t = base[i] + s * null[i];
        total += t;
        out.tensions_n[i] = t.max(limits.min_n[i]).min(limits.max_n[i]);
    }
    if crossed | !(low <= high) | !total.is_finite() {
        return Err(closed_form_error(&base, &null, limits));
    }
    if s != 0.0 {
        for i in 0..N {
            let (t, lo, hi) = (out.tensions_n[i], limits.min_n[i], limits.max_n[i]);
            let near = 1e-12 * hi;
            if t - lo <= near || hi - t <= near {
                out.at_limit.insert(i);
            }
        }
    }
    Ok(out)
}

/// Unit-free direction of the (one-dimensional) null space.
#[inline(always)]
fn null_vector<const K: usize, const N: usize>(
    a: &[[f64; N]; K],
    factor: &[[f64; K]; K],
) -> [f64; N] {
    if K == 3 && N == 4 {
        // Signed minors.
        let c = |i: usize| [a[0][i % N], a[1 % K][i % N], a[2 % K][i % N]];
        let cross = |p: [f64; 3], q: [f64; 3]| {
            [
                p[1] * q[2] - p[2] * q[1],
                p[2] * q[0] - p[0] * q[2],
                p[0] * q[1] - p[1] * q[0],
            ]
        };
        let dot = |p: [f64; 3], q: [f64; 3]| p[0] * q[0] + p[1] * q[1] + p[2] * q[2];
        let (c01, c23) = (cross(c(0), c(1)), cross(c(2), c(3)));
        let minors = [
            dot(c(1), c23),
            -dot(c(0), c23),
            dot(c(3), c01),
            -dot(c(2), c01),
        ];
        return core::array::from_fn(|i| minors[i % 4]);
    }
    // The projector on the null space is n n^T: the column of its largest diagonal entry.
    let mut best = (0.0, 0);
    for i in 0..N {
        let column: [f64; K] = core::array::from_fn(|k| a[k][i]);
        let mut solved = column;
        cholesky_solve(factor, &mut solved);
        let inside: f64 = (0..K).map(|k| column[k] * solved[k]).sum();
        if 1.0 - inside > best.0 {
            best = (1.0 - inside, i);
        }
    }
    let mut v: [f64; K] = core::array::from_fn(|k| a[k][best.1]);
    cholesky_solve(factor, &mut v);
    let mut n = transposed_times(a, &v).map(|x| -x);
    n[best.1] += 1.0;
    n
}

#[cold]
fn closed_form_error<const N: usize>(
    base: &[f64; N],
    null: &[f64; N],
    limits: &TensionLimits<N>,
) -> Error {
    if let Err(error) = limits.check() {
        return error;
    }
    if !base.iter().chain(null).all(|x| x.is_finite()) {
        return not_finite();
    }
    // The two cables whose intervals along the line do not meet.
    let first = |at| End { at, cable: 0 };
    let (mut low, mut high) = (first(f64::NEG_INFINITY), first(f64::INFINITY));
    for cable in 0..N {
        let inverse = 1.0 / (null[cable] + 1e-280);
        let p = (limits.min_n[cable] - base[cable]) * inverse;
        let q = (limits.max_n[cable] - base[cable]) * inverse;
        let (p, q) = (p.min(q), p.max(q));
        if p > low.at {
            low = End { at: p, cable };
        }
        if q < high.at {
            high = End { at: q, cable };
        }
    }
    let worst = limiting(low, high, null);
    Error::OutsideTensionLimits {
        cable: worst.cable + 1,
        // Cable `low` wants a larger s: its tension is then too small if it grows with s.
        bound: if worst.toward * null[worst.cable] > 0.0 {
            Bound::Minimum
        } else {
            Bound::Maximum
        },
        violation_n: worst.violation_n,
    }
}

/// An end of a cable's interval along the null vector.
#[derive(Clone, Copy)]
pub(crate) struct End {
    pub(crate) at: f64,
    pub(crate) cable: usize,
}

/// The cable that keeps tensions from their limits.
pub(crate) struct Limiting {
    pub(crate) cable: usize,
    /// +1 if it needs to go up along the null vector, -1 if down.
    pub(crate) toward: f64,
    /// N.
    pub(crate) violation_n: f64,
}

/// Of the two cables with incompatible limits (ends of their intervals along `null`), the one with
/// the larger violation at their least-squares compromise.
#[inline(always)]
pub(crate) fn limiting<const N: usize>(low: End, high: End, null: &[f64; N]) -> Limiting {
    let gap = low.at - high.at;
    let (p, q) = (null[low.cable].abs(), null[high.cable].abs());
    // Both violations share the gap so that the sum of their squares is least.
    let shared = p * q * gap / (p * p + q * q).max(f64::MIN_POSITIVE);
    let (cable, toward, size) = if q > p {
        (low.cable, 1.0, q)
    } else {
        (high.cable, -1.0, p)
    };
    Limiting {
        cable,
        toward,
        violation_n: shared * size,
    }
}
