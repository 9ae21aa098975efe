//! Leverages of the rows: variances of their predictions.
//!
//! With V the covariance of the shared unknowns and, for one pose, L the Cholesky factor of its own block and C the
//! coupling (shared x own) of which L^-1 is already part, a row with derivatives o (own) and s (shared) has the leverage
//! s' V s - 2 s' B o + o' A o with B = V C L^-1 and A = L^-T (1 + C' V C) L^-1. B and A are computed once for each pose.
//! Rows of one kind have the same shared unknowns, so that their part of V is gathered once for all poses.

use super::alike::turned;
use super::normal::Reduced;
use super::rows::{OWN_MAX, Row};
use nalgebra::DMatrix;

/// What the leverages need, for all rows.
pub(super) struct Leverages<'a> {
    own: usize,
    shared: usize,
    /// Pose after pose: A, own x own, row-major.
    own_covariance: Vec<f64>,
    /// Pose after pose: B, shared x own, row-major.
    cross: Vec<f64>,
    covariance: &'a DMatrix<f64>,
    kinds: Vec<Kind>,
    /// Products of one row.
    sums: Vec<f64>,
}

/// Rows with the same shared unknowns.
struct Kind {
    places: Vec<usize>,
    /// Their covariance, lower triangle in rows of full width, what is beside the diagonal doubled.
    covariance: Vec<f64>,
}

impl<'a> Leverages<'a> {
    pub(super) fn new(reduced: &Reduced, covariance: &'a DMatrix<f64>) -> Self {
        let own = reduced.own;
        let (shared, columns) = reduced.coupling.shape();
        let coupling = reduced.coupling.as_slice();
        // C' V: a column for each shared unknown, in which a pose's own ones are neighbours.
        let mut spread = DMatrix::zeros(columns, shared);
        spread.gemm(1.0, &turned(coupling, shared, columns), covariance, 0.0);
        let mut out = Self {
            own,
            shared,
            own_covariance: Vec::with_capacity(columns * own),
            cross: Vec::with_capacity(columns * shared),
            covariance,
            kinds: Vec::new(),
            sums: Vec::new(),
        };
        let size = own * own;
        let mut middle = DMatrix::zeros(own, own);
        for (k, factor) in reduced.factors.chunks_exact(size).enumerate() {
            let inverses = &mut [0.0; OWN_MAX][..own];
            for (a, inverse) in inverses.iter_mut().enumerate() {
                *inverse = 1.0 / factor[a * own + a];
            }
            let piece = spread.rows(k * own, own).into_owned();
            let of_pose = &coupling[k * own * shared..(k + 1) * own * shared];
            // 1 + C' V C.
            middle.fill_with_identity();
            middle.gemm(
                1.0,
                &turned(of_pose, shared, own),
                &turned(piece.as_slice(), own, shared),
                1.0,
            );
            let first = out.cross.len();
            out.cross.extend_from_slice(piece.as_slice());
            for line in out.cross[first..].chunks_exact_mut(own) {
                divide(line, factor, inverses);
            }
            // It is symmetric, so that both sides are the same division, of rows and then of columns.
            for _ in 0..2 {
                for line in middle.as_mut_slice().chunks_exact_mut(own) {
                    divide(line, factor, inverses);
                }
                middle.transpose_mut();
            }
            out.own_covariance.extend_from_slice(middle.as_slice());
        }
        out
    }

    /// Variance of a row's prediction, in the row's variances: 1 means that the estimate follows the measurement
    /// completely, 0 that it does not depend on it.
    pub(super) fn of(&mut self, k: usize, row: &Row<'_>) -> f64 {
        let own = self.own;
        let kind = self.kind(row);
        let size = row.shared.len();
        self.sums.clear();
        self.sums.resize(size, 0.0);
        let cross = &self.cross[k * own * self.shared..(k + 1) * own * self.shared];
        let between = &mut [0.0; OWN_MAX][..own];
        let covariance = &self.kinds[kind].covariance;
        for (i, entry) in row.shared.iter().enumerate() {
            let line = &covariance[i * size..=i * size + i];
            for (slot, other) in self.sums.iter_mut().zip(line) {
                *slot += entry.slope * other;
            }
            let line = &cross[entry.at * own..(entry.at + 1) * own];
            for (slot, other) in between.iter_mut().zip(line) {
                *slot -= 2.0 * entry.slope * other;
            }
        }
        let covariance = &self.own_covariance[k * own * own..(k + 1) * own * own];
        for (value, line) in row.own.iter().zip(covariance.chunks_exact(own)) {
            if *value != 0.0 {
                for (slot, other) in between.iter_mut().zip(line) {
                    *slot += value * other;
                }
            }
        }
        let of_shared: f64 = (row.shared.iter().zip(&self.sums))
            .map(|(entry, sum)| entry.slope * sum)
            .sum();
        let of_own: f64 = row.own.iter().zip(&*between).map(|(x, y)| x * y).sum();
        of_shared + of_own
    }

    /// Number of the row's kind, which is added if it is new.
    fn kind(&mut self, row: &Row<'_>) -> usize {
        let places = || row.shared.iter().map(|entry| entry.at);
        let known = |kind: &Kind| kind.places.iter().copied().eq(places());
        if let Some(found) = self.kinds.iter().position(known) {
            return found;
        }
        let places: Vec<usize> = places().collect();
        let mut covariance = vec![0.0; places.len() * places.len()];
        for (a, &i) in places.iter().enumerate() {
            for (b, &j) in places[..=a].iter().enumerate() {
                let times = if a == b { 1.0 } else { 2.0 };
                covariance[a * places.len() + b] = times * self.covariance[(i, j)];
            }
        }
        self.kinds.push(Kind { places, covariance });
        self.kinds.len() - 1
    }
}

/// A row vector times L^-1, in place.
fn divide(line: &mut [f64], factor: &[f64], inverses: &[f64]) {
    let own = line.len();
    for j in (0..own).rev() {
        let value = line[j] * inverses[j];
        line[j] = value;
        for (slot, other) in line[..j].iter_mut().zip(&factor[j * own..j * own + j]) {
            *slot -= value * other;
        }
    }
}
