//! Sheets to print as one PDF file, one page each.

use super::file::PlotError;
use super::letters::Letters;
use super::pdf::{SHEET_POINTS, pdf};
use super::shapes::{Anchor, Shape, Words};
use crate::calibration::drawing::{Drawing, LINE_MM, Mark};

/// Sheets as the bytes of a PDF file at true scale.
///
/// # Errors
/// [`PlotError`]: font or compression.
pub(crate) fn sheets_pdf(title: &str, sheets: &[Drawing]) -> Result<Vec<u8>, PlotError> {
    let pages: Vec<_> = sheets
        .iter()
        .map(|sheet| (sheet.marks.iter().map(shape).collect(), sheet.size_mm))
        .collect();
    pdf(title, &pages, SHEET_POINTS, &Letters::new()?)
}

fn shape(mark: &Mark) -> Shape {
    match mark {
        Mark::Block { at, size, black } => Shape::Rect {
            class: "",
            at: *at,
            size: *size,
            fill: if *black { "#000000" } else { "#ffffff" }.to_owned(),
            opacity: 1.0,
            crisp: false,
        },
        Mark::Line { from, to } => Shape::Lines {
            class: String::new(),
            lines: vec![vec![*from, *to]],
            stroke: "#000000".to_owned(),
            width: LINE_MM,
            dash: &[],
            tip: None,
        },
        Mark::Words { at, size, text } => Shape::Words(Words {
            size: *size,
            fill: "#000000",
            ..Words::new("", Anchor::Start, *at, text)
        }),
    }
}
