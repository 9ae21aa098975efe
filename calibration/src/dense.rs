//! Least squares in a plain implementation: all unknowns in one dense system, derivatives by
//! differences. The reference for the speed of `lengths` and [`mod@super::joint`]
//! (`benches/calibration.rs`), and an independent solver for the same minimum.

use super::check::usable;
use super::data::Data;
use super::error::Refusal;
use super::fit::{Options, model, start};
use super::rows::{Model, singles};
use super::solve::initial_lengths;
use super::unknowns::{Priors, State};
use mcdpr_kinematics::{Attempt, Damping, descend};
use nalgebra::{DMatrix, DVector};

/// Step of the differences, in the unknowns' units (m, rad, N).
const STEP: f64 = 1e-7;

/// Damping relative to the diagonal.
const DAMPING: Damping = Damping {
    start: 1e-6,
    least: 0.0,
    most: 1e8,
    after_success: 0.1,
    after_failure: 10.0,
    steps: 100,
};

/// Levenberg-Marquardt with a dense Jacobian by forward differences, down to gains below `little` (or
/// a 1e-9th of the cost). Returns the minimum and its cost; `None` where the start has no residuals.
pub fn minimise<S: Clone>(
    start: &S,
    unknowns: usize,
    little: f64,
    residuals: impl Fn(&S) -> Option<DVector<f64>>,
    stepped: impl Fn(&S, &DVector<f64>) -> S,
) -> Option<(S, f64)> {
    let first = residuals(start)?;
    let attempt = |at: &S, r: &DVector<f64>, damping: f64| {
        let mut jacobian = DMatrix::zeros(r.len(), unknowns);
        for j in 0..unknowns {
            let mut step = DVector::zeros(unknowns);
            step[j] = STEP;
            let column = (residuals(&stepped(at, &step))? - r) / STEP;
            jacobian.set_column(j, &column);
        }
        let mut h = jacobian.tr_mul(&jacobian);
        for j in 0..unknowns {
            h[(j, j)] *= 1.0 + damping;
        }
        let step = h.cholesky()?.solve(&-jacobian.tr_mul(r));
        let trial = stepped(at, &step);
        let Some(next) = residuals(&trial) else {
            return Some(Attempt::Worse);
        };
        let gain = r.norm_squared() - next.norm_squared();
        Some(if gain < 0.0 || gain.is_nan() {
            Attempt::Worse
        } else if gain < 1e-9 * r.norm_squared() + little {
            Attempt::Last(trial, next)
        } else {
            Attempt::Better(trial, next)
        })
    };
    let found = descend(start.clone(), first, &DAMPING, attempt)?;
    let cost = found.linear.norm_squared();
    Some((found.at, cost))
}

/// Solves the joint problem of [`mod@super::joint`] in this way, without its search for outliers.
/// Returns the estimate and its cost.
///
/// # Errors
/// [`Refusal`] of the data, or of a start outside the robot's domain.
pub fn joint_dense(data: &Data, options: &Options) -> Result<(State, f64), Refusal> {
    let usable = usable(data)?;
    let model = model(&usable, options);
    let mut state = start(&usable, &model.layout);
    initial_lengths(&usable.data, &mut state)?;
    let shared = model.layout.len();
    let unknowns = shared + model.layout.local() * usable.data.poses.len();
    minimise(
        &state,
        unknowns,
        1e-5,
        |state| residuals(&model, &options.priors, state),
        |state, step| {
            let (shared, own) = step.as_slice().split_at(shared);
            state.stepped(&usable.data, &model.layout, shared, own)
        },
    )
    .ok_or_else(|| Refusal::NotConverged {
        what: "the start is outside the robot's domain".to_owned(),
    })
}

fn residuals(model: &Model<'_>, priors: &Priors, state: &State) -> Option<DVector<f64>> {
    let cables = singles(state).ok()?;
    let mut out = Vec::new();
    for k in 0..state.poses.len() {
        model
            .rows(state, &cables, k, |row| out.push(row.residual))
            .ok()?;
    }
    let priors = state.priors(model.data, &model.layout, priors);
    out.extend(priors.iter().map(|prior| prior.deviation / prior.sigma));
    Some(DVector::from_vec(out))
}

#[cfg(test)]
mod tests {
    use super::super::joint::joint;
    use super::super::simulate::{Setup, Target, simulate};
    use super::*;

    #[test]
    fn ends_where_the_joint_method_does() {
        for target in [Target::Tag, Target::Board] {
            let setup = Setup {
                target,
                poses: 9,
                ..Setup::default()
            };
            let (data, _) = simulate(&setup).unwrap();
            let options = Options::default();
            let answer = joint(&data, &options).unwrap();
            assert!(answer.rejected.is_empty() && answer.tension_scatter_relative == Some(0.0));
            let (state, cost) = joint_dense(&data, &options).unwrap();
            assert!(
                cost > answer.chi_square.unwrap(),
                "the priors count as well"
            );
            for (dense, joint) in state.cables.iter().zip(&answer.cables) {
                // A hundredth of the anchors' standard deviation.
                let off = (dense.anchor_m - joint.anchor_m).norm();
                assert!(off < 3e-5, "{target:?}: {off:e}");
            }
        }
    }
}
