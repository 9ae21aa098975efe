//! Why a board did not execute a request, in words with a remedy.

use super::LinkError;
use crate::faults::{describe_reject, reject_advice};
use mcdpr_protocol::{PROTOCOL_MAJOR, PROTOCOL_MINOR, Reject};
use miette::Diagnostic;
use thiserror::Error;

/// Why a board did not execute a request.
#[derive(Debug, Error, Diagnostic)]
pub enum ClientError {
    /// The line is gone.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Link(#[from] LinkError),
    /// No answer.
    #[error("no board answers on this line")]
    #[diagnostic(
        code(mcdpr::board::silent),
        help(
            "check that the board has power, that this is its port (`mcdpr ports`) and that RX and TX are not swapped; flash it with `cargo flash-fw` if it never ran"
        )
    )]
    Silent,
    /// The board stopped answering.
    #[error("the board stopped answering ({waiting} unanswered)")]
    #[diagnostic(
        code(mcdpr::board::lost),
        help("it stops and holds by itself; check cable and power, then connect again")
    )]
    Lost {
        /// The request that waits longest.
        waiting: String,
    },
    /// The board's clock ran backwards.
    #[error("the board's clock ran back by {by_ms:.0} ms: it is not the board that it was")]
    #[diagnostic(
        code(mcdpr::board::clock),
        help(
            "it may have restarted; its brakes are closed then: connect again. For a `sim --pty --time-scale X`, give the same --time-scale"
        )
    )]
    ClockRanBack {
        /// By how much, ms.
        by_ms: f64,
    },
    /// The board speaks another version of the wire format.
    #[error(
        "the board speaks protocol {board_major}.{board_minor}, this program speaks {PROTOCOL_MAJOR}.{PROTOCOL_MINOR}: nothing was moved"
    )]
    #[diagnostic(code(mcdpr::board::version), help("{remedy}"))]
    Version {
        /// The board's.
        board_major: u16,
        /// The board's.
        board_minor: u16,
        /// What to do.
        remedy: &'static str,
    },
    /// The board answered a request with what belongs to another one.
    #[error("the board's answer to {request} is that to another request")]
    #[diagnostic(
        code(mcdpr::board::answer),
        help("nothing is assumed from it: give the command again; if it comes back, report it")
    )]
    Answer {
        /// What was asked.
        request: String,
    },
    /// The board refused a request.
    #[error("the board refused {request}: {}", describe_reject(reject))]
    #[diagnostic(code(mcdpr::board::refused), help("{}", reject_advice(reject)))]
    Refused {
        /// What was asked.
        request: String,
        /// Why not.
        reject: Reject,
    },
}
