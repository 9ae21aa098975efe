//! What an observer sees.

use crate::faults::describe_fault;
use mcdpr_protocol::{BoardState, Status};
use serde::{Deserialize, Serialize};

/// State of a robot that is being run, SI units; what is not known yet is `None` or empty.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct View {
    /// Grows with every change.
    pub revision: u64,
    /// The board's tick at which the values below were sampled.
    pub tick: u32,
    /// The board's state.
    pub state: Option<BoardState>,
    /// The task in progress.
    pub task: Option<String>,
    /// Whether a motion is held on its path.
    pub paused: bool,
    /// Path time reached, s.
    pub path_s: f64,
    /// Duration of the motion in progress, s.
    pub duration_s: f64,
    /// Paid-out length of each cable by its drum encoder, m.
    pub lengths_m: Vec<f64>,
    /// Commanded length of each cable, m.
    pub setpoints_m: Vec<f64>,
    /// Tension of each cable at its winch, N.
    pub tensions_n: Vec<f64>,
    /// Where the tool is planned to be now, world, m.
    pub tool_m: Option<[f64; 3]>,
    /// The latched fault, in words.
    pub fault: Option<String>,
    /// Whether the lengths are referenced.
    pub referenced: bool,
    /// Whether the gripper is commanded closed.
    pub gripper_closed: bool,
    /// Time from a heartbeat to its answer, s.
    pub round_trip_s: f64,
}

impl View {
    /// Takes over the values of a board's status.
    pub fn take_status(&mut self, status: &Status) {
        self.tick = status.tick.0;
        self.state = Some(status.state);
        self.lengths_m = status.lengths_m().collect();
        self.setpoints_m = status.setpoints_m().collect();
        self.tensions_n = status.tensions_n().collect();
        self.fault = status.fault.as_ref().map(describe_fault);
        self.referenced = status.referenced;
        self.gripper_closed = status.gripper_closed;
        if matches!(status.state, BoardState::Disarmed | BoardState::Fault) {
            self.paused = false;
        }
    }
}
