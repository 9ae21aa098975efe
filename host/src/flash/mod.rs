//! The board's firmware: its file is checked and tried on the emulated chip, then written through a
//! debug probe (feature `flash`).
//!
//! A file that is not firmware for this board is refused before any probe is searched for: no ELF
//! file, one for another machine or chip, a truncated one, and one that does not send its greeting
//! when an emulated chip executes it.

#[cfg(feature = "flash")]
mod probe;

#[cfg(feature = "flash")]
pub(crate) use probe::{probes, write};

use crate::experiment::SimulatedRobot;
use crate::link::{Client, ClientError, Link, LinkError};
use crate::machine::{Controller, Firmware, Mismatch};
use crate::motion::Model;
use crate::robot::Robot;
use mcdpr_protocol::{BoardState, Hello, Reject, Request, SessionId};
use miette::Diagnostic;
use thiserror::Error;

/// The chip's name, as debug tools call it.
pub(crate) const CHIP: &str = "STM32F103C8";

/// Why nothing was written, or why the board does not answer.
#[derive(Debug, Error, Diagnostic)]
pub enum FlashError {
    /// It is a program for such a chip, but not this board's.
    #[error("{path} is not firmware of this board: on an emulated chip {reason}")]
    #[diagnostic(
        code(mcdpr::flash::stranger),
        help("`cargo fw` builds the board's firmware; nothing was written")
    )]
    Stranger {
        /// The file.
        path: String,
        /// Its behaviour there.
        reason: String,
    },
    /// It speaks another protocol than this program.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Version(ClientError),
    /// This program cannot write a chip.
    #[cfg(not(feature = "flash"))]
    #[error("the file is good, but this mcdpr was built without `flash`")]
    #[diagnostic(
        code(mcdpr::flash::feature),
        help(
            "build it with `cargo build --release -p mcdpr --features flash`, or use `cargo flash-fw` (which needs probe-rs: https://probe.rs)"
        )
    )]
    NoFeature,
    /// No probe is plugged in.
    #[error("no debug probe is connected")]
    #[diagnostic(
        code(mcdpr::flash::no_probe),
        help(
            "plug an ST-Link/V2, a J-Link or a CMSIS-DAP v2 probe into USB, and wire SWDIO to PA13, SWCLK to PA14, GND to GND, 3.3 V to its reference (docs/wiring.md); the serial port of the board is not a probe"
        )
    )]
    NoProbe,
    /// Probes exist, but this user may not use them.
    #[error("no permission to use the probe {probe}")]
    #[diagnostic(
        code(mcdpr::flash::permission),
        help(
            "copy docs/99-mcdpr.rules to /etc/udev/rules.d/, reload udev, join the group plugdev, plug the probe in again"
        )
    )]
    Permission {
        /// The probe.
        probe: String,
    },
    /// Several probes are possible.
    #[error("there are several probes: {found}")]
    #[diagnostic(
        code(mcdpr::flash::several),
        help("say which with `--probe SERIAL`, or unplug the others")
    )]
    Several {
        /// The existing probes.
        found: String,
    },
    /// The requested probe does not exist.
    #[error("no probe has the serial number {asked}; there are: {found}")]
    #[diagnostic(
        code(mcdpr::flash::unknown_probe),
        help("`mcdpr flash --list` lists them")
    )]
    UnknownProbe {
        /// Asked for.
        asked: String,
        /// Those that are there.
        found: String,
    },
    /// The chip behind the probe is another one.
    #[error("the chip behind the probe is {found}, not an {CHIP}: nothing was written")]
    #[diagnostic(
        code(mcdpr::flash::chip),
        help(
            "use a board with an STM32F103C8 (\"blue pill\"); clones with other identities are not supported"
        )
    )]
    OtherChip {
        /// Its identification.
        found: String,
    },
    /// Probe or chip failed.
    #[error("{step}: {reason}")]
    #[diagnostic(
        code(mcdpr::flash::failed),
        help(
            "check SWDIO, SWCLK, GND and the board's 3.3 V, hold the wires short, press reset and try again; brakes stay closed meanwhile"
        )
    )]
    Failed {
        /// The operation.
        step: &'static str,
        /// The probe's message.
        reason: String,
    },
    /// Drives have torque, or may get it.
    #[error("the board is armed or held by another program: nothing was written")]
    #[diagnostic(
        code(mcdpr::flash::armed),
        help(
            "flashing resets the board: brakes close and the drives lose their commands in the middle of what they do; stop and disarm it first (`mcdpr stop --on PORT`)"
        )
    )]
    Armed,
    /// The firmware that answers after flashing is not the one that was written.
    #[error("the board that answers runs {board}, not the {file} that was written")]
    #[diagnostic(
        code(mcdpr::flash::another_board),
        help(
            "another board is on this port (`mcdpr ports`), or BOOT0 is set: the chip then does not start from flash"
        )
    )]
    NotStarted {
        /// The answering firmware's commit.
        board: String,
        /// The file's.
        file: String,
    },
}

