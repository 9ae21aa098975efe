//! `mcdpr study track`: a task again and again on machines that creep, warm and drift, tracked and not; and knocks.

use crate::cli::run::tool_height_m;
use crate::cli::table::lay_out;
use crate::cli::track::prior;
use crate::cli::{Common, Failed, Outcome, print_json, write_out};
use crate::experiment::{Experiment, Looking, SimulatedRobot, Stated};
use crate::machine::Mismatch;
use crate::motion::{Model, Task};
use crate::report::Figures;
use crate::run::tracking::{Lesson, Tracking};
use crate::run::{RunError, interrupted, watch_for_interrupts};
use crate::study::quantile;
use mcdpr_core::random::Random;
use nalgebra::Vector3;
use rayon::prelude::*;
use serde_json::{Value, json};

/// The moving robot repeats a task on machines that creep, warm and drift: tracked with and without camera, and not
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// Laps of the task, with a rest after each
    #[arg(long, default_value_t = 40, value_parser = clap::value_parser!(u32).range(2..=10_000))]
    laps: u32,
    /// Simulated machines, one per seed
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..=1000))]
    seeds: u64,
    /// The task: a file, or the name of a built-in one
    #[arg(long, default_value = "fitting", value_name = "TASK")]
    task: String,
    /// Knock a random anchor by so much after half of the laps, mm; 0 for no knock
    #[arg(long, default_value_t = 0.0, value_name = "MM")]
    knock_mm: f64,
}

/// An anchor moves within this time, s: a knock in an instant would jerk the cables over their limit, and the board
/// would stop the robot.
const KNOCK_S: f64 = 0.5;

/// How a robot is tracked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Seeing,
    Blind,
    Untracked,
}

impl Kind {
    const ALL: [Self; 3] = [Self::Seeing, Self::Blind, Self::Untracked];

    const fn word(self) -> &'static str {
        match self {
            Self::Seeing => "tracked",
            Self::Blind => "without_camera",
            Self::Untracked => "untracked",
        }
    }
}

/// One machine's laps.
struct Done {
    laps: Vec<Figures>,
    rests: Vec<Lesson>,
    tubes: Vec<Stated>,
    /// The cable whose anchor was knocked, from 1, and the rest before it.
    knocked: Option<(usize, usize)>,
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        if !(0.0..=20.0).contains(&self.knock_mm) {
            let reason = format!("{}: give 0 to 20", self.knock_mm);
            return Err(Failed::from_error("--knock-mm")(reason).into());
        }
        let robot = crate::robot::find(&common.robot)?;
        let model = Model::new(&robot)?;
        let task = crate::motion::find_task_for(&model, &self.task, tool_height_m(&robot, -100.0))?;
        Experiment::new(&model, task.clone()).plan()?;
        watch_for_interrupts().map_err(Failed::from_error("watching for Ctrl-C"))?;
        let machine = common.mismatch(Mismatch::after_hours());
        let seeds = common.seed..common.seed.saturating_add(self.seeds);
        let jobs: Vec<(Kind, u64)> = Kind::ALL
            .into_iter()
            .filter(|kind| match kind {
                Kind::Seeing => !robot.tags.is_empty(),
                Kind::Blind => true,
                // Knocks are told to nobody there.
                Kind::Untracked => self.knock_mm == 0.0,
            })
            .flat_map(|kind| seeds.clone().map(move |seed| (kind, seed)))
            .collect();
        let all: Vec<(Kind, u64, Result<Done, RunError>)> = jobs
            .into_par_iter()
            .map(|(kind, seed)| {
                if interrupted() {
                    return (kind, seed, Err(RunError::Interrupted));
                }
                let done = self.laps_of(&model, &task, machine, kind, seed);
                if !common.json {
                    match &done {
                        Ok(done) => {
                            eprintln!(
                                "seed {seed}, {}: {:.3} mm",
                                kind.word(),
                                mean_mm(&done.laps)
                            );
                        }
                        Err(error) => eprintln!("seed {seed}, {}: {error}", kind.word()),
                    }
                }
                (kind, seed, done)
            })
            .collect();
        if interrupted() {
            return Err(RunError::Interrupted.into());
        }
        self.show(common, &all)
    }

    fn laps_of(
        &self,
        model: &Model,
        task: &Task,
        machine: Mismatch,
        kind: Kind,
        seed: u64,
    ) -> Result<Done, RunError> {
        let link = SimulatedRobot::new(machine, seed).at_home(model)?;
        let rests = std::cell::RefCell::new(Vec::new());
        let knocked = std::cell::Cell::new(None);
        let mut random = Random::new(seed ^ 0x6b6e_6f63);
        let mut experiment = Experiment::new(model, task.clone()).laps(self.laps as usize);
        if kind != Kind::Untracked {
            let looking = match kind {
                Kind::Seeing => Looking::Simulated,
                _ => Looking::Blind,
            };
            let tracking = (Tracking::new(model, &prior(model.robot())), None);
            experiment = experiment.tracked(
                tracking,
                looking,
                |_, lesson| {
                    let mut rests = rests.borrow_mut();
                    rests.push(lesson.clone());
                    if self.knock_mm > 0.0 && rests.len() == self.laps as usize / 2 {
                        let cable = random.below(model.robot().cables.len());
                        let way = Vector3::from_fn(|_, _| random.normal());
                        let by_m = way.normalize() * self.knock_mm * 1e-3;
                        let done = link.with(|simulation| {
                            let plant = simulation.plant_mut();
                            plant.push_anchor(cable, by_m.into(), KNOCK_S)
                        });
                        if done.is_ok() {
                            knocked.set(Some((cable + 1, rests.len())));
                        }
                    }
                },
                None,
            );
        }
        let run = experiment.simulate_on(&link, seed)?.run;
        Ok(Done {
            laps: run.laps,
            tubes: run.stated,
            rests: rests.take(),
            knocked: knocked.get(),
        })
    }

    fn show(&self, common: &Common, all: &[(Kind, u64, Result<Done, RunError>)]) -> Outcome {
        let mut document = json!({
            "study": "track", "robot": common.robot, "task": self.task, "laps": self.laps,
            "first_seed": common.seed, "seeds": self.seeds, "knock_mm": self.knock_mm,
        });
        let head = [
            "path error of the tool",
            "mean, mm",
            "range",
            "last lap",
            "greatest, median",
            "stopped",
        ];
        let mut table = vec![head.map(str::to_owned).to_vec()];
        let mut sentences = Vec::new();
        for kind in Kind::ALL {
            let of_kind: Vec<_> = all.iter().filter(|(k, ..)| *k == kind).collect();
            if of_kind.is_empty() {
                continue;
            }
            let done: Vec<&Done> = of_kind
                .iter()
                .filter_map(|(.., d)| d.as_ref().ok())
                .collect();
            let failed: Vec<String> = of_kind
                .iter()
                .filter_map(|(_, seed, d)| d.as_ref().err().map(|e| format!("seed {seed}: {e}")))
                .collect();
            let means: Vec<f64> = done.iter().map(|d| mean_mm(&d.laps)).collect();
            let most: Vec<f64> = done.iter().map(|d| most_mm(&d.laps)).collect();
            let last: Vec<f64> = done
                .iter()
                .map(|d| mean_mm(d.laps.last().map_or(&[], std::slice::from_ref)))
                .collect();
            let q = |values: &[f64], share: f64| quantile(values.to_vec(), share);
            let knocks = (kind != Kind::Untracked).then(|| names(&done));
            document[kind.word()] = json!({
                "mean_mm": q(&means, 0.5), "mean_least_mm": q(&means, 0.0), "mean_most_mm": q(&means, 1.0),
                "last_lap_mm": q(&last, 0.5), "last_lap_most_mm": q(&last, 1.0),
                "max_mm": q(&most, 0.5), "max_most_mm": q(&most, 1.0),
                "machines": done.len(), "stopped": failed, "rests": knocks, "tube": tube(&done),
            });
            table.push(vec![
                kind.word().to_owned(),
                format!("{:.3}", q(&means, 0.5)),
                format!("{:.3} to {:.3}", q(&means, 0.0), q(&means, 1.0)),
                format!("{:.3}", q(&last, 0.5)),
                format!("{:.3}", q(&most, 0.5)),
                failed.len().to_string(),
            ]);
            if let Some(knocks) = knocks {
                sentences.push(format!("{}: {knocks}", kind.word()));
            }
            if let Some(tube) = tube(&done) {
                sentences.push(format!("{}, tube of the plans: {tube}", kind.word()));
            }
            sentences.extend(failed);
        }
        if common.json {
            return print_json(&document);
        }
        write_out(&lay_out(&table));
        for sentence in sentences {
            say!("{sentence}");
        }
        Ok(())
    }
}

