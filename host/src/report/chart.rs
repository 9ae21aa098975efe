//! Line charts as SVG that follow a page's colours, with bands, marks on the time axis and curves
//! thinned so that no peak is lost.

use std::fmt::Write as _;

/// One curve.
#[derive(Debug, Clone)]
pub struct Curve {
    /// Its name in the legend.
    pub name: String,
    /// Points in order; a jump in the drawing where a value is not finite.
    pub points: Vec<(f64, f64)>,
    /// Whether it is drawn dashed (planned values).
    pub dashed: bool,
    /// Which of the page's colours, from 0.
    pub color: usize,
}

impl Curve {
    /// A solid curve.
    #[must_use]
    pub fn new(name: impl Into<String>, color: usize, points: Vec<(f64, f64)>) -> Self {
        Self {
            name: name.into(),
            points,
            dashed: false,
            color,
        }
    }

    /// The same, dashed.
    #[must_use]
    pub(crate) const fn dashed(mut self) -> Self {
        self.dashed = true;
        self
    }
}

/// A chart.
#[derive(Debug, Clone, Default)]
pub struct Chart {
    /// Its title.
    pub title: String,
    /// Names of the axes, with units.
    pub axes: (String, String),
    /// The curves.
    pub curves: Vec<Curve>,
    /// Permitted range of the curves.
    pub band: Option<(f64, f64)>,
    /// Marks on the first axis: position, text, and whether it is a fault.
    pub marks: Vec<(f64, String, bool)>,
    /// One scale for both axes: for paths.
    pub square: bool,
    /// Text without axes, for projections.
    pub bare: bool,
}

const WIDTH: f64 = 760.0;
const HEIGHT: f64 = 300.0;
const LEFT: f64 = 62.0;
const RIGHT: f64 = 14.0;
const TOP: f64 = 30.0;
const BOTTOM: f64 = 44.0;
/// Columns into which a curve is thinned.
const COLUMNS: usize = 700;

/// Steps of 1, 2 or 5 times a power of ten, about this many over a range.
fn step(range: f64, count: f64) -> f64 {
    let raw = (range / count).max(1e-12);
    let power = 10_f64.powf(raw.log10().floor());
    let rest = raw / power;
    power
        * if rest <= 1.0 {
            1.0
        } else if rest <= 2.0 {
            2.0
        } else if rest <= 5.0 {
            5.0
        } else {
            10.0
        }
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
}

/// Keeps the least and the greatest of every column.
fn thinned(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    if points.len() <= 2 * COLUMNS {
        return points.to_vec();
    }
    let mut kept = Vec::new();
    for column in points.chunks(points.len().div_ceil(COLUMNS)) {
        let by = |a: &&(f64, f64), b: &&(f64, f64)| a.1.total_cmp(&b.1);
        let (low, high) = (column.iter().min_by(by), column.iter().max_by(by));
        let mut pair: Vec<_> = low.into_iter().chain(high).copied().collect();
        pair.sort_by(|a, b| a.0.total_cmp(&b.0));
        pair.dedup();
        kept.extend(pair);
    }
    kept
}

/// Every n-th point, for paths, which have no columns.
fn spaced(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let every = points.len().div_ceil(2 * COLUMNS).max(1);
    points.iter().step_by(every).copied().collect()
}

impl Chart {
    /// The chart as an `svg` element.
    #[must_use]
    pub fn svg(&self) -> String {
        let height = if self.square { WIDTH * 0.62 } else { HEIGHT };
        let finite = || {
            let points = self.curves.iter().flat_map(|curve| &curve.points);
            points.filter(|(x, y)| x.is_finite() && y.is_finite())
        };
        let mut x = finite().fold((f64::MAX, f64::MIN), |(l, h), p| (l.min(p.0), h.max(p.0)));
        let mut y = finite().fold((f64::MAX, f64::MIN), |(l, h), p| (l.min(p.1), h.max(p.1)));
        if x.0 > x.1 {
            (x, y) = ((0.0, 1.0), (0.0, 1.0));
        }
        if let Some((low, high)) = self.band {
            y = (y.0.min(low), y.1.max(high));
        }
        let pad = ((y.1 - y.0) * 0.06).max(1e-6);
        y = (y.0 - pad, y.1 + pad);
        if x.1 - x.0 < 1e-9 {
            x.1 = x.0 + 1.0;
        }
        let (inner_w, inner_h) = (WIDTH - LEFT - RIGHT, height - TOP - BOTTOM);
        if self.square {
            let unit = ((x.1 - x.0) / inner_w).max((y.1 - y.0) / inner_h) * 1.05;
            let (mx, my) = (0.5 * (x.0 + x.1), 0.5 * (y.0 + y.1));
            x = (mx - 0.5 * unit * inner_w, mx + 0.5 * unit * inner_w);
            y = (my - 0.5 * unit * inner_h, my + 0.5 * unit * inner_h);
        }
        let px = |value: f64| LEFT + (value - x.0) / (x.1 - x.0) * inner_w;
        let py = |value: f64| TOP + (y.1 - value) / (y.1 - y.0) * inner_h;
        let title = escape(&self.title);
        // Writing to a string cannot fail, here and below.
        let mut out = format!(
            "<svg viewBox=\"0 0 {WIDTH} {height:.0}\" role=\"img\" aria-label=\"{title}\"><text \
             class=\"title\" x=\"{LEFT}\" y=\"18\">{title}</text>"
        );
        if let Some((low, high)) = self.band {
            let (top, bottom) = (py(high), py(low));
            let _ = write!(
                out,
                "<rect class=\"band\" x=\"{LEFT}\" y=\"{top:.1}\" width=\"{inner_w}\" \
                 height=\"{:.1}\"/>",
                bottom - top
            );
        }
        if !self.bare {
            self.grid(&mut out, (x, y), (&px, &py), height);
        }
        for (at, what, fault) in &self.marks {
            let (place, class) = (px(*at), if *fault { "fault" } else { "mark" });
            if !(LEFT - 0.5..=WIDTH - RIGHT + 0.5).contains(&place) {
                continue;
            }
            let bottom = height - BOTTOM;
            let _ = write!(
                out,
                "<line class=\"{class}\" x1=\"{place:.1}\" x2=\"{place:.1}\" y1=\"{TOP}\" \
                 y2=\"{bottom:.1}\"><title>{} at {at:.3} s</title></line>",
                escape(what)
            );
        }
        let mut legend = WIDTH - RIGHT;
        for curve in self.curves.iter().rev() {
            let points = if self.square {
                spaced(&curve.points)
            } else {
                thinned(&curve.points)
            };
            let mut path = String::new();
            let mut pen_down = false;
            for (at, value) in points {
                if !value.is_finite() {
                    pen_down = false;
                    continue;
                }
                let kind = if pen_down { 'L' } else { 'M' };
                pen_down = true;
                let _ = write!(path, "{kind}{:.1} {:.1}", px(at), py(value));
            }
            let dash = if curve.dashed { " dashed" } else { "" };
            let color = curve.color % 8;
            let _ = write!(out, "<path class=\"c{color}{dash}\" d=\"{path}\"/>");
            if !curve.name.is_empty() {
                let chars = curve.name.chars().count();
                legend -= 7.0 * f64::from(u32::try_from(chars).unwrap_or(0)) + 34.0;
                let _ = write!(
                    out,
                    "<path class=\"c{color}{dash}\" d=\"M{legend:.0} 14h20\"/><text x=\"{:.0}\" \
                     y=\"18\">{}</text>",
                    legend + 24.0,
                    escape(&curve.name)
                );
            }
        }
        out.push_str("</svg>");
        out
    }

