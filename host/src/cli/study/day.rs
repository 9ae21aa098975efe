//! `mcdpr study day`: hours of work with creep, heat, payloads and knocks, tracked and not.

use crate::cli::table::lay_out;
use crate::cli::{Common, Failed, Outcome, print_json, write_out};
use crate::motion::Model;
use crate::run::{interrupted, watch_for_interrupts};
use crate::study::quantile;
use mcdpr_twin::day::{Day, DayError, Kind, Work};
use mcdpr_twin::plant::{AfterHours, Mismatch};
use rayon::prelude::*;
use serde_json::{Value, json};

/// Tool error over hours of picking and circles, with a tracked state, without camera, and untracked
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// Hours of work
    #[arg(long, default_value_t = 8.0, value_name = "H")]
    hours: f64,
    /// Simulated machines, one per seed
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..=1000))]
    seeds: u64,
    /// Seconds between two looks at the mat
    #[arg(long, default_value_t = 300.0, value_name = "S")]
    look_every_s: f64,
    /// Size of the knocks that are tried on copies of the machine, once an hour; 0 for none
    #[arg(long, default_value_t = 3.0, value_name = "MM")]
    knock_mm: f64,
    /// What the cables are made of: steel creeps next to nothing
    #[arg(long, value_enum, default_value_t = Cables::Polymer)]
    cables: Cables,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Cables {
    Polymer,
    Steel,
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        for (name, value, range) in [
            ("--hours", self.hours, 0.1..=200.0),
            ("--look-every-s", self.look_every_s, 10.0..=1e5),
            ("--knock-mm", self.knock_mm, 0.0..=20.0),
        ] {
            if !range.contains(&value) {
                let reason = format!("{value}: give {} to {}", range.start(), range.end());
                return Err(Failed::from_error(name)(reason).into());
            }
        }
        let robot = crate::robot::find(&common.robot)?;
        let model = Model::new(&robot)?;
        watch_for_interrupts().map_err(Failed::from_error("watching for Ctrl-C"))?;
        let seeds: Vec<u64> = (common.seed..common.seed.saturating_add(self.seeds)).collect();
        let kinds = [Kind::Seeing, Kind::Blind, Kind::Untracked];
        let jobs: Vec<(Kind, u64)> = kinds
            .into_iter()
            .flat_map(|kind| seeds.iter().map(move |seed| (kind, *seed)))
            .collect();
        let days: Vec<(Kind, u64, Result<Day, DayError>)> = jobs
            .into_par_iter()
            .map(|(kind, seed)| {
                let work = Work {
                    model: model.clone(),
                    mismatch: match self.cables {
                        Cables::Polymer => Mismatch::after_hours(),
                        Cables::Steel => Mismatch::changing(AfterHours::steel()),
                    },
                    hours: self.hours,
                    look_every_s: self.look_every_s,
                    kind,
                    knock_m: if kind == Kind::Seeing {
                        self.knock_mm * 1e-3
                    } else {
                        0.0
                    },
                };
                let day = work.run(seed, &mut |_| !interrupted());
                if !common.json && !interrupted() {
                    match &day {
                        Ok(day) => eprintln!("seed {seed}, {}: {:.3} mm", word(kind), mean_mm(day)),
                        Err(error) => eprintln!("seed {seed}, {}: {error}", word(kind)),
                    }
                }
                (kind, seed, day)
            })
            .collect();
        if interrupted() {
            return Err(crate::run::RunError::Interrupted.into());
        }
        let mut of_kind: Vec<(Kind, Vec<Day>)> = kinds.map(|kind| (kind, Vec::new())).into();
        let mut failed = Vec::new();
        for (kind, seed, day) in days {
            match day {
                Ok(day) => {
                    if let Some((_, days)) = of_kind.iter_mut().find(|(k, _)| *k == kind) {
                        days.push(day);
                    }
                }
                Err(error) => failed.push(format!("seed {seed}, {}: {error}", word(kind))),
            }
        }
        self.show(common, &of_kind, &failed)
    }

    fn show(&self, common: &Common, of_kind: &[(Kind, Vec<Day>)], failed: &[String]) -> Outcome {
        let rows: Vec<(&'static str, Value)> = of_kind
            .iter()
            .map(|(kind, days)| (word(*kind), figures(days, self.hours)))
            .collect();
        let seeing = of_kind.iter().find(|(kind, _)| *kind == Kind::Seeing);
        let (knocks, loads) = seeing.map_or((Value::Null, Value::Null), |(_, days)| {
            (knocks(days, self.hours), loads(days))
        });
        if common.json {
            let mut document = json!({
                "study": "day",
                "robot": common.robot,
                "hours": self.hours,
                "first_seed": common.seed,
                "seeds": self.seeds,
                "failed": failed,
                "knocks": knocks,
                "payloads": loads,
            });
            for (name, value) in rows {
                document[name] = value;
            }
            return print_json(&document);
        }
        let head = [
            "the tool's error",
            "mean, mm",
            "range",
            "95 %, mm",
            "inside, %",
        ];
        let mut table = vec![head.map(str::to_owned).to_vec()];
        let cell = |value: &Value| value.as_f64().map_or("-".to_owned(), |v| format!("{v:.3}"));
        for (name, row) in &rows {
            let inside = row["inside"].as_f64();
            table.push(vec![
                (*name).to_owned(),
                cell(&row["mean_mm"]),
                format!(
                    "{} to {}",
                    cell(&row["mean_least_mm"]),
                    cell(&row["mean_most_mm"])
                ),
                cell(&row["p95_mm"]),
                inside.map_or("-".to_owned(), |v| format!("{:.1}", v * 100.0)),
            ]);
        }
        write_out(&lay_out(&table));
        say!("knocks: {knocks}");
        say!("payloads: {loads}");
        for line in failed {
            say!("{line}");
        }
        Ok(())
    }
}

