//! The command line: one file per command, each with its arguments and what it does.
//!
//! Results go to standard output, everything else to standard error. Exit codes: 0 done, 1 refused
//! or failed with a reason, 2 wrong usage, 3 stopped by a fault, 130 interrupted after a stop.

/// Prints a line of a result to standard output; see [`write_out`].
macro_rules! say {
    ($($what:tt)*) => {
        $crate::cli::say_out(&format!("{}\n", format_args!($($what)*)))
    };
}

mod bench;
mod calibrate;
mod camera;
mod care;
mod clear;
mod commission;
mod compute;
mod config;
mod demo;
mod doctor;
mod dry;
mod emulate;
mod estimate;
mod experiment;
mod export;
mod eye;
mod faults;
mod fingerprint;
mod flash;
mod line;
mod live;
mod model;
#[cfg(unix)]
mod monitor;
mod movement;
mod numbers;
mod order;
#[cfg(unix)]
mod orders;
mod pick;
mod plan;
mod ports;
mod predict;
mod progress;
mod reach;
mod reaction;
mod recorded;
mod recover;
mod replay;
mod report;
mod reproduce;
mod rig;
mod ros;
mod run;
mod serve;
mod service;
mod shell;
mod sim;
mod states;
mod study;
mod table;
mod token;
mod track;
mod tune;
mod under_page;

pub use dry::{DRY_RUNS, DryRun, commands};

use crate::calibration::collect::CollectError;
use crate::chart::PlotFormat;
use crate::hil::Wires;
use crate::link::{LinkError, PortLink, SerialLines, SerialLink};
use crate::machine::{Controller, Firmware, Mismatch};
use crate::run::RunError;
use clap::{Args, Parser, Subcommand};
use miette::Diagnostic;
use std::path::PathBuf;
use std::process::ExitCode;

/// Control of a modular cable-driven parallel robot: simulate it, plan, run.
#[derive(Debug, Parser)]
#[command(name = "mcdpr", version, about, max_term_width = 80)]
struct Cli {
    #[command(flatten)]
    common: Common,
    /// What to do; without it, `demo`.
    #[command(subcommand)]
    command: Option<Command>,
}

/// Options that every command understands.
#[derive(Debug, Clone, Args)]
pub(crate) struct Common {
    /// Robot file, or the name of a built-in robot
    #[arg(
        long,
        global = true,
        default_value = "paper-table5",
        value_name = "FILE"
    )]
    pub robot: String,
    /// Calibration file to apply, or `none`; by default the one beside the robot file
    #[arg(long, global = true, value_name = "FILE|none")]
    pub calibration: Option<String>,
    /// Connection to the robot: `sim` (simulated in this process), `chip` (simulated, controlled by
    /// the firmware file on an emulated chip), `hil:PORT,CAN,PORT` (simulated, controlled by a real board: its port,
    /// its CAN bus, the signal board's port) or a serial port; of a robot with several boards the port of each
    #[arg(
        long,
        global = true,
        default_value = "sim",
        value_name = "sim|chip|hil:WIRES|PORT[,PORT]"
    )]
    pub on: String,
    /// The firmware file for `--on chip`; else MCDPR_FIRMWARE, else the output of `cargo fw`
    #[arg(long, global = true, value_name = "FILE")]
    pub firmware: Option<PathBuf>,
    /// One JSON document on standard output, SI units
    #[arg(long, global = true)]
    pub json: bool,
    /// Seed of everything random in the simulator
    #[arg(long, global = true, default_value_t = 1, value_name = "N")]
    pub seed: u64,
    /// The simulated machine: as its file says, with the errors of a calibrated machine, as a workshop builds
    /// it, or with the errors that a real robot's logs show, its winches calibrated (as-found) or not
    /// (as-delivered), or realistic with cables that creep, a room that warms and sensors that drift (after-hours).
    /// A robot that was calibrated on the simulator stays the machine that it is
    #[arg(long, global = true, value_name = "KIND",
          value_parser = ["exact", "realistic", "as-built", "as-found", "as-delivered", "after-hours"])]
    pub machine: Option<String>,
    /// Folder for the run's files, instead of runs/DATE-TIME-NAME
    #[arg(long, global = true, value_name = "DIR")]
    pub record: Option<PathBuf>,
    /// Kind of the plots that are drawn; a plot whose file is named has the kind of its ending. `report` draws them
    /// into its page, and with this option also as files
    #[arg(long, global = true, value_name = "KIND", value_enum)]
    pub plots: Option<PlotFormat>,
    /// Plan and judge only: nothing moves. A command that cannot be judged without doing it is refused
    #[arg(long, global = true)]
    pub dry_run: bool,
    /// Simulated seconds per second; without it, `sim --pty` keeps real time and everything else is
    /// simulated as fast as possible. Use the same scale to communicate with a `sim --pty` that has
    /// one
    #[arg(long, global = true, value_name = "X")]
    pub time_scale: Option<f64>,
    /// Show the robot in a browser on this machine while it moves, in real time; port 8650 if none is given, 0
    /// takes a free one
    #[arg(long, global = true, value_name = "PORT", num_args = 0..=1, default_missing_value = "8650")]
    pub serve: Option<u16>,
    /// A page started this program: its process, which answers questions on standard input.
    #[arg(long, global = true, hide = true, value_name = "PROCESS")]
    pub for_page: Option<u32>,
    /// The live page of `--serve`, from the first line to a robot on.
    #[arg(skip)]
    pub page: live::LivePage,
    /// What controls a simulated robot; `--on chip` sets it.
    #[arg(skip)]
    pub controller: Controller,
}

