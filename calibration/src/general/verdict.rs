//! Data that do not determine an unknown, contradict an entered value, or do not fit.

use super::data::Set;
use super::fit::{Fit, expected};
use super::model::Group;
use super::slip::{self, Candidate};
use super::solve::variance;
use super::unknowns::Unit;

/// Above this cable speed a sample counts as taken in motion, m/s: the inertia of the platform then
/// exceeds the residual of the equations of equilibrium at rest.
pub(crate) const MOVING_MPS: f64 = 0.05;

/// The verdict on a data set and its estimate, in words.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Verdict {
    /// Why the answer must not be used; `None` if it may be.
    pub refused: Option<String>,
    /// Cables that slipped: where, when and by how much.
    pub slips: Vec<String>,
    /// Constants in the robot's description that the data contradict, with the estimated value.
    pub contradicted: Vec<String>,
    /// Readings with almost no weight because they do not fit.
    pub distrusted: Vec<String>,
    /// Unknowns that the data do not determine: they stay at their priors.
    pub open: Vec<String>,
    /// Unknowns of which only a combination is determined.
    pub together: Vec<String>,
}

/// The set without samples that were taken in motion, which are named in its notes.
#[must_use]
pub fn without_moving(set: &Set) -> Set {
    let moving = |speed: Option<f64>| speed.is_some_and(|speed| speed > MOVING_MPS);
    let mut out = set.only(|_, sample| !moving(sample.speed_mps));
    for (k, sample) in set.samples.iter().enumerate() {
        if moving(sample.speed_mps) {
            out.notes.push(format!(
                "{}: a cable moved at {:.0} mm/s: left out",
                set.name(k),
                sample.speed_mps.unwrap_or(0.0) * 1e3
            ));
        }
    }
    out
}

/// Weight below which a reading is named.
/// With six degrees of freedom that is an error of 4.7 times the scatter.
const DISTRUSTED: f64 = 0.25;
/// Standard deviations above which an entered constant counts as contradicted.
/// By chance 6 of 100 000 right ones do.
const CONTRADICTED: f64 = 4.0;
/// Share of its prior above which the data do not determine an unknown.
/// The data then reduce the variance by less than a fifth.
const OPEN: f64 = 0.9;
/// Correlation above which two unknowns cannot be separated.
const ONE: f64 = 0.95;
/// Greatest ratio of the scatter to the expected one.
const SCATTER: f64 = 8.0;

/// Judges an estimate.
#[must_use]
pub fn verdict(fit: &Fit) -> Verdict {
    let mut out = Verdict::default();
    slips(fit, &mut out);
    contradictions(fit, &mut out);
    let (named, all) = distrusted(fit, &mut out);
    observability(fit, &mut out);
    out.refused = refusal(fit, named, all);
    out
}

/// A slip in words, as in "cable 2 slipped by +3.05 mm (1 sigma 0.04) before pose 12".
#[must_use]
pub(crate) fn slip_words(fit: &Fit, slip: usize) -> String {
    let jump = &fit.layout.breaks[slip];
    let at = fit.layout.jump(slip);
    format!(
        "cable {} slipped by {:+.2} mm (1 sigma {:.2}) before {}",
        jump.cable + 1,
        fit.solution.state.theta[at] * 1e3,
        fit.solution.covariance[(at, at)].sqrt() * 1e3,
        fit.set.name(jump.from)
    )
}

fn slips(fit: &Fit, out: &mut Verdict) {
    for j in 0..fit.layout.breaks.len() {
        let words = slip_words(fit, j);
        out.slips
            .push(format!("{words}: it is counted as a jump from there on"));
    }
    let left = slip::candidates(fit)
        .into_iter()
        .filter(|c: &Candidate| c.gain > slip::GAIN)
        .max_by(|a, b| a.gain.total_cmp(&b.gain));
    if let Some(left) = left {
        out.slips.push(format!(
            "cable {} may have slipped once more, by {:+.2} mm before {}",
            left.slip.cable + 1,
            left.size_m * 1e3,
            fit.set.name(left.slip.from)
        ));
    }
}

