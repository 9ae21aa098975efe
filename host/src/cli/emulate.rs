//! `mcdpr emulate FIRMWARE --pty`: the firmware's own file on an emulated chip, with the simulated
//! robot around it, as a serial device for another program.

use super::{Common, Failed, Outcome, sim};
use crate::experiment::SimulatedRobot;
use crate::machine::{Controller, Firmware, Mismatch};
use crate::motion::Model;
use crate::run::watch_for_interrupts;
use mcdpr_simulator::LinkOptions;
use std::path::PathBuf;

/// Execute the board's firmware on an emulated chip behind a serial device
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// The firmware's file (ELF), as `cargo fw` builds it
    #[arg(value_name = "FIRMWARE")]
    file: PathBuf,
    /// Make a pseudo-terminal and print its name
    #[arg(long, required = true)]
    pty: bool,
    /// Simulate the machine exactly as described: no mismatch, no pulley loss
    #[arg(long)]
    ideal: bool,
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let scale = common.checked_time_scale()?.unwrap_or(1.0);
        let firmware = Firmware::find(Some(&self.file))?;
        let described = crate::robot::find(&common.robot)?;
        let model = Model::new(&described)?;
        model.hanging("the emulated chip, which has four modules,")?;
        let mismatch = if self.ideal {
            Mismatch::default()
        } else {
            Mismatch::realistic()
        };
        // The pseudo-terminal is the line; the chip's own UART has its real speed.
        let options = LinkOptions {
            latency_us: 0,
            ..LinkOptions::default()
        };
        let robot = SimulatedRobot::new(mismatch, common.seed)
            .line(options)
            .controller(&Controller::Chip(firmware))
            .at_home(&model)?;
        watch_for_interrupts().map_err(Failed::from_error("watching for Ctrl-C"))?;
        sim::serve(&described, robot, &[], common, scale, None)
    }
}
