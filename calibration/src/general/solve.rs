//! One weighted problem over shared unknowns and those of each sample, which are eliminated.

use super::model::{GROUPS, Model, Row, State, stepped_own};
use super::unknowns::Unknown;
use crate::corner::Entry;
use mcdpr_kinematics::{Attempt, Damping, Pose, descend};
use nalgebra::{Cholesky, DMatrix, DVector, Rotation3, Vector3};

/// One standard deviation per kind of reading.
pub type Scatter = [f64; GROUPS];

/// The variance of a row.
#[must_use]
pub fn variance(row: &Row, scatter: &Scatter) -> f64 {
    let [factor, extra] = row.scale;
    (factor * scatter[row.group.index()]).powi(2) + extra * extra
}

/// A sample's part of the problem at the solution.
#[derive(Debug, Clone)]
pub struct Block {
    /// Its rows.
    pub rows: Vec<Row>,
    /// Inverse of its own normal matrix.
    pub inverse: DMatrix<f64>,
    /// Derivative of its own unknowns by the shared ones.
    pub follow: DMatrix<f64>,
}

impl Block {
    /// Derivative of a row with respect to the shared unknowns, the sample's own following.
    #[must_use]
    pub fn total(&self, row: &Row) -> DVector<f64> {
        let mut out = self.follow.tr_mul(&DVector::from_column_slice(&row.own));
        for &Entry { at, slope: by } in &row.shared {
            out[at] += by;
        }
        out
    }

    /// Variance of a row's prediction, the reading's own scatter not counted.
    #[must_use]
    pub(crate) fn predicted_variance(&self, row: &Row, covariance: &DMatrix<f64>) -> f64 {
        let total = self.total(row);
        let own = DVector::from_column_slice(&row.own);
        total.dot(&(covariance * &total)) + own.dot(&(&self.inverse * &own))
    }
}

/// A minimum.
#[derive(Debug, Clone)]
pub struct Solution {
    /// Values of the unknowns.
    pub state: State,
    /// Covariance of the shared unknowns.
    pub covariance: DMatrix<f64>,
    /// Per sample.
    pub blocks: Vec<Block>,
    /// The sum of weighted squares, priors included.
    pub cost: f64,
    /// Whether the last step gained almost nothing.
    pub converged: bool,
}

/// A start: below the middle of the anchors, tilted as the inclinometer measures, or from a
/// picture.
#[must_use]
pub fn start(model: &Model<'_>, unknowns: &[Unknown]) -> State {
    let robot = &model.set.robot;
    let n = robot.cables.len().max(1) as f64;
    let middle: Vector3<f64> = robot
        .cables
        .iter()
        .map(|c| c.anchor_m)
        .sum::<Vector3<f64>>()
        / n;
    let spread: f64 = robot
        .cables
        .iter()
        .map(|c| (c.anchor_m - middle).norm())
        .sum::<f64>()
        / n;
    let carried = robot.mass_kg * mcdpr_kinematics::GRAVITY_MPS2 / n;
    let place = middle - Vector3::z() * (0.5 * spread);
    let eye = model.set.eye.as_ref();
    let unplaced = || (Pose::level(Vector3::zeros()), Rotation3::identity());
    let trackers = model.layout.trackers.iter();
    let frames: Vec<_> = trackers
        .map(|&index| model.set.trackers[index].start.unwrap_or_else(unplaced))
        .collect();
    State {
        theta: unknowns.iter().map(|u| u.mean).collect(),
        camera_from_platform: eye.map_or_else(
            || Pose::level(Vector3::zeros()),
            |eye| eye.camera_from_platform,
        ),
        world_from_body: eye.map_or_else(Vec::new, |eye| eye.world_from_body.clone()),
        tracker_from_world: frames.iter().map(|start| start.0).collect(),
        platform_from_target: frames.iter().map(|start| start.1).collect(),
        poses: model
            .set
            .samples
            .iter()
            .map(|sample| {
                let [roll, pitch, _] = sample.rpy_rad;
                let tilted = [roll.unwrap_or(0.0), pitch.unwrap_or(0.0), 0.0];
                sample
                    .start
                    .unwrap_or_else(|| Pose::from_rpy(place, tilted))
            })
            .collect(),
        tensions_n: model
            .set
            .samples
            .iter()
            .map(|sample| {
                // A cable without tension has no effect on the equilibrium: its derivatives would
                // be zero.
                let of = |t: &Option<f64>| t.unwrap_or(carried).max(0.1 * carried);
                sample.tension_n.iter().map(of).collect()
            })
            .collect(),
    }
}

