//! Normal equations in arrow form: unknowns of each pose, and unknowns shared by all. The former are
//! eliminated pose by pose (Schur complement; Triggs et al., 2000), which leaves a small dense system.

use super::alike::{Alike, PoseSlots, turned};
use super::corner::Entry;
use super::rows::{Model, Row, Source, singles};
use super::unknowns::{Priors, State};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// Factor on each row of each pose: 1 counts in full, 0 is rejected.
pub type Weights = Vec<Vec<f64>>;

/// Normal equations at a state, with the residuals they were built from.
#[derive(Debug, Clone)]
pub struct Normal {
    own: usize,
    shared: usize,
    /// Pose after pose: own x own, row-major, lower triangle.
    own_h: Vec<f64>,
    own_g: Vec<f64>,
    /// Pose after pose: own rows of `shared` numbers.
    cross: Vec<f64>,
    /// Lower triangle, row-major.
    shared_h: Vec<f64>,
    shared_g: DVector<f64>,
    /// Weighted sum of squares of the measurements.
    pub chi_square: f64,
    /// Sum of squares of the priors.
    pub prior_chi_square: f64,
    /// Residuals of each pose's rows, in standard deviations, not weighted.
    pub residuals: Vec<Vec<f64>>,
}

/// The system with the poses eliminated.
#[derive(Debug, Clone)]
pub struct Reduced {
    /// Unknowns of one pose.
    pub(super) own: usize,
    /// Pose after pose: Cholesky factor of the own block, row-major.
    pub(super) factors: Vec<f64>,
    /// `shared` x (poses * own): columns are the rows of L^-1 cross.
    pub(super) coupling: DMatrix<f64>,
    /// L^-1 of the own gradients.
    own_g: DVector<f64>,
    /// Schur complement.
    pub information: DMatrix<f64>,
    gradient: DVector<f64>,
}

impl Normal {
    /// Accumulates all rows and priors. `None` outside the model's domain.
    #[must_use]
    pub fn at(
        model: &Model<'_>,
        priors: &Priors,
        state: &State,
        weights: &Weights,
    ) -> Option<Self> {
        let (own, shared) = (model.layout.local(), model.layout.len());
        let poses = state.poses.len();
        let mut out = Self {
            own,
            shared,
            own_h: vec![0.0; own * own * poses],
            own_g: vec![0.0; own * poses],
            cross: Vec::with_capacity(own * shared * poses),
            shared_h: vec![0.0; shared * shared],
            shared_g: DVector::zeros(shared),
            chi_square: 0.0,
            prior_chi_square: 0.0,
            residuals: vec![Vec::new(); poses],
        };
        let cables = singles(state).ok()?;
        let mut corners = CornerSums::new();
        let mut balance = Alike::new();
        for k in 0..poses {
            // Pose by pose, so that what is set to zero is still near when it is filled.
            out.cross.resize(own * shared * (k + 1), 0.0);
            let mut list = Vec::with_capacity(model.row_bound(k));
            model
                .rows(state, &cables, k, |row| {
                    let weight = weights.get(k).and_then(|w| w.get(list.len()));
                    list.push(row.residual);
                    let weight = weight.copied().unwrap_or(1.0);
                    if let Source::Corner(_, _, axis) = row.source {
                        // Another body of tags: its sums belong to other unknowns.
                        if corners.body != row.shared.get(6).map(|entry| entry.at) {
                            corners.flush_pose(k, &mut out);
                            corners.flush_shared(&mut out);
                        }
                        corners.add(row, weight, axis);
                    } else if matches!(row.source, Source::Balance(_)) {
                        balance.add(row, weight);
                    } else {
                        out.add(k, row, weight);
                    }
                })
                .ok()?;
            corners.flush_pose(k, &mut out);
            balance.flush_pose(&mut PoseSlots {
                h: &mut out.own_h[k * own * own..(k + 1) * own * own],
                g: &mut out.own_g[k * own..(k + 1) * own],
                cross: &mut out.cross[k * own * shared..(k + 1) * own * shared],
            });
            out.residuals[k] = list;
        }
        corners.flush_shared(&mut out);
        out.chi_square += balance.flush_shared(&mut out.shared_h, out.shared_g.as_mut_slice());
        for prior in state.priors(model.data, &model.layout, priors) {
            let weight = 1.0 / (prior.sigma * prior.sigma);
            out.shared_h[prior.index * (shared + 1)] += weight;
            out.shared_g[prior.index] += weight * prior.deviation;
            out.prior_chi_square += weight * prior.deviation * prior.deviation;
        }
        (out.chi_square + out.prior_chi_square)
            .is_finite()
            .then_some(out)
    }

