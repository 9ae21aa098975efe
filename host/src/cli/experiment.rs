//! `mcdpr experiment NAME|FILE`: holds a tension while hands pull, and reports the effect.

use super::recorded::{Work, on_record};
use super::table::lay_out;
use super::{Common, Failed, Outcome, print_json};
use crate::chart::{Chart, Curve, Figure};
use crate::link::ClientError;
use crate::machine::Mismatch;
use crate::motion::{Model, PlanOptions, Tensioning};
use crate::record::Doing;
use crate::report::RunFolder;
use crate::robot::LawKind;
use crate::run::{RunError, watch_for_interrupts};
use crate::tension::{Bench, Change, Experiment, Recovery, Steady, Trace, at_rest, hold, recovery};
use miette::{Diagnostic, IntoDiagnostic as _};
use serde::Serialize;

/// Hold a tension while hands pull: hold, platform, cable, slack, or a task file
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// Built-in experiment (hold, platform, cable, slack), or a task file with [[pull]]
    what: String,
    /// Law instead of the robot file's
    #[arg(long, value_enum)]
    law: Option<Law>,
    /// Set-point instead of the robot file's, N
    #[arg(long, value_name = "N")]
    setpoint_n: Option<f64>,
    /// Tension lost at every simulated pulley, as a share
    #[arg(long, value_name = "SHARE", default_value_t = 0.0)]
    pulley_loss: f64,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Law {
    /// The paper's Eq. 1
    Pd,
    /// The default law
    Default,
}

/// The request exceeds the robot's limits.
#[derive(Debug, thiserror::Error, Diagnostic)]
#[error("{what} is {value}, it must be {rule}: nothing was moved")]
#[diagnostic(code(mcdpr::tension::range))]
struct OutOfRange {
    what: &'static str,
    value: f64,
    rule: String,
}