/// The rows of all samples.
///
/// # Errors
/// If a cable has no geometry at a pose.
pub(crate) fn all_rows(
    model: &Model<'_>,
    state: &State,
) -> Result<Vec<Vec<Row>>, mcdpr_kinematics::Error> {
    let samples = model.set.samples.iter().enumerate();
    samples
        .map(|(k, sample)| model.rows(state, sample, k, &state.poses[k], &state.tensions_n[k]))
        .collect()
}

/// Weight of every row, per sample: the inverse of its variance, times the weight of Student's
/// distribution.
pub type Weights = Vec<Vec<f64>>;

fn cost(rows: &[Vec<Row>], weights: &Weights, state: &State, unknowns: &[Unknown]) -> f64 {
    let readings: f64 = rows
        .iter()
        .zip(weights)
        .flat_map(|(rows, weights)| rows.iter().zip(weights))
        .map(|(row, w)| w * row.residual * row.residual)
        .sum();
    let priors: f64 = unknowns
        .iter()
        .zip(&state.theta)
        .map(|(u, value)| ((value - u.mean) / u.sigma).powi(2))
        .sum();
    readings + priors
}

/// A sample's own normal matrix, its coupling to the shared unknowns, and its gradient.
struct Normal {
    own: DMatrix<f64>,
    /// Own times shared.
    mixed: DMatrix<f64>,
    gradient: DVector<f64>,
    /// Shared unknowns that it depends on.
    touched: Vec<usize>,
}

fn normal(rows: &[Row], weights: &[f64], own: usize, shared: usize) -> Normal {
    let mut out = Normal {
        own: DMatrix::zeros(own, own),
        mixed: DMatrix::zeros(own, shared),
        gradient: DVector::zeros(own),
        touched: Vec::new(),
    };
    let mut seen = vec![false; shared];
    for (row, &w) in rows.iter().zip(weights) {
        for (i, &a) in row.own.iter().enumerate() {
            if a == 0.0 {
                continue;
            }
            let wa = w * a;
            out.gradient[i] += wa * row.residual;
            for (j, &b) in row.own.iter().enumerate() {
                out.own[(i, j)] += wa * b;
            }
            for &Entry { at, slope: by } in &row.shared {
                out.mixed[(i, at)] += wa * by;
            }
        }
        for &Entry { at, .. } in &row.shared {
            seen[at] = true;
        }
    }
    out.touched = (0..shared).filter(|&at| seen[at]).collect();
    out
}

/// Marquardt's damping of all steps together; the limit of steps counts those that are taken.
const DAMPING: Damping = Damping {
    start: 1e-3,
    least: 1e-12,
    most: 1e9,
    after_success: 0.125,
    after_failure: 4.0,
    steps: usize::MAX,
};

/// Rows, cost and normal equations of a state.
struct Linear {
    rows: Vec<Vec<Row>>,
    cost: f64,
    equations: Equations,
}

/// A problem with fixed weights.
struct Problem<'a, 'b> {
    model: &'a Model<'b>,
    unknowns: &'a [Unknown],
    weights: &'a Weights,
}

impl Problem<'_, '_> {
    fn linear(&self, state: &State, rows: Vec<Vec<Row>>, cost: f64) -> Linear {
        let own = self.model.layout.own();
        Linear {
            equations: assemble(&rows, self.weights, state, self.unknowns, own),
            rows,
            cost,
        }
    }

