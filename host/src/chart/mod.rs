//! The one way to draw: line charts, points and maps as SVG, PNG and PDF.
//!
//! A chart becomes shapes once, and they serve three places: a page, whose style sheet may override the colours
//! by class, a drawing of its own ([`Figure`]), for which every colour is also an attribute, and a file of
//! pixels or for print ([`PlotFormat`]), whose letters are those of an embedded font. Widths
//! and sizes of text are chosen for one column of a journal (85 mm), where text is then 6 points.
//! The colours of curves can be distinguished by colour-blind readers (Okabe and Ito, 2008).

mod axes;
mod figure;
mod file;
mod letters;
mod pdf;
mod pixels;
mod shapes;
mod sheets;

pub(crate) use figure::Figure;
pub(crate) use file::{PlotError, PlotFormat};
pub(crate) use sheets::sheets_pdf;

use axes::{Frame, Span};
use shapes::{Anchor, DIM, SIZE, Shape, Words, escape};

/// Width of a chart, px.
const WIDTH: f64 = 480.0;
/// Its width on paper: a column of a journal, mm.
const COLUMN_MM: f64 = 85.0;
/// Height of a chart's plotting area, px; that of a square one is its width.
const HEIGHT: f64 = 190.0;
/// Number of columns into which a curve is thinned.
const COLUMNS: usize = 420;
/// Distance between two rows of the legend, px.
const ROW: f64 = 17.0;
/// Colours of curves; the page's style sheet has the same names.
const COLORS: [&str; 8] = [
    "#0072b2", "#d55e00", "#009e73", "#8a2fb5", "#17202a", "#b3261e", "#00798c", "#777777",
];

/// How a curve is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Stroke {
    Solid,
    /// Planned values.
    Dashed,
    /// Single measurements.
    Crosses,
}

/// One curve.
#[derive(Debug, Clone)]
pub struct Curve {
    name: String,
    /// Points in order; the line is interrupted where a value is not finite.
    points: Vec<[f64; 2]>,
    stroke: Stroke,
    color: usize,
}

impl Curve {
    /// A solid curve with one of the eight colours, from 0. Without a name it is not in the legend.
    pub(crate) fn new(
        name: impl Into<String>,
        color: usize,
        points: impl IntoIterator<Item = (f64, f64)>,
    ) -> Self {
        Self {
            name: name.into(),
            points: points.into_iter().map(|(x, y)| [x, y]).collect(),
            stroke: Stroke::Solid,
            color: color % COLORS.len(),
        }
    }

    /// The same, dashed: for planned values.
    pub(crate) const fn dashed(mut self) -> Self {
        self.stroke = Stroke::Dashed;
        self
    }

    /// The same as single crosses: for measurements that are not a sequence.
    pub(crate) const fn crosses(mut self) -> Self {
        self.stroke = Stroke::Crosses;
        self
    }

    fn color(&self) -> &'static str {
        COLORS.get(self.color).copied().unwrap_or("#000000")
    }

    fn class(&self) -> String {
        let dashed = if self.stroke == Stroke::Dashed {
            " dashed"
        } else {
            ""
        };
        format!("c{}{dashed}", self.color)
    }

    /// Its lines as they are drawn.
    fn drawn(&self, lines: Vec<Vec<[f64; 2]>>) -> Shape {
        Shape::Lines {
            class: self.class(),
            lines,
            stroke: self.color().to_owned(),
            width: 1.5,
            dash: if self.stroke == Stroke::Dashed {
                &[5.0, 4.0]
            } else {
                &[]
            },
            tip: None,
        }
    }
}

/// A mark on the first axis.
#[derive(Debug, Clone)]
struct Mark {
    at: f64,
    text: String,
    fault: bool,
}

/// A filled rectangle of a map.
#[derive(Debug, Clone)]
pub(crate) struct Patch {
    /// Its lower left corner, in the chart's units.
    pub min: [f64; 2],
    /// Its upper right corner.
    pub max: [f64; 2],
    /// Its colour, as `#RRGGBB`.
    pub color: String,
}

