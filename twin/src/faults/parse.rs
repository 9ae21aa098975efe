//! Scenarios in text form: `S2@3.0s` on the command line, TOML in a file.

use super::{How, Injection, MOST_INJECTIONS, Phase, Scenario, Snag, Supply, When, how};
use mcdpr_core::robot::{DriveKind, Robot};
use mcdpr_protocol::FaultId;
use miette::Diagnostic;
use serde::Deserialize;
use thiserror::Error;

/// Latest time of a fault, s.
const LATEST_S: f64 = 3600.0;

/// Why a scenario is refused.
#[derive(Debug, Error, Diagnostic)]
pub enum ScenarioError {
    /// Not of the form `ID[:CABLE]@TIME`.
    #[error("{text:?} is not a fault to inject: {what}")]
    #[diagnostic(
        code(mcdpr::scenario::form),
        help(
            "write ID@TIME or ID:CABLE@TIME, such as S2@3.0s, C3:2@1.5s or B1:4@start, or snag@TIME or snag:+x@TIME for a hook that catches the tool, or power:all@3s/2s for a supply (board, drives, host, all; dip: the board's dips; crash: its program fails) that is gone for two seconds, or wire:2@3s for the fault line's plug of a board; `mcdpr faults` lists the ids"
        )
    )]
    Form {
        /// The given text.
        text: String,
        /// What is wrong with it.
        what: String,
    },
    /// A row that cannot be simulated.
    #[error("{} ({}) cannot be injected: {why}", fault.name(), fault.what())]
    #[diagnostic(
        code(mcdpr::scenario::not_here),
        help("`mcdpr faults` shows which rows can be injected, and how each is tested")
    )]
    NotHere {
        /// The row.
        fault: FaultId,
        /// Why not.
        why: &'static str,
    },
    /// A row that cannot be simulated on this robot.
    #[error("{} ({}) cannot be injected into winch {}: {why}", fault.name(), fault.what(), cable + 1)]
    #[diagnostic(
        code(mcdpr::scenario::not_this_robot),
        help("`drive` in the robot file says what its drives are")
    )]
    NotThisRobot {
        /// The row.
        fault: FaultId,
        /// The cable, from 0.
        cable: usize,
        /// Why not.
        why: &'static str,
    },
    /// The file cannot be read.
    #[error("scenario file {path} cannot be read: {reason}")]
    #[diagnostic(code(mcdpr::scenario::unreadable))]
    Unreadable {
        /// Which.
        path: String,
        /// Why.
        reason: String,
    },
    /// The file is not a valid scenario.
    #[error("scenario file {path} is malformed: {message}")]
    #[diagnostic(
        code(mcdpr::scenario::malformed),
        help(
            "a scenario has [[fault]] tables with id and at_s (or at = \"start\"), and if you like cable, strength, lasts_s, and for id = \"snag\" along = [x, y, z]; see docs/safety.md"
        )
    )]
    Malformed {
        /// Which.
        path: String,
        /// What is wrong and where.
        message: String,
    },
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    name: Option<String>,
    #[serde(default)]
    fault: Vec<Entry>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    id: String,
    cable: Option<usize>,
    at: Option<String>,
    at_s: Option<f64>,
    strength: Option<f64>,
    lasts_s: Option<f64>,
    /// Direction in which a snag blocks, world; without it, all directions.
    along: Option<[f64; 3]>,
}

/// The word for a hook that catches the platform.
const SNAG: &str = "snag";
/// Time of a board from a fault of its program to its new start, s.
const CRASH_S: f64 = 5e-3;
/// The word for the plug of a board's fault line that is pulled.
const WIRE: &str = "wire:";
/// Boards that a robot may have: one for each cable at most.
const MOST_BOARDS: usize = 8;
/// The word for a supply that is gone.
const POWER: &str = "power";

impl Injection {
    /// A fault at its nominal strength that stays, on the first cable.
    #[must_use]
    pub const fn new(fault: FaultId, when: When) -> Self {
        Self {
            fault,
            cable: 0,
            when,
            strength: 1.0,
            lasts_s: None,
            snag: None,
            supply: None,
        }
    }

