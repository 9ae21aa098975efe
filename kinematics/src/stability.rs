//! First-order behaviour around an equilibrium: responses, stiffness, natural modes.

use nalgebra::{Matrix3, Matrix6, SMatrix, Vector3, Vector6};

use crate::cable_vec::{CableMatrix, CableVec, MAX_CABLES};
use crate::equilibrium_state::Equilibrium;
use crate::error::{Error, Solver};
use crate::linear::{DENSE, eliminate};
use crate::math::sqrt;
use crate::robot::Robot;

/// Response of an equilibrium to small changes of the held quantities.
///
/// Inputs, one per cable: its held length (m) or, for a tension-held cable, its tension (N).
/// Outputs, one per cable: its tension (N) if it is length-held and taut; otherwise its length (m).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Linearisation {
    /// `response[(k, j)]` = d(output of cable k)/d(input of cable j). For the four-cable robot with
    /// cable 4 tension-held, row 4 is the closure row: dl4 = c1 dl1 + c2 dl2 + c3 dl3 + cT dT4.
    /// Columns of slack cables are zero.
    pub response: CableMatrix,
    /// Change of pose `[dp, phi]` (m, rad, world, about the platform's origin) per unit of each
    /// cable's input.
    pub pose: CableVec<[f64; 6]>,
}

/// Derivatives of lengths, tensions and attitude by the tool position at equilibrium, when the
/// length-held winches move the tool.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToolSensitivity {
    /// d(length of cable)/d(tool position), dimensionless, world frame.
    pub lengths_per_position: CableVec<[f64; 3]>,
    /// d(tension of cable)/d(tool position), N/m, world frame; zero for tension-held cables.
    pub tensions_per_position: CableVec<[f64; 3]>,
    /// d(rotation vector)/d(tool position), rad/m, 3 x 3, world frame.
    pub rotation_per_position: Matrix3<f64>,
    /// `[(k, j)]`: d(length of cable k)/d(held tension of cable j), m/N; columns of length-held
    /// cables are zero.
    pub lengths_per_tension: CableMatrix,
    /// `[(k, j)]`: d(tension of cable k)/d(held tension of cable j), dimensionless.
    pub tensions_per_tension: CableMatrix,
    /// d(rotation vector)/d(held tension), rad/N, world frame; zero for length-held cables.
    pub rotation_per_tension: CableVec<[f64; 3]>,
}

/// Stiffness and free vibration at an equilibrium.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stability {
    /// Hessian of the energy with respect to `[dp, phi]`, 6 x 6 (N/m, N, N m, world, about the
    /// platform's origin), tensions frozen, axial stiffness of elastic cables included; the
    /// inextensible cables constrain it further.
    pub stiffness: Matrix6<f64>,
    /// Number of degrees of freedom that the taut inextensible cables leave.
    pub freedoms: usize,
    /// Eigenvalues of the stiffness on those freedoms, ascending (N/m; rotations are scaled by the
    /// robot's lever so that all have the same unit).
    pub reduced_eigenvalues_n_per_m: CableVec<f64>,
    /// Whether all reduced eigenvalues are positive.
    pub stable: bool,
    /// Natural frequencies, Hz, ascending. Empty when the platform has no inertia; an unstable mode
    /// is given as a negative number, minus its growth rate over 2 pi.
    pub modes_hz: CableVec<f64>,
    /// Mass matrix in the coordinates of the stiffness (kg, kg m, kg m^2); `None` when the platform has no inertia.
    pub mass: Option<Matrix6<f64>>,
}

/// Columns of the systems below: unknowns plus one right-hand side per cable and three positions.
const WIDTH: usize = DENSE + MAX_CABLES + 3;

impl<const N: usize> Robot<N> {
    /// Full symmetric Hessian of the energy with the tensions of an equilibrium.
    fn energy_hessian(
        &self,
        eq: &Equilibrium,
    ) -> Result<([[f64; 6]; 6], SMatrix<f64, N, 6>), Error> {
        if eq.tensions_n.len() != N {
            return Err(Error::CableCount {
                expected: N,
                got: eq.tensions_n.len(),
            });
        }
        let inverse = self.inverse(&eq.pose)?;
        let tensions = core::array::from_fn(|i| eq.tensions_n[i]);
        let mut h = self.hessian(&eq.pose, &inverse, &tensions, &[0.0; N]);
        for i in 0..6 {
            for j in i + 1..6 {
                h[i][j] = h[j][i];
            }
        }
        Ok((h, inverse.twist_jacobian()))
    }