/// An entry of a map's legend.
#[derive(Debug, Clone)]
struct Chip {
    color: String,
    text: String,
}

/// A chart.
#[derive(Debug, Clone)]
pub struct Chart {
    title: String,
    across: String,
    up: String,
    curves: Vec<Curve>,
    band: Option<[f64; 2]>,
    marks: Vec<Mark>,
    patches: Vec<Patch>,
    chips: Vec<Chip>,
    square: bool,
}

impl Chart {
    /// A chart with a title and the names of its axes, each with its unit.
    pub(crate) fn new(
        title: impl Into<String>,
        across: impl Into<String>,
        up: impl Into<String>,
    ) -> Self {
        Self {
            title: title.into(),
            across: across.into(),
            up: up.into(),
            curves: Vec::new(),
            band: None,
            marks: Vec::new(),
            patches: Vec::new(),
            chips: Vec::new(),
            square: false,
        }
    }

    /// With these curves besides.
    pub(crate) fn with(mut self, curves: impl IntoIterator<Item = Curve>) -> Self {
        self.curves.extend(curves);
        self
    }

    /// With the permitted range of the curves as a shaded band.
    pub(crate) const fn band(mut self, low: f64, high: f64) -> Self {
        self.band = Some([low, high]);
        self
    }

    /// With one scale for both axes, so that a circle is drawn as one.
    pub(crate) const fn square(mut self) -> Self {
        self.square = true;
        self
    }

    /// With a vertical line, red for a fault; a browser shows the text under the pointer.
    pub(crate) fn mark(mut self, at: f64, text: impl Into<String>, fault: bool) -> Self {
        self.marks.push(Mark {
            at,
            text: text.into(),
            fault,
        });
        self
    }

    /// With coloured rectangles, and what each colour means.
    pub(crate) fn map(
        mut self,
        patches: Vec<Patch>,
        legend: impl IntoIterator<Item = (String, String)>,
    ) -> Self {
        self.patches = patches;
        self.chips = legend
            .into_iter()
            .map(|(color, text)| Chip { color, text })
            .collect();
        self
    }

    /// Its title.
    pub(crate) fn title(&self) -> &str {
        &self.title
    }

