//! `mcdpr sim --pty`: the simulated robot as a serial device for another program.

use super::calibrate::On;
use super::{Common, Failed, Outcome, print_json};
use crate::calibration::target;
use crate::experiment::SimulatedRobot;
use crate::machine::Mismatch;
use crate::motion::Model;
use crate::run::{interrupted, watch_for_interrupts};
use crate::scenario::{FaultyLink, Injection, Supply};
use mcdpr_simulator::LinkOptions;
use std::io::Write as _;
use std::path::PathBuf;

mod eye;
#[cfg(unix)]
mod several;
#[cfg(unix)]
mod tilt;

use eye::{Below, Eye};

/// Simulate the robot behind a serial device for another program
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// Make a pseudo-terminal and print its name
    #[arg(long, required = true)]
    pty: bool,
    /// Simulate the machine exactly as described: no mismatch, no pulley loss
    #[arg(long)]
    ideal: bool,
    /// Write the pictures of the platform's camera into this folder, whenever one is requested: the
    /// other program reads it with --camera folder:DIR
    #[arg(long, value_name = "DIR")]
    camera: Option<PathBuf>,
    /// Put a tray with this many objects on printed tags under the robot, instead of its tags on
    /// the floor
    #[arg(long, value_name = "N", requires = "camera")]
    objects: Option<usize>,
    /// Inject a fault, as `mcdpr demo --fault` does: power:board@2s/1s cuts the board's supply 2 s after
    /// the first motion's start, for 1 s
    #[arg(long, value_name = "FAULT@TIME")]
    fault: Vec<String>,
    /// The tags on the floor
    #[arg(long, value_enum, default_value_t = On::Robot, requires = "camera", conflicts_with = "objects")]
    target: On,
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let scale = common.checked_time_scale()?.unwrap_or(1.0);
        let mut robot = crate::robot::find(&common.robot)?;
        let cables = robot.cables.len();
        let faults = self.fault.iter().map(|word| Injection::parse(word, cables));
        let faults = faults.collect::<Result<Vec<_>, _>>()?;
        let host = |fault: &Injection| matches!(fault.supply, Some(Supply::Host | Supply::All));
        if faults.iter().any(host) {
            let reason = "the computer of the other program is not simulated: give power:board or power:drives";
            return Err(Failed::from_error("--fault")(reason).into());
        }
        if let Some(target) = self.target.target() {
            robot.tags = target::tags(target);
        }
        let model = Model::new(&robot)?;
        let mismatch = if self.ideal {
            Mismatch::default()
        } else {
            common.mismatch(Mismatch::realistic())
        };
        // The pseudo-terminal is the line: the wire in front of the board need not be slow as well.
        let options = LinkOptions {
            latency_us: 0,
            ..LinkOptions::default()
        };
        let link = SimulatedRobot::new(mismatch, common.seed)
            .line(options)
            .controller(&common.controller)
            .at_home(&model)?;
        watch_for_interrupts().map_err(Failed::from_error("watching for Ctrl-C"))?;
        #[cfg(unix)]
        if !robot.boards.is_empty() {
            if self.camera.is_some() || !faults.is_empty() {
                let reason = "it is not possible for a robot of several boards; use --on sim";
                return Err(Failed::from_error("--camera or --fault")(reason).into());
            }
            return several::serve(&link, common, scale);
        }
        let below = Below {
            objects: self.objects,
            ideal: self.ideal,
        };
        let eye = self.camera.as_ref();
        let eye = eye.map(|folder| Eye::start(folder, &robot, &link, &below, common.seed));
        let eye = eye.transpose()?;
        serve(&robot, link, &faults, common, scale, eye.as_ref())
    }
}

/// Bytes from the board that are collected for one write, while the robot catches up with time.
#[cfg(unix)]
const WRITTEN_AT_ONCE: usize = 128;

/// Serves a robot behind a pseudo-terminal, at `scale` simulated seconds per second, with its
/// camera and its inclinometer if it has one.
#[cfg(unix)]
pub(super) fn serve(
    described: &crate::robot::Robot,
    robot: crate::link::SimulatedLink,
    faults: &[Injection],
    common: &Common,
    scale: f64,
    eye: Option<&Eye>,
) -> Outcome {
    use crate::link::Link;
    use serialport::{SerialPort, TTYPort};
    use std::io::{ErrorKind, Read};
    use std::time::{Duration, Instant};

    let failed = || Failed::from_error("making a pseudo-terminal");
    let (mut host_side, device) = TTYPort::pair().map_err(failed())?;
    host_side
        .set_timeout(Duration::from_millis(1))
        .map_err(failed())?;
    let name = device.name().unwrap_or_default();
    // Another program must have the device for itself; a plain handle only keeps it open.
    let _keep_alive = std::fs::File::open(&name).map_err(Failed::from_error("opening it"))?;
    drop(device);
    let mut tilt = tilt::TiltPort::open(described, &robot, common.seed)?;
    let imu = tilt.as_ref().map(tilt::TiltPort::name);
    if common.json {
        let mut ports = serde_json::json!({ "port": name });
        if let Some(imu) = imu {
            ports["imu"] = imu.into();
        }
        print_json(&ports)?;
    } else {
        say!("{name}");
        if let Some(imu) = imu {
            eprintln!("its inclinometer: --imu {imu}");
        }
        eprintln!("the simulated robot hangs at home; try: mcdpr run paper:table7 --on {name}");
    }
    // A reader that waits for the name must not wait for a full buffer.
    let _ = std::io::stdout().flush();
    let began = Instant::now();
    let mut link = FaultyLink::new(robot.clone(), faults);
    let mut buffer = [0; 512];
    let mut answer = Vec::new();
    while !interrupted() {
        let used = match host_side.read(&mut buffer) {
            Ok(used) => used,
            Err(error) if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::Interrupted) => 0,
            Err(error) => {
                return Err(Failed::from_error("reading the pseudo-terminal")(error).into());
            }
        };
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "positive"
        )]
        let now_us = (began.elapsed().as_secs_f64() * 1e6 * scale) as u64;
        answer.clear();
        while link.now_us() < now_us {
            link.receive(now_us, &mut answer)
                .map_err(crate::link::ClientError::from)?;
            // Several bytes at a time: a write for each would be so slow that the robot falls
            // behind real time on a busy machine, and misses heartbeats.
            if answer.len() < WRITTEN_AT_ONCE && link.now_us() < now_us {
                continue;
            }
            // There may be no reader: a full pseudo-terminal loses bytes like a real line.
            let _ = host_side.write(&answer);
            answer.clear();
        }
        if let Some(eye) = eye {
            eye.look(&robot)?;
        }
        if let Some(tilt) = &mut tilt {
            tilt.send(link.now_us())?;
        }
        // Only now: a byte must not reach the board before it was sent, however late this loop is.
        link.send(buffer.get(..used).unwrap_or_default())
            .map_err(crate::link::ClientError::from)?;
    }
    Ok(())
}

#[cfg(not(unix))]
pub(super) fn serve(
    _described: &crate::robot::Robot,
    _robot: crate::link::SimulatedLink,
    _faults: &[Injection],
    _common: &Common,
    _scale: f64,
    _eye: Option<&Eye>,
) -> Outcome {
    let reason = "this system has no pseudo-terminals; use `--on sim`";
    Err(Failed::from_error("sim --pty")(reason).into())
}
