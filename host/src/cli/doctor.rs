//! `mcdpr doctor`: checks all parts, and says what to do about a failed one.

use super::service::Machine;
use super::{Common, Failed, Outcome, print_json};
use crate::doctor::{self, Finding, Verdict};
use crate::experiment::SimulatedRobot;
use crate::link::{Client, ClientError, Link, SimulatedLink};
use crate::machine::Mismatch;
use crate::motion::Model;
use crate::robot::Robot;
use crate::run::{self, Homing, LengthFiles, RunError, Session, new_session, watch_for_interrupts};
use mcdpr_protocol::Request;

/// Check port, board, firmware, drives, encoders, tensions and brakes; say what to do
///
/// Nothing moves and no drive gets torque, unless --arm is given
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// Then arm the hanging robot and disarm it again: the board tests every drive, brake and
    /// encoder by itself
    #[arg(long)]
    arm: bool,
    #[command(flatten)]
    machine: Machine,
}

/// The state after a loss of power, by the board's journal.
fn power<L: Link>(client: &mut Client<L>, robot: &Robot) -> miette::Result<Option<Finding>> {
    if run::status(client)?.referenced {
        return Ok(None);
    }
    let sentence = crate::recovery::after_cut(client, robot)?;
    Ok(sentence.map(|sentence| {
        let next = "`mcdpr recover --on PORT`";
        Finding::with(Verdict::Note, "power", sentence, next)
    }))
}

/// What runs did to cables, drums and brakes.
fn wear(robot: &Robot) -> Option<Finding> {
    match crate::care::load(robot) {
        Ok(wear) => {
            let sentence = crate::care::sentence(&wear)?;
            let used = wear.cables.iter().filter_map(|cable| cable.used());
            if used.fold(0.0, f64::max) < WORN {
                return Some(Finding::good("care", sentence));
            }
            let next = "replace that cable, then `mcdpr care --renewed CABLE`";
            Some(Finding::with(Verdict::Note, "care", sentence, next))
        }
        Err(error) => Some(Finding::with(
            Verdict::Note,
            "care",
            error.to_string(),
            "move that file away: wear is counted anew",
        )),
    }
}

/// Share of a life from which on a cable is to be replaced: half of all cables of steel break at its end, and
/// their lives scatter by a factor of two.
const WORN: f64 = 0.5;

/// The simulated robot behind the line, if there is one.
type Opened = (Box<dyn Link>, Option<SimulatedLink>);

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        if common.dry_run && self.arm {
            return Err(super::dry::refusal("doctor --arm").into());
        }
        watch_for_interrupts().map_err(Failed::from_error("watching for Ctrl-C"))?;
        let robot = common.robot()?;
        let mut findings = vec![Finding::good(
            "program",
            format!(
                "mcdpr {}, robot {} with {} cables",
                env!("CARGO_PKG_VERSION"),
                robot.name,
                robot.cables.len()
            ),
        )];
        self.look(common, &robot, &mut findings)?;
        findings.extend(wear(&robot));
        if common.json {
            print_json(&serde_json::json!({
                "healthy": doctor::is_healthy(&findings),
                "simulated": common.on == "sim",
                "findings": findings,
            }))?;
        } else {
            for finding in &findings {
                print_finding(finding);
            }
        }
        let bad = findings
            .iter()
            .filter(|f| f.verdict == Verdict::Bad)
            .count();
        match bad {
            0 => Ok(()),
            1 => Err(Failed::from_error("doctor")("one part must be repaired first").into()),
            _ => Err(
                Failed::from_error("doctor")(format!("{bad} parts must be repaired first")).into(),
            ),
        }
    }

    /// Port, then board, then everything behind it; an unreachable part ends the check.
    fn look(&self, common: &Common, robot: &Robot, findings: &mut Vec<Finding>) -> Outcome {
        let (link, simulated) = match self.open(common, robot)? {
            Ok(opened) => opened,
            Err(error) => {
                findings.push(doctor::refused("port", &error));
                return Ok(());
            }
        };
        findings.push(Finding::good(
            "port",
            match (&simulated, common.controller.firmware()) {
                _ if common.controller.wires().is_some() => {
                    "a simulated robot with a board in the loop".into()
                }
                (Some(_), Some(_)) => {
                    "a simulated robot with the firmware on an emulated chip".into()
                }
                (Some(_), None) => "a simulated robot in this process".into(),
                (None, _) => format!("{} opened, for this program alone", common.on),
            },
        ));
        let mut client = match Client::connect(link, new_session()) {
            Ok(client) => client,
            Err(error) => {
                findings.push(doctor::refused("board", &error));
                return Ok(());
            }
        };
        match doctor::examine(&mut client, robot) {
            Ok(found) => {
                findings.extend(found);
                if simulated.is_none() {
                    findings.extend(power(&mut client, robot)?);
                }
            }
            Err(error) => findings.push(doctor::refused("line", &error)),
        }
        if client.request(Request::Close).is_err() || !self.arm {
            return Ok(());
        }
        if !doctor::is_healthy(findings) {
            findings.push(Finding::with(
                Verdict::Unseen,
                "arming",
                "not tried",
                "repair what is named above first",
            ));
            return Ok(());
        }
        let model = Model::new(robot)?;
        // The program has placed the simulated robot itself; for a board, the saved lengths are
        // used.
        let homing = match simulated {
            Some(_) => Homing::Place(robot.tool.home_in_world_m),
            None => Homing::Known,
        };
        findings.push(arm(client.into_link(), &model, homing));
        Ok(())
    }

    fn open(&self, common: &Common, robot: &Robot) -> miette::Result<Result<Opened, ClientError>> {
        if common.on != "sim" {
            let link = common.open_port().map_err(ClientError::from);
            return Ok(link.map(|link| -> Opened { (Box::new(link), None) }));
        }
        let real = self.machine.really(robot)?;
        let link = SimulatedRobot::new(Mismatch::realistic(), common.seed)
            .controller(&common.controller)
            .at_home(&Model::new(&real)?)?;
        Ok(Ok((Box::new(link.clone()), Some(link))))
    }
}

/// Lets the board arm, which tests every part, and disarms it.
fn arm(link: Box<dyn Link>, model: &Model, homing: Homing<'_>) -> Finding {
    let handle = crate::control::Handle::new();
    let armed = Session::open(model, link, new_session(), &handle, homing, &LengthFiles).and_then(
        |mut session| {
            session.arm()?;
            session.disarm()
        },
    );
    handle.close("the command has ended");
    match armed {
        Ok(()) => Finding::good(
            "arming",
            "every drive came up, every brake held its drive and opened, every drum turned as its motor did; brakes closed again",
        ),
        Err(RunError::Fault { record, .. }) => doctor::arming_fault(&record),
        Err(error @ RunError::NotHomed { .. }) => Finding {
            verdict: Verdict::Unseen,
            ..doctor::refused("arming", &error)
        },
        Err(error) => doctor::refused("arming", &error),
    }
}

/// Prints a finding, and below it the remedy.
pub(super) fn print_finding(finding: &Finding) {
    let mark = match finding.verdict {
        Verdict::Good => "ok  ",
        Verdict::Note => "note",
        Verdict::Bad => "BAD ",
        Verdict::Unseen => "-   ",
    };
    let part = match finding.cable {
        Some(cable) => format!("{} {cable}", finding.part),
        None => finding.part.to_owned(),
    };
    say!("{mark}  {part:<14} {}", finding.found);
    if let Some(remedy) = &finding.remedy {
        say!("                     -> {remedy}");
    }
}
