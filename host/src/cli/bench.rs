//! `mcdpr bench`: the self-test of a board without a robot, with a sealed record.

use super::{Common, Failed, Outcome, print_json};
use crate::bench::{self, BenchError, Report};
use crate::experiment::SimulatedRobot;
use crate::files;
use crate::flash::Image;
use crate::link::{Client, ClientError, Link};
use crate::machine::{Firmware, Mismatch};
use crate::motion::Model;
use crate::robot::Robot;
use crate::run::{RunError, new_session};
use mcdpr_protocol::Request;
use serde_json::{Value, json};
use std::io::{BufRead, Write};
use std::path::PathBuf;

/// Most bytes of a key.
const MOST_KEY: u64 = 1 << 16;

/// Test a board without a robot: chip, clocks, supply, CAN, inputs, tick, stack; write a sealed record
///
/// No drive gets torque. With --outputs each output is switched on for 0.3 s, after its name was
/// typed: disconnect brakes and drives first. The board must have no configuration: press its reset
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// Test the outputs, too: each after its name was typed
    #[arg(long)]
    outputs: bool,
    /// Jumper wires lead from outputs to inputs (docs/wiring.md): each output must show there
    #[arg(long, requires = "outputs")]
    jumpers: bool,
    /// Write the record to this file
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Seal the record with this file's bytes as a key
    #[arg(long, value_name = "FILE")]
    key: Option<PathBuf>,
    /// Only check that a record matches its seal
    #[arg(long, value_name = "FILE", conflicts_with_all = ["outputs", "jumpers", "out"])]
    verify: Option<PathBuf>,
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let key = match &self.key {
            Some(path) => {
                let shown = path.display().to_string();
                Some(files::read_bytes(path, MOST_KEY).map_err(Failed::from_error(&shown))?)
            }
            None => None,
        };
        if let Some(path) = &self.verify {
            let shown = path.display().to_string();
            let text = files::read_text(path).map_err(Failed::from_error(&shown))?;
            let verdict = bench::verify(&text, key.as_deref())?;
            say!("{shown}: as it was sealed; verdict {verdict}");
            return Ok(());
        }
        // The file is compared with the running firmware, if there is one; a named file must be valid.
        let firmware = match common.controller.firmware() {
            Some(firmware) => Some(firmware.clone()),
            None if common.firmware.is_some() => Some(Firmware::find(common.firmware.as_deref())?),
            // Without a file the board is tested without that comparison.
            None => Firmware::find(None).ok(),
        };
        let image = match &firmware {
            Some(firmware) => Some(Image::examine("the firmware's file", firmware)?),
            None => None,
        };
        let mut client = Client::connect(open(common)?, new_session())?;
        let expects = image.as_ref().map(Image::commit);
        let outputs = self.outputs;
        let mut confirm = |name: &str| outputs && typed(name);
        let examined = bench::examine(&mut client, expects.as_deref(), self.jumpers, &mut confirm);
        // In any case the session ends, so that other programs can use the board.
        let closed = client.request(Request::Close);
        let report = examined?;
        closed.map_err(RunError::from)?;
        let record = record(common, &report, image.as_ref(), key.as_deref());
        if let Some(path) = &self.out {
            let shown = path.display().to_string();
            let text = serde_json::to_string_pretty(&record).unwrap_or_default();
            files::write_atomically(path, text).map_err(Failed::from_error(&shown))?;
        }
        if common.json {
            print_json(&record)?;
        } else {
            print_report(&report);
        }
        if report.passes() {
            return Ok(());
        }
        Err(
            Failed::from_error("bench")("the board must not drive a robot before this is repaired")
                .into(),
        )
    }
}

fn open(common: &Common) -> miette::Result<Box<dyn Link>> {
    if common.on != "sim" {
        return Ok(Box::new(common.open_one_port().map_err(ClientError::from)?));
    }
    if common.controller.is_in_process() {
        return Err(BenchError::NoChip.into());
    }
    let robot = Robot::built_in("paper-table5")?;
    let link = SimulatedRobot::new(Mismatch::realistic(), common.seed)
        .controller(&common.controller)
        .at_home(&Model::new(&robot)?)?;
    Ok(Box::new(link))
}

/// Whether the user types the output's name.
fn typed(name: &str) -> bool {
    eprint!("{name} will be on for 0.3 s; no drive gets a command. Type `{name}` to continue: ");
    let _ = std::io::stderr().flush();
    let mut line = String::new();
    let read = std::io::stdin().lock().read_line(&mut line);
    read.is_ok() && line.trim() == name
}

fn record(common: &Common, report: &Report, image: Option<&Image>, key: Option<&[u8]>) -> Value {
    let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    let record = json!({
        "format": "mcdpr-bench 1",
        "program": env!("CARGO_PKG_VERSION"),
        "simulated": common.on == "sim",
        "unix_time_s": since.map_or(0, |since| since.as_secs()),
        "verdict": if report.passes() { "pass" } else { "fail" },
        "file_sha256": image.map(|image| bench::sha256(&image.flash)),
        "board": report,
    });
    match record {
        Value::Object(record) => bench::seal(record, key),
        other => other,
    }
}

fn print_report(report: &Report) {
    say!("board {}", report.serial);
    for finding in &report.findings {
        super::doctor::print_finding(finding);
    }
    say!("verdict: {}", if report.passes() { "pass" } else { "fail" });
}