fn contradictions(fit: &Fit, out: &mut Verdict) {
    for (i, unknown) in fit.unknowns.iter().enumerate() {
        let Some(entered) = unknown.entered else {
            continue;
        };
        let prior = unknown.sigma * unknown.sigma;
        let fixed = prior - fit.solution.covariance[(i, i)];
        // Its information is too small to contradict.
        if fixed < 0.02 * prior {
            continue;
        }
        let off = fit.solution.state.theta[i] - unknown.mean;
        // With a right entry the shift has this variance: prior minus posterior.
        if off.abs() < CONTRADICTED * fixed.sqrt() {
            continue;
        }
        let Unit {
            factor,
            symbol: unit,
        } = unknown.unit;
        out.contradicted.push(format!(
            "{} is entered as {:.3} {unit}, the data want {:.3} {unit}",
            unknown.name,
            entered * factor,
            // The estimate lies between entry and data: this is the value of the data alone.
            (entered + off * prior / fixed) * factor
        ));
    }
}

/// Names the readings with almost no weight: how many, of how many.
fn distrusted(fit: &Fit, out: &mut Verdict) -> (usize, usize) {
    let (mut named, mut all) = (0, 0);
    for (k, (block, trust)) in fit.solution.blocks.iter().zip(&fit.trust).enumerate() {
        for (row, trust) in block.rows.iter().zip(trust) {
            // Statics are no reading that a user could check.
            if !row.group.is_sensor() {
                continue;
            }
            all += 1;
            if *trust > DISTRUSTED {
                continue;
            }
            named += 1;
            let what = row.group.name();
            let Unit {
                factor,
                symbol: unit,
            } = row.group.unit();
            let of = match row.group {
                Group::Length | Group::Tension | Group::Swivel => {
                    format!("cable {}'s {what}", row.index + 1)
                }
                Group::Position | Group::Turn => {
                    let tracker = fit.set.trackers.get(row.index / 3);
                    format!("{what} of {}", tracker.map_or("?", |t| t.name.as_str()))
                }
                Group::Distance => {
                    let tape = fit.set.tapes.get(row.index);
                    format!("{what} of tape {}", tape.map_or("?", |t| t.name.as_str()))
                }
                _ => what.to_owned(),
            };
            out.distrusted.push(format!(
                "{}: {of} is off by {:.2} {unit}, {:.0} times its scatter",
                fit.set.name(k),
                row.residual.abs() * factor,
                row.residual.abs() / variance(row, &fit.scatter).sqrt()
            ));
        }
    }
    (named, all)
}

fn observability(fit: &Fit, out: &mut Verdict) {
    let covariance = &fit.solution.covariance;
    let of = |i: usize| covariance[(i, i)].sqrt();
    for (i, unknown) in fit.unknowns.iter().enumerate() {
        // An eyelet's radius is not an unknown.
        if unknown.sigma.is_finite() && unknown.sigma > 1e-8 && of(i) > OPEN * unknown.sigma {
            let Unit {
                factor,
                symbol: unit,
            } = unknown.unit;
            let name = &unknown.name;
            out.open
                .push(format!("{name} (+-{:.2} {unit})", of(i) * factor));
        }
    }
    let n = fit.layout.cables;
    let gains: Vec<usize> = (0..n).map(|i| fit.layout.gain(i)).collect();
    let mass = fit.layout.mass();
    let with = |at: usize| gains.iter().map(|&g| covariance[(g, at)]).sum::<f64>();
    let total: f64 = gains.iter().map(|&g| with(g)).sum();
    if (with(mass) / (total.sqrt() * of(mass))).abs() > ONE {
        out.together.push(
            "the cells' common gain and the mass are one unknown: weigh the platform".to_owned(),
        );
    }
    for (a, one) in fit.unknowns.iter().enumerate() {
        for (b, other) in fit.unknowns.iter().enumerate().skip(a + 1) {
            let correlation = covariance[(a, b)] / (of(a) * of(b));
            // A session's own part and the common one are the same quantity.
            if correlation.abs() > ONE && !other.name.starts_with(one.name.as_str()) {
                out.together.push(format!(
                    "{} and {} are nearly one unknown",
                    one.name, other.name
                ));
            }
        }
    }
}

fn refusal(fit: &Fit, named: usize, all: usize) -> Option<String> {
    let expected = expected(&fit.set);
    for group in Group::ALL {
        let g = group.index();
        if fit.scatter[g] > SCATTER * expected[g] {
            let what = group.name();
            let Unit {
                factor,
                symbol: unit,
            } = group.unit();
            return Some(format!(
                "no robot like this one fits the data: each {what} scatters by {:.2} {unit}, {:.2} are \
                 expected; check units, order of the cables, and that every sample was at rest",
                fit.scatter[g] * factor,
                expected[g] * factor
            ));
        }
    }
    (named * 5 > all).then(|| {
        format!(
            "{named} of {all} readings fit no common robot: check units and order of the cables"
        )
    })
}
