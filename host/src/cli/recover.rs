//! `mcdpr recover`: the robot's position after a loss of power with a bound, or the next measurement.

use super::eye::Eye;
use super::progress::Phase;
use super::{Common, Failed, Outcome, print_json};
use crate::link::{Client, ClientError};
use crate::machine::Mismatch;
use crate::motion::Model;
use crate::recovery::simulated::{Disturbance, SimulatedCut, simulate};
use crate::recovery::{Before, KnownTags, Verdict, load, load_reference, recover};
use crate::run::saved::{board_name, scale_of};
use crate::run::{ResumeError, RunError, new_session};
use crate::scenario::{Injection, When};
use mcdpr_protocol::Request;

/// After a loss of power: find the tool's position with a bound, and reference the board's lengths; or say
/// what to measure
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// Largest error of the tool's position that the job allows, mm
    #[arg(long, default_value_t = 5.0, value_name = "MM")]
    bound_mm: f64,
    /// You confirm that nobody touched drums, brakes or platform without power
    #[arg(long)]
    untouched: bool,
    /// You confirm that the computer and the robot lost their supply at the same time
    #[arg(long)]
    together: bool,
    /// Where the evidence is not enough: wind each cable by 0.4 mm, under watch, and read all tensions. Drums
    /// and platform move
    #[arg(long)]
    gentle: bool,
    #[command(flatten)]
    eye: Eye,
    /// On the simulator: the supply that fails while the robot runs --task, when and for how long
    #[arg(
        long,
        default_value = "power:all@2s/1s",
        value_name = "power:WHOSE@TIME/DURATION"
    )]
    fault: String,
    /// On the simulator: the task that is interrupted
    #[arg(long, default_value = "paper:table7", value_name = "TASK")]
    task: String,
    /// On the simulator: look at the tag on the floor
    #[arg(long)]
    tag: bool,
    /// On the simulator: the board has a battery at VBAT
    #[arg(long)]
    battery: bool,
    /// On the simulator: then continue the task (on a port: `mcdpr run TASK --resume`)
    #[arg(long)]
    resume: bool,
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        if !(self.bound_mm.is_finite() && self.bound_mm > 0.0) {
            let reason = format!("the bound is {} mm: give a length over 0", self.bound_mm);
            return Err(Failed::from_error("--bound-mm")(reason).into());
        }
        let model = Model::new(&common.robot()?)?;
        model.hanging("going on after a loss of power")?;
        let verdict = if common.on == "sim" {
            self.eye.refused_on_simulator("--camera")?;
            self.on_simulator(common, &model)?
        } else {
            self.on_port(common, &model)?
        };
        print(common, &verdict)
    }

    fn on_port(&self, common: &Common, model: &Model) -> miette::Result<Verdict> {
        if self.resume {
            let reason = "continue with `mcdpr run TASK --resume --on PORT`";
            return Err(Failed::from_error("--resume")(reason).into());
        }
        if self.tag {
            let reason = "that is the simulator's camera; name one with --camera";
            return Err(Failed::from_error("--tag")(reason).into());
        }
        if self.battery {
            let reason =
                "that is the simulator's board; a real one tells by itself whether it has one";
            return Err(Failed::from_error("--battery")(reason).into());
        }
        let mut camera = self.eye.tags(model.robot(), &common.page)?;
        let calibrated = model.robot().calibrated.as_ref();
        let places = calibrated.map_or(Vec::new(), |calibrated| calibrated.places.clone());
        let link = common.open_port().map_err(ClientError::from)?;
        let mut client = Client::connect(link, new_session()).map_err(RunError::from)?;
        let board = board_name(client.hello());
        let before = Before {
            journal: load(&board, scale_of(model.robot())),
            tags: camera.as_mut().map(|camera| KnownTags { camera, places }),
            reference: load_reference(&board),
            untouched: self.untouched,
            together: self.together,
            gentle: self.gentle,
            bound_m: self.bound_mm * 1e-3,
        };
        let verdict = recover(&mut client, model, before)?;
        client.request(Request::Close).map_err(RunError::from)?;
        Ok(verdict)
    }

    fn on_simulator(&self, common: &Common, model: &Model) -> miette::Result<Verdict> {
        let cables = model.robot().cables.len();
        let cut = Injection::parse(&self.fault, cables)?;
        let wrong = |reason: &str| Failed::from_error("--fault")(reason.to_owned());
        let supply = cut.supply.ok_or_else(|| {
            wrong("it cuts no supply: give power:board, power:drives, power:host, power:all, power:dip or power:crash")
        })?;
        let When::Motion(at_s) = cut.when else {
            return Err(wrong("give a time after the motion's start, such as 2s").into());
        };
        let height_m = super::run::tool_height_m(model.robot(), super::demo::HEIGHT_MM);
        let cut_motion = SimulatedCut {
            task: crate::motion::find_task(&self.task, height_m)?,
            mismatch: Mismatch::realistic(),
            seed: common.seed,
            supply,
            at_s,
            lasts_s: cut.lasts_s.unwrap_or(1.0),
            disturbance: Disturbance::None,
            seen_at_home: self.tag,
            battery: self.battery,
            controller: common.controller.clone(),
        };
        let phase = Phase::begin("simulating the loss of power and the recovery");
        let after = simulate(model, &cut_motion)?;
        let mut after =
            after.ok_or_else(|| wrong("the task was done before: give an earlier time"))?;
        after.gentle = self.gentle;
        // Far ahead: a journal of this very moment is never from the future.
        let now_ms = u64::MAX / 2;
        let journal = after.read(model, now_ms);
        let bound_m = self.bound_mm * 1e-3;
        let (verdict, truth_m) =
            after.recover(model, journal.clone(), self.tag, self.untouched, bound_m)?;
        drop(phase);
        if let Some(error_m) = crate::recovery::verdict::error_m(&verdict, &truth_m) {
            eprintln!(
                "simulated: the tool's true position is {:.2} mm from there",
                error_m * 1e3
            );
        }
        if self.resume && verdict.accepted {
            let journal = journal
                .map_err(ResumeError::Journal)
                .map_err(RunError::from)?;
            let run = after.resume(model, cut_motion.task, journal)?;
            let figures = run.figures(model)?;
            let error_mm = figures
                .path_error_m
                .map_or(f64::NAN, |error| error.max * 1e3);
            eprintln!(
                "resumed: {:.1} s to the task's end, the tool at most {error_mm:.2} mm from the path",
                run.plan.timed.duration_s()
            );
        }
        Ok(verdict)
    }
}

