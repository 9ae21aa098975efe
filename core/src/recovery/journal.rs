//! The journal of a run: records that only grow at the end, so that a cut in the middle of any write
//! cannot spoil what was there before.
//!
//! A file is [`MAGIC`] and records. A record is its payload's length (u16), kind (u8), number (u32),
//! payload, and the CRC-32 of all of that (u32), little-endian. Numbers rise by one. What ends in the
//! middle of a record was cut there: the records before it count. A record whose checksum is wrong
//! while more of the file follows was changed afterwards: the file is refused. This is the usual form of
//! a write-ahead log (Gray and Reuter, Transaction Processing, 1993, ch. 9).
//!
//! Beside it a [`Mark`] says which record has certainly reached the disk, so that a file from which
//! whole records were taken, or one of another run, is found out.

use crate::motion::Interruption;
use mcdpr_protocol::BoardState;
use mcdpr_protocol::frame::crc32;
use miette::Diagnostic;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// First bytes of a journal.
pub const MAGIC: &[u8; 8] = b"MCDPRJ01";
/// Bytes around a payload.
/// Length 2, kind 1, number 4, CRC-32 4.
const AROUND: usize = 11;
/// Most bytes of a payload.
const MOST_BYTES: usize = 60_000;
/// A clock may be set back by this, ms.
const CLOCK_MS: u64 = 60_000;

const KIND_IDENTITY: u8 = 1;
const KIND_PLAN: u8 = 2;
const KIND_KEPT: u8 = 3;
const KIND_END: u8 = 4;

/// The robot and the task of a journal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Identity {
    /// Number of the board, hexadecimal.
    pub board: String,
    /// Number of the session on the wire.
    pub session: u32,
    /// Name of the robot.
    pub robot: String,
    /// Checksum of geometry and scale, calibration included.
    pub scale: u32,
    /// Name of the task, or its file.
    pub task: String,
    /// Checksum of the task's text; of its name for one that is built in.
    pub task_hash: u32,
    /// Wall clock at the start of the run, ms since 1970.
    pub wall_ms: u64,
}

/// The host's plan: enough to make it again from the task.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// The tool at the start of the whole motion, world, m.
    pub start_m: [f64; 3],
    /// Duration of the plan under way, s.
    pub duration_s: f64,
    /// Interruptions after which the motion was continued. Path times count from the last one.
    #[serde(default)]
    pub interruptions: Vec<Interruption>,
}

/// The state of one instant.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Kept {
    /// The link's time, µs.
    pub time_us: u64,
    /// Path time of the motion, ms; 0 while nothing moves.
    pub path_ms: u32,
    /// The board's state.
    pub state: BoardState,
    /// Whether its lengths were referenced.
    pub referenced: bool,
    /// Bit set of open brakes.
    pub brakes_open: u8,
    /// Bit set of drives that gave torque.
    pub torque_on: u8,
    /// Whether the gripper was commanded closed.
    pub gripper_closed: bool,
    /// Whether the gripper's switch was closed.
    pub gripper_switch: bool,
    /// Each cable.
    pub cables: Vec<KeptCable>,
}

/// One cable of [`Kept`].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct KeptCable {
    /// Paid-out length by the drum encoder, m.
    pub length_m: f64,
    /// Its set-point, m.
    pub setpoint_m: f64,
    /// Its rate, m/s.
    pub speed_mps: f64,
    /// Tension, N.
    pub tension_n: f64,
}

/// A journal that was read.
#[derive(Debug, Clone, PartialEq)]
pub struct Journal {
    /// Whose it is.
    pub identity: Identity,
    /// The plan under way, if one was made.
    pub plan: Option<Plan>,
    /// The last state.
    pub last: Option<Kept>,
    /// The last state at rest, held by torque or brakes.
    pub still: Option<Kept>,
    /// Path time that the last plan has reached, ms; 0 before its motion.
    pub path_ms: u32,
    /// Whether the program ended by itself: it continued when the line was gone.
    pub ended: bool,
    /// Number of the last whole record.
    pub number: u32,
    /// Bytes of a record that was cut.
    pub torn_bytes: usize,
}

/// The last record that has certainly reached the disk.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Mark {
    /// The run's session.
    pub session: u32,
    /// Its last record on the disk.
    pub number: u32,
}

