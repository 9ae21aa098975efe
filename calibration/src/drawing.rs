//! A sheet to print before it becomes a file: rectangles, lines and words in millimetres.

use std::fmt::Write as _;

/// Width of all lines, mm.
pub const LINE_MM: f64 = 0.2;

/// Something on a sheet; mm from its upper left corner, y down.
#[derive(Debug, Clone, PartialEq)]
pub enum Mark {
    /// A filled rectangle.
    Block {
        /// Its upper left corner.
        at: [f64; 2],
        /// Width and height.
        size: [f64; 2],
        /// Black, otherwise white.
        black: bool,
    },
    /// A thin black line.
    Line {
        /// Where it begins.
        from: [f64; 2],
        /// Where it ends.
        to: [f64; 2],
    },
    /// Words in one line.
    Words {
        /// Begin of their base line.
        at: [f64; 2],
        /// Size of the letters.
        size: f64,
        /// The words.
        text: String,
    },
}

/// A white sheet with marks, in the order in which they are drawn.
#[derive(Debug, Clone, PartialEq)]
pub struct Drawing {
    /// Width and height, mm.
    pub size_mm: [f64; 2],
    /// What is on it.
    pub marks: Vec<Mark>,
}

impl Drawing {
    /// An empty sheet.
    pub(crate) const fn new(size_mm: [f64; 2]) -> Self {
        Self {
            size_mm,
            marks: Vec::new(),
        }
    }

    pub(crate) fn line(&mut self, from: [f64; 2], to: [f64; 2]) {
        self.marks.push(Mark::Line { from, to });
    }

    pub(crate) fn words(&mut self, at: [f64; 2], size: f64, text: &str) {
        let text = text.to_owned();
        self.marks.push(Mark::Words { at, size, text });
    }

    /// The sheet as SVG at true scale.
    #[must_use]
    pub fn svg(&self) -> String {
        let [width, height] = self.size_mm;
        let mut out = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width:.3}mm\" height=\"{height:.3}mm\" \
             viewBox=\"0 0 {width:.3} {height:.3}\">\n\
             <rect x=\"0\" y=\"0\" width=\"{width:.3}\" height=\"{height:.3}\" fill=\"white\"/>\n"
        );
        for mark in &self.marks {
            // Writing to a string cannot fail.
            let _ = match mark {
                Mark::Block {
                    at: [x, y],
                    size: [width, height],
                    black,
                } => {
                    let fill = if *black { "black" } else { "white" };
                    writeln!(
                        out,
                        "<rect x=\"{x:.4}\" y=\"{y:.4}\" width=\"{width:.4}\" height=\"{height:.4}\" fill=\"{fill}\"/>"
                    )
                }
                Mark::Line {
                    from: [x1, y1],
                    to: [x2, y2],
                } => writeln!(
                    out,
                    "<line x1=\"{x1:.3}\" y1=\"{y1:.3}\" x2=\"{x2:.3}\" y2=\"{y2:.3}\" stroke=\"black\" \
                     stroke-width=\"{LINE_MM}\"/>"
                ),
                Mark::Words {
                    at: [x, y],
                    size,
                    text,
                } => writeln!(
                    out,
                    "<text x=\"{x:.2}\" y=\"{y:.2}\" font-size=\"{size}\" font-family=\"sans-serif\">{text}</text>"
                ),
            };
        }
        out.push_str("</svg>\n");
        out
    }
}
