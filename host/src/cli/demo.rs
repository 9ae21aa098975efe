//! `mcdpr demo`: the paper's robot around its circle, or another one around a circle that fits it, on the
//! simulator.

use super::progress::Bar;
use super::reaction;
use super::recorded::{About, Recorded};
use super::run::{figure_rows, say_choice, tool_height_m};
use super::table::lay_out;
use super::{Common, Failed, Outcome, print_json};
use crate::chart::PlotFormat;
use crate::experiment::{Experiment, SimulatedRobot, SimulatedRun};
use crate::machine::Mismatch;
use crate::motion::{Model, PAPER, PAPER_HEIGHT_M, Task};
use crate::record::{Doing, task_source};
use crate::report::{Figures, PathTrace, RunFolder, draw_path, write_samples};
use crate::run::watch_for_interrupts;
use crate::scenario::Scenario;
use mcdpr_protocol::SessionId;
use serde::Serialize;

/// Show the simulated robot following the paper's circle, or one that fits the robot (the default)
#[derive(Debug, Default, clap::Args)]
pub(crate) struct Cmd {
    /// Inject a fault and show the reaction: ID[:CABLE]@TIME, such as S2@3.0s, C3:2@1.5s, B1@start
    #[arg(long = "fault", value_name = "FAULT")]
    faults: Vec<String>,
    /// Inject the faults of a scenario file (TOML) and show the reaction
    #[arg(long, value_name = "FILE", conflicts_with = "faults")]
    scenario: Option<std::path::PathBuf>,
}

/// Height of the paper's circle, mm.
pub(crate) const HEIGHT_MM: f64 = PAPER_HEIGHT_M * 1e3;

/// One JSON document of the demo. The figures at the top are those of the realistic machine.
#[derive(Debug, Serialize)]
struct Document {
    #[serde(flatten)]
    realistic: Figures,
    realtime_factor: f64,
    run_folder: String,
    duration_s: f64,
    simulated: bool,
    as_described: Figures,
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        if common.on != "sim" {
            return Err(
                Failed::from_error("the demo runs on the simulator only")(format!(
                    "for a board use `mcdpr run paper:table7 --on {}`",
                    common.on
                ))
                .into(),
            );
        }
        let robot = crate::robot::find(&common.robot)?;
        let model = Model::new(&robot)?;
        let task = task_for(&model)?;
        say_choice(&model);
        let cables = robot.cables.len();
        let scenario = match &self.scenario {
            Some(file) => Some(crate::scenario::load(file, cables)?),
            None if self.faults.is_empty() => None,
            None => Some(Scenario::from_words(&self.faults, cables)?),
        };
        if let Some(scenario) = &scenario {
            scenario.suits(&robot)?;
        }
        let plan = Experiment::new(&model, task.clone()).plan()?;
        if common.dry_run {
            eprintln!(
                "{:.1} s, within every limit; nothing was moved",
                plan.timed.duration_s()
            );
            return Ok(());
        }
        if let Some(scenario) = scenario {
            return reaction::show(&model, task, &scenario, common);
        }
        watch_for_interrupts().map_err(Failed::from_error("watching for Ctrl-C"))?;
        let one = |name: &'static str, mismatch: &Mismatch| {
            let bar = Bar::new(name);
            let run = Experiment::new(&model, task.clone())
                .progress(|p| {
                    bar.update(p);
                })
                .simulate(
                    &SimulatedRobot::new(*mismatch, common.seed).controller(&common.controller),
                );
            bar.finish();
            run
        };
        let ideal = one("machine as described", &Mismatch::default())?;
        let (real, folder) = recorded(&model, task.clone(), common)?;
        report(&model, task.name == PAPER, &ideal, &real, &folder, common)
    }
}

/// The machine of the first column, if the user names no other.
const USUAL: &str = "realistic";

fn task_for(model: &Model) -> miette::Result<Task> {
    let height_m = tool_height_m(model.robot(), HEIGHT_MM);
    let name = Task::fitting_name(model);
    Ok(crate::motion::find_task_for(model, name, height_m)?)
}

/// The run on the machine that is off, with its record.
fn recorded(
    model: &Model,
    task: Task,
    common: &Common,
) -> miette::Result<(SimulatedRun, RunFolder)> {
    let mismatch = common.mismatch(Mismatch::realistic());
    let source = task_source(&task.name, tool_height_m(model.robot(), HEIGHT_MM));
    // The same seed must give the same run, bytes on the wire included.
    let session = SessionId(1);
    let about = About {
        name: "demo",
        task: source,
        session,
        mismatch: &mismatch,
        doing: Doing::Task,
        orders: None,
        at_home: true,
    };
    let recorded = Recorded::start(common, Some(model), about)?;
    let bar = Bar::new("machine that is off");
    let robot = SimulatedRobot::new(mismatch, common.seed).controller(&common.controller);
    let run = Experiment::new(model, task)
        .session(session)
        .recorded_by(&recorded.events)
        .progress(|p| bar.update(p))
        .simulate(&robot);
    bar.finish();
    let folder = recorded.finish();
    Ok((run?, folder))
}

