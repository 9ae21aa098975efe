//! Faults of a simulated robot: at the plant, the drive bus, the pins, the line or the host's program,
//! never inside the controller.

mod inject;
mod line;
mod parse;
pub mod rows;
pub mod survey;

pub use inject::{How, how};
pub use line::FaultyLink;
pub use parse::ScenarioError;

use mcdpr_protocol::FaultId;

/// Start of a fault.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum When {
    /// Before the host connects: the robot hangs on its brakes.
    Start,
    /// This long after the motion has begun, s.
    Motion(f64),
    /// This long after the board has entered this phase, s.
    After(Phase, f64),
}

/// Phases of a board around a motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    /// It arms for the first time.
    Arming,
    /// Its brakes have opened while it arms for the first time: it turns its drums a little.
    Stirring,
    /// It holds under tension for the first time.
    Holding,
    /// It stops after the motion: brakes close under torque.
    Stopping,
    /// Its brakes have begun to close in this stop; torque is still on.
    Closing,
    /// Its brakes are closed and its torque is off after the motion.
    Parked,
    /// It arms for the second time.
    Rearming,
}

impl Phase {
    /// Every phase.
    pub const ALL: [Self; 7] = [
        Self::Arming,
        Self::Stirring,
        Self::Holding,
        Self::Stopping,
        Self::Closing,
        Self::Parked,
        Self::Rearming,
    ];

    /// Its name, as the command line takes it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Arming => "arming",
            Self::Stirring => "stirring",
            Self::Holding => "holding",
            Self::Stopping => "stopping",
            Self::Closing => "closing",
            Self::Parked => "parked",
            Self::Rearming => "rearming",
        }
    }
}

/// One fault to inject.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Injection {
    /// The row of `docs/faults.md`.
    pub fault: FaultId,
    /// The cable, 0 for the first; ignored if the whole robot fails.
    pub cable: usize,
    /// When.
    pub when: When,
    /// Strength, 1 as described by [`How`]: slips, offsets and rates are multiplied by it.
    pub strength: f64,
    /// After this time the cause disappears by itself, s; `None` for never.
    pub lasts_s: Option<f64>,
    /// A stiff hook catches the platform, which is a realistic cause of C2: instead of the
    /// injection that [`How`] describes for that row.
    pub snag: Option<Snag>,
    /// A supply is gone: instead of what [`How`] says of the row.
    pub supply: Option<Supply>,
}

/// Whose supply is gone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Supply {
    /// The board's; drives and brakes keep theirs, and the brakes close because nothing holds them
    /// open.
    Board,
    /// That of drives and brakes; the board keeps its own.
    Drives,
    /// The computer's: the host falls silent.
    Host,
    /// All of them.
    All,
    /// The board's, which only dips: its voltage detector resets the board, which keeps what a reset leaves.
    Dip,
    /// None: a fault of the program resets the board (P4).
    Crash,
}

impl Supply {
    /// Every supply, with its name on the command line.
    pub const ALL: [(Self, &'static str); 6] = [
        (Self::Board, "board"),
        (Self::Drives, "drives"),
        (Self::Host, "host"),
        (Self::All, "all"),
        (Self::Dip, "dip"),
        (Self::Crash, "crash"),
    ];
}

/// Where a hook holds the platform.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Snag {
    /// It holds the tool where it is.
    Fast,
    /// It holds the tool against motion along this direction, world.
    Against([f64; 3]),
}

/// Some faults, in one run.
#[derive(Debug, Clone, PartialEq)]
pub struct Scenario {
    /// Its name.
    pub name: String,
    /// The faults.
    pub injections: Vec<Injection>,
}

/// Greatest size of a scenario.
const MOST_INJECTIONS: usize = 32;