/// A refusal of a recovery.
#[derive(Debug, thiserror::Error, miette::Diagnostic)]
#[error("not recovered: {sentence}")]
#[diagnostic(code(mcdpr::recover::refused), help("{next}"))]
struct Refused {
    sentence: String,
    next: String,
}

fn print(common: &Common, verdict: &Verdict) -> Outcome {
    if common.json {
        print_json(verdict)?;
    } else if verdict.accepted {
        say!("{}", verdict.sentence);
    }
    if !common.json {
        let list = |name: &str, words: &[String]| {
            if !words.is_empty() {
                say!("{name}: {}", words.join("; "));
            }
        };
        let bounds = verdict.bound_95_mm.zip(verdict.integrity_bound_mm);
        if let Some((statistical, integrity)) = bounds {
            say!(
                "bounds: {statistical:.1} mm in 95 % of cases; {integrity:.1} mm where a drum slipped or lengths agree with a tag by chance, undetected"
            );
        }
        list("used", &verdict.used);
        list("contradicts", &verdict.contradicts);
        let out: Vec<_> = verdict
            .paid_out_mm
            .iter()
            .map(|mm| format!("{mm:.2}"))
            .collect();
        if !out.is_empty() {
            say!(
                "paid out since the last state in the journal: {} mm",
                out.join(", ")
            );
        }
    }
    if verdict.accepted {
        if !common.json {
            say!("next: {}", verdict.next);
        }
        return Ok(());
    }
    Err(Refused {
        sentence: verdict.sentence.clone(),
        next: verdict.next.clone(),
    }
    .into())
}
