//! What the board knows of one drive, whatever it speaks.

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
    /// The one mode of a cable's drive: fixed by the configuration, entered when the board arms.
    #[must_use]
    pub const fn of(cable: &CableConfig) -> Self {
        match (cable.control, cable.output) {
            (Control::Length, _) => Self::Position,
            (Control::Tension, TensionOutput::Current) => Self::Current,
            (Control::Tension, TensionOutput::Speed) => Self::Speed,
        }
    }
}

/// The mode that a demand is of.
pub(super) const fn mode_of(demand: DriveDemand) -> Option<Mode> {
    match demand {
        DriveDemand::Off => None,
        DriveDemand::EnablePosition | DriveDemand::Position { .. } => Some(Mode::Position),
        DriveDemand::EnableCurrent | DriveDemand::Current { .. } => Some(Mode::Current),
        DriveDemand::EnableSpeed | DriveDemand::Speed { .. } => Some(Mode::Speed),
    }
}

/// Where a drive is between power and obedience.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    /// Nothing is known of it.
    #[default]
    Cold,
    /// It was reset.
    Waiting,
    /// It is being set up.
    Setup,
    /// It answers and gives no torque.
    Idle,
    /// It enters its mode; an RMDS that had its time obeys.
    Enabling,
    /// It has said that it obeys (CiA 402).
    Enabled,
}

/// One drive.
#[derive(Debug, Default, Clone, Copy)]
pub(super) struct Drive {
    pub node: u8,
    pub phase: Phase,
    /// Milliseconds left of what the phase waits for.
    pub timer: u16,
    /// Where in its set-up it is (CiA 402).
    pub step: u8,
    pub input: DriveInput,
    /// Status word (CiA 402).
    pub status: u16,
    /// Mode that the drive says it is in (CiA 402).
    pub mode: u8,
    /// Mode that it shall be in (CiA 402).
    pub wanted_mode: u8,
    /// It reports the mode that it is in (CiA 402).
    pub tells_mode: bool,
    /// It acts on commands at SYNC, not at once (CiA 402).
    pub at_sync: bool,
    /// An object that it refused (CiA 402).
    pub refused: Option<Refused>,
    /// Last emergency code, 0 where it is over (CiA 402).
    pub emergency: u16,
    /// Motor current of a thousand thousandths of torque, mA (CiA 402).
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

/// A frame to send, and what it makes of the drive once it is on its way.
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
