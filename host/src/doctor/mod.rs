//! Checks of a board, its drives and its sensors from the host, part by part, before anything
//! moves: each with the finding and the remedy.
//!
//! Nothing here gives torque or opens a brake, and no attached cables are assumed. Checks that need
//! motion (that an encoder counts, that a brake holds a motor) are part of arming, which the board
//! does by itself.

pub(crate) mod parts;

use crate::link::{Client, Link, advice, describe_fault};
use crate::robot::Robot;
use crate::run::{self, RunError};
use mcdpr_protocol::{BoardState, PROTOCOL_MAJOR, PROTOCOL_MINOR, Status};
use serde::Serialize;

/// State of a part.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// As required.
    Good,
    /// It works, with a remark.
    Note,
    /// It must be repaired before the robot may move.
    Bad,
    /// It could not be checked.
    Unseen,
}

/// One part, the finding, and the remedy.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Finding {
    /// The part.
    pub part: &'static str,
    /// Cable and winch, 1 for the first; `None` for parts that the board has only one of.
    pub cable: Option<usize>,
    /// Its state.
    pub verdict: Verdict,
    /// The finding.
    pub found: String,
    /// The remedy, if there is one.
    pub remedy: Option<String>,
}

impl Finding {
    /// A part of the board as a whole that is as required.
    #[must_use]
    pub fn good(part: &'static str, found: impl Into<String>) -> Self {
        Self {
            part,
            cable: None,
            verdict: Verdict::Good,
            found: found.into(),
            remedy: None,
        }
    }

    /// A part with another verdict, and its remedy.
    #[must_use]
    pub fn with(
        verdict: Verdict,
        part: &'static str,
        found: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self {
            verdict,
            remedy: Some(remedy.into()),
            ..Self::good(part, found)
        }
    }

    /// The same for one cable, from 0.
    #[must_use]
    fn of(self, index: usize) -> Self {
        Self {
            cable: Some(index + 1),
            ..self
        }
    }
}

/// Checks everything behind this client, in the order in which a builder would repair it.
///
/// Sends the robot's configuration (a board that already has it keeps its reference lengths), and
/// changes nothing else.
///
/// # Errors
/// The line's: a board that stops answering during the check.
pub fn examine<L: Link>(client: &mut Client<L>, robot: &Robot) -> Result<Vec<Finding>, RunError> {
    let mut findings = vec![identity(client)];
    findings.push(start(client));
    let status = run::status(client)?;
    findings.push(state(&status));
    findings.extend(protocols(client, robot));
    let configured = configuration(client, robot, &status)?;
    let usable = configured.verdict == Verdict::Good;
    findings.push(configured);
    // Without a configuration the board knows neither drives nor sensors.
    if usable {
        findings.extend(parts::drives(client, robot)?);
        let watched = parts::watch(client, robot)?;
        findings.extend(parts::encoders(&watched));
        findings.extend(parts::tensions(&watched, robot));
        findings.push(parts::brakes(&run::status(client)?));
    }
    findings.push(line(client));
    Ok(findings)
}

/// Whether no part needs repair.
#[must_use]
pub(crate) fn is_healthy(findings: &[Finding]) -> bool {
    findings.iter().all(|f| f.verdict != Verdict::Bad)
}

/// A fault found by arming, as a finding.
#[must_use]
pub(crate) fn arming_fault(record: &mcdpr_protocol::FaultRecord) -> Finding {
    let remedy = format!("{}; then `mcdpr clear --on PORT`", advice(record.fault));
    let finding = Finding::with(Verdict::Bad, "arming", describe_fault(record), remedy);
    match usize::from(record.cable) {
        0 => finding,
        cable => finding.of(cable - 1),
    }
}

fn identity<L: Link>(client: &Client<L>) -> Finding {
    let hello = client.hello();
    let id: String = hello.board_id.iter().map(|b| format!("{b:02x}")).collect();
    let firmware = match hash_of(&hello.git_hash) {
        Some(hash) => format!("firmware {hash}"),
        None => "firmware of no known commit".to_owned(),
    };
    // A protocol other than this program's ends the connection before any check.
    Finding::good(
        "board",
        format!(
            "{id}, {firmware}, protocol {}.{} as this program's {PROTOCOL_MAJOR}.{PROTOCOL_MINOR}",
            hello.major, hello.minor
        ),
    )
}