    /// Whether it has no curves and no map.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.curves.is_empty() && self.patches.is_empty()
    }

    /// The chart as an `svg` element.
    #[must_use]
    pub(crate) fn svg(&self) -> String {
        self.element("").0
    }

    /// The chart as an `svg` element with more attributes, and its height, px.
    fn element(&self, attributes: &str) -> (String, f64) {
        let (shapes, height) = self.shapes();
        let title = escape(&self.title);
        let mut out = format!(
            "<svg{attributes} viewBox=\"0 0 {WIDTH} {height:.0}\" role=\"img\" aria-label=\"{title}\" \
             font-family=\"system-ui,'DejaVu Sans',sans-serif\" font-size=\"{SIZE}\" fill=\"{DIM}\">"
        );
        shapes.iter().for_each(|shape| shape.svg(&mut out));
        out.push_str("</svg>");
        (out, height)
    }

    /// What it consists of, the lowest first, and its height, px.
    fn shapes(&self) -> (Vec<Shape>, f64) {
        let (legend, rows) = self.legend();
        let frame = self.frame(rows);
        let mut shapes = vec![Shape::Words(Words::title([6.0, 15.0], 13.0, &self.title))];
        for patch in &self.patches {
            let ([left, bottom], [right, top]) = (frame.px(patch.min), frame.px(patch.max));
            shapes.push(Shape::Rect {
                class: "",
                at: [left, top],
                size: [right - left, bottom - top],
                fill: patch.color.clone(),
                opacity: 1.0,
                crisp: true,
            });
        }
        if let Some([low, high]) = self.band {
            let [left, right] = frame.sides();
            let (top, bottom) = (frame.px([0.0, high])[1], frame.px([0.0, low])[1]);
            shapes.push(Shape::Rect {
                class: "band",
                at: [left, top],
                size: [right - left, bottom - top],
                fill: "#009e73".to_owned(),
                opacity: 0.13,
                crisp: false,
            });
        }
        frame.draw_grid(&mut shapes, &self.across, &self.up);
        self.draw_marks(&mut shapes, &frame);
        // Last first: the first curve lies on top.
        let curves = self.curves.iter().rev();
        shapes.extend(curves.map(|curve| curve.drawn(self.lines(curve, &frame))));
        shapes.extend(legend);
        (shapes, frame.height())
    }

    /// The ranges of both axes and their places in the picture.
    fn frame(&self, legend_rows: u32) -> Frame {
        let points = self.curves.iter().flat_map(|curve| &curve.points);
        let corners = self.patches.iter().flat_map(|p| [&p.min, &p.max]);
        let (mut across, mut up) = (Span::default(), Span::default());
        for [x, y] in points.chain(corners) {
            if x.is_finite() && y.is_finite() {
                across.include(*x);
                up.include(*y);
            }
        }
        for value in self.band.into_iter().flatten() {
            up.include(value);
        }
        if self.patches.is_empty() {
            up.widen(0.06);
        }
        let top = 22.0 + ROW * f64::from(legend_rows) + 6.0;
        Frame::new(across, up, top, self.square)
    }

    fn draw_marks(&self, shapes: &mut Vec<Shape>, frame: &Frame) {
        let [left, right] = frame.sides();
        let [top, bottom] = frame.ends();
        for Mark { at, text, fault } in &self.marks {
            let [place, _] = frame.px([*at, 0.0]);
            if !(left - 0.5..=right + 0.5).contains(&place) {
                continue;
            }
            let (class, stroke, width, dash): (_, _, _, &[f32]) = if *fault {
                ("fault", "#b3261e", 2.0, &[])
            } else {
                ("mark", "#777777", 1.0, &[2.0, 3.0])
            };
            shapes.push(Shape::Lines {
                class: class.to_owned(),
                lines: vec![vec![[place, top], [place, bottom]]],
                stroke: stroke.to_owned(),
                width,
                dash,
                tip: Some(format!("{text} at {at:.3} s")),
            });
        }
    }

    /// The legend in rows below the title, and the number of rows: never over the curves.
    fn legend(&self) -> (Vec<Shape>, u32) {
        let (mut shapes, mut left, mut row) = (Vec::new(), 6.0, 0);
        let mut place = |chars: usize| {
            let width = 30.0 + 6.6 * f64::from(u32::try_from(chars).unwrap_or(0));
            if row == 0 || left + width > WIDTH - 6.0 {
                (left, row) = (6.0, row + 1);
            }
            let at = [left, 16.0 + ROW * f64::from(row)];
            left += width + 8.0;
            at
        };
        let words = |[x, y]: [f64; 2], text: &str| {
            Shape::Words(Words::new("", Anchor::Start, [x + 23.0, y], text))
        };
        for chip in &self.chips {
            let [x, y] = place(chip.text.chars().count());
            shapes.push(Shape::Rect {
                class: "",
                at: [x, y - 10.0],
                size: [18.0, 11.0],
                fill: chip.color.clone(),
                opacity: 1.0,
                crisp: false,
            });
            shapes.push(words([x, y], &chip.text));
        }
        for curve in self.curves.iter().filter(|curve| !curve.name.is_empty()) {
            let [x, y] = place(curve.name.chars().count());
            let lines = match curve.stroke {
                Stroke::Crosses => cross([x + 9.0, y - 4.0]).to_vec(),
                Stroke::Solid | Stroke::Dashed => vec![vec![[x, y - 4.0], [x + 18.0, y - 4.0]]],
            };
            shapes.push(curve.drawn(lines));
            shapes.push(words([x, y], &curve.name));
        }
        (shapes, row)
    }

    /// A curve as lines in the picture.
    fn lines(&self, curve: &Curve, frame: &Frame) -> Vec<Vec<[f64; 2]>> {
        let finite = |at: &&[f64; 2]| at.iter().all(|value| value.is_finite());
        if curve.stroke == Stroke::Crosses {
            let points = curve.points.iter().filter(finite);
            return points.flat_map(|at| cross(frame.px(*at))).collect();
        }
        let points = if self.square {
            spaced(&curve.points)
        } else {
            thinned(&curve.points)
        };
        let parts = points.split(|at| !finite(&at));
        parts
            .filter(|part| !part.is_empty())
            .map(|part| part.iter().map(|at| frame.px(*at)).collect())
            .collect()
    }
}

