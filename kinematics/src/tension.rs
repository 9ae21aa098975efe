//! Tension distribution: tensions within limits that balance a load.
//!
//! The structure matrix A has the column `-[t_i; u_i x t_i]` for cable i: tensions T exert the
//! wrench A T on the platform, and equilibrium under an external wrench w is A T + w = 0.
//! The optimum is the balanced distribution nearest (least squares) to a target. One degree of
//! redundancy has a closed form: the balanced tensions are a line, cut by the limits to an
//! interval. For more, the dual problem min_v sum psi_i(target_i + (A^T v)_i) - b.v is piecewise
//! quadratic and is solved by Newton's method with a line search, the limits being hardened in
//! stages; the final set of cables at their limits is then solved exactly. (The problem statement
//! follows Pott, 2018; the dual Newton method is that of Li and Swetits, 1997.)

use nalgebra::{SMatrix, Vector3, Vector6};

use crate::cable_vec::CableSet;
use crate::error::{Bound, Error, Solver};
use crate::inverse::Inverse;
use crate::linear::{cholesky, cholesky_solve};
use crate::math::sqrt;
use crate::pose::Pose;
use crate::robot::Robot;

/// Allowed tensions, per cable, N.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TensionLimits<const N: usize> {
    /// Smallest allowed tension of each cable.
    pub min_n: [f64; N],
    /// Largest allowed tension of each cable.
    pub max_n: [f64; N],
}

impl<const N: usize> TensionLimits<N> {
    /// The same limits for all cables.
    pub fn uniform(min_n: f64, max_n: f64) -> Self {
        Self {
            min_n: [min_n; N],
            max_n: [max_n; N],
        }
    }

    /// Refuses limits that are not finite, negative, or crossed.
    ///
    /// # Errors
    /// [`Error::InvalidInput`] naming the cable.
    pub fn check(&self) -> Result<(), Error> {
        for i in 0..N {
            let (lo, hi) = (self.min_n[i], self.max_n[i]);
            if !(lo >= 0.0 && lo <= hi && hi.is_finite()) {
                return Err(Error::InvalidInput {
                    what: "tension limits must be 0 <= minimum <= maximum",
                    cable: Some(i + 1),
                    value: if lo >= 0.0 { hi } else { lo },
                });
            }
        }
        Ok(())
    }
}

/// Which of the balanced distributions is wanted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Goal<const N: usize> {
    /// Nearest (least squares) to the middle of the limits.
    Middle,
    /// Smallest sum of squares.
    MinimumNorm,
    /// Nearest (least squares) to these tensions, N.
    NearestTo([f64; N]),
}

impl<const N: usize> Goal<N> {
    #[inline(always)]
    fn target(&self, limits: &TensionLimits<N>) -> [f64; N] {
        match self {
            Goal::Middle => core::array::from_fn(|i| 0.5 * (limits.min_n[i] + limits.max_n[i])),
            Goal::MinimumNorm => [0.0; N],
            Goal::NearestTo(t) => *t,
        }
    }
}

/// A balanced distribution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Distribution<const N: usize> {
    /// Tension of each cable, N, within its limits.
    pub tensions_n: [f64; N],
    /// Cables at one of their limits.
    pub at_limit: CableSet,
}

impl<const N: usize> Inverse<N> {
    /// The structure matrix, 6 x N: column i is `-[t_i; u_i x t_i]`, the wrench (N, N m, world,
    /// about the platform's origin) of a unit tension in cable i. It is minus the transpose of the
    /// twist Jacobian.
    pub fn structure_matrix(&self) -> SMatrix<f64, 6, N> {
        -self.twist_jacobian().transpose()
    }

    /// Rows of the structure matrix as arrays: what [`distribute`] reads.
    #[inline(always)]
    pub(crate) fn structure_rows(&self) -> [[f64; N]; 6] {
        let (t, u) = (&self.directions, &self.arms_m);
        let mut a = [[0.0; N]; 6];
        for i in 0..N {
            a[0][i] = -t[0][i];
            a[1][i] = -t[1][i];
            a[2][i] = -t[2][i];
            a[3][i] = u[2][i] * t[1][i] - u[1][i] * t[2][i];
            a[4][i] = u[0][i] * t[2][i] - u[2][i] * t[0][i];
            a[5][i] = u[1][i] * t[0][i] - u[0][i] * t[1][i];
        }
        a
    }
}

impl<const N: usize> Robot<N> {
    /// The wrench of gravity on the platform, `[force, moment]` (N, N m, world, about its origin).
    pub fn gravity_wrench(&self, pose: &Pose) -> Vector6<f64> {
        let f = Vector3::z() * -self.weight_n();
        let m = (pose.rotation * self.platform().center_of_mass_m).cross(&f);
        Vector6::new(f.x, f.y, f.z, m.x, m.y, m.z)
    }

