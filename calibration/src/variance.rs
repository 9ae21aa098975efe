//! Scatter and priors that the data widen.
//!
//! What is assumed of a machine holds for a good one. On a real one each drum has its own radius, each
//! load cell its own zero, and the equations of equilibrium do not close. Each such group has one standard
//! deviation, which is estimated by variance components: the sum of the squared residuals over the sum of
//! their redundancies (Foerstner, 1979). It changes only where the residuals, each over its own standard
//! deviation, are larger than chance explains, and never falls below what was assumed: the estimate from
//! data of a good machine is the same as without it.

use super::normal::{Normal, Weights};
use super::rows::{Model, Source};
use super::solve::Rows;
use super::unknowns::{Part, Priors, State};
use mcdpr_kinematics::Descent;
use nalgebra::DMatrix;

/// Greatest change of a standard deviation in one round.
const STEP: f64 = 8.0;
/// A smaller change does not count.
const LITTLE: f64 = 1.1;
/// Redundancy below which a prior's residual says nothing but rounding.
const NOTHING: f64 = 1e-9;
/// Standard deviations of the mean square above which equilibrium counts as disturbed.
const DISTURBED: f64 = 4.0;

/// Mean of `count` squares of standard normal numbers that is exceeded by chance in 1 of 1000 cases (Wilson
/// and Hilferty, 1931).
fn chance(count: f64) -> f64 {
    const Z: f64 = 3.09;
    let part = 2.0 / (9.0 * count);
    (1.0 - part + Z * part.sqrt()).powi(3)
}

/// Adapts priors and the scatter of equilibrium at an estimate. Returns whether any has changed.
pub(crate) fn widened(
    model: &mut Model<'_>,
    priors: &mut Priors,
    assumed: &Priors,
    descent: &Descent<State, Normal>,
    rows: &Rows,
    covariance: &DMatrix<f64>,
    weights: &Weights,
) -> bool {
    let mut changed = widened_priors(model, priors, assumed, descent, covariance);
    if model.layout.statics {
        changed |= widened_balance(model, &descent.linear, rows, weights);
    }
    changed
}

fn widened_priors(
    model: &Model<'_>,
    priors: &mut Priors,
    assumed: &Priors,
    descent: &Descent<State, Normal>,
    covariance: &DMatrix<f64>,
) -> bool {
    let layout = &model.layout;
    let all = descent.at.priors(model.data, layout, priors);
    let least = descent.at.priors(model.data, layout, assumed);
    let mut changed = false;
    for part in Part::ALL {
        let range = part.range(layout);
        let (mut squares, mut redundancy, mut studentised, mut count) = (0.0, 0.0, 0.0, 0.0);
        let mut over = 1.0_f64;
        for (prior, assumed) in all.iter().zip(&least) {
            if !range.contains(&prior.index) {
                continue;
            }
            let variance = prior.sigma * prior.sigma;
            let free = 1.0 - covariance[(prior.index, prior.index)] / variance;
            over = prior.sigma / assumed.sigma;
            if free < NOTHING {
                continue;
            }
            let square = prior.deviation * prior.deviation / variance;
            squares += square;
            redundancy += free;
            studentised += square / free;
            count += 1.0;
        }
        let surprising = count > 0.0 && studentised / count > chance(count);
        if !surprising && over < LITTLE {
            continue;
        }
        let by = (squares / redundancy.max(NOTHING)).sqrt().clamp(1.0 / STEP, STEP);
        // Back to what was assumed at most.
        let by = by.max(1.0 / over);
        if by > LITTLE || by < 1.0 / LITTLE {
            part.widen(priors, by);
            changed = true;
        }
    }
    changed
}

fn widened_balance(
    model: &mut Model<'_>,
    normal: &Normal,
    rows: &Rows,
    weights: &Weights,
) -> bool {
    let mut changed = false;
    for moment in [false, true] {
        let (mut squares, mut redundancy) = (0.0, 0.0);
        for (k, sources) in rows.sources.iter().enumerate() {
            for (j, source) in sources.iter().enumerate() {
                if matches!(source, Source::Balance(axis) if (*axis > 2) == moment) && weights[k][j] > 0.0 {
                    squares += normal.residuals[k][j].powi(2);
                    redundancy += 1.0 - rows.leverage[k][j];
                }
            }
        }
        let assumed = model.assumed;
        let (sigma, least) = if moment {
            (&mut model.scatter.moment_nm, assumed.moment_nm)
        } else {
            (&mut model.scatter.force_n, assumed.force_n)
        };
        let ratio = squares / redundancy.max(1e-6);
        let disturbed = ratio > 1.0 + DISTURBED * (2.0 / redundancy.max(1e-6)).sqrt();
        let over = *sigma / least;
        if !disturbed && over < LITTLE {
            continue;
        }
        let by = ratio.sqrt().clamp(1.0 / STEP, STEP).max(1.0 / over);
        if by > LITTLE || by < 1.0 / LITTLE {
            *sigma *= by;
            changed = true;
        }
    }
    changed
}
