//! The least-squares solver.

use super::held;
use super::newton;
use super::rows::{self, Measurements, Sigmas};
use crate::motion::{Model, PlanError, StaticState};
use mcdpr_kinematics::{Attempt, Damping, Pose, descend};
use miette::Diagnostic;
use nalgebra::{DMatrix, Matrix3, SMatrix, SVector, Vector3, Vector4};
use thiserror::Error;

/// It usually takes four or five steps.
pub(super) const DAMPING: Damping = Damping {
    start: 1e-6,
    least: 1e-12,
    most: 1e6,
    after_success: 0.1,
    after_failure: 10.0,
    steps: 40,
};
/// A step is no longer than this, m: more than a hand's width is not plausible in this problem.
pub(super) const LONGEST_STEP_M: f64 = 0.05;
/// The search ends after a step shorter than this, m.
pub(super) const LAST_STEP_M: f64 = 1e-9;
/// Unknowns: the tool's position (m), the tension of the tension-held cable (N), the attitude
/// relative to statics (rad).
const UNKNOWNS: usize = 7;
/// Rows that are not measurements: the attitude's three.
const PRIORS: usize = 3;
/// Step sizes of the numerical derivatives.
/// In m, N and rad: 10 um are a thirtieth of a length's assumed error.
const CHANGES: [f64; UNKNOWNS] = [1e-5, 1e-5, 1e-5, 1e-3, 1e-5, 1e-5, 1e-5];

type Unknowns = SVector<f64, UNKNOWNS>;
type Linear = newton::Linear<UNKNOWNS>;

fn place(x: &Unknowns) -> Vector3<f64> {
    x.fixed_rows::<3>(0).into_owned()
}

fn turned(x: &Unknowns) -> Vector3<f64> {
    x.fixed_rows::<3>(4).into_owned()
}

/// Why the platform's position cannot be estimated.
#[derive(Debug, Error, Diagnostic)]
pub enum EstimateError {
    /// Fewer rows than unknowns.
    #[error("{rows} measured values do not determine where the platform is: {needed} are needed")]
    #[diagnostic(
        code(mcdpr::estimate::few),
        help("give the lengths of all cables, or a view of a tag whose place is known")
    )]
    Few {
        /// Number of values.
        rows: usize,
        /// Fewest that do.
        needed: usize,
    },
    /// A value is NaN or infinite.
    #[error("a measured value is not a finite number")]
    #[diagnostic(code(mcdpr::estimate::finite))]
    NotFinite,
    /// The rows do not determine every unknown.
    #[error("the measurements do not determine every unknown of the platform")]
    #[diagnostic(
        code(mcdpr::estimate::rank),
        help("give more lengths, or a view of a tag")
    )]
    Rank,
    /// No resting pose fits.
    #[error("no resting pose fits the measurements")]
    #[diagnostic(
        code(mcdpr::estimate::fit),
        help("check that the platform hangs at rest, and that the robot file is this robot's")
    )]
    NoFit {
        /// Why not.
        source: Box<PlanError>,
    },
}

/// Estimated state of the platform.
#[derive(Debug, Clone)]
pub struct Estimate {
    /// How it hangs.
    pub rest: StaticState,
    /// Tool, world, m.
    pub tool_m: Vector3<f64>,
    /// Covariance of the tool's place, m^2, world.
    pub covariance_m2: Matrix3<f64>,
    /// Covariance of the attitude as a rotation vector, rad^2, world.
    pub rotation_covariance_rad2: Matrix3<f64>,
    /// How far the attitude is from that of statics, as far as pictures show it: rotation vector,
    /// rad, world. `rest` keeps the attitude of statics.
    pub off_statics_rad: Vector3<f64>,
    /// Rows over their standard deviation, in the order: lengths, tensions, tag corners (u, v),
    /// attitude. Where lengths hold the pose: lengths, tag corners; of a platform in a plane then its place across the
    /// plane and two leans, from those of statics.
    pub residuals: Vec<f64>,
    /// Sum of the squares of the residuals.
    pub chi2: f64,
    /// Rows minus unknowns.
    pub freedoms: usize,
}

impl Estimate {
    /// The redundancy residual: what the rows disagree by, over what their standard deviations
    /// explain. About 1 where all is well; `None` without redundancy.
    #[must_use]
    pub fn redundancy(&self) -> Option<f64> {
        (self.freedoms > 0).then(|| (self.chi2 / self.freedoms as f64).sqrt())
    }
}

