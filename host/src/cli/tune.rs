//! `mcdpr tune tension`: gains for the tension loop of a robot.

use super::recorded::{Work, on_record};
use super::table::lay_out;
use super::{Common, Failed, Outcome, print_json};
use crate::chart::{Chart, Curve, Figure};
use crate::experiment::SimulatedRobot;
use crate::link::ClientError;
use crate::machine::Mismatch;
use crate::motion::Model;
use crate::record::Doing;
use crate::report::RunFolder;
use crate::robot::{Robot, TensionLaw, TensionOutput};
use crate::run::{RunError, watch_for_interrupts};
use crate::tension::rig::Rig;
use crate::tension::tune::{Answer, Identified, LEAST, Margins, excitation, excite, identify};
use miette::IntoDiagnostic as _;
use serde::Serialize;

/// Find good gains: the robot holds, steps its set-point, and a model is fitted to the response
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    /// The loop of the tension-held cable
    Tension(Tension),
}

#[derive(Debug, clap::Args)]
struct Tension {
    /// Height of the steps, N
    #[arg(long, value_name = "N", default_value_t = 2.0)]
    step_n: f64,
    /// Judge these gains instead of a proposal: kp,ki,damping_ns_per_m
    #[arg(
        long,
        value_name = "KP,KI,D",
        value_delimiter = ',',
        allow_hyphen_values = true
    )]
    gains: Option<Vec<f64>>,
}

#[derive(Debug, Serialize)]
struct Document {
    identified: Identified,
    before: TensionLaw,
    before_margins: Option<Margins>,
    proposed: TensionLaw,
    margins: Margins,
    before_rms_n: f64,
    after_rms_n: f64,
    /// Whether the gains of the file are no worse on the machine.
    keep: bool,
    simulated: bool,
    run_folder: String,
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let What::Tension(tension) = &self.what;
        tension.run(common)
    }
}

impl Tension {
    fn run(&self, common: &Common) -> Outcome {
        let robot = crate::robot::find(&common.robot)?;
        if robot.tension.output == TensionOutput::Velocity {
            let why = "its gains are speeds per tension, and the model that tuning fits is that of a force: \
                       judge them with `mcdpr experiment` and `mcdpr study winch`";
            return Err(Failed::from_error("a law with `output = \"velocity\"`")(why).into());
        }
        let model = Model::new(&robot)?;
        // A step up and one down of this height must both stay within floor and ceiling.
        let room = robot.tension.setpoint_n - robot.tension.floor_n;
        let room = room.min(robot.tension.ceiling_n - robot.tension.setpoint_n);
        if !(self.step_n > 0.0 && self.step_n <= room) {
            let why = format!(
                "{} N; it must be over 0 and at most {room:.1} N",
                self.step_n
            );
            return Err(Failed::from_error("the step is out of range")(why).into());
        }
        watch_for_interrupts().map_err(Failed::from_error("watching for Ctrl-C"))?;
        let cable = model.hanging("tuning the tension law")?;
        let missing = || Failed::from_error("the robot file")("it has no winch for this cable");
        let winch = robot.winch_of(cable).ok_or_else(missing)?;
        let damping_time_s = robot.cables.get(cable).map_or(0.0, |c| c.damping_time_s);
        let stages = excitation(robot.tension.setpoint_n, self.step_n);
        let folder =
            RunFolder::create(common.record.as_deref(), "tune-tension").into_diagnostic()?;
        let tries = Tries {
            robot: &robot,
            cable,
            stages: &stages,
            common,
            folder: &folder,
        };
        let before = tries.answer(robot.tension, "before")?;
        let identified = identify(&robot, cable, winch, &before)?;
        let (proposed, margins, after) = match self.gains.as_deref() {
            Some(&[kp, ki, damping_ns_per_m]) => {
                let law = TensionLaw {
                    kp,
                    ki,
                    damping_ns_per_m,
                    ..robot.tension
                };
                let margins = identified.margins(&law, damping_time_s)?;
                let after = tries.answer(law, "try-1")?;
                (law, margins, after)
            }
            Some(other) => {
                let why = format!("{} values; give three: kp,ki,damping_ns_per_m", other.len());
                return Err(Failed::from_error("--gains")(why).into());
            }
            None => tries.best(&identified, damping_time_s, rms(&before))?,
        };
        let before_margins = identified.margins(&robot.tension, damping_time_s).ok();
        folder
            .write("step.svg", &picture(&robot.name, &before, &after))
            .into_diagnostic()?;
        let document = Document {
            identified,
            before: robot.tension,
            before_margins,
            proposed,
            margins,
            before_rms_n: rms(&before),
            after_rms_n: rms(&after),
            keep: rms(&before) <= rms(&after),
            simulated: common.on == "sim",
            run_folder: folder.path().display().to_string(),
        };
        folder
            .write_json("tune.json", &document)
            .into_diagnostic()?;
        if common.json {
            return print_json(&document);
        }
        document.print();
        Ok(())
    }
}

