//! Small fixed-size vector, quaternion and matrix arithmetic.
//!
//! The substep runs ten thousand times per simulated second, also in unoptimised test builds,
//! so these are plain functions over arrays rather than a generic linear algebra type.

/// A vector of three components.
pub(crate) type V3 = [f64; 3];
/// A 3x3 matrix, row by row.
pub(crate) type M3 = [[f64; 3]; 3];
/// A quaternion `[w, x, y, z]`.
pub(crate) type Q = [f64; 4];

#[inline(always)]
pub(crate) fn add(a: V3, b: V3) -> V3 {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

#[inline(always)]
pub(crate) fn sub(a: V3, b: V3) -> V3 {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline(always)]
pub(crate) fn scale(a: V3, s: f64) -> V3 {
    [a[0] * s, a[1] * s, a[2] * s]
}

/// `a + s b`.
#[inline(always)]
pub(crate) fn axpy(a: V3, s: f64, b: V3) -> V3 {
    [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]]
}

#[inline(always)]
pub(crate) fn dot(a: V3, b: V3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
pub(crate) fn cross(a: V3, b: V3) -> V3 {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

#[inline(always)]
pub(crate) fn norm(a: V3) -> f64 {
    dot(a, a).sqrt()
}

/// `m v`.
#[inline(always)]
pub(crate) fn mul(m: &M3, v: V3) -> V3 {
    [dot(m[0], v), dot(m[1], v), dot(m[2], v)]
}

/// `m^T v`.
#[inline(always)]
pub(crate) fn mul_t(m: &M3, v: V3) -> V3 {
    [
        m[0][0] * v[0] + m[1][0] * v[1] + m[2][0] * v[2],
        m[0][1] * v[0] + m[1][1] * v[1] + m[2][1] * v[2],
        m[0][2] * v[0] + m[1][2] * v[1] + m[2][2] * v[2],
    ]
}

/// Hamilton product `a b`.
#[inline(always)]
pub(crate) fn q_mul(a: Q, b: Q) -> Q {
    [
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    ]
}

#[inline(always)]
pub(crate) fn q_conj(a: Q) -> Q {
    [a[0], -a[1], -a[2], -a[3]]
}

#[inline(always)]
pub(crate) fn q_normalised(a: Q) -> Q {
    let s = 1.0 / (a[0] * a[0] + a[1] * a[1] + a[2] * a[2] + a[3] * a[3]).sqrt();
    [a[0] * s, a[1] * s, a[2] * s, a[3] * s]
}

/// Rotation matrix of a unit quaternion.
#[inline(always)]
pub(crate) fn q_matrix(q: Q) -> M3 {
    let [w, x, y, z] = q;
    [
        [
            1.0 - 2.0 * (y * y + z * z),
            2.0 * (x * y - w * z),
            2.0 * (x * z + w * y),
        ],
        [
            2.0 * (x * y + w * z),
            1.0 - 2.0 * (x * x + z * z),
            2.0 * (y * z - w * x),
        ],
        [
            2.0 * (x * z - w * y),
            2.0 * (y * z + w * x),
            1.0 - 2.0 * (x * x + y * y),
        ],
    ]
}

/// Unit quaternion of a rotation matrix (the branch with the largest component, so that the
/// division is never by a small number; Shepperd 1978).
pub(crate) fn q_from_matrix(m: &M3) -> Q {
    let trace = m[0][0] + m[1][1] + m[2][2];
    let candidates = [trace, m[0][0], m[1][1], m[2][2]];
    let mut best = 0;
    for (i, c) in candidates.iter().enumerate() {
        if *c > candidates[best] {
            best = i;
        }
    }
    let q = match best {
        0 => [
            1.0 + trace,
            m[2][1] - m[1][2],
            m[0][2] - m[2][0],
            m[1][0] - m[0][1],
        ],
        1 => [
            m[2][1] - m[1][2],
            1.0 + 2.0 * m[0][0] - trace,
            m[0][1] + m[1][0],
            m[0][2] + m[2][0],
        ],
        2 => [
            m[0][2] - m[2][0],
            m[0][1] + m[1][0],
            1.0 + 2.0 * m[1][1] - trace,
            m[1][2] + m[2][1],
        ],
        _ => [
            m[1][0] - m[0][1],
            m[0][2] + m[2][0],
            m[1][2] + m[2][1],
            1.0 + 2.0 * m[2][2] - trace,
        ],
    };
    q_normalised(q)
}

/// Eigenvalues and a right-handed orthonormal eigenbasis (columns) of a symmetric matrix, by
/// cyclic Jacobi rotations.
pub(crate) fn symmetric_eigen(m: &M3) -> (V3, M3) {
    let mut a = *m;
    let mut basis: M3 = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    // Jacobi sweeps converge quadratically, within some five; 32 is only a bound.
    for _ in 0..32 {
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            if a[p][q] == 0.0 {
                continue;
            }
            // The angle that makes a_pq zero: tan(2 angle) = 2 a_pq / (a_qq - a_pp).
            let angle = 0.5 * libm::atan2(2.0 * a[p][q], a[q][q] - a[p][p]);
            let (s, c) = libm::sincos(angle);
            // Rotate rows and columns p and q of `a`, and columns p and q of the basis.
            for row in &mut a {
                (row[p], row[q]) = (c * row[p] - s * row[q], s * row[p] + c * row[q]);
            }
            let (row_p, row_q) = (a[p], a[q]);
            a[p] = axpy(scale(row_p, c), -s, row_q);
            a[q] = axpy(scale(row_p, s), c, row_q);
            for row in &mut basis {
                (row[p], row[q]) = (c * row[p] - s * row[q], s * row[p] + c * row[q]);
            }
        }
    }
    // Rotations keep the determinant at +1, so the basis is right-handed by construction.
    ([a[0][0], a[1][1], a[2][2]], basis)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eigenbasis_reproduces_the_matrix() {
        let m: M3 = [[2.0, 0.3, -0.4], [0.3, 1.5, 0.2], [-0.4, 0.2, 1.1]];
        let (values, basis) = symmetric_eigen(&m);
        for i in 0..3 {
            for j in 0..3 {
                let back: f64 = (0..3).map(|k| basis[i][k] * values[k] * basis[j][k]).sum();
                assert!((back - m[i][j]).abs() < 1e-14, "{i}{j}: {back}");
            }
        }
        let columns: Vec<V3> = (0..3)
            .map(|k| [basis[0][k], basis[1][k], basis[2][k]])
            .collect();
        assert!((dot(cross(columns[0], columns[1]), columns[2]) - 1.0).abs() < 1e-14);
    }

    #[test]
    fn quaternion_and_matrix_agree_in_every_branch() {
        for q in [
            [0.9, 0.1, -0.2, 0.3],
            [0.1, 0.9, 0.2, -0.3],
            [-0.1, 0.2, 0.9, 0.3],
            [0.1, -0.2, 0.3, 0.9],
        ] {
            let q = q_normalised(q);
            let back = q_from_matrix(&q_matrix(q));
            let same = q.iter().zip(back).map(|(a, b)| a * b).sum::<f64>().abs();
            assert!((same - 1.0).abs() < 1e-14);
        }
    }
}
