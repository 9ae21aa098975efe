//! `mcdpr run TASK`: do a task on the simulator or on a board.

#[cfg(unix)]
use super::orders::listen;
use super::plan::Options;
use super::progress::Bar;
use super::recorded::{About, Recorded};
use super::table::lay_out;
use super::track::{Started, Track, remember, words};
use super::{Common, Failed, Outcome, print_json};
use crate::chart::PlotFormat;
use crate::control::Handle;
use crate::experiment::{Experiment, Looking, Run, SimulatedRobot, Stated};
use crate::machine::Mismatch;
use crate::motion::{Model, Task, Watch};
use crate::record::{Doing, Watched, task_source};
use crate::report::tube::share_inside;
use crate::report::{Figures, PathTrace, RunFolder, draw_path, write_samples};
use crate::robot::Robot;
use crate::run::saved::scale_of;
use crate::run::tracking::Lesson;
use crate::run::{Homing, new_session, watch_for_interrupts};
use mcdpr_core::estimate::tube::Tube;
use mcdpr_protocol::SessionId;
use serde::Serialize;
use std::cell::RefCell;

/// Run a task: a built-in one (paper:table7, paper:table8) or a task file
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// Name of a built-in task, or a task file (TOML)
    task: String,
    /// Height of a built-in task: that of a level platform's origin; the tool is below it
    #[arg(long, value_name = "MM", default_value_t = -100.0, allow_negative_numbers = true)]
    z_mm: f64,
    /// Simulate the machine exactly as described: no mismatch, no pulley loss
    #[arg(long)]
    ideal: bool,
    /// The robot hangs at its home now: for a board without reference lengths
    #[arg(long)]
    at_home: bool,
    /// Continue this task where a loss of power interrupted it, after `mcdpr recover`: straight back to its
    /// path, then the rest
    #[arg(long, conflicts_with = "at_home")]
    resume: bool,
    /// Do the task so many times in one session
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=100_000),
          conflicts_with = "resume")]
    laps: u32,
    #[command(flatten)]
    track: Track,
    #[command(flatten)]
    options: Options,
}

