//! The estimate: values of the unknowns together with the scatter of every kind of reading.
//!
//! The scatter is estimated by expectation and maximisation over variance components (Dempster,
//! Laird and Rubin, 1977): the variance of a kind of reading is the mean of its squared residuals
//! plus the variance of their predictions. Readings follow Student's distribution with six degrees
//! of freedom (Lange, Little and Taylor, 1989), so an outlier loses its weight automatically.

use super::data::Set;
use super::model::{GROUPS, Group, Model, Row};
use super::solve::{Scatter, Solution, Weights, all_rows, solve, start, variance};
use super::unknowns::{Break, Layout, Priors, Unknown, unknowns};

/// Degrees of freedom of Student's distribution.
const FREEDOM: f64 = 6.0;
/// Variance of that distribution per squared scale.
const TAILS: f64 = FREEDOM / (FREEDOM - 2.0);

/// Choices of the estimate.
#[derive(Debug, Clone, Copy)]
pub struct Options {
    /// Standard deviations of the priors.
    pub priors: Priors,
    /// Rounds of estimating the scatter; 0 keeps the stated scatter.
    pub rounds: usize,
    /// Number of slips that are searched for and modelled as jumps.
    pub slips: usize,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            priors: Priors::default(),
            rounds: 40,
            slips: 3,
        }
    }
}

/// The estimate from the data.
#[derive(Debug, Clone)]
pub struct Fit {
    /// The samples that took part.
    pub set: Set,
    /// Order of the unknowns.
    pub layout: Layout,
    /// The unknowns.
    pub unknowns: Vec<Unknown>,
    /// Length at which the drums' gains have no effect, m.
    pub middle_m: f64,
    /// Values, covariance, rows.
    pub solution: Solution,
    /// Scale of each kind's distribution.
    pub scatter: Scatter,
    /// Weight of each row by Student's distribution, 0 to about 1.2, per sample.
    pub trust: Vec<Vec<f64>>,
    /// Rounds until the scatter settled.
    pub rounds: usize,
}

/// The scatter expected before the data are seen: typical sizes from a real robot's logs.
pub(super) fn expected(set: &Set) -> Scatter {
    let weight = set.robot.mass_kg * mcdpr_kinematics::GRAVITY_MPS2;
    let stated = &set.stated;
    let mut out = [0.0; GROUPS];
    out[Group::Length.index()] = stated.length_m.unwrap_or(5e-4);
    out[Group::Tension.index()] = stated.tension_n.unwrap_or(0.004 * weight);
    out[Group::Swivel.index()] = 3e-3;
    out[Group::Tilt.index()] = 3e-3;
    out[Group::Yaw.index()] = 3e-3;
    // 0.42 % of the weight and 0.78 mm times the weight: the residual of statics there.
    out[Group::Force.index()] = 0.0042 * weight;
    out[Group::Moment.index()] = 0.00078 * weight;
    out[Group::Corner.index()] = stated.corner_px.unwrap_or(0.3);
    // Motion capture and total stations: some tenths of a millimetre; a tape is read to a millimetre.
    out[Group::Position.index()] = stated.position_m.unwrap_or(3e-4);
    out[Group::Turn.index()] = 2e-3;
    out[Group::Distance.index()] = stated.distance_m.unwrap_or(1e-3);
    out
}

impl Fit {
    /// The model at the estimate.
    #[must_use]
    pub fn model(&self) -> Model<'_> {
        Model {
            set: &self.set,
            layout: self.layout.clone(),
            middle_m: self.middle_m,
        }
    }

    /// The scatter with which a new reading is predicted: the variance of the whole distribution.
    #[must_use]
    pub(crate) fn predictive_scatter(&self) -> Scatter {
        self.scatter.map(|s| s * TAILS.sqrt())
    }
}

