//! Tension distribution: tensions within limits that balance a load.
//!
//! The structure matrix A has the column `-[t_i; u_i x t_i]` for cable i: tensions T exert the
//! wrench A T on the platform, and equilibrium under an external wrench w is A T + w = 0.
//! The optimum is the balanced distribution nearest (least squares) to a target. One degree of
//! redundancy has a closed form: the balanced tensions are a line, cut by the limits to an
//! interval. So have two: they are a plane, cut to a polygon. For more, the dual problem min_v sum psi_i(target_i + (A^T v)_i) - b.v is piecewise
//! quadratic and is solved by Newton's method with a line search, the limits being hardened in
//! stages; the final set of cables at their limits is then solved exactly. (The problem statement
//! follows Pott, 2018; the dual Newton method is that of Li and Swetits, 1997.)

mod blocks;
mod closed;
mod dual;
mod pair;

use nalgebra::{SMatrix, Vector3, Vector6};

use crate::cable_vec::CableSet;
use crate::error::{Bound, Error, Solver};
use crate::inverse::Inverse;
use crate::linear::{cholesky, cholesky_solve};
use crate::math::sqrt;
use crate::pose::Pose;
use crate::robot::Robot;

pub(crate) use closed::{End, limiting};
use closed::{closed_form, three_forces};
use dual::dual;

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
    #[inline]
    pub fn check(&self) -> Result<(), Error> {
        // All at once first: valid limits, the usual ones, take no branch for each.
        let valid = |i: usize| {
            let (lo, hi) = (self.min_n[i], self.max_n[i]);
            (lo >= 0.0) & (lo <= hi) & (hi < f64::INFINITY)
        };
        if (0..N).fold(true, |all, i| all & valid(i)) {
            return Ok(());
        }
        self.name_invalid()
    }

    #[cold]
    fn name_invalid(&self) -> Result<(), Error> {
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

/// Which of the balanced distributions to return.
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

    /// Rows of the structure matrix as arrays, for [`distribute`].
    #[inline(always)]
    pub(crate) fn structure_rows(&self) -> [[f64; N]; 6] {
        let (t, u) = (&self.directions, &self.arms_m);
        let mut a = [[0.0; N]; 6];
        for i in 0..N {
            // Minus: directions point to the platform, and cables pull it the other way.
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
/// Shape: A is `K` x `N` (K equations, N cables), any scale. Exact optimum for N = K + 1 and N = K + 2 by
/// closed form, for more cables by the dual method of the module's text; for N <= K the balanced tensions
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
        // The paper's case, three forces and four cables, needs no factorisation.
        if K == 3
            && let Some(found) = three_forces(a, load, limits, &target)
        {
            return Ok(found);
        }
        closed_form(a, load, limits, &target)
    } else if N > K {
        limits.check()?;
        if N == K + 2
            && let Some(found) = pair::pair(a, load, limits, &target)
        {
            return Ok(found);
        }
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
    // Squares: 1e-8 of the load may remain, since normal equations lose half of the digits.
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

/// A tension is at its limit within this share of the greatest one.
const NEAR: f64 = 1e-12;

fn finish<const N: usize>(t: [f64; N], limits: &TensionLimits<N>) -> Distribution<N> {
    let mut out = Distribution {
        tensions_n: t,
        at_limit: CableSet::default(),
    };
    for i in 0..N {
        let (lo, hi) = (limits.min_n[i], limits.max_n[i]);
        out.tensions_n[i] = t[i].max(lo).min(hi);
        if t[i] - lo <= NEAR * hi || hi - t[i] <= NEAR * hi {
            out.at_limit.insert(i);
        }
    }
    out
}