impl Common {
    /// Lets the emulated chip control every simulated robot, if `--on chip` asks for it. From
    /// there on the robot is a simulated one for every command.
    fn take_up_chip(&mut self) -> Outcome {
        let scale = self.checked_time_scale()?;
        if Wires::is_meant(&self.on) {
            self.controller = Controller::Hil(Wires::parse(&self.on, scale.unwrap_or(1.0))?);
            "sim".clone_into(&mut self.on);
        }
        if self.machine.is_some() && self.on != "sim" && self.on != "chip" {
            let reason = format!(
                "the robot on {} is what it is; leave out --machine",
                self.on
            );
            return Err(Failed::from_error("--machine")(reason).into());
        }
        if self.on == "chip" {
            self.controller = Controller::Chip(Firmware::find(self.firmware.as_deref())?);
            "sim".clone_into(&mut self.on);
        }
        Ok(())
    }

    /// The simulated machine: that of `--machine`, or the command's usual one.
    pub(crate) fn mismatch(&self, usual: Mismatch) -> Mismatch {
        let named = self.machine.as_deref().and_then(Mismatch::named);
        named.unwrap_or(usual)
    }

    /// Refuses the emulated chip for a command that simulates many robots in this process.
    ///
    /// # Errors
    /// Where `--on chip` was given.
    pub(crate) fn no_chip(&self, command: &str) -> Result<(), Failed> {
        if self.controller.is_in_process() {
            return Ok(());
        }
        Err(Failed::from_error(command)(
            "it simulates many robots, each with the control core in this process, none on a chip or a board; leave out --on",
        ))
    }

    /// Kind of the plots of a run.
    pub(crate) fn plots(&self) -> PlotFormat {
        self.plots.unwrap_or_default()
    }

    /// Opens the serial port of `--on`, or those of all boards of the robot, with the time scale of
    /// `--time-scale`.
    ///
    /// # Errors
    /// Those of [`SerialLink::open`]; [`LinkError::Boards`] where the robot has another number of
    /// boards.
    pub(crate) fn open_port(&self) -> Result<PortLink, LinkError> {
        let scale = self.time_scale.unwrap_or(1.0);
        let names: Vec<&str> = self.on.split(',').map(str::trim).collect();
        // A robot that cannot be read has been reported by its command, or is not needed by it.
        let designed = crate::robot::find(&self.robot).ok();
        let several = designed.is_some_and(|robot| !robot.boards.is_empty());
        let wrong = |what: String, help: &str| LinkError::Boards {
            what,
            help: help.to_owned(),
        };
        if !several {
            return match names.as_slice() {
                [name] => Ok(PortLink::One(SerialLink::open(name)?.at_scale(scale))),
                _ => Err(wrong(
                    format!(
                        "{} ports are given, but the robot has one board",
                        names.len()
                    ),
                    "give its port alone, or name the robot of these boards with --robot",
                )),
            };
        }
        // With its calibration: the boards' configuration has it.
        let robot = self
            .robot()
            .map_err(|error| wrong(error.to_string(), "see docs/robot-file.md"))?;
        if names.len() != robot.boards.len() {
            return Err(wrong(
                format!(
                    "the robot has {} boards, but --on gives {} port(s)",
                    robot.boards.len(),
                    names.len()
                ),
                "give one port per board, with commas: --on PORT,PORT",
            ));
        }
        let lines = SerialLines::open(&names, scale)?;
        let boards = mcdpr_core::boards::Boards::new(&robot, lines);
        let boards = boards.map_err(|error| wrong(error.to_string(), "see docs/robot-file.md"))?;
        boards
            .map(|boards| PortLink::Several(Box::new(boards)))
            .ok_or_else(|| wrong("the robot has one board".into(), "give its port alone"))
    }