    /// Tensions that balance gravity and an external wrench (`[force, moment]`, N and N m, world,
    /// about the platform's origin) at a pose, all six equations.
    ///
    /// # Errors
    /// As [`distribute`], and domain errors of [`Robot::inverse`].
    pub fn distribute(
        &self,
        pose: &Pose,
        external_wrench: &Vector6<f64>,
        limits: &TensionLimits<N>,
        goal: &Goal<N>,
    ) -> Result<Distribution<N>, Error> {
        let a = self.inverse(pose)?.structure_rows();
        let load = -(self.gravity_wrench(pose) + external_wrench);
        distribute(&a, &load.into(), limits, goal)
    }

    /// Tensions that balance the forces alone (gravity and an external force, N, world), as in the
    /// paper's model of a platform that is held level: moments are ignored.
    ///
    /// # Errors
    /// As [`distribute`], and domain errors of [`Robot::inverse`].
    pub fn distribute_forces(
        &self,
        pose: &Pose,
        external_force_n: &Vector3<f64>,
        limits: &TensionLimits<N>,
        goal: &Goal<N>,
    ) -> Result<Distribution<N>, Error> {
        let t = self.inverse(pose)?.directions;
        let a = t.map(|row| row.map(|x| -x));
        let f = external_force_n;
        distribute(&a, &[-f.x, -f.y, self.weight_n() - f.z], limits, goal)
    }
}

/// Tensions within limits with A T = `load`, nearest to the goal.
///
/// Shape: A is `K` x `N` (K equations, N cables), any scale. Exact optimum for N = K + 1 by closed
/// form, for N > K + 1 by the dual method of the module's text; for N <= K the balanced tensions
/// are unique, if there are any.
///
/// # Errors
/// [`Error::InvalidInput`]; [`Error::Singular`] if the rows of A are dependent (N > K) or its
/// columns are (N <= K); [`Error::WrenchNotBalanced`] if N <= K cables cannot produce the load;
/// [`Error::OutsideTensionLimits`] naming the cable that is worst off when the limits are exceeded
/// as little as possible (least squares; for N = K + 1 between the two cables that leave no room).
///
/// ```
/// use mcdpr_kinematics::{Goal, TensionLimits, distribute};
/// // Two cables pull up, one down: T1 + T2 - T3 = 10.
/// let t = distribute(
///     &[[1.0, 1.0, -1.0]],
///     &[10.0],
///     &TensionLimits::uniform(1.0, 20.0),
///     &Goal::MinimumNorm,
/// )?;
/// assert!((t.tensions_n[0] - 5.5).abs() < 1e-12 && (t.tensions_n[2] - 1.0).abs() < 1e-12);
/// # Ok::<(), mcdpr_kinematics::Error>(())
/// ```
#[inline]
pub fn distribute<const K: usize, const N: usize>(
    a: &[[f64; N]; K],
    load: &[f64; K],
    limits: &TensionLimits<N>,
    goal: &Goal<N>,
) -> Result<Distribution<N>, Error> {
    let target = goal.target(limits);
    if N == K + 1 {
        closed_form(a, load, limits, &target)
    } else if N > K {
        limits.check()?;
        dual(a, load, limits, &target)
    } else {
        limits.check()?;
        unique(a, load, limits)
    }
}

fn not_finite() -> Error {
    Error::InvalidInput {
        what: "matrix, load and target of a tension distribution must be finite",
        cable: None,
        value: f64::NAN,
    }
}

fn singular() -> Error {
    Error::Singular {
        solver: Solver::TensionDistribution,
    }
}

/// A A^T, lower triangle, of the columns with weight.
#[inline(always)]
fn gram<const K: usize, const N: usize>(a: &[[f64; N]; K], weight: &[f64; N]) -> [[f64; K]; K] {
    let mut g = [[0.0; K]; K];
    for r in 0..K {
        for c in 0..=r {
            let mut s = 0.0;
            for i in 0..N {
                s += a[r][i] * a[c][i] * weight[i];
            }
            g[r][c] = s;
        }
    }
    g
}

#[inline(always)]
fn times<const K: usize, const N: usize>(a: &[[f64; N]; K], t: &[f64; N]) -> [f64; K] {
    let mut out = [0.0; K];
    for k in 0..K {
        for i in 0..N {
            out[k] += a[k][i] * t[i];
        }
    }
    out
}

