//! `mcdpr calibrate target`: the sheet to print.

use super::collect::On;
use crate::calibration::drawing::Drawing;
use crate::calibration::result::write_whole;
use crate::calibration::sheets::{Paper, Sheets, sheets};
use crate::calibration::target::{TargetError, sheet, tables, tags};
use crate::chart::sheets_pdf;
use crate::cli::{Common, Failed, Outcome, print_json, write_out};
use crate::robot::Tag;
use std::path::PathBuf;

/// Draw tags to print, at true scale with a ruler, and the lines for the robot file
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// The tags; a board is more accurate than one tag, loose tags less accurate than a board
    #[arg(value_enum, default_value_t = On::Board)]
    target: On,
    /// The paper: several sheets with marks if the target is larger, or one sheet of the target's own size
    #[arg(long, value_enum, default_value_t = Format::A4)]
    paper: Format,
    /// File to write, .svg or .pdf. A PDF has a page for each sheet. As SVG several bodies or sheets have one file
    /// each, with their numbers before the ending
    #[arg(long, value_name = "FILE", default_value = "target.svg")]
    out: PathBuf,
}

/// What is printed on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Format {
    /// Sheets of 210 x 297 mm
    A4,
    /// Sheets of 297 x 420 mm
    A3,
    /// One sheet as large as the target, for a print shop
    One,
}

impl Format {
    /// The drawings of one body, and what they are.
    fn drawings(self, tags: &[Tag], body: u32) -> Result<(Vec<Drawing>, String), TargetError> {
        let paper = match self {
            Self::A4 => Paper::A4,
            Self::A3 => Paper::A3,
            Self::One => {
                return Ok((
                    vec![sheet(tags, body)?],
                    "one sheet of its own size".to_owned(),
                ));
            }
        };
        let Sheets {
            drawings,
            grid: [across, down],
            landscape,
        } = sheets(tags, body, paper)?;
        let side = if landscape { "landscape" } else { "portrait" };
        let name = paper.name();
        let words = match drawings.len() {
            1 => format!("one sheet of {name}, {side}"),
            count => format!("{count} sheets of {name}, {side}, {across} across and {down} down"),
        };
        Ok((drawings, words))
    }
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let ending = self
            .out
            .extension()
            .map(|ending| ending.to_ascii_lowercase());
        let as_pdf = match ending.as_ref().and_then(|ending| ending.to_str()) {
            Some("svg") => false,
            Some("pdf") => true,
            _ => {
                let reason = format!("{}: sheets are drawn as .svg or .pdf", self.out.display());
                return Err(Failed::from_error("--out")(reason).into());
            }
        };
        let tags = match self.target.target() {
            Some(target) => tags(target),
            None => crate::robot::find(&common.robot)?.tags,
        };
        let mut bodies: Vec<u32> = tags.iter().map(|tag| tag.body).collect();
        bodies.sort_unstable();
        bodies.dedup();
        let (mut files, mut printed, mut joined, mut pages) =
            (Vec::new(), Vec::new(), false, Vec::new());
        for &body in &bodies {
            let (drawings, words) = self.paper.drawings(&tags, body)?;
            let many = drawings.len() > 1;
            for (k, drawing) in drawings.into_iter().enumerate() {
                if as_pdf {
                    pages.push(drawing);
                    continue;
                }
                let mut ending = String::new();
                if bodies.len() > 1 {
                    ending += &format!("{body}.");
                }
                if many {
                    ending += &format!("{}.", k + 1);
                }
                let path = match ending.as_str() {
                    "" => self.out.clone(),
                    ending => self.out.with_extension(format!("{ending}svg")),
                };
                files.push((path, drawing.svg().into_bytes()));
            }
            printed.push(words);
            joined |= many;
        }
        if as_pdf {
            let file = sheets_pdf("Tags to print at 100 %", &pages)
                .map_err(Failed::from_error("--out"))?;
            files.push((self.out.clone(), file));
        }
        if !common.dry_run {
            for (path, bytes) in &files {
                write_whole(path, bytes)?;
            }
        }
        let files: Vec<String> = files
            .iter()
            .map(|(path, _)| path.display().to_string())
            .collect();
        let tables = tables(&tags);
        if common.json {
            return print_json(&serde_json::json!({
                "files": files, "sheets": printed, "robot_file": tables,
            }));
        }
        write_out(&tables);
        for (words, body) in printed.iter().zip(&bodies) {
            say!("# body {body}: {words}");
        }
        say!("# {}: print at 100 % and check the ruler", files.join(", "));
        if joined {
            say!(
                "# join the sheets on a flat plate: cut along the lines, let the crosses meet, and check the \
                 distance between far corners of two tags; --paper one is more accurate"
            );
        }
        Ok(())
    }
}
