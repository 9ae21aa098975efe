//! Where the robot hangs, by lengths with a full covariance, tensions and tags.
//!
//! As [`crate::estimate`], but after a cut the errors of the lengths are large and correlated: all drums
//! paid out for about the same time. Their rows are whitened by the Cholesky factor of their
//! covariance (generalised least squares, Aitken 1935). Unknown are the tool's position, the tension of the
//! tension-held cable and the difference of the attitude from that of statics.

use super::cut::Lengths;
use crate::estimate::{EstimateError, Measurements, Sigmas, Supposed, residuals};
use crate::motion::{Model, StaticState};
use mcdpr_kinematics::{Attempt, Damping, descend};
use nalgebra::{DMatrix, DVector, Matrix3, SVector, Vector3};

const UNKNOWNS: usize = 7;
/// A step is no longer than this, m.
const LONGEST_STEP_M: f64 = 0.05;
/// After a step shorter than this the search ends, m.
const LAST_STEP_M: f64 = 1e-8;
const DAMPING: Damping = Damping {
    start: 1e-6,
    least: 1e-12,
    most: 1e7,
    after_success: 0.1,
    after_failure: 30.0,
    steps: 25,
};
/// Steps of the numerical derivatives: m, N, rad.
const CHANGES: [f64; UNKNOWNS] = [1e-5, 1e-5, 1e-5, 1e-3, 1e-5, 1e-5, 1e-5];

type Unknowns = SVector<f64, UNKNOWNS>;

/// The evidence of one estimate.
#[derive(Debug, Clone)]
pub struct Weighed<'a> {
    /// Lengths; `None` where they are unknown.
    pub lengths: Option<&'a Lengths>,
    /// Tensions at rest and their standard deviations, N.
    pub tensions_n: &'a [f64],
    /// Standard deviation of each.
    pub tension_sigmas_n: &'a [f64],
    /// Tags and their places; its lengths and tensions are not used.
    pub seen: &'a Measurements,
    /// Standard deviation of the attitude from that of statics, rad.
    pub attitude_rad: f64,
}

/// An estimate of how the robot hangs.
#[derive(Debug, Clone)]
pub struct Found {
    /// The robot's statics there.
    pub rest: StaticState,
    /// The tool, world, m.
    pub tool_m: Vector3<f64>,
    /// Its covariance, m².
    pub covariance_m2: Matrix3<f64>,
    /// Sum of the squared residuals.
    pub chi2: f64,
    /// Rows minus unknowns.
    pub freedoms: usize,
    /// Measured minus estimated tensions, over their standard deviations.
    pub tension_residuals: Vec<f64>,
    /// Change of the estimated tool position per metre of each cable, 3 x n.
    pub tool_per_length: DMatrix<f64>,
    /// Increase of the root of `chi2` per metre of each cable.
    pub residual_per_length: Vec<f64>,
    /// Change of the estimated tool position per change of the tags' place, 3 x 3: identity where the
    /// tags alone give the position, zero without tags.
    pub tool_per_tag: Matrix3<f64>,
    /// Logarithm of the probability density of the evidence, up to a constant that is the same for all
    /// lengths with the other evidence unchanged (Laplace's approximation).
    pub log_evidence: f64,
}

struct Problem<'a> {
    model: &'a Model,
    weighed: &'a Weighed<'a>,
    /// Inverse of the lengths' Cholesky factor.
    white: Option<DMatrix<f64>>,
}

