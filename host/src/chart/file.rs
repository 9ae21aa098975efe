//! Figures as files: SVG, PNG, PDF.

use super::{Figure, letters, pdf, pixels};
use miette::Diagnostic;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Kind of a plot's file.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum PlotFormat {
    /// For a browser, and to be edited
    #[default]
    Svg,
    /// Pixels, 300 per inch: 1004 for a column of 85 mm
    Png,
    /// For print, a column 85 mm wide, with its letters
    Pdf,
}

/// Why a plot cannot be written.
#[derive(Debug, Error, Diagnostic)]
pub(crate) enum PlotError {
    /// The name says nothing or something else.
    #[error("{path}: a plot is a file .svg, .png or .pdf, {found}")]
    #[diagnostic(
        code(mcdpr::plot::ending),
        help("end the name with .svg, .png or .pdf")
    )]
    Ending {
        /// The name.
        path: PathBuf,
        /// What it has instead.
        found: String,
    },
    /// The figure is too large.
    #[error(
        "a plot of {width:.0} x {height:.0} px is too large for a PNG: write it as .svg or .pdf"
    )]
    #[diagnostic(code(mcdpr::plot::size))]
    Size {
        /// Its width.
        width: f64,
        /// Its height.
        height: f64,
    },
    /// The embedded font cannot be read.
    #[error("the program's own font cannot be read: {0}")]
    #[diagnostic(code(mcdpr::plot::font), help("build the program again"))]
    Font(#[from] ttf_parser::FaceParsingError),
    /// The pixels cannot be encoded.
    #[error("the plot cannot be encoded: {0}")]
    #[diagnostic(code(mcdpr::plot::encoding))]
    Encoding(#[from] png::EncodingError),
    /// A part cannot be compressed.
    #[error("the plot cannot be compressed: {0}")]
    #[diagnostic(code(mcdpr::plot::compression))]
    Compression(#[from] std::io::Error),
}

impl PlotFormat {
    /// The kind that a file's ending asks for.
    ///
    /// # Errors
    /// [`PlotError::Ending`].
    pub(crate) fn of(path: &Path) -> Result<Self, PlotError> {
        let ending = path.extension().map(|ending| ending.to_string_lossy());
        let found = match ending.as_deref().map(str::to_ascii_lowercase).as_deref() {
            Some("svg") => return Ok(Self::Svg),
            Some("png") => return Ok(Self::Png),
            Some("pdf") => return Ok(Self::Pdf),
            Some(other) => format!("not .{other}"),
            None => "and the name has no ending".to_owned(),
        };
        Err(PlotError::Ending {
            path: path.to_owned(),
            found,
        })
    }

    /// The ending of its files, without a dot.
    pub(crate) const fn ending(self) -> &'static str {
        match self {
            Self::Svg => "svg",
            Self::Png => "png",
            Self::Pdf => "pdf",
        }
    }
}

impl Figure {
    /// The picture as the bytes of a file.
    ///
    /// # Errors
    /// [`PlotError`], but not its ending.
    pub(crate) fn file(&self, format: PlotFormat) -> Result<Vec<u8>, PlotError> {
        if format == PlotFormat::Svg {
            return Ok(self.svg().into_bytes());
        }
        let letters = letters::Letters::new()?;
        let (title, shapes, size) = self.shapes();
        match format {
            PlotFormat::Svg | PlotFormat::Png => pixels::png(&shapes, size, &letters),
            PlotFormat::Pdf => pdf::pdf(title, &[(shapes, size)], pdf::PLOT_POINTS, &letters),
        }
    }
}
