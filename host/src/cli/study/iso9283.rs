//! `mcdpr study iso9283`: accuracy as industry measures it.

use crate::cli::table::lay_out;
use crate::cli::{Common, Failed, Outcome, print_json, write_out};
use crate::control::Handle;
use crate::files;
use crate::machine::Mismatch;
use crate::motion::Model;
use crate::run::RunError;
use crate::study::iso9283::simulated::{self, Figures, Test, TestError};
use crate::study::iso9283::{Cube, POSES, tracker};
use rayon::prelude::*;
use std::path::PathBuf;

/// Wait at each pose in the task that `--write-task` writes, s: time for a tracker to average.
const TRACKER_WAIT_S: f64 = 2.0;

/// Pose and path accuracy and repeatability by ISO 9283, in the robot's own cube
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// Simulated machines, one per seed
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..=1000))]
    seeds: u64,
    /// Cycles over the five poses; the standard asks for 30
    #[arg(long, default_value_t = 30, value_parser = clap::value_parser!(u16).range(2..=200))]
    cycles: u16,
    /// Speed as a share of the robot file's limit; the standard asks for 100, 50 and 10
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u8).range(1..=100))]
    speed_percent: u8,
    /// Half width of the limit band of overshoot and stabilisation
    #[arg(long, default_value_t = 0.5, value_name = "MM")]
    band_mm: f64,
    /// Judge what a tracker measured (CSV: cycle, pose, `x_mm`, `y_mm`, `z_mm`) instead of simulating
    #[arg(long, value_name = "FILE", conflicts_with = "seeds")]
    tracker: Option<PathBuf>,
    /// Write the cycles as a task file for `mcdpr run` and stop
    #[arg(long, value_name = "FILE", conflicts_with = "tracker")]
    write_task: Option<PathBuf>,
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        if common.on != "sim" {
            let reason = "the study needs the simulator's truth. For a robot on a port, write the \
                          cycles with --write-task, drive them with `mcdpr run`, and give the \
                          tracker's file with --tracker";
            return Err(Failed::from_error("--on")(reason).into());
        }
        if !(self.band_mm.is_finite() && self.band_mm > 0.0) {
            return Err(Failed::from_error("--band-mm")("the band must be over 0 mm").into());
        }
        let robot = crate::robot::find(&common.robot)?;
        let model = Model::new(&robot)?;
        model.comes_to_rest("the study of ISO 9283")?;
        let cube = Cube::largest(&model).map_err(Failed::from_error("the test cube"))?;
        let test = Test {
            cube,
            cycles: usize::from(self.cycles),
            speed_mps: robot.limits.speed_mps * f64::from(self.speed_percent) / 100.0,
            band_m: self.band_mm * 1e-3,
        };
        if let Some(path) = &self.write_task {
            let text = cube.task_text(test.cycles, TRACKER_WAIT_S, test.speed_mps);
            files::write_atomically(path, text.as_bytes())
                .map_err(Failed::from_error("writing the task"))?;
            say!(
                "{}: {} cycles in a {} of {:.0} mm; next: mcdpr run {}",
                path.display(),
                test.cycles,
                cube.shape(),
                cube.side_m * 1e3,
                path.display()
            );
            return Ok(());
        }
        if let Some(path) = &self.tracker {
            let what = path.display().to_string();
            let text = files::read_text(path).map_err(Failed::from_error(&what))?;
            let attained = tracker::read(&text).map_err(Failed::from_error(&what))?;
            let cycles = attained[0].len();
            let attained = tracker::in_robot_frame(attained, &cube.poses_m())
                .map_err(Failed::from_error(&what))?;
            let found = simulated::figures(&cube, &attained)
                .ok_or(TestError::Few(cycles))
                .map_err(Failed::from_error(&what))?;
            let test = Test { cycles, ..test };
            return Self::show(
                common,
                &test,
                &[found],
                &format!("{cycles} measured cycles of {what}"),
            );
        }
        // Simulated robots need no orderly end.
        let first = common.seed;
        let seeds: Vec<u64> = (first..first.saturating_add(self.seeds)).collect();
        let handle = Handle::new();
        let runs: Vec<Result<Figures, TestError>> = seeds
            .par_iter()
            .map(|seed| {
                let mismatch = Mismatch::realistic();
                let controller = &common.controller;
                let found = simulated::run(&model, &mismatch, *seed, controller, &test, &handle);
                if !common.json {
                    match &found {
                        Ok(found) => {
                            let greatest = greatest_mm(found, |pose| pose.accuracy_m);
                            eprintln!("seed {seed}: pose accuracy up to {greatest:.3} mm");
                        }
                        Err(error) => eprintln!("seed {seed}: {error}"),
                    }
                }
                found
            })
            .collect();
        // A machine that its board stops is part of the result; anything else ends the study.
        let mut completed = Vec::new();
        let mut stopped = Vec::new();
        for (seed, run) in seeds.iter().zip(runs) {
            match run {
                Ok(figures) => completed.push(figures),
                Err(TestError::Run(error @ RunError::Fault { .. })) => stopped.push((*seed, error)),
                Err(TestError::Run(error)) => return Err(error.into()),
                Err(error) => return Err(Failed::from_error("study iso9283")(error).into()),
            }
        }
        if completed.is_empty()
            && let Some((_, error)) = stopped.pop()
        {
            return Err(error.into());
        }
        for (seed, error) in &stopped {
            say!("seed {seed} was stopped: {error}");
        }
        let runs = completed;
        let last = first.saturating_add(self.seeds - 1);
        Self::show(
            common,
            &test,
            &runs,
            &format!("realistic simulated machines, seeds {first} to {last}"),
        )
    }

    fn show(common: &Common, test: &Test, runs: &[Figures], of: &str) -> Outcome {
        let cycles = test.cycles;
        let rows: Vec<Row> = FIGURES
            .iter()
            .filter_map(|(name, key, value)| {
                let mut all: Vec<f64> = runs.iter().filter_map(value).collect();
                all.sort_by(f64::total_cmp);
                Some(Row {
                    name,
                    key,
                    least: *all.first()?,
                    most: *all.last()?,
                    median: crate::calibration::study::median(all),
                })
            })
            .collect();
        let poses_mm: Vec<[f64; 3]> = test
            .cube
            .poses_m()
            .iter()
            .map(|p| [p.x * 1e3, p.y * 1e3, p.z * 1e3])
            .collect();
        if common.json {
            let figures: serde_json::Map<_, _> = rows
                .iter()
                .map(|row| {
                    let cell = serde_json::json!(
                        {"median": row.median, "least": row.least, "most": row.most}
                    );
                    (row.key.to_owned(), cell)
                })
                .collect();
            return print_json(&serde_json::json!({
                "study": "iso9283",
                "of": of,
                "completed": runs.len(),
                "cycles": cycles,
                "speed_mps": test.speed_mps,
                "cube_side_mm": test.cube.side_m * 1e3,
                "square_in_plane": test.cube.normal.is_some(),
                "poses_mm": poses_mm,
                "figures": figures,
            }));
        }
        let head = ["ISO 9283", "median", "least", "most"];
        let mut table = vec![head.map(str::to_owned).to_vec()];
        for row in rows {
            let cell = |value: f64| format!("{value:.3}");
            let cells = [
                row.name.to_owned(),
                cell(row.median),
                cell(row.least),
                cell(row.most),
            ];
            table.push(cells.to_vec());
        }
        write_out(&lay_out(&table));
        say!(
            "{} of {:.0} mm around ({:.0}, {:.0}, {:.0}) mm, {:.0} mm/s; {of}",
            test.cube.shape(),
            test.cube.side_m * 1e3,
            poses_mm[0][0],
            poses_mm[0][1],
            poses_mm[0][2],
            test.speed_mps * 1e3
        );
        Ok(())
    }
}