    /// Weighted sum of squares with the priors: the cost.
    #[must_use]
    pub fn cost(&self) -> f64 {
        self.chi_square + self.prior_chi_square
    }

    fn add(&mut self, k: usize, row: &Row<'_>, weight: f64) {
        if weight == 0.0 {
            return;
        }
        self.chi_square += weight * row.residual * row.residual;
        let (own, shared) = (self.own, self.shared);
        let h = &mut self.own_h[k * own * own..(k + 1) * own * own];
        let g = &mut self.own_g[k * own..(k + 1) * own];
        let cross = &mut self.cross[k * own * shared..(k + 1) * own * shared];
        for (a, &value) in row.own.iter().enumerate() {
            // Most entries are zero: a length does not depend on the tensions of other cables.
            if value == 0.0 {
                continue;
            }
            let value = value * weight;
            g[a] += value * row.residual;
            for (slot, other) in h[a * own..].iter_mut().zip(&row.own[..=a]) {
                *slot += value * other;
            }
            let line = &mut cross[a * shared..(a + 1) * shared];
            for &Entry {
                at: j,
                slope: other,
            } in row.shared
            {
                line[j] += value * other;
            }
        }
        for (
            p,
            &Entry {
                at: i,
                slope: value,
            },
        ) in row.shared.iter().enumerate()
        {
            let value = value * weight;
            self.shared_g[i] += value * row.residual;
            for &Entry {
                at: j,
                slope: other,
            } in &row.shared[..=p]
            {
                self.shared_h[i.max(j) * shared + i.min(j)] += value * other;
            }
        }
    }

    /// Eliminates the poses, with Marquardt's damping (relative to the diagonal). `None` where a
    /// block is not positive definite.
    #[must_use]
    pub fn reduced(&self, damping: f64) -> Option<Reduced> {
        let (own, shared) = (self.own, self.shared);
        let poses = self.own_g.len() / own;
        let mut coupling = Vec::with_capacity(shared * poses * own);
        let mut own_g = DVector::from_column_slice(&self.own_g);
        let mut factors = self.own_h.clone();
        for k in 0..poses {
            let l = &mut factors[k * own * own..(k + 1) * own * own];
            for a in 0..own {
                let diagonal = &mut l[a * own + a];
                // A tiny diagonal (1/m^2, against 1e8 and more), for unknowns without rows: a
                // tension without sensor, a pose whose picture was rejected.
                *diagonal = *diagonal * (1.0 + damping) + 1.0;
            }
            factor(l, own)?;
            let (from, to) = (k * own * shared, (k + 1) * own * shared);
            coupling.extend_from_slice(&self.cross[from..to]);
            let block = &mut coupling[from..to];
            let g = &mut own_g.as_mut_slice()[k * own..(k + 1) * own];
            for a in 0..own {
                let (done, rest) = block.split_at_mut(a * shared);
                let line = &mut rest[..shared];
                let factors = &l[a * own..a * own + a];
                // Two at a time: each number of the line is read and written half as often.
                let mut earlier = done.chunks_exact(2 * shared);
                for (pair, f) in earlier.by_ref().zip(factors.chunks_exact(2)) {
                    let (first, second) = pair.split_at(shared);
                    for ((x, y), z) in line.iter_mut().zip(first).zip(second) {
                        *x = *x - f[0] * y - f[1] * z;
                    }
                }
                if let [.., f] = factors.chunks_exact(2).remainder() {
                    for (x, y) in line.iter_mut().zip(earlier.remainder()) {
                        *x -= f * y;
                    }
                }
                let rhs = factors
                    .iter()
                    .zip(&*g)
                    .fold(g[a], |sum, (f, x)| sum - f * x);
                let inv = 1.0 / l[a * own + a];
                for x in line.iter_mut() {
                    *x *= inv;
                }
                g[a] = rhs * inv;
            }
        }
        let coupling = DMatrix::from_vec(shared, poses * own, coupling);
        // The lower triangle row by row is the upper one column by column.
        let mut information = DMatrix::from_column_slice(shared, shared, &self.shared_h);
        for j in 0..shared {
            information[(j, j)] *= 1.0 + damping;
        }
        // Only the upper triangle, in strips. Each strip packs its rows anew: few are faster than narrow ones.
        let turned = turned(coupling.as_slice(), shared, poses * own);
        for first in (0..shared).step_by(STRIP) {
            let width = STRIP.min(shared - first);
            let rows = first + width;
            information.view_mut((0, first), (rows, width)).gemm(
                -1.0,
                &coupling.rows(0, rows),
                &turned.columns(first, width),
                1.0,
            );
        }
        for j in 0..shared {
            for i in 0..j {
                information[(j, i)] = information[(i, j)];
            }
        }
        let mut gradient = self.shared_g.clone();
        gradient.gemv(-1.0, &coupling, &own_g, 1.0);
        Some(Reduced {
            own,
            factors,
            coupling,
            own_g,
            information,
            gradient,
        })
    }
}