/// Asks the board that will be written whether it is armed. If it does not answer, or has another
/// protocol version, it cannot be asked: the consequence is returned in words.
///
/// # Errors
/// [`FlashError::Armed`] if it is, or if another program holds it.
pub fn ask_before<L: Link>(
    link: L,
    session: SessionId,
) -> Result<Option<&'static str>, FlashError> {
    const UNKNOWN: &str = "no board answered whether the robot is armed: as soon as the chip is written its brakes close and its drives get no commands; hold the platform by other means";
    let mut client = match Client::connect(link, session) {
        Ok(client) => client,
        // Another program holds the board and may arm it at any time.
        Err(ClientError::Refused {
            reject: Reject::SessionHeld,
            ..
        }) => return Err(FlashError::Armed),
        Err(_) => return Ok(Some(UNKNOWN)),
    };
    let Ok(status) = crate::run::status(&mut client) else {
        return Ok(Some(UNKNOWN));
    };
    let rests = matches!(
        status.state,
        BoardState::Disarmed | BoardState::Fault | BoardState::EStop
    );
    if !rests || status.torque_on != 0 {
        return Err(FlashError::Armed);
    }
    // Ends the session; a board that refuses is about to be reset anyway.
    let _ = client.request(Request::Close);
    Ok(None)
}

/// A checked firmware file.
#[derive(Debug, Clone)]
pub(crate) struct Image {
    /// Bytes of flash from its start, without the erased rest.
    pub flash: Vec<u8>,
    /// Its greeting on the emulated chip.
    pub hello: Hello,
}

impl Image {
    /// Executes the file on an emulated chip with a robot around it, until it sends its greeting.
    ///
    /// # Errors
    /// [`FlashError::Stranger`], [`FlashError::Version`].
    pub(crate) fn examine(path: &str, firmware: &Firmware) -> Result<Self, FlashError> {
        let stranger = |reason: String| FlashError::Stranger {
            path: path.to_owned(),
            reason,
        };
        let robot = Robot::built_in("paper-table5").map_err(|error| stranger(error.to_string()))?;
        let model = Model::new(&robot).map_err(|error| stranger(error.to_string()))?;
        // Any robot does: only the greeting is awaited.
        let link = SimulatedRobot::new(Mismatch::default(), 1)
            .controller(&Controller::Chip(firmware.clone()))
            .at_home(&model)
            .map_err(|error| stranger(error.to_string()))?;
        let client = match Client::connect(link, SessionId(1)) {
            Ok(client) => client,
            Err(error @ ClientError::Version { .. }) => return Err(FlashError::Version(error)),
            Err(ClientError::Silent) => {
                return Err(stranger(
                    "it says no hello on the board's serial port".into(),
                ));
            }
            Err(ClientError::Link(LinkError::Broken { reason })) => return Err(stranger(reason)),
            Err(error) => return Err(stranger(error.to_string())),
        };
        Ok(Self {
            flash: firmware.flash(),
            hello: *client.hello(),
        })
    }

    /// The commit that it was built from, in words.
    #[must_use]
    pub(crate) fn commit(&self) -> String {
        crate::doctor::hash_of(&self.hello.git_hash).unwrap_or_else(|| "an unknown commit".into())
    }

    /// Whether this is the firmware that a board reports.
    ///
    /// # Errors
    /// [`FlashError::NotStarted`].
    pub(crate) fn is_what_answers(&self, hello: &Hello) -> Result<(), FlashError> {
        if hello.git_hash == self.hello.git_hash {
            return Ok(());
        }
        let board = crate::doctor::hash_of(&hello.git_hash);
        Err(FlashError::NotStarted {
            board: board.unwrap_or_else(|| "an unknown commit".into()),
            file: self.commit(),
        })
    }
}