    /// Opens the one serial port of `--on`, for work on a single board.
    ///
    /// # Errors
    /// Those of [`SerialLink::open`]; [`LinkError::Boards`] for several ports.
    pub(crate) fn open_one_port(&self) -> Result<SerialLink, LinkError> {
        if self.on.contains(',') {
            return Err(LinkError::Boards {
                what: "this command works on one board at a time".into(),
                help: "give that board's port alone".into(),
            });
        }
        Ok(SerialLink::open(&self.on)?.at_scale(self.time_scale.unwrap_or(1.0)))
    }

    /// Simulated seconds per second of a robot that this process simulates; `None`: as fast as possible. With
    /// viewers it keeps real time.
    ///
    /// # Errors
    /// As [`Self::checked_time_scale`].
    pub(crate) fn pace(&self) -> Result<Option<f64>, Failed> {
        Ok(self.checked_time_scale()?.or(self.serve.map(|_| 1.0)))
    }

    /// The time scale, if one was given.
    ///
    /// # Errors
    /// If it is not between 0.01 and 100.
    pub(crate) fn checked_time_scale(&self) -> Result<Option<f64>, Failed> {
        match self.time_scale {
            Some(scale) if !(scale.is_finite() && (0.01..=100.0).contains(&scale)) => {
                let reason = format!("{scale} is not between 0.01 and 100");
                Err(Failed::from_error("--time-scale")(reason))
            }
            scale => Ok(scale),
        }
    }
}

#[derive(Debug, Subcommand)]
enum Command {
    Demo(demo::Cmd),
    Plan(plan::Cmd),
    Experiment(experiment::Cmd),
    Rig(rig::Cmd),
    Tune(tune::Cmd),
    Run(run::Cmd),
    #[cfg(unix)]
    Stop(orders::Stop),
    #[cfg(unix)]
    Pause(orders::Pause),
    #[cfg(unix)]
    Resume(orders::Resume),
    Move(movement::Move),
    Jog(movement::Jog),
    Park(movement::Park),
    Home(movement::Home),
    Recover(recover::Cmd),
    Arm(movement::Arm),
    Disarm(movement::Disarm),
    Gripper(movement::Gripper),
    Clear(clear::Cmd),
    Commission(commission::Cmd),
    Serve(serve::Cmd),
    Ros(ros::Cmd),
    #[cfg(unix)]
    Monitor(monitor::Cmd),
    Replay(replay::Cmd),
    Report(report::Report),
    Compare(report::Compare),
    Export(export::Cmd),
    Model(model::Cmd),
    Reproduce(reproduce::Cmd),
    Fingerprint(fingerprint::Cmd),
    Estimate(estimate::Cmd),
    Ik(compute::ik::Cmd),
    Fk(compute::fk::Cmd),
    Statics(compute::statics::Cmd),
    Workspace(compute::workspace::Cmd),
    Calibrate(calibrate::Cmd),
    Track(track::Cmd),
    Care(care::Cmd),
    Predict(predict::Cmd),
    Pick(pick::Cmd),
    Camera(camera::Cmd),
    Sim(sim::Cmd),
    Emulate(emulate::Cmd),
    Ports(ports::Cmd),
    Doctor(doctor::Cmd),
    Bench(bench::Cmd),
    #[cfg_attr(not(feature = "flash"), command(hide = true))]
    Flash(flash::Cmd),
    States(states::Cmd),
    Study(study::Cmd),
    Faults(faults::Cmd),
    Config(config::Cmd),
    Completions(shell::Completions),
    Man(shell::Man),
}