/// Columns of a product that are computed at once.
const STRIP: usize = 40;

/// Unknowns that a corner depends on, and its residual: 6 of the pose, 6 of the camera, 6 of the
/// body, focal length, principal point (2), k1, tag scale, residual.
const CORNER: usize = 24;
/// Of these, those of the pose.
const OWN: usize = 6;

/// Sums of products over the corners of one body: many rows on few unknowns, so that they are summed
/// densely and go to the normal equations once per picture, the part shared by all pictures once.
struct CornerSums {
    /// First unknown of the body; `None` while empty.
    body: Option<usize>,
    /// Index of each shared unknown in the normal equations.
    places: [usize; CORNER - 1 - OWN],
    sums: Box<[[f64; CORNER]; CORNER]>,
    /// A row that is summed with the next one of its pose.
    waiting: Option<[f64; CORNER]>,
}

impl CornerSums {
    fn new() -> Self {
        Self {
            body: None,
            places: [0; CORNER - 1 - OWN],
            sums: Box::new([[0.0; CORNER]; CORNER]),
            waiting: None,
        }
    }

    /// Adds a row in the order in which `Model::rows` gives the unknowns of a corner.
    fn add(&mut self, row: &Row<'_>, weight: f64, axis: usize) {
        if self.body.is_none() {
            self.body = row.shared.get(6).map(|entry| entry.at);
            for (slot, entry) in self.places.iter_mut().zip(&row.shared[..13]) {
                *slot = entry.at;
            }
            let center = row.shared[13].at - axis;
            self.places[13] = center;
            self.places[14] = center + 1;
            self.places[15] = row.shared[14].at;
            self.places[16] = row.shared[15].at;
        }
        if weight == 0.0 {
            return;
        }
        let mut x = [0.0; CORNER];
        x[..OWN].copy_from_slice(&row.own[..OWN]);
        for (slot, entry) in x[OWN..].iter_mut().zip(&row.shared[..13]) {
            *slot = entry.slope;
        }
        x[19 + axis] = row.shared[13].slope;
        x[21] = row.shared[14].slope;
        x[22] = row.shared[15].slope;
        x[23] = row.residual;
        let root = weight.sqrt();
        let x = x.map(|value| value * root);
        // Two rows at a time: each sum is read and written half as often.
        let Some(y) = self.waiting.take() else {
            self.waiting = Some(x);
            return;
        };
        self.sum(&x, &y);
    }

    fn sum(&mut self, x: &[f64; CORNER], y: &[f64; CORNER]) {
        for (i, line) in self.sums.iter_mut().enumerate() {
            let values = (x[i], y[i]);
            // A multiple of four keeps the loop in whole vector registers; the rest is not read.
            let upto = (i / 4 + 1) * 4;
            for ((slot, a), b) in line[..upto].iter_mut().zip(&x[..upto]).zip(&y[..upto]) {
                *slot += values.0 * a + values.1 * b;
            }
        }
    }

    /// Adds the row that waits for another one.
    fn finish(&mut self) {
        if let Some(x) = self.waiting.take() {
            self.sum(&x, &[0.0; CORNER]);
        }
    }

    /// Adds the information of the corners of one pose about its own unknowns.
    fn flush_pose(&mut self, k: usize, out: &mut Normal) {
        if self.body.is_none() {
            return;
        }
        self.finish();
        let last = CORNER - 1;
        let (own, shared) = (out.own, out.shared);
        for a in 0..OWN {
            out.own_g[k * own + a] += self.sums[last][a];
            let line = (k * own + a) * own;
            for b in 0..=a {
                out.own_h[line + b] += self.sums[a][b];
            }
            let line = &mut out.cross[(k * own + a) * shared..(k * own + a + 1) * shared];
            for (at, sums) in self.places.iter().zip(&self.sums[OWN..last]) {
                line[*at] += sums[a];
            }
        }
        for line in self.sums.iter_mut() {
            line[..OWN].fill(0.0);
        }
    }