/// One JSON document of a run.
#[derive(Debug, Serialize)]
struct Document {
    #[serde(flatten)]
    figures: Figures,
    duration_s: f64,
    simulated: bool,
    realtime_factor: Option<f64>,
    run_folder: Option<String>,
    /// Figures of each lap, if the task was repeated.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    laps: Vec<Figures>,
    /// What each rest taught, if the robot was tracked.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    rests: Vec<Lesson>,
    /// The tool's error that each lap's plan stated, if the robot was tracked.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    tubes: Vec<Stated>,
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let robot = common.robot()?;
        let model = Model::new(&robot)?.with_options(self.options.chosen());
        let task = {
            let height_m = tool_height_m(&robot, self.z_mm);
            crate::motion::find_task_for(&model, &self.task, height_m)?
        };
        self.check_resume(common)?;
        self.track.check(common, self.resume)?;
        if common.dry_run {
            let drawing = super::plan::Drawing::OnRequest;
            return super::plan::show(
                common,
                &model,
                task,
                &Watch::default(),
                drawing,
                None,
                &super::plan::Known::default().belief(&robot)?,
            );
        }
        say_choice(&model);
        let start = || self.track.start(common, &model);
        let tracked = self.track.is_on().then(start).transpose()?;
        let model = match &tracked {
            Some(started) => started.rubbing_as_found(model),
            None => model,
        };
        watch_for_interrupts().map_err(Failed::from_error("watching for Ctrl-C"))?;
        let bar = Bar::new("running");
        let time_scale = common.pace()?;
        let handle = Handle::new();
        #[cfg(unix)]
        let _listening = listen(common, &handle)?;
        let name = task.name.clone();
        let mismatch = if self.ideal {
            Mismatch::default()
        } else {
            common.mismatch(Mismatch::realistic())
        };
        // Judge before a robot is even simulated: nothing may move for a refused task.
        Experiment::new(&model, task.clone()).plan()?;
        let source = task_source(&self.task, tool_height_m(&robot, self.z_mm));
        // The same seed must give the same run, bytes on the wire included.
        let session = if common.on == "sim" {
            SessionId(1)
        } else {
            new_session()
        };
        let hash = crate::recovery::task_hash(&source);
        let folder_name = source.name.clone();
        let about = About {
            name: &folder_name,
            task: source,
            session,
            mismatch: &mismatch,
            doing: Doing::Task,
            at_home: common.on == "sim" || self.at_home,
            orders: Some(&handle),
        };
        let recorded = Recorded::start(common, Some(&model), about)?;
        let events = &recorded.events;
        let rests = RefCell::new(Vec::new());
        let looking = self.track.looking(common, &model)?;
        let outcome = if common.on == "sim" {
            let robot = SimulatedRobot::new(mismatch, common.seed).controller(&common.controller);
            let experiment = Experiment::new(&model, task)
                .session(session)
                .handle(&handle)
                .recorded_by(events)
                .time_scale(time_scale)
                .progress(|p| bar.update(p));
            self.followed(experiment, tracked, looking, &rests)
                .simulate(&robot)
                .map(|simulated| {
                    let factor = simulated.realtime_factor();
                    (simulated.run, Some(factor))
                })
        } else {
            let experiment = self
                .on_port(&model, task, hash)
                .session(session)
                .handle(&handle)
                .progress(|p| bar.update(p));
            common
                .open_port()
                .map_err(|error| crate::link::ClientError::from(error).into())
                .and_then(|link| {
                    let line = Watched::new(link, events).with_orders(&handle);
                    self.followed(experiment, tracked, looking, &rests)
                        .run_on(line)
                })
                .map(|run| (run, None))
        };
        bar.finish();
        let rests = rests.take();
        remember(common, &name, &rests);
        // A failed run is kept too: it is the one that needs examination.
        let folder = recorded.finish();
        let (run, realtime_factor) = outcome.inspect_err(|_| {
            eprintln!("what happened is recorded in {}", folder.path().display());
        })?;
        if let Err(error) = save(&model, &name, &run, &folder, common.plots()) {
            incomplete(&error);
        }
        let figures = run.figures(&model)?;
        let tubes = if run.stated.is_empty() {
            run.stated().into_iter().collect()
        } else {
            run.stated.clone()
        };
        let document = Document {
            tubes,
            figures,
            duration_s: run.plan.timed.duration_s(),
            simulated: run.simulated,
            realtime_factor,
            run_folder: Some(folder.path().display().to_string()),
            laps: run.laps.clone(),
            rests,
        };
        if let Err(error) = folder.write_json("summary.json", &document) {
            incomplete(&error);
        }
        if common.json {
            return print_json(&document);
        }
        let title = if run.simulated {
            "simulation"
        } else {
            "hardware"
        };
        let rows = [vec![String::new(), title.to_owned()]];
        let rows: Vec<_> = rows
            .into_iter()
            .chain(figure_rows(&model, &[figures]))
            .collect();
        super::write_out(&lay_out(&rows));
        if let Some(laps) = lap_words(&document.laps) {
            say!("{laps}");
        }
        if !document.rests.is_empty() {
            say!("{}", words(&document.rests));
        }
        if let Some(stated) = stated_words(&document.tubes) {
            say!("{stated}");
        }
        say!("run folder: {}", folder.path().display());
        Ok(())
    }

    /// The experiment with its laps, and tracked if that was asked for; `rests` gets what each rest taught.
    fn followed<'a>(
        &self,
        experiment: Experiment<'a>,
        tracked: Option<Started>,
        looking: Looking<'a>,
        rests: &'a RefCell<Vec<Lesson>>,
    ) -> Experiment<'a> {
        let experiment = experiment.laps(self.laps as usize);
        match tracked {
            Some(started) => started.tracked(experiment, looking, rests),
            None => experiment,
        }
    }

    /// Refuses `--resume` where nothing can be continued.
    fn check_resume(&self, common: &Common) -> Outcome {
        if self.resume && common.on == "sim" {
            let reason = "no simulated robot outlasts this program: `mcdpr recover --resume` cuts its power, recovers and continues; or give a port with --on";
            return Err(Failed::from_error("run --resume")(reason).into());
        }
        if self.resume && common.dry_run {
            return Err(super::dry::refusal("run --resume").into());
        }
        Ok(())
    }

    /// The task on a board, from its start or from where it was interrupted; `hash` is its checksum.
    fn on_port<'m>(&self, model: &'m Model, task: Task, hash: u32) -> Experiment<'m> {
        let experiment = Experiment::new(model, task);
        let homing = if self.at_home {
            Homing::Place(model.robot().tool.home_in_world_m)
        } else {
            Homing::Known
        };
        let experiment = experiment.homing(homing);
        if self.resume {
            let scale = scale_of(model.robot());
            return experiment.resume(hash, move |board| crate::recovery::load(board, scale));
        }
        experiment
    }
}

/// The first and the last lap, and the median, in a sentence; `None` for a single one.
fn lap_words(laps: &[Figures]) -> Option<String> {
    let (first, last) = laps.first().zip(laps.last()).filter(|_| laps.len() > 1)?;
    let error = |figures: &Figures| {
        figures
            .path_error_m
            .map_or(figures.cable_length_error_m.mean, |e| e.mean)
            * 1e3
    };
    let what = if first.path_error_m.is_some() {
        "path error of the tool"
    } else {
        "cable length error"
    };
    let mut all: Vec<f64> = laps.iter().map(error).collect();
    all.sort_by(f64::total_cmp);
    let middle = all.get(all.len() / 2).copied().unwrap_or(0.0);
    Some(format!(
        "{} laps, {what}, mean of the first {:.3}, of the last {:.3}, median {middle:.3} mm",
        laps.len(),
        error(first),
        error(last)
    ))
}

