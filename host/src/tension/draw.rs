//! Curves as SVG text.

use plotters::prelude::*;

/// A curve, or points, with a name for the legend.
pub struct Curve<'a> {
    /// Name.
    pub name: &'a str,
    /// Points.
    pub points: Vec<(f64, f64)>,
    /// Crosses instead of a line.
    pub crosses: bool,
}

impl<'a> Curve<'a> {
    /// A line.
    #[must_use]
    pub fn line(name: &'a str, points: impl IntoIterator<Item = (f64, f64)>) -> Self {
        Self {
            name,
            points: points.into_iter().collect(),
            crosses: false,
        }
    }

    /// Single points.
    #[must_use]
    pub fn crosses(name: &'a str, points: impl IntoIterator<Item = (f64, f64)>) -> Self {
        Self {
            crosses: true,
            ..Self::line(name, points)
        }
    }
}

/// Size of a picture, px.
const SIZE: (u32, u32) = (1000, 520);
/// Greatest number of points per line.
const MOST_POINTS: usize = 2500;

/// Draws curves over common axes. Without data the text is empty.
#[must_use]
pub fn draw(title: &str, x: &str, y: &str, curves: &[Curve]) -> String {
    let mut svg = String::new();
    // Drawing into a string fails only through a bug here; a missing picture must not lose figures.
    if render(title, x, y, curves, &mut svg).is_none() {
        svg.clear();
    }
    svg
}

fn render(title: &str, x: &str, y: &str, curves: &[Curve], svg: &mut String) -> Option<()> {
    let points = || curves.iter().flat_map(|curve| &curve.points);
    let range = |of: fn(&(f64, f64)) -> f64| {
        let values = || points().map(of).filter(|value| value.is_finite());
        let low = values().fold(f64::INFINITY, f64::min);
        let high = values().fold(f64::NEG_INFINITY, f64::max);
        let margin = (0.06 * (high - low)).max(1e-6);
        low.is_finite().then_some(low - margin..high + margin)
    };
    let (across, up) = (range(|p| p.0)?, range(|p| p.1)?);
    let colors = [BLUE, RED, BLACK, GREEN, MAGENTA, CYAN];
    let root = SVGBackend::with_string(svg, SIZE).into_drawing_area();
    root.fill(&WHITE).ok()?;
    let mut chart = ChartBuilder::on(&root)
        .caption(title, ("sans-serif", 20))
        .margin(12)
        .x_label_area_size(40)
        .y_label_area_size(60)
        .build_cartesian_2d(across, up)
        .ok()?;
    chart
        .configure_mesh()
        .x_desc(x)
        .y_desc(y)
        .light_line_style(WHITE)
        .draw()
        .ok()?;
    for (curve, color) in curves.iter().zip(colors.into_iter().cycle()) {
        let step = curve.points.len().div_ceil(MOST_POINTS).max(1);
        let points = curve.points.iter().copied().step_by(step);
        let drawn = if curve.crosses {
            chart.draw_series(points.map(|at| Cross::new(at, 5, color.stroke_width(2))))
        } else {
            let line = LineSeries::new(points, color);
            let plain = chart.draw_series(line).ok()?;
            plain
                .label(curve.name)
                .legend(move |(x, y)| PathElement::new([(x, y), (x + 20, y)], color));
            continue;
        };
        drawn
            .ok()?
            .label(curve.name)
            .legend(move |(x, y)| Cross::new((x + 10, y), 5, color));
    }
    chart
        .configure_series_labels()
        .background_style(WHITE)
        .border_style(BLACK)
        .draw()
        .ok()?;
    root.present().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curves_and_crosses_are_drawn_and_nothing_gives_nothing() {
        let svg = draw(
            "a title",
            "x",
            "y",
            &[
                Curve::line("one", [(0.0, 1.0), (1.0, 2.0)]),
                Curve::crosses("two", [(0.5, 1.5)]),
            ],
        );
        assert!(svg.contains("a title") && svg.contains("one") && svg.contains("two"));
        assert!(svg.contains("polyline"));
        assert!(draw("t", "x", "y", &[]).is_empty());
    }
}
