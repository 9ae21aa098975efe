//! Levenberg-Marquardt on the joint problem, with rejection of rows that do not fit.

use super::data::Data;
use super::error::Refusal;
use super::leverage::Leverages;
use super::normal::{Normal, Reduced, Step, Weights};
use super::rows::{Model, Source, singles};
use super::unknowns::{Priors, State};
use super::variance::{Rows, Widening, freedoms, of_fisher};
use mcdpr_kinematics::{Attempt, Damping, Descent};
use nalgebra::DMatrix;

/// A row farther off than this many standard deviations is rejected.
/// Of a million normal residuals 7 are, by chance.
const REJECT: f64 = 4.5;
/// Scale of the robust loss (Cauchy) in standard deviations, while outliers are sought.
const ROBUST: f64 = 2.5;

/// A minimum of the joint problem.
#[derive(Debug, Clone)]
pub struct Minimum {
    /// The estimate.
    pub state: State,
    /// The normal equations at the estimate.
    pub normal: Normal,
    /// The same with the poses eliminated.
    pub reduced: Reduced,
    /// Covariance of the shared unknowns.
    pub covariance: DMatrix<f64>,
    /// 1 for rows that were used, 0 for rejected ones.
    pub weights: Weights,
    /// Leverage of each row.
    pub leverage: Weights,
    /// Source of each row.
    pub sources: Vec<Vec<Source>>,
    /// Relative scatter of the tensions beyond the sensor's.
    pub tension_relative: f64,
    /// Force that the equations of equilibrium leave unexplained, level and vertical, N: standard deviations, larger by what
    /// a region of 95 % needs because they were estimated from few poses.
    pub force_n: [f64; 2],
    /// Moment, about level axes and about the vertical, N m, likewise.
    pub moment_nm: [f64; 2],
    /// The priors, as wide as the data want them.
    pub priors: Priors,
    /// Steps taken.
    pub iterations: usize,
}

/// Damping relative to the diagonal.
const DAMPING: Damping = Damping {
    start: 1e-5,
    least: 1e-12,
    most: 1e8,
    after_success: 0.1,
    after_failure: 30.0,
    steps: 40,
};

/// Minimises with fixed weights.
fn descend(
    model: &Model<'_>,
    priors: &Priors,
    start: &State,
    weights: &Weights,
    most: usize,
) -> Result<Descent<State, Normal>, Refusal> {
    let outside = || Refusal::NotConverged {
        what: "the start is outside the robot's domain".to_owned(),
    };
    let normal = Normal::at(model, priors, start, weights).ok_or_else(outside)?;
    let attempt = |state: &State, normal: &Normal, damping: f64| {
        let little = 1e-5 + 1e-9 * normal.cost();
        let step = normal.reduced(damping).and_then(|reduced| reduced.step());
        let Some(Step {
            shared,
            own,
            expected,
        }) = step
        else {
            return Some(Attempt::Worse);
        };
        if damping < 1e-4 && expected < little {
            // A three hundredth of a standard deviation: another step is not worthwhile.
            return Some(Attempt::Enough);
        }
        let trial = state.stepped(model.data, &model.layout, shared.as_slice(), own.as_slice());
        Some(match Normal::at(model, priors, &trial, weights) {
            // At the minimum the cost only changes by its rounding.
            Some(next) if next.cost() <= normal.cost() * (1.0 + 1e-12) => {
                let gain = normal.cost() - next.cost();
                if gain.max(expected * 0.1) < little {
                    Attempt::Last(trial, next)
                } else {
                    Attempt::Better(trial, next)
                }
            }
            _ => Attempt::Worse,
        })
    };
    let damping = Damping {
        steps: most,
        ..DAMPING
    };
    mcdpr_kinematics::descend(start.clone(), normal, &damping, attempt).ok_or_else(outside)
}

