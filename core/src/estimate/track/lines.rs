//! Rows of numbers in one piece of memory, and their reduction to a triangle.

/// Rows of equal width.
#[derive(Debug, Clone)]
pub(super) struct Lines {
    width: usize,
    values: Vec<f64>,
}

impl Lines {
    pub(super) fn new(width: usize) -> Self {
        Self {
            width,
            values: Vec::with_capacity(32 * width),
        }
    }

    /// Appends a row of zeros; its index, and the row.
    pub(super) fn push(&mut self) -> (usize, &mut [f64]) {
        let index = self.count();
        self.values.resize(self.values.len() + self.width, 0.0);
        (index, self.row_mut(index))
    }

    pub(super) fn count(&self) -> usize {
        self.values.len() / self.width
    }

    pub(super) fn row(&self, index: usize) -> &[f64] {
        &self.values[index * self.width..][..self.width]
    }

    pub(super) fn row_mut(&mut self, index: usize) -> &mut [f64] {
        &mut self.values[index * self.width..][..self.width]
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = &[f64]> {
        self.values.chunks_exact(self.width)
    }

    pub(super) fn iter_mut(&mut self) -> impl Iterator<Item = &mut [f64]> {
        self.values.chunks_exact_mut(self.width)
    }

    /// The rows, each followed by its row of the unit matrix: after [`Self::triangulate`] these columns are the
    /// reflections that were made.
    pub(super) fn with_unit(&self) -> Self {
        let count = self.count();
        let mut out = Self {
            width: self.width + count,
            values: vec![0.0; count * (self.width + count)],
        };
        for (index, (row, old)) in out.iter_mut().zip(self.iter()).enumerate() {
            row[..old.len()].copy_from_slice(old);
            row[old.len() + index] = 1.0;
        }
        out
    }

    /// Householder's reflections that make the first `columns` of the rows upper triangular; all columns follow.
    /// `false` where these columns have no full rank.
    pub(super) fn triangulate(&mut self, columns: usize) -> bool {
        let width = self.width;
        let mut mirror = vec![0.0; self.count()];
        let mut sums = vec![0.0; width];
        if self.count() < columns {
            return false;
        }
        for column in 0..columns {
            let mirror = &mut mirror[column..];
            let rows = &mut self.values[column * width..];
            for (slot, row) in mirror.iter_mut().zip(rows.chunks_exact(width)) {
                *slot = row[column];
            }
            let length = mirror.iter().map(|v| v * v).sum::<f64>().sqrt();
            if length.is_nan() || length <= 1e-9 {
                return false;
            }
            mirror[0] += if mirror[0] > 0.0 { length } else { -length };
            let scale = 2.0 / mirror.iter().map(|v| v * v).sum::<f64>();
            let sums = &mut sums[column..];
            sums.fill(0.0);
            for (row, factor) in rows.chunks_exact(width).zip(mirror.iter()) {
                for (sum, value) in sums.iter_mut().zip(&row[column..]) {
                    *sum += factor * value;
                }
            }
            for (row, factor) in rows.chunks_exact_mut(width).zip(mirror.iter()) {
                let factor = scale * factor;
                for (value, sum) in row[column..].iter_mut().zip(sums.iter()) {
                    *value -= factor * sum;
                }
            }
        }
        true
    }

    /// Solves the triangle of the first `unknowns` rows and columns for the column that follows them.
    pub(super) fn solved(&self, unknowns: usize) -> Vec<f64> {
        let mut out = vec![0.0; unknowns];
        for index in (0..unknowns).rev() {
            let row = self.row(index);
            let sum: f64 = (index + 1..unknowns).map(|k| row[k] * out[k]).sum();
            out[index] = (row[unknowns] - sum) / row[index];
        }
        out
    }
}
