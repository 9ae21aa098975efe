//! What commands for a bare winch share: the board, or a simulated machine without cables.

use super::{Common, Failed};
use crate::link::{Client, Link, SimulatedLink};
use crate::machine::{self, Mismatch};
use crate::robot::Robot;
use crate::run::{new_session, watch_for_interrupts};
use mcdpr_protocol::SessionId;
use mcdpr_simulator::LinkOptions;

/// Which machine is simulated.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct Machine {
    /// With `--on sim`: simulate this machine, whatever --robot says of it
    #[arg(long, value_name = "FILE")]
    machine: Option<String>,
}

impl Machine {
    /// The machine as it was really built: another one than the robot file says, where that was
    /// asked for.
    pub(crate) fn really(&self, robot: &Robot) -> miette::Result<Robot> {
        match &self.machine {
            Some(name) => Ok(Robot::find(name)?),
            None => Ok(robot.clone()),
        }
    }
}

/// A connected board and, where it is simulated in this process, the simulation behind it.
pub(crate) type Connected = (Client<Box<dyn Link>>, Option<SimulatedLink>);

/// Connects with the board, or simulates a machine whose winches are bare.
pub(crate) fn connected(
    common: &Common,
    robot: &Robot,
    machine: &Machine,
) -> miette::Result<Connected> {
    watch_for_interrupts().map_err(Failed::from_error("watching for Ctrl-C"))?;
    if common.on != "sim" {
        let link: Box<dyn Link> =
            Box::new(common.open_port().map_err(crate::link::ClientError::from)?);
        return Ok((Client::connect(link, new_session())?, None));
    }
    let real = machine.really(robot)?;
    let options = LinkOptions::default();
    let simulation =
        machine::simulate_unloaded(&real, &Mismatch::realistic(), &options, common.seed)
            .map_err(crate::link::LinkError::from)
            .map_err(crate::link::ClientError::from)?;
    let link = SimulatedLink::new(simulation);
    let boxed: Box<dyn Link> = Box::new(link.clone());
    Ok((Client::connect(boxed, SessionId(1))?, Some(link)))
}