/// The start: nominal values, poses from the pictures, initial lengths from both.
pub(super) fn initial_lengths(data: &Data, state: &mut State) -> Result<(), Refusal> {
    let cables = singles(state).map_err(|error| Refusal::NotConverged {
        what: error.to_string(),
    })?;
    for (i, cable) in cables.iter().enumerate() {
        let mut all = Vec::new();
        for (pose, seen) in state.poses.iter().zip(&data.poses) {
            if let (Some(dl), Ok([length])) = (seen.encoder_m[i], cable.lengths_m(pose)) {
                all.push(length - dl);
            }
        }
        // The median: one wrong reading or picture does not move the start.
        all.sort_by(f64::total_cmp);
        state.initial_length_m[i] =
            *all.get(all.len() / 2)
                .ok_or_else(|| Refusal::NotConverged {
                    what: format!("cable {}: no pose has its length", i + 1),
                })?;
    }
    Ok(())
}

fn examine(
    model: &Model<'_>,
    state: &State,
    reduced: &Reduced,
    covariance: &DMatrix<f64>,
) -> Option<Rows> {
    let cables = singles(state).ok()?;
    let mut out = Rows {
        leverage: Vec::new(),
        sources: Vec::new(),
    };
    let mut leverages = Leverages::new(reduced, covariance);
    for k in 0..state.poses.len() {
        let rows = model.row_bound(k);
        let (mut leverage, mut sources) = (Vec::with_capacity(rows), Vec::with_capacity(rows));
        model
            .rows(state, &cables, k, |row| {
                leverage.push(leverages.of(k, row).clamp(0.0, 1.0));
                sources.push(row.source);
            })
            .ok()?;
        out.leverage.push(leverage);
        out.sources.push(sources);
    }
    Some(out)
}

/// Rounds of widening priors and scatter before outliers are sought.
const WIDENINGS: usize = 40;

/// What is known at a descent's end.
struct Weighed {
    reduced: Reduced,
    covariance: DMatrix<f64>,
    rows: Rows,
}

