//! Normal distribution of the slow states, and its update by rows with unit noise.

use super::creep::Creeping;
use nalgebra::{DMatrix, DVector};

/// Mean and covariance.
#[derive(Debug, Clone)]
pub(super) struct Gaussian {
    pub(super) mean: Vec<f64>,
    /// Row by row; symmetric.
    pub(super) covariance: Vec<f64>,
    /// What each cable has crept by the tensions so far, which are known.
    pub(super) creeping: Vec<Creeping>,
}

/// Slopes lie in groups of this many rows: one multiplication of the processor takes two or four.
const GROUP: usize = 4;

/// Rows `residual + slopes (x - at) + noise = 0`, the noise of unit variance.
#[derive(Debug, Clone)]
pub(super) struct Linear {
    pub(super) at: Vec<f64>,
    pub(super) residual: Vec<f64>,
    /// For each group of rows the slopes of all its rows by the first state, then by the second, and so on.
    slopes: Vec<Vec<[f64; GROUP]>>,
}

impl Linear {
    /// Rows of zeros about these states.
    pub(super) fn new(at: &[f64], rows: usize) -> Self {
        Self {
            at: at.to_vec(),
            residual: vec![0.0; rows],
            slopes: vec![vec![[0.0; GROUP]; at.len()]; rows.div_ceil(GROUP)],
        }
    }

    pub(super) fn slope(&self, row: usize, state: usize) -> f64 {
        self.slopes[row / GROUP][state][row % GROUP]
    }

    pub(super) fn slope_mut(&mut self, row: usize, state: usize) -> &mut f64 {
        &mut self.slopes[row / GROUP][state][row % GROUP]
    }
}

/// What rows teach of states.
#[derive(Debug, Clone)]
pub(super) struct Lesson {
    pub(super) mean: Vec<f64>,
    pub(super) fit: Fit,
    /// Row by row, one value per state: the covariance loses their squares.
    known: Vec<Vec<f64>>,
    /// Innovations of unit variance, and the factor of their covariance that makes them so.
    pub(super) white: DVector<f64>,
    pub(super) factor: DMatrix<f64>,
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
        Self {
            mean,
            covariance,
            creeping: Vec::new(),
        }
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

