//! `mcdpr calibrate`: the robot's parameters from measurements.

mod all;
mod plan;
mod study;

use super::{Common, Outcome};
use clap::Subcommand;

/// Find the robot's parameters from cable lengths, tensions and pictures of tags
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    All(all::Cmd),
    Plan(plan::Cmd),
    Study(study::Cmd),
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        match &self.what {
            What::All(cmd) => cmd.run(common),
            What::Plan(cmd) => cmd.run(common),
            What::Study(cmd) => cmd.run(common),
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