    /// Adds the information of all corners so far about the shared unknowns.
    fn flush_shared(&mut self, out: &mut Normal) {
        if self.body.take().is_none() {
            return;
        }
        let last = CORNER - 1;
        out.chi_square += self.sums[last][last];
        for (c, &at) in (OWN..last).zip(&self.places) {
            out.shared_g[at] += self.sums[last][c];
            for (d, &other) in (OWN..=c).zip(&self.places) {
                out.shared_h[at.max(other) * out.shared + at.min(other)] += self.sums[c][d];
            }
        }
        *self.sums = [[0.0; CORNER]; CORNER];
    }
}

/// Cholesky factor in place, lower triangle, row-major. `None` unless positive definite.
fn factor(l: &mut [f64], n: usize) -> Option<()> {
    for i in 0..n {
        for j in 0..=i {
            let mut sum = l[i * n + j];
            for k in 0..j {
                sum -= l[i * n + k] * l[j * n + k];
            }
            if i == j {
                if sum.is_nan() || sum <= 0.0 {
                    return None;
                }
                l[i * n + i] = sum.sqrt();
            } else {
                l[i * n + j] = sum / l[j * n + j];
            }
        }
    }
    Some(())
}

/// A symmetric positive definite matrix, scaled to a unit diagonal and factored: the unknowns differ
/// by many orders of magnitude.
#[derive(Debug, Clone)]
pub(crate) struct Scaled {
    scale: DVector<f64>,
    cholesky: Cholesky<f64, Dyn>,
}

impl Scaled {
    /// `None` unless positive definite.
    #[must_use]
    pub fn new(matrix: &DMatrix<f64>) -> Option<Self> {
        let scale = matrix.diagonal().map(|d| 1.0 / d.sqrt());
        if scale.iter().any(|s| !s.is_finite()) {
            return None;
        }
        let n = matrix.nrows();
        let unit = DMatrix::from_fn(n, n, |i, j| matrix[(i, j)] * scale[i] * scale[j]);
        Some(Self {
            scale,
            cholesky: Cholesky::new(unit)?,
        })
    }

    /// Solves the system.
    #[must_use]
    pub fn solve(&self, rhs: &DVector<f64>) -> DVector<f64> {
        let scaled = rhs.component_mul(&self.scale);
        self.cholesky.solve(&scaled).component_mul(&self.scale)
    }

    /// The inverse.
    #[must_use]
    pub fn inverse(&self) -> DMatrix<f64> {
        let mut out = self.cholesky.inverse();
        for j in 0..out.ncols() {
            for i in 0..out.nrows() {
                out[(i, j)] *= self.scale[i] * self.scale[j];
            }
        }
        out
    }
}

/// A step of the unknowns.
pub struct Step {
    /// Of the shared ones.
    pub shared: DVector<f64>,
    /// Of each pose's own, one pose after the other.
    pub own: DVector<f64>,
    /// Expected decrease of the cost.
    pub expected: f64,
}

impl Reduced {
    /// The undamped step of the damped system.
    #[must_use]
    pub fn step(&self) -> Option<Step> {
        let shared = Scaled::new(&self.information)?.solve(&-&self.gradient);
        let mut own = -&self.own_g;
        own.gemv_tr(-1.0, &self.coupling, &shared, 1.0);
        let expected = own.norm_squared() + 0.0_f64.max(-self.gradient.dot(&shared));
        let size = self.own * self.own;
        for (k, l) in self.factors.chunks_exact(size).enumerate() {
            let x = &mut own.as_mut_slice()[k * self.own..(k + 1) * self.own];
            for a in (0..self.own).rev() {
                let mut sum = x[a];
                for b in a + 1..self.own {
                    sum -= l[b * self.own + a] * x[b];
                }
                x[a] = sum / l[a * self.own + a];
            }
        }
        (shared.iter().chain(own.iter()))
            .all(|x| x.is_finite())
            .then_some(Step {
                shared,
                own,
                expected,
            })
    }

    /// Covariance of the shared unknowns.
    #[must_use]
    pub fn covariance(&self) -> Option<DMatrix<f64>> {
        Some(Scaled::new(&self.information)?.inverse())
    }
}
