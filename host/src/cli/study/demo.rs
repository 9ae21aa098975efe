//! `mcdpr study demo`: the figures of `mcdpr demo` over many seeds.

use crate::cli::table::lay_out;
use crate::cli::{Common, Failed, Outcome, print_json, write_out};
use crate::experiment::{self, Experiment, SimulatedRobot, Told};
use crate::machine::Mismatch;
use crate::motion::{Model, Task};
use crate::report::Figures;
use crate::robot::Robot;
use clap::ValueEnum;

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
    /// Machines as found: what the calibration is told of the machine itself, which no calibration of a real robot is;
    /// for the share of the error that a better calibration could take away
    #[arg(long, value_enum, value_delimiter = ',', value_name = "GROUP,...")]
    told: Vec<Told>,
    /// Machines as found: the share of a group of its errors that each machine has, 0 to 1, such as wrench=0.25 or
    /// all=0,wrench=1 (a later word goes before an earlier one); groups: wrench (that no model has), homing, cells
    /// (gain and zero), noise, drums, gears, pulleys, stiffness, platform, frame
    #[arg(long, value_name = "GROUP=SHARE,...")]
    shares: Option<String>,
}

/// Kind of machines that are calibrated first.
const FOUND: &str = "as-found";

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
        let found = self.found(kind)?;
        let mut runs = Vec::new();
        for seed in 1..=self.seeds {
            let figures = if kind == FOUND {
                self.after_calibration(&robot, &task, seed, &found, common)?
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
            let mut out = serde_json::json!({
                "study": "demo",
                "seeds": format!("1 to {}", self.seeds),
                (kind): figures,
            });
            if let Some(shares) = &self.shares {
                out["shares"] = shares.as_str().into();
            }
            if !self.told.is_empty() {
                // Whoever reads the figures must see that no robot has them.
                out["told"] = self.told_words().into();
            }
            return print_json(&out);
        }
        let machines = match kind {
            FOUND if self.told.is_empty() => "machines as found, calibrated".to_owned(),
            FOUND => "machines as found, told the truth".to_owned(),
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
        if let Some(shares) = &self.shares {
            say!("share of the errors that were found: {shares}");
        }
        if !self.told.is_empty() {
            let what = self.told_words().join(", ");
            say!("not obtainable on a robot: the calibration was told the machine's {what}");
        }
        Ok(())
    }

    /// The name of the machines as found, with the shares of their errors.
    fn found(&self, kind: &str) -> Result<String, Failed> {
        for (option, given) in [
            ("--told", !self.told.is_empty()),
            ("--shares", self.shares.is_some()),
        ] {
            if given && kind != FOUND {
                let reason = format!("it is of machines as found; add --machine {FOUND}");
                return Err(Failed::from_error(option)(reason));
            }
        }
        let Some(shares) = &self.shares else {
            return Ok(FOUND.to_owned());
        };
        let name = format!("{FOUND},{shares}");
        Mismatch::parse(&name).map_err(Failed::from_error("--shares"))?;
        Ok(name)
    }

    /// The words of `--told`.
    fn told_words(&self) -> Vec<String> {
        let values = self.told.iter().filter_map(Told::to_possible_value);
        values.map(|value| value.get_name().to_owned()).collect()
    }

    /// The circle on a machine as found, after its own calibration by the board of tags and without homing anew.
    /// `found` names the machine with the shares of its errors.
    fn after_calibration(
        &self,
        robot: &Robot,
        task: &Task,
        seed: u64,
        found: &str,
        common: &Common,
    ) -> miette::Result<Figures> {
        let failed = Failed::from_error("--told");
        let known = if self.told.contains(&Told::All) {
            experiment::truth(robot, found, seed).map_err(failed)?
        } else {
            let controller = &common.controller;
            let by_tags =
                crate::pick::calibrated_by(self.poses, robot, seed, controller, Some(found))?;
            if self.told.is_empty() {
                by_tags
            } else {
                experiment::told(by_tags, &self.told).map_err(failed)?
            }
        };
        let model = Model::new(&known)?;
        let mismatch = Mismatch::parse(found).map_err(Failed::from_error("--shares"))?;
        let machine = SimulatedRobot::new(mismatch, seed)
            .just_calibrated()
            .controller(&common.controller);
        let run = Experiment::new(&model, task.clone()).simulate(&machine)?;
        Ok(run.run.figures(&model)?)
    }
}