/// The normal equations without the poses, the covariance and each row's leverage at a descent's end.
fn weighed(model: &Model<'_>, descent: &Descent<State, Normal>) -> Result<Weighed, &'static str> {
    const SINGULAR: &str = "the normal equations are singular";
    let reduced = descent.linear.reduced(0.0).ok_or(SINGULAR)?;
    let covariance = reduced.covariance().ok_or(SINGULAR)?;
    let rows = examine(model, &descent.at, &reduced, &covariance)
        .ok_or("the estimate left the robot's domain")?;
    Ok(Weighed {
        reduced,
        covariance,
        rows,
    })
}

/// Source of each row.
fn sources_of(model: &Model<'_>, state: &State) -> Option<Vec<Vec<Source>>> {
    let cables = singles(state).ok()?;
    let mut out = Vec::with_capacity(state.poses.len());
    for k in 0..state.poses.len() {
        let mut sources = Vec::new();
        model
            .rows(state, &cables, k, |row| sources.push(row.source))
            .ok()?;
        out.push(sources);
    }
    Some(out)
}

/// Residuals in standard deviations of the residual itself, where the measurement is overdetermined.
fn studentised(residual: f64, leverage: f64) -> f64 {
    // Near a leverage of 1 the estimate follows the row: the residual is rounding and shows
    // nothing.
    residual / (1.0 - leverage).max(0.05).sqrt()
}

/// Robust ratio of the tensions' scatter to the assumed one (from the median of the squares).
fn tension_ratio(normal: &Normal, rows: &Rows, weights: &Weights) -> Option<(f64, usize)> {
    let mut squares = Vec::new();
    for (k, sources) in rows.sources.iter().enumerate() {
        for (j, source) in sources.iter().enumerate() {
            let free = 1.0 - rows.leverage[k][j];
            if matches!(source, Source::Tension(_)) && free > 0.02 && weights[k][j] > 0.0 {
                squares.push(normal.residuals[k][j].powi(2) / free);
            }
        }
    }
    squares.sort_by(f64::total_cmp);
    let median = *squares.get(squares.len() / 2)?;
    // Median of chi-square with one degree of freedom.
    Some((median / 0.4549, squares.len()))
}

/// Solves the joint problem from nominal values and given platform poses.
///
/// # Errors
/// [`Refusal::NotConverged`].
pub fn solve(model: &Model<'_>, assumed: &Priors, mut start: State) -> Result<Minimum, Refusal> {
    initial_lengths(model.data, &mut start)?;
    let mut model = model.clone();
    let mut own_priors = *assumed;
    let priors = &mut own_priors;
    let unsolved = |what: &str| Refusal::NotConverged {
        what: what.to_owned(),
    };
    let mut weights: Weights = Vec::new();
    let mut descent = descend(&model, priors, &start, &weights, 40)?;
    let mut iterations = descent.steps;
    weights = descent
        .linear
        .residuals
        .iter()
        .map(|list| vec![1.0; list.len()])
        .collect();
    let worst = |normal: &Normal| {
        let all = normal.residuals.iter().flatten();
        all.fold(0.0_f64, |a, r| a.max(r.abs()))
    };
    // First what machines have in general: outliers are sought in what this does not explain.
    let mut last = None;
    for _ in 0..WIDENINGS {
        let Ok(found) = weighed(&model, &descent) else {
            break;
        };
        let (rows, covariance) = (&found.rows, &found.covariance);
        let mut robust = weights.clone();
        let scale = ROBUST.max(2.0 * spread(&descent.linear));
        for (k, list) in robust.iter_mut().enumerate() {
            for (j, weight) in list.iter_mut().enumerate() {
                let off = together(&descent.linear.residuals[k], &rows.sources[k], j) / scale;
                if !matches!(rows.sources[k][j], Source::Balance(_)) {
                    *weight = 1.0 / (1.0 + off * off);
                }
            }
        }
        let mut widening = Widening {
            model: &mut model,
            priors,
            assumed,
        };
        let mut changed = widening.step(&descent, rows, covariance, &robust);
        if let Some((ratio, count)) = tension_ratio(&descent.linear, rows, &weights)
            && changed
            && let Some(relative) = wider(&model, ratio, count)
        {
            model.scatter.tension_relative = relative;
            changed = true;
        }
        if !changed {
            // Nothing has moved since: without outliers the rounds below begin with the same.
            last = Some(found);
            break;
        }
        descent = descend(&model, priors, &descent.at, &robust, 8)?;
        iterations += descent.steps;
    }
    let outliers = worst(&descent.linear) > REJECT;
    if outliers {
        let sources = sources_of(&model, &descent.at)
            .ok_or_else(|| unsolved("the estimate left the robot's domain"))?;
        // Outliers bias the fit: reduce their weight in steps, from a wide loss to a narrow one.
        let mut scale = spread(&descent.linear) * 4.0;
        for _ in 0..14 {
            scale = (scale * 0.5).min(spread(&descent.linear) * 4.0).max(ROBUST);
            for (k, list) in weights.iter_mut().enumerate() {
                for (j, weight) in list.iter_mut().enumerate() {
                    let r = together(&descent.linear.residuals[k], &sources[k], j) / scale;
                    *weight = match sources[k][j] {
                        // Equilibrium is not a reading: it has no outliers.
                        Source::Balance(_) => 1.0,
                        _ => 1.0 / (1.0 + r * r),
                    };
                }
            }
            let before = descent.linear.residuals.clone();
            descent = descend(&model, priors, &descent.at, &weights, 8)?;
            iterations += descent.steps;
            let change = (before
                .iter()
                .flatten()
                .zip(descent.linear.residuals.iter().flatten()))
            .fold(0.0_f64, |a, (x, y)| a.max((x - y).abs() / (1.0 + x.abs())));
            if scale <= ROBUST && change < 0.05 {
                break;
            }
        }
    }
    // What was known before outliers lost their weight is of another minimum.
    let mut known = last.filter(|_| !outliers);
    for round in 0..10 {
        let known = match known.take() {
            Some(known) => known,
            None => weighed(&model, &descent).map_err(unsolved)?,
        };
        let Weighed {
            reduced,
            covariance,
            rows,
        } = known;
        let mut settled = true;
        let mut widening = Widening {
            model: &mut model,
            priors,
            assumed,
        };
        if round < 4 && widening.step(&descent, &rows, &covariance, &weights) {
            settled = false;
        }
        // Later rounds keep the scatter, so that the set of rejected rows can settle.
        if round < 6
            && let Some((ratio, count)) = tension_ratio(&descent.linear, &rows, &weights)
            && let Some(relative) = wider(&model, ratio, count)
        {
            model.scatter.tension_relative = relative;
            settled = false;
        }
        for (k, list) in weights.iter_mut().enumerate() {
            for (j, weight) in list.iter_mut().enumerate() {
                let used = if *weight == 0.0 {
                    0.0
                } else {
                    rows.leverage[k][j]
                };
                let off = studentised(
                    together(&descent.linear.residuals[k], &rows.sources[k], j),
                    used,
                );
                let fits = matches!(rows.sources[k][j], Source::Balance(_)) || off < REJECT;
                let next = if fits { 1.0 } else { 0.0 };
                // After some rounds a row at the limit stays rejected: it must not oscillate.
                if *weight != next && !(round > 4 && next == 1.0) {
                    *weight = next;
                    settled = false;
                }
            }
        }
        if settled || round == 9 {
            // A scatter that comes from the data is itself uncertain.
            let freedoms = freedoms(&model, &rows, &weights);
            let known = freedoms.iter().flatten().flatten();
            let freedom = known.copied().reduce(|sum, one| sum + one);
            let covariance = covariance * freedom.map_or(1.0, of_fisher);
            let [of_forces, of_moments] = freedoms;
            return Ok(Minimum {
                state: descent.at,
                normal: descent.linear,
                reduced,
                covariance,
                weights,
                leverage: rows.leverage,
                sources: rows.sources,
                tension_relative: model.scatter.tension_relative,
                force_n: uncertain(model.scatter.force_n, of_forces),
                moment_nm: uncertain(model.scatter.moment_nm, of_moments),
                priors: *priors,
                iterations,
            });
        }
        descent = descend(&model, priors, &descent.at, &weights, 20)?;
        iterations += descent.steps;
    }
    Err(unsolved("the rejected rows do not settle"))
}

/// Standard deviations that were estimated with these degrees of freedom, larger by what a region of 95 % needs for that.
fn uncertain(sigmas: [f64; 2], freedoms: [Option<f64>; 2]) -> [f64; 2] {
    let [level, vertical] = freedoms.map(|freedom| freedom.map_or(1.0, of_fisher).sqrt());
    [sigmas[0] * level, sigmas[1] * vertical]
}

/// A row's residual; of a corner, the larger of both axes, since a corner is rejected as a whole.
fn together(residuals: &[f64], sources: &[Source], j: usize) -> f64 {
    let own = residuals[j].abs();
    match sources[j] {
        Source::Corner(_, _, 0) => own.max(residuals[j + 1].abs()),
        Source::Corner(..) => own.max(residuals[j - 1].abs()),
        _ => own,
    }
}

/// Robust standard deviation of all residuals.
fn spread(normal: &Normal) -> f64 {
    let mut all: Vec<f64> = normal.residuals.iter().flatten().map(|r| r.abs()).collect();
    all.sort_by(f64::total_cmp);
    (1.4826 * all.get(all.len() / 2).copied().unwrap_or(1.0)).max(0.5)
}

/// The relative scatter of tensions that explains the ratio, if it differs from the present one by
/// more than chance.
fn wider(model: &Model<'_>, ratio: f64, count: usize) -> Option<f64> {
    let now = model.scatter.tension_relative;
    // The median of n squares scatters by about 2.3/sqrt(n).
    let chance = 2.0 * 2.3 / (count.max(1) as f64).sqrt();
    if (ratio - 1.0).abs() < chance.min(0.8) || (now == 0.0 && ratio < 1.0) {
        return None;
    }
    let sigma = model.data.noise.tension_n?;
    let mut squares: Vec<f64> = Vec::new();
    for pose in &model.data.poses {
        squares.extend(pose.tension_n.iter().flatten().map(|t| t * t));
    }
    squares.sort_by(f64::total_cmp);
    let typical = squares.get(squares.len() / 2)?.max(1e-6);
    let variance = ratio * (sigma * sigma + now * now * typical) - sigma * sigma;
    // 10 % at most: above 6 % the data are refused in any case.
    let next = (variance.max(0.0) / typical).sqrt().min(0.1);
    ((next - now).abs() > 1e-3).then_some(next)
}
