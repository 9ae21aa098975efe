//! Who is behind the lines: every board's hello, and whether they make up this robot.

use super::phase::Phase;
use super::port::Port;
use super::{Boards, Lines, Member};
use crate::link::aside::{hello_in, hello_query};
use crate::link::{Client, LinkError, check};
use mcdpr_protocol::{BoardState, ConfigHash, Hello, SessionId};
use std::collections::VecDeque;

/// Time for all boards to say hello, µs: less than the host waits, so that the silent one is named.
const HELLO_US: u64 = 2_500_000;

/// The hellos so far.
#[derive(Debug, Default)]
pub(super) struct Claim {
    hellos: Vec<Option<Hello>>,
    heard: Vec<Vec<u8>>,
    begun_us: u64,
    asking: bool,
}

impl Claim {
    pub(super) fn begun(lines: usize, now_us: u64) -> Self {
        Self {
            hellos: vec![None; lines],
            heard: vec![Vec::new(); lines],
            begun_us: now_us,
            asking: true,
        }
    }

    pub(super) const fn is_asking(&self) -> bool {
        self.asking
    }
}

/// A board's number as it is shown.
fn digits(hello: &Hello) -> String {
    hello.board_id.iter().map(|b| format!("{b:02x}")).collect()
}

fn refused(what: String, help: &str) -> LinkError {
    LinkError::Boards {
        what,
        help: help.to_owned(),
    }
}

impl<L: Lines> Boards<L> {
    /// Asks the lines again that have not answered.
    pub(super) fn ask_missing(&mut self) -> Result<(), LinkError> {
        if self.lines.now_us() >= self.claim.begun_us + HELLO_US
            && let Some(silent) = self.claim.hellos.iter().position(Option::is_none)
        {
            self.claim.asking = false;
            let line = self.lines.name(silent);
            return Err(refused(
                format!("no board answers on {line}, and the robot needs all of its boards"),
                "check power and line of that board (`mcdpr ports`); nothing was moved",
            ));
        }
        for line in 0..self.lines.count() {
            if self.claim.hellos.get(line).is_some_and(Option::is_none) {
                self.lines.send(line, &hello_query())?;
            }
        }
        Ok(())
    }

    /// Looks for hellos in what has arrived.
    pub(super) fn hear_hellos(&mut self, arrived: &mut [Vec<u8>]) -> Result<(), LinkError> {
        let places = self.claim.heard.iter_mut().zip(&mut self.claim.hellos);
        for ((heard, hello), bytes) in places.zip(arrived) {
            heard.append(bytes);
            if hello.is_none() {
                *hello = hello_in(heard);
            }
        }
        let hellos: Option<Vec<Hello>> = self.claim.hellos.iter().copied().collect();
        let Some(hellos) = hellos else { return Ok(()) };
        self.claim.asking = false;
        self.sort(&hellos)?;
        let joint = self.joint(&hellos)?;
        self.session = SessionId(0);
        self.claim.hellos = hellos.into_iter().map(Some).collect();
        self.enter(SessionId(0));
        self.tell_hello(&joint);
        Ok(())
    }

    /// Finds the line of each board.
    fn sort(&mut self, hellos: &[Hello]) -> Result<(), LinkError> {
        let wanted = self.layout.len();
        if hellos.len() != wanted {
            return Err(refused(
                format!(
                    "the robot has {wanted} boards, but {} lines are given",
                    hellos.len()
                ),
                "give one port per board: `--on PORT,PORT`",
            ));
        }
        for (index, hello) in hellos.iter().enumerate() {
            let twin = hellos.iter().take(index);
            let twin = twin
                .clone()
                .position(|other| other.board_id == hello.board_id);
            if let Some(twin) = twin {
                return Err(refused(
                    format!(
                        "the boards on {} and {} have the same number, {}",
                        self.lines.name(twin),
                        self.lines.name(index),
                        digits(hello)
                    ),
                    "two names of one port? Give each board's own; nothing was moved",
                ));
            }
        }
        let mut free: Vec<usize> = (0..hellos.len()).collect();
        let mut lines = vec![None; wanted];
        for (id, place) in self.ids.iter().zip(&mut lines) {
            let Some(id) = id else { continue };
            let line = hellos.iter().position(|hello| digits(hello) == *id);
            let Some(line) = line else {
                let found: Vec<String> = hellos.iter().map(digits).collect();
                return Err(refused(
                    format!(
                        "the robot's board {id} is on none of the lines: there are {}",
                        found.join(", ")
                    ),
                    "connect that board, or correct `id` of [[board]] in the robot file",
                ));
            };
            free.retain(|other| *other != line);
            *place = Some(line);
        }
        let mut free = free.into_iter();
        self.line_of = lines
            .into_iter()
            .filter_map(|line| line.or_else(|| free.next()))
            .collect();
        Ok(())
    }