/// A cross about a point of the picture.
fn cross([x, y]: [f64; 2]) -> [Vec<[f64; 2]>; 2] {
    let corner = |across: f64, down: f64| [x + 3.5 * across, y + 3.5 * down];
    [
        vec![corner(-1.0, -1.0), corner(1.0, 1.0)],
        vec![corner(-1.0, 1.0), corner(1.0, -1.0)],
    ]
}

/// Keeps the least and the greatest of every column.
fn thinned(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    if points.len() <= 2 * COLUMNS {
        return points.to_vec();
    }
    let mut kept = Vec::new();
    for column in points.chunks(points.len().div_ceil(COLUMNS)) {
        let by = |a: &&[f64; 2], b: &&[f64; 2]| a[1].total_cmp(&b[1]);
        let (low, high) = (column.iter().min_by(by), column.iter().max_by(by));
        // In the order of time: the least may come after the greatest.
        let mut pair: Vec<_> = low.into_iter().chain(high).copied().collect();
        pair.sort_by(|a, b| a[0].total_cmp(&b[0]));
        pair.dedup();
        kept.extend(pair);
    }
    kept
}

/// Every n-th point, for paths, which have no columns; the last is kept.
fn spaced(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let every = points.len().div_ceil(2 * COLUMNS).max(1);
    let mut kept: Vec<_> = points.iter().step_by(every).copied().collect();
    if every > 1 {
        kept.extend(points.last());
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thinning_keeps_every_peak() {
        let mut points: Vec<_> = (0..50_000).map(|i| [f64::from(i), 0.0]).collect();
        points[31_337][1] = 9.0;
        points[44_444][1] = -7.0;
        let kept = thinned(&points);
        assert!(kept.len() <= 2 * COLUMNS + 2);
        assert!(kept.contains(&[31_337.0, 9.0]) && kept.contains(&[44_444.0, -7.0]));
        assert!(kept.is_sorted_by(|a, b| a[0] <= b[0]));
    }

    #[test]
    fn text_is_escaped_and_values_that_are_not_finite_interrupt_the_line() {
        let curve = Curve::new("n", 0, [(0.0, 1.0), (0.5, f64::NAN), (1.0, 2.0)]);
        let svg = Chart::new("a < b & c", "x", "y").with([curve]).svg();
        assert!(svg.contains("a &lt; b &amp; c") && !svg.contains("NaN"));
        let curve = svg.split("class=\"c0\"").nth(1).unwrap();
        let path = curve.split(" d=\"").nth(1).unwrap().split('"').next();
        assert_eq!(path.unwrap().matches('M').count(), 2, "two parts");
    }

    #[test]
    fn the_legend_takes_rows_of_its_own_above_the_curves() {
        let curves = (0..8).map(|i| Curve::new(format!("a longer name {i}"), i, [(0.0, 0.0)]));
        let chart = Chart::new("t", "x", "y").with(curves);
        let (_, rows) = chart.legend();
        assert!(rows >= 3, "{rows}");
        let [top, _] = chart.frame(rows).ends();
        assert!(top > 16.0 + ROW * f64::from(rows));
    }

    #[test]
    fn a_square_chart_has_one_scale() {
        let curve = Curve::new("", 0, [(0.0, 0.0), (30.0, 10.0)]);
        let frame = Chart::new("", "", "").with([curve]).square().frame(0);
        let ([x0, y0], [x1, y1]) = (frame.px([0.0, 0.0]), frame.px([10.0, 10.0]));
        assert!(((x1 - x0) - (y0 - y1)).abs() < 1e-9);
    }
}
