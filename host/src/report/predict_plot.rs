//! Predictions of left-out readings as a picture: errors with their intervals, residuals of what was learnt from, and
//! what the data add to the knowledge of each unknown.

use crate::calibration::general::Set;
use crate::calibration::general::fit::Fit;
use crate::calibration::general::model::Group;
use crate::calibration::general::predict::{Answer, HALF_95};
use crate::chart::{Chart, Curve, Figure};

/// Between neighbouring readings of one sample, in samples: their intervals stand side by side.
const APART: f64 = 0.12;

/// Name of a reading, by its kind and its number.
pub(crate) type Named<'a> = &'a dyn Fn(Group, usize) -> String;

/// Draws the predictions of `answers` (samples of `rest`) by the estimate `found`.
#[must_use]
pub(crate) fn predict_figure(
    name: &str,
    found: &Fit,
    rest: &Set,
    answers: &[Answer],
    named: Named<'_>,
) -> Figure {
    let sensors = || Group::ALL.into_iter().filter(|group| group.is_sensor());
    let mut charts: Vec<Chart> = sensors()
        .filter_map(|group| predictions(group, rest, answers, named))
        .collect();
    charts.extend(sensors().filter_map(|group| residuals(group, found, named)));
    charts.push(worth(found));
    Figure::new(format!("{name}: predictions"), 2, charts)
}

/// One kind of reading: a cross for each error, a line for its 95 % interval.
fn predictions(group: Group, rest: &Set, answers: &[Answer], named: Named<'_>) -> Option<Chart> {
    let unit = group.unit();
    let mut intervals: Vec<(usize, Vec<(f64, f64)>)> = Vec::new();
    let mut errors = Vec::new();
    for answer in answers {
        for one in answer.readings.iter().filter(|one| one.group == group) {
            let at = answer.sample as f64 + 1.0 + APART * one.index as f64;
            let half = HALF_95 * one.sigma * unit.factor;
            let line = [(at, -half), (at, half), (f64::NAN, f64::NAN)];
            match intervals.iter_mut().find(|(index, _)| *index == one.index) {
                Some((_, points)) => points.extend(line),
                None => intervals.push((one.index, line.to_vec())),
            }
            errors.push((at, one.error * unit.factor));
        }
    }
    if errors.is_empty() {
        return None;
    }
    let title = format!(
        "{}: prediction minus reading, in its 95 % interval",
        group.name()
    );
    let lines = intervals
        .into_iter()
        .map(|(index, points)| Curve::new(named(group, index), index, points));
    let chart = Chart::new(title, "sample", format!("off by, {}", unit.symbol))
        .with(lines)
        .with([Curve::new("", ERROR_COLOR, errors).crosses()]);
    Some(marked(chart, rest))
}

/// Black: on every interval's colour.
const ERROR_COLOR: usize = 4;

/// Residuals of one kind of reading in units of its estimated scatter.
fn residuals(group: Group, found: &Fit, named: Named<'_>) -> Option<Chart> {
    let scale = found.scatter.get(group.index()).copied()?;
    let mut curves: Vec<(usize, Vec<(f64, f64)>)> = Vec::new();
    for (k, block) in found.solution.blocks.iter().enumerate() {
        for row in block.rows.iter().filter(|row| row.group == group) {
            let [factor, extra] = row.scale;
            let sigma = (factor * scale).hypot(extra);
            let point = (k as f64 + 1.0, row.residual / sigma);
            // Eight corners of a tag are one curve.
            let index = if group == Group::Corner { 0 } else { row.index };
            match curves.iter_mut().find(|(of, _)| *of == index) {
                Some((_, points)) => points.push(point),
                None => curves.push((index, vec![point])),
            }
        }
    }
    if curves.is_empty() {
        return None;
    }
    let curves = curves
        .into_iter()
        .map(|(index, points)| Curve::new(named(group, index), index, points).crosses());
    let unit = group.unit();
    let title = format!(
        "{}: residuals of the calibration, 1 = {:.2} {}",
        group.name(),
        scale * unit.factor,
        unit.symbol
    );
    let chart = Chart::new(title, "sample", "residual, standard deviations")
        .with(curves)
        .band(-HALF_95, HALF_95);
    Some(marked(chart, &found.set))
}

/// A mark where each session begins.
fn marked(chart: Chart, set: &Set) -> Chart {
    let mut before = None;
    let mut out = chart;
    for (k, sample) in set.samples.iter().enumerate() {
        if before != Some(sample.session) {
            let name = set.sessions.get(sample.session).map_or("", |name| name);
            out = out.mark(k as f64 + 0.75, name, false);
        }
        before = Some(sample.session);
    }
    out
}

/// Standard deviation of each unknown after the data, as a share of that before; by kind of unknown.
fn worth(found: &Fit) -> Chart {
    let mut kinds: Vec<(String, Vec<(f64, f64)>)> = Vec::new();
    for (i, unknown) in found.unknowns.iter().enumerate() {
        if !unknown.sigma.is_finite() || unknown.sigma <= 0.0 {
            continue;
        }
        let (kind, cable) = kind_of(&unknown.name);
        let left = found.solution.covariance[(i, i)].max(0.0).sqrt() / unknown.sigma;
        match kinds.iter_mut().find(|(known, _)| *known == kind) {
            Some((_, points)) => points.push((cable, left)),
            None => kinds.push((kind, vec![(cable, left)])),
        }
    }
    let curves = kinds.into_iter().enumerate().map(|(k, (kind, points))| {
        // Kinds of one colour stand side by side.
        let shift = 0.06 * k as f64 - 0.3;
        let points = points.into_iter().map(|(at, left)| (at + shift, left));
        Curve::new(kind, k, points).crosses()
    });
    Chart::new(
        "what the data leave open: standard deviation after over before",
        "cable; 0: not of one cable",
        "share left",
    )
    .with(curves)
    .band(0.0, 1.0)
}

/// Kind of an unknown by its name, and its cable, 0 if it is not of one: "cable 2's drum" is a drum of cable 2.
fn kind_of(name: &str) -> (String, f64) {
    let Some((cable, rest)) = name
        .strip_prefix("cable ")
        .and_then(|rest| rest.split_once("'s "))
    else {
        return ("others".to_owned(), 0.0);
    };
    let kind = rest
        .split(" in ")
        .next()
        .and_then(|rest| rest.split(" at ").next());
    (
        kind.unwrap_or(rest).to_owned(),
        cable.parse().unwrap_or(0.0),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unknowns_are_grouped_by_their_names() {
        assert_eq!(kind_of("cable 2's drum"), ("drum".to_owned(), 2.0));
        assert_eq!(kind_of("cable 4's anchor in x"), ("anchor".to_owned(), 4.0));
        assert_eq!(kind_of("the mass"), ("others".to_owned(), 0.0));
    }
}
