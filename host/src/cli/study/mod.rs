//! `mcdpr study WHAT`: the figures of the documents, simulated again over many seeds.

mod calibrated;
mod day;
mod demo;
mod iso9283;
mod motion;
mod power;
mod real;
mod robots;
mod tension;
mod track;
mod tube;
mod winch;

use super::{Common, Failed, Outcome};

/// Simulate the studies that the documents quote, seed by seed
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    #[command(subcommand)]
    which: Which,
}

#[derive(Debug, clap::Subcommand)]
enum Which {
    Calibrated(calibrated::Cmd),
    Day(day::Cmd),
    Demo(demo::Cmd),
    Iso9283(iso9283::Cmd),
    Motion(motion::Cmd),
    Power(power::Cmd),
    Real(real::Cmd),
    Robots(robots::Cmd),
    Tension(tension::Cmd),
    Track(track::Cmd),
    Tube(tube::Cmd),
    Winch(winch::Cmd),
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        // Only losses of power are also studied on emulated chips.
        if !matches!(self.which, Which::Power(_)) {
            common.no_chip("study")?;
        }
        // Real data are no robot's, and of an industrial test there may be a tracker's file.
        let of_files = matches!(self.which, Which::Real(_) | Which::Iso9283(_));
        if common.on != "sim" && !of_files {
            let reason = "a study needs the truth, which only the simulator knows";
            return Err(Failed::from_error("--on")(reason).into());
        }
        match &self.which {
            Which::Calibrated(cmd) => cmd.run(common),
            Which::Day(cmd) => cmd.run(common),
            Which::Demo(cmd) => cmd.run(common),
            Which::Iso9283(cmd) => cmd.run(common),
            Which::Motion(cmd) => cmd.run(common),
            Which::Power(cmd) => cmd.run(common),
            Which::Real(cmd) => cmd.run(common),
            Which::Robots(cmd) => cmd.run(common),
            Which::Tension(cmd) => cmd.run(common),
            Which::Track(cmd) => cmd.run(common),
            Which::Tube(cmd) => cmd.run(common),
            Which::Winch(cmd) => cmd.run(common),
        }
    }
}
