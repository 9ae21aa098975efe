//! The inputs of a run: everything needed to run it again.

use crate::plant::Mismatch;
use mcdpr_core::motion::PlanOptions;
use serde::{Deserialize, Serialize};

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
    /// A simulated robot in this process, in front of a board outside: its answers cannot be simulated
    /// again.
    InTheLoop {
        /// Its mismatch from its description.
        mismatch: Mismatch,
        /// Seed of everything random.
        seed: u64,
        /// The wires to the board.
        wires: String,
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

/// Version of the wire format that this program speaks.
#[must_use]
pub fn protocol_version() -> String {
    format!(
        "{}.{}",
        mcdpr_protocol::PROTOCOL_MAJOR,
        mcdpr_protocol::PROTOCOL_MINOR
    )
}