    fn grid(
        &self,
        out: &mut String,
        (x, y): ((f64, f64), (f64, f64)),
        (px, py): (&dyn Fn(f64) -> f64, &dyn Fn(f64) -> f64),
        height: f64,
    ) {
        let bottom = height - BOTTOM;
        let label = |value: f64, step: f64| {
            let digits = if step >= 1.0 {
                0
            } else if step >= 0.1 {
                1
            } else if step >= 0.01 {
                2
            } else {
                3
            };
            // No minus in front of a zero.
            format!(
                "{:.digits$}",
                if value.abs() < step * 1e-6 {
                    0.0
                } else {
                    value
                }
            )
        };
        let along = step(y.1 - y.0, 5.0);
        let mut value = (y.0 / along).ceil() * along;
        while value <= y.1 {
            let at = py(value);
            let _ = write!(
                out,
                "<line class=\"grid\" x1=\"{LEFT}\" x2=\"{}\" y1=\"{at:.1}\" y2=\"{at:.1}\"/>\
                 <text class=\"y\" x=\"{}\" y=\"{:.1}\">{}</text>",
                WIDTH - RIGHT,
                LEFT - 6.0,
                at + 4.0,
                label(value, along)
            );
            value += along;
        }
        let along = step(x.1 - x.0, 10.0);
        let mut value = (x.0 / along).ceil() * along;
        while value <= x.1 {
            let at = px(value);
            let _ = write!(
                out,
                "<line class=\"grid\" x1=\"{at:.1}\" x2=\"{at:.1}\" y1=\"{TOP}\" y2=\"{bottom:.1}\"/>\
                 <text class=\"x\" x=\"{at:.1}\" y=\"{:.1}\">{}</text>",
                bottom + 16.0,
                label(value, along)
            );
            value += along;
        }
        let _ = write!(
            out,
            "<text class=\"x\" x=\"{:.0}\" y=\"{:.0}\">{}</text><text class=\"x\" \
             transform=\"translate(14 {:.0}) rotate(-90)\">{}</text>",
            LEFT + (WIDTH - LEFT - RIGHT) * 0.5,
            height - 8.0,
            escape(&self.axes.0),
            TOP + (height - TOP - BOTTOM) * 0.5,
            escape(&self.axes.1)
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thinning_keeps_every_peak() {
        let mut points: Vec<_> = (0..50_000).map(|i| (f64::from(i), 0.0)).collect();
        points[31_337].1 = 9.0;
        points[44_444].1 = -7.0;
        let kept = thinned(&points);
        assert!(kept.len() <= 2 * COLUMNS + 2);
        assert!(kept.contains(&(31_337.0, 9.0)) && kept.contains(&(44_444.0, -7.0)));
        assert!(kept.is_sorted_by(|a, b| a.0 <= b.0));
    }

    #[test]
    fn steps_are_round_and_labels_are_escaped() {
        for (range, wanted) in [(10.0, 2.0), (1.0, 0.2), (0.04, 0.01), (70.0, 20.0)] {
            assert!((step(range, 5.0) - wanted).abs() < 1e-9 * wanted, "{range}");
        }
        let chart = Chart {
            title: "a < b & c".to_owned(),
            curves: vec![Curve::new("n", 0, vec![(0.0, f64::NAN), (1.0, 2.0)])],
            ..Chart::default()
        };
        let svg = chart.svg();
        assert!(
            svg.contains("a &lt; b &amp; c") && !svg.contains("NaN"),
            "{svg}"
        );
    }
}
