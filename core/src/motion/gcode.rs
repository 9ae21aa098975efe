//! A subset of G-code (ISO 6983, as RS274/NGC reads it), because users of cable machines bring such
//! programs.
//!
//! Understood: `G0` `G1` `G2` `G3` (arcs in the horizontal plane by `I` `J`, no change of height),
//! `G4 P` (seconds), `G17`, `G21`, `G90` `G91`, `M3` (close the gripper), `M5` (open it), `M2`
//! `M30` (end), `F` (mm/min), `N` numbers, comments in parentheses or after a semicolon, and `A` `B` `C`:
//! roll, pitch and yaw of the platform at the end of a move, degrees, R = Rz(C) Ry(B) Rx(A). A move
//! of these alone turns the platform in place, and `F` is degrees a minute there. Anything else is
//! refused with its line and column, because a skipped word could be an important one.

mod words;

use self::words::{Word, Wrong, words};
use super::path::{Path, PathError, Piece, TURN_LEVER_M, near};
use super::plan::MOST_STEPS;
use super::timed::Step;
use mcdpr_kinematics::rotation_from_rpy;
use nalgebra::{Rotation3, UnitQuaternion, Vector3};

/// Endings of G-code files' names, without the dot, in lower case.
pub const GCODE_ENDINGS: [&str; 4] = ["gcode", "nc", "ngc", "g"];

/// Whether a file with this name holds G-code.
#[must_use]
pub fn is_gcode(path: &std::path::Path) -> bool {
    let ending = path.extension().and_then(|ending| ending.to_str());
    ending.is_some_and(|ending| {
        GCODE_ENDINGS
            .iter()
            .any(|known| known.eq_ignore_ascii_case(ending))
    })
}

/// The part of a program that is not understood, and where it is.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct GCodeError {
    /// Line, from 1.
    pub line: usize,
    /// Column, from 1.
    pub column: usize,
    /// What is wrong.
    pub message: String,
}

/// State that carries over from line to line.
struct Machine {
    /// Position of the tool, mm; unknown until all of X, Y and Z were given.
    at_mm: [Option<f64>; 3],
    /// A, B and C, degrees.
    turned_deg: [f64; 3],
    /// Whether the program gives an attitude.
    turns: bool,
    absolute: bool,
    /// G0 to G3.
    motion: Option<u8>,
    feed_mm_min: Option<f64>,
    start_m: Option<Vector3<f64>>,
    start_deg: [f64; 3],
    steps: Vec<Step>,
}

/// A program as a task.
#[derive(Debug)]
pub(super) struct Program {
    /// The first complete place, world, m.
    pub start_m: Option<Vector3<f64>>,
    /// The attitude there (world_from_platform), of a program that gives any: level, where it gives it
    /// later.
    pub start_attitude: Option<Rotation3<f64>>,
    /// What it does from there.
    pub steps: Vec<Step>,
}

/// Reads a program.
pub(super) fn read(text: &str) -> Result<Program, GCodeError> {
    let mut machine = Machine {
        at_mm: [None; 3],
        turned_deg: [0.0; 3],
        turns: false,
        start_deg: [0.0; 3],
        absolute: true,
        motion: None,
        feed_mm_min: None,
        start_m: None,
        steps: Vec::new(),
    };
    let mut last = 1;
    for (index, line) in text.lines().enumerate() {
        last = index + 1;
        let at = |column: usize, message: String| GCodeError {
            line: index + 1,
            column,
            message,
        };
        let words = words(line).map_err(|(column, message)| at(column, message))?;
        let ended = machine
            .block(&words)
            .map_err(|(column, message)| at(column, message))?;
        // On every line: a long program must not fill the memory first.
        if machine.steps.len() > MOST_STEPS {
            return Err(at(
                1,
                format!("the program has more than {MOST_STEPS} steps"),
            ));
        }
        if ended {
            break;
        }
    }
    if machine.start_m.is_none() {
        return Err(GCodeError {
            line: last,
            column: 1,
            message: "the program gives no complete position: give X, Y and Z once".to_owned(),
        });
    }
    Ok(Program {
        start_m: machine.start_m,
        start_attitude: machine.turns.then(|| attitude(machine.start_deg)),
        steps: machine.steps,
    })
}