    fn taut_length_held(eq: &Equilibrium) -> ([usize; N], usize) {
        let mut list = [0; N];
        let mut m = 0;
        for i in 0..N {
            if !eq.tension_held.contains(i) && !eq.slack.contains(i) {
                list[m] = i;
                m += 1;
            }
        }
        (list, m)
    }

    /// Response of an equilibrium to small changes of the held lengths and tensions.
    ///
    /// Source: implicit differentiation of the equilibrium conditions.
    ///
    /// # Errors
    /// [`Error::CableCount`] for an equilibrium of another robot; [`Error::Singular`] at a pose where
    /// the response is not defined.
    pub fn linearise(&self, eq: &Equilibrium) -> Result<Linearisation, Error> {
        let (h, jacobian) = self.energy_hessian(eq)?;
        let (active, m) = Self::taut_length_held(eq);
        let n = 6 + m;
        let mut a = [[0.0; WIDTH]; DENSE];
        for i in 0..6 {
            a[i][..6].copy_from_slice(&h[i]);
        }
        for (k, &cable) in active[..m].iter().enumerate() {
            for j in 0..6 {
                a[j][6 + k] = jacobian[(cable, j)];
                a[6 + k][j] = jacobian[(cable, j)];
            }
            let axial = eq.axial_stiffness_n_per_m[cable];
            // An elastic cable gets longer by its tension over EA / l, in addition to the commanded
            // length.
            if axial > 0.0 {
                a[6 + k][6 + k] = -1.0 / axial;
            }
            a[6 + k][n + cable] = 1.0;
        }
        for cable in eq.tension_held.iter().filter(|&c| c < N) {
            for j in 0..6 {
                a[j][n + cable] = -jacobian[(cable, j)];
            }
        }
        if !eliminate(&mut a, n, N) {
            return Err(Error::Singular {
                solver: Solver::Linearisation,
            });
        }
        let mut response = CableMatrix::zeros(N);
        for input in 0..N {
            for output in 0..N {
                let taut = active[..m].iter().position(|&c| c == output);
                response[(output, input)] = match taut {
                    Some(k) => a[6 + k][n + input],
                    None => (0..6)
                        .map(|j| jacobian[(output, j)] * a[j][n + input])
                        .sum(),
                };
            }
        }
        Ok(Linearisation {
            response,
            pose: CableVec::from_fn(N, |c| core::array::from_fn(|j| a[j][n + c])),
        })
    }

    /// How lengths, tensions and attitude change with the tool's position and the held tensions.
    ///
    /// `tool_in_platform_m` is the point that [`Robot::equilibrium_at`] placed.
    ///
    /// # Errors
    /// As [`Robot::linearise`]; [`Error::TooFewCables`] unless exactly three taut cables are
    /// length-held.
    pub fn tool_sensitivity(
        &self,
        eq: &Equilibrium,
        tool_in_platform_m: &Vector3<f64>,
    ) -> Result<ToolSensitivity, Error> {
        // About the tool, its position is an input that a rotation does not change.
        let shifted = self.about(tool_in_platform_m)?;
        let mut about_tool = *eq;
        about_tool.pose.position_m = eq.pose.transform(tool_in_platform_m);
        let (h, jacobian) = shifted.energy_hessian(&about_tool)?;
        let (active, m) = Self::taut_length_held(eq);
        if m != 3 {
            return Err(Error::TooFewCables {
                solver: Solver::Linearisation,
                needed: 3,
                got: m,
            });
        }
        // Unknowns: rotation (3) and the three tensions; inputs: position (3) and held tensions.
        let n = 6;
        let mut a = [[0.0; WIDTH]; DENSE];
        for i in 0..6 {
            a[i][..3].copy_from_slice(&h[i][3..]);
            for (k, &cable) in active[..3].iter().enumerate() {
                a[i][3 + k] = jacobian[(cable, i)];
            }
            for j in 0..3 {
                a[i][n + j] = -h[i][j];
            }
            for cable in eq.tension_held.iter().filter(|&c| c < N) {
                a[i][n + 3 + cable] = -jacobian[(cable, i)];
            }
        }
        if !eliminate(&mut a, n, 3 + N) {
            return Err(Error::Singular {
                solver: Solver::Linearisation,
            });
        }
        let length = |cable: usize, column: usize| -> f64 {
            (0..3)
                .map(|j| jacobian[(cable, 3 + j)] * a[j][n + column])
                .sum()
        };
        let tension = |cable: usize, column: usize| -> f64 {
            match active[..3].iter().position(|&c| c == cable) {
                Some(k) => a[3 + k][n + column],
                None => 0.0,
            }
        };
        let mut out = ToolSensitivity {
            lengths_per_position: CableVec::from_fn(N, |c| {
                core::array::from_fn(|k| jacobian[(c, k)] + length(c, k))
            }),
            tensions_per_position: CableVec::from_fn(N, |c| {
                core::array::from_fn(|k| tension(c, k))
            }),
            rotation_per_position: Matrix3::from_fn(|i, k| a[i][n + k]),
            lengths_per_tension: CableMatrix::zeros(N),
            tensions_per_tension: CableMatrix::zeros(N),
            rotation_per_tension: CableVec::from_fn(N, |c| {
                core::array::from_fn(|i| a[i][n + 3 + c])
            }),
        };
        for input in eq.tension_held.iter().filter(|&c| c < N) {
            for output in 0..N {
                out.lengths_per_tension[(output, input)] = length(output, 3 + input);
                out.tensions_per_tension[(output, input)] = if output == input {
                    1.0
                } else {
                    tension(output, 3 + input)
                };
            }
        }
        Ok(out)
    }

