//! Normal distribution of the slow states, and its update by rows with unit noise.

/// Mean and covariance.
#[derive(Debug, Clone)]
pub(super) struct Gaussian {
    pub(super) mean: Vec<f64>,
    /// Row by row; symmetric.
    pub(super) covariance: Vec<f64>,
}

/// Rows `residual + slopes (x - at) + noise = 0`, the noise of unit variance.
#[derive(Debug, Clone)]
pub(super) struct Linear {
    pub(super) at: Vec<f64>,
    pub(super) residual: Vec<f64>,
    /// One row of slopes per residual.
    pub(super) slopes: Vec<Vec<f64>>,
}

/// How well rows fitted before they were used.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Fit {
    /// Sum of squared innovations over their variance.
    pub(super) squares: f64,
    /// Logarithm of the determinant of the innovations' covariance.
    pub(super) log_volume: f64,
    pub(super) rows: usize,
}

impl Fit {
    /// Logarithm of the likelihood, without its constant.
    pub(super) fn log_likelihood(&self) -> f64 {
        -0.5 * (self.squares + self.log_volume)
    }

    pub(super) fn with(self, other: Self) -> Self {
        Self {
            squares: self.squares + other.squares,
            log_volume: self.log_volume + other.log_volume,
            rows: self.rows + other.rows,
        }
    }
}

impl Gaussian {
    pub(super) fn new(mean: Vec<f64>, sigmas: &[f64]) -> Self {
        let size = mean.len();
        let mut covariance = vec![0.0; size * size];
        for (slot, sigma) in covariance.iter_mut().step_by(size + 1).zip(sigmas) {
            *slot = sigma * sigma;
        }
        Self { mean, covariance }
    }

    pub(super) fn size(&self) -> usize {
        self.mean.len()
    }

    pub(super) fn variance(&self, state: usize) -> f64 {
        let size = self.size();
        self.covariance
            .get(state * size + state)
            .copied()
            .unwrap_or(0.0)
    }

    /// Adds to the variance of one state, independent of all others.
    pub(super) fn loosen(&mut self, state: usize, variance: f64) {
        let size = self.size();
        if let Some(slot) = self.covariance.get_mut(state * size + state) {
            *slot += variance;
        }
    }

    /// The state is known to be `value` within `sigma`, whatever it was.
    pub(super) fn reset(&mut self, state: usize, value: f64, sigma: f64) {
        let size = self.size();
        for other in 0..size {
            self.covariance[state * size + other] = 0.0;
            self.covariance[other * size + state] = 0.0;
        }
        self.covariance[state * size + state] = sigma * sigma;
        self.mean[state] = value;
    }

    /// `state = keep state + gain other`, one step of a first-order model.
    pub(super) fn mix(&mut self, state: usize, keep: f64, other: usize, gain: f64) {
        let size = self.size();
        self.mean[state] = keep * self.mean[state] + gain * self.mean[other];
        for k in 0..size {
            self.covariance[state * size + k] =
                keep * self.covariance[state * size + k] + gain * self.covariance[other * size + k];
        }
        for k in 0..size {
            self.covariance[k * size + state] =
                keep * self.covariance[k * size + state] + gain * self.covariance[k * size + other];
        }
    }

    /// `to` follows `from` by `factor`: adds what that means to the covariance. Both were independent.
    pub(super) fn couple(&mut self, from: usize, to: usize, factor: f64) {
        let size = self.size();
        let column: Vec<f64> = (0..size)
            .map(|k| self.covariance[from * size + k])
            .collect();
        for (k, value) in column.iter().enumerate() {
            if k != to {
                self.covariance[to * size + k] += factor * value;
                self.covariance[k * size + to] += factor * value;
            }
        }
        self.covariance[to * size + to] += factor * factor * column[from];
    }

    /// `covariance` times a vector.
    pub(super) fn times(&self, vector: &[f64], out: &mut [f64]) {
        let size = self.size();
        out.fill(0.0);
        // Column by column, which is row by row: the matrix is symmetric, and most slopes are zero.
        for (line, &factor) in self.covariance.chunks_exact(size).zip(vector) {
            if factor == 0.0 {
                continue;
            }
            for (slot, value) in out.iter_mut().zip(line) {
                *slot += factor * value;
            }
        }
    }

    /// Variance of a linear function of the states, with its cross terms: `rows` x `rows`.
    pub(super) fn spread<const R: usize>(&self, rows: &[Vec<f64>; R]) -> [[f64; R]; R] {
        let mut out = [[0.0; R]; R];
        let mut product = vec![0.0; self.size()];
        for (i, row) in rows.iter().enumerate() {
            self.times(row, &mut product);
            for (j, other) in rows.iter().enumerate() {
                out[i][j] = dot(other, &product);
            }
        }
        out
    }

    /// Takes the rows into account, one after the other (Kalman, 1960, with scalar observations).
    pub(super) fn update(&mut self, linear: &Linear) -> Fit {
        let size = self.size();
        let mut product = vec![0.0; size];
        let mut fit = Fit::default();
        for (residual, slopes) in linear.residual.iter().zip(&linear.slopes) {
            self.times(slopes, &mut product);
            let variance = dot(slopes, &product) + 1.0;
            let off: f64 = slopes
                .iter()
                .zip(self.mean.iter().zip(&linear.at))
                .map(|(slope, (mean, at))| slope * (mean - at))
                .sum();
            let innovation = -(residual + off);
            let inverse = 1.0 / variance;
            for (mean, gain) in self.mean.iter_mut().zip(&product) {
                *mean += gain * innovation * inverse;
            }
            for (line, gain) in self.covariance.chunks_exact_mut(size).zip(&product) {
                let factor = gain * inverse;
                if factor == 0.0 {
                    continue;
                }
                for (slot, value) in line.iter_mut().zip(&product) {
                    *slot -= factor * value;
                }
            }
            fit.squares += innovation * innovation * inverse;
            fit.log_volume += libm::log(variance);
            fit.rows += 1;
        }
        fit
    }
}

pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

/// Householder's reflections that make the first `columns` of the rows upper triangular; all columns
/// follow. `false` where the columns have no full rank.
pub(super) fn triangulate(rows: &mut [Vec<f64>], columns: usize) -> bool {
    for column in 0..columns {
        let square: f64 = rows
            .iter()
            .skip(column)
            .map(|r| r[column] * r[column])
            .sum();
        let length = square.sqrt();
        if length.is_nan() || length <= 1e-9 {
            return false;
        }
        let pivot = rows[column][column];
        let alpha = if pivot > 0.0 { -length } else { length };
        let mut mirror: Vec<f64> = rows.iter().skip(column).map(|r| r[column]).collect();
        mirror[0] -= alpha;
        let scale = 2.0 / dot(&mirror, &mirror);
        let width = rows[column].len();
        let mut sums = vec![0.0; width];
        for (row, factor) in rows.iter().skip(column).zip(&mirror) {
            for (sum, value) in sums.iter_mut().zip(row).skip(column) {
                *sum += factor * value;
            }
        }
        for (row, factor) in rows.iter_mut().skip(column).zip(&mirror) {
            for (value, sum) in row.iter_mut().zip(&sums).skip(column) {
                *value -= scale * factor * sum;
            }
        }
    }
    true
}
