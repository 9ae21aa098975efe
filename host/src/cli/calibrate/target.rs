//! `mcdpr calibrate target`: the sheet to print.

use super::collect::On;
use crate::calibration::result::write_whole;
use crate::calibration::target::{sheet, tables, tags};
use crate::cli::{Common, Outcome, print_json, write_out};
use std::path::PathBuf;

/// Draw tags to print, at true scale with a ruler, and the lines for the robot file
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// The tags; a board is more accurate than one tag, loose tags less accurate than a board
    #[arg(value_enum, default_value_t = On::Board)]
    target: On,
    /// File to write (SVG); with several bodies, one per body with its number before the ending
    #[arg(long, value_name = "FILE", default_value = "target.svg")]
    out: PathBuf,
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let tags = match self.target.target() {
            Some(target) => tags(target),
            None => crate::robot::find(&common.robot)?.tags,
        };
        let mut bodies: Vec<u32> = tags.iter().map(|tag| tag.body).collect();
        bodies.sort_unstable();
        bodies.dedup();
        let mut files = Vec::new();
        for &body in &bodies {
            let path = if bodies.len() > 1 {
                self.out.with_extension(format!("{body}.svg"))
            } else {
                self.out.clone()
            };
            let drawing = sheet(&tags, body)?;
            if !common.dry_run {
                write_whole(&path, &drawing)?;
            }
            files.push(path.display().to_string());
        }
        let tables = tables(&tags);
        if common.json {
            return print_json(&serde_json::json!({ "files": files, "robot_file": tables }));
        }
        write_out(&tables);
        say!("# {}: print at 100 % and check the ruler", files.join(", "));
        Ok(())
    }
}