#[inline(always)]
fn transposed_times<const K: usize, const N: usize>(a: &[[f64; N]; K], v: &[f64; K]) -> [f64; N] {
    let mut out = [0.0; N];
    for k in 0..K {
        for i in 0..N {
            out[i] += a[k][i] * v[k];
        }
    }
    out
}

#[inline(always)]
fn closed_form<const K: usize, const N: usize>(
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
        // The offset keeps 0 / 0 out; it is far below the rounding of any other entry.
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
    let (mut low, mut high) = ((f64::NEG_INFINITY, 0), (f64::INFINITY, 0));
    for i in 0..N {
        let inverse = 1.0 / (null[i] + 1e-280);
        let p = (limits.min_n[i] - base[i]) * inverse;
        let q = (limits.max_n[i] - base[i]) * inverse;
        let (p, q) = (p.min(q), p.max(q));
        if p > low.0 {
            low = (p, i);
        }
        if q < high.0 {
            high = (q, i);
        }
    }
    let (worst, toward, size) = limiting(low, high, null);
    Error::OutsideTensionLimits {
        cable: worst + 1,
        // Cable `low` wants a larger s: its tension is then too small if it grows with s.
        bound: if toward * null[worst] > 0.0 {
            Bound::Minimum
        } else {
            Bound::Maximum
        },
        violation_n: size,
    }
}

/// Of the two cables that leave no room (ends of their intervals along `null`), the one that is
/// exceeded more at their least-squares compromise: (index, +1 if it is the lower one, violation).
#[inline(always)]
pub(crate) fn limiting<const N: usize>(
    low: (f64, usize),
    high: (f64, usize),
    null: &[f64; N],
) -> (usize, f64, f64) {
    let gap = low.0 - high.0;
    let (p, q) = (null[low.1].abs(), null[high.1].abs());
    let shared = p * q * gap / (p * p + q * q).max(f64::MIN_POSITIVE);
    if q > p {
        (low.1, 1.0, shared * q)
    } else {
        (high.1, -1.0, shared * p)
    }
}

/// The error that names the cable with the largest violation (positive: above the maximum).
fn worst_violation<const N: usize>(violations: &[f64; N]) -> Error {
    let worst = (0..N).fold(0, |w, i| {
        if violations[i].abs() > violations[w].abs() {
            i
        } else {
            w
        }
    });
    Error::OutsideTensionLimits {
        cable: worst + 1,
        bound: if violations[worst] > 0.0 {
            Bound::Maximum
        } else {
            Bound::Minimum
        },
        violation_n: violations[worst].abs(),
    }
}

/// N <= K: least squares must be exact, and within the limits.
fn unique<const K: usize, const N: usize>(
    a: &[[f64; N]; K],
    load: &[f64; K],
    limits: &TensionLimits<N>,
) -> Result<Distribution<N>, Error> {
    let mut normal = [[0.0; N]; N];
    let mut t = [0.0; N];
    for k in 0..K {
        for i in 0..N {
            t[i] += a[k][i] * load[k];
            for j in 0..=i {
                normal[i][j] += a[k][i] * a[k][j];
            }
        }
    }
    if !cholesky(&mut normal) {
        return Err(singular());
    }
    cholesky_solve(&normal, &mut t);
    if !t.iter().all(|x| x.is_finite()) {
        return Err(not_finite());
    }
    let got = times(a, &t);
    let (mut left, mut size) = (0.0, 0.0);
    for k in 0..K {
        left += (got[k] - load[k]) * (got[k] - load[k]);
        size += load[k] * load[k];
    }
    if left > 1e-16 * size {
        return Err(Error::WrenchNotBalanced {
            residual_n: sqrt(left),
        });
    }
    let violations: [f64; N] =
        core::array::from_fn(|i| t[i] - t[i].max(limits.min_n[i]).min(limits.max_n[i]));
    if violations.iter().any(|v| v.abs() > 1e-9 * sqrt(size)) {
        return Err(worst_violation(&violations));
    }
    Ok(finish(t, limits))
}

fn finish<const N: usize>(t: [f64; N], limits: &TensionLimits<N>) -> Distribution<N> {
    let mut out = Distribution {
        tensions_n: t,
        at_limit: CableSet::default(),
    };
    for i in 0..N {
        let (lo, hi) = (limits.min_n[i], limits.max_n[i]);
        out.tensions_n[i] = t[i].max(lo).min(hi);
        if t[i] - lo <= 1e-12 * hi || hi - t[i] <= 1e-12 * hi {
            out.at_limit.insert(i);
        }
    }
    out
}

/// More than one degree of redundancy.
fn dual<const K: usize, const N: usize>(
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