/// Why a journal is not valid.
#[derive(Debug, Clone, PartialEq, Eq, Error, Diagnostic)]
pub enum JournalError {
    /// There is no journal.
    #[error("no journal was kept for board {board}")]
    #[diagnostic(code(mcdpr::journal::missing))]
    Missing {
        /// The board.
        board: String,
    },
    /// The file is not a journal.
    #[error("the file is not a journal: its first bytes differ")]
    #[diagnostic(code(mcdpr::journal::form))]
    Form,
    /// A record was changed.
    #[error("the record at byte {at} is damaged, and {after} bytes follow it")]
    #[diagnostic(code(mcdpr::journal::damaged))]
    Damaged {
        /// Where.
        at: usize,
        /// Bytes after it.
        after: usize,
    },
    /// It has no state.
    #[error("it was cut before its first state")]
    #[diagnostic(code(mcdpr::journal::empty))]
    Empty,
    /// Records that were on the disk are missing.
    #[error("it ends with record {last}, but record {marked} had reached the disk: it was cut")]
    #[diagnostic(code(mcdpr::journal::cut))]
    Cut {
        /// The last record in the file.
        last: u32,
        /// The record that the mark names.
        marked: u32,
    },
    /// It is of another run than the last one.
    #[error("it is of session {journal:08x}, the last run was session {last:08x}")]
    #[diagnostic(code(mcdpr::journal::session))]
    Session {
        /// The journal's.
        journal: u32,
        /// The last one.
        last: u32,
    },
    /// It is of another board.
    #[error("it is of board {journal}, this is board {board}")]
    #[diagnostic(code(mcdpr::journal::board))]
    Board {
        /// The journal's.
        journal: String,
        /// This one.
        board: String,
    },
    /// It is of a robot with another geometry, scale or calibration.
    #[error("it is of the robot {journal} with another geometry, scale or calibration")]
    #[diagnostic(code(mcdpr::journal::robot))]
    Robot {
        /// The journal's robot.
        journal: String,
    },
    /// It begins in the future.
    #[error("it is from the future, by {ahead_s} s: check this computer's clock")]
    #[diagnostic(code(mcdpr::journal::future))]
    Future {
        /// By how much, s.
        ahead_s: u64,
    },
}

/// Writes the bytes of records, one after the other.
#[derive(Debug, Clone, Default)]
pub struct Encoder {
    number: u32,
}

impl Encoder {
    /// Number of the last record.
    #[must_use]
    pub const fn number(&self) -> u32 {
        self.number
    }

    /// The beginning of a file: magic and identity, and the plan under way.
    pub fn begin(&mut self, identity: &Identity, plan: Option<&Plan>) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        let text = serde_json::to_vec(identity).unwrap_or_default();
        bytes.extend(self.record(KIND_IDENTITY, &text));
        if let Some(plan) = plan {
            bytes.extend(self.plan(plan));
        }
        bytes
    }

    /// A plan.
    pub fn plan(&mut self, plan: &Plan) -> Vec<u8> {
        let text = serde_json::to_vec(plan).unwrap_or_default();
        self.record(KIND_PLAN, &text)
    }

    /// A state.
    pub fn kept(&mut self, kept: &Kept) -> Vec<u8> {
        let mut payload = Vec::with_capacity(24 + 16 * kept.cables.len());
        payload.extend(kept.time_us.to_le_bytes());
        payload.extend(kept.path_ms.to_le_bytes());
        let flags = u8::from(kept.referenced)
            | u8::from(kept.gripper_closed) << 1
            | u8::from(kept.gripper_switch) << 2;
        let count = u8::try_from(kept.cables.len()).unwrap_or(u8::MAX);
        payload.extend([
            state_number(kept.state),
            flags,
            kept.brakes_open,
            kept.torque_on,
            count,
        ]);
        for cable in &kept.cables {
            // Steps of 0.1 um, 1 um/s and 1 mN: an i32 holds 214 m, 2147 m/s and 2.1 MN.
            for (value, per_unit) in [
                (cable.length_m, 1e7),
                (cable.setpoint_m, 1e7),
                (cable.speed_mps, 1e6),
                (cable.tension_n, 1e3),
            ] {
                payload.extend(fixed(value * per_unit).to_le_bytes());
            }
        }
        self.record(KIND_KEPT, &payload)
    }

    /// The end record of a program that ended by itself.
    pub fn end(&mut self) -> Vec<u8> {
        self.record(KIND_END, &[])
    }

    fn record(&mut self, kind: u8, payload: &[u8]) -> Vec<u8> {
        self.number = self.number.wrapping_add(1);
        let length = u16::try_from(payload.len()).unwrap_or(u16::MAX);
        let payload = payload.get(..length.into()).unwrap_or(payload);
        let mut bytes = Vec::with_capacity(payload.len() + AROUND);
        bytes.extend(length.to_le_bytes());
        bytes.push(kind);
        bytes.extend(self.number.to_le_bytes());
        bytes.extend(payload);
        let sum = crc32(&bytes);
        bytes.extend(sum.to_le_bytes());
        bytes
    }
}