impl Problem<'_> {
    fn rest(&self, x: &Unknowns, near: Option<&StaticState>) -> Result<StaticState, EstimateError> {
        let tool_m = x.fixed_rows::<3>(0).into_owned();
        self.model
            .rest_with(&tool_m, x[3].max(0.05), near)
            .map_err(|source| EstimateError::NoFit {
                source: Box::new(source),
            })
    }

    fn rows(&self, x: &Unknowns, rest: &StaticState) -> Result<DVector<f64>, EstimateError> {
        let weighed = self.weighed;
        let mut rows = Vec::new();
        if let (Some(lengths), Some(white)) = (weighed.lengths, &self.white) {
            let said = DVector::from_column_slice(&rest.paid_out_m);
            // Whitened: rows of unit variance, without correlation.
            rows.extend((white * (&lengths.mean_m - said)).iter().copied());
        }
        let tensions = weighed.tensions_n.iter().zip(rest.tensions_n());
        let tensions = tensions.zip(weighed.tension_sigmas_n);
        rows.extend(tensions.map(|((shown, said), sigma)| (shown - said) / sigma));
        let sigmas = Sigmas {
            attitude_rad: weighed.attitude_rad,
            ..Sigmas::default()
        };
        let supposed = Supposed {
            rest,
            turned: x.fixed_rows::<3>(4).into_owned(),
            skip: None,
        };
        let mut others = Vec::new();
        residuals(self.model, weighed.seen, &sigmas, supposed, &mut others)
            .ok_or(EstimateError::Rank)?;
        rows.extend(others);
        if rows.iter().any(|row| !row.is_finite()) {
            return Err(EstimateError::NotFinite);
        }
        Ok(DVector::from_vec(rows))
    }
}

/// A state of the search.
struct Fit {
    x: Unknowns,
    rest: StaticState,
    rows: DVector<f64>,
}

impl Problem<'_> {
    /// Derivatives of the rows with respect to the unknowns.
    fn slopes(&self, fit: &Fit) -> Result<DMatrix<f64>, EstimateError> {
        let mut slopes = DMatrix::zeros(fit.rows.len(), UNKNOWNS);
        for (column, change) in CHANGES.into_iter().enumerate() {
            let mut moved = fit.x;
            moved[column] += change;
            // Place and tension change the statics; the other three turn the platform out of them.
            let there = if column < 4 {
                self.rows(&moved, &self.rest(&moved, Some(&fit.rest))?)?
            } else {
                self.rows(&moved, &fit.rest)?
            };
            slopes.set_column(column, &((there - &fit.rows) / change));
        }
        Ok(slopes)
    }

    /// The state at `x`, where it fits no worse than `fit`.
    fn improved(&self, fit: &Fit, x: Unknowns) -> Option<Fit> {
        let rest = self.rest(&x, Some(&fit.rest)).ok()?;
        let rows = self.rows(&x, &rest).ok()?;
        let better = rows.norm_squared() <= fit.rows.norm_squared();
        better.then_some(Fit { x, rest, rows })
    }

    fn attempt(
        &self,
        fit: &Fit,
        slopes: &DMatrix<f64>,
        damping: f64,
    ) -> Result<Attempt<Fit, DMatrix<f64>>, EstimateError> {
        let mut normal = slopes.transpose() * slopes;
        let gradient = slopes.transpose() * &fit.rows;
        for i in 0..UNKNOWNS {
            normal[(i, i)] *= 1.0 + damping;
        }
        let step = normal
            .cholesky()
            .ok_or(EstimateError::Rank)?
            .solve(&-gradient);
        let far = step.rows(0, 3).norm();
        let step = step * (LONGEST_STEP_M / far.max(LONGEST_STEP_M));
        let tried = fit.x + Unknowns::from_iterator(step.iter().copied());
        Ok(match self.improved(fit, tried) {
            // The slopes hardly change over the last step.
            Some(next) if far < LAST_STEP_M => Attempt::Last(next, slopes.clone()),
            Some(next) => {
                let slopes = self.slopes(&next)?;
                Attempt::Better(next, slopes)
            }
            None if far < 0.1 * LAST_STEP_M => Attempt::Enough,
            None => Attempt::Worse,
        })
    }
}