    /// A supply that is gone.
    #[must_use]
    pub const fn cut(supply: Supply, when: When) -> Self {
        Self {
            supply: Some(supply),
            ..Self::new(FaultId::P1, when)
        }
    }

    /// The plug of a board's fault line is pulled; boards count from 0.
    fn unplugged(board: usize, when: When) -> Self {
        Self {
            cable: board,
            ..Self::new(FaultId::L19, when)
        }
    }

    /// A stiff hook that catches the tool.
    #[must_use]
    pub const fn snagged(snag: Snag, when: When) -> Self {
        Self {
            snag: Some(snag),
            ..Self::new(FaultId::C2, when)
        }
    }

    /// Reads `ID@TIME` or `ID:CABLE@TIME`; cables count from 1, TIME is `3.0s`, `500ms`, a plain
    /// number of seconds after the motion's start, `start` for before the robot arms, or
    /// `stopping+0.1s` for so long after a [`Phase`] has begun. `snag@TIME`
    /// is a hook that catches the tool, `snag:+x@TIME` one that holds against motion along +x.
    /// `power:WHOSE@TIME/DURATION` cuts the supply of `board`, `drives`, `host` or `all`, lets the board's `dip`, or
    /// lets its program `crash`; P1 is the board's. Without a duration it stays away; a crash lasts 5 ms.
    /// `wire:BOARD@TIME` pulls the plug of a board's fault line.
    ///
    /// ```
    /// use mcdpr_twin::faults::{Injection, When};
    /// let stuck = Injection::parse("S2:3@1500ms", 4)?;
    /// assert_eq!((stuck.fault.name(), stuck.cable), ("S2", 2));
    /// assert_eq!(stuck.when, When::Motion(1.5));
    /// # Ok::<(), mcdpr_twin::faults::ScenarioError>(())
    /// ```
    ///
    /// # Errors
    /// [`ScenarioError::Form`], [`ScenarioError::NotHere`].
    pub fn parse(text: &str, cables: usize) -> Result<Self, ScenarioError> {
        let form = |what: &str| ScenarioError::Form {
            text: text.to_owned(),
            what: what.to_owned(),
        };
        let (what, when) = text
            .split_once('@')
            .ok_or_else(|| form("it has no @TIME"))?;
        let (when, lasts_s) = match when.split_once('/') {
            None => (when, None),
            Some((when, lasts)) => match parse_time(lasts.trim()) {
                Some(When::Motion(lasts_s)) if lasts_s > 0.0 => (when, Some(lasts_s)),
                _ => return Err(form("its duration is not a time")),
            },
        };
        let when = parse_time(when.trim()).ok_or_else(|| form("its start is not a time"))?;
        let injection = Self::read(text, what, when, cables)?;
        Ok(Self {
            lasts_s: lasts_s.or(injection.lasts_s),
            ..injection
        })
    }

    fn read(text: &str, what: &str, when: When, cables: usize) -> Result<Self, ScenarioError> {
        let form = |what: &str| ScenarioError::Form {
            text: text.to_owned(),
            what: what.to_owned(),
        };
        if is_power(what) {
            let supply = supply_named(what);
            let supply = supply
                .ok_or_else(|| form("its supply is not board, drives, host, all, dip or crash"))?;
            return Ok(Self {
                lasts_s: (supply == Supply::Crash).then_some(CRASH_S),
                ..Self::cut(supply, when)
            });
        }
        if let Some(board) = what.trim().strip_prefix(WIRE) {
            let board = board_named(board);
            let board = board.ok_or_else(|| form("its board is not 1 to 8"))?;
            return Ok(Self::unplugged(board, when));
        }
        let (id, cable) = match what.split_once(':') {
            Some((id, axis)) if is_snag(id) => {
                let along = axis_named(axis.trim());
                let along = along.ok_or_else(|| form("its direction is not +x, -x, +y to -z"))?;
                return Ok(Self::snagged(Snag::Against(along), when));
            }
            None if is_snag(what) => return Ok(Self::snagged(Snag::Fast, when)),
            Some((id, cable)) => {
                let cable = cable.trim().parse::<usize>();
                (
                    id,
                    Some(cable.map_err(|_| form("its cable is not a number"))?),
                )
            }
            None => (what, None),
        };
        build(id.trim(), cable, when, cables).map_err(|error| match error {
            Problem::Text(what) => form(&what),
            Problem::Error(error) => error,
        })
    }
}

