//! Prediction of readings that were left out, with intervals, from those that are given.

use super::Priors;
use super::data::{Sample, Set};
use super::fit::Fit;
use super::model::{Group, Model, Row, State, stepped_own};
use super::solve::{Scatter, variance};
use super::unknowns::{Layout, unknowns};
use crate::corner::Entry;
use mcdpr_kinematics::{Attempt, Damping, Pose, descend};
use nalgebra::{DMatrix, DVector};

/// Half the width of a 95 % interval, in standard deviations.
pub const HALF_95: f64 = 1.96;

/// 95 % quantile of chi-square with three degrees of freedom: a region in space.
pub(crate) const CHI2_3_95: f64 = 7.8147;

/// Which readings of a sample are given.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Given {
    /// What is read.
    pub group: Group,
    /// Index of the cable or axis.
    pub index: usize,
}

/// A reading and what was predicted for it.
#[derive(Debug, Clone, PartialEq)]
pub struct Predicted {
    /// What is read.
    pub group: Group,
    /// Index of the cable or axis.
    pub index: usize,
    /// Prediction minus reading.
    pub error: f64,
    /// Standard deviation of that, scatter of the reading included.
    pub sigma: f64,
}

impl Predicted {
    /// Whether the reading lies within the 95 % interval.
    #[must_use]
    pub fn inside(&self) -> bool {
        self.error.abs() <= HALF_95 * self.sigma
    }
}

/// All predictions for one sample.
#[derive(Debug, Clone)]
pub struct Answer {
    /// Index of the sample in its set.
    pub sample: usize,
    /// Pose of the platform, from the given readings.
    pub pose: Pose,
    /// Covariance of its displacement, position then rotation.
    pub pose_covariance: nalgebra::Matrix6<f64>,
    /// The readings that were left out.
    pub readings: Vec<Predicted>,
}

/// Predicts all readings of a set's samples that are not `given`, from an estimate that has not
/// used them. Every sample is predicted independently. A session that was not part of the estimate
/// has its own zeros and offsets, which widen the intervals by their priors.
#[must_use]
pub fn predict(
    fit: &Fit,
    set: &Set,
    given: &[Given],
    priors: &Priors,
) -> Vec<Result<Answer, String>> {
    let (layout, mean, covariance) = extended(fit, set, priors);
    let model = Model {
        set,
        layout,
        middle_m: fit.middle_m,
    };
    let state = State {
        theta: mean,
        ..fit.solution.state.clone()
    };
    let scatter = fit.predictive_scatter();
    set.samples
        .iter()
        .enumerate()
        .map(|(k, sample)| {
            let case = Case {
                fit,
                model: &model,
                state: &state,
                covariance: &covariance,
                scatter: &scatter,
            };
            case.predict(k, sample, given)
                .map_err(|reason| format!("{}: {reason}", set.name(k)))
        })
        .collect()
}

/// The estimate with the sessions of another set besides its own.
fn extended(fit: &Fit, set: &Set, priors: &Priors) -> (Layout, Vec<f64>, DMatrix<f64>) {
    let mut layout = fit.layout.clone();
    // Slips belong to the estimate's own samples. They are the last unknowns: all others keep their
    // places.
    layout.breaks.clear();
    let known = layout.len();
    for sample in &set.samples {
        if layout.slot(sample.session).is_none() {
            layout.sessions.push(sample.session);
        }
    }
    let all = unknowns(set, &layout, priors);
    let mut mean: Vec<f64> = all.iter().map(|u| u.mean).collect();
    mean[..known].copy_from_slice(&fit.solution.state.theta[..known]);
    let mut covariance = DMatrix::zeros(all.len(), all.len());
    let old = fit.solution.covariance.view((0, 0), (known, known));
    covariance.view_mut((0, 0), (known, known)).copy_from(&old);
    for (i, u) in all.iter().enumerate().skip(known) {
        covariance[(i, i)] = u.sigma * u.sigma;
    }
    (layout, mean, covariance)
}

struct Case<'a> {
    fit: &'a Fit,
    model: &'a Model<'a>,
    state: &'a State,
    covariance: &'a DMatrix<f64>,
    scatter: &'a Scatter,
}

/// A sample's own unknowns.
struct Own {
    pose: Pose,
    tensions_n: Vec<f64>,
    rows: Vec<Row>,
    /// Of the given readings and the statics.
    normal: DMatrix<f64>,
    gradient: DVector<f64>,
    cost: f64,
}

impl Own {
    fn new(pose: Pose, tensions_n: Vec<f64>, rows: Vec<Row>, unknowns: usize) -> Self {
        Self {
            pose,
            tensions_n,
            rows,
            normal: DMatrix::zeros(unknowns, unknowns),
            gradient: DVector::zeros(unknowns),
            cost: 0.0,
        }
    }
}

