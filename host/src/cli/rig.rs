//! `mcdpr rig`: spools and attaches cables, tensions them evenly, lowers the platform.

use super::recorded::{Work, on_record};
use super::{Common, Failed, Outcome, print_json};
use crate::experiment::SimulatedRobot;
use crate::link::{ClientError, Link, SerialLink, SimulatedLink, plant_failed};
use crate::machine::{self, Mismatch};
use crate::motion::Model;
use crate::record::Doing;
use crate::robot::Robot;
use crate::run::{RunError, watch_for_interrupts};
use crate::tension::rig::{Rig, TAKEN_UP_N, lowered, rigged, winding};
use mcdpr_protocol::SessionId;
use mcdpr_simulator::LinkOptions;
use mcdpr_simulator::plant::{Plant, PlantError};
use miette::Diagnostic;
use std::io::{BufRead as _, IsTerminal as _, Write as _};

/// Put cables on a robot: spool, attach, tension evenly, lower; slow, monitored, each step
/// confirmed
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    #[command(subcommand)]
    what: What,
    /// Do every step without asking
    #[arg(long, global = true)]
    yes: bool,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    /// Wind a free cable onto its drum (negative length) or off it
    #[command(allow_negative_numbers = true)]
    Spool {
        /// Number of the cable, from 1
        cable: usize,
        /// Length, mm, paid out positive
        length_mm: f64,
    },
    /// Take up the slack of a cable that was just hooked into the platform, check that its own
    /// sensor measures it, and slacken it again
    Attach {
        /// Number of the cable, from 1
        cable: usize,
    },
    /// Take up the slack of all cables evenly and tension them until the robot hangs
    Tension,
    /// Lower a hanging robot onto its stand, until all cables are slack
    Lower,
}

/// Errors while rigging, beyond those of a run.
#[derive(Debug, thiserror::Error, Diagnostic)]
enum RigError {
    #[error("stopped before \"{step}\": nothing moves, the brakes are closed")]
    #[diagnostic(
        code(mcdpr::rig::stopped),
        help(
            "start again where you stopped: rig tension goes up, rig lower goes down; --yes asks nothing"
        )
    )]
    NotConfirmed { step: String },
    #[error("cable {cable} is still slack, {tension_n:.2} N")]
    #[diagnostic(
        code(mcdpr::rig::slack),
        help(
            "see that the cable is on and runs free, wind it by hand or with `mcdpr rig spool`, then start again"
        )
    )]
    Slack { cable: usize, tension_n: f64 },
    #[error("cable {cable} was pulled and channel {other} felt it, {tension_n:.2} N")]
    #[diagnostic(
        code(mcdpr::rig::crossed),
        help(
            "the wires of two tension sensors are swapped, or another winch turns: see docs/wiring.md"
        )
    )]
    Crossed {
        cable: usize,
        other: usize,
        tension_n: f64,
    },
    #[error("{what}")]
    #[diagnostic(code(mcdpr::rig::range))]
    Range { what: String },
    #[error("{robot} has {boards} boards: cables are put on one board at a time")]
    #[diagnostic(
        code(mcdpr::rig::boards),
        help(
            "connect to one board alone, with a robot file of its modules (docs/robot-file.md, [[board]])"
        )
    )]
    Boards { robot: String, boards: usize },
}

/// The line to the robot, and the session to open on it.
struct Line<'l> {
    link: Box<dyn Link + 'l>,
    session: SessionId,
}

/// The action, and the tensions after it, N.
struct Done {
    what: String,
    tensions_n: Vec<f64>,
}

impl Done {
    fn new(what: &str, tensions_n: Vec<f64>) -> Self {
        Self {
            what: what.to_owned(),
            tensions_n,
        }
    }
}

/// Slackness of the cables of a simulated robot.
#[derive(Debug, Clone, Copy)]
enum Slack {
    /// On, and too long.
    Long,
    /// The same, with the end of one cable (from 0) free.
    Free(usize),
}

