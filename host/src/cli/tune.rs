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
use crate::run::{Alone, RunError, watch_for_interrupts};
use crate::tension::rig::Rig;
use crate::tension::tune::{
    Answer, Identified, LEAST, Margins, check_gains, excitation, excite, identify,
};
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
    /// The fitted model; none of a law with a speed as its output.
    identified: Option<Identified>,
    before: TensionLaw,
    before_margins: Option<Margins>,
    proposed: TensionLaw,
    margins: Option<Margins>,
    before_rms_n: f64,
    after_rms_n: f64,
    before_ringing_n: f64,
    after_ringing_n: f64,
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
        let asked = self.asked(&robot.tension)?;
        watch_for_interrupts().map_err(Failed::from_error("watching for Ctrl-C"))?;
        let cable = model.holding().first_by_tension().ok_or_else(|| {
            Failed::from_error("tune tension")(format!(
                "{} holds every cable by its length: there is no tension loop to tune",
                robot.name
            ))
        })?;
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
        let identified = match robot.tension.output {
            TensionOutput::Current if model.holding().hangs() => {
                let _alone = Alone::begin();
                Some(identify(&robot, cable, winch, &before)?)
            }
            // The model is that of a platform that swings on lengths: elsewhere the robot itself is searched.
            TensionOutput::Current | TensionOutput::Velocity => None,
        };
        let judged = |law: &TensionLaw| {
            let found = identified.as_ref();
            found
                .map(|found| found.margins(law, damping_time_s))
                .transpose()
        };
        let (proposed, margins, after) = match asked {
            Some(law) => {
                let margins = judged(&law)?;
                let after = tries.answer(law, "try-1")?;
                (law, margins, after)
            }
            None => {
                let best = match &identified {
                    Some(identified) => tries.by_model(identified, damping_time_s, &before)?,
                    None => tries.by_search(&before)?,
                };
                best.unwrap_or_else(|| {
                    (
                        robot.tension,
                        judged(&robot.tension).ok().flatten(),
                        before.clone(),
                    )
                })
            }
        };
        let before_margins = judged(&robot.tension).ok().flatten();
        folder
            .plot(
                "step",
                &picture(&robot.name, &before, &after),
                common.plots(),
            )
            .into_diagnostic()?;
        let document = Document {
            identified,
            before: robot.tension,
            before_margins,
            proposed,
            margins,
            before_rms_n: before.rms_n(),
            after_rms_n: after.rms_n(),
            before_ringing_n: before.ringing_n(),
            after_ringing_n: after.ringing_n(),
            keep: !is_better(&after, &before, &before),
            simulated: common.on == "sim",
            run_folder: folder.path().display().to_string(),
        };
        folder
            .write_json("tune.json", &document)
            .into_diagnostic()?;
        if common.json {
            return print_json(&document);
        }
        document.print(common.plots().ending());
        Ok(())
    }
}

