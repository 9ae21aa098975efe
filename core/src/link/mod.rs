//! Byte streams to a board, each with the clock that goes with it.
//!
//! A [`Link`] carries bytes and is the only clock that the host's logic reads: a serial port has
//! the machine's clock, the simulator has virtual time, a replay has the recorded one. So the same
//! host code runs on all of them, and a run can be repeated bit by bit from its bytes and times.

pub mod client;
pub mod clock;
mod error;
mod receiver;
mod tee;

pub use client::{Client, Event};
pub(crate) use client::{aside, check};
pub use clock::BoardClock;
pub use error::ClientError;
pub use tee::{Direction, RawFrame, Tee};

use miette::Diagnostic;
use thiserror::Error;

/// A byte stream to one board, and its clock.
pub trait Link {
    /// Time at which the last call returned, µs since the link was opened. Never runs backwards.
    fn now_us(&self) -> u64;

    /// Sends bytes now.
    ///
    /// # Errors
    /// The line is gone.
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError>;

    /// Waits until bytes have arrived or until `until_us`, whichever is first; appends the bytes
    /// to `into` and gives the time.
    ///
    /// # Errors
    /// The line is gone.
    fn receive(&mut self, until_us: u64, into: &mut Vec<u8>) -> Result<u64, LinkError>;

    /// Passes what the host knows besides the bytes. Only observed lines use it.
    fn note(&mut self, _note: Note<'_>) {}

    /// Whether its time runs while no call waits on the link: true for a real board, false for
    /// virtual time.
    fn goes_on(&self) -> bool {
        false
    }
}

/// What the host knows besides the bytes, for observers of a line.
#[derive(Debug, Clone, Copy)]
pub enum Note<'a> {
    /// The plan that is about to be run.
    Plan(&'a crate::motion::Plan),
    /// Text for the record.
    Remark(&'a str),
    /// A picture that was taken, with what was found in it.
    Picture(&'a crate::sight::Shown),
}

impl<L: Link + ?Sized> Link for &mut L {
    fn now_us(&self) -> u64 {
        (**self).now_us()
    }
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        (**self).send(bytes)
    }
    fn receive(&mut self, until_us: u64, into: &mut Vec<u8>) -> Result<u64, LinkError> {
        (**self).receive(until_us, into)
    }
    fn note(&mut self, note: Note<'_>) {
        (**self).note(note);
    }
    fn goes_on(&self) -> bool {
        (**self).goes_on()
    }
}

impl<L: Link + ?Sized> Link for Box<L> {
    fn now_us(&self) -> u64 {
        (**self).now_us()
    }
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        (**self).send(bytes)
    }
    fn receive(&mut self, until_us: u64, into: &mut Vec<u8>) -> Result<u64, LinkError> {
        (**self).receive(until_us, into)
    }
    fn note(&mut self, note: Note<'_>) {
        (**self).note(note);
    }
    fn goes_on(&self) -> bool {
        (**self).goes_on()
    }
}

/// Why a line to a board could not be opened.
#[derive(Debug, Error, Diagnostic)]
pub enum LinkError {
    /// There is no such port.
    #[error("there is no serial port {port}")]
    #[diagnostic(
        code(mcdpr::link::no_port),
        help("plug in the board's USB cable; `mcdpr ports` lists the ports that exist now{found}")
    )]
    NoPort {
        /// The port asked for.
        port: String,
        /// The existing ports.
        found: String,
    },
    /// The port is there, but another program has it.
    #[error("serial port {port} is taken by another program")]
    #[diagnostic(
        code(mcdpr::link::taken),
        help(
            "stop the other program (another mcdpr, a terminal, a modem manager), then try again"
        )
    )]
    Taken {
        /// The port asked for.
        port: String,
    },
    /// The port is there, but this user may not use it.
    #[error("no permission to open serial port {port}")]
    #[diagnostic(
        code(mcdpr::link::permission),
        help(
            "on Linux join the port's group, usually with `sudo usermod -aG dialout $USER`, and log in again"
        )
    )]
    Permission {
        /// The port asked for.
        port: String,
    },
    /// The path exists but is not a serial port.
    #[error("{port} cannot be opened as a serial port: {reason}")]
    #[diagnostic(
        code(mcdpr::link::unusable),
        help("`mcdpr ports` lists serial ports; `--on sim` needs none")
    )]
    Unusable {
        /// The port asked for.
        port: String,
        /// The system's message.
        reason: String,
    },
    /// The line was open and has failed.
    #[error("the line to the board broke: {reason}")]
    #[diagnostic(
        code(mcdpr::link::broken),
        help(
            "the board stops and holds by itself when it hears nothing for 100 ms; check cable and power, then connect again"
        )
    )]
    Broken {
        /// The system's message.
        reason: String,
    },
    /// Several boards do not make up the robot, or one of them failed.
    #[error("{what}")]
    #[diagnostic(code(mcdpr::link::boards), help("{help}"))]
    Boards {
        /// Which board, and what is wrong with it.
        what: String,
        /// What to do.
        help: String,
    },
    /// The simulated robot left the region in which its physics is valid.
    #[error("the simulated robot failed")]
    #[diagnostic(
        code(mcdpr::link::plant),
        help("the platform was driven into a pulley or its cables tangled; check the task")
    )]
    Plant(#[source] Box<dyn std::error::Error + Send + Sync>),
    /// The board in front of the simulated robot cannot go on.
    #[error("the board of the simulated robot stopped: {reason}")]
    #[diagnostic(
        code(mcdpr::link::board),
        help(
            "an emulated chip: what its firmware did wrong is named with its address. A board in the loop: see docs/hil.md. \
             Both drive robots of four winches"
        )
    )]
    Board {
        /// Why.
        reason: String,
    },
}
