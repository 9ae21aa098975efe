//! Shared by commands for a bare winch: the board, or a simulated machine without cables.

use super::recorded::{Work, on_record};
use super::{Common, Failed};
use crate::link::{Client, ClientError, Link, SimulatedLink, plant_failed};
use crate::machine::{self, Mismatch};
use crate::record::Doing;
use crate::report::RunFolder;
use crate::robot::Robot;
use crate::run::watch_for_interrupts;
use mcdpr_simulator::LinkOptions;

/// The machine to simulate.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct Machine {
    /// With `--on sim`: the machine is built as this robot file says, whatever --robot says of it
    #[arg(long, value_name = "FILE")]
    built: Option<String>,
}

impl Machine {
    /// The machine as really built: it differs from the robot file if requested.
    pub(crate) fn really(&self, robot: &Robot) -> miette::Result<Robot> {
        match &self.built {
            Some(name) => Ok(crate::robot::find(name)?),
            None => Ok(robot.clone()),
        }
    }
}

/// A connected board and, if it is simulated in this process, the simulation.
pub(crate) type Connected<'l> = (Client<Box<dyn Link + 'l>>, Option<SimulatedLink>);

/// Runs an action on the board, or on a simulated machine whose winches are bare; with a record.
pub(crate) fn connected<T>(
    common: &Common,
    robot: &Robot,
    machine: &Machine,
    name: &str,
    work: impl FnOnce(Connected<'_>) -> miette::Result<T>,
) -> miette::Result<(T, RunFolder)> {
    watch_for_interrupts().map_err(Failed::from_error("watching for Ctrl-C"))?;
    let mismatch = Mismatch::realistic();
    let about = Work {
        name,
        doing: Doing::Hands,
        mismatch,
        cables: robot.cables.len(),
        model: None,
        orders: None,
        plans_first: false,
    };
    on_record(common, &about, |record| {
        if common.on != "sim" {
            let line = record.line(common.open_one_port().map_err(ClientError::from)?);
            return work((Client::connect(line, record.session)?, None));
        }
        let real = machine.really(robot)?;
        let options = LinkOptions::default();
        let simulation =
            machine::simulate_unloaded(&real, &mismatch, &options, common.seed, &common.controller)
                .map_err(plant_failed)
                .map_err(ClientError::from)?;
        let link = SimulatedLink::new(simulation);
        let line = record.simulated(link.clone());
        work((Client::connect(line, record.session)?, Some(link)))
    })
}
