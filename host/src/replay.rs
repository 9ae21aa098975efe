//! Runs the host and the core again on recorded bytes; their output must be identical to the last
//! bit.

use crate::control::Handle;
use crate::experiment::{Experiment, SimulatedRobot};
use crate::link::{Direction, Link, LinkError, RawFrame};
use crate::machine::Controller;
use crate::motion::{Model, PlanError, Task, TaskError};
use crate::record::{Doing, LoadError, Machine, RecordedRun};
use crate::robot::{Robot, RobotError};
use crate::run::{Homing, RunError};
use mcdpr_protocol::SessionId;
use miette::Diagnostic;
use std::path::PathBuf;
use thiserror::Error;

/// Why a replay differs or is not possible.
#[derive(Debug, Error, Diagnostic)]
pub enum ReplayError {
    /// The record cannot be read.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Load(#[from] LoadError),
    /// The record has holes.
    #[error("the record lacks {missing} calls of the line, so it cannot be replayed")]
    #[diagnostic(
        code(mcdpr::replay::gaps),
        help("`mcdpr report` and `mcdpr export` still read what is there")
    )]
    Gaps {
        /// Number of missing calls.
        missing: u64,
    },
    /// The recorded robot file is not accepted.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Robot(#[from] RobotError),
    /// The recorded calibration is not accepted.
    #[error("the calibration in the record: {reason}")]
    #[diagnostic(code(mcdpr::replay::calibration))]
    Calibration {
        /// Why.
        reason: String,
    },
    /// No part of it can be repeated.
    #[error("no part of this run can be repeated: {reason}")]
    #[diagnostic(
        code(mcdpr::replay::nothing),
        help("`mcdpr report` and `mcdpr export` show what is in it")
    )]
    Nothing {
        /// Why.
        reason: String,
    },
    /// The recorded task is not accepted.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Task(#[from] TaskError),
    /// The recorded robot cannot be planned for.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Plan(#[from] PlanError),
    /// The host acted differently.
    #[error("the {who} differs from the record at {time_s:.6} s, call {call} of the line: {what}")]
    #[diagnostic(
        code(mcdpr::replay::differs),
        help(
            "another version of the program ({program}) recorded it, or something in it depends on more than bytes and times"
        )
    )]
    Differs {
        /// Host or core.
        who: &'static str,
        /// The link's time.
        time_s: f64,
        /// Which call.
        call: usize,
        /// How.
        what: String,
        /// The recording program.
        program: String,
    },
    /// The simulated robot cannot be set up as recorded.
    #[error("the simulated robot cannot be set up as recorded: {reason}")]
    #[diagnostic(code(mcdpr::replay::simulator))]
    Simulator {
        /// Why.
        reason: String,
    },
}

/// Result of a replay.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Proof {
    /// Bytes that the host sent again, all equal; `None` if its output depended on more than the
    /// record.
    pub host_bytes: Option<u64>,
    /// Bytes that the core sent again, all equal; `None` if no simulator was used.
    pub core_bytes: Option<u64>,
    /// Calls of the line.
    pub calls: usize,
    /// Whether the host reached the record's end (a truncated record ends before it).
    pub whole: bool,
}

/// Answers as recorded, and notes a different request.
struct Recorded<'a> {
    frames: &'a [RawFrame],
    next: usize,
    now_us: u64,
    sent: u64,
    differs: Option<String>,
    ran_out: bool,
}

impl Recorded<'_> {
    fn take(&mut self, direction: Direction) -> Result<RawFrame, LinkError> {
        let stop = |reason: &str| LinkError::Broken {
            reason: reason.to_owned(),
        };
        let Some(frame) = self.frames.get(self.next) else {
            self.ran_out = true;
            return Err(stop("the record ends here"));
        };
        if frame.direction != direction {
            self.differs = Some(match direction {
                Direction::ToBoard => "it sends instead of waiting".to_owned(),
                Direction::ToHost => "it waits instead of sending".to_owned(),
            });
            return Err(stop("replay differs"));
        }
        self.next += 1;
        self.now_us = frame.time_us;
        Ok(frame.clone())
    }
}

impl Link for Recorded<'_> {
    fn now_us(&self) -> u64 {
        self.now_us
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        let frame = self.take(Direction::ToBoard)?;
        if frame.bytes != bytes {
            // The error names the call that differs, not the next one.
            self.next -= 1;
            self.differs = Some("it sends other bytes".to_owned());
            return Err(LinkError::Broken {
                reason: "replay differs".to_owned(),
            });
        }
        self.sent += bytes.len() as u64;
        Ok(())
    }

    fn receive(&mut self, _until_us: u64, into: &mut Vec<u8>) -> Result<u64, LinkError> {
        let frame = self.take(Direction::ToHost)?;
        into.extend_from_slice(&frame.bytes);
        Ok(frame.time_us)
    }
}

/// The robot as it was recorded, with the calibration that was applied to it.
///
/// # Errors
/// [`ReplayError::Robot`], [`ReplayError::Calibration`].
pub(crate) fn recorded_robot(run: &RecordedRun) -> Result<Robot, ReplayError> {
    let designed = run.designed_robot()?;
    let Some(calibration) = &run.scenario.calibration else {
        return Ok(designed);
    };
    let path = PathBuf::from(&calibration.name);
    let applied = crate::calibration::result::apply_text(&designed, &calibration.text, &path);
    applied.map_err(|reason| ReplayError::Calibration { reason })
}