/// What the plans of tracked laps stated of the tool's error, and whether it held, in a sentence.
fn stated_words(tubes: &[Stated]) -> Option<String> {
    let (first, last) = tubes.first().zip(tubes.last())?;
    let plans = match tubes.len() {
        1 => format!(
            "the plan stated the tool within {:.2} mm",
            last.mean_m * 1e3
        ),
        _ => format!(
            "the first plan stated the tool within {:.2} mm, the last within {:.2} mm",
            first.mean_m * 1e3,
            last.mean_m * 1e3
        ),
    };
    let words = format!("{plans} of the path (95 %, mean radius), by what is tracked");
    let inside: Option<Vec<f64>> = tubes.iter().map(|tube| tube.inside).collect();
    Some(match inside {
        Some(shares) => {
            let mean = shares.iter().sum::<f64>() / shares.len() as f64;
            format!(
                "{words}; the simulated tool was inside for {:.1} % of the path",
                mean * 100.0
            )
        }
        None => words,
    })
}

/// Height of the tool when a level platform's origin is at `z_mm`, m.
pub(crate) fn tool_height_m(robot: &Robot, z_mm: f64) -> f64 {
    z_mm * 1e-3 + robot.tool.tcp_in_platform_m.z
}

/// A disk that is full now does not affect the completed motion.
pub(crate) fn incomplete(error: &dyn std::fmt::Display) {
    eprintln!("warning: the run's folder is incomplete: {error}");
}

/// Writes samples and plot of a run.
fn save(model: &Model, name: &str, run: &Run, folder: &RunFolder, plots: PlotFormat) -> Outcome {
    let failed = || Failed::from_error("writing the run folder");
    let truth = run.true_path.as_deref();
    let samples = write_samples(&run.plan, &run.samples, truth)?;
    folder.write("samples.csv", &samples).map_err(failed())?;
    let traces: Vec<_> = truth
        .into_iter()
        .map(|points| PathTrace {
            name: "simulated tool",
            points,
        })
        .collect();
    let figure = draw_path(name, &run.plan, &traces)?;
    folder.plot("path", &figure, plots).map_err(failed())?;
    folder
        .write_json("robot.json", model.robot())
        .map_err(failed())?;
    let tube = match &run.tube {
        Some(tube) => Some(tube.clone()),
        None => {
            let belief = super::plan::Known::default().belief(model.robot())?;
            Tube::along(&run.plan, &belief)?
        }
    };
    if let Some(tube) = tube {
        let inside = truth.map(|points| share_inside(&run.plan, &tube, points));
        let about = serde_json::json!({
            "words": tube.words(), "mean_m": tube.mean_m, "widest": tube.widest, "inside": inside,
        });
        folder
            .write_json(super::report::TUBE, &about)
            .map_err(failed())?;
    }
    Ok(())
}

/// Rows of a table of figures, one column per run.
pub(crate) fn figure_rows(model: &Model, figures: &[Figures]) -> Vec<Vec<String>> {
    let row = |name: &str, cell: &dyn Fn(&Figures) -> String| {
        std::iter::once(name.to_owned())
            .chain(figures.iter().map(cell))
            .collect()
    };
    let numbers: Vec<_> = model
        .holding()
        .by_tension()
        .iter()
        .map(|cable| (cable + 1).to_string())
        .collect();
    let mut rows = vec![
        row("path error of the tool, mean / max, mm", &|f| {
            f.path_error_m.map_or("not measured".to_owned(), |e| {
                format!("{:.3} / {:.3}", e.mean * 1e3, e.max * 1e3)
            })
        }),
        row("cable length error, mean / sd / max, mm", &|f| {
            let e = f.cable_length_error_m;
            format!(
                "{:.3} / {:.3} / {:.3}",
                e.mean * 1e3,
                e.sd * 1e3,
                e.max * 1e3
            )
        }),
    ];
    if !numbers.is_empty() {
        let name = format!("cable-{} tension error, mean / max, N", numbers.join(", -"));
        rows.push(row(&name, &|f| {
            let e = f.tension_error_n;
            format!("{:.3} / {:.3}", e.mean_abs, e.max_abs)
        }));
    }
    if figures.iter().any(|f| f.attitude_error_rad.is_some()) {
        rows.push(row("attitude error, mean / max, deg", &|f| {
            f.attitude_error_rad.map_or("not measured".to_owned(), |e| {
                format!("{:.3} / {:.3}", e.mean.to_degrees(), e.max.to_degrees())
            })
        }));
    }
    rows
}

/// Says how the cables to hold by length were chosen, where the program chose them.
pub(crate) fn say_choice(model: &Model) {
    let Some(choice) = &model.robot().chosen else {
        return;
    };
    let list = |cables: &[usize]| {
        let numbers: Vec<_> = cables.iter().map(|cable| (cable + 1).to_string()).collect();
        numbers.join(", ")
    };
    let holding = model.holding();
    let next = choice.next.map_or_else(String::new, |next| {
        format!(", the next best choice {next:.3}")
    });
    eprintln!(
        "control = \"auto\": cables {} by length, {} by tension; worst conditioning over the work space \
         {:.3}{next}",
        list(holding.by_length()),
        list(holding.by_tension()),
        choice.condition
    );
}
