//! Charts beside and below each other as a file of its own.

use super::shapes::{Shape, Words};
use super::{Chart, WIDTH};

/// Distance between charts, px.
const GAP: f64 = 12.0;

/// A picture of several charts under one title.
#[derive(Debug, Clone)]
pub(crate) struct Figure {
    title: String,
    columns: usize,
    charts: Vec<Chart>,
}

impl Figure {
    /// A picture with this many charts in a row.
    pub(crate) fn new(
        title: impl Into<String>,
        columns: usize,
        charts: impl IntoIterator<Item = Chart>,
    ) -> Self {
        Self {
            title: title.into(),
            columns: columns.max(1),
            charts: charts.into_iter().collect(),
        }
    }

    /// Where each chart is, px, and the size of the whole picture.
    fn places(&self) -> (Vec<[f64; 2]>, [f64; 2]) {
        let mut places = Vec::new();
        // Each chart goes where there is most room, so that a tall one leaves no hole.
        let mut tops = vec![34.0_f64; self.columns.min(self.charts.len().max(1))];
        for chart in &self.charts {
            let shortest = (0_u32..).zip(&mut tops).min_by(|a, b| a.1.total_cmp(b.1));
            let Some((column, top)) = shortest else {
                continue;
            };
            places.push([f64::from(column) * (WIDTH + GAP), *top]);
            *top += chart.shapes().1 + GAP;
        }
        let count = u32::try_from(tops.len()).unwrap_or(1);
        let width = f64::from(count) * (WIDTH + GAP) - GAP;
        (places, [width, tops.into_iter().fold(0.0, f64::max)])
    }

    /// The picture as the text of an SVG file, on white.
    #[must_use]
    pub(crate) fn svg(&self) -> String {
        let (places, [width, height]) = self.places();
        let mut out = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width:.0}\" height=\"{height:.0}\" \
             viewBox=\"0 0 {width:.0} {height:.0}\" font-family=\"system-ui,'DejaVu Sans',sans-serif\">\
             <rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>"
        );
        Shape::Words(self.headline()).svg(&mut out);
        for (chart, [left, top]) in self.charts.iter().zip(places) {
            let (_, height) = chart.shapes();
            let place =
                format!(" x=\"{left:.0}\" y=\"{top:.0}\" width=\"{WIDTH}\" height=\"{height:.0}\"");
            out += &chart.element(&place).0;
        }
        out.push_str("</svg>\n");
        out
    }

    fn headline(&self) -> Words {
        Words::title([6.0, 21.0], 15.0, &self.title)
    }

    /// Its name, everything in it, the lowest first, and its size, px.
    pub(super) fn shapes(&self) -> (&str, Vec<Shape>, [f64; 2]) {
        let (places, size) = self.places();
        let mut shapes = vec![Shape::Words(self.headline())];
        for (chart, place) in self.charts.iter().zip(places) {
            let parts = chart.shapes().0.into_iter();
            shapes.extend(parts.map(|shape| shape.moved(place)));
        }
        (&self.title, shapes, size)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chart::Curve;

    #[test]
    fn a_figure_is_as_wide_as_its_columns_and_needs_no_style_sheet() {
        let chart = || {
            let curves = [
                Curve::new("one", 0, [(0.0, 1.0), (1.0, 2.0)]),
                Curve::new("two", 1, [(0.5, 1.5)]).crosses(),
            ];
            Chart::new("a chart", "x", "y").with(curves)
        };
        let svg = Figure::new("a <title>", 2, [chart(), chart(), chart()]).svg();
        assert!(svg.contains("a &lt;title&gt;") && svg.contains("width=\"972\""));
        assert!(svg.contains("stroke=\"#0072b2\"") && svg.contains("stroke=\"#d55e00\""));
        assert_eq!(svg.matches("<svg").count(), 4);
        assert_eq!(svg.matches("<svg").count(), svg.matches("</svg>").count());
    }
}
