//! `mcdpr study demo`: the figures of `mcdpr demo` over many seeds.

use crate::cli::table::lay_out;
use crate::cli::{Common, Outcome, print_json, write_out};
use crate::experiment::{Experiment, SimulatedRobot};
use crate::machine::Mismatch;
use crate::motion::{Model, Task};
use crate::report::Figures;
use crate::robot::Robot;

/// The demo's figures as medians over many machines with their ranges: realistic ones, or as found
/// (`--machine as-found`), each calibrated first
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// Machines, one per seed
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..=1000))]
    seeds: u64,
    /// Machines as found: poses of the calibration, home included
    #[arg(long, default_value_t = 20, value_parser = crate::cli::numbers::whole::<7, 200>)]
    poses: usize,
}

/// A figure's name, its key and unit, and its source.
type Figure = (&'static str, &'static str, fn(&Figures) -> Option<f64>);

const FIGURES: [Figure; 5] = [
    ("path error of the tool, mean, mm", "path_mean_mm", |f| {
        f.path_error_m.map(|e| e.mean * 1e3)
    }),
    ("path error of the tool, max, mm", "path_max_mm", |f| {
        f.path_error_m.map(|e| e.max * 1e3)
    }),
    ("cable length error, mean, mm", "length_mean_mm", |f| {
        Some(f.cable_length_error_m.mean * 1e3)
    }),
    ("cable-4 tension error, mean, N", "tension_mean_n", |f| {
        Some(f.tension_error_n.mean_abs)
    }),
    ("cable-4 tension error, max, N", "tension_max_n", |f| {
        Some(f.tension_error_n.max_abs)
    }),
];

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let robot = crate::robot::find(&common.robot)?;
        let model = Model::new(&robot)?;
        model.hanging("the study of the paper's circle")?;
        let height_m = crate::cli::run::tool_height_m(&robot, crate::cli::demo::HEIGHT_MM);
        let task = crate::motion::find_task("paper:table7", height_m)?;
        let kind = common.machine.as_deref().unwrap_or("realistic");
        let mut runs = Vec::new();
        for seed in 1..=self.seeds {
            let figures = if kind == "as-found" {
                after_calibration(&robot, &task, seed, self.poses, common)?
            } else {
                let mismatch = common.mismatch(Mismatch::realistic());
                let machine = SimulatedRobot::new(mismatch, seed).controller(&common.controller);
                let run = Experiment::new(&model, task.clone()).simulate(&machine)?;
                run.run.figures(&model)?
            };
            if !common.json {
                let path = figures.path_error_m;
                let mm = |value: Option<f64>| value.map_or(f64::NAN, |v| v * 1e3);
                eprintln!(
                    "seed {seed}: path {:.3} / {:.3} mm",
                    mm(path.map(|e| e.mean)),
                    mm(path.map(|e| e.max))
                );
            }
            runs.push(figures);
        }
        let rows: Vec<_> = FIGURES
            .iter()
            .map(|(name, key, of)| {
                let mut all: Vec<f64> = runs.iter().filter_map(of).collect();
                all.sort_by(f64::total_cmp);
                let middle = crate::calibration::study::median(all.clone());
                let (least, most) = (all.first().copied(), all.last().copied());
                (*name, *key, middle, least, most)
            })
            .collect();
        if common.json {
            let figures: serde_json::Map<_, _> = rows
                .iter()
                .map(|(_, key, median, least, most)| {
                    let cell = serde_json::json!({"median": median, "least": least, "most": most});
                    ((*key).to_owned(), cell)
                })
                .collect();
            return print_json(&serde_json::json!({
                "study": "demo",
                "seeds": format!("1 to {}", self.seeds),
                (kind): figures,
            }));
        }
        let machines = match kind {
            "as-found" => "machines as found, calibrated".to_owned(),
            kind => format!("{kind} machines"),
        };
        let head = [machines.as_str(), "median", "least", "most"];
        let mut table = vec![head.map(str::to_owned).to_vec()];
        for (name, _, median, least, most) in rows {
            let cell = |value: Option<f64>| format!("{:.3}", value.unwrap_or(f64::NAN));
            table.push(vec![
                name.to_owned(),
                cell(Some(median)),
                cell(least),
                cell(most),
            ]);
        }
        write_out(&lay_out(&table));
        say!("seeds 1 to {} of {}", self.seeds, robot.name);
        Ok(())
    }
}

/// The circle on a machine as found, after its own calibration by the board of tags and without homing anew.
fn after_calibration(
    robot: &Robot,
    task: &Task,
    seed: u64,
    poses: usize,
    common: &Common,
) -> miette::Result<Figures> {
    let found = Some("as-found");
    let known = crate::pick::calibrated_by(poses, robot, seed, &common.controller, found)?;
    let model = Model::new(&known)?;
    let machine = SimulatedRobot::new(Mismatch::as_found(), seed)
        .just_calibrated()
        .controller(&common.controller);
    let run = Experiment::new(&model, task.clone()).simulate(&machine)?;
    Ok(run.run.figures(&model)?)
}
