//! State of one drive, independent of its protocol.

use super::can::CanFrame;
use crate::config::{CableConfig, Control, TensionOutput};
use crate::io::{DriveDemand, DriveInput, Refused};

/// Modes that the core uses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// Position.
    Position,
    /// Current, or torque.
    Current,
    /// Speed.
    Speed,
}

impl Mode {
    /// The mode of a cable's drive: fixed by the configuration, entered when the board arms.
    #[must_use]
    pub const fn of(cable: &CableConfig) -> Self {
        match (cable.control, cable.output) {
            (Control::Length, _) => Self::Position,
            (Control::Tension, TensionOutput::Current) => Self::Current,
            (Control::Tension, TensionOutput::Speed) => Self::Speed,
        }
    }
}

/// The mode that a demand belongs to.
pub(super) const fn mode_of(demand: DriveDemand) -> Option<Mode> {
    match demand {
        DriveDemand::Off => None,
        DriveDemand::EnablePosition | DriveDemand::Position { .. } => Some(Mode::Position),
        DriveDemand::EnableCurrent | DriveDemand::Current { .. } => Some(Mode::Current),
        DriveDemand::EnableSpeed | DriveDemand::Speed { .. } => Some(Mode::Speed),
    }
}

/// Phase of a drive between power-on and operation.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    /// Unknown.
    #[default]
    Cold,
    /// It was reset.
    Waiting,
    /// It is being set up.
    Setup,
    /// It answers and gives no torque.
    Idle,
    /// It is entering its mode; for an RMDS, operation is assumed after a fixed time.
    Enabling,
    /// It has reported operation enabled (CiA 402).
    Enabled,
}

/// One drive.
#[derive(Debug, Default, Clone, Copy)]
pub(super) struct Drive {
    pub node: u8,
    pub phase: Phase,
    /// Milliseconds left of the phase's waiting time.
    pub timer: u16,
    /// Index in its set-up (CiA 402).
    pub step: u8,
    pub input: DriveInput,
    /// Status word (CiA 402).
    pub status: u16,
    /// Mode reported by the drive (CiA 402).
    pub mode: u8,
    /// Requested mode (CiA 402).
    pub wanted_mode: u8,
    /// It reports its actual mode (CiA 402).
    pub tells_mode: bool,
    /// It acts on commands at SYNC, not at once (CiA 402).
    pub at_sync: bool,
    /// An object that it refused (CiA 402).
    pub refused: Option<Refused>,
    /// Last emergency code, 0 after it has ended (CiA 402).
    pub emergency: u16,
    /// Motor current at a thousand thousandths of torque, mA (CiA 402).
    pub rated_ma: i32,
    /// Milliseconds since the last heartbeat (CiA 402).
    pub quiet_ms: u16,
    /// Milliseconds since the last feedback, for its speed (CiA 402).
    pub since_ms: u16,
    /// Milliseconds between two feedbacks.
    pub period_ms: u16,
    /// Motor rpm per count in a millisecond, 16 fractional bits (CiA 402).
    pub rpm_per_count_q16: i32,
}

/// A frame to send, and the drive's state after it is sent.
pub(super) struct Step {
    pub frame: CanFrame,
    pub then: Phase,
    pub timer: u16,
}

impl Step {
    pub const fn new(frame: CanFrame, then: Phase, timer: u16) -> Self {
        Self { frame, then, timer }
    }
}