impl Machine {
    /// Reads one line; returns whether the program ends with it.
    fn block(&mut self, words: &[Word]) -> Result<bool, Wrong> {
        let mut axes: [Option<Word>; 3] = [None; 3];
        let mut turns: [Option<Word>; 3] = [None; 3];
        let (mut offset_i, mut offset_j, mut wait) = (None, None, None);
        let (mut dwell, mut ended) = (None, false);
        let mut gripper = None;
        for word in words {
            let Word {
                letter,
                value,
                column,
            } = *word;
            // Codes such as G5.1 have one decimal: compared in tenths, G2.1 is not taken for G2.
            let tenths = (value * 10.0).round();
            let whole = |known: &[f64]| known.iter().any(|k| (tenths - k * 10.0).abs() < 0.5);
            match letter {
                'N' | 'O' => {}
                'G' if whole(&[0.0, 1.0, 2.0, 3.0]) => {
                    // One of four small whole numbers.
                    self.motion = [0_u8, 1, 2, 3]
                        .into_iter()
                        .find(|n| (f64::from(*n) - value).abs() < 0.05);
                }
                'G' if whole(&[4.0]) => dwell = Some(column),
                'G' if whole(&[17.0, 21.0]) => {}
                'G' if whole(&[90.0]) => self.absolute = true,
                'G' if whole(&[91.0]) => self.absolute = false,
                'G' if whole(&[20.0]) => {
                    return Err((column, "inches (G20): give millimetres (G21)".to_owned()));
                }
                'M' if whole(&[3.0]) => gripper = Some(true),
                'M' if whole(&[5.0]) => gripper = Some(false),
                'M' if whole(&[2.0, 30.0]) => ended = true,
                'F' if value > 0.0 => self.feed_mm_min = Some(value),
                'F' => return Err((column, format!("F{value}: a speed is over 0"))),
                'X' => axes[0] = Some(*word),
                'Y' => axes[1] = Some(*word),
                'Z' => axes[2] = Some(*word),
                'A' => turns[0] = Some(*word),
                'B' => turns[1] = Some(*word),
                'C' => turns[2] = Some(*word),
                'I' => offset_i = Some(*word),
                'J' => offset_j = Some(*word),
                'P' => wait = Some(*word),
                _ => return Err((column, format!("{letter}{value} is not understood"))),
            }
        }
        // The order of execution of a block in RS274/NGC: tool first, then waits and moves.
        if let Some(closed) = gripper {
            self.steps.push(Step::Gripper { closed });
        }
        if let Some(column) = dwell {
            let seconds = wait.ok_or((column, "G4 needs P, the seconds to wait".to_owned()))?;
            if seconds.value < 0.0 {
                return Err((seconds.column, "a wait is 0 or more seconds".to_owned()));
            }
            if let Some(word) = axes.iter().chain(&turns).flatten().next() {
                return Err((word.column, "G4 does not move".to_owned()));
            }
            self.steps.push(Step::Dwell {
                duration_s: seconds.value,
            });
        } else if let Some(word) = wait {
            return Err((word.column, "P belongs to G4".to_owned()));
        } else {
            let from_deg = self.turned_deg;
            self.turn(turns)?;
            let places = axes.iter().chain(&turns).any(Option::is_some);
            if places || offset_i.is_some() || offset_j.is_some() {
                let column = words.first().map_or(1, |word| word.column);
                self.travel(column, from_deg, axes, offset_i, offset_j)?;
            }
        }
        Ok(ended)
    }

    /// Takes the angles of a block.
    fn turn(&mut self, turns: [Option<Word>; 3]) -> Result<(), Wrong> {
        for (angle_deg, word) in self.turned_deg.iter_mut().zip(turns) {
            let Some(Word { value, column, .. }) = word else {
                continue;
            };
            let by_deg = if self.absolute {
                value - *angle_deg
            } else {
                value
            };
            // The platform turns about one axis by the shortest way: half a turn has none.
            if self.start_m.is_some() && by_deg.abs() >= 180.0 {
                let message =
                    "a turn of half a turn or more has no shortest way: give places between";
                return Err((column, message.to_owned()));
            }
            *angle_deg += by_deg;
            self.turns = true;
        }
        Ok(())
    }