/// Whether the text is `power`, `power:WHOSE` or P1.
fn is_power(text: &str) -> bool {
    let (word, _) = text.split_once(':').unwrap_or((text, ""));
    is_board_power(text) || word.trim().eq_ignore_ascii_case(POWER)
}

fn is_board_power(text: &str) -> bool {
    text.trim().eq_ignore_ascii_case(FaultId::P1.name())
}

/// The supply of such a text; `None` for an unknown one.
fn supply_named(text: &str) -> Option<Supply> {
    if is_board_power(text) {
        return Some(Supply::Board);
    }
    let (_, whose) = text.split_once(':').unwrap_or((text, "all"));
    let mut known = Supply::ALL.into_iter();
    Some(known.find(|(_, name)| *name == whose.trim())?.0)
}

/// The board of this number, from 0.
fn board_named(text: &str) -> Option<usize> {
    let number = text.trim().parse::<usize>().ok()?;
    (1..=MOST_BOARDS).contains(&number).then(|| number - 1)
}

fn is_snag(id: &str) -> bool {
    id.trim().eq_ignore_ascii_case(SNAG)
}

/// The unit vector of `+x`, `-x`, `+y` and so on.
fn axis_named(text: &str) -> Option<[f64; 3]> {
    let (sign, axis) = match (text.strip_prefix('+'), text.strip_prefix('-')) {
        (Some(axis), _) => (1.0, axis),
        (_, Some(axis)) => (-1.0, axis),
        _ => return None,
    };
    Some(match axis {
        "x" => [sign, 0.0, 0.0],
        "y" => [0.0, sign, 0.0],
        "z" => [0.0, 0.0, sign],
        _ => return None,
    })
}

enum Problem {
    Text(String),
    Error(ScenarioError),
}

fn parse_time(text: &str) -> Option<When> {
    if text == "start" {
        return Some(When::Start);
    }
    if let Some((name, after)) = text.split_once('+') {
        let phase = Phase::ALL.into_iter().find(|phase| phase.name() == name)?;
        return match parse_time(after.trim())? {
            When::Motion(after_s) => Some(When::After(phase, after_s)),
            _ => None,
        };
    }
    // `ms` before `s`, in which it ends as well.
    let (number, factor) = match (text.strip_suffix("ms"), text.strip_suffix('s')) {
        (Some(number), _) => (number, 1e-3),
        (None, Some(number)) => (number, 1.0),
        (None, None) => (text, 1.0),
    };
    let seconds = number.trim().parse::<f64>().ok()? * factor;
    (0.0..=LATEST_S)
        .contains(&seconds)
        .then_some(When::Motion(seconds))
}

fn build(id: &str, cable: Option<usize>, when: When, cables: usize) -> Result<Injection, Problem> {
    let fault = FaultId::ALL
        .iter()
        .copied()
        .find(|fault| fault.name().eq_ignore_ascii_case(id))
        .ok_or_else(|| Problem::Text(format!("there is no fault {id}")))?;
    if let How::Not(why) = how(fault) {
        return Err(Problem::Error(ScenarioError::NotHere { fault, why }));
    }
    let number = cable.unwrap_or(1);
    if number == 0 || number > cables {
        return Err(Problem::Text(format!(
            "there is no cable {number}: the robot has 1 to {cables}"
        )));
    }
    Ok(Injection {
        cable: number - 1,
        ..Injection::new(fault, when)
    })
}

impl Scenario {
    /// Checks that this robot can show these faults: an RMDS drive cannot report excess
    /// temperature.
    ///
    /// # Errors
    /// [`ScenarioError::NotThisRobot`] for the first that it cannot show.
    pub fn suits(&self, robot: &Robot) -> Result<(), ScenarioError> {
        for injection in &self.injections {
            let board = robot.boards.get(injection.cable);
            if injection.fault == FaultId::L19 && !board.is_some_and(|board| board.fault_line) {
                return Err(ScenarioError::NotHere {
                    fault: injection.fault,
                    why: "the robot has no such board, or no fault line",
                });
            }
            let winch = robot.winch_of(injection.cable);
            let rmds = winch.is_some_and(|winch| winch.drive == DriveKind::Rmds);
            if injection.fault == FaultId::D6 && rmds {
                return Err(ScenarioError::NotThisRobot {
                    fault: injection.fault,
                    cable: injection.cable,
                    why: "its drive, an RMDS, has no such report",
                });
            }
        }
        Ok(())
    }

