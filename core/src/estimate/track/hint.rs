//! What the rows of a rest say of anchors that may have moved.

use super::gaussian::{Lesson, Linear, dot};
use nalgebra::{DMatrix, Matrix3, Vector3};

/// What rows say of three states that may have moved: information, and information times the move.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Hint {
    information: Matrix3<f64>,
    moved: Vector3<f64>,
}

impl Hint {
    pub(super) fn none() -> Self {
        Self {
            information: Matrix3::zeros(),
            moved: Vector3::zeros(),
        }
    }

    pub(super) fn with(self, other: &Self) -> Self {
        Self {
            information: self.information + other.information,
            moved: self.moved + other.moved,
        }
    }

    /// Sum of squares that a move explains, at most: chi-squared of three without one. Directions known less than a move of
    /// `sigma` do not count.
    pub(super) fn explains(&self, sigma: f64) -> f64 {
        let known = self.information + Matrix3::identity() / (sigma * sigma);
        let move_by = known.cholesky().map(|factor| factor.solve(&self.moved));
        move_by.map_or(0.0, |by| self.moved.dot(&by))
    }
}

impl Linear {
    /// What these rows said, with `lesson`, of a move of three states each, from each of `firsts` on.
    pub(super) fn hints(&self, lesson: &Lesson, firsts: &[usize]) -> Vec<Hint> {
        let rows = self.residual.len();
        let mut white = DMatrix::from_fn(rows, 3 * firsts.len(), |row, column| {
            self.slope(row, firsts[column / 3] + column % 3)
        });
        if !lesson.factor.solve_lower_triangular_mut(&mut white) {
            return Vec::new();
        }
        let columns = white.as_slice().chunks_exact(3 * rows);
        let hint = |three: &[f64]| {
            let by = |k: usize| &three[k * rows..(k + 1) * rows];
            Hint {
                information: Matrix3::from_fn(|i, j| dot(by(i), by(j))),
                moved: Vector3::from_fn(|i, _| dot(by(i), lesson.white.as_slice())),
            }
        };
        columns.map(hint).collect()
    }
}
