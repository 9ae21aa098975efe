//! `mcdpr calibrate history`: the calibrations that were in use, and back to one of them.

use crate::calibration::history::{back_to, history, history_path, remember};
use crate::calibration::result::path_for;
use crate::cli::table::lay_out;
use crate::cli::{Common, Failed, Outcome, print_json, write_out};
use serde_json::json;
use std::path::PathBuf;

/// The calibrations that were in use, when and why; `--back-to` uses one of them again
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// Use the calibration with this number again; the present one is kept
    #[arg(long, value_name = "N")]
    back_to: Option<usize>,
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let robot = crate::robot::find(&common.robot)?;
        let file = match common.calibration.as_deref() {
            Some("none") => {
                let reason = "no calibration is in use: leave out --calibration none";
                return Err(Failed::from_error("calibrate history")(reason).into());
            }
            Some(file) => PathBuf::from(file),
            None => path_for(&common.robot),
        };
        if !common.dry_run {
            if let Some(number) = self.back_to {
                back_to(&robot, &file, number)?;
            } else if file.is_file() {
                // Calibrations of before there was a history.
                remember(&robot, &file, "found in use")?;
            }
        }
        let known = history(&robot, &file)?;
        if common.dry_run
            && let Some(number) = self.back_to
            && known.entries.iter().all(|entry| entry.number != number)
        {
            let reason = format!("{} has no entry {number}", history_path(&file).display());
            return Err(Failed::from_error("--back-to")(reason).into());
        }
        let used = crate::files::read_text(&file).ok();
        let last = known.entries.len().saturating_sub(1);
        let in_use = |at: usize| {
            let now = used.as_deref();
            at == last && now.is_some_and(|text| known.entries.get(at).is_some_and(|e| e.is(text)))
        };
        if common.json {
            let entries = known.entries.iter().enumerate().map(|(at, entry)| {
                json!({
                    "number": entry.number, "date": entry.date, "cause": entry.cause,
                    "robot_hash": entry.robot_hash, "moved_mm": entry.moved_mm,
                    "moved_cable": entry.moved_cable, "predicted_error_mm": entry.error_mm,
                    "in_use": in_use(at),
                })
            });
            return print_json(&json!({
                "file": history_path(&file), "calibration": file, "entries": entries.collect::<Vec<_>>(),
                "torn_lines": known.torn,
            }));
        }
        if known.entries.is_empty() {
            say!(
                "no calibration of {} was in use yet; next: mcdpr calibrate all --robot {}",
                robot.name,
                common.robot
            );
            return Ok(());
        }
        let head = [
            "number",
            "date",
            "cause",
            "anchor moved",
            "expected error",
            "",
        ];
        let mut table = vec![head.map(str::to_owned).to_vec()];
        let mm = |value: Option<f64>| value.map_or("-".to_owned(), |v| format!("{v:.2} mm"));
        for (at, entry) in known.entries.iter().enumerate() {
            let moved = match (entry.moved_mm, entry.moved_cable) {
                (Some(v), Some(cable)) => format!("{v:.2} mm, cable {cable}"),
                _ => "-".to_owned(),
            };
            table.push(vec![
                entry.number.to_string(),
                entry.date.clone(),
                entry.cause.clone(),
                moved,
                mm(entry.error_mm),
                if in_use(at) { "in use" } else { "" }.to_owned(),
            ]);
        }
        write_out(&lay_out(&table));
        for line in &known.torn {
            say!(
                "line {line} of {} is torn and was skipped",
                history_path(&file).display()
            );
        }
        Ok(())
    }
}