struct Row {
    name: &'static str,
    key: &'static str,
    median: f64,
    least: f64,
    most: f64,
}

/// A figure's name with unit, its key, and where it is found.
type Figure = (&'static str, &'static str, fn(&Figures) -> Option<f64>);

const FIGURES: [Figure; 10] = [
    (
        "AP, pose accuracy, mean of P1 to P5, mm",
        "pose_accuracy_mean_mm",
        |f| Some(f.poses.iter().map(|p| p.accuracy_m).sum::<f64>() * 1e3 / POSES as f64),
    ),
    ("AP, greatest of P1 to P5, mm", "pose_accuracy_mm", |f| {
        Some(greatest_mm(f, |p| p.accuracy_m))
    }),
    (
        "RP, pose repeatability, greatest, mm",
        "pose_repeatability_mm",
        |f| Some(greatest_mm(f, |p| p.repeatability_m)),
    ),
    (
        "drift of the pose over the test, greatest, mm",
        "drift_mm",
        |f| Some(greatest_mm(f, |p| p.drift_m)),
    ),
    (
        "AD, distance accuracy P2 to P4, mm",
        "distance_accuracy_mm",
        |f| Some(f.distance.accuracy_m * 1e3),
    ),
    (
        "RD, distance repeatability, mm",
        "distance_repeatability_mm",
        |f| Some(f.distance.repeatability_m * 1e3),
    ),
    ("ATp, path accuracy, mm", "path_accuracy_mm", |f| {
        f.path.map(|p| p.accuracy_m * 1e3)
    }),
    (
        "RTp, path repeatability, mm",
        "path_repeatability_mm",
        |f| f.path.map(|p| p.repeatability_m * 1e3),
    ),
    ("OV, overshoot, greatest, mm", "overshoot_mm", |f| {
        f.arrival.map(|a| a.overshoot_m * 1e3)
    }),
    ("stabilisation time, greatest, s", "stabilisation_s", |f| {
        f.arrival.map(|a| a.stabilisation_s)
    }),
];

fn greatest_mm(figures: &Figures, of: impl Fn(&crate::study::iso9283::PoseFigures) -> f64) -> f64 {
    figures.poses.iter().map(of).fold(0.0, f64::max) * 1e3
}