/// Time for taking up slack: this many stretches of a second and a half.
const STRETCHES: usize = 20;
/// Speed of winding a free cable, m/s.
const WIND_MPS: f64 = 0.02;
/// Longest piece wound at once, mm.
const LONGEST_MM: f64 = 1000.0;

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let robot = crate::robot::find(&common.robot)?;
        if robot.boards.len() > 1 {
            let (robot, boards) = (robot.name, robot.boards.len());
            return Err(RigError::Boards { robot, boards }.into());
        }
        let model = Model::new(&robot)?;
        watch_for_interrupts().map_err(Failed::from_error("watching for Ctrl-C"))?;
        let slack = vec![0.0; robot.cables.len()];
        match self.what {
            What::Spool { cable, length_mm } => {
                known(&robot, cable)?;
                if length_mm.is_nan() || length_mm.abs() > LONGEST_MM {
                    let what = format!("{length_mm} mm is more than {LONGEST_MM} mm at once");
                    return Err(RigError::Range { what }.into());
                }
                let start = (&slack[..], Some(Slack::Free(cable - 1)));
                self.on(common, &model, "rig-spool", start, |line| {
                    self.spool(&model, line, cable - 1, length_mm)
                })
            }
            What::Attach { cable } => {
                known(&robot, cable)?;
                let start = (&slack[..], Some(Slack::Long));
                self.on(common, &model, "rig-attach", start, |line| {
                    self.attach(&model, line, cable - 1)
                })
            }
            What::Tension => {
                let start = (&slack[..], Some(Slack::Long));
                self.on(common, &model, "rig-tension", start, |line| {
                    self.tension(&model, line)
                })
            }
            What::Lower => {
                let home = model.rest_at_home()?;
                let tensions = home.tensions_n();
                self.on(common, &model, "rig-lower", (tensions, None), |line| {
                    self.lower(&model, line, tensions)
                })
            }
        }
    }

    /// Runs an action on the robot, with a record, and reports it. The simulated robot has these
    /// tensions, or its cables are slack as given.
    fn on(
        &self,
        common: &Common,
        model: &Model,
        name: &str,
        (tensions_n, slack): (&[f64], Option<Slack>),
        work: impl FnOnce(Line<'_>) -> miette::Result<Done>,
    ) -> Outcome {
        let about = Work::new(name, Doing::Hands, Mismatch::default(), model);
        let (done, folder) = on_record(common, &about, |record| {
            let line = if common.on == "sim" {
                record.simulated(self.simulated(model, common, tensions_n, slack)?)
            } else {
                record.line(port(common)?)
            };
            work(Line {
                link: line,
                session: record.session,
            })
        })?;
        let folder = folder.path().display();
        if common.json {
            return print_json(&serde_json::json!({
                "done": done.what,
                "tensions_n": done.tensions_n,
                "simulated": common.on == "sim",
                "run_folder": folder.to_string(),
            }));
        }
        if done.tensions_n.is_empty() {
            say!("{}", done.what);
        } else {
            say!("{}: {}", done.what, words(&done.tensions_n));
        }
        say!("run folder: {folder}");
        Ok(())
    }

    /// The simulated robot on a stand at home: hanging, or with its cables 15 to 30 mm too long.
    fn simulated(
        &self,
        model: &Model,
        common: &Common,
        tensions_n: &[f64],
        slack: Option<Slack>,
    ) -> Result<SimulatedLink, RunError> {
        let broken = |error: PlantError| RunError::Client(plant_failed(error).into());
        let Some(slack) = slack else {
            let link = SimulatedRobot::new(Mismatch::default(), common.seed)
                .controller(&common.controller)
                .at_home(model)?;
            link.with(|s| s.plant_mut().touch_stand());
            return Ok(link);
        };
        let params = machine::plant_params(model.robot(), &Mismatch::default(), common.seed);
        let mut plant = Plant::new(params, common.seed).map_err(broken)?;
        let pose = model.rest_at_home()?.equilibrium.pose;
        let matrix = pose.rotation.matrix();
        let rotation = [0, 1, 2].map(|row| [0, 1, 2].map(|column| matrix[(row, column)]));
        let at = mcdpr_simulator::plant::Pose::from_matrix(pose.position_m.into(), &rotation)
            .map_err(broken)?;
        plant.place_at(&at, tensions_n).map_err(broken)?;
        plant.set_stand(true);
        for cable in 0..model.robot().cables.len() {
            #[expect(clippy::cast_precision_loss, reason = "a small count")]
            // Each cable has another slack, so that one is taut before the others.
            let longer_m = 0.015 + 0.005 * cable as f64;
            plant.slip_cable(cable, longer_m).map_err(broken)?;
        }
        if let Slack::Free(cable) = slack {
            // A free end is simulated as a broken cable: neither pulls.
            plant.break_cable(cable).map_err(broken)?;
        }
        let options = LinkOptions::default();
        let line = machine::line_to(
            model.robot(),
            plant,
            &options,
            common.seed,
            &common.controller,
        );
        line.map_err(|error| RunError::Client(error.into()))
    }

    fn spool(
        &self,
        model: &Model,
        line: Line<'_>,
        cable: usize,
        length_mm: f64,
    ) -> miette::Result<Done> {
        let robot = winding(model.robot(), cable);
        let speed = winch_speed(&robot, cable).min(WIND_MPS);
        self.confirm(&format!(
            "wind cable {} {length_mm} mm {} at {:.0} mm/s; its end is free, fingers are away",
            cable + 1,
            if length_mm < 0.0 { "in" } else { "out" },
            speed * 1e3
        ))?;
        let count = robot.cables.len();
        // Approximate: the length on the drum is counted only from here on.
        let lengths: Vec<f64> = model.rest_at_home()?.paid_out_m;
        let mut rig = Rig::start(&robot, line.link, line.session, &lengths, &vec![0.0; count])?;
        rig.wind(cable, length_mm * 1e-3, speed)?;
        rig.finish()?;
        Ok(Done::new("wound; the brakes are closed", Vec::new()))
    }

    fn attach(&self, model: &Model, line: Line<'_>, cable: usize) -> miette::Result<Done> {
        self.confirm(&format!(
            "the platform stands on its stand at home, cable {} runs over its pulleys and is hooked \
             in, slack: arm and take it up",
            cable + 1
        ))?;
        let lengths: Vec<f64> = model.rest_at_home()?.paid_out_m;
        let slack = vec![0.0; lengths.len()];
        let mut rig = Rig::start(
            &rigged(model.robot()),
            line.link,
            line.session,
            &lengths,
            &slack,
        )?;
        let now = rig.take_up(Some(cable), STRETCHES, |now| eprintln!("  {}", words(now)))?;
        rig.tension(&slack)?;
        rig.finish()?;
        felt(cable, &now)?;
        let what = format!(
            "cable {} is on, its own sensor felt it; it is slack again, the brakes are closed",
            cable + 1
        );
        Ok(Done::new(&what, now))
    }

    fn tension(&self, model: &Model, line: Line<'_>) -> miette::Result<Done> {
        let home = model.rest_at_home()?;
        let goal = home.tensions_n().to_vec();
        self.confirm(
            "the platform stands on its stand at home, every cable is on and slack: arm and take \
             up the slack",
        )?;
        let slack = vec![0.0; goal.len()];
        let mut rig = Rig::start(
            &rigged(model.robot()),
            line.link,
            line.session,
            &home.paid_out_m,
            &slack,
        )?;
        let now = rig.take_up(None, STRETCHES, |now| eprintln!("  {}", words(now)))?;
        if let Some((index, &tension_n)) =
            now.iter().enumerate().find(|(_, n)| **n < 0.5 * TAKEN_UP_N)
        {
            rig.finish()?;
            return Err(RigError::Slack {
                cable: index + 1,
                tension_n,
            }
            .into());
        }
        eprintln!("every cable is taken up: {}", words(&now));
        let step = format!("raise all tensions together to {}", words(&goal));
        // Down again before the brakes close: a refused step must not leave it half tensioned.
        if let Err(error) = self.confirm(&step) {
            rig.tension(&slack)?;
            rig.finish()?;
            return Err(error.into());
        }
        let now = rig.tension(&goal)?;
        rig.finish()?;
        Ok(Done::new("the robot hangs, the brakes are closed", now))
    }

    fn lower(&self, model: &Model, line: Line<'_>, tensions_n: &[f64]) -> miette::Result<Done> {
        self.confirm("the stand is under the platform, which hangs at home: arm and let it down")?;
        let home = model.rest_at_home()?;
        let mut rig = Rig::start(
            &lowered(model.robot()),
            line.link,
            line.session,
            &home.paid_out_m,
            tensions_n,
        )?;
        let low = vec![TAKEN_UP_N; tensions_n.len()];
        let now = rig.tension(&low)?;
        eprintln!("the stand carries: {}", words(&now));
        if let Err(error) = self.confirm("let all cables go slack") {
            rig.finish()?;
            return Err(error.into());
        }
        let now = rig.tension(&vec![0.0; tensions_n.len()])?;
        rig.finish()?;
        Ok(Done::new(
            "the cables are slack, the brakes are closed",
            now,
        ))
    }

    /// Asks whether the next step may be done; no answer means no.
    fn confirm(&self, step: &str) -> Result<(), RigError> {
        if self.yes {
            eprintln!("{step}");
            return Ok(());
        }
        eprint!("{step}? [y/N] ");
        let _ = std::io::stderr().flush();
        let mut answer = String::new();
        let read = std::io::stdin().lock().read_line(&mut answer);
        if !std::io::stdin().is_terminal() {
            // A terminal shows the end of the line that was typed.
            eprintln!();
        }
        if read.is_ok() && matches!(answer.trim(), "y" | "Y" | "yes") {
            return Ok(());
        }
        Err(RigError::NotConfirmed {
            step: step.to_owned(),
        })
    }
}