#[derive(Debug, Serialize)]
struct Document {
    experiment: String,
    setpoint_n: f64,
    simulated: bool,
    steady: Steady,
    recovery: Option<Recovery>,
    fault: Option<String>,
    run_folder: String,
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let mut robot = crate::robot::find(&common.robot)?;
        match self.law {
            Some(Law::Pd) => robot.tension.law = LawKind::Pd,
            Some(Law::Default) => robot.tension.law = LawKind::Default,
            None => {}
        }
        if let Some(setpoint_n) = self.setpoint_n {
            let (floor_n, ceiling_n) = (robot.tension.floor_n, robot.tension.ceiling_n);
            if !(floor_n..=ceiling_n).contains(&setpoint_n) {
                return Err(OutOfRange {
                    what: "the set-point",
                    value: setpoint_n,
                    rule: format!("{floor_n} to {ceiling_n} N (floor_n and ceiling_n)"),
                }
                .into());
            }
            robot.tension.setpoint_n = setpoint_n;
        }
        if !(0.0..=0.1).contains(&self.pulley_loss) {
            return Err(OutOfRange {
                what: "the pulley loss",
                value: self.pulley_loss,
                rule: "0 to 0.1".to_owned(),
            }
            .into());
        }
        let mut model = Model::new(&robot)?;
        if self.setpoint_n.is_some() {
            // The requested tension, and not the one that suits the position best.
            model = model.with_options(PlanOptions {
                tensioning: Tensioning::Setpoint,
                ..PlanOptions::default()
            });
        }
        let held = model.holding().first_by_tension().ok_or_else(|| {
            Failed::from_error("experiment")(format!(
                "no cable of {} is held by its tension: there is no tension loop to try",
                robot.name
            ))
        })?;
        let experiment = Experiment::find(&self.what, held, robot.cables.len())?;
        if common.dry_run {
            eprintln!(
                "{} is a valid experiment; nothing was moved",
                experiment.name
            );
            return Ok(());
        }
        watch_for_interrupts().map_err(Failed::from_error("watching for Ctrl-C"))?;
        let simulated = common.on == "sim";
        let name = format!("tension-{}", experiment.name);
        let work = Work::new(&name, Doing::Hands, Mismatch::default(), &model);
        let (trace, folder) = on_record(common, &work, |record| {
            if simulated {
                let change = Change {
                    pulley_loss: self.pulley_loss,
                    ..Change::default()
                };
                let mut bench = Bench::start_on(
                    model.clone(),
                    &change,
                    common.seed,
                    &common.controller,
                    |link, tap| record.tapped(link, tap),
                )?;
                return Ok(bench.run(&experiment.script)?);
            }
            let link = common
                .open_port()
                .map_err(|error| RunError::from(ClientError::from(error)))?;
            let (line, session) = (record.line(link), record.session);
            Ok(hold(&model, line, session, &experiment, |words| {
                eprintln!("{words}")
            })?)
        })?;
        self.report(&experiment, &trace, &folder, common)
    }

    fn report(
        &self,
        experiment: &Experiment,
        trace: &Trace,
        folder: &RunFolder,
        common: &Common,
    ) -> Outcome {
        let simulated = common.on == "sim";
        let end_s = experiment.script.duration_s;
        let from_s = (end_s - 2.0).max(0.0);
        let steady = at_rest(trace, from_s, end_s);
        let back = experiment
            .disturbed_s
            .map(|[on_s, off_s]| recovery(trace, on_s, off_s));
        folder.write("trace.csv", &table(trace)).into_diagnostic()?;
        let source = if simulated { "simulated" } else { "measured" };
        let title = format!("{}: tension of the held cable, {source}", experiment.name);
        let pairs = |y: &[f64], x: &[f64]| -> Vec<(f64, f64)> {
            x.iter().copied().zip(y.iter().copied()).collect()
        };
        let setpoint = [0.0, end_s].map(|at_s| (at_s, trace.setpoint_n));
        let chart = Chart::new("band: set-point +-0.5 N", "time, s", "tension, N")
            .with([
                Curve::new("tension", 0, pairs(&trace.tension_n, &trace.time_s)),
                Curve::new("set-point", 4, setpoint).dashed(),
            ])
            .band(trace.setpoint_n - 0.5, trace.setpoint_n + 0.5);
        folder
            .plot("tension", &Figure::new(title, 1, [chart]), common.plots())
            .into_diagnostic()?;
        let document = Document {
            experiment: experiment.name.clone(),
            setpoint_n: trace.setpoint_n,
            simulated,
            steady,
            recovery: back,
            fault: trace.fault.clone(),
            run_folder: folder.path().display().to_string(),
        };
        folder
            .write_json("summary.json", &document)
            .into_diagnostic()?;
        if common.json {
            return print_json(&document);
        }
        let row = |name: &str, value: String| vec![name.to_owned(), value];
        let mut rows = vec![
            row("", source.to_owned()),
            row(
                "mean error over the end, N",
                format!("{:.3}", steady.mean_error_n),
            ),
            row("standard deviation there, N", format!("{:.3}", steady.sd_n)),
        ];
        if let Some(back) = back {
            rows.push(row("peak error, N", format!("{:.2}", back.peak_n)));
            rows.push(row(
                "mean of 50 ms back in 0.5 N after, s",
                format!("{:.3}", back.mean_back_s),
            ));
            rows.push(row(
                "every ms back in 0.5 N after, s",
                format!("{:.3}", back.instant_back_s),
            ));
            rows.push(row(
                "least tension of any cable, N",
                format!("{:.2}", back.least_n),
            ));
        }
        super::write_out(&lay_out(&rows));
        say!(
            "run folder: {} (tension.{} shows the trace)",
            document.run_folder,
            common.plots().ending()
        );
        match &trace.fault {
            None => Ok(()),
            Some(fault) => Err(Failed::from_error("the experiment ended early")(fault).into()),
        }
    }
}

fn table(trace: &Trace) -> String {
    let mut text = String::from("time_s,tension_n,current_a,least_tension_n\n");
    for (((t, n), a), least) in trace
        .time_s
        .iter()
        .zip(&trace.tension_n)
        .zip(&trace.current_a)
        .zip(&trace.least_n)
    {
        text.push_str(&format!("{t:.3},{n:.4},{a:.4},{least:.4}\n"));
    }
    text
}
