//! Rows with the same shared unknowns in all poses, as those of equilibrium: their part of the normal equations is
//! summed as a dense product, and not entry by entry.

use super::rows::{OWN_MAX, Row};
use nalgebra::{DMatrix, DMatrixView, Dyn};

/// The rows so far.
pub(super) struct Alike {
    /// Index of each shared unknown; empty before the first row.
    places: Vec<usize>,
    /// Row after row, times the root of its weight: derivatives by the shared unknowns, then the residual.
    rows: Vec<f64>,
    /// The same by the own unknowns of the present pose, padded with zeros.
    own: Vec<[f64; OWN_MAX]>,
    /// Sums for one own unknown, in the order of `places`, then its gradient.
    line: Vec<f64>,
}

/// Slots of the normal equations of one pose.
pub(super) struct PoseSlots<'a> {
    /// own x own, row-major, lower triangle.
    pub h: &'a mut [f64],
    /// Gradient.
    pub g: &'a mut [f64],
    /// own rows of as many numbers as there are shared unknowns.
    pub cross: &'a mut [f64],
}

impl Alike {
    pub(super) const fn new() -> Self {
        Self {
            places: Vec::new(),
            rows: Vec::new(),
            own: Vec::new(),
            line: Vec::new(),
        }
    }

    /// Adds a row; its shared unknowns are those of the first one, in the same order, each once.
    pub(super) fn add(&mut self, row: &Row<'_>, weight: f64) {
        if self.places.is_empty() {
            self.places.extend(row.shared.iter().map(|entry| entry.at));
        }
        debug_assert!(
            self.places
                .iter()
                .copied()
                .eq(row.shared.iter().map(|entry| entry.at)),
            "rows alike have the same unknowns"
        );
        let root = weight.sqrt();
        self.rows
            .extend(row.shared.iter().map(|entry| entry.slope * root));
        self.rows.push(row.residual * root);
        let mut own = [0.0; OWN_MAX];
        for (slot, value) in own.iter_mut().zip(row.own) {
            *slot = value * root;
        }
        self.own.push(own);
    }

    /// Adds what the rows since the last call say of one pose.
    pub(super) fn flush_pose(&mut self, slots: &mut PoseSlots<'_>) {
        if self.own.is_empty() {
            return;
        }
        let (own, width) = (slots.g.len(), self.places.len() + 1);
        let first = self.rows.len() - self.own.len() * width;
        let rows = &self.rows[first..];
        for a in 0..own {
            self.line.clear();
            self.line.resize(width, 0.0);
            let h = &mut slots.h[a * own..=a * own + a];
            for (row, values) in self.own.iter().zip(rows.chunks_exact(width)) {
                let value = row[a];
                for (slot, other) in h.iter_mut().zip(row) {
                    *slot += value * other;
                }
                for (slot, other) in self.line.iter_mut().zip(values) {
                    *slot += value * other;
                }
            }
            let shared = slots.cross.len() / own;
            let cross = &mut slots.cross[a * shared..(a + 1) * shared];
            for (&at, sum) in self.places.iter().zip(&self.line) {
                cross[at] += sum;
            }
            slots.g[a] += self.line[width - 1];
        }
        self.own.clear();
    }

    /// Adds what all rows say of the shared unknowns (lower triangle, row-major, and the gradient); gives their weighted
    /// sum of squares.
    pub(super) fn flush_shared(self, h: &mut [f64], g: &mut [f64]) -> f64 {
        let width = self.places.len() + 1;
        let count = self.rows.len() / width;
        if count == 0 {
            return 0.0;
        }
        let columns = DMatrixView::from_slice(&self.rows, width, count);
        let turned = turned(&self.rows, width, count);
        let mut sums = DMatrix::zeros(width, width);
        sums.gemm(1.0, &columns, &turned, 0.0);
        for (c, &i) in self.places.iter().enumerate() {
            g[i] += sums[(width - 1, c)];
            for (d, &j) in self.places[..=c].iter().enumerate() {
                h[i.max(j) * g.len() + i.min(j)] += sums[(c, d)];
            }
        }
        sums[(width - 1, width - 1)]
    }
}

/// A matrix given column by column, read as its transpose (`columns` x `rows`) without a copy.
pub(super) fn turned(
    values: &[f64],
    rows: usize,
    columns: usize,
) -> DMatrixView<'_, f64, Dyn, Dyn> {
    DMatrixView::from_slice_with_strides_generic(values, Dyn(columns), Dyn(rows), Dyn(rows), Dyn(1))
}
