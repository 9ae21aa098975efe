//! `mcdpr study real FILE --train SESSION`: the calibration on a real robot's logs.

use crate::calibration::general::Set;
use crate::calibration::general::fit::Options;
use crate::calibration::general::study::{Errors, study};
use crate::cli::table::lay_out;
use crate::cli::{Common, Failed, Outcome, print_json, write_out};
use std::path::PathBuf;

/// How well a calibration from one session predicts readings that it has not used
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// Samples as JSON: version 1 or 2 of the project's format, or source/robot/sensors/samples
    file: PathBuf,
    /// The session for the estimate; every third of its samples is left out
    #[arg(long, value_name = "SESSION")]
    train: String,
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let what = format!("data {}", self.file.display());
        let text = crate::files::read_text(&self.file).map_err(Failed::from_error(&what))?;
        let set = Set::from_json(&text)?;
        let found =
            study(&set, &self.train, &Options::default()).map_err(Failed::from_error(&what))?;
        let notes = &found.notes;
        let verdict = &found.verdict;
        if common.json {
            let by_session: serde_json::Map<_, _> = found
                .by_session
                .iter()
                .map(|of| (of.name.clone(), serde_json::json!(of.errors)))
                .collect();
            return print_json(&serde_json::json!({
                "study": "real",
                "train": self.train,
                "held_out": found.held_out,
                "other_sessions": found.other_sessions,
                "by_session": by_session,
                "first_pose": found.first_poses,
                "refused": verdict.refused,
                "slips": verdict.slips,
                "contradicted": verdict.contradicted,
                "distrusted": verdict.distrusted,
                "not_fixed": verdict.open,
                "one_unknown": verdict.together,
                "notes": notes,
            }));
        }
        let head = [
            "predicted, rms (within 95 %)",
            "samples",
            "length, mm",
            "tilt, deg",
            "tension, N",
            "swivel, deg",
        ];
        let mut table = vec![head.map(str::to_owned).to_vec()];
        table.push(row(
            &format!("every third of {}", self.train),
            &found.held_out,
        ));
        for of in &found.by_session {
            table.push(row(&of.name, &of.errors));
        }
        write_out(&lay_out(&table));
        for first in &found.first_poses {
            say!(
                "first pose of {} from changes of {} samples: {:.1} mm and {:.2} degrees from the \
                 calibrated one, {:.1} mm stated",
                first.session,
                first.samples,
                first.position_mm,
                first.angle_deg,
                first.stated_mm
            );
        }
        let parts = [
            ("refused", verdict.refused.as_slice()),
            ("slipped", verdict.slips.as_slice()),
            ("contradicted", verdict.contradicted.as_slice()),
            ("hardly counted", verdict.distrusted.as_slice()),
            ("left out", notes.as_slice()),
            ("not fixed by the data", verdict.open.as_slice()),
            ("one unknown", verdict.together.as_slice()),
        ];
        for (head, lines) in parts {
            for line in lines {
                say!("{head}: {line}");
            }
        }
        Ok(())
    }
}

fn row(name: &str, errors: &Errors) -> Vec<String> {
    let cell = |rms: Option<f64>, inside: Option<f64>| match (rms, inside) {
        (Some(rms), Some(inside)) => format!("{rms:.2} ({:.0} %)", inside * 100.0),
        _ => "-".to_owned(),
    };
    let inside = &errors.inside;
    vec![
        name.to_owned(),
        errors.samples.to_string(),
        cell(errors.length_mm, inside.length_mm),
        cell(errors.tilt_deg, inside.tilt_deg),
        cell(errors.tension_n, inside.tension_n),
        cell(errors.swivel_deg, inside.swivel_deg),
    ]
}
