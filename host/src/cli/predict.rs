//! `mcdpr predict`: predicts readings that were left out from the others, with intervals.

use super::table::lay_out;
use super::{Common, Failed, Outcome, print_json, write_out};
use crate::calibration::general::fit::{Options, fit};
use crate::calibration::general::model::Group;
use crate::calibration::general::predict::{Answer, Given, HALF_95, predict};
use crate::calibration::general::study::{Errors, given};
use crate::calibration::general::verdict::{verdict, without_moving};
use crate::calibration::general::{Priors, Set};
use crate::chart::{PlotError, PlotFormat};
use crate::report::predict_figure;
use std::path::PathBuf;

/// Predict the readings that are not given, with 95 % intervals, from a calibration by some sessions
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// Samples as JSON: see docs/calibration.md
    #[arg(long, value_name = "FILE")]
    data: PathBuf,
    /// The session to learn from; all others are predicted. May be given several times
    #[arg(long, value_name = "SESSION", required = true)]
    train: Vec<String>,
    /// The readings that are given: length1, tension4, swivel2, roll, pitch, yaw. Without: all
    /// lengths but the last cable's, and its tension
    #[arg(long, value_name = "READING", value_delimiter = ',')]
    given: Vec<String>,
    /// Draw errors with their intervals, residuals of the calibration by sensor and session, and what the data add to
    /// each unknown: .svg, .png or .pdf
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let plot = self.plot.as_deref();
        let plot = plot.map(|path| Ok::<_, PlotError>((path, PlotFormat::of(path)?)));
        let plot = plot.transpose()?;
        let what = format!("data {}", self.data.display());
        let text = crate::files::read_text(&self.data).map_err(Failed::from_error(&what))?;
        let set = Set::from_json(&text)?;
        let mut sessions = Vec::new();
        for name in &self.train {
            let unknown = || {
                let known = set.sessions.join(", ");
                let reason = format!("there is no session {name}; there are {known}");
                Failed::from_error(&what)(reason)
            };
            sessions.push(set.session(name).ok_or_else(unknown)?);
        }
        let cables = set.cable_count();
        let known = if self.given.is_empty() {
            given(cables)
        } else {
            let read = |word: &String| {
                reading(word, cables).ok_or_else(|| {
                    Failed::from_error("--given")(format!(
                        "{word} is not a reading of a robot with {cables} cables: write length1, \
                         tension4, swivel2, roll, pitch or yaw"
                    ))
                })
            };
            self.given.iter().map(read).collect::<Result<_, _>>()?
        };
        let seen = without_moving(&set.only(|_, sample| sessions.contains(&sample.session)));
        let found = fit(&seen, &Options::default()).map_err(Failed::from_error(&what))?;
        let said = verdict(&found);
        if let Some(reason) = &said.refused {
            return Err(Failed::from_error(&what)(reason.clone()).into());
        }
        let rest = set.only(|_, sample| !sessions.contains(&sample.session));
        let mut notes = seen.notes.clone();
        notes.extend(said.slips);
        notes.extend(said.contradicted);
        let mut answers = Vec::new();
        for answer in predict(&found, &rest, &known, &Priors::default()) {
            match answer {
                Ok(answer) => answers.push(answer),
                Err(reason) => notes.push(reason),
            }
        }
        if let Some((path, kind)) = plot {
            let named = |group, index| name(group, index, &rest);
            let figure = predict_figure(&set.id, &found, &rest, &answers, &named);
            crate::files::write_atomically(path, figure.file(kind)?)
                .map_err(Failed::from_error("writing the plot"))?;
        }
        if common.json {
            let samples: Vec<_> = answers.iter().map(|answer| json(answer, &rest)).collect();
            return print_json(&serde_json::json!({
                "errors": Errors::of(&answers), "samples": samples, "notes": notes,
            }));
        }
        let head = ["sample", "reading", "off by", "95 % within", "unit", ""];
        let mut table = vec![head.map(str::to_owned).to_vec()];
        for answer in &answers {
            for one in &answer.readings {
                let unit = one.group.unit();
                table.push(vec![
                    rest.name(answer.sample),
                    name(one.group, one.index, &rest),
                    format!("{:+.2}", one.error * unit.factor),
                    format!("{:.2}", HALF_95 * one.sigma * unit.factor),
                    unit.symbol.to_owned(),
                    if one.inside() { "" } else { "outside" }.to_owned(),
                ]);
            }
        }
        write_out(&lay_out(&table));
        for note in notes {
            say!("{note}");
        }
        Ok(())
    }
}

fn json(answer: &Answer, set: &Set) -> serde_json::Value {
    let readings: Vec<_> = answer
        .readings
        .iter()
        .map(|one| {
            serde_json::json!({
                "reading": name(one.group, one.index, set), "error": one.error, "sigma": one.sigma,
                "inside": one.inside(),
            })
        })
        .collect();
    serde_json::json!({
        "sample": set.name(answer.sample),
        "position_m": <[f64; 3]>::from(answer.pose.position_m),
        "readings": readings,
    })
}

const TURNS: [&str; 3] = ["roll", "pitch", "yaw"];

fn name(group: Group, index: usize, set: &Set) -> String {
    let tracker = || {
        let tracker = set.trackers.get(index / 3);
        let axis = ["x", "y", "z"][index % 3];
        tracker.map_or_else(String::new, |t| format!("{} {axis}", t.name))
    };
    match group {
        Group::Length => format!("length{}", index + 1),
        Group::Tension => format!("tension{}", index + 1),
        Group::Swivel => format!("swivel{}", index + 1),
        Group::Tilt | Group::Yaw => TURNS.get(index).map_or("", |word| word).to_owned(),
        Group::Position => tracker(),
        Group::Turn => format!("{} (angle)", tracker()),
        Group::Distance => set
            .tapes
            .get(index)
            .map_or_else(String::new, |t| t.name.clone()),
        _ => format!("{}{}", group.name(), index + 1),
    }
}

fn reading(word: &str, cables: usize) -> Option<Given> {
    let word = word.trim();
    if let Some(index) = TURNS.iter().position(|turn| *turn == word) {
        let group = if index < 2 { Group::Tilt } else { Group::Yaw };
        return Some(Given { group, index });
    }
    let kinds = [
        ("length", Group::Length),
        ("tension", Group::Tension),
        ("swivel", Group::Swivel),
    ];
    kinds.iter().find_map(|(kind, group)| {
        let number: usize = word.strip_prefix(kind)?.parse().ok()?;
        (1..=cables).contains(&number).then(|| Given {
            group: *group,
            index: number - 1,
        })
    })
}