impl Common {
    /// The calibration to apply: the requested one, or the one beside the robot file.
    pub(crate) fn calibration_file(&self) -> Option<PathBuf> {
        match self.calibration.as_deref() {
            Some("none") => None,
            Some(file) => Some(PathBuf::from(file)),
            None => {
                let beside = crate::calibration::result::path_for(&self.robot);
                beside.is_file().then_some(beside)
            }
        }
    }

    /// The robot with its calibration, if there is one.
    ///
    /// # Errors
    /// If either file is unusable, or a calibration of the simulator is used with a board.
    pub(crate) fn robot(&self) -> miette::Result<crate::robot::Robot> {
        use crate::calibration::result;
        let designed = crate::robot::find(&self.robot)?;
        let Some(path) = self.calibration_file() else {
            return Ok(designed);
        };
        let robot = result::apply(&designed, &path)?;
        let simulated = robot.calibrated.as_ref().and_then(|c| c.simulated_seed);
        if self.on != "sim" && simulated.is_some() {
            let what = format!("calibration {}", path.display());
            return Err(Failed::from_error(&what)(
                "it was made on the simulator; calibrate this machine, or add --calibration none",
            )
            .into());
        }
        eprintln!("calibration {} applied", path.display());
        Ok(robot)
    }
}

/// A command's outcome: an error, or nothing.
pub type Outcome = miette::Result<()>;

/// Reads the command line, executes it, and returns the exit code.
pub fn main() -> ExitCode {
    #[cfg(unix)]
    take_file_size_limit_as_an_error();
    #[cfg(unix)]
    end_at_interrupts();
    let (mut cli, words) = order::parse();
    let _ = miette::set_hook(Box::new(|_| {
        Box::new(miette::MietteHandlerOpts::new().width(100).build())
    }));
    let allowed = if cli.common.dry_run {
        dry::check(&words)
    } else {
        Ok(())
    };
    let allowed = allowed.and_then(|()| Ok(live::check(&words, cli.common.serve)?));
    if let Err(report) = allowed.and_then(|()| cli.common.take_up_chip()) {
        eprintln!("{report:?}");
        return ExitCode::FAILURE;
    }
    let common = &cli.common;
    #[cfg(unix)]
    if let Some(page) = common.for_page {
        under_page::watch(page);
    }
    let outcome = match cli.command.unwrap_or(Command::Demo(demo::Cmd::default())) {
        Command::Demo(cmd) => cmd.run(common),
        Command::Plan(cmd) => cmd.run(common),
        Command::Experiment(cmd) => cmd.run(common),
        Command::Rig(cmd) => cmd.run(common),
        Command::Tune(cmd) => cmd.run(common),
        Command::Run(cmd) => cmd.run(common),
        #[cfg(unix)]
        Command::Stop(cmd) => cmd.run(common),
        #[cfg(unix)]
        Command::Pause(cmd) => cmd.run(common),
        #[cfg(unix)]
        Command::Resume(cmd) => cmd.run(common),
        Command::Move(cmd) => cmd.run(common),
        Command::Jog(cmd) => cmd.run(common),
        Command::Park(cmd) => cmd.run(common),
        Command::Home(cmd) => cmd.run(common),
        Command::Recover(cmd) => cmd.run(common),
        Command::Arm(cmd) => cmd.run(common),
        Command::Disarm(cmd) => cmd.run(common),
        Command::Gripper(cmd) => cmd.run(common),
        Command::Clear(cmd) => cmd.run(common),
        Command::Commission(cmd) => cmd.run(common),
        Command::Serve(cmd) => cmd.run(common),
        Command::Ros(cmd) => cmd.run(common),
        #[cfg(unix)]
        Command::Monitor(cmd) => cmd.run(common),
        Command::Replay(cmd) => cmd.run(common),
        Command::Report(cmd) => cmd.run(common),
        Command::Compare(cmd) => cmd.run(common),
        Command::Reproduce(cmd) => cmd.run(common),
        Command::Fingerprint(cmd) => cmd.run(common),
        Command::Export(cmd) => cmd.run(common),
        Command::Model(cmd) => cmd.run(common),
        Command::Estimate(cmd) => cmd.run(common),
        Command::Ik(cmd) => cmd.run(common),
        Command::Fk(cmd) => cmd.run(common),
        Command::Statics(cmd) => cmd.run(common),
        Command::Workspace(cmd) => cmd.run(common),
        Command::Calibrate(cmd) => cmd.run(common),
        Command::Track(cmd) => cmd.run(common),
        Command::Care(cmd) => cmd.run(common),
        Command::Predict(cmd) => cmd.run(common),
        Command::Pick(cmd) => cmd.run(common),
        Command::Camera(cmd) => cmd.run(common),
        Command::Sim(cmd) => cmd.run(common),
        Command::Emulate(cmd) => cmd.run(common),
        Command::Ports(cmd) => cmd.run(common),
        Command::Doctor(cmd) => cmd.run(common),
        Command::Bench(cmd) => cmd.run(common),
        Command::Flash(cmd) => cmd.run(common),
        Command::States(cmd) => cmd.run(common),
        Command::Study(cmd) => cmd.run(common),
        Command::Faults(cmd) => cmd.run(common),
        Command::Config(cmd) => cmd.run(common),
        Command::Completions(cmd) => cmd.run(common),
        Command::Man(cmd) => cmd.run(common),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(report) => {
            match common.for_page {
                Some(_) => eprintln!("{}", under_page::in_one_line(report.as_ref())),
                None => eprintln!("{report:?}"),
            }
            let code = report
                .downcast_ref::<RunError>()
                .map(RunError::exit_code)
                .or_else(|| report.downcast_ref().map(crate::pick::PickError::exit_code))
                .or_else(|| report.downcast_ref().map(CollectError::exit_code))
                .unwrap_or(1);
            ExitCode::from(u8::try_from(code).unwrap_or(1))
        }
    }
}