/// The length at which drums' gains have no effect: the middle of the readings, or of the robot.
fn middle_m(set: &Set) -> f64 {
    let all: Vec<f64> = set
        .samples
        .iter()
        .flat_map(|sample| sample.length_m.iter().flatten().copied())
        .collect();
    if set.robot.absolute && !all.is_empty() {
        return all.iter().sum::<f64>() / all.len() as f64;
    }
    let anchors = set.robot.cables.iter().map(|cable| cable.anchor_m);
    let n = set.cable_count().max(1) as f64;
    let middle = anchors.clone().sum::<nalgebra::Vector3<f64>>() / n;
    anchors.map(|anchor| (anchor - middle).norm()).sum::<f64>() / n
}

/// The layout of a set: every session that has samples.
fn layout(set: &Set, breaks: Vec<Break>) -> Layout {
    let mut sessions: Vec<usize> = set.samples.iter().map(|sample| sample.session).collect();
    sessions.sort_unstable();
    sessions.dedup();
    let seen = set.samples.iter().any(|sample| !sample.views.is_empty());
    Layout {
        cables: set.cable_count(),
        bodies: set
            .eye
            .as_ref()
            .filter(|_| seen)
            .map(|eye| eye.world_from_body.len()),
        trackers: set.tracking(),
        tapes: set.taped(),
        sessions,
        breaks,
    }
}

/// Estimates all unknowns and the scatter of the readings.
///
/// # Errors
/// In words, if the data do not determine the unknowns.
pub fn fit(set: &Set, options: &Options) -> Result<Fit, String> {
    // The frames of trackers follow from poses that the robot's own sensors show.
    let (mut placed, mut before) = (None, None);
    if !set.tracking().is_empty() {
        let alone = fit_with(&set.alone(), options, Vec::new(), None)?;
        placed = Some(set.placed(&alone.solution.state.poses)?);
        before = Some(alone);
    }
    let set = placed.as_ref().unwrap_or(set);
    let mut found = fit_with(set, options, Vec::new(), before.as_ref())?;
    while found.layout.breaks.len() < options.slips {
        let slip = super::slip::largest(&found).or_else(|| super::slip::distrusted(&found));
        let Some(slip) = slip else {
            break;
        };
        let mut breaks = found.layout.breaks.clone();
        // The same jump once more would have no information of its own.
        if breaks.contains(&slip) {
            break;
        }
        breaks.push(slip);
        found = fit_with(set, options, breaks, Some(&found))?;
    }
    Ok(found)
}

/// As [`fit`] with slips at given moments, from an earlier estimate's poses.
///
/// # Errors
/// As [`fit`].
pub(crate) fn fit_with(
    set: &Set,
    options: &Options,
    breaks: Vec<Break>,
    before: Option<&Fit>,
) -> Result<Fit, String> {
    let layout = layout(set, breaks);
    let unknowns = unknowns(set, &layout, &options.priors);
    let middle_m = before.map_or_else(|| middle_m(set), |before| before.middle_m);
    let model = Model {
        set,
        layout: layout.clone(),
        middle_m,
    };
    let centre = expected(set);
    // Start with a wide scatter: the start is far from the answer.
    let mut scatter = if options.rounds == 0 {
        centre
    } else {
        centre.map(|s| 2.0 * s)
    };
    let mut from = start(&model, &unknowns);
    if let Some(before) = before {
        from.poses.clone_from(&before.solution.state.poses);
        from.tensions_n
            .clone_from(&before.solution.state.tensions_n);
        from.camera_from_platform = before.solution.state.camera_from_platform;
        from.world_from_body
            .clone_from(&before.solution.state.world_from_body);
        let old = &before.layout;
        // What comes after the camera has other places where trackers or tapes are new.
        let same = old.trackers == layout.trackers && old.tapes == layout.tapes;
        let kept = if same {
            usize::MAX
        } else {
            layout.after_camera()
        };
        for (value, old) in from
            .theta
            .iter_mut()
            .zip(&before.solution.state.theta)
            .take(kept)
        {
            *value = *old;
        }
        if same {
            from.tracker_from_world
                .clone_from(&before.solution.state.tracker_from_world);
            from.platform_from_target
                .clone_from(&before.solution.state.platform_from_target);
        }
    }
    let rows = all_rows(&model, &from).map_err(|error| error.to_string())?;
    let mut trust: Vec<Vec<f64>> = rows.iter().map(|rows| vec![1.0; rows.len()]).collect();
    let weigh = |rows: &[Vec<Row>], trust: &[Vec<f64>], scatter: &Scatter| -> Weights {
        rows.iter()
            .zip(trust)
            .map(|(rows, trust)| {
                rows.iter()
                    .zip(trust)
                    .map(|(row, t)| t / variance(row, scatter))
                    .collect()
            })
            .collect()
    };
    let mut weights = weigh(&rows, &trust, &scatter);
    let mut solution = solve(&model, &unknowns, &weights, &from, 60)?;
    let mut rounds = 0;
    while rounds < options.rounds {
        rounds += 1;
        let before = scatter;
        let squares = expected_squares(&solution);
        // With a scatter that is still wrong, good rows would look like outliers.
        if rounds > 2 {
            trust = trusted(&solution, &squares, &scatter);
        }
        scatter = components(&solution, &squares, &trust, &scatter, &centre);
        let rows: Vec<Vec<Row>> = solution.blocks.iter().map(|b| b.rows.clone()).collect();
        weights = weigh(&rows, &trust, &scatter);
        // Only the weights have changed: two steps follow them.
        solution = solve(&model, &unknowns, &weights, &solution.state, 2)?;
        let change = scatter
            .iter()
            .zip(&before)
            .map(|(a, b)| (a / b).ln().abs())
            .fold(0.0, f64::max);
        if change < 0.01 && rounds > 5 {
            break;
        }
    }
    Ok(Fit {
        set: set.clone(),
        layout,
        unknowns,
        middle_m,
        solution,
        scatter,
        trust,
        rounds,
    })
}

