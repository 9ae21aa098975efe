//! Charts beside and below each other as a file of its own.

use super::{Chart, WIDTH, escape};
use std::fmt::Write as _;

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

    /// The picture as the text of an SVG file, on white.
    #[must_use]
    pub(crate) fn svg(&self) -> String {
        let mut body = String::new();
        // Each chart goes where there is most room, so that a tall one leaves no hole.
        let mut tops = vec![34.0_f64; self.columns.min(self.charts.len().max(1))];
        for chart in &self.charts {
            let shortest = (0_u32..).zip(&mut tops).min_by(|a, b| a.1.total_cmp(b.1));
            let Some((column, top)) = shortest else {
                continue;
            };
            let left = f64::from(column) * (WIDTH + GAP);
            let (_, height) = chart.element("");
            let place =
                format!(" x=\"{left:.0}\" y=\"{top:.0}\" width=\"{WIDTH}\" height=\"{height:.0}\"");
            body += &chart.element(&place).0;
            *top += height + GAP;
        }
        let count = u32::try_from(tops.len()).unwrap_or(1);
        let top = tops.into_iter().fold(0.0, f64::max);
        let width = f64::from(count) * (WIDTH + GAP) - GAP;
        let title = escape(&self.title);
        let mut out = String::new();
        // Writing to a string cannot fail.
        let _ = writeln!(
            out,
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width:.0}\" height=\"{top:.0}\" \
             viewBox=\"0 0 {width:.0} {top:.0}\"><rect width=\"100%\" height=\"100%\" \
             fill=\"#ffffff\"/><text x=\"6\" y=\"21\" font-size=\"15\" font-weight=\"600\" \
             font-family=\"system-ui,'DejaVu Sans',sans-serif\" fill=\"#17202a\">{title}</text>\
             {body}</svg>"
        );
        out
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