/// Estimates the resting state from what was measured, starting near `start_m` (tool, world, m).
///
/// # Errors
/// [`EstimateError`].
pub fn estimate(
    model: &Model,
    measured: &Measurements,
    sigmas: &Sigmas,
    start_m: &Vector3<f64>,
) -> Result<Estimate, EstimateError> {
    model
        .comes_to_rest("the estimate from lengths, tensions and tags")
        .map_err(no_fit)?;
    if !model.holding().hangs() {
        let start = Pose::level(start_m - model.robot().tool.tcp_in_platform_m);
        return held::solve(model, measured, sigmas, start, None);
    }
    let tension_n = rows::held_tension_n(model, measured);
    let start = Vector4::new(start_m.x, start_m.y, start_m.z, tension_n);
    solve(model, measured, sigmas, start, None)
}

/// What is solved: the rows, where the search starts, and the pose of a tag left out.
struct Problem<'a> {
    model: &'a Model,
    measured: &'a Measurements,
    sigmas: &'a Sigmas,
    /// The tool (world, m) and the tension of the tension-held cable (N) at the start.
    start: Vector4<f64>,
    /// Index of the row that is left out.
    skip: Option<usize>,
}

impl Problem<'_> {
    /// The resting state of these unknowns.
    fn rest(&self, x: &Unknowns, near: Option<&StaticState>) -> Result<StaticState, EstimateError> {
        // The search may step to a negative tension, for which statics refuse to answer.
        let rest = self.model.rest_with(&place(x), x[3].max(0.05), near);
        rest.map_err(no_fit)
    }

    /// Rows over their standard deviation.
    fn residuals(
        &self,
        rest: &StaticState,
        x: &Unknowns,
        into: &mut Vec<f64>,
    ) -> Result<(), EstimateError> {
        let supposed = rows::Supposed {
            rest,
            turned: turned(x),
            skip: self.skip,
        };
        rows::residuals(self.model, self.measured, self.sigmas, supposed, into)
            .ok_or(EstimateError::Rank)
    }

    /// Without a measured tension the tension-held cable's is a weak guess, not an unknown.
    fn has_prior(&self) -> bool {
        self.measured.tensions_n.is_empty()
    }

    /// Sum of squares, with the guess of the tension.
    fn cost(&self, residuals: &[f64], x: &Unknowns) -> f64 {
        let sum: f64 = residuals.iter().map(|r| r * r).sum();
        let off = (x[3] - self.start.w) / PRIOR_N;
        sum + if self.has_prior() { off * off } else { 0.0 }
    }

    /// Derivatives of the rows by forward differences: rows x [`UNKNOWNS`].
    fn jacobian(&self, fit: &Fit) -> Result<DMatrix<f64>, EstimateError> {
        let mut jacobian = DMatrix::zeros(fit.residuals.len(), UNKNOWNS);
        let mut moved_residuals = Vec::new();
        for (column, change) in CHANGES.into_iter().enumerate() {
            let mut moved = fit.x;
            moved[column] += change;
            let near = self.rest(&moved, Some(&fit.rest))?;
            self.residuals(&near, &moved, &mut moved_residuals)?;
            for (row, (new, old)) in moved_residuals.iter().zip(&fit.residuals).enumerate() {
                jacobian[(row, column)] = (new - old) / change;
            }
        }
        Ok(jacobian)
    }

    /// Normal matrix and gradient.
    fn linear(&self, fit: &Fit) -> Result<Linear, EstimateError> {
        let jacobian = self.jacobian(fit)?;
        let mut linear = Linear::of(&jacobian, &fit.residuals);
        if self.has_prior() {
            linear.normal[(3, 3)] += 1.0 / (PRIOR_N * PRIOR_N);
            linear.gradient[3] += (fit.x[3] - self.start.w) / (PRIOR_N * PRIOR_N);
        }
        Ok(linear)
    }

    /// The search's first state, with as many rows as unknowns at least.
    fn first(&self) -> Result<Fit, EstimateError> {
        let mut x = Unknowns::zeros();
        x.fixed_rows_mut::<4>(0).copy_from(&self.start);
        let rest = self.rest(&x, None)?;
        let mut residuals = Vec::new();
        self.residuals(&rest, &x, &mut residuals)?;
        if residuals.iter().any(|r| !r.is_finite()) {
            return Err(EstimateError::NotFinite);
        }
        // The three rows of the attitude are always there; only the user's own values are reported.
        if residuals.len() + usize::from(self.has_prior()) < UNKNOWNS {
            return Err(EstimateError::Few {
                rows: residuals.len().saturating_sub(PRIORS),
                needed: UNKNOWNS - PRIORS,
            });
        }
        Ok(Fit { x, rest, residuals })
    }

    /// The state at `x`, where it is a resting state that fits no worse than `fit`.
    fn improved(&self, fit: &Fit, x: Unknowns) -> Option<Fit> {
        let rest = self.rest(&x, Some(&fit.rest)).ok()?;
        let mut residuals = Vec::new();
        self.residuals(&rest, &x, &mut residuals).ok()?;
        let better = self.cost(&residuals, &x) <= self.cost(&fit.residuals, &fit.x);
        better.then_some(Fit { x, rest, residuals })
    }

    fn attempt(
        &self,
        fit: &Fit,
        linear: &Linear,
        damping: f64,
    ) -> Result<Attempt<Fit, Linear>, EstimateError> {
        let step = linear.step(damping)?;
        // All unknowns are shortened alike: the step keeps its direction.
        let step = step * (LONGEST_STEP_M / place(&step).norm().max(LONGEST_STEP_M));
        let last = place(&step).norm() < LAST_STEP_M;
        newton::attempt(self.improved(fit, fit.x + step), last, |next| {
            self.linear(next)
        })
    }
}