fn known(robot: &Robot, cable: usize) -> Result<(), RigError> {
    if (1..=robot.cables.len()).contains(&cable) {
        return Ok(());
    }
    let what = format!("there is no cable {cable} of {}", robot.cables.len());
    Err(RigError::Range { what })
}

/// Checks that the sensor of the one cable (from 0) that was taken up measured it.
fn felt(cable: usize, tensions_n: &[f64]) -> Result<(), RigError> {
    let pulled = |n: f64| n > 0.5 * TAKEN_UP_N;
    let mut others = tensions_n.iter().enumerate();
    if let Some((other, &tension_n)) = others.find(|&(other, &n)| other != cable && pulled(n)) {
        return Err(RigError::Crossed {
            cable: cable + 1,
            other: other + 1,
            tension_n,
        });
    }
    let tension_n = tensions_n.get(cable).copied().unwrap_or(0.0);
    if pulled(tension_n) {
        return Ok(());
    }
    Err(RigError::Slack {
        cable: cable + 1,
        tension_n,
    })
}

fn winch_speed(robot: &Robot, cable: usize) -> f64 {
    robot
        .winch_of(cable)
        .map_or(WIND_MPS, |winch| 0.4 * winch.max_cable_speed_mps())
}

fn words(tensions_n: &[f64]) -> String {
    let each: Vec<_> = tensions_n.iter().map(|n| format!("{n:.1}")).collect();
    format!("{} N", each.join(", "))
}

fn port(common: &Common) -> Result<SerialLink, RunError> {
    common
        .open_one_port()
        .map_err(|error| RunError::from(ClientError::from(error)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pull_that_its_own_sensor_does_not_feel_is_named() {
        assert!(felt(1, &[0.1, 1.0, -0.1, 0.0]).is_ok());
        assert!(matches!(
            felt(1, &[0.1, 0.2, 0.0, 0.0]),
            Err(RigError::Slack { cable: 2, .. })
        ));
        assert!(matches!(
            felt(1, &[0.1, 0.0, 0.9, 0.0]),
            Err(RigError::Crossed {
                cable: 2,
                other: 3,
                ..
            })
        ));
    }
}