    /// Reads the faults of a command line.
    ///
    /// # Errors
    /// [`ScenarioError`] for the first invalid one.
    pub fn from_words(words: &[String], cables: usize) -> Result<Self, ScenarioError> {
        let injections = words.iter().map(|word| Injection::parse(word, cables));
        Ok(Self {
            name: words.join(", "),
            injections: injections.collect::<Result<_, _>>()?,
        })
    }

    /// Reads a scenario from the text of a file; `path` names it in messages.
    ///
    /// # Errors
    /// [`ScenarioError`].
    pub fn parse(text: &str, path: &str, cables: usize) -> Result<Self, ScenarioError> {
        let malformed = |message: String| ScenarioError::Malformed {
            path: path.to_owned(),
            message,
        };
        let file: File = toml::from_str(text).map_err(|error| malformed(error.to_string()))?;
        if file.fault.is_empty() || file.fault.len() > MOST_INJECTIONS {
            return Err(malformed(format!(
                "it needs 1 to {MOST_INJECTIONS} [[fault]] tables"
            )));
        }
        let mut injections = Vec::new();
        for (number, entry) in (1..).zip(&file.fault) {
            let wrong = |what: String| malformed(format!("fault {number}: {what}"));
            let needs = || {
                wrong(format!(
                    "it needs either at = \"start\" (or \"parked+0.5s\") or at_s of 0 to {LATEST_S}"
                ))
            };
            let when = match (entry.at.as_deref(), entry.at_s) {
                (None, Some(at_s)) if (0.0..=LATEST_S).contains(&at_s) => When::Motion(at_s),
                (Some(at), None) => parse_time(at).ok_or_else(needs)?,
                _ => return Err(needs()),
            };
            let strength = entry.strength.unwrap_or(1.0);
            if !(0.001..=1000.0).contains(&strength) {
                return Err(wrong("strength must be 0.001 to 1000".to_owned()));
            }
            if entry
                .lasts_s
                .is_some_and(|s| !(0.001..=LATEST_S).contains(&s))
            {
                return Err(wrong(format!("lasts_s must be 0.001 to {LATEST_S}")));
            }
            let snag = is_snag(&entry.id);
            if entry.along.is_some_and(|along| !snag || !points(along)) {
                let what = "along is for id = \"snag\": a direction of finite numbers, not all 0";
                return Err(wrong(what.to_owned()));
            }
            let injection = if is_power(&entry.id) {
                let none = || wrong("its supply is not board, drives, host or all".to_owned());
                Injection::cut(supply_named(&entry.id).ok_or_else(none)?, when)
            } else if let Some(board) = entry.id.trim().strip_prefix(WIRE) {
                let none = || wrong("its board is not 1 to 8".to_owned());
                Injection::unplugged(board_named(board).ok_or_else(none)?, when)
            } else if snag {
                let direction = entry.along.map_or(Snag::Fast, Snag::Against);
                Injection::snagged(direction, when)
            } else {
                build(&entry.id, entry.cable, when, cables).map_err(|p| match p {
                    Problem::Text(what) => wrong(what),
                    Problem::Error(error) => error,
                })?
            };
            injections.push(Injection {
                strength,
                lasts_s: entry.lasts_s,
                ..injection
            });
        }
        Ok(Self {
            name: file.name.unwrap_or_else(|| path.to_owned()),
            injections,
        })
    }
}