/// A state of the search.
struct Fit {
    x: Unknowns,
    rest: StaticState,
    residuals: Vec<f64>,
}

impl Fit {
    /// Attitude's derivatives with respect to the unknowns, rad per unit.
    fn turning(&self, model: &Model) -> Result<SMatrix<f64, 3, UNKNOWNS>, EstimateError> {
        let tool = &model.robot().tool.tcp_in_platform_m;
        let slopes = model
            .geometry()
            .tool_sensitivity(&self.rest.equilibrium, tool)
            .map_err(|source| no_fit(source.into()))?;
        let per_tension = model
            .holding()
            .first_by_tension()
            .map_or([0.0; 3], |held| slopes.rotation_per_tension[held]);
        let mut turning = SMatrix::<f64, 3, UNKNOWNS>::zeros();
        turning
            .fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&slopes.rotation_per_position);
        turning.set_column(3, &Vector3::from(per_tension));
        turning
            .fixed_view_mut::<3, 3>(0, 4)
            .copy_from(&Matrix3::identity());
        Ok(turning)
    }

    /// The estimate, with its covariance.
    fn estimate(self, linear: &Linear, problem: &Problem<'_>) -> Result<Estimate, EstimateError> {
        let covariance = linear.normal.try_inverse().ok_or(EstimateError::Rank)?;
        let turning = self.turning(problem.model)?;
        let rows = self.residuals.len() + usize::from(problem.has_prior());
        Ok(Estimate {
            tool_m: place(&self.x),
            off_statics_rad: turned(&self.x),
            covariance_m2: covariance.fixed_view::<3, 3>(0, 0).into_owned(),
            rotation_covariance_rad2: turning * covariance * turning.transpose(),
            chi2: self.residuals.iter().map(|r| r * r).sum(),
            freedoms: rows.saturating_sub(UNKNOWNS),
            residuals: self.residuals,
            rest: self.rest,
        })
    }
}

pub(super) fn no_fit(source: PlanError) -> EstimateError {
    EstimateError::NoFit {
        source: Box::new(source),
    }
}

pub(super) fn solve(
    model: &Model,
    measured: &Measurements,
    sigmas: &Sigmas,
    start: Vector4<f64>,
    skip: Option<usize>,
) -> Result<Estimate, EstimateError> {
    let problem = Problem {
        model,
        measured,
        sigmas,
        start,
        skip,
    };
    let first = problem.first()?;
    let linear = problem.linear(&first)?;
    // `descend` only reports that an attempt failed: the reason is kept here.
    let mut failure = EstimateError::Rank;
    let found = descend(first, linear, &DAMPING, |fit, linear, damping| {
        problem
            .attempt(fit, linear, damping)
            .map_err(|error| failure = error)
            .ok()
    });
    match found {
        Some(found) => found.at.estimate(&found.linear, &problem),
        None => Err(failure),
    }
}

/// Standard deviation assumed for a tension that was not measured, N.
const PRIOR_N: f64 = 2.0;
