//! More than one degree of redundancy: Newton's method on the dual problem.

use super::{
    Distribution, TensionLimits, finish, gram, not_finite, singular, times, transposed_times,
    worst_violation,
};
use crate::error::Error;
use crate::linear::{cholesky, cholesky_solve};

/// More than one degree of redundancy.
pub(super) fn dual<const K: usize, const N: usize>(
    a: &[[f64; N]; K],
    load: &[f64; K],
    limits: &TensionLimits<N>,
    target: &[f64; N],
) -> Result<Distribution<N>, Error> {
    if !a
        .iter()
        .flatten()
        .chain(load)
        .chain(target)
        .all(|x| x.is_finite())
    {
        return Err(not_finite());
    }
    if !cholesky(&mut gram(a, &[1.0; N])) {
        return Err(singular());
    }
    let clamp = |i: usize, z: f64| z.max(limits.min_n[i]).min(limits.max_n[i]);
    let mut v = [0.0; K];
    let mut violations = [0.0; N];
    // `soft` is the slope of the tension beyond a limit.
    let mut soft = 1.0;
    // Seven stages: the slope falls from 1 to 0.05^6 = 1.6e-8, nearly a hard limit. A hard limit at
    // once gives a singular Hessian when too many cables are at limits.
    for _ in 0..7 {
        let value = |v: &[f64; K]| -> (f64, [f64; N]) {
            let lift = transposed_times(a, v);
            let z: [f64; N] = core::array::from_fn(|i| target[i] + lift[i]);
            let mut sum = 0.0;
            for i in 0..N {
                let c = clamp(i, z[i]);
                // Integral of clamp + soft (z - clamp).
                sum += c * (z[i] - c) + 0.5 * c * c + 0.5 * soft * (z[i] - c) * (z[i] - c);
            }
            for k in 0..K {
                sum -= load[k] * v[k];
            }
            (sum, z)
        };
        let (mut now, mut z) = value(&v);
        for _ in 0..60 {
            let t: [f64; N] = core::array::from_fn(|i| {
                let c = clamp(i, z[i]);
                c + soft * (z[i] - c)
            });
            let mut d = times(a, &t);
            let mut size = 0.0_f64;
            for k in 0..K {
                d[k] = load[k] - d[k];
                size = size.max(d[k].abs());
            }
            let scale = load.iter().fold(1.0_f64, |s, x| s.max(x.abs()));
            if size <= 1e-12 * scale {
                break;
            }
            let weight: [f64; N] =
                core::array::from_fn(|i| if clamp(i, z[i]) == z[i] { 1.0 } else { soft });
            let mut h = gram(a, &weight);
            if !cholesky(&mut h) {
                break;
            }
            let slope_of = d;
            cholesky_solve(&h, &mut d);
            let slope: f64 = (0..K).map(|k| -slope_of[k] * d[k]).sum();
            let mut step = 1.0;
            let mut moved = false;
            for _ in 0..40 {
                let trial: [f64; K] = core::array::from_fn(|k| v[k] + step * d[k]);
                let (next, next_z) = value(&trial);
                // Sufficient decrease (Armijo, 1966); the last term is the rounding of the value.
                if next <= now + 1e-4 * step * slope + 1e-14 * now.abs() {
                    moved = next < now || step == 1.0;
                    v = trial;
                    now = next;
                    z = next_z;
                    break;
                }
                step *= 0.5;
            }
            if !moved {
                break;
            }
        }
        if let Some(exact) = exact_on_set(a, load, limits, target, &z) {
            return Ok(exact);
        }
        violations = core::array::from_fn(|i| soft * (z[i] - clamp(i, z[i])));
        // The set of cables at their limits was not right yet: harder limits separate them better.
        soft *= 0.05;
    }
    Err(worst_violation(&violations))
}

/// With the cables whose z lies beyond a limit fixed there, the optimum of the others; `None` if
/// that does not balance within the limits, or is not the optimum.
fn exact_on_set<const K: usize, const N: usize>(
    a: &[[f64; N]; K],
    load: &[f64; K],
    limits: &TensionLimits<N>,
    target: &[f64; N],
    z: &[f64; N],
) -> Option<Distribution<N>> {
    let clamp = |i: usize, z: f64| z.max(limits.min_n[i]).min(limits.max_n[i]);
    let free: [f64; N] = core::array::from_fn(|i| f64::from(u8::from(clamp(i, z[i]) == z[i])));
    let mut t: [f64; N] = core::array::from_fn(|i| {
        if free[i] > 0.0 {
            target[i]
        } else {
            clamp(i, z[i])
        }
    });
    let mut h = gram(a, &free);
    let trace: f64 = (0..K).map(|k| gram(a, &[1.0; N])[k][k]).sum();
    for (k, row) in h.iter_mut().enumerate() {
        row[k] += 1e-10 * trace;
    }
    if !cholesky(&mut h) {
        return None;
    }
    let scale = load.iter().fold(1.0_f64, |s, x| s.max(x.abs()));
    let mut multiplier = [0.0; K];
    let mut left = f64::INFINITY;
    // The shift above makes this a refinement; it converges at once unless the set is singular.
    for _ in 0..6 {
        let mut d = times(a, &t);
        for k in 0..K {
            d[k] = load[k] - d[k];
        }
        left = d.iter().fold(0.0, |m: f64, x| m.max(x.abs()));
        if left <= 1e-13 * scale {
            break;
        }
        cholesky_solve(&h, &mut d);
        let lift = transposed_times(a, &d);
        for i in 0..N {
            t[i] += free[i] * lift[i];
        }
        for k in 0..K {
            multiplier[k] += d[k];
        }
    }
    if !(left <= 1e-10 * scale) {
        return None;
    }
    let lift = transposed_times(a, &multiplier);
    for i in 0..N {
        let width = 1e-10 * (limits.max_n[i] + scale);
        if free[i] > 0.0 {
            if (t[i] - clamp(i, t[i])).abs() > width {
                return None;
            }
        } else {
            // A cable at its limit must want to go beyond it.
            let wish = target[i] + lift[i];
            if (clamp(i, wish) - t[i]).abs() > width {
                return None;
            }
        }
    }
    Some(finish(t, limits))
}
