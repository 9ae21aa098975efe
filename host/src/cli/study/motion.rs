//! `mcdpr study motion`: accuracy and swing of the tool.

use crate::cli::table::lay_out;
use crate::cli::{Common, Failed, Outcome, print_json, write_out};
use crate::motion::{Planner, Shaping};
use crate::study::motion::{self, Job, Known, Row};
use mcdpr_protocol::frame::crc32;

/// Accuracy of the tool's position, and its swing
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// Seeds per case
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..=1000))]
    seeds: u64,
    /// Cases of this planner only
    #[arg(long)]
    planner: Option<Planner>,
    /// Cases with this pulley loss only, %
    #[arg(long)]
    loss: Option<f64>,
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let Self {
            seeds,
            planner,
            loss,
        } = *self;
        let planners = planner.map_or(vec![Planner::Equilibrium, Planner::Level], |p| vec![p]);
        let losses = loss.map_or(vec![0.0, 0.02], |percent| vec![percent / 100.0]);
        let mut rows = Vec::new();
        for planner in planners {
            for &loss in &losses {
                for case in motion::cases(planner, loss) {
                    let row = motion::row(&case, seeds);
                    if !common.json {
                        eprintln!("{}", words(&row).join("  "));
                    }
                    rows.push(row);
                }
            }
        }
        if common.json {
            let text = serde_json::to_string(&rows).map_err(Failed::from_error("the result"))?;
            return print_json(&serde_json::json!({
                "study": "motion",
                "seeds": format!("1 to {seeds}"),
                "crc32_of_rows": format!("{:08x}", crc32(text.as_bytes())),
                "rows": rows,
            }));
        }
        let head = [
            "case",
            "planner",
            "loss, %",
            "path mean/max, mm",
            "rest median/p95, mm",
            "swing, mm",
            "tension, N",
            "least, N",
            "time, s",
            "runs",
        ];
        let head = head.map(str::to_owned).to_vec();
        let table: Vec<_> = std::iter::once(head)
            .chain(rows.iter().map(words))
            .collect();
        write_out(&lay_out(&table));
        Ok(())
    }
}

fn words(row: &Row) -> Vec<String> {
    let case = &row.case;
    let job = match case.job {
        Job::Circle8s => "circle in 8 s",
        Job::Circle10s => "circle in 10 s",
        Job::Line => "line at 100 mm/s",
        Job::LineAtLimit => "line at the limit",
        Job::Grasp => "at rest, grasp",
        Job::Release => "at rest, release",
        Job::FastMove => "300 mm at 0.5 m/s",
    };
    let mut name = format!("{job}, {}", case.robot);
    name.push_str(if case.every_error {
        ", every error"
    } else {
        ", anchors"
    });
    name.push_str(match case.known {
        Known::Homed => ", homed",
        Known::HomedByOne => ", homed by one tag",
        Known::Absolute => ", absolute",
    });
    if case.job == Job::FastMove {
        name.push_str(if case.shaping == Shaping::None {
            ", unshaped"
        } else {
            ", ZV"
        });
    }
    if case.frictionless {
        name.push_str(", no friction");
    }
    let mm = |value: f64| format!("{:.3}", value * 1e3);
    let Some(median) = row.median else {
        return vec![name, row.failed.clone().unwrap_or_default()];
    };
    let path = if median.path_mean_m.is_finite() {
        format!("{} / {}", mm(median.path_mean_m), mm(median.path_max_m))
    } else {
        "-".to_owned()
    };
    let p95 = row.rest_p95_m.map_or(String::new(), mm);
    vec![
        name,
        format!("{:?}", case.planner).to_lowercase(),
        format!("{:.0}", case.pulley_loss * 100.0),
        path,
        format!("{} / {p95}", mm(median.rest_m)),
        mm(median.swing_m),
        if median.tension_n.is_finite() {
            format!("{:.3}", median.tension_n)
        } else {
            "-".to_owned()
        },
        format!("{:.1}", median.least_tension_n),
        format!("{:.2}", median.duration_s),
        row.runs.to_string(),
    ]
}
