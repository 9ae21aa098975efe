//! A plan as a picture: path from above, lengths, tensions with their limits, tilt.

use crate::chart::{Chart, Curve, Figure, PlotFormat};
use crate::motion::{Plan, PlanError, StaticState};
use mcdpr_core::estimate::tube::Tube;

/// Number of points of a curve.
const POINTS: u32 = 600;

/// Draws a plan as the text of an SVG file.
///
/// # Errors
/// [`PlanError::Path`] for a plan that cannot be evaluated.
pub fn draw_plan(title: &str, plan: &Plan) -> Result<String, PlanError> {
    Ok(plan_figure(title, plan, None)?.svg())
}

/// Draws a plan as the bytes of a PNG file, 300 pixels per inch at the width of a column.
///
/// # Errors
/// A plan that cannot be evaluated, or a picture that cannot be encoded.
pub fn draw_plan_png(title: &str, plan: &Plan) -> miette::Result<Vec<u8>> {
    Ok(plan_figure(title, plan, None)?.file(PlotFormat::Png)?)
}

/// Draws a plan, and how far the tool may be off it.
///
/// # Errors
/// [`PlanError::Path`] for a plan that cannot be evaluated.
pub(crate) fn plan_figure(
    title: &str,
    plan: &Plan,
    tube: Option<&Tube>,
) -> Result<Figure, PlanError> {
    let duration_s = plan.timed.duration_s();
    let step_s = (duration_s / f64::from(POINTS)).max(1e-3);
    let states: Vec<(f64, StaticState)> = plan.states(step_s).collect();
    let mut path = Vec::new();
    for (time_s, _) in &states {
        let at_mm = plan.timed.tool_m(*time_s)? * 1e3;
        path.push((at_mm.x, at_mm.y));
    }
    let start_m = states
        .first()
        .map_or_else(Vec::new, |(_, rest)| rest.paid_out_m.clone());
    let cables = |of: &dyn Fn(&StaticState, usize) -> Option<f64>| -> Vec<Curve> {
        let curve = |cable: usize| {
            let points = states
                .iter()
                .filter_map(|(time_s, rest)| Some((*time_s, of(rest, cable)?)));
            Curve::new(format!("cable {}", cable + 1), cable, points)
        };
        (0..start_m.len()).map(curve).collect()
    };
    let lengths =
        cables(&|rest, cable| Some((rest.paid_out_m.get(cable)? - start_m.get(cable)?) * 1e3));
    let tensions = cables(&|rest, cable| rest.tensions_n().get(cable).copied());
    let tilt = states
        .iter()
        .map(|(time_s, rest)| (*time_s, rest.equilibrium.pose.tilt_rad().to_degrees()));
    let mut charts = vec![
        Chart::new("Path of the tool from above", "x, mm", "y, mm")
            .with([Curve::new("", 0, path)])
            .square(),
        Chart::new("Tensions", "time, s", "N").with(tensions),
        Chart::new("Lengths since the start", "time, s", "mm").with(lengths),
        Chart::new("Tilt of the platform", "time, s", "degrees").with([Curve::new("", 0, tilt)]),
    ];
    if let Some(tube) = tube {
        let points = tube.points.iter();
        let radii = points.map(|point| (point.time_s, point.radius_m * 1e3));
        charts.push(
            Chart::new("The tool is within this of the path, 95 %", "time, s", "mm")
                .with([Curve::new("", 0, radii)]),
        );
    }
    Ok(Figure::new(title, 2, charts))
}