/// Responses of the robot to the same steps, each with its own record.
struct Tries<'a> {
    robot: &'a Robot,
    cable: usize,
    stages: &'a [(f64, f64)],
    common: &'a Common,
    folder: &'a RunFolder,
}

impl Tries<'_> {
    /// Gains with increasing margins, each tested on the robot, because the model is never exact.
    /// Returns those that follow the steps best.
    fn best(
        &self,
        identified: &Identified,
        damping_time_s: f64,
        before_rms_n: f64,
    ) -> Result<(TensionLaw, Margins, Answer), miette::Report> {
        let mut best: Option<(TensionLaw, Margins, Answer)> = None;
        let mut failed = None;
        for (factor, name) in [(1.0, "try-1"), (1.6, "try-2"), (2.5, "try-3")] {
            let least = Margins {
                gain: LEAST.gain * factor,
                delay_s: LEAST.delay_s * factor,
            };
            let before = &self.robot.tension;
            let (law, margins) = match identified.propose(before, damping_time_s, &least) {
                Ok(proposed) => proposed,
                Err(error) => {
                    failed.get_or_insert_with(|| miette::Report::from(error));
                    break;
                }
            };
            self.try_one((law, margins), name, &mut best, &mut failed)?;
        }
        // If the model's optimum is too much for the machine: go in steps from the gains that work.
        for (factor, name) in [(4.0, "try-4"), (2.0, "try-5"), (1.0, "try-6")] {
            if best.as_ref().is_some_and(|(.., b)| rms(b) < before_rms_n) {
                break;
            }
            let law = TensionLaw {
                ki: self.robot.tension.ki * factor,
                ..self.robot.tension
            };
            if let Ok(margins) = identified.margins(&law, damping_time_s) {
                self.try_one((law, margins), name, &mut best, &mut failed)?;
            }
        }
        // The least margins give gains or an error.
        best.ok_or_else(|| failed.unwrap_or_else(|| miette::miette!("no gains were tried")))
    }

    /// Tests these gains on the robot, and keeps them if they follow better than the best so far. A
    /// fault is a result as well: the gains are not usable.
    fn try_one(
        &self,
        (law, margins): (TensionLaw, Margins),
        name: &str,
        best: &mut Option<(TensionLaw, Margins, Answer)>,
        failed: &mut Option<miette::Report>,
    ) -> Result<(), miette::Report> {
        match self.answer(law, name) {
            Ok(after) if best.as_ref().is_none_or(|(.., b)| rms(&after) < rms(b)) => {
                *best = Some((law, margins, after));
            }
            Ok(_) => {}
            Err(error) if matches!(error.downcast_ref(), Some(RunError::Fault { .. })) => {
                failed.get_or_insert(error);
            }
            Err(error) => return Err(error),
        }
        Ok(())
    }

    /// Arms the robot with these gains and measures the response; `name` is that of the record.
    fn answer(&self, law: TensionLaw, name: &str) -> miette::Result<Answer> {
        let mut tuned = self.robot.clone();
        tuned.tension = law;
        let model = Model::new(&tuned)?;
        let common = Common {
            record: Some(self.folder.path().join(name)),
            ..self.common.clone()
        };
        let mismatch = Mismatch::realistic();
        // The gains are in the recorded bytes: they are sent to the board.
        let work = Work::new("tune-tension", Doing::Orders, mismatch, &model);
        let (answer, _) = on_record(&common, &work, |record| {
            let line = if common.on == "sim" {
                let link = SimulatedRobot::new(mismatch, common.seed)
                    .controller(&common.controller)
                    .at_home(&model)?;
                record.simulated(link)
            } else {
                record.line(common.open_port().map_err(ClientError::from)?)
            };
            let home = model.rest_at_home()?;
            let (lengths_m, tensions_n) = (&home.paid_out_m, home.tensions_n());
            let mut rig = Rig::start(model.robot(), line, record.session, lengths_m, tensions_n)?;
            let answer = excite(&mut rig, self.cable, self.stages)?;
            rig.finish()?;
            Ok(answer)
        })?;
        Ok(answer)
    }
}

