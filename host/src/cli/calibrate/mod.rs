//! `mcdpr calibrate`: the robot's parameters from measurements.

mod all;
mod check;
pub(crate) mod collect;
mod history;
mod plan;
mod study;
mod target;
mod tension;
mod verify;
mod winch;

use super::{Common, Outcome};
use clap::Subcommand;
pub(crate) use collect::On;

/// Find the robot's parameters from cable lengths, tensions and pictures of tags
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    Collect(collect::Cmd),
    All(all::Cmd),
    Frame(all::FrameCmd),
    Camera(all::CameraCmd),
    Plan(plan::Cmd),
    Target(target::Cmd),
    Verify(verify::Cmd),
    Check(check::Cmd),
    Study(study::Cmd),
    Winch(winch::Cmd),
    History(history::Cmd),
    Tension(tension::Cmd),
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        match &self.what {
            What::Collect(cmd) => cmd.run(common),
            What::All(cmd) => cmd.run(common),
            What::Frame(cmd) => cmd.run(common),
            What::Camera(cmd) => cmd.run(common),
            What::Plan(cmd) => cmd.run(common),
            What::Target(cmd) => cmd.run(common),
            What::Check(cmd) => cmd.run(common),
            What::Verify(cmd) => cmd.run(common),
            What::Study(cmd) => cmd.run(common),
            What::Winch(cmd) => cmd.run(common),
            What::History(cmd) => cmd.run(common),
            What::Tension(cmd) => cmd.run(common),
        }
    }
}

/// The estimators.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Method {
    /// One weighted problem with priors and covariance (recommended)
    Joint,
    /// The paper's estimator, for comparison
    Paper,
}