/// The task as it was recorded.
///
/// # Errors
/// [`ReplayError::Task`].
pub(crate) fn recorded_task(run: &RecordedRun, model: &Model) -> Result<Task, ReplayError> {
    let source = &run.scenario.task;
    Ok(match &source.text {
        Some(text) => Task::parse_file(text, source.name.clone().into())?,
        None => crate::motion::find_task_for(model, &source.name, source.tool_z_m)?,
    })
}

/// Runs host and core again and compares every byte. The core's side is compared where
/// `controller` is what controlled the recorded robot.
///
/// # Errors
/// [`ReplayError::Differs`] with the first difference; the others where it cannot be replayed.
pub fn replay(run: &RecordedRun, controller: &Controller) -> Result<Proof, ReplayError> {
    // After a hole nothing can be repeated: every later answer depends on it.
    if run.gaps > 0 {
        return Err(ReplayError::Gaps { missing: run.gaps });
    }
    let scenario = &run.scenario;
    let model = Model::new(&recorded_robot(run)?)?.with_options(scenario.options);
    let (host_bytes, whole) = match scenario.doing {
        Doing::Task => {
            let (bytes, whole) = host(run, &model, recorded_task(run, &model)?)?;
            (Some(bytes), whole)
        }
        Doing::Orders | Doing::Pictures | Doing::Hands => (None, run.damage.is_none()),
    };
    let core_bytes = match &run.scenario.machine {
        // The content of the workcell, and actions of people, are not in the record.
        _ if matches!(scenario.doing, Doing::Pictures | Doing::Hands) => None,
        Machine::Simulated {
            mismatch,
            seed,
            firmware,
        } if *firmware == controller.firmware_crc() => {
            let robot = SimulatedRobot::new(*mismatch, *seed).at_home(&model);
            let robot = robot.map_err(|error| ReplayError::Simulator {
                reason: error.to_string(),
            })?;
            Some(core(run, robot)?)
        }
        Machine::Simulated { .. } | Machine::InTheLoop { .. } | Machine::Port { .. } => None,
    };
    if host_bytes.is_none() && core_bytes.is_none() {
        let reason = match (scenario.doing, &scenario.machine) {
            (Doing::Pictures, _) => {
                "it followed pictures, and the workcell is not in the record".to_owned()
            }
            (Doing::Hands, _) => {
                "people were involved (pulls, weights, rigging, a bare winch)".to_owned()
            }
            (_, Machine::Simulated { .. }) => {
                "another firmware answered; name it with --on chip --firmware FILE".to_owned()
            }
            (_, Machine::InTheLoop { wires, .. }) => {
                format!("a person gave the orders, and the board on {wires} answered")
            }
            (_, Machine::Port { name }) => format!("a person gave the orders, and {name} answered"),
        };
        return Err(ReplayError::Nothing { reason });
    }
    Ok(Proof {
        host_bytes,
        core_bytes,
        calls: run.frames.len(),
        whole,
    })
}

fn host(run: &RecordedRun, model: &Model, task: Task) -> Result<(u64, bool), ReplayError> {
    let mut line = Recorded {
        frames: &run.frames,
        next: 0,
        now_us: 0,
        sent: 0,
        differs: None,
        ran_out: false,
    };
    let session = SessionId(run.scenario.session);
    let handle = Handle::scripted(run.orders.iter().copied());
    let homing = if run.scenario.at_home {
        Homing::Place(model.robot().tool.home_in_world_m)
    } else {
        Homing::Known
    };
    let outcome = Experiment::new(model, task)
        .session(session)
        .handle(&handle)
        .homing(homing)
        .run_on(&mut line);
    if let Some(what) = line.differs {
        return Err(differs("host", run, line.next, what));
    }
    let over = line.next == run.frames.len();
    if !over {
        let what = match outcome {
            Ok(_) => "it has ended".to_owned(),
            Err(error) => format!("it has ended: {error}"),
        };
        return Err(differs("host", run, line.next, what));
    }
    // A run that ended with a fault ends with it again; only a lack of record is incomplete.
    let whole = !(line.ran_out && matches!(outcome, Err(RunError::Client(_))));
    Ok((line.sent, whole))
}

fn core(run: &RecordedRun, mut robot: impl Link) -> Result<u64, ReplayError> {
    let mut bytes = 0;
    let mut answer = Vec::new();
    for (call, frame) in run.frames.iter().enumerate() {
        let failed = |error: LinkError| differs("core", run, call, error.to_string());
        match frame.direction {
            Direction::ToBoard => robot.send(&frame.bytes).map_err(failed)?,
            Direction::ToHost => {
                answer.clear();
                let time_us = robot.receive(frame.time_us, &mut answer).map_err(failed)?;
                if time_us != frame.time_us || answer != frame.bytes {
                    return Err(differs(
                        "core",
                        run,
                        call,
                        "it answers differently".to_owned(),
                    ));
                }
                bytes += answer.len() as u64;
            }
        }
    }
    Ok(bytes)
}

fn differs(who: &'static str, run: &RecordedRun, call: usize, what: String) -> ReplayError {
    let frame = run.frames.get(call).or(run.frames.last());
    ReplayError::Differs {
        who,
        time_s: frame.map_or(0.0, |frame| frame.time_us as f64 * 1e-6),
        call,
        what,
        program: run.scenario.program.clone(),
    }
}