fn report(
    model: &Model,
    paper: bool,
    ideal: &SimulatedRun,
    real: &SimulatedRun,
    folder: &RunFolder,
    common: &Common,
) -> Outcome {
    save((model, paper), ideal, real, (folder, common.plots()))?;
    let (as_described, realistic) = (ideal.run.figures(model)?, real.run.figures(model)?);
    let simulated_s = ideal.simulated_s + real.simulated_s;
    let took_s = (ideal.took + real.took).as_secs_f64();
    let document = Document {
        realistic,
        realtime_factor: simulated_s / took_s.max(1e-9),
        run_folder: folder.path().display().to_string(),
        duration_s: real.run.plan.timed.duration_s(),
        simulated: true,
        as_described,
    };
    folder
        .write_json("summary.json", &document)
        .map_err(Failed::from_error("writing the run folder"))?;
    if common.json {
        return print_json(&document);
    }
    if paper {
        say!(
            "{}: approach and circle of Table 7 with the platform at z = {HEIGHT_MM:.0} mm, {:.1} s",
            model.robot().name,
            document.duration_s
        );
    } else {
        say!(
            "{}: approach and circle that fits its work space{}, {:.1} s",
            model.robot().name,
            if model.holding().freedom().turns() {
                ", then tilts and turns both ways"
            } else {
                ""
            },
            document.duration_s
        );
    }
    let kind = common.machine.as_deref().unwrap_or(USUAL);
    let machine = format!("{kind} machine");
    let words = |row: [&str; 4]| row.map(str::to_owned).to_vec();
    let mut rows = vec![
        words(["", "simulation,", "simulation,", "the paper,"]),
        words(["", &machine, "as described", "hardware"]),
    ];
    let theirs = ["3.425 / 7.044", "1.240 / 1.062 / 4.105", "0.291 /  -"];
    if !paper {
        for row in &mut rows {
            row.pop();
        }
    }
    for (index, mut row) in figure_rows(model, &[realistic, as_described])
        .into_iter()
        .enumerate()
    {
        if paper {
            row.push(theirs.get(index).copied().unwrap_or_default().to_owned());
        }
        rows.push(row);
    }
    super::write_out(&lay_out(&rows));
    if kind == USUAL {
        say!(
            "realistic: anchors off by 0.3 mm, pulleys lose 2 %, mass 2 %, stiffness 20 %, drive lag \
             20 %, sensor gain 1 % (seed {})",
            common.seed
        );
    } else {
        say!(
            "{kind}: see --machine in `mcdpr demo --help` (seed {})",
            common.seed
        );
    }
    say!(
        "{simulated_s:.1} s simulated in {took_s:.2} s ({:.0} times real time)",
        document.realtime_factor
    );
    say!(
        "run folder: {} (path.{} shows the circle)",
        document.run_folder,
        common.plots().ending()
    );
    Ok(())
}

fn save(
    (model, paper): (&Model, bool),
    ideal: &SimulatedRun,
    real: &SimulatedRun,
    (folder, plots): (&RunFolder, PlotFormat),
) -> Outcome {
    let failed = || Failed::from_error("writing the run folder");
    let plan = &real.run.plan;
    for (name, run) in [
        ("samples.csv", &real.run),
        ("samples-as-described.csv", &ideal.run),
    ] {
        let text = write_samples(plan, &run.samples, run.true_path.as_deref())?;
        folder.write(name, &text).map_err(failed())?;
    }
    let traces = [("machine that is off", real), ("as described", ideal)];
    let traces: Vec<_> = traces
        .iter()
        .map(|(name, run)| PathTrace {
            name,
            points: run.run.true_path.as_deref().unwrap_or_default(),
        })
        .collect();
    let shown = if paper {
        "the circle of Table 7"
    } else {
        "a circle that fits"
    };
    let title = format!("{}: {shown}, simulated tool", model.robot().name);
    folder
        .plot("path", &draw_path(&title, plan, &traces)?, plots)
        .map_err(failed())?;
    folder
        .write_json("robot.json", model.robot())
        .map_err(failed())?;
    Ok(())
}
