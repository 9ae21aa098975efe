//! `mcdpr emulate FIRMWARE`: the firmware's own file on an emulated chip, as a serial device for another
//! program. With `--pty` the simulated robot is around it, with `--hil` its pins and its bus are devices,
//! too.

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
    #[arg(long, required_unless_present = "hil", conflicts_with = "hil")]
    pty: bool,
    /// Make three pseudo-terminals and print the `--on` with which another program has the chip in the loop: the chip's
    /// line, its CAN bus (slcan), and the signal board's line. The chip's time passes as that program says; with
    /// --time-scale by itself, and the other program needs the same scale
    #[arg(long)]
    hil: bool,
    /// Simulate the machine exactly as described: no mismatch, no pulley loss
    #[arg(long, conflicts_with = "hil")]
    ideal: bool,
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let scale = common.checked_time_scale()?;
        let firmware = Firmware::find(Some(&self.file))?;
        if self.hil {
            return in_the_loop(&firmware, scale);
        }
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
        sim::serve(&described, robot, &[], common, scale.unwrap_or(1.0), None)
    }
}

/// Only its pins are connected: nothing can be left in a bad state, and Ctrl-C ends it at once.
#[cfg(all(unix, feature = "emulator"))]
fn in_the_loop(firmware: &Firmware, scale: Option<f64>) -> Outcome {
    use std::io::Write as _;
    let mut bench = crate::hil::emulated::Bench::new(firmware.bytes().into())?;
    let mut out = std::io::stdout().lock();
    writeln!(out, "{}", bench.names()).map_err(Failed::from_error("standard output"))?;
    out.flush().map_err(Failed::from_error("standard output"))?;
    drop(out);
    match bench.serve(scale)? {}
}

#[cfg(not(all(unix, feature = "emulator")))]
fn in_the_loop(_: &Firmware, _: Option<f64>) -> Outcome {
    Err(Failed::from_error("emulate --hil")(
        "this program was built without pseudo-terminals or the emulator",
    )
    .into())
}