/// Ctrl-C ends a command that has no robot at once, with the exit code for it. Commands with a robot watch for it
/// themselves, and stop the robot.
#[cfg(unix)]
fn end_at_interrupts() {
    use std::sync::Arc;
    use std::sync::atomic::AtomicBool;
    let at_once = Arc::new(AtomicBool::new(true));
    // Without it the signal ends the program all the same.
    let _ =
        signal_hook::flag::register_conditional_shutdown(signal_hook::consts::SIGINT, 130, at_once);
}

/// A file that reaches its size limit (`ulimit -f`) must give a write error, like a full disk, and
/// must not end the program in the middle of a motion.
#[cfg(unix)]
fn take_file_size_limit_as_an_error() {
    use std::sync::Arc;
    use std::sync::atomic::AtomicBool;
    let seen = Arc::new(AtomicBool::new(false));
    // A system without room for a handler has none for a robot either.
    let _ = signal_hook::flag::register(signal_hook::consts::SIGXFSZ, seen);
}

/// Prints one JSON document.
///
/// # Errors
/// If the value cannot be written as JSON.
pub(crate) fn print_json(value: &impl serde::Serialize) -> Outcome {
    let text = serde_json::to_string(value).map_err(Failed::from_error("the result"))?;
    write_out(&(text + "\n"));
    Ok(())
}

/// Writes words to standard output; on a terminal its width breaks them between words. Where a program reads, a line
/// stays one line.
pub(crate) fn say_out(text: &str) {
    match terminal_size::terminal_size_of(std::io::stdout()) {
        // A terminal may say that it has no columns.
        Some((terminal_size::Width(columns), _)) if columns >= 20 => {
            write_out(&table::wrap(text, columns.into()));
        }
        _ => write_out(text),
    }
}

/// Writes a result to standard output. A closed reader (a pager, `head`) is not an error.
pub(crate) fn write_out(text: &str) {
    use std::io::Write as _;
    let mut out = std::io::stdout().lock();
    let _ = out.write_all(text.as_bytes()).and_then(|()| out.flush());
}

/// An operation of the system failed: a file, a folder, a terminal.
#[derive(Debug, thiserror::Error, Diagnostic)]
#[error("{what}: {reason}")]
#[diagnostic(code(mcdpr::system))]
pub(crate) struct Failed {
    what: String,
    reason: String,
}

impl Failed {
    /// For `map_err`: adds the operation.
    pub(crate) fn from_error<E: std::fmt::Display>(what: &str) -> impl FnOnce(E) -> Self + '_ {
        move |error| Self {
            what: what.to_owned(),
            reason: error.to_string(),
        }
    }
}