#[expect(clippy::cast_possible_truncation, reason = "saturates")]
fn fixed(value: f64) -> i32 {
    value.round() as i32
}

// The index is the byte in the file: a new state goes to the end, or old journals change meaning.
const STATES: [BoardState; 9] = [
    BoardState::Boot,
    BoardState::Disarmed,
    BoardState::Arming,
    BoardState::Holding,
    BoardState::Moving,
    BoardState::Pausing,
    BoardState::Stopping,
    BoardState::Fault,
    BoardState::EStop,
];

fn state_number(state: BoardState) -> u8 {
    let found = STATES.iter().position(|known| *known == state);
    found
        .and_then(|index| u8::try_from(index).ok())
        .unwrap_or(0)
}

/// The records of a file: kind, number and payload of each, and the bytes of one that was cut.
struct Records<'a> {
    bytes: &'a [u8],
    at: usize,
    number: Option<u32>,
}

enum Next<'a> {
    Record(u8, u32, &'a [u8]),
    Torn(usize),
    Damaged,
    End,
}

impl<'a> Records<'a> {
    fn next(&mut self) -> Next<'a> {
        let rest = self.bytes.get(self.at..).unwrap_or_default();
        if rest.is_empty() {
            return Next::End;
        }
        let Some((length, _)) = rest.split_first_chunk::<2>() else {
            return Next::Torn(rest.len());
        };
        let length = usize::from(u16::from_le_bytes(*length));
        let whole = length + AROUND;
        // A file system may have given a file its length and not yet its bytes.
        if rest.iter().all(|byte| *byte == 0) {
            return Next::Torn(rest.len());
        }
        // No record is that long: its length itself is damaged.
        if length > MOST_BYTES {
            return Next::Damaged;
        }
        let Some(record) = rest.get(..whole) else {
            return Next::Torn(rest.len());
        };
        let parsed = parse(record);
        match parsed {
            Some((kind, number, payload))
                if self
                    .number
                    .is_none_or(|last| number == last.wrapping_add(1)) =>
            {
                self.at += whole;
                self.number = Some(number);
                Next::Record(kind, number, payload)
            }
            // The last record: half of it was written. Were it damaged later, its mark would show it.
            _ if rest.iter().skip(whole).all(|byte| *byte == 0) => Next::Torn(rest.len()),
            _ => Next::Damaged,
        }
    }
}

fn parse(record: &[u8]) -> Option<(u8, u32, &[u8])> {
    let (body, sum) = record.split_last_chunk::<4>()?;
    if crc32(body) != u32::from_le_bytes(*sum) {
        return None;
    }
    let (_, rest) = body.split_first_chunk::<2>()?;
    let (kind, rest) = rest.split_first()?;
    let (number, payload) = rest.split_first_chunk::<4>()?;
    Some((*kind, u32::from_le_bytes(*number), payload))
}

fn kept(payload: &[u8]) -> Option<Kept> {
    let (time, rest) = payload.split_first_chunk::<8>()?;
    let (path, rest) = rest.split_first_chunk::<4>()?;
    let ([state, flags, brakes_open, torque_on, count], rest) = rest.split_first_chunk::<5>()?;
    let mut values = rest
        .chunks_exact(4)
        .filter_map(|four| four.first_chunk::<4>());
    let mut value = |unit: f64| Some(f64::from(i32::from_le_bytes(*values.next()?)) * unit);
    let mut cables = Vec::new();
    for _ in 0..*count {
        cables.push(KeptCable {
            length_m: value(1e-7)?,
            setpoint_m: value(1e-7)?,
            speed_mps: value(1e-6)?,
            tension_n: value(1e-3)?,
        });
    }
    Some(Kept {
        time_us: u64::from_le_bytes(*time),
        path_ms: u32::from_le_bytes(*path),
        state: STATES.get(usize::from(*state)).copied()?,
        referenced: flags & 1 != 0,
        gripper_closed: flags & 2 != 0,
        gripper_switch: flags & 4 != 0,
        brakes_open: *brakes_open,
        torque_on: *torque_on,
        cables,
    })
}

