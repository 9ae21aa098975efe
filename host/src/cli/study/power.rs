//! `mcdpr study power`: random losses of power, and the errors of the recovery.

use crate::cli::table::lay_out;
use crate::cli::{Common, Failed, Outcome, print_json, write_out};
use crate::motion::Model;
use crate::recovery::study::{Case, Figures, KINDS, Kind, figures, study};
use std::path::PathBuf;

/// Random losses of power on realistic machines, and the errors of the recovery
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// Cuts; the kinds take turns
    #[arg(long, default_value_t = 60, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    runs: u64,
    /// Largest bound of the tool's place that the job allows, mm
    #[arg(long, default_value_t = 5.0, value_name = "MM")]
    bound_mm: f64,
    /// Write every case into this file, a line of JSON each
    #[arg(long, value_name = "FILE")]
    cases: Option<PathBuf>,
}

const fn name(kind: Kind) -> &'static str {
    match kind {
        Kind::Camera => "undisturbed, with camera",
        Kind::NoCamera => "undisturbed, without camera",
        Kind::Slipped => "slipped brake",
        Kind::Moved => "moved platform",
        Kind::Swapped => "swapped journal",
        Kind::Corrupted => "corrupted journal",
    }
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        if common.on != "sim" {
            let reason = "a study needs the truth, which only the simulator knows";
            return Err(Failed::from_error("--on")(reason).into());
        }
        let robot = crate::robot::find(&common.robot)?;
        let model = Model::new(&robot)?;
        model.hanging("going on after a loss of power")?;
        let bound_m = self.bound_mm * 1e-3;
        let cases = study(&model, common.seed, self.runs, bound_m)?;
        if let Some(path) = &self.cases {
            let lines: Result<Vec<_>, _> = cases.iter().map(serde_json::to_string).collect();
            let text = lines.map_err(Failed::from_error("the cases"))?.join("\n");
            crate::files::write_atomically(path, text)
                .map_err(Failed::from_error("writing the cases"))?;
        }
        let undisturbed = |case: &&Case| matches!(case.kind, Kind::Camera | Kind::NoCamera);
        let fine = figures(cases.iter().filter(undisturbed));
        let all = figures(cases.iter());
        let with_camera = figures(cases.iter().filter(|case| case.kind == Kind::Camera));
        let last = common.seed + self.runs - 1;
        let of = |kind: Kind| figures(cases.iter().filter(|case| case.kind == kind));
        if common.json {
            let kinds: serde_json::Map<_, _> = KINDS
                .iter()
                .map(|kind| (key(*kind), serde_json::json!(of(*kind))))
                .collect();
            return print_json(&serde_json::json!({
                "study": "power",
                "robot": robot.name,
                "seeds": format!("{} to {last}", common.seed),
                "drop_max_mm": all.drop_max_mm,
                "accepted_wrongly": all.accepted_wrongly,
                "refused_wrongly": fine.refused,
                "median_mm": with_camera.median_mm,
                "inside": fine.inside,
                "inside_95": fine.inside_95,
                "kinds": kinds,
            }));
        }
        let head = [
            "simulation, realistic machines",
            "cases",
            "accepted",
            "wrongly",
            "error median / most, mm",
            "inside 95 % / both bounds",
            "bound 95 %, median",
            "bound median / most, mm",
            "most under 0.1 m/s",
            "drop, mm",
        ];
        let mut rows = vec![head.map(str::to_owned).to_vec()];
        rows.extend(KINDS.iter().map(|kind| row(name(*kind), &of(*kind))));
        rows.push(row("all", &all));
        write_out(&lay_out(&rows));
        say!("robot {}, seeds {} to {last}", robot.name, common.seed);
        Ok(())
    }
}

fn key(kind: Kind) -> String {
    let value = serde_json::json!(kind);
    value.as_str().unwrap_or_default().to_owned()
}

fn row(name: &str, figures: &Figures) -> Vec<String> {
    let cell = |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.2}"));
    vec![
        name.to_owned(),
        figures.cases.to_string(),
        figures.accepted.to_string(),
        figures.accepted_wrongly.to_string(),
        format!("{} / {}", cell(figures.median_mm), cell(figures.most_mm)),
        format!("{} / {}", cell(figures.inside_95), cell(figures.inside)),
        cell(figures.bound_95_median_mm),
        format!(
            "{} / {}",
            cell(figures.bound_median_mm),
            cell(figures.bound_most_mm)
        ),
        cell(figures.bound_most_slow_mm),
        format!("{:.2}", figures.drop_max_mm),
    ]
}