/// Estimates by all the evidence, starting with the tool at `start_m`.
///
/// # Errors
/// [`EstimateError`].
pub(crate) fn fuse(
    model: &Model,
    weighed: &Weighed<'_>,
    start_m: &Vector3<f64>,
) -> Result<Found, EstimateError> {
    let white = match weighed.lengths {
        None => None,
        Some(lengths) => {
            let factor = lengths.covariance_m2.clone().cholesky();
            let inverse = factor.and_then(|factor| factor.l().try_inverse());
            Some(inverse.ok_or(EstimateError::Rank)?)
        }
    };
    let problem = Problem {
        model,
        weighed,
        white,
    };
    let held = model.holding().first_by_tension().unwrap_or(0);
    let shown = weighed.tensions_n.get(held).copied();
    let mut x = Unknowns::zeros();
    x.fixed_rows_mut::<3>(0).copy_from(start_m);
    // A sensor near zero would start the search where the robot may have no resting pose.
    x[3] = shown.unwrap_or(model.robot().tension.setpoint_n).max(0.5);
    let rest = problem.rest(&x, None)?;
    let rows = problem.rows(&x, &rest)?;
    let first = Fit { x, rest, rows };
    let slopes = problem.slopes(&first)?;
    // `descend` only reports that an attempt failed: the reason is kept here.
    let mut failure = EstimateError::Rank;
    let found = descend(first, slopes, &DAMPING, |fit, slopes, damping| {
        problem
            .attempt(fit, slopes, damping)
            .map_err(|error| failure = error)
            .ok()
    })
    .ok_or(failure)?;
    problem.found(found.at, &found.linear)
}

impl Problem<'_> {
    /// The estimate at the end of the search, with its covariance.
    fn found(&self, fit: Fit, slopes: &DMatrix<f64>) -> Result<Found, EstimateError> {
        let Fit { x, rest, rows } = fit;
        let covariance = (slopes.transpose() * slopes)
            .try_inverse()
            .ok_or(EstimateError::Rank)?;
        let lengths = self.white.as_ref().map_or(0, DMatrix::nrows);
        // A length that is off by one adds a column of the whitening matrix to the rows.
        let gain = &covariance * slopes.transpose();
        let mut tool_per_length = DMatrix::zeros(3, lengths);
        let mut residual_per_length = Vec::new();
        if let Some(white) = &self.white {
            for cable in 0..lengths {
                let mut bias = DVector::zeros(rows.len());
                bias.rows_mut(0, lengths).copy_from(&white.column(cable));
                let moved = &gain * &bias;
                tool_per_length.set_column(cable, &moved.rows(0, 3));
                residual_per_length.push((bias - slopes * &moved).norm());
            }
        }
        // Laplace: half the logarithm of the determinant, minus half of chi-square. The whitening
        // adds the normalisation of the lengths, which differs between the causes.
        let spread = libm::log(covariance.determinant().max(f64::MIN_POSITIVE));
        let white = self.white.as_ref().map_or(0.0, |white| {
            white
                .diagonal()
                .iter()
                .map(|part| libm::log(part.abs()))
                .sum()
        });
        let log_evidence = 0.5 * (spread - rows.norm_squared()) + white;
        let tensions = self.weighed.tensions_n.len();
        // All tags shifted alike change their rows as a shift of the tool does, the other way. The
        // attitude's rows below them do not depend on the tool's position.
        let first = lengths + tensions;
        let tag_rows = rows.len() - first;
        let tags = slopes.view((first, 0), (tag_rows, 3));
        let by_tags = gain.view((0, first), (3, tag_rows)) * tags;
        Ok(Found {
            log_evidence,
            tool_per_tag: by_tags.fixed_view::<3, 3>(0, 0).into_owned(),
            tool_m: x.fixed_rows::<3>(0).into_owned(),
            covariance_m2: covariance.fixed_view::<3, 3>(0, 0).into_owned(),
            chi2: rows.norm_squared(),
            freedoms: rows.len().saturating_sub(UNKNOWNS),
            tension_residuals: rows.rows(lengths, tensions).iter().copied().collect(),
            tool_per_length: -tool_per_length,
            residual_per_length,
            rest,
        })
    }
}
