//! The normal equations A A^T v = b of a tension distribution, for six equations in blocks of three.
//!
//! A Cholesky factor of six rows is a chain of six square roots and divisions, and solving with it one of twelve steps,
//! each of which waits for the one before. Blocks of three (forces and moments) are inverted by their cofactors: two
//! divisions in all, and products that do not wait for each other (Schur complement; Zhang, 2005). Cofactors lose as many
//! digits as the block is nearly singular, so that such a matrix is left to the factor.

use super::gram;
use crate::linear::{cholesky, cholesky_solve};

/// Least determinant of a block as a share of its greatest possible one, the product of its diagonal: four of sixteen
/// digits may be lost.
const LEAST: f64 = 1e-4;

type Three = [[f64; 3]; 3];

/// A A^T, ready to solve with.
// Blocks are of six equations, whose factor is larger still.
#[allow(clippy::large_enum_variant)]
pub(super) enum Normal<const K: usize> {
    /// Six equations, far from singular.
    Blocks(Blocks),
    /// The factor of [`cholesky`].
    Factor([[f64; K]; K]),
}

/// Inverse of [P Q^T; Q R].
pub(super) struct Blocks {
    /// P^-1.
    first: Three,
    /// Q P^-1.
    across: Three,
    /// (R - Q P^-1 Q^T)^-1.
    rest: Three,
}

impl<const K: usize> Normal<K> {
    /// Of a `K` x `N` matrix; `None` if it is singular or not finite.
    #[inline(always)]
    pub(super) fn new<const N: usize>(a: &[[f64; N]; K]) -> Option<Self> {
        if let Some(blocks) = Blocks::new(a) {
            return Some(Self::Blocks(blocks));
        }
        let mut factor = gram(a, &[1.0; N]);
        cholesky(&mut factor).then_some(Self::Factor(factor))
    }

    /// Solves A A^T x = b in place.
    #[inline(always)]
    pub(super) fn solve(&self, b: &mut [f64; K]) {
        match self {
            Self::Blocks(blocks) => blocks.solve(b),
            Self::Factor(factor) => cholesky_solve(factor, b),
        }
    }
}

impl Blocks {
    #[inline(always)]
    fn new<const K: usize, const N: usize>(a: &[[f64; N]; K]) -> Option<Self> {
        let a: &[[f64; N]; 6] = a[..].try_into().ok()?;
        let product = |r: usize, c: usize| dot(&a[r], &a[c]);
        let symmetric = |at: usize| {
            let [xx, xy, xz] = [0, 1, 2].map(|c| product(at, at + c));
            let [yy, yz] = [1, 2].map(|c| product(at + 1, at + c));
            [
                [xx, xy, xz],
                [xy, yy, yz],
                [xz, yz, product(at + 2, at + 2)],
            ]
        };
        let (p, r) = (symmetric(0), symmetric(3));
        let q: Three = core::array::from_fn(|i| core::array::from_fn(|j| product(3 + i, j)));
        let first = inverse(&p, &p)?;
        let across: Three = q.map(|row| times(&first, &row));
        let mut left = r;
        for i in 0..3 {
            for j in 0..=i {
                left[i][j] -= inner(&across[i], &q[j]);
                left[j][i] = left[i][j];
            }
        }
        let rest = inverse(&left, &r)?;
        Some(Self {
            first,
            across,
            rest,
        })
    }

    #[inline(always)]
    fn solve<const K: usize>(&self, b: &mut [f64; K]) {
        let [b0, b1, b2, b3, b4, b5, ..] = b[..] else {
            return;
        };
        let upper = [b0, b1, b2];
        let known = times(&self.across, &upper);
        let lower = times(&self.rest, &[b3 - known[0], b4 - known[1], b5 - known[2]]);
        let alone = times(&self.first, &upper);
        for j in 0..3 {
            let by_lower = self.across[0][j] * lower[0]
                + self.across[1][j] * lower[1]
                + self.across[2][j] * lower[2];
            b[j] = alone[j] - by_lower;
            b[3 + j] = lower[j];
        }
    }
}

/// In two sums, which need not wait for each other.
#[inline(always)]
fn dot<const N: usize>(x: &[f64; N], y: &[f64; N]) -> f64 {
    let mut sums = [0.0; 2];
    for i in 0..N / 2 {
        sums[0] += x[2 * i] * y[2 * i];
        sums[1] += x[2 * i + 1] * y[2 * i + 1];
    }
    if N % 2 == 1 {
        sums[0] += x[N - 1] * y[N - 1];
    }
    sums[0] + sums[1]
}

#[inline(always)]
fn inner(x: &[f64; 3], y: &[f64; 3]) -> f64 {
    x[0] * y[0] + x[1] * y[1] + x[2] * y[2]
}

#[inline(always)]
fn times(m: &Three, x: &[f64; 3]) -> [f64; 3] {
    [inner(&m[0], x), inner(&m[1], x), inner(&m[2], x)]
}

/// Inverse of a symmetric positive definite matrix by its cofactors; `None` if it is nearly singular beside `whole`, the
/// matrix that it was before other unknowns were eliminated.
#[inline(always)]
fn inverse(m: &Three, whole: &Three) -> Option<Three> {
    let [[a, b, c], [_, d, e], [_, _, f]] = *m;
    let (xx, xy, xz) = (d * f - e * e, c * e - b * f, b * e - c * d);
    let determinant = a * xx + b * xy + c * xz;
    // Not a number is not greater either.
    if !(determinant > LEAST * (whole[0][0] * whole[1][1] * whole[2][2])) {
        return None;
    }
    let by = 1.0 / determinant;
    let (yy, yz, zz) = (a * f - c * c, b * c - a * e, a * d - b * b);
    let (xx, xy, xz, yy, yz, zz) = (xx * by, xy * by, xz * by, yy * by, yz * by, zz * by);
    Some([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn blocks_solve_as_the_factor_does_and_leave_nearly_singular_matrices_to_it() {
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let (mut blocks, mut factors) = (0, 0);
        for case in 0..2000 {
            let mut a: [[f64; 8]; 6] =
                core::array::from_fn(|_| core::array::from_fn(|_| random.random_range(-1.0..1.0)));
            if case % 4 == 0 {
                // Two rows that are nearly one.
                for i in 0..8 {
                    a[5][i] = a[case / 4 % 5][i] + 1e-3 * a[5][i];
                }
            }
            let b: [f64; 6] = core::array::from_fn(|_| random.random_range(-1.0..1.0));
            let normal = Normal::new(&a).unwrap();
            match normal {
                Normal::Blocks(_) => blocks += 1,
                Normal::Factor(_) => factors += 1,
            }
            let mut ours = b;
            normal.solve(&mut ours);
            let mut factor = gram(&a, &[1.0; 8]);
            assert!(cholesky(&mut factor));
            let mut theirs = b;
            cholesky_solve(&factor, &mut theirs);
            let size = theirs.iter().fold(0.0_f64, |most, x| most.max(x.abs()));
            for (x, y) in ours.iter().zip(&theirs) {
                assert!((x - y).abs() < 1e-10 * size, "{ours:?} {theirs:?}");
            }
        }
        assert!(blocks > 1000 && factors >= 500, "{blocks} {factors}");
        let mut a = [[0.5; 8]; 6];
        assert!(Normal::new(&a).is_none());
        a[0][0] = f64::NAN;
        assert!(Normal::new(&a).is_none());
    }
}