    /// Two independent states have this correlation now.
    pub(super) fn tie(&mut self, [a, b]: [usize; 2], correlation: f64) {
        let size = self.size();
        let both = correlation * libm::sqrt(self.variance(a) * self.variance(b));
        self.covariance[a * size + b] = both;
        self.covariance[b * size + a] = both;
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

    /// `to` follows `from` by `factor`: adds what that means to the covariance.
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
        self.covariance[to * size + to] += factor * (factor * column[from] + 2.0 * column[to]);
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

    /// What rows teach (Kalman, 1960); the covariance is left to [`Self::taught`]. `None` where they are no numbers.
    pub(super) fn learn(&self, linear: &Linear) -> Option<Lesson> {
        let rows = linear.residual.len();
        let off: Vec<f64> = self
            .mean
            .iter()
            .zip(&linear.at)
            .map(|(m, at)| m - at)
            .collect();
        let mut innovation = DVector::zeros(rows);
        let mut spread = DMatrix::identity(rows, rows);
        // Covariance times slopes, group by group.
        let products: Vec<Vec<[f64; GROUP]>> = linear
            .slopes
            .iter()
            .map(|group| self.times_group(group))
            .collect();
        for (first, group) in linear.slopes.iter().enumerate() {
            let by_off = weighted(&off, group);
            for row in first * GROUP..rows.min((first + 1) * GROUP) {
                innovation[row] = -(linear.residual[row] + by_off[row % GROUP]);
            }
            // The lower triangle is enough for the factor.
            for (second, product) in products.iter().take(first + 1).enumerate() {
                let block = outer(group, product);
                for i in first * GROUP..rows.min((first + 1) * GROUP) {
                    for j in second * GROUP..=i.min(second * GROUP + GROUP - 1) {
                        spread[(i, j)] += block[i % GROUP][j % GROUP];
                    }
                }
            }
        }
        let factor = spread.cholesky()?.unpack();
        let white = factor.solve_lower_triangular(&innovation)?;
        // Products over the factor: of unit variance, and independent.
        let mut known: Vec<Vec<f64>> = Vec::with_capacity(rows);
        for row in 0..rows {
            let (group, k) = (row / GROUP, row % GROUP);
            let mut line: Vec<f64> = products[group].iter().map(|product| product[k]).collect();
            for (before, other) in known.iter().enumerate() {
                let share = factor[(row, before)];
                line.iter_mut()
                    .zip(other)
                    .for_each(|(slot, value)| *slot -= share * value);
            }
            let inverse = 1.0 / factor[(row, row)];
            line.iter_mut().for_each(|slot| *slot *= inverse);
            known.push(line);
        }
        let mut mean = self.mean.clone();
        for (line, by) in known.iter().zip(white.iter()) {
            mean.iter_mut()
                .zip(line)
                .for_each(|(slot, value)| *slot += by * value);
        }
        let fit = Fit {
            squares: white.norm_squared(),
            log_volume: 2.0 * factor.diagonal().iter().map(|v| libm::log(*v)).sum::<f64>(),
            rows,
        };
        Some(Lesson {
            mean,
            fit,
            known,
            white,
            factor,
        })
    }

    /// The states after a lesson.
    pub(super) fn taught(&self, lesson: Lesson) -> Self {
        let size = self.size();
        let mut covariance = self.covariance.clone();
        let zeros = vec![0.0; size];
        for row in 0..size {
            let line = &mut covariance[row * size..][..=row];
            // Four at a time: each pass over the line costs as much as its arithmetic.
            for group in lesson.known.chunks(GROUP) {
                let part = |k: usize| &group.get(k).unwrap_or(&zeros)[..=row];
                let (a, b, c, d) = (part(0), part(1), part(2), part(3));
                let by = [a[row], b[row], c[row], d[row]];
                let others = a.iter().zip(b).zip(c.iter().zip(d));
                for (slot, ((a, b), (c, d))) in line.iter_mut().zip(others) {
                    *slot -= (by[0] * a + by[1] * b) + (by[2] * c + by[3] * d);
                }
            }
        }
        for row in 0..size {
            for column in 0..row {
                covariance[column * size + row] = covariance[row * size + column];
            }
        }
        Self {
            mean: lesson.mean,
            covariance,
            creeping: self.creeping.clone(),
        }
    }

    /// Covariance times a group of slopes: as many values per state.
    fn times_group(&self, slopes: &[[f64; GROUP]]) -> Vec<[f64; GROUP]> {
        let lines = self.covariance.chunks_exact(self.size());
        lines.map(|line| weighted(line, slopes)).collect()
    }
}

/// Sum of the slopes, each times its factor; even and odd ones by themselves, which need not wait for each other.
#[inline]
fn weighted(factors: &[f64], slopes: &[[f64; GROUP]]) -> [f64; GROUP] {
    let mut even = [0.0; GROUP];
    let mut odd = [0.0; GROUP];
    let (pairs, last) = factors.as_chunks::<2>();
    let (slope_pairs, last_slope) = slopes.as_chunks::<2>();
    for ([f, g], [a, b]) in pairs.iter().zip(slope_pairs) {
        for k in 0..GROUP {
            even[k] += f * a[k];
            odd[k] += g * b[k];
        }
    }
    for (f, a) in last.iter().zip(last_slope) {
        for k in 0..GROUP {
            even[k] += f * a[k];
        }
    }
    core::array::from_fn(|k| even[k] + odd[k])
}

/// Sum over the states of the products of each slope with each entry.
#[inline]
fn outer(slopes: &[[f64; GROUP]], product: &[[f64; GROUP]]) -> [[f64; GROUP]; GROUP] {
    let mut sums = [[0.0; GROUP]; GROUP];
    for (slope, entry) in slopes.iter().zip(product) {
        for k in 0..GROUP {
            for l in 0..GROUP {
                sums[k][l] += slope[k] * entry[l];
            }
        }
    }
    sums
}

pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}
