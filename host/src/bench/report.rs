//! The self-test's result, and why it could not be completed.

use crate::doctor::Finding;
use crate::run::RunError;
use mcdpr_protocol::BoardState;
use miette::Diagnostic;
use serde::Serialize;
use thiserror::Error;

/// Why the self-test could not be completed.
#[derive(Debug, Error, Diagnostic)]
pub enum BenchError {
    /// The line, or the board.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Run(#[from] RunError),
    /// The board is in use.
    #[error("the board is {state:?}: a self-test is for a board without a robot")]
    #[diagnostic(
        code(mcdpr::bench::armed),
        help("stop and disarm it first (`mcdpr stop --on PORT`), and disconnect the drives")
    )]
    Armed {
        /// Its state.
        state: BoardState,
    },
    /// Another chip.
    #[error(
        "the chip identifies itself as 0x{id_code:08x}, not as an STM32F103x8: nothing was tested"
    )]
    #[diagnostic(
        code(mcdpr::bench::chip),
        help("use a board with an STM32F103C8; nothing is known of this one's pins")
    )]
    UnknownChip {
        /// Its identity.
        id_code: u32,
    },
    /// Another image than the file.
    #[error("the board runs firmware {board}, the file is {file}: nothing was tested")]
    #[diagnostic(
        code(mcdpr::bench::firmware),
        help(
            "`mcdpr flash FILE --on PORT` writes the file, or name the right one with --firmware"
        )
    )]
    OtherFirmware {
        /// The board's commit.
        board: String,
        /// The file's.
        file: String,
    },
    /// The board has no real chip.
    #[error("the simulator's board has no chip to test")]
    #[diagnostic(
        code(mcdpr::bench::no_chip),
        help("name a serial port with `--on PORT`, or the emulated chip with `--on chip`")
    )]
    NoChip,
}

/// Readings of an input channel of the converter.
#[derive(Debug, Clone, Serialize)]
pub struct Channel {
    /// Winch, 1 for the first.
    pub winch: usize,
    /// Mean and standard deviation, V.
    pub mean_v: f64,
    /// As above.
    pub sigma_v: f64,
    /// Readings in bins of one sigma about the mean: under -3, ..., over 3.
    pub histogram: [usize; 8],
    /// Encoder counts of the drum at the first reading, and the greatest change while it rested.
    pub drum_counts: i32,
    /// As above.
    pub flicker: i32,
}

/// Results of a self-test.
#[derive(Debug, Clone, Serialize)]
pub struct Report {
    /// The chip's serial number.
    pub serial: String,
    /// The commit of the firmware that runs.
    pub firmware: Option<String>,
    /// Part by part.
    pub findings: Vec<Finding>,
    /// The inputs, winch by winch.
    pub channels: Vec<Channel>,
    /// Greatest time of a control tick, core cycles.
    pub tick_cycles: u32,
    /// Stack that was never used, bytes.
    pub stack_free_bytes: u16,
    /// Supply, mV.
    pub supply_mv: u16,
    /// Slow oscillator, Hz.
    pub slow_hz: u32,
}

impl Report {
    /// Whether no part needs repair.
    #[must_use]
    pub fn passes(&self) -> bool {
        crate::doctor::is_healthy(&self.findings)
    }
}