    /// Stiffness, reduced Hessian and natural modes at an equilibrium.
    ///
    /// The winches keep their held quantities (lengths or tensions); drums do not move in
    /// length-held cables and follow without inertia in tension-held ones.
    ///
    /// # Errors
    /// [`Error::CableCount`] for an equilibrium of another robot; domain errors.
    pub fn stability(&self, eq: &Equilibrium) -> Result<Stability, Error> {
        let (h, jacobian) = self.energy_hessian(eq)?;
        let mut stiffness = Matrix6::from_fn(|i, j| h[i][j]);
        let (active, m) = Self::taut_length_held(eq);
        let mut rigid = [Vector6::zeros(); 6];
        let mut count = 0;
        // Scaling makes radians comparable with metres in the orthogonalisation.
        let scale = Vector6::new(1.0, 1.0, 1.0, self.lever_m, self.lever_m, self.lever_m);
        for &cable in &active[..m] {
            let row = jacobian.row(cable).transpose();
            let axial = eq.axial_stiffness_n_per_m[cable];
            if axial > 0.0 {
                stiffness += row * row.transpose() * axial;
                continue;
            }
            let scaled = row.component_div(&scale);
            if count < 6
                && let Some(unit) = orthogonal_part(&scaled, &rigid[..count])
            {
                rigid[count] = unit;
                count += 1;
            }
        }
        let basis = complement(&rigid, count);
        let freedoms = 6 - count;
        let scaled = Matrix6::from_fn(|i, j| stiffness[(i, j)] / (scale[i] * scale[j]));
        let on_basis = |full: &Matrix6<f64>| {
            // Directions outside the freedoms get the unit matrix, to keep the size fixed.
            Matrix6::from_fn(|i, j| {
                if i < freedoms && j < freedoms {
                    basis[i].dot(&(full * basis[j]))
                } else {
                    f64::from(u8::from(i == j))
                }
            })
        };
        let reduced = on_basis(&scaled);
        let eigenvalues = leading_eigenvalues(&reduced, freedoms);
        // N/m. An eigenvalue of rounding size is a free direction, not a stable one.
        let tiny = 1e-9 * self.weight_n() / self.lever_m;
        let mut out = Stability {
            stiffness,
            freedoms,
            stable: eigenvalues.iter().all(|&x| x > tiny),
            reduced_eigenvalues_n_per_m: eigenvalues,
            modes_hz: CableVec::filled(0),
            mass: self.mass_matrix(eq),
        };
        if let Some(mass) = &out.mass {
            let mass = Matrix6::from_fn(|i, j| mass[(i, j)] / (scale[i] * scale[j]));
            // M = L L^T, and the modes are the eigenvalues of L^-1 K L^-T.
            if let Some(factor) = on_basis(&mass).cholesky()
                && let Some(inverse) = factor.l().try_inverse()
            {
                let dynamic = inverse * reduced * inverse.transpose();
                let squares = leading_eigenvalues(&dynamic, freedoms);
                out.modes_hz = CableVec::from_fn(freedoms, |k| {
                    let w2 = squares[k];
                    sqrt(w2.abs()) * w2.signum() / core::f64::consts::TAU
                });
            }
        }
        Ok(out)
    }