    /// The state after a step; `None` where the cost is greater there or cannot be computed.
    fn improved(&self, state: &State, linear: &Linear, damping: f64) -> Option<(State, Linear)> {
        let (step, owns) = step(&linear.equations, damping)?;
        let mut next = self.model.stepped(state, step.as_slice());
        for (k, own) in owns.iter().enumerate() {
            let (pose, tensions) =
                stepped_own(&state.poses[k], &state.tensions_n[k], own.as_slice());
            next.poses[k] = pose;
            next.tensions_n[k] = tensions;
        }
        let rows = all_rows(self.model, &next).ok()?;
        let new = cost(&rows, self.weights, &next, self.unknowns);
        (new <= linear.cost * (1.0 + 1e-12) + 1e-12).then(|| {
            let linear = self.linear(&next, rows, new);
            (next, linear)
        })
    }
}

/// Solves by Levenberg and Marquardt's method with fixed weights; at most `steps` are taken.
///
/// # Errors
/// In words, if the start has no geometry or a system cannot be solved.
pub fn solve(
    model: &Model<'_>,
    unknowns: &[Unknown],
    weights: &Weights,
    from: &State,
    steps: usize,
) -> Result<Solution, String> {
    let problem = Problem {
        model,
        unknowns,
        weights,
    };
    let rows = all_rows(model, from).map_err(|error| error.to_string())?;
    let at = cost(&rows, weights, from, unknowns);
    let linear = problem.linear(from, rows, at);
    let (mut taken, mut converged) = (0, steps > 0);
    let damping = Damping {
        steps: if steps == 0 { 0 } else { DAMPING.steps },
        ..DAMPING
    };
    let found = descend(from.clone(), linear, &damping, |state, linear, damping| {
        let Some((next, after)) = problem.improved(state, linear, damping) else {
            return Some(Attempt::Worse);
        };
        taken += 1;
        let gain = linear.cost - after.cost;
        // A millionth of the sum of squares: the scatter itself is not known that well.
        let small = gain < 1e-6 * after.cost.max(1.0);
        converged = small || taken < steps;
        Some(if small || taken == steps {
            Attempt::Last(next, after)
        } else {
            Attempt::Better(next, after)
        })
    })
    .ok_or("the least squares were not solved")?;
    finish(found.at, found.linear, unknowns.len(), converged)
}

/// Normal equations of the shared unknowns, and those of every sample.
struct Equations {
    shared: DMatrix<f64>,
    gradient: DVector<f64>,
    normals: Vec<Normal>,
    /// Unknowns of each sample.
    own: usize,
}

fn assemble(
    rows: &[Vec<Row>],
    weights: &Weights,
    state: &State,
    unknowns: &[Unknown],
    own: usize,
) -> Equations {
    let n = unknowns.len();
    let mut shared = DMatrix::zeros(n, n);
    let mut gradient = DVector::zeros(n);
    for (i, u) in unknowns.iter().enumerate() {
        let w = 1.0 / (u.sigma * u.sigma);
        shared[(i, i)] = w;
        gradient[i] = w * (state.theta[i] - u.mean);
    }
    let mut normals = Vec::with_capacity(rows.len());
    for (rows, weights) in rows.iter().zip(weights) {
        for (row, &w) in rows.iter().zip(weights) {
            for &Entry { at: i, slope: a } in &row.shared {
                gradient[i] += w * a * row.residual;
                for &Entry { at: j, slope: b } in &row.shared {
                    shared[(i, j)] += w * a * b;
                }
            }
        }
        normals.push(normal(rows, weights, own, n));
    }
    Equations {
        shared,
        gradient,
        normals,
        own,
    }
}

/// The own system of a sample with damping; a small diagonal keeps unknowns without rows solvable.
fn damped(own: &DMatrix<f64>, damping: f64) -> Option<Cholesky<f64, nalgebra::Dyn>> {
    let mut own = own.clone();
    let ridge = 1e-13 * own.diagonal().max();
    for i in 0..own.nrows() {
        own[(i, i)] += damping * own[(i, i)] + ridge;
    }
    Cholesky::new(own)
}