    /// The hello of the boards as one.
    fn joint(&self, hellos: &[Hello]) -> Result<Hello, LinkError> {
        let of = |board: usize| {
            let line = self.line_of.get(board).copied().unwrap_or(board);
            hellos.get(line).copied()
        };
        let Some(first) = of(0) else {
            return Err(refused(
                "the robot has no board".into(),
                "add [[board]] tables",
            ));
        };
        let mut joint = first;
        for board in 0..hellos.len() {
            let Some(hello) = of(board) else { continue };
            if let Err(error) = check(&hello) {
                return Err(refused(
                    format!("{}: {error}", self.name(board)),
                    "flash all boards with this program's firmware: `cargo flash-fw`",
                ));
            }
            if hello.git_hash != first.git_hash {
                let text = |hash: [u8; 8]| String::from_utf8_lossy(&hash).into_owned();
                return Err(refused(
                    format!(
                        "{} runs firmware {}, {} runs {}: nothing was moved",
                        self.name(0),
                        text(first.git_hash),
                        self.name(board),
                        text(hello.git_hash)
                    ),
                    "flash all boards with the same firmware: `cargo flash-fw`",
                ));
            }
            if board > 0 {
                // A number of its own for the set: lengths are kept by it.
                for (mine, other) in joint.board_id.iter_mut().zip(hello.board_id) {
                    *mine = mine.rotate_left(3) ^ other;
                }
            }
        }
        Ok(joint)
    }

    /// New clients for a session.
    pub(super) fn enter(&mut self, session: SessionId) {
        self.session = session;
        let now_us = self.lines.now_us();
        let hellos = &self.claim.hellos;
        // What the boards are does not change with the session.
        let infos: Vec<_> = self
            .members
            .iter()
            .map(|m| m.client.info().clone())
            .collect();
        let members = self.line_of.iter().enumerate().filter_map(|(board, line)| {
            let hello = hellos.get(*line).copied().flatten()?;
            let port = Port {
                now_us,
                ..Port::default()
            };
            let mut client = Client::idle(port, session, hello);
            if let Some(info) = infos.get(board) {
                client.set_info(info.clone());
            }
            Some(Member {
                client,
                phase: Phase::default(),
                seen_us: u64::MAX,
                todo: VecDeque::new(),
                issued: VecDeque::new(),
                state: BoardState::Boot,
                state_us: 0,
            })
        });
        self.members = members.collect();
    }

    /// Refuses boards that were exchanged with each other, and one that has another robot's
    /// configuration while another board has this robot's.
    pub(super) fn check_configs(&self, has: &[Option<ConfigHash>]) -> Result<(), LinkError> {
        let own = |board: usize| self.parts.get(board).map(|(_, hash)| *hash);
        for (board, config) in has.iter().enumerate() {
            let Some(config) = *config else { continue };
            if own(board) == Some(config) {
                continue;
            }
            let twin = (0..self.parts.len()).find(|other| own(*other) == Some(config));
            if let Some(twin) = twin {
                return Err(refused(
                    format!(
                        "{} has the configuration of board {}: boards are swapped, nothing was moved",
                        self.name(board),
                        twin + 1
                    ),
                    "give the ports in the order of the [[board]] tables, or give each table its \
                     board's `id`; if the cables were exchanged, switch the boards off and on",
                ));
            }
            let others = has.iter().enumerate();
            let mixed = others
                .filter(|(other, _)| *other != board)
                .any(|(other, config)| config.is_some() && *config == own(other));
            if mixed {
                return Err(refused(
                    format!(
                        "{} has the configuration of another robot, the other boards have this robot's: \
                         nothing was moved",
                        self.name(board)
                    ),
                    "is it this robot's board? If its modules are now this robot's, switch it off \
                     and on",
                ));
            }
        }
        Ok(())
    }
}