    /// Mass matrix (6 x 6, kg, kg m, kg m^2, world axes, about the platform's origin) at an
    /// equilibrium's pose; `None` without inertia.
    pub(crate) fn mass_matrix(&self, eq: &Equilibrium) -> Option<Matrix6<f64>> {
        let platform = self.platform();
        let r = eq.pose.rotation.matrix();
        let inertia = r * platform.inertia_kg_m2? * r.transpose();
        let c = (r * platform.center_of_mass_m).cross_matrix();
        let m = platform.mass_kg;
        let mut mass = Matrix6::identity() * m;
        // The centre of mass moves with v + omega x c = v - [c] omega.
        mass.fixed_view_mut::<3, 3>(0, 3).copy_from(&(-c * m));
        mass.fixed_view_mut::<3, 3>(3, 0).copy_from(&(c * m));
        mass.fixed_view_mut::<3, 3>(3, 3)
            .copy_from(&(inertia - c * c * m));
        Some(mass)
    }
}

/// Unit vector of the component of `v` outside the span of orthonormal vectors.
fn orthogonal_part(v: &Vector6<f64>, span: &[Vector6<f64>]) -> Option<Vector6<f64>> {
    let size = v.norm();
    let mut rest = *v;
    // Twice is enough (Giraud, Langou and Rozloznik, 2005).
    for _ in 0..2 {
        for s in span {
            rest -= s * s.dot(&rest);
        }
    }
    let left = rest.norm();
    (left > 1e-9 * size).then(|| rest / left)
}

/// Orthonormal basis of the complement of the first `count` (orthonormal) vectors.
fn complement(span: &[Vector6<f64>; 6], count: usize) -> [Vector6<f64>; 6] {
    let mut all = *span;
    let mut used = [false; 6];
    for slot in count..6 {
        // The axis that is furthest outside the span so far.
        let mut best = (0.0, 0);
        for k in (0..6).filter(|&k| !used[k]) {
            let inside: f64 = all[..slot].iter().map(|s| s[k] * s[k]).sum();
            if 1.0 - inside > best.0 {
                best = (1.0 - inside, k);
            }
        }
        used[best.1] = true;
        let mut axis = Vector6::zeros();
        axis[best.1] = 1.0;
        all[slot] = orthogonal_part(&axis, &all[..slot]).unwrap_or(axis);
    }
    let mut out = [Vector6::zeros(); 6];
    out[..6 - count].copy_from_slice(&all[count..]);
    out
}

/// Eigenvalues, ascending, of the leading `n` x `n` block of a symmetric matrix, by cyclic Jacobi
/// rotations (accurate for small eigenvalues, too).
fn leading_eigenvalues(m: &Matrix6<f64>, n: usize) -> CableVec<f64> {
    let mut a = *m;
    for _ in 0..30 {
        let mut off = 0.0;
        let mut all = 0.0;
        for i in 0..n {
            for j in 0..n {
                let square = a[(i, j)] * a[(i, j)];
                all += square;
                off += if i == j { 0.0 } else { square };
            }
        }
        // Sums of squares: off-diagonal entries of 1e-16 are rounding.
        if off <= 1e-32 * all {
            break;
        }
        for p in 0..n {
            for q in p + 1..n {
                let apq = a[(p, q)];
                if apq == 0.0 {
                    continue;
                }
                let tau = (a[(q, q)] - a[(p, p)]) / (2.0 * apq);
                // The smaller root: rotations up to 45 degrees converge (Golub and Van Loan, Matrix
                // Computations, 8.5).
                let t = tau.signum() / (tau.abs() + sqrt(1.0 + tau * tau));
                let c = 1.0 / sqrt(1.0 + t * t);
                let s = t * c;
                for k in 0..n {
                    let (x, y) = (a[(k, p)], a[(k, q)]);
                    a[(k, p)] = c * x - s * y;
                    a[(k, q)] = s * x + c * y;
                }
                for k in 0..n {
                    let (x, y) = (a[(p, k)], a[(q, k)]);
                    a[(p, k)] = c * x - s * y;
                    a[(q, k)] = s * x + c * y;
                }
            }
        }
    }
    let mut out = CableVec::from_fn(n, |i| a[(i, i)]);
    out.sort_unstable_by(f64::total_cmp);
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eigenvalues_agree_with_the_invariants() {
        let b = Matrix6::from_fn(|i, j| ((i * 7 + j * 3) % 5) as f64 - 1.7);
        let a = b + b.transpose();
        let values = leading_eigenvalues(&a, 6);
        let sum: f64 = values.iter().sum();
        let product: f64 = values.iter().product();
        assert!((sum - a.trace()).abs() < 1e-12);
        assert!((product - a.determinant()).abs() < 1e-9 * product.abs().max(1.0));
        assert!(values.windows(2).all(|w| w[0] <= w[1]));
    }
}
