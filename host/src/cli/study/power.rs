//! `mcdpr study power`: random losses of power, and the errors of the recovery.

use crate::cli::numbers::positive;
use crate::cli::progress::Phase;
use crate::cli::table::lay_out;
use crate::cli::{Common, Failed, Outcome, print_json, write_out};
use crate::motion::{Model, Task};
use crate::recovery::study::{Case, Figures, KINDS, Kind, What, figures, study};
use crate::recovery::{Cost, cost};
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
    /// Only cuts with nothing else: skip the seeds of the other kinds
    #[arg(long)]
    undisturbed: bool,
    /// Only the other kinds: skip the seeds of cuts with nothing else
    #[arg(long, conflicts_with = "undisturbed")]
    disturbed: bool,
    /// Every case has one brake that holds only this force at the cable, N
    #[arg(long, value_name = "N", value_parser = positive, conflicts_with = "undisturbed")]
    weak_brake_n: Option<f64>,
    /// The boards have a battery for their backup registers
    #[arg(long)]
    battery: bool,
    /// The camera did not see the tags when the robot was homed
    #[arg(long)]
    no_view_at_homing: bool,
    /// Closing time of all brakes instead of the robot file's, ms
    #[arg(long, value_name = "MS", value_parser = clap::value_parser!(u16).range(1..=500))]
    brake_ms: Option<u16>,
    /// Time for which the rail keeps all drives instead of the robot file's, ms
    #[arg(long, value_name = "MS", value_parser = clap::value_parser!(u16).range(0..=500))]
    hold_up_ms: Option<u16>,
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

/// The kinds without a fault but the cut.
const UNDISTURBED: [Kind; 2] = [Kind::Camera, Kind::NoCamera];

/// The journal's cost over a straight way of some seconds.
fn journal_cost(model: &Model) -> miette::Result<Cost> {
    let home = model.robot().tool.home_in_world_m * 1e3;
    let text = format!(
        "start_mm = [{x}, {y}, {z}]\n[[leg]]\nto_mm = [{}, {y}, {z}]\nduration_s = 8\n",
        home.x + 60.0,
        x = home.x,
        y = home.y,
        z = home.z,
    );
    let task = Task::parse(&text, "way.toml".into())?;
    Ok(cost(model, &task)?)
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let mut robot = crate::robot::find(&common.robot)?;
        if let Some(brake_ms) = self.brake_ms {
            for winch in &mut robot.winches {
                winch.brake_close_s = f64::from(brake_ms) * 1e-3;
            }
        }
        if let Some(hold_up_ms) = self.hold_up_ms {
            for winch in &mut robot.winches {
                winch.drive_hold_up_s = f64::from(hold_up_ms) * 1e-3;
            }
        }
        let model = Model::new(&robot)?;
        model.hanging("going on after a loss of power")?;
        let kinds = match self.undisturbed {
            true => &UNDISTURBED[..],
            false if self.weak_brake_n.is_some() => &[Kind::Slipped][..],
            false => &KINDS[..],
        };
        let wanted = |kind: &&Kind| !self.disturbed || !UNDISTURBED.contains(kind);
        let what = What {
            kinds: kinds.iter().filter(wanted).copied().collect(),
            bound_m: self.bound_mm * 1e-3,
            seen_at_home: !self.no_view_at_homing,
            weak_brake_n: self.weak_brake_n,
            battery: self.battery,
        };
        let seeds = common.seed..common.seed.saturating_add(self.runs);
        let phase = Phase::begin("cutting the power and recovering");
        let cases = study(&model, seeds, &what, &common.controller)?;
        drop(phase);
        let cost = journal_cost(&model)?;
        if let Some(path) = &self.cases {
            let lines: Result<Vec<_>, _> = cases.iter().map(serde_json::to_string).collect();
            let text = lines.map_err(Failed::from_error("the cases"))?.join("\n");
            crate::files::write_atomically(path, text)
                .map_err(Failed::from_error("writing the cases"))?;
        }
        let undisturbed = |case: &&Case| UNDISTURBED.contains(&case.kind);
        let fine = figures(cases.iter().filter(undisturbed));
        let lost = figures(
            cases
                .iter()
                .filter(undisturbed)
                .filter(|case| case.counts_lost()),
        );
        let counted = figures(
            cases
                .iter()
                .filter(undisturbed)
                .filter(|case| !case.counts_lost()),
        );
        let all = figures(cases.iter());
        let with_camera = figures(cases.iter().filter(|case| case.kind == Kind::Camera));
        let last = common.seed + self.runs - 1;
        let of = |kind: Kind| figures(cases.iter().filter(|case| case.kind == kind));
        if common.json {
            let kinds: serde_json::Map<_, _> = kinds
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
                "undisturbed": fine,
                "counts_kept": counted,
                "counts_lost": lost,
                "journal": cost,
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
            "normalised error squared",
            "bound 95 %, median",
            "bound median / most, mm",
            "most under 0.1 m/s",
            "by a tag",
            "its error / over homing's, median mm",
            "within 1 mm / over homing's",
            "drop median / most, mm",
            "over 5 mm",
        ];
        let mut rows = vec![head.map(str::to_owned).to_vec()];
        rows.extend(kinds.iter().map(|kind| row(name(*kind), &of(*kind))));
        rows.push(row("undisturbed", &fine));
        rows.push(row("  board kept its counts", &counted));
        rows.push(row("  board lost its counts", &lost));
        rows.push(row("all", &all));
        write_out(&lay_out(&rows));
        say!("robot {}, seeds {} to {last}", robot.name, common.seed);
        let share = cost.core_share.map_or("not measured".to_owned(), |share| {
            format!("{:.2} % of a core", share * 100.0)
        });
        say!(
            "journal: {:.2} MB a minute, {share}, over {:.1} s in real time",
            cost.mb_per_min,
            cost.duration_s
        );
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
        cell(figures.normalised_mean),
        cell(figures.bound_95_median_mm),
        format!(
            "{} / {}",
            cell(figures.bound_median_mm),
            cell(figures.bound_most_mm)
        ),
        cell(figures.bound_most_slow_mm),
        figures.by_tag.to_string(),
        format!(
            "{} / {}",
            cell(figures.by_tag_median_mm),
            cell(figures.since_homing_median_mm)
        ),
        format!(
            "{} / {}",
            figures.within_1_mm, figures.since_homing_within_1_mm
        ),
        format!(
            "{} / {:.2}",
            cell(figures.drop_median_mm),
            figures.drop_max_mm
        ),
        figures.drops_over_5_mm.to_string(),
    ]
}
