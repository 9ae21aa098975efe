//! `mcdpr study robots`: accuracy of every kind of robot.

use crate::cli::table::lay_out;
use crate::cli::{Common, Outcome, print_json, write_out};
use crate::motion::Model;
use crate::study::robots::{self, KINDS, Row};

/// Accuracy of robots of every kind on a path that fits them
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// Robots; by default every shipped one that is held otherwise than the paper's
    robots: Vec<String>,
    /// Seeds per robot
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..=1000))]
    seeds: u64,
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let all = KINDS.map(str::to_owned).to_vec();
        let names = if self.robots.is_empty() {
            &all
        } else {
            &self.robots
        };
        let mut rows = Vec::new();
        for name in names {
            let model = Model::new(&crate::robot::find(name)?)?;
            for exact in [true, false] {
                rows.push(robots::row(
                    &model,
                    exact,
                    if exact { 1 } else { self.seeds },
                )?);
            }
        }
        if common.json {
            return print_json(&serde_json::json!({
                "study": "robots",
                "seeds": format!("1 to {}", self.seeds),
                "rows": rows,
            }));
        }
        let head = [
            "robot",
            "machine",
            "path mean, mm",
            "path max, mm",
            "attitude mean, deg",
            "attitude max, deg",
            "tension, N",
            "runs",
        ];
        let head = head.map(str::to_owned).to_vec();
        let table: Vec<_> = std::iter::once(head)
            .chain(rows.iter().map(words))
            .collect();
        write_out(&lay_out(&table));
        for row in rows.iter().filter(|row| row.failed.is_some()) {
            say!(
                "{}: {}",
                row.robot,
                row.failed.as_deref().unwrap_or_default()
            );
        }
        Ok(())
    }
}

/// Median and range over the seeds.
fn words(row: &Row) -> Vec<String> {
    let column = |pick: &dyn Fn(&robots::Outcome) -> Option<f64>, scale: f64| {
        let mut values: Vec<f64> = row.runs.iter().filter_map(pick).collect();
        values.sort_by(f64::total_cmp);
        let middle = values
            .get(values.len() / 2)
            .zip(values.get(values.len().saturating_sub(1) / 2));
        let (Some((a, b)), Some(least), Some(most)) = (middle, values.first(), values.last())
        else {
            return "-".to_owned();
        };
        let median = 0.5 * (a + b) * scale;
        if row.exact {
            return format!("{median:.3}");
        }
        format!("{median:.3} ({:.3} to {:.3})", least * scale, most * scale)
    };
    let ends = row
        .runs
        .iter()
        .fold((f64::MAX, 0.0_f64), |(low, high), run| {
            (
                low.min(run.tension_least_n),
                high.max(run.tension_greatest_n),
            )
        });
    let degrees = 1f64.to_degrees();
    vec![
        row.robot.clone(),
        if row.exact {
            "as described"
        } else {
            "realistic"
        }
        .to_owned(),
        column(&|run| Some(run.path_mean_m), 1e3),
        column(&|run| Some(run.path_max_m), 1e3),
        column(&|run| run.attitude_mean_rad, degrees),
        column(&|run| run.attitude_max_rad, degrees),
        format!("{:.1} to {:.1}", ends.0, ends.1),
        row.runs.len().to_string(),
    ]
}