/// A step of the shared unknowns, and of those of each sample.
fn step(equations: &Equations, damping: f64) -> Option<(DVector<f64>, Vec<DVector<f64>>)> {
    let Equations {
        shared,
        gradient,
        normals,
        ..
    } = equations;
    let mut reduced = shared.clone();
    let mut right = gradient.clone();
    let mut parts = Vec::with_capacity(normals.len());
    for normal in normals {
        let solver = damped(&normal.own, damping)?;
        // A sample depends on some of the shared unknowns only: the other columns are zero.
        let mixed = normal.mixed.select_columns(normal.touched.iter());
        let follow = solver.solve(&mixed);
        let apart = solver.solve(&normal.gradient);
        let less = mixed.tr_mul(&follow);
        let less_right = mixed.tr_mul(&apart);
        for (a, &i) in normal.touched.iter().enumerate() {
            right[i] -= less_right[a];
            for (b, &j) in normal.touched.iter().enumerate() {
                reduced[(i, j)] -= less[(a, b)];
            }
        }
        parts.push((follow, apart));
    }
    for i in 0..reduced.nrows() {
        reduced[(i, i)] += damping * 1e-3 * shared[(i, i)];
    }
    let solution = -solve_scaled(&reduced)?.solve_for(&right);
    let owns = normals
        .iter()
        .zip(parts)
        .map(|(normal, (follow, apart))| {
            -apart - follow * solution.select_rows(normal.touched.iter())
        })
        .collect();
    Some((solution, owns))
}

/// A symmetric system with unit diagonal: unknowns have very different units.
struct Scaled {
    scale: DVector<f64>,
    factor: Cholesky<f64, nalgebra::Dyn>,
}

fn solve_scaled(matrix: &DMatrix<f64>) -> Option<Scaled> {
    let scale = matrix.diagonal().map(|d| 1.0 / d.max(1e-300).sqrt());
    let scaled = DMatrix::from_fn(matrix.nrows(), matrix.ncols(), |i, j| {
        matrix[(i, j)] * scale[i] * scale[j] + if i == j { 1e-13 } else { 0.0 }
    });
    Some(Scaled {
        scale,
        factor: Cholesky::new(scaled)?,
    })
}

impl Scaled {
    fn solve_for(&self, right: &DVector<f64>) -> DVector<f64> {
        self.factor
            .solve(&right.component_mul(&self.scale))
            .component_mul(&self.scale)
    }
    fn inverse(&self) -> DMatrix<f64> {
        let inverse = self.factor.inverse();
        DMatrix::from_fn(inverse.nrows(), inverse.ncols(), |i, j| {
            inverse[(i, j)] * self.scale[i] * self.scale[j]
        })
    }
}

/// The minimum with its covariance, undamped.
fn finish(state: State, linear: Linear, n: usize, converged: bool) -> Result<Solution, String> {
    let Linear {
        rows,
        cost,
        equations,
    } = linear;
    let Equations {
        shared: mut reduced,
        normals,
        own,
        ..
    } = equations;
    let mut blocks = Vec::with_capacity(rows.len());
    for (normal, rows) in normals.iter().zip(rows) {
        // Undamped: the covariance is that of the problem, not of the search.
        let solver = damped(&normal.own, 0.0).ok_or("a sample's own unknowns are not fixed")?;
        let mixed = normal.mixed.select_columns(normal.touched.iter());
        let part = solver.solve(&mixed);
        let less = mixed.tr_mul(&part);
        let mut follow = DMatrix::zeros(own, n);
        for (a, &i) in normal.touched.iter().enumerate() {
            follow.set_column(i, &-part.column(a));
            for (b, &j) in normal.touched.iter().enumerate() {
                reduced[(i, j)] -= less[(a, b)];
            }
        }
        blocks.push(Block {
            rows,
            inverse: solver.inverse(),
            follow,
        });
    }
    let covariance = solve_scaled(&reduced)
        .ok_or("the data leave a direction open that no prior holds")?
        .inverse();
    Ok(Solution {
        state,
        covariance,
        blocks,
        cost,
        converged,
    })
}
