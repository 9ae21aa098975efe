//! A recorded run, read back.

use super::mcap::{self, Damage, ReadError};
use super::pack::unpack;
use super::{FILE_NAME, RobotText, Scenario, WIRE};
use crate::decode::{Decoder, Seen, Tick};
use crate::events::{PlanNote, TruthPoint};
use mcdpr_core::control::ScriptedOrder;
use mcdpr_core::faults::describe_fault;
use mcdpr_core::link::RawFrame;
use mcdpr_core::robot::{ModuleFiles, Robot, RobotError};
use mcdpr_protocol::Status;
use miette::Diagnostic;
use serde::Serialize;
use std::path::PathBuf;
use thiserror::Error;

/// Why a run cannot be read.
#[derive(Debug, Error, Diagnostic)]
pub enum LoadError {
    /// There is no such file.
    #[error("there is no recorded run at {path}: {reason}")]
    #[diagnostic(
        code(mcdpr::record::missing),
        help("name a run's folder (runs/DATE-TIME-NAME) or its {FILE_NAME}")
    )]
    Missing {
        /// Where.
        path: PathBuf,
        /// The system's message.
        reason: String,
    },
    /// It is not an MCAP file.
    #[error("{path} cannot be read")]
    #[diagnostic(
        code(mcdpr::record::unreadable),
        help("a record of this program starts with the MCAP magic; was the file overwritten?")
    )]
    Unreadable {
        /// Where.
        path: PathBuf,
        /// Why not.
        source: ReadError,
    },
    /// It is an MCAP file with other content.
    #[error("{path} is not a record of a run: {reason}")]
    #[diagnostic(
        code(mcdpr::record::other),
        help("it must hold the attachment scenario.json and the wire's bytes")
    )]
    Other {
        /// Where.
        path: PathBuf,
        /// What is missing.
        reason: String,
    },
    /// Another version wrote it.
    #[error(
        "{path} was recorded with protocol {theirs}, this program speaks {}",
        super::scenario::protocol_version()
    )]
    #[diagnostic(
        code(mcdpr::record::version),
        help(
            "use mcdpr {program}, which recorded it; its JSON topics can be read by any MCAP tool"
        )
    )]
    Version {
        /// Where.
        path: PathBuf,
        /// The protocol of the record.
        theirs: String,
        /// The program that wrote it.
        program: String,
    },
}

/// Something that the board measured or reported.
#[derive(Debug, Clone)]
pub struct Report {
    /// The link's time, s.
    pub time_s: f64,
    /// The measurement or the report.
    pub seen: Seen,
}

/// A change of the board's state, or a fault.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Change {
    /// The link's time, s.
    pub time_s: f64,
    /// The new state, or the fault in words.
    pub text: String,
}

/// A message of the log.
#[derive(Debug, Clone, PartialEq)]
pub struct LogLine {
    /// Time since the start of the record, s.
    pub time_s: f64,
    /// Foxglove's level: 2 info, 3 warning, 4 error.
    pub level: u64,
    /// The text.
    pub text: String,
}

/// A recorded run.
#[derive(Debug, Clone)]
pub struct RecordedRun {
    /// The file.
    pub path: PathBuf,
    /// What was run.
    pub scenario: Scenario,
    /// Calls of the line in order, with the link's times.
    pub frames: Vec<RawFrame>,
    /// The plan, if there was one; several motions one after another in path time.
    pub plan: Option<PlanNote>,
    /// True states of a simulated robot.
    pub truth: Vec<TruthPoint>,
    /// Orders during the run.
    pub orders: Vec<ScriptedOrder>,
    /// The log.
    pub log: Vec<LogLine>,
    /// Whether the file is complete.
    pub damage: Option<Damage>,
    /// Calls of the line that are missing inside the record (its watcher did not keep up, or a
    /// part is corrupt).
    pub gaps: u64,
}