fn rms(answer: &Answer) -> f64 {
    let errors = answer.asked_n.iter().zip(&answer.measured_n);
    let squares: f64 = errors.map(|(a, m)| (a - m).powi(2)).sum();
    #[expect(clippy::cast_precision_loss, reason = "some thousand samples")]
    let count = answer.asked_n.len().max(1) as f64;
    (squares / count).sqrt()
}

fn picture(name: &str, before: &Answer, after: &Answer) -> String {
    let timed = |values: &[f64]| -> Vec<(f64, f64)> {
        (0_u32..)
            .zip(values)
            .map(|(tick, &n)| (f64::from(tick) * 1e-3, n))
            .collect()
    };
    let title = format!("{name}: steps of the set-point before and after");
    let chart = Chart::new("steps of the set-point", "time, s", "tension, N").with([
        Curve::new("before", 1, timed(&before.measured_n)),
        Curve::new("after", 0, timed(&after.measured_n)),
        Curve::new("set-point", 4, timed(&before.asked_n)).dashed(),
    ]);
    Figure::new(title, 1, [chart]).svg()
}

impl Document {
    fn print(&self) {
        let found = &self.identified;
        let row = |name: &str, cells: &[String]| {
            std::iter::once(name.to_owned())
                .chain(cells.iter().cloned())
                .collect::<Vec<_>>()
        };
        super::write_out(&lay_out(&[
            row("force over demand", &[format!("{:.2}", found.gain)]),
            row("delay, ms", &[format!("{:.1}", found.delay_s * 1e3)]),
            row("friction, N", &[format!("{:.2}", found.friction_n)]),
            row(
                "resonance of drum and cable, Hz",
                &[format!("{:.0}", found.resonance_hz)],
            ),
            row(
                "platform there, kg and Hz",
                &[format!("{:.1}, {:.1}", found.far_mass_kg, found.swing_hz)],
            ),
            row(
                "explained by the model, %",
                &[format!("{:.1}", found.explained * 100.0)],
            ),
        ]));
        let both = |a: f64, b: f64| [format!("{a:.2}"), format!("{b:.2}")];
        let margin = |of: fn(&Margins) -> f64, unit: f64| {
            let before = self.before_margins.as_ref();
            let before = before.map_or("unstable".to_owned(), |m| format!("{:.1}", of(m) * unit));
            [before, format!("{:.1}", of(&self.margins) * unit)]
        };
        super::write_out(&lay_out(&[
            row("", &["before".to_owned(), "after".to_owned()]),
            row("kp", &both(self.before.kp, self.proposed.kp)),
            row("ki", &both(self.before.ki, self.proposed.ki)),
            row("kd", &both(self.before.kd, self.proposed.kd)),
            row(
                "damping_ns_per_m",
                &both(self.before.damping_ns_per_m, self.proposed.damping_ns_per_m),
            ),
            row("gain margin, factor (10: more)", &margin(|m| m.gain, 1.0)),
            row("delay margin, ms (20: more)", &margin(|m| m.delay_s, 1e3)),
            row(
                "rms error over the steps, N",
                &both(self.before_rms_n, self.after_rms_n),
            ),
        ]));
        if self.keep {
            say!(
                "nothing was changed: the gains of the robot file follow the steps better, keep \
                 them; {}/step.svg shows both",
                self.run_folder
            );
            return;
        }
        say!(
            "nothing was changed: put the gains into [tension] of the robot file; {}/step.svg shows \
             the steps",
            self.run_folder
        );
    }
}
