//! Hardware in the loop: a real board in front of the simulated drives and the simulated robot.
//!
//! Three wires lead to the board: its own line to the host, its CAN bus (`can`), and the line to a
//! second board that stands for encoders, sensors and switches (`signals`). The board cannot tell
//! this from a robot. The emulated chip can stand in for it, behind the same three wires
//! (`emulated`). `docs/hil.md` has the second board's requirements.

mod board;
mod can;
#[cfg(all(unix, feature = "emulator"))]
pub(crate) mod emulated;
mod port;
mod signals;
mod slcan;

pub(crate) use board::HilBoard;

use miette::Diagnostic;
use thiserror::Error;

/// How `--on` begins for a board in the loop.
const PREFIX: &str = "hil:";

/// Why a board cannot be taken into the loop, or left it.
#[derive(Debug, Error, Diagnostic)]
pub enum HilError {
    /// `--on hil:` names another number of wires.
    #[error("--on {given}: three wires are needed, not {found}")]
    #[diagnostic(
        code(mcdpr::hil::wires),
        help(
            "give the board's own port, its CAN bus (a network interface such as can0, or the port of an slcan adapter) \
             and the port of the signal board: --on hil:PORT,CAN,PORT; see docs/hil.md"
        )
    )]
    Wires {
        /// The option's value.
        given: String,
        /// How many wires it names.
        found: usize,
    },
    /// A wire cannot be opened or no longer works.
    #[error("{what} {name}: {reason}")]
    #[diagnostic(code(mcdpr::hil::wire), help("{help}"))]
    Wire {
        /// Which wire.
        what: &'static str,
        /// Its name.
        name: String,
        /// What happened.
        reason: String,
        /// What to do.
        help: String,
    },
}

impl HilError {
    /// A wire that fails.
    fn wire(what: &'static str, name: &str, reason: impl ToString, help: &str) -> Self {
        Self::Wire {
            what,
            name: name.to_owned(),
            reason: reason.to_string(),
            help: help.to_owned(),
        }
    }
}

/// The three wires to a board, by name.
#[derive(Debug, Clone, PartialEq)]
pub struct Wires {
    /// Serial port of the board itself.
    pub line: String,
    /// Its CAN bus: a network interface, or the serial port of an adapter that speaks slcan.
    pub can: String,
    /// Serial port of the signal board.
    pub signals: String,
    /// Simulated seconds per second: 1 for a real board.
    pub time_scale: f64,
}

impl std::fmt::Display for Wires {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self {
            line, can, signals, ..
        } = self;
        write!(formatter, "{line},{can},{signals}")
    }
}

impl Wires {
    /// Whether `--on` names a board in the loop.
    #[must_use]
    pub(crate) fn is_meant(on: &str) -> bool {
        on.starts_with(PREFIX)
    }

    /// From `hil:PORT,CAN,PORT`.
    ///
    /// # Errors
    /// [`HilError::Wires`].
    pub fn parse(on: &str, time_scale: f64) -> Result<Self, HilError> {
        let names = on.strip_prefix(PREFIX).unwrap_or(on).split(',');
        let names: Vec<&str> = names.map(str::trim).collect();
        match names.as_slice() {
            [line, can, signals] if names.iter().all(|name| !name.is_empty()) => Ok(Self {
                line: (*line).to_owned(),
                can: (*can).to_owned(),
                signals: (*signals).to_owned(),
                time_scale,
            }),
            _ => Err(HilError::Wires {
                given: on.to_owned(),
                found: names.iter().filter(|name| !name.is_empty()).count(),
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_wires_are_a_board_and_two_are_none() {
        let wires = Wires::parse("hil:/dev/ttyUSB0, can0,/dev/ttyACM1", 1.0).unwrap();
        assert_eq!(
            (
                wires.line.as_str(),
                wires.can.as_str(),
                wires.signals.as_str()
            ),
            ("/dev/ttyUSB0", "can0", "/dev/ttyACM1")
        );
        for (bad, found) in [
            ("hil:", 0),
            ("hil:a,b", 2),
            ("hil:a,,c", 2),
            ("hil:a,b,c,d", 4),
        ] {
            let error = Wires::parse(bad, 1.0).unwrap_err().to_string();
            assert!(error.contains(&format!("not {found}")), "{error}");
        }
    }
}
