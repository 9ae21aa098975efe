//! Inputs and outputs of a tick, and the interface that a board implements.

use crate::config::Active;
use crate::kept::KeptLengths;
use crate::supervisor::State;
use mcdpr_protocol::{Bench, Info, Kept, Tick};

/// Last feedback of one drive.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
pub struct DriveInput {
    /// The drive accepts commands in the requested mode.
    pub ready: bool,
    /// The motor has torque, according to its feedback: the drive is enabled, or its current flows.
    pub torque: bool,
    /// The drive reports a fault.
    pub fault: bool,
    /// Milliseconds since its last feedback; `u16::MAX` if there was none.
    pub age_ms: u16,
    /// Motor position, counts.
    pub counts: i32,
    /// Motor speed, rpm.
    pub rpm: i16,
    /// Motor current, mA.
    pub current_ma: i16,
    /// The bus to all drives is off: none receives commands (D1).
    pub bus_off: bool,
    /// The drive warns (CiA 402).
    pub warning: bool,
    /// The drive reports that it, its motor or its supply is too hot (D6; CiA 402).
    pub over_temperature: bool,
    /// An object of its set-up that the drive refused (CiA 402).
    pub refused: Option<Refused>,
}

/// An object that a drive refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Refused {
    /// Index in bits 8 to 23, sub-index in bits 0 to 7.
    pub object: u32,
    /// The drive's abort code (CiA 301).
    pub code: u32,
}

/// Drives that answer on the bus.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
pub struct Scan {
    /// Every number has been asked.
    pub done: bool,
    /// Bit n of word m: drive 32 m + n answers.
    pub nodes: [u32; 4],
}

/// Measurements of this tick. `N` cables.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Inputs<const N: usize> {
    /// Drum encoder counters, wrapping.
    pub encoders: [u16; N],
    /// Tension channels: 0 to 65520 for 0 V to 3.3 V (12 bits, sixteen times oversampled).
    pub tension_adc: [u16; N],
    /// Drives.
    pub drives: [DriveInput; N],
    /// Drives that were found on the bus.
    pub scan: Scan,
    /// The emergency stop is pressed.
    pub e_stop: bool,
    /// The gripper's switch is closed.
    pub gripper_switch: bool,
    /// The tick started late (P5).
    pub overrun: bool,
    /// Errors that the serial line's receiver has counted since the last tick: framing, noise,
    /// overrun (L18).
    pub line_errors: u16,
    /// The fault line that all boards of a robot share is low: one of them is not well (L19).
    pub fault_line_low: bool,
}

impl<const N: usize> Default for Inputs<N> {
    fn default() -> Self {
        Self {
            encoders: [0; N],
            tension_adc: [0; N],
            drives: [DriveInput::default(); N],
            scan: Scan::default(),
            e_stop: false,
            gripper_switch: false,
            overrun: false,
            line_errors: 0,
            fault_line_low: false,
        }
    }
}

/// Demand on a drive. The bus behind it brings the drive into the mode.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
pub enum DriveDemand {
    /// No torque.
    #[default]
    Off,
    /// Be enabled in position mode, and hold the present position.
    EnablePosition,
    /// Be enabled in current mode, without current.
    EnableCurrent,
    /// Be enabled in speed mode, at rest.
    EnableSpeed,
    /// Go to this motor position, no faster than this.
    Position {
        /// Motor counts.
        counts: i32,
        /// Largest motor speed, rpm.
        rpm: u16,
    },
    /// Give this current.
    Current {
        /// Milliamperes.
        ma: i16,
    },
    /// Turn at this speed.
    Speed {
        /// Motor speed, rpm.
        rpm: i16,
    },
}

impl DriveDemand {
    /// Whether the drive gives torque.
    #[must_use]
    pub const fn gives_torque(self) -> bool {
        matches!(
            self,
            Self::Position { .. } | Self::Current { .. } | Self::Speed { .. }
        )
    }
}

/// Command to a spring-applied brake.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
pub enum Brake {
    /// Unpowered: the spring holds the drum.
    #[default]
    Closed,
    /// Powered: the drum is free.
    Open,
}

/// Outputs of a tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Outputs<const N: usize> {
    /// Drives.
    pub drives: [DriveDemand; N],
    /// Brakes.
    pub brakes: [Brake; N],
    /// Allow the drives their power: there is a configuration, and no emergency stop.
    pub drive_enable: bool,
    /// Close the gripper.
    pub gripper_closed: bool,
    /// Start a scan for drives on the bus.
    pub scan: bool,
    /// Send frames through the CAN controller and back, without the bus.
    pub can_loop: bool,
    /// Keep the fault line from falling: no fault is latched.
    pub well: bool,
}

impl<const N: usize> Default for Outputs<N> {
    fn default() -> Self {
        Self {
            drives: [DriveDemand::Off; N],
            brakes: [Brake::Closed; N],
            drive_enable: false,
            gripper_closed: false,
            scan: false,
            can_loop: false,
            well: false,
        }
    }
}

/// Bytes that a board keeps of its line: more than five ticks' worth at 921600 baud (92.16 bytes
/// each).
pub const RING: usize = 512;

/// The received bytes of a line. They are numbered from the start, wrapping; the last [`RING`] of
/// them can be read.
pub trait Line {
    /// Number of bytes received so far: the number of the next one.
    fn arrived(&mut self) -> u32;
    /// The byte with this number.
    fn byte(&self, number: u32) -> u8;
}

/// The board as [`Cycle`](crate::cycle::Cycle) needs it. Its [`Line`] is searched by the tick for
/// stops; below the tick, `link` reads it completely.
pub trait Board<const N: usize>: Line {
    /// Reads all inputs once, in place.
    fn read(&mut self, inputs: &mut Inputs<N>);
    /// Applies all outputs: pins at once, drives by their bus.
    fn apply(&mut self, now: Tick, config: Option<&Active<N>>, outputs: &Outputs<N>);
    /// Adds board-specific values to the core's identity.
    fn complete(&self, info: &mut Info);
    /// Adds board-specific values to a self-test, with the inputs of this tick. A simulation has no
    /// chip, and leaves zeros.
    fn measure(&mut self, report: &mut Bench, inputs: &Inputs<N>) {
        let _ = (report, inputs);
    }
    /// Stores the lengths of this tick where a reset leaves them; without them, makes the stored ones invalid.
    fn keep(&mut self, lengths: Option<&KeptLengths<N>>);
    /// Adds the lengths that were stored before the last reset.
    fn kept(&self, kept: &mut Kept);
    /// Shows the state to people near the board.
    fn show(&mut self, state: State, now: Tick) {
        let _ = (state, now);
    }
}