/// Whether a direction is not zero.
fn points(along: [f64; 3]) -> bool {
    let largest = along
        .iter()
        .fold(0.0_f64, |most, part| most.max(part.abs()));
    along.iter().all(|part| part.is_finite()) && largest > 1e-6
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_name_a_row_a_cable_and_a_time() {
        let stuck = Injection::parse("s2@3.0s", 4).unwrap();
        assert_eq!(stuck, Injection::new(FaultId::S2, When::Motion(3.0)));
        let brake = Injection::parse("B1:4@start", 4).unwrap();
        assert_eq!((brake.cable, brake.when), (3, When::Start));
        assert_eq!(
            Injection::parse("C3@250ms", 4).unwrap().when,
            When::Motion(0.25)
        );
        for wrong in [
            "", "S2", "S2@", "S2@x", "S2@-1s", "S2@nan", "S2@1e9s", "X9@1s", "S2:0@1s", "S2:5@1s",
            "S2:a@1s", "@1s",
        ] {
            let error = Injection::parse(wrong, 4).unwrap_err();
            assert!(matches!(error, ScenarioError::Form { .. }), "{wrong}");
        }
        let hook = Injection::parse("snag:-z@1s", 4).unwrap();
        assert_eq!(hook.snag, Some(Snag::Against([0.0, 0.0, -1.0])));
        let hook = Injection::parse("SNAG@1s", 4).unwrap();
        assert_eq!((hook.fault, hook.snag), (FaultId::C2, Some(Snag::Fast)));
        let cut = Injection::parse("power:drives@1.5s/2s", 4).unwrap();
        assert_eq!((cut.supply, cut.lasts_s), (Some(Supply::Drives), Some(2.0)));
        let cut = Injection::parse("P1@1s", 4).unwrap();
        assert_eq!((cut.supply, cut.lasts_s), (Some(Supply::Board), None));
        let all = Injection::parse("power@1s", 4).unwrap();
        assert_eq!(all.supply, Some(Supply::All));
        for wrong in [
            "power:sun@1s",
            "power@1s/",
            "power@1s/-1s",
            "power@1s/start",
        ] {
            assert!(Injection::parse(wrong, 4).is_err(), "{wrong}");
        }
        let parked = Injection::parse("B2:3@parked+250ms", 4).unwrap();
        assert_eq!(parked.when, When::After(Phase::Parked, 0.25));
        for wrong in [
            "S2@gone+1s",
            "S2@parked+",
            "S2@parked+start",
            "S2@parked+-1s",
        ] {
            assert!(Injection::parse(wrong, 4).is_err(), "{wrong}");
        }
        for wrong in ["snag:1@1s", "snag:x@1s", "snag:+w@1s", "snag@"] {
            assert!(Injection::parse(wrong, 4).is_err(), "{wrong}");
        }
        assert!(matches!(
            Injection::parse("F3@1s", 4),
            Err(ScenarioError::NotHere { .. })
        ));
    }

    #[test]
    fn a_file_says_the_same_and_more_and_its_mistakes_are_named() {
        let text = "name = \"two\"\n[[fault]]\nid = \"S7\"\ncable = 2\nat_s = 1.5\nlasts_s = 0.1\n\
                    [[fault]]\nid = \"C1\"\nat = \"start\"\nstrength = 2\n";
        let scenario = Scenario::parse(text, "two.toml", 4).unwrap();
        assert_eq!(scenario.name, "two");
        assert_eq!(scenario.injections[0].lasts_s, Some(0.1));
        assert_eq!(scenario.injections[1].strength, 2.0);
        for (wrong, part) in [
            ("", "[[fault]]"),
            ("[[fault]]\nid = \"S7\"", "at_s"),
            ("[[fault]]\nid = \"S7\"\nat_s = -1", "at_s"),
            ("[[fault]]\nid = \"S7\"\nat_s = nan", "at_s"),
            ("[[fault]]\nid = \"S7\"\nat_s = 1\nwho = 2", "who"),
            ("[[fault]]\nid = \"S7\"\nat_s = 1\ncable = 9", "no cable 9"),
            ("[[fault]]\nid = \"S7\"\nat_s = 1\nstrength = 0", "strength"),
            ("[[fault]]\nid = \"Z1\"\nat_s = 1", "no fault Z1"),
            (
                "[[fault]]\nid = \"snag\"\nat_s = 1\nalong = [0, 0, 0]",
                "along",
            ),
            (
                "[[fault]]\nid = \"S7\"\nat_s = 1\nalong = [1, 0, 0]",
                "along",
            ),
        ] {
            let error = Scenario::parse(wrong, "w.toml", 4).unwrap_err().to_string();
            assert!(error.contains(part), "{wrong}: {error}");
        }
    }
}
