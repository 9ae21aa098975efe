//! A X = Y B for rigid transformations: Kronecker product and singular value decomposition (paper,
//! Eqs. 27-39; Li, Wang and Wu, 2010).

use super::pnp::nearest_rotation;
use mcdpr_kinematics::Pose;
use nalgebra::{DMatrix, DVector, Matrix3};

/// X and Y of A X = Y B from pairs (A, B). `None` with fewer than three pairs or if they do not
/// determine the answer.
///
/// Rotations: with x = (vec X, vec Y) the pairs give K x = 0; x is the right singular vector of the
/// least singular value, of either sign and any scale. Its sign is fixed by the determinant, its
/// scale by the projection onto SO(3). Translations follow by least squares.
#[must_use]
pub fn solve(pairs: &[(Pose, Pose)]) -> Option<(Pose, Pose)> {
    // Two motions about different axes are needed: three poses.
    if pairs.len() < 3 {
        return None;
    }
    // Row-major vec: vec(A X) = (A kron I) vec X, vec(Y B) = (I kron B^T) vec Y.
    let mut k = DMatrix::zeros(9 * pairs.len(), 18);
    for (n, (a, b)) in pairs.iter().enumerate() {
        let (ra, rb) = (a.rotation.matrix(), b.rotation.matrix());
        for i in 0..3 {
            for j in 0..3 {
                for m in 0..3 {
                    k[(9 * n + 3 * i + j, 3 * m + j)] = ra[(i, m)];
                    k[(9 * n + 3 * i + j, 9 + 3 * i + m)] = -rb[(m, j)];
                }
            }
        }
    }
    let svd = k.svd(false, true);
    let mut order: Vec<usize> = (0..18).collect();
    order.sort_by(|&p, &q| svd.singular_values[p].total_cmp(&svd.singular_values[q]));
    // A second solution that fits equally well: the rotations are not determined.
    if svd.singular_values[order[1]] < 1e-6 * svd.singular_values[order[17]] {
        return None;
    }
    let x = svd.v_t?.row(order[0]).transpose();
    let matrix = |at: usize| Matrix3::from_fn(|i, j| x[at + 3 * i + j]);
    let (mut rx, mut ry) = (matrix(0), matrix(9));
    if rx.determinant() < 0.0 {
        (rx, ry) = (-rx, -ry);
    }
    let (rx, ry) = (nearest_rotation(&rx)?, nearest_rotation(&ry)?);
    let mut q = DMatrix::zeros(3 * pairs.len(), 6);
    let mut rhs = DVector::zeros(3 * pairs.len());
    for (n, (a, b)) in pairs.iter().enumerate() {
        q.view_mut((3 * n, 0), (3, 3))
            .copy_from(a.rotation.matrix());
        q.view_mut((3 * n, 3), (3, 3))
            .copy_from(&-Matrix3::identity());
        rhs.rows_mut(3 * n, 3)
            .copy_from(&(ry * b.position_m - a.position_m));
    }
    let t = q.svd(true, true).solve(&rhs, 1e-12).ok()?;
    Some((
        Pose::new(t.fixed_rows::<3>(0).into_owned(), rx),
        Pose::new(t.fixed_rows::<3>(3).into_owned(), ry),
    ))
}

#[cfg(test)]
mod tests {

    use super::*;
    use nalgebra::Vector3;

    fn pose(seed: f64) -> Pose {
        let f = |k: f64| (seed * 12.9898 + k * 78.233).sin();
        Pose::from_rpy(
            Vector3::new(f(1.0), f(2.0), f(3.0)),
            [f(4.0), f(5.0), 2.0 * f(6.0)],
        )
    }

    #[test]
    fn finds_both_transformations() {
        let (x, y) = (pose(0.3), pose(0.7));
        // A X = Y B: A = Y B X^-1.
        let pairs: Vec<_> = (1..8)
            .map(|n| pose(f64::from(n)))
            .map(|b| (y.compose(&b).compose(&x.inverse()), b))
            .collect();
        let (found_x, found_y) = solve(&pairs).unwrap();
        for (found, wanted) in [(found_x, x), (found_y, y)] {
            assert!((found.position_m - wanted.position_m).norm() < 1e-12);
            assert!((found.rotation.matrix() - wanted.rotation.matrix()).norm() < 1e-12);
        }
    }

    #[test]
    fn one_axis_is_refused() {
        let (x, y) = (pose(0.3), pose(0.7));
        let pairs: Vec<_> = (1..8)
            .map(|n| Pose::from_rpy(Vector3::x(), [0.0, 0.0, f64::from(n) * 0.2]))
            .map(|b| (y.compose(&b).compose(&x.inverse()), b))
            .collect();
        assert!(solve(&pairs).is_none());
    }
}