impl Case<'_> {
    fn predict(&self, k: usize, sample: &Sample, given: &[Given]) -> Result<Answer, String> {
        // The equations of equilibrium always count: they connect lengths, tensions and pose.
        let is_given = |row: &Row| {
            !row.group.is_sensor()
                || given
                    .iter()
                    .any(|g| g.group == row.group && g.index == row.index)
        };
        // From the three samples of the estimate whose given readings are nearest.
        let mut near: Vec<(f64, usize)> = self
            .fit
            .set
            .samples
            .iter()
            .enumerate()
            .map(|(j, other)| (distance(sample, other, given), j))
            .collect();
        // Few readings can have more than one minimum: three starts, and the one with the least
        // cost.
        near.sort_by(|a, b| a.0.total_cmp(&b.0));
        let found = near
            .iter()
            .take(3)
            .filter_map(|(_, j)| self.solve(k, sample, *j, &is_given))
            .min_by(|a, b| a.cost.total_cmp(&b.cost))
            .ok_or("the given readings do not fix where the platform is")?;
        let inverse = found
            .normal
            .clone()
            .cholesky()
            .ok_or("the given readings do not fix where the platform is")?
            .inverse();
        let (own, shared) = (self.model.layout.own(), self.covariance.nrows());
        let mut mixed = DMatrix::zeros(own, shared);
        for row in found.rows.iter().filter(|row| is_given(row)) {
            let w = 1.0 / variance(row, self.scatter);
            for (i, &a) in row.own.iter().enumerate() {
                for &Entry { at, slope: by } in &row.shared {
                    mixed[(i, at)] += w * a * by;
                }
            }
        }
        let follow = -(&inverse * mixed);
        let readings = found
            .rows
            .iter()
            .filter(|row| !is_given(row))
            .map(|row| {
                let own = DVector::from_column_slice(&row.own);
                let mut total = follow.tr_mul(&own);
                for &Entry { at, slope: by } in &row.shared {
                    total[at] += by;
                }
                let spread = total.dot(&(self.covariance * &total))
                    + own.dot(&(&inverse * &own))
                    + variance(row, self.scatter);
                Predicted {
                    group: row.group,
                    index: row.index,
                    error: row.residual,
                    sigma: spread.sqrt(),
                }
            })
            .collect();
        let all = &inverse + &follow * self.covariance * follow.transpose();
        Ok(Answer {
            sample: k,
            pose: found.pose,
            pose_covariance: all.fixed_view::<6, 6>(0, 0).into_owned(),
            readings,
        })
    }

    /// The sample's own unknowns, with the shared ones as estimated.
    fn solve(
        &self,
        k: usize,
        sample: &Sample,
        from: usize,
        is_given: &dyn Fn(&Row) -> bool,
    ) -> Option<Own> {
        let known = &self.fit.solution.state;
        let evaluate = |pose: Pose, tensions_n: Vec<f64>| {
            let rows = self
                .model
                .rows(self.state, sample, k, &pose, &tensions_n)
                .ok()?;
            let mut own = Own::new(pose, tensions_n, rows, self.model.layout.own());
            for row in own.rows.iter().filter(|row| is_given(row)) {
                let w = 1.0 / variance(row, self.scatter);
                let a = DVector::from_column_slice(&row.own);
                own.normal.ger(w, &a, &a, 1.0);
                own.gradient.axpy(w * row.residual, &a, 1.0);
                own.cost += w * row.residual.powi(2);
            }
            own.cost.is_finite().then_some(own)
        };
        let first = evaluate(known.poses[from], known.tensions_n[from].clone())?;
        let found = descend(first, (), &DAMPING, |at, (), damping| {
            let mut system = at.normal.clone();
            for i in 0..system.nrows() {
                system[(i, i)] *= 1.0 + damping;
            }
            let step = -system.cholesky()?.solve(&at.gradient);
            let (pose, tensions_n) = stepped_own(&at.pose, &at.tensions_n, step.as_slice());
            Some(match evaluate(pose, tensions_n) {
                Some(next) if next.cost <= at.cost * (1.0 + 1e-12) + 1e-15 => {
                    if at.cost - next.cost < 1e-10 {
                        Attempt::Last(next, ())
                    } else {
                        Attempt::Better(next, ())
                    }
                }
                _ => Attempt::Worse,
            })
        })?;
        Some(found.at).filter(|own| own.tensions_n.iter().all(|t| t.is_finite()))
    }
}

/// Damping of the search for a sample's own unknowns.
const DAMPING: Damping = Damping {
    start: 1e-2,
    least: 1e-14,
    most: 1e9,
    after_success: 0.1,
    after_failure: 5.0,
    steps: 200,
};

/// How far the given readings of two samples are apart: 50 mm of length count as 10 N.
fn distance(a: &Sample, b: &Sample, given: &[Given]) -> f64 {
    let of = |sample: &Sample, g: &Given| match g.group {
        Group::Length => sample.length_m[g.index].map(|v| v / 0.05),
        Group::Tension => sample.tension_n[g.index].map(|v| v / 10.0),
        Group::Swivel => sample.swivel_rad[g.index].map(|v| v / 0.05),
        Group::Tilt | Group::Yaw => sample.rpy_rad[g.index].map(|v| v / 0.05),
        _ => None,
    };
    given
        .iter()
        .filter_map(|g| Some((of(a, g)? - of(b, g)?).powi(2)))
        .sum()
}

/// Errors and shares over some readings.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Score {
    /// Root mean square of the errors, in the unit that the key names.
    pub rms: f64,
    /// Share of the readings within their 95 % interval.
    pub inside: f64,
    /// Number of readings.
    pub readings: usize,
}

/// The score of one kind of reading; `None` without any.
#[must_use]
pub fn score(answers: &[Answer], group: Group, factor: f64) -> Option<Score> {
    let all: Vec<&Predicted> = answers
        .iter()
        .flat_map(|answer| &answer.readings)
        .filter(|reading| reading.group == group)
        .collect();
    if all.is_empty() {
        return None;
    }
    let n = all.len() as f64;
    let squares: f64 = all.iter().map(|r| r.error * r.error).sum();
    Some(Score {
        rms: (squares / n).sqrt() * factor,
        inside: all.iter().filter(|r| r.inside()).count() as f64 / n,
        readings: all.len(),
    })
}