impl Tension {
    /// The law with the gains of `--gains`, if they were given.
    fn asked(&self, own: &TensionLaw) -> Result<Option<TensionLaw>, miette::Report> {
        let law = match self.gains.as_deref() {
            None => return Ok(None),
            Some(&[kp, ki, damping_ns_per_m]) => TensionLaw {
                kp,
                ki,
                damping_ns_per_m,
                ..*own
            },
            Some(other) => {
                let why = format!("{} values; give three: kp,ki,damping_ns_per_m", other.len());
                return Err(Failed::from_error("--gains")(why).into());
            }
        };
        check_gains(&law)?;
        Ok(Some(law))
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

/// Gains with their margins on the model, if there is one, and the response to them.
type Tried = (TensionLaw, Option<Margins>, Answer);

impl Tries<'_> {
    /// Gains with increasing margins on the model, each tested on the robot, because the model is never exact.
    /// Returns those that follow the steps best, if they are better than those of the robot file.
    fn by_model(
        &self,
        identified: &Identified,
        damping_time_s: f64,
        before: &Answer,
    ) -> Result<Option<Tried>, miette::Report> {
        let (mut best, mut tried, mut failed) = (None, false, None);
        for (factor, name) in [(1.0, "try-1"), (1.6, "try-2"), (2.5, "try-3")] {
            let least = Margins {
                gain: LEAST.gain * factor,
                delay_s: LEAST.delay_s * factor,
            };
            let law = &self.robot.tension;
            let alone = Alone::begin();
            let proposed = identified.propose(law, damping_time_s, &least);
            drop(alone);
            let (law, margins) = match proposed {
                Ok(proposed) => proposed,
                Err(error) => {
                    failed.get_or_insert_with(|| miette::Report::from(error));
                    break;
                }
            };
            tried |= self.try_one((law, Some(margins)), name, before, &mut best, &mut failed)?;
        }
        // If the model's optimum is too much for the machine: go in steps from the gains that work.
        for (factor, name) in [(4.0, "try-4"), (2.0, "try-5")] {
            if best.is_some() {
                break;
            }
            let law = TensionLaw {
                ki: self.robot.tension.ki * factor,
                ..self.robot.tension
            };
            if let Ok(margins) = identified.margins(&law, damping_time_s) {
                tried |=
                    self.try_one((law, Some(margins)), name, before, &mut best, &mut failed)?;
            }
        }
        // Where nothing could be tried there is a reason.
        failed.filter(|_| !tried).map_or(Ok(best), Err)
    }

    /// Gains of a law that commands a speed, and of a platform that is held on all sides: there is no model of the
    /// drive's own loop, nor of that platform, so that the robot itself is searched, from the file's gains on. Gains that are proposed were also tested at [`SPARE`] times.
    fn by_search(&self, before: &Answer) -> Result<Option<Tried>, miette::Report> {
        let (mut best, mut failed) = (None, None);
        let from = self.robot.tension;
        for (number, factor) in (1..).zip([0.5, 0.7, 1.4, 2.0, 2.8]) {
            let scaled = |by: f64| TensionLaw {
                kp: from.kp * by,
                ki: from.ki * by,
                ..from
            };
            let mut found: Option<Tried> = None;
            let name = format!("try-{number}");
            self.try_one(
                (scaled(factor), None),
                &name,
                before,
                &mut found,
                &mut failed,
            )?;
            let Some(found) = found else { continue };
            let spare = match self.answer(scaled(factor * SPARE), &format!("{name}-spare")) {
                Ok(spare) => spare.ringing_n() <= SPARE * before.ringing_n(),
                Err(error) if is_fault(&error) => false,
                Err(error) => return Err(error),
            };
            let rival = best.as_ref().map_or(before, |(.., best): &Tried| best);
            if spare && is_better(&found.2, rival, before) {
                best = Some(found);
            }
        }
        Ok(best)
    }

    /// Tests these gains on the robot, and keeps them if they are better than the best so far, and than those
    /// before. A fault is a result as well: the gains are not usable. Returns whether the robot took them.
    fn try_one(
        &self,
        (law, margins): (TensionLaw, Option<Margins>),
        name: &str,
        before: &Answer,
        best: &mut Option<Tried>,
        failed: &mut Option<miette::Report>,
    ) -> Result<bool, miette::Report> {
        match self.answer(law, name) {
            Ok(after) => {
                let rival = best.as_ref().map_or(before, |(.., best)| best);
                if is_better(&after, rival, before) {
                    *best = Some((law, margins, after));
                }
                Ok(true)
            }
            Err(error) if is_fault(&error) => {
                failed.get_or_insert(error);
                Ok(false)
            }
            Err(error) => Err(error),
        }
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

/// Proposed gains follow the steps with this share of the error at most: less is not worth a change.
const LESS_ERROR: f64 = 0.95;

/// A gain margin below this is too little: 6 dB.
const LEAST_MARGIN: f64 = 2.0;

/// Gains that were found without a model must also work at so many times their value.
const SPARE: f64 = 1.5;

/// Whether gains follow their steps better than a rival, and ring no more than those before.
fn is_better(after: &Answer, rival: &Answer, before: &Answer) -> bool {
    after.rms_n() < LESS_ERROR * rival.rms_n() && after.ringing_n() <= before.ringing_n()
}

fn is_fault(error: &miette::Report) -> bool {
    matches!(error.downcast_ref(), Some(RunError::Fault { .. }))
}

fn picture(name: &str, before: &Answer, after: &Answer) -> Figure {
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
    Figure::new(title, 1, [chart])
}

impl Document {
    /// For a reader, with the ending of the plot.
    fn print(&self, plot: &str) {
        let row = |name: &str, cells: &[String]| {
            std::iter::once(name.to_owned())
                .chain(cells.iter().cloned())
                .collect::<Vec<_>>()
        };
        if let Some(found) = &self.identified {
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
        }
        let both = |a: f64, b: f64| [format!("{a:.2}"), format!("{b:.2}")];
        let margin = |of: fn(&Margins) -> f64, unit: f64| {
            let unknown = if self.identified.is_some() {
                "unstable"
            } else {
                "no model"
            };
            [&self.before_margins, &self.margins].map(|margins| {
                let words = margins.as_ref().map(|m| format!("{:.1}", of(m) * unit));
                words.unwrap_or_else(|| unknown.to_owned())
            })
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
            row(
                "ringing while the set-point rests, rms, N",
                &[self.before_ringing_n, self.after_ringing_n].map(|n| format!("{n:.3}")),
            ),
        ]));
        let kept = self.keep.then_some(self.before_margins).flatten();
        if let Some(margins) = kept.filter(|margins| margins.gain < LEAST_MARGIN) {
            say!(
                "warning: the gain margin of these gains is {:.1}, less than {LEAST_MARGIN}: elsewhere in the work space the loop \
                 may shake; a smaller kp has more (`mcdpr config check` tries a motion)",
                margins.gain
            );
        }
        if self.keep {
            say!(
                "nothing was changed: keep the gains of the robot file: no others follow the steps better without \
                 more ringing; {}/step.{plot} shows both",
                self.run_folder
            );
            return;
        }
        say!(
            "nothing was changed: put the gains into [tension] of the robot file; {}/step.{plot} shows \
             the steps",
            self.run_folder
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A response that is off by `off_n` and rings with this amplitude.
    fn response(off_n: f64, rings_n: f64) -> Answer {
        let wave = |k: u32| rings_n * (f64::from(k) * 0.6).sin();
        Answer {
            asked_n: vec![10.0; 1000],
            measured_n: (0..1000).map(|k| 10.0 + off_n + wave(k)).collect(),
        }
    }

    #[test]
    fn only_less_error_without_more_ringing_is_better() {
        let before = response(1.0, 0.1);
        let better = |after: &Answer| is_better(after, &before, &before);
        assert!(better(&response(0.9, 0.1)) && better(&response(0.5, 0.05)));
        assert!(!better(&response(0.97, 0.1)), "hardly less error");
        assert!(!better(&response(0.5, 0.11)), "more ringing");
        assert!(!better(&before));
    }
}