impl Journal {
    /// Reads the bytes of a file.
    ///
    /// # Errors
    /// [`JournalError::Form`], [`JournalError::Damaged`], [`JournalError::Empty`].
    pub fn read(bytes: &[u8]) -> Result<Self, JournalError> {
        if bytes.get(..MAGIC.len()) != Some(MAGIC.as_slice()) {
            // A file that was cut within its first bytes holds nothing.
            let begun = MAGIC.starts_with(bytes);
            return Err(if begun {
                JournalError::Empty
            } else {
                JournalError::Form
            });
        }
        let mut records = Records {
            bytes,
            at: MAGIC.len(),
            number: None,
        };
        let mut identity = None;
        let (mut plan, mut last, mut still) = (None, None, None);
        let (mut ended, mut number, mut torn_bytes) = (false, 0, 0);
        let mut path_ms = 0;
        loop {
            let at = records.at;
            let damaged = || JournalError::Damaged {
                at,
                after: bytes.len().saturating_sub(at),
            };
            match records.next() {
                Next::End => break,
                Next::Torn(left) => {
                    torn_bytes = left;
                    break;
                }
                Next::Damaged => return Err(damaged()),
                Next::Record(kind, of, payload) => {
                    number = of;
                    match kind {
                        KIND_IDENTITY => {
                            let read = serde_json::from_slice::<Identity>(payload);
                            identity = Some(read.map_err(|_| damaged())?);
                        }
                        KIND_PLAN => {
                            let read = serde_json::from_slice::<Plan>(payload);
                            plan = Some(read.map_err(|_| damaged())?);
                            // Path times count from the start of each plan.
                            path_ms = 0;
                        }
                        KIND_KEPT => {
                            let read = kept(payload).ok_or_else(damaged)?;
                            if matches!(read.state, BoardState::Disarmed | BoardState::Holding) {
                                still = Some(read.clone());
                            }
                            // A board that holds after its motion gives 0.
                            path_ms = path_ms.max(read.path_ms);
                            last = Some(read);
                        }
                        KIND_END => ended = true,
                        // A kind of a later version.
                        _ => {}
                    }
                }
            }
        }
        let identity = identity.ok_or(JournalError::Empty)?;
        if last.is_none() {
            return Err(JournalError::Empty);
        }
        Ok(Self {
            identity,
            plan,
            last,
            still,
            path_ms,
            ended,
            number,
            torn_bytes,
        })
    }

    /// Whether it is of this board and robot, whole up to its mark, and not from the future.
    ///
    /// # Errors
    /// [`JournalError`] says why not.
    pub fn check(
        &self,
        board: &str,
        scale: u32,
        mark: Option<Mark>,
        now_ms: u64,
    ) -> Result<(), JournalError> {
        let of = &self.identity;
        if of.board != board {
            return Err(JournalError::Board {
                journal: of.board.clone(),
                board: board.to_owned(),
            });
        }
        if of.scale != scale {
            return Err(JournalError::Robot {
                journal: of.robot.clone(),
            });
        }
        // A computer that lost its date cannot tell the last run from an earlier one.
        if of.wall_ms > now_ms.saturating_add(CLOCK_MS) {
            return Err(JournalError::Future {
                ahead_s: (of.wall_ms - now_ms) / 1000,
            });
        }
        // No mark yet: the run was cut before its first record was certain to be on the disk.
        let Some(mark) = mark else {
            return Ok(());
        };
        if mark.session != of.session {
            return Err(JournalError::Session {
                journal: of.session,
                last: mark.session,
            });
        }
        if mark.number > self.number {
            return Err(JournalError::Cut {
                last: self.number,
                marked: mark.number,
            });
        }
        Ok(())
    }
}

/// Bytes of one slot of a file of marks.
/// Session 4, number 4, CRC-32 4.
pub const MARK_BYTES: usize = 12;

impl Mark {
    /// The bytes of a slot. Two slots are written in turn: a cut spoils one of them.
    #[must_use]
    pub fn to_bytes(self) -> [u8; MARK_BYTES] {
        let mut bytes = [0; MARK_BYTES];
        let (body, sum) = bytes.split_at_mut(8);
        let fields = self.session.to_le_bytes();
        let fields = fields.into_iter().chain(self.number.to_le_bytes());
        for (slot, byte) in body.iter_mut().zip(fields) {
            *slot = byte;
        }
        sum.copy_from_slice(&crc32(body).to_le_bytes());
        bytes
    }

    /// The later whole slot of a file of marks; `None` where neither is whole.
    #[must_use]
    pub fn read(bytes: &[u8]) -> Option<Self> {
        let slots = bytes.chunks_exact(MARK_BYTES).filter_map(|slot| {
            let (body, sum) = slot.split_last_chunk::<4>()?;
            let (session, number) = body.split_first_chunk::<4>()?;
            (crc32(body) == u32::from_le_bytes(*sum)).then_some(Self {
                session: u32::from_le_bytes(*session),
                number: u32::from_le_bytes(*number.first_chunk::<4>()?),
            })
        });
        slots.max_by_key(|mark| mark.number)
    }
}

#[cfg(test)]
mod tests;