/// The commit that a board's firmware was built from, if it is known.
#[must_use]
pub fn hash_of(bytes: &[u8; 8]) -> Option<String> {
    let text: String = bytes
        .iter()
        .take_while(|byte| byte.is_ascii_alphanumeric())
        .map(|byte| char::from(*byte))
        .collect();
    (!text.is_empty()).then_some(text)
}

fn start<L: Link>(client: &Client<L>) -> Finding {
    use mcdpr_protocol::ResetCause::{Panic, Unknown, Watchdog};
    let cause = client.hello().reset_cause;
    let last = String::from_utf8_lossy(&client.info().last_panic).into_owned();
    let found = format!("started by: {cause:?}");
    match cause {
        Panic | Watchdog => Finding::with(
            Verdict::Note,
            "start",
            if last.is_empty() {
                found
            } else {
                format!("{found}; its last words: {last}")
            },
            "the firmware failed or hung: keep this text and report it; the outputs were safe meanwhile",
        ),
        Unknown => Finding::with(
            Verdict::Note,
            "start",
            found,
            "check the supply: a chip that does not know why it started has seen dips",
        ),
        _ => Finding::good("start", found),
    }
}

fn state(status: &Status) -> Finding {
    if status.state == BoardState::EStop {
        return Finding::with(
            Verdict::Bad,
            "state",
            "the emergency stop is pressed",
            "look around, release it, then `mcdpr clear --on PORT`",
        );
    }
    if let Some(record) = status.fault {
        return Finding::with(
            Verdict::Bad,
            "state",
            format!("a fault is latched, {}", describe_fault(&record)),
            format!("{}; then `mcdpr clear --on PORT`", advice(record.fault)),
        );
    }
    let lengths = if status.referenced {
        "knows its cable lengths"
    } else {
        "does not know its cable lengths (after a loss of power `mcdpr recover`, else `mcdpr home`)"
    };
    Finding::good("state", format!("{:?}, {lengths}", status.state))
}

/// The drives' protocols named by the robot file and supported by the firmware.
fn protocols<L: Link>(client: &Client<L>, robot: &Robot) -> Option<Finding> {
    use crate::robot::DriveKind;
    let spoken = client.info().drive_kinds;
    let wanted = robot.winches.first()?.drive;
    let (bit, name) = match wanted {
        DriveKind::Rmds => (1, "rmds"),
        DriveKind::Cia402 => (2, "cia402"),
    };
    // The core in this process reports no kinds.
    (spoken != 0 && spoken & (1 << bit) == 0).then(|| {
        Finding::with(
            Verdict::Bad,
            "drives",
            format!("the firmware does not speak `{name}`"),
            "flash this program's firmware (`cargo flash-fw`), or correct `drive` in the robot file",
        )
    })
}

fn configuration<L: Link>(
    client: &mut Client<L>,
    robot: &Robot,
    status: &Status,
) -> Result<Finding, RunError> {
    if !matches!(status.state, BoardState::Disarmed | BoardState::Fault) {
        return Ok(Finding::with(
            Verdict::Unseen,
            "configuration",
            format!("not sent while {:?}", status.state),
            "disarm first: `mcdpr disarm --on PORT`",
        ));
    }
    match run::configure(client, robot) {
        Ok(hash) => Ok(Finding::good(
            "configuration",
            format!("{} for {} cables taken", robot.name, robot.cables.len())
                + &format!(", hash {:08x}", hash.0),
        )),
        Err(
            error @ (RunError::Cables { .. }
            | RunError::Config(_)
            | RunError::Client(crate::link::ClientError::Refused { .. })),
        ) => Ok(refused("configuration", &error)),
        Err(error) => Err(error),
    }
}

/// An error as a finding: its message, and its advice.
#[must_use]
pub fn refused(part: &'static str, error: &dyn miette::Diagnostic) -> Finding {
    let remedy = error.help().map_or_else(
        || "see docs/first-day.md".to_owned(),
        |help| help.to_string(),
    );
    Finding::with(Verdict::Bad, part, error.to_string(), remedy)
}

fn line<L: Link>(client: &Client<L>) -> Finding {
    let (again, bad) = client.link_errors();
    let trip_ms = client
        .beat()
        .map_or(0.0, |beat| beat.round_trip_us as f64 * 1e-3);
    let found =
        format!("round trip {trip_ms:.1} ms, {again} frames sent again, {bad} arrived damaged");
    if again > 2 || bad > 2 {
        return Finding::with(
            Verdict::Note,
            "line",
            found,
            "shorten the cable between computer and board, keep it away from motor cables, use a hub with its own supply",
        );
    }
    Finding::good("line", found)
}
