//! What a chart consists of before it becomes a file: rectangles, lines and words, and the same as SVG.

use std::fmt::Write as _;

/// Something to draw; px, y down.
#[derive(Debug, Clone)]
pub(super) enum Shape {
    /// A filled rectangle.
    Rect {
        /// Its class in a page's style sheet, or none.
        class: &'static str,
        at: [f64; 2],
        size: [f64; 2],
        fill: String,
        opacity: f64,
        /// Its edges are on whole pixels, so that neighbours leave no seam.
        crisp: bool,
    },
    /// Lines through points.
    Lines {
        class: String,
        lines: Vec<Vec<[f64; 2]>>,
        stroke: String,
        width: f64,
        /// Lengths of dashes and gaps, or none.
        dash: &'static [f32],
        /// Words that a browser shows under the pointer.
        tip: Option<String>,
    },
    /// Words.
    Words(Words),
}

/// Words in one line.
#[derive(Debug, Clone)]
pub(super) struct Words {
    pub(super) class: &'static str,
    pub(super) text: String,
    /// Their place on the base line.
    pub(super) at: [f64; 2],
    pub(super) anchor: Anchor,
    /// Size of the letters.
    pub(super) size: f64,
    pub(super) bold: bool,
    pub(super) fill: &'static str,
    /// Whether they run upwards.
    pub(super) upwards: bool,
}

/// What of the words is at their place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Anchor {
    Start,
    Middle,
    End,
}

/// Size of the words of a chart, px.
pub(super) const SIZE: f64 = 12.0;
/// Colour of the words of a chart.
pub(super) const DIM: &str = "#3c4854";
/// Colour of titles.
pub(super) const DARK: &str = "#17202a";

impl Words {
    /// Plain words.
    pub(super) fn new(
        class: &'static str,
        anchor: Anchor,
        at: [f64; 2],
        text: impl Into<String>,
    ) -> Self {
        Self {
            class,
            text: text.into(),
            at,
            anchor,
            size: SIZE,
            bold: false,
            fill: DIM,
            upwards: false,
        }
    }

    /// A title of a size.
    pub(super) fn title(at: [f64; 2], size: f64, text: impl Into<String>) -> Self {
        Self {
            size,
            bold: true,
            fill: DARK,
            ..Self::new("title", Anchor::Start, at, text)
        }
    }

    fn svg(&self, out: &mut String) {
        out.push_str("<text");
        if !self.class.is_empty() {
            let _ = write!(out, " class=\"{}\"", self.class);
        }
        match self.anchor {
            Anchor::Start => {}
            Anchor::Middle => out.push_str(" text-anchor=\"middle\""),
            Anchor::End => out.push_str(" text-anchor=\"end\""),
        }
        let [x, y] = self.at;
        if self.upwards {
            let _ = write!(out, " transform=\"translate({x:.0} {y:.0}) rotate(-90)\"");
        } else {
            let _ = write!(out, " x=\"{x:.1}\" y=\"{y:.1}\"");
        }
        if self.bold {
            out.push_str(" font-weight=\"600\"");
        }
        if self.size != SIZE {
            let _ = write!(out, " font-size=\"{}\"", self.size);
        }
        if self.fill != DIM {
            let _ = write!(out, " fill=\"{}\"", self.fill);
        }
        let _ = write!(out, ">{}</text>", escape(&self.text));
    }
}

impl Shape {
    /// Adds it to the text of an SVG element. Writing to a string cannot fail.
    pub(super) fn svg(&self, out: &mut String) {
        match self {
            Self::Rect {
                class,
                at: [x, y],
                size: [width, height],
                fill,
                opacity,
                crisp,
            } => {
                out.push_str("<rect");
                if !class.is_empty() {
                    let _ = write!(out, " class=\"{class}\"");
                }
                if *crisp {
                    out.push_str(" shape-rendering=\"crispEdges\"");
                }
                let _ = write!(
                    out,
                    " x=\"{x:.1}\" y=\"{y:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" fill=\"{fill}\""
                );
                if *opacity < 1.0 {
                    let _ = write!(out, " fill-opacity=\"{opacity}\"");
                }
                out.push_str("/>");
            }
            Self::Lines {
                class,
                lines,
                stroke,
                width,
                dash,
                tip,
            } => {
                let _ = write!(
                    out,
                    "<path class=\"{class}\" fill=\"none\" stroke=\"{stroke}\""
                );
                let _ = write!(out, " stroke-width=\"{width}\" stroke-linejoin=\"round\"");
                if !dash.is_empty() {
                    let dash: Vec<_> = dash.iter().map(f32::to_string).collect();
                    let _ = write!(out, " stroke-dasharray=\"{}\"", dash.join(" "));
                }
                out.push_str(" d=\"");
                for line in lines {
                    for (index, [x, y]) in line.iter().enumerate() {
                        let kind = if index == 0 { 'M' } else { 'L' };
                        let _ = write!(out, "{kind}{x:.1} {y:.1}");
                    }
                }
                match tip {
                    Some(tip) => {
                        let _ = write!(out, "\"><title>{}</title></path>", escape(tip));
                    }
                    None => out.push_str("\"/>"),
                }
            }
            Self::Words(words) => words.svg(out),
        }
    }

    /// The same, this much further right and down.
    pub(super) fn moved(mut self, [right, down]: [f64; 2]) -> Self {
        let shift = |[x, y]: &mut [f64; 2]| {
            *x += right;
            *y += down;
        };
        match &mut self {
            Self::Rect { at, .. } => shift(at),
            Self::Lines { lines, .. } => lines.iter_mut().flatten().for_each(shift),
            Self::Words(words) => shift(&mut words.at),
        }
        self
    }
}

/// Red, green and blue of `#RRGGBB`; black for anything else.
pub(super) fn rgb(color: &str) -> [u8; 3] {
    [1, 3, 5].map(|from| {
        let digits = color.get(from..from + 2);
        digits.map_or(0, |hex| u8::from_str_radix(hex, 16).unwrap_or(0))
    })
}

pub(super) fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}