/// Expected squares of all errors: squared residual plus the variance of its prediction.
fn expected_squares(solution: &Solution) -> Vec<Vec<f64>> {
    solution
        .blocks
        .iter()
        .map(|block| {
            block
                .rows
                .iter()
                .map(|row| {
                    let spread = block.predicted_variance(row, &solution.covariance);
                    row.residual * row.residual + spread
                })
                .collect()
        })
        .collect()
}

/// Weight of each row; the equations of equilibrium of one sample share one.
fn trusted(solution: &Solution, squares: &[Vec<f64>], scatter: &Scatter) -> Vec<Vec<f64>> {
    solution
        .blocks
        .iter()
        .zip(squares)
        .map(|(block, squares)| {
            let balance: Vec<f64> = block
                .rows
                .iter()
                .zip(squares)
                .filter(|(row, _)| !row.group.is_sensor())
                .map(|(row, square)| square / variance(row, scatter))
                .collect();
            // One contact or gust disturbs all six equations: Student's distribution in as many
            // dimensions.
            let together =
                (FREEDOM + balance.len() as f64) / (FREEDOM + balance.iter().sum::<f64>());
            block
                .rows
                .iter()
                .zip(squares)
                .map(|(row, square)| {
                    if row.group.is_sensor() {
                        (FREEDOM + 1.0) / (FREEDOM + square / variance(row, scatter))
                    } else {
                        together
                    }
                })
                .collect()
        })
        .collect()
}

/// The scatter from the expected squares, with the expected scatter counted as one reading.
fn components(
    solution: &Solution,
    squares: &[Vec<f64>],
    trust: &[Vec<f64>],
    scatter: &Scatter,
    centre: &Scatter,
) -> Scatter {
    let mut sums = centre.map(|s| s * s);
    let mut counts = [1.0; GROUPS];
    for ((block, squares), trust) in solution.blocks.iter().zip(squares).zip(trust) {
        for ((row, square), trust) in block.rows.iter().zip(squares).zip(trust) {
            let g = row.group.index();
            let share = scatter[g] * scatter[g] / variance(row, scatter);
            sums[g] += trust * square * share;
            counts[g] += 1.0;
        }
    }
    std::array::from_fn(|g| (sums[g] / counts[g]).sqrt())
}