    fn travel(
        &mut self,
        column: usize,
        from_deg: [f64; 3],
        axes: [Option<Word>; 3],
        offset_i: Option<Word>,
        offset_j: Option<Word>,
    ) -> Result<(), Wrong> {
        let motion = self.motion.ok_or((
            column,
            "a position without G0, G1, G2 or G3 before it".to_owned(),
        ))?;
        let mut to_mm = self.at_mm;
        for (slot, word) in to_mm.iter_mut().zip(axes) {
            let Some(word) = word else { continue };
            *slot = if self.absolute {
                Some(word.value)
            } else {
                let from = slot.ok_or((
                    word.column,
                    "G91 before a complete position: the position of the tool is not known"
                        .to_owned(),
                ))?;
                Some(from + word.value)
            };
        }
        let from_mm = std::mem::replace(&mut self.at_mm, to_mm);
        let whole = |place: [Option<f64>; 3]| match place {
            [Some(x), Some(y), Some(z)] => Some(Vector3::new(x, y, z) / 1e3),
            _ => None,
        };
        let Some(to_m) = whole(to_mm) else {
            return Ok(());
        };
        let wrong = |error: PathError| (column, error.to_string());
        near(&to_m).map_err(wrong)?;
        let Some(from_m) = whole(from_mm) else {
            // The first position is where the task starts; the planner chooses the way to it.
            if motion > 1 {
                return Err((column, "the first move must be G0 or G1".to_owned()));
            }
            self.start_m = Some(to_m);
            self.start_deg = self.turned_deg;
            return Ok(());
        };
        let to = attitude(self.turned_deg);
        let turn = UnitQuaternion::from_rotation_matrix(&(attitude(from_deg).inverse() * to));
        let in_place = motion < 2 && (to_m - from_m).norm() < 1e-6 && turn.angle() > 1e-9;
        let piece = if in_place {
            Piece::turn(to_m, turn.angle()).map_err(wrong)?
        } else if motion < 2 {
            if let Some(word) = offset_i.or(offset_j) {
                return Err((word.column, format!("{} belongs to G2 and G3", word.letter)));
            }
            // Programs repeat positions; a move without length is not a path.
            if (to_m - from_m).norm() < 1e-6 {
                return Err((column, "this move has no length: leave it out".to_owned()));
            }
            Piece::line(from_m, to_m).map_err(wrong)?
        } else {
            arc(column, motion, from_m, to_m, offset_i, offset_j)?
        };
        let speed_mps = match (motion, self.feed_mm_min) {
            // G0 is as fast as the robot may be; F is in mm/min, of a turn in place in degrees/min.
            (0, _) => None,
            (_, Some(feed)) if in_place => Some(feed.to_radians() / 60.0 * TURN_LEVER_M),
            (_, Some(feed)) => Some(feed / 60e3),
            (_, None) if in_place => {
                return Err((column, "no speed yet: give F, degrees/min".to_owned()));
            }
            (_, None) => return Err((column, "no speed yet: give F, mm/min".to_owned())),
        };
        let turns = from_deg != self.turned_deg;
        // The end is where the piece ends: rounding must not add up over a program.
        self.steps.push(Step::Move {
            path: Path::new(vec![piece])
                .map_err(wrong)?
                .turning_to(turns.then_some(to)),
            duration_s: None,
            speed_mps,
        });
        Ok(())
    }
}

/// A, B and C in degrees as a rotation.
fn attitude(degrees: [f64; 3]) -> Rotation3<f64> {
    rotation_from_rpy(degrees.map(f64::to_radians))
}

/// An arc of G2 or G3: from here about (I, J) to there.
fn arc(
    column: usize,
    motion: u8,
    from_m: Vector3<f64>,
    to_m: Vector3<f64>,
    offset_i: Option<Word>,
    offset_j: Option<Word>,
) -> Result<Piece, Wrong> {
    if offset_i.is_none() && offset_j.is_none() {
        return Err((column, "an arc needs its centre: I, J".to_owned()));
    }
    let offset = |word: Option<Word>| word.map_or(0.0, |word| word.value / 1e3);
    let center_m = from_m + Vector3::new(offset(offset_i), offset(offset_j), 0.0);
    if (to_m.z - from_m.z).abs() > 1e-6 {
        return Err((
            column,
            "an arc that changes height is not understood".to_owned(),
        ));
    }
    let (start, end) = ((from_m - center_m).xy(), (to_m - center_m).xy());
    let gap_m = (start.norm() - end.norm()).abs();
    // Programs round I, J and the end to some decimals of a millimetre: both radii differ by that.
    if gap_m > 1e-5 {
        let message = format!(
            "the arc's ends are {:.4} and {:.4} mm from its centre",
            start.norm() * 1e3,
            end.norm() * 1e3
        );
        return Err((column, message));
    }
    let turn = std::f64::consts::TAU;
    let mut sweep = libm::atan2(end.y, end.x) - libm::atan2(start.y, start.x);
    // Rounding must not make a whole circle an arc without length.
    if (to_m - from_m).norm() < 1e-7 {
        sweep = 0.0;
    }
    // G2 clockwise, G3 counter-clockwise; to the same place is a whole circle.
    sweep = if motion == 3 {
        (sweep - 1e-9).rem_euclid(turn) + 1e-9
    } else {
        -((-sweep - 1e-9).rem_euclid(turn) + 1e-9)
    };
    Piece::arc(center_m, start.norm(), from_m, sweep).map_err(|error| (column, error.to_string()))
}

#[cfg(test)]
mod tests;
