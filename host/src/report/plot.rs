//! A run's path as a picture.

use super::PathPoint;
use crate::chart::{Chart, Curve, Figure};
use crate::motion::{Plan, PlanError};
use nalgebra::Vector3;

/// One measured path to draw.
pub(crate) struct PathTrace<'a> {
    /// Its name in the legend.
    pub name: &'a str,
    /// Its points.
    pub points: &'a [PathPoint],
}

/// Number of points of the desired path.
const POINTS: u32 = 1500;
/// The greatest error is drawn with about this share of the path's width.
const SHOWN: f64 = 0.08;

/// Draws the desired path from above beside the actual ones, their errors magnified on the path, and
/// their errors over time.
///
/// # Errors
/// [`PlanError::Path`] for a plan that cannot be evaluated.
pub(crate) fn draw_path(
    title: &str,
    plan: &Plan,
    traces: &[PathTrace],
) -> Result<Figure, PlanError> {
    let duration_s = plan.timed.duration_s();
    let times_s = (0..=POINTS).map(|index| duration_s * f64::from(index) / f64::from(POINTS));
    let desired_m = times_s
        .map(|time_s| plan.timed.tool_m(time_s))
        .collect::<Result<Vec<_>, _>>()?;
    let mm = |at_m: &Vector3<f64>| (at_m.x * 1e3, at_m.y * 1e3);
    let desired = || Curve::new("desired", 4, desired_m.iter().map(mm)).dashed();
    let mut errors = Vec::new();
    for trace in traces {
        let mut found = Vec::new();
        for point in trace.points {
            let wanted_m = plan.timed.tool_m(point.path_s.min(duration_s))?;
            let off_m = Vector3::from(point.tool_m) - wanted_m;
            found.push((point.path_s, wanted_m, off_m));
        }
        errors.push(found);
    }
    let greatest_m = errors
        .iter()
        .flatten()
        .map(|(_, _, off_m)| off_m.norm())
        .fold(1e-9, f64::max);
    let times = magnification(&desired_m, greatest_m);
    let named = || traces.iter().zip(&errors).enumerate();
    let actual = named().map(|(color, (trace, _))| {
        let points = trace.points.iter().map(|point| mm(&point.tool_m.into()));
        Curve::new(trace.name, color, points)
    });
    let magnified = named().map(|(color, (trace, errors))| {
        let points = errors.iter().map(|(_, at, off)| mm(&(at + off * times)));
        Curve::new(trace.name, color, points)
    });
    let over_time = named().map(|(color, (trace, errors))| {
        let points = errors
            .iter()
            .map(|(at_s, _, off)| (*at_s, off.norm() * 1e3));
        Curve::new(trace.name, color, points)
    });
    let path = Chart::new("Path from above", "x, mm", "y, mm")
        .with(actual)
        .with([desired()])
        .square();
    let enlarged = format!("Path from above, errors {times} times");
    let enlarged = Chart::new(enlarged, "x, mm", "y, mm")
        .with(magnified)
        .with([desired()])
        .square();
    let error = Chart::new("Distance from the desired position", "path time, s", "mm");
    let charts = [path, enlarged, error.with(over_time)];
    Ok(Figure::new(title, 2, charts))
}

/// A round factor that makes the greatest error visible beside the path.
fn magnification(desired_m: &[Vector3<f64>], greatest_m: f64) -> f64 {
    let (mut low_m, mut high_m) = (Vector3::repeat(f64::MAX), Vector3::repeat(f64::MIN));
    for at_m in desired_m {
        low_m = low_m.inf(at_m);
        high_m = high_m.sup(at_m);
    }
    let width_m = (high_m.x - low_m.x).max(high_m.y - low_m.y).max(1e-3);
    let raw = (SHOWN * width_m / greatest_m).max(1.0);
    let power = 10_f64.powf(raw.log10().floor());
    let factors = [5.0, 2.0, 1.0];
    power
        * factors
            .into_iter()
            .find(|f| raw >= f * power)
            .unwrap_or(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_magnification_is_round_and_shows_the_error() {
        let path = [Vector3::zeros(), Vector3::new(0.3, 0.1, 0.0)];
        for (greatest_m, wanted) in [(1e-3, 20.0), (0.24e-3, 100.0), (0.1, 1.0)] {
            let times = magnification(&path, greatest_m);
            assert!((times - wanted).abs() < 1e-9, "{greatest_m}: {times}");
        }
    }
}
