//! Small dense solvers: Cholesky of a fixed size, and Gaussian elimination of a run-time size.

use crate::math::sqrt;

/// Lower Cholesky factor in place (the lower triangle of `a` is read); the diagonal is stored
/// inverted. `false` if the matrix is not positive definite (or holds NaN).
#[inline(always)]
pub(crate) fn cholesky<const K: usize>(a: &mut [[f64; K]; K]) -> bool {
    for j in 0..K {
        let mut d = a[j][j];
        // A pivot that has lost fifteen digits is rounding: the matrix is singular.
        let floor = d * 1e-15;
        for k in 0..j {
            d -= a[j][k] * a[j][k];
        }
        if !(d > floor) {
            return false;
        }
        let inv = 1.0 / sqrt(d);
        a[j][j] = inv;
        for i in j + 1..K {
            let mut s = a[i][j];
            for k in 0..j {
                s -= a[i][k] * a[j][k];
            }
            a[i][j] = s * inv;
        }
    }
    true
}

/// Solves L L^T x = b in place with the factor of [`cholesky`].
#[inline(always)]
pub(crate) fn cholesky_solve<const K: usize>(l: &[[f64; K]; K], b: &mut [f64; K]) {
    for i in 0..K {
        let mut s = b[i];
        for k in 0..i {
            s -= l[i][k] * b[k];
        }
        b[i] = s * l[i][i];
    }
    for i in (0..K).rev() {
        let mut s = b[i];
        for k in i + 1..K {
            s -= l[k][i] * b[k];
        }
        b[i] = s * l[i][i];
    }
}

/// Largest system of [`eliminate`]: six degrees of freedom and sixteen cables.
pub(crate) const DENSE: usize = 22;

/// Solves the leading `n` x `n` system for `m` right-hand sides (columns `n..n+m` of the rows) by
/// Gaussian elimination with row scaling and partial pivoting. `false` if singular to 1e-13.
pub(crate) fn eliminate<const W: usize>(a: &mut [[f64; W]; DENSE], n: usize, m: usize) -> bool {
    let width = n + m;
    // Rows have different units (N, N m, m): scaled, their pivots can be compared.
    for row in a.iter_mut().take(n) {
        let scale = row[..n].iter().fold(0.0_f64, |s, x| s.max(x.abs()));
        if !(scale > 0.0 && scale.is_finite()) {
            return false;
        }
        for x in row[..width].iter_mut() {
            *x /= scale;
        }
    }
    for j in 0..n {
        let pivot = (j..n).fold(j, |p, i| if a[i][j].abs() > a[p][j].abs() { i } else { p });
        if !(a[pivot][j].abs() > 1e-13) {
            return false;
        }
        a.swap(j, pivot);
        let row = a[j];
        for i in j + 1..n {
            let f = a[i][j] / row[j];
            for k in j..width {
                a[i][k] -= f * row[k];
            }
        }
    }
    for j in (0..n).rev() {
        for k in n..width {
            let mut s = a[j][k];
            for i in j + 1..n {
                s -= a[j][i] * a[i][k];
            }
            a[j][k] = s / a[j][j];
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cholesky_solves_and_refuses() {
        let mut a = [[4.0, 0.0, 0.0], [2.0, 5.0, 0.0], [-1.0, 0.5, 3.0]];
        assert!(cholesky(&mut a));
        // Right-hand side of x = (1, 2, 3): rows (4 2 -1), (2 5 .5), (-1 .5 3).
        let mut b = [5.0, 13.5, 9.0];
        cholesky_solve(&a, &mut b);
        for (got, want) in b.iter().zip([1.0, 2.0, 3.0]) {
            assert!((got - want).abs() < 1e-14);
        }
        let mut indefinite = [[1.0, 0.0], [2.0, 1.0]];
        assert!(!cholesky(&mut indefinite));
        let mut nan = [[f64::NAN; 2]; 2];
        assert!(!cholesky(&mut nan));
    }

    #[test]
    fn elimination_pivots() {
        let mut a = [[0.0; 24]; DENSE];
        a[0][..4].copy_from_slice(&[0.0, 2.0, 4.0, 1.0]);
        a[1][..4].copy_from_slice(&[3.0, 1.0, 5.0, 3.0]);
        assert!(eliminate(&mut a, 2, 2));
        // 2y = 4, 3x + y = 5; and 2y = 1, 3x + y = 3.
        let got = [a[0][2], a[1][2], a[0][3], a[1][3]];
        for (g, w) in got.iter().zip([1.0, 2.0, 5.0 / 6.0, 0.5]) {
            assert!((g - w).abs() < 1e-15);
        }
        let mut singular = [[1.0; 24]; DENSE];
        assert!(!eliminate(&mut singular, 2, 1));
    }
}
