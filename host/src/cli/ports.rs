//! `mcdpr ports`: lists the serial ports.

use super::{Common, Outcome, print_json};
use crate::link::list_ports;

/// List the serial ports of this machine
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let ports = list_ports();
        if common.json {
            return print_json(&ports);
        }
        if ports.is_empty() {
            say!("no serial ports: plug in the board's USB cable, or use `--on sim`");
        }
        for port in ports {
            say!("{}   {}", port.name, port.description);
        }
        Ok(())
    }
}