const fn word(kind: Kind) -> &'static str {
    match kind {
        Kind::Seeing => "tracked",
        Kind::Blind => "without_camera",
        Kind::Untracked => "untracked",
    }
}

fn mean_mm(day: &Day) -> f64 {
    let sum: f64 = day.samples.iter().map(|sample| sample.error_m).sum();
    sum / day.samples.len().max(1) as f64 * 1e3
}

fn median_of(days: &[Day], of: impl Fn(&Day) -> f64) -> f64 {
    quantile(days.iter().map(of).collect(), 0.5)
}

/// Share of the judged seconds between two times in which the tool was in its region.
fn inside(days: &[Day], from_s: f64, to_s: f64) -> Option<f64> {
    let within = days.iter().flat_map(|day| &day.samples);
    let within = within.filter(|s| s.at_s >= from_s && s.at_s < to_s);
    let said: Vec<bool> = within.filter_map(|sample| sample.inside).collect();
    let yes = said.iter().filter(|inside| **inside).count();
    (!said.is_empty()).then(|| yes as f64 / said.len() as f64)
}

/// Medians over the seeds, and what each hour was like.
fn figures(days: &[Day], hours: f64) -> Value {
    let p95 = |day: &Day| quantile(day.samples.iter().map(|s| s.error_m * 1e3).collect(), 0.95);
    let means: Vec<f64> = days.iter().map(mean_mm).collect();
    let mut by_hour = Vec::new();
    let mut hour = 0.0;
    while hour < hours {
        let (from_s, to_s) = (hour * 3600.0, (hour + 1.0) * 3600.0);
        let of_hour = |day: &Day| {
            let within = day.samples.iter();
            let within = within.filter(|s| s.at_s >= from_s && s.at_s < to_s);
            within.map(|s| s.error_m * 1e3).collect::<Vec<f64>>()
        };
        let mean = median_of(days, |day| {
            let errors = of_hour(day);
            errors.iter().sum::<f64>() / errors.len().max(1) as f64
        });
        by_hour.push(json!({
            "mean_mm": mean,
            "p95_mm": median_of(days, |day| quantile(of_hour(day), 0.95)),
            "inside": inside(days, from_s, to_s),
        }));
        hour += 1.0;
    }
    json!({
        "completed": days.len(),
        "mean_mm": quantile(means.clone(), 0.5),
        "mean_least_mm": quantile(means.clone(), 0.0),
        "mean_most_mm": quantile(means, 1.0),
        "p95_mm": median_of(days, p95),
        "p95_most_mm": quantile(days.iter().map(p95).collect(), 1.0),
        "inside": inside(days, 0.0, f64::INFINITY),
        "hours": by_hour,
        "doubted": days.iter().map(|day| day.doubted).sum::<usize>(),
        "rests": days.iter().map(|day| day.rests).sum::<usize>(),
        "false_names": days.iter().map(|day| day.false_names.len()).sum::<usize>(),
    })
}

fn knocks(days: &[Day], hours: f64) -> Value {
    let all: Vec<_> = days.iter().flat_map(|day| &day.knocks).collect();
    if all.is_empty() {
        return Value::Null;
    }
    let share = |camera: bool| {
        let these: Vec<_> = all.iter().filter(|k| (k.anchor == 0) == camera).collect();
        let right = these.iter().filter(|k| k.right).count();
        let wrong = these
            .iter()
            .filter(|k| !k.right && k.looks.is_some())
            .count();
        let off = these
            .iter()
            .filter(|k| k.right)
            .map(|k| k.off_m * 1e3)
            .collect();
        json!({
            "tried": these.len(),
            "named": right as f64 / these.len().max(1) as f64,
            "named_wrongly": wrong as f64 / these.len().max(1) as f64,
            "off_median_mm": quantile(off, 0.5),
        })
    };
    json!({
        "anchor": share(false),
        "camera": share(true),
        "undisturbed_hours": hours * days.len() as f64,
        "false_names": days.iter().map(|day| day.false_names.len()).sum::<usize>(),
    })
}

fn loads(days: &[Day]) -> Value {
    let all: Vec<_> = days.iter().flat_map(|day| &day.loads).collect();
    let mass: Vec<f64> = all.iter().map(|load| load.mass.abs()).collect();
    let across: Vec<f64> = all.iter().map(|load| load.across_m * 1e3).collect();
    let along: Vec<f64> = all.iter().map(|load| load.along_m * 1e3).collect();
    json!({
        "lifted": all.len(),
        "mass_error_median": quantile(mass.clone(), 0.5),
        "mass_error_p95": quantile(mass, 0.95),
        "center_across_median_mm": quantile(across.clone(), 0.5),
        "center_across_p95_mm": quantile(across, 0.95),
        "center_along_median_mm": quantile(along.clone(), 0.5),
        "center_along_p95_mm": quantile(along, 0.95),
    })
}