/// Rests, how many fitted, and how knocks were named: within two rests after them, rightly, and without one.
fn names(done: &[&Done]) -> Value {
    let (mut rests, mut fitted, mut knocks, mut right, mut wrong, mut without) = (0, 0, 0, 0, 0, 0);
    for machine in done {
        rests += machine.rests.len();
        fitted += machine.rests.iter().filter(|lesson| lesson.fits).count();
        knocks += usize::from(machine.knocked.is_some());
        let named = (1..).zip(&machine.rests);
        for (rest, words) in named.filter_map(|(rest, l)| Some((rest, l.named.as_ref()?))) {
            match machine.knocked {
                Some((cable, before)) if rest > before => {
                    let says = words.starts_with(&format!("anchor {cable} "));
                    right += usize::from(says && rest <= before + 2);
                    wrong += usize::from(!says);
                }
                _ => without += 1,
            }
        }
    }
    json!({
        "rests": rests, "fitted": fitted, "knocks": knocks, "named_within_two": right,
        "named_wrongly": wrong, "named_without_a_knock": without,
    })
}

/// Share of the path with the tool inside the tube that each lap's plan stated, of all laps and of one machine's, and the mean
/// radius, mm; `None` without tracking.
fn tube(done: &[&Done]) -> Option<Value> {
    let shares: Vec<f64> = done
        .iter()
        .filter(|machine| !machine.tubes.is_empty())
        .map(|machine| {
            let inside = machine.tubes.iter().filter_map(|tube| tube.inside);
            inside.sum::<f64>() / machine.tubes.len() as f64
        })
        .collect();
    let radii = done.iter().flat_map(|machine| &machine.tubes);
    let radii: Vec<f64> = radii.map(|tube| tube.mean_m * 1e3).collect();
    if shares.is_empty() {
        return None;
    }
    Some(json!({
        "inside": shares.iter().sum::<f64>() / shares.len() as f64,
        "inside_least_of_a_machine": quantile(shares, 0.0),
        "radius_mm": quantile(radii.clone(), 0.5),
        "radius_least_mm": quantile(radii.clone(), 0.0), "radius_most_mm": quantile(radii, 1.0),
    }))
}

/// Mean over the laps, mm.
fn mean_mm(laps: &[Figures]) -> f64 {
    let sum: f64 = laps
        .iter()
        .filter_map(|lap| Some(lap.path_error_m?.mean))
        .sum();
    sum / laps.len().max(1) as f64 * 1e3
}

/// Greatest of all laps, mm.
fn most_mm(laps: &[Figures]) -> f64 {
    let most = laps.iter().filter_map(|lap| Some(lap.path_error_m?.max));
    most.fold(0.0, f64::max) * 1e3
}