impl RecordedRun {
    /// Reads the bytes of a record; `path` names it in messages.
    ///
    /// # Errors
    /// [`LoadError`]. A file that is cut short or partly corrupt is read as far as it goes.
    pub fn parse(bytes: &[u8], path: PathBuf) -> Result<Self, LoadError> {
        let contents = mcap::read(bytes).map_err(|source| LoadError::Unreadable {
            path: path.clone(),
            source,
        })?;
        let other = |reason: &str| LoadError::Other {
            path: path.clone(),
            reason: reason.to_owned(),
        };
        let about = contents.metadata.get("mcdpr");
        let theirs = about.and_then(|table| table.get("protocol"));
        // Before the scenario is read: another version may have another one.
        if let Some(theirs) = theirs
            && *theirs != super::scenario::protocol_version()
        {
            let program = about.and_then(|table| table.get("program"));
            return Err(LoadError::Version {
                path,
                theirs: theirs.clone(),
                program: program.cloned().unwrap_or_default(),
            });
        }
        let scenario = contents
            .attachment("scenario.json")
            .ok_or_else(|| other("it has no scenario"))?;
        let scenario: Scenario = serde_json::from_slice(scenario)
            .map_err(|error| other(&format!("its scenario is malformed: {error}")))?;
        let mut run = Self {
            path,
            frames: Vec::new(),
            plan: None,
            truth: Vec::new(),
            orders: Vec::new(),
            log: Vec::new(),
            damage: contents.damage.clone(),
            gaps: 0,
            scenario,
        };
        let start_ns = run.scenario.started_unix_us.saturating_mul(1000);
        let mut next_call = 0_u32;
        // Of several motions one after another, each continues in path time where the last ended.
        let mut before_s = 0.0;
        for message in &contents.messages {
            let time_ns = message.log_time_ns.saturating_sub(start_ns);
            match contents.topic(message.channel) {
                Some(WIRE) => {
                    let Some((first, frames)) = unpack(&message.data) else {
                        run.gaps += 1;
                        continue;
                    };
                    // Numbers that are left out are calls that the watcher missed.
                    run.gaps += u64::from(first.wrapping_sub(next_call));
                    next_call = first.wrapping_add(u32::try_from(frames.len()).unwrap_or(0));
                    run.frames.extend(frames);
                }
                Some("/plan") => {
                    if let Ok(plan) = serde_json::from_slice(&message.data) {
                        before_s = run.plan.as_ref().map_or(0.0, |plan| plan.duration_s);
                        run.add_plan(plan);
                    }
                }
                Some("/truth") => {
                    let truth: Option<TruthPoint> = serde_json::from_slice(&message.data).ok();
                    run.truth.extend(truth.map(|mut truth| {
                        if truth.path_s > 0.0 {
                            truth.path_s += before_s;
                        }
                        truth
                    }));
                }
                Some("/order") => {
                    let line: serde_json::Value =
                        serde_json::from_slice(&message.data).unwrap_or_default();
                    let order = serde_json::from_value(line["order"].clone()).ok();
                    let ordered = line["looks"].as_u64().zip(order);
                    let scripted = |(polls, order)| ScriptedOrder { polls, order };
                    run.orders.extend(ordered.map(scripted));
                }
                Some("/log") => {
                    let line: serde_json::Value =
                        serde_json::from_slice(&message.data).unwrap_or_default();
                    run.log.push(LogLine {
                        time_s: time_ns as f64 * 1e-9,
                        level: line["level"].as_u64().unwrap_or(0),
                        text: line["message"].as_str().unwrap_or_default().to_owned(),
                    });
                }
                _ => {}
            }
        }
        Ok(run)
    }

    fn add_plan(&mut self, plan: PlanNote) {
        let Some(all) = &mut self.plan else {
            self.plan = Some(plan);
            return;
        };
        let before_s = all.duration_s;
        all.duration_s += plan.duration_s;
        all.points.extend(plan.points.into_iter().map(|mut point| {
            point.time_s += before_s;
            point
        }));
    }

    /// The robot as its files describe it; a calibration is not applied.
    ///
    /// # Errors
    /// What is wrong with the robot file.
    pub fn designed_robot(&self) -> Result<Robot, RobotError> {
        let files = &self.scenario.robot;
        let (name, text) = files.first().map_or(("the record", ""), |file| {
            (file.name.as_str(), file.text.as_str())
        });
        Robot::parse(text, name, &Modules(files))
    }

    /// Everything that the board measured and reported.
    #[must_use]
    pub fn seen(&self) -> Vec<Report> {
        let mut decoder = Decoder::default();
        let mut all = Vec::new();
        for frame in &self.frames {
            let time_s = frame.time_us as f64 * 1e-6;
            let seen = decoder.take(frame).into_iter();
            all.extend(seen.map(|seen| Report { time_s, seen }));
        }
        all
    }

    /// Measurements, tick by tick.
    #[must_use]
    pub fn ticks(&self) -> Vec<Tick> {
        let mut ticks: Vec<Tick> = Vec::new();
        for Report { seen, .. } in self.seen() {
            if let Seen::Ticks(block) = seen {
                ticks.extend(block);
            }
        }
        ticks
    }

    /// Changes of state and faults.
    #[must_use]
    pub fn changes(&self) -> Vec<Change> {
        let mut changes = Vec::new();
        let mut last: Option<Status> = None;
        for Report { time_s, seen } in self.seen() {
            let Seen::Status(status) = seen else { continue };
            if last
                .as_ref()
                .is_none_or(|before| before.state != status.state)
            {
                let text = format!("{:?}", status.state);
                changes.push(Change { time_s, text });
            }
            let before = last.as_ref().and_then(|before| before.fault);
            if let Some(fault) = status.fault.filter(|fault| before != Some(*fault)) {
                let text = format!("fault {}", describe_fault(&fault));
                changes.push(Change { time_s, text });
            }
            last = Some(status);
        }
        changes
    }

    /// Duration of the record, s.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.frames
            .last()
            .map_or(0.0, |frame| frame.time_us as f64 * 1e-6)
    }
}

/// Winch modules in a record.
struct Modules<'a>(&'a [RobotText]);

impl ModuleFiles for Modules<'_> {
    fn open(&self, asked: &str) -> Result<(String, String), (String, String)> {
        let found = self.0.iter().find(|file| file.name == asked);
        found
            .map(|file| (file.name.clone(), file.text.clone()))
            .ok_or_else(|| {
                let what = format!("the record has no winch module \"{asked}\"");
                (
                    what,
                    "another program wrote it, or it was changed".to_owned(),
                )
            })
    }
}
