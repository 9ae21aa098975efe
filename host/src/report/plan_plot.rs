//! A plan as a picture: path from above, lengths, tensions, tilt.

use crate::motion::Plan;
use plotters::coord::Shift;
use plotters::prelude::*;

/// Size of the picture, px.
const SIZE: (u32, u32) = (1200, 900);
/// Points per curve.
const POINTS: u32 = 600;

type Failed = Box<dyn std::error::Error>;
type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Curve = (String, Vec<(f64, f64)>);

/// Draws a plan as SVG text; empty if it cannot be drawn.
#[must_use]
pub fn draw_plan(title: &str, plan: &Plan) -> String {
    let mut svg = String::new();
    if render(title, plan, &mut svg).is_err() {
        svg.clear();
    }
    svg
}

fn render(title: &str, plan: &Plan, svg: &mut String) -> Result<(), Failed> {
    let duration_s = plan.timed.duration_s();
    let step_s = (duration_s / f64::from(POINTS)).max(1e-3);
    let states: Vec<_> = plan.states(step_s).collect();
    let mut path = Vec::new();
    for (time_s, _) in &states {
        let at = plan.timed.tool_m(*time_s)? * 1e3;
        path.push((at.x, at.y));
    }
    let first = states.first().map(|(_, rest)| rest.paid_out_m.clone());
    let cables = first.as_ref().map_or(0, Vec::len);
    let curves = |pick: &dyn Fn(usize, usize) -> Option<f64>| -> Vec<Curve> {
        (0..cables)
            .map(|cable| {
                let points = states
                    .iter()
                    .enumerate()
                    .filter_map(|(index, (time_s, _))| Some((*time_s, pick(index, cable)?)));
                (format!("cable {}", cable + 1), points.collect())
            })
            .collect()
    };
    let rest = |index: usize| states.get(index).map(|(_, rest)| rest);
    let lengths = curves(&|index, cable| {
        let start = first.as_ref()?.get(cable)?;
        Some((rest(index)?.paid_out_m.get(cable)? - start) * 1e3)
    });
    let tensions = curves(&|index, cable| rest(index)?.tensions_n().get(cable).copied());
    let tilt = states
        .iter()
        .map(|(time_s, rest)| (*time_s, rest.equilibrium.pose.tilt_rad().to_degrees()));
    let root = SVGBackend::with_string(svg, SIZE).into_drawing_area();
    root.fill(&WHITE)?;
    let root = root.titled(title, ("sans-serif", 20))?;
    let areas = root.split_evenly((2, 2));
    let [a, b, c, d] = &areas[..] else {
        return Ok(());
    };
    chart(
        a,
        ("x, mm", "y, mm"),
        &[("tool, from above".to_owned(), path)],
        true,
    )?;
    chart(
        b,
        ("time, s", "length since the start, mm"),
        &lengths,
        false,
    )?;
    chart(c, ("time, s", "tension, N"), &tensions, false)?;
    chart(
        d,
        ("time, s", "tilt, deg"),
        &[("tilt".to_owned(), tilt.collect())],
        false,
    )?;
    root.present()?;
    Ok(())
}

fn chart(
    area: &Area<'_>,
    axes: (&str, &str),
    curves: &[Curve],
    square: bool,
) -> Result<(), Failed> {
    let (mut low, mut high) = ((f64::MAX, f64::MAX), (f64::MIN, f64::MIN));
    for (x, y) in curves.iter().flat_map(|(_, points)| points) {
        low = (low.0.min(*x), low.1.min(*y));
        high = (high.0.max(*x), high.1.max(*y));
    }
    let mut half = (0.52 * (high.0 - low.0), 0.55 * (high.1 - low.1));
    if square {
        // One scale for both axes, so that a circle looks like one.
        half = (half.0.max(half.1), half.0.max(half.1));
    }
    half = (half.0.max(1e-3), half.1.max(1e-3));
    let middle = (0.5 * (low.0 + high.0), 0.5 * (low.1 + high.1));
    let mut chart = ChartBuilder::on(area)
        .margin(10)
        .x_label_area_size(35)
        .y_label_area_size(55)
        .build_cartesian_2d(
            middle.0 - half.0..middle.0 + half.0,
            middle.1 - half.1..middle.1 + half.1,
        )?;
    chart
        .configure_mesh()
        .x_desc(axes.0)
        .y_desc(axes.1)
        .light_line_style(WHITE)
        .draw()?;
    let colors = [RED, BLUE, MAGENTA, BLACK, CYAN, GREEN];
    for ((name, points), color) in curves.iter().zip(colors.iter().cycle()) {
        let color = *color;
        chart
            .draw_series(LineSeries::new(points.iter().copied(), color))?
            .label(name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 20, y)], color));
    }
    chart
        .configure_series_labels()
        .background_style(WHITE)
        .border_style(BLACK)
        .draw()?;
    Ok(())
}
