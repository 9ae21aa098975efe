//! Plots as SVG text.

use crate::motion::{Plan, PlanError};
use nalgebra::Vector3;
use plotters::prelude::*;

/// One measured path to draw.
pub(crate) struct PathTrace<'a> {
    /// Its name in the legend.
    pub name: &'a str,
    /// Path time (s) and position (m).
    pub points: &'a [(f64, [f64; 3])],
}

/// Size of the picture, px.
const SIZE: (u32, u32) = (1200, 600);
/// Greatest number of points per curve.
const MOST_POINTS: usize = 1500;

/// Draws the desired path from above beside the actual ones, and their errors over time.
///
/// # Errors
/// [`PlanError::Path`] for a plan that cannot be evaluated.
pub(crate) fn draw_path(
    title: &str,
    plan: &Plan,
    traces: &[PathTrace],
) -> Result<String, PlanError> {
    let duration_s = plan.timed.duration_s();
    let mut desired = Vec::new();
    let mut errors: Vec<Vec<(f64, f64)>> = Vec::new();
    for index in 0..=MOST_POINTS {
        #[expect(clippy::cast_precision_loss, reason = "a small count")]
        let time_s = duration_s * index as f64 / MOST_POINTS as f64;
        desired.push(plan.timed.tool_m(time_s)?);
    }
    for trace in traces {
        let mut curve = Vec::new();
        for (time_s, at) in thinned(trace.points) {
            let error = Vector3::from(*at) - plan.timed.tool_m(time_s.min(duration_s))?;
            curve.push((*time_s, error.norm() * 1e3));
        }
        errors.push(curve);
    }
    let mut svg = String::new();
    // Drawing into a string fails only through a bug in this function; a missing picture is then
    // visible, and the run's figures are not lost.
    if render(title, &desired, traces, &errors, duration_s, &mut svg).is_err() {
        svg.clear();
    }
    Ok(svg)
}

fn thinned<T>(points: &[T]) -> impl Iterator<Item = &T> {
    points
        .iter()
        .step_by(points.len().div_ceil(MOST_POINTS).max(1))
}

fn render(
    title: &str,
    desired: &[Vector3<f64>],
    traces: &[PathTrace],
    errors: &[Vec<(f64, f64)>],
    duration_s: f64,
    svg: &mut String,
) -> Result<(), DrawingAreaErrorKind<std::io::Error>> {
    let colors = [RED, BLUE, MAGENTA, CYAN];
    let root = SVGBackend::with_string(svg, SIZE).into_drawing_area();
    let wrong = |error: DrawingAreaErrorKind<_>| match error {
        DrawingAreaErrorKind::LayoutError => DrawingAreaErrorKind::LayoutError,
        DrawingAreaErrorKind::SharingError => DrawingAreaErrorKind::SharingError,
        DrawingAreaErrorKind::BackendError(_) => DrawingAreaErrorKind::LayoutError,
    };
    root.fill(&WHITE).map_err(wrong)?;
    let root = root.titled(title, ("sans-serif", 20)).map_err(wrong)?;
    let (left, right) = root.split_horizontally(SIZE.1);

    let mm = |at: &Vector3<f64>| (at.x * 1e3, at.y * 1e3);
    let (mut low, mut high) = (Vector3::repeat(f64::MAX), Vector3::repeat(f64::MIN));
    for at in desired {
        low = low.inf(at);
        high = high.sup(at);
    }
    // One scale for both axes, so that a circle looks like one.
    let half = 0.55e3 * (high.x - low.x).max(high.y - low.y).max(1e-3);
    let middle = (low + high) * 0.5e3;
    let mut chart = ChartBuilder::on(&left)
        .margin(10)
        .x_label_area_size(35)
        .y_label_area_size(50)
        .build_cartesian_2d(
            middle.x - half..middle.x + half,
            middle.y - half..middle.y + half,
        )
        .map_err(wrong)?;
    chart
        .configure_mesh()
        .x_desc("x, mm")
        .y_desc("y, mm")
        .light_line_style(WHITE)
        .draw()
        .map_err(wrong)?;
    chart
        .draw_series(LineSeries::new(
            desired.iter().map(mm),
            BLACK.stroke_width(3),
        ))
        .map_err(wrong)?
        .label("desired")
        .legend(|(x, y)| PathElement::new([(x, y), (x + 20, y)], BLACK));
    for (trace, color) in traces.iter().zip(colors) {
        let points = thinned(trace.points).map(|(_, at)| (at[0] * 1e3, at[1] * 1e3));
        chart
            .draw_series(LineSeries::new(points, color))
            .map_err(wrong)?
            .label(trace.name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 20, y)], color));
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::LowerRight)
        .background_style(WHITE)
        .border_style(BLACK)
        .draw()
        .map_err(wrong)?;

    let most = errors
        .iter()
        .flatten()
        .map(|(_, error)| *error)
        .fold(1e-3, f64::max);
    let mut chart = ChartBuilder::on(&right)
        .margin(10)
        .x_label_area_size(35)
        .y_label_area_size(50)
        .build_cartesian_2d(0.0..duration_s, 0.0..most * 1.25)
        .map_err(wrong)?;
    chart
        .configure_mesh()
        .x_desc("path time, s")
        .y_desc("distance from the desired place, mm")
        .light_line_style(WHITE)
        .draw()
        .map_err(wrong)?;
    for ((curve, trace), color) in errors.iter().zip(traces).zip(colors) {
        chart
            .draw_series(LineSeries::new(curve.iter().copied(), color))
            .map_err(wrong)?
            .label(trace.name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 20, y)], color));
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .background_style(WHITE)
        .border_style(BLACK)
        .draw()
        .map_err(wrong)?;
    root.present().map_err(wrong)
}
