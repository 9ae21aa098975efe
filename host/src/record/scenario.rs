//! The inputs of a run: everything needed to run it again.

use crate::machine::Mismatch;
use crate::motion::PlanOptions;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Source of a task.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TaskSource {
    /// Name of a built-in task, or of the task file.
    pub name: String,
    /// The file's text; `None` for a built-in task.
    pub text: Option<String>,
    /// Height of the tool for a built-in task, world, m.
    pub tool_z_m: f64,
}

impl TaskSource {
    /// The source of a task as it is asked for on the command line.
    #[must_use]
    pub fn of(name: &str, tool_z_m: f64) -> Self {
        let built_in = crate::motion::BUILT_IN
            .iter()
            .any(|(known, _)| *known == name);
        let text = (!built_in)
            .then(|| crate::files::read_text(name).ok())
            .flatten();
        Self {
            name: name.to_owned(),
            text,
            tool_z_m,
        }
    }
}

/// The machine in the run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Machine {
    /// A simulated robot in this process: it can be simulated again.
    Simulated {
        /// Its mismatch from its description.
        mismatch: Mismatch,
        /// Seed of everything random.
        seed: u64,
        /// CRC-32 of the firmware's file, where an emulated chip executed it; `None` for the
        /// control core in the program itself.
        firmware: Option<u32>,
    },
    /// A board behind a port.
    Port {
        /// Its name.
        name: String,
    },
}

/// Action of the host with the robot.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Doing {
    /// It ran a task: the record contains everything that it depended on.
    #[default]
    Task,
    /// It executed single orders, such as moves and jogs: its output depends on the user.
    Orders,
    /// It followed pictures.
    Pictures,
    /// People were involved: they pulled, rigged, hung weights, or turned a bare winch.
    Hands,
}

/// One text file of the robot's description.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RobotText {
    /// Path relative to the robot file's folder.
    pub name: String,
    /// Its contents.
    pub text: String,
}

/// The inputs of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Scenario {
    /// Version of the program.
    pub program: String,
    /// Version of the wire format, `major.minor`.
    pub protocol: String,
    /// Start, Unix time, µs.
    pub started_unix_us: u64,
    /// The command line after the program's name.
    pub arguments: Vec<String>,
    /// The robot's files, the robot file first.
    pub robot: Vec<RobotText>,
    /// The calibration that was applied to it, if any.
    #[serde(default)]
    pub calibration: Option<RobotText>,
    /// The task.
    pub task: TaskSource,
    /// Planning options.
    #[serde(default)]
    pub options: PlanOptions,
    /// Action of the host.
    #[serde(default)]
    pub doing: Doing,
    /// Whether the robot was stated to hang at home.
    #[serde(default)]
    pub at_home: bool,
    /// Number of the session on the wire.
    pub session: u32,
    /// The machine.
    pub machine: Machine,
}

impl Scenario {
    /// A scenario that starts now.
    #[must_use]
    pub fn new(robot: &str, task: TaskSource, session: u32, machine: Machine) -> Self {
        let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
        let started = since.map_or(0, |since| since.as_micros());
        Self {
            program: env!("CARGO_PKG_VERSION").to_owned(),
            protocol: protocol_version(),
            started_unix_us: u64::try_from(started).unwrap_or(0),
            arguments: std::env::args().skip(1).collect(),
            robot: robot_files(robot),
            calibration: None,
            task,
            options: PlanOptions::default(),
            doing: Doing::Task,
            at_home: false,
            session,
            machine,
        }
    }

    /// Writes the robot's files below a folder and returns the robot file's path.
    ///
    /// # Errors
    /// The system's; a name that leaves the folder is refused.
    pub(crate) fn lay_out_robot(&self, folder: &Path) -> std::io::Result<PathBuf> {
        let mut first = None;
        for file in &self.robot {
            // A record from elsewhere must not write outside of the folder.
            let inside = Path::new(&file.name)
                .components()
                .all(|part| matches!(part, std::path::Component::Normal(_)));
            if !inside {
                return Err(std::io::Error::other(format!(
                    "the record names a file outside its folder: {}",
                    file.name
                )));
            }
            let path = folder.join(&file.name);
            if let Some(parent) = path.parent() {
                std::fs::create_dir_all(parent)?;
            }
            std::fs::write(&path, &file.text)?;
            first.get_or_insert(path);
        }
        first.ok_or_else(|| std::io::Error::other("the record holds no robot file"))
    }

    /// Writes the calibration below a folder and returns its path, if one was applied.
    ///
    /// # Errors
    /// The system's.
    pub(crate) fn lay_out_calibration(&self, folder: &Path) -> std::io::Result<Option<PathBuf>> {
        let Some(file) = &self.calibration else {
            return Ok(None);
        };
        let path = folder.join("recorded.calibration.json");
        std::fs::write(&path, &file.text)?;
        Ok(Some(path))
    }
}

/// Version of the wire format that this program speaks.
#[must_use]
pub fn protocol_version() -> String {
    format!(
        "{}.{}",
        mcdpr_protocol::PROTOCOL_MAJOR,
        mcdpr_protocol::PROTOCOL_MINOR
    )
}

/// Texts of a robot file and of the winch modules that it names.
fn robot_files(name: &str) -> Vec<RobotText> {
    crate::robot::sources(name)
        .into_iter()
        .map(|(name, text)| RobotText { name, text })
        .collect()
}
