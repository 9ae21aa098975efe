//! Tasks: motions of the tool, by name or from a file.

use super::gcode::{self, is_gcode};
use super::path::{LEAST_LENGTH_M, Path, PathError, Piece};
use super::plan::{MOST_STEPS, PlanError};
use super::timed::Step;
use crate::near::nearest;
use mcdpr_kinematics::rotation_from_rpy;
use miette::Diagnostic;
use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use serde::Deserialize;
use std::path::PathBuf;
use thiserror::Error;

/// Names of the built-in tasks, with a description.
pub const BUILT_IN: &[(&str, &str)] = &[
    (
        "paper:table7",
        "the paper's approach and circle of 65 mm, in 10 s (Table 7)",
    ),
    ("paper:table8", "the paper's line of 500 mm (Table 8)"),
    (
        FITTING,
        "a circle that fits the robot's own work space, then tilts and turns where it has an attitude",
    ),
];

/// Name of the task that fits any robot.
pub const FITTING: &str = "fitting";

/// Time for the paper's circle, limited by its geared drives, s.
const CIRCLE_S: f64 = 10.0;

/// Smaller turns are not made, rad.
const LEAST_TURN_RAD: f64 = 1e-5;

/// A motion of the tool.
#[derive(Debug, Clone)]
pub struct Task {
    /// Its name.
    pub name: String,
    /// Where it starts, world, m; `None`: the tool's current position.
    start_m: Option<Vector3<f64>>,
    /// The attitude that it starts with (world_from_platform); `None`: the current one.
    start_attitude: Option<Rotation3<f64>>,
    /// Steps from rest to rest, each starting where the one before ends.
    pub steps: Vec<Step>,
}

/// Why a task cannot be loaded.
#[derive(Debug, Error, Diagnostic)]
pub enum TaskError {
    /// Neither a built-in task nor a file.
    #[error("there is no task {name}")]
    #[diagnostic(
        code(mcdpr::task::unknown),
        help(
            "{}built in are {}; anything else must be a task file (TOML), see docs/tasks.md",
            meant(name),
            names()
        )
    )]
    Unknown {
        /// What was asked for.
        name: String,
    },
    /// The file cannot be read.
    #[error("task file {path} cannot be read")]
    #[diagnostic(code(mcdpr::task::unreadable))]
    Unreadable {
        /// Which.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The file is not a valid task.
    #[error("task file {path} is malformed: {message}")]
    #[diagnostic(
        code(mcdpr::task::malformed),
        help("a task has start_mm and [[leg]] tables; see docs/tasks.md")
    )]
    Malformed {
        /// Which.
        path: PathBuf,
        /// What is wrong and where.
        message: String,
    },
    /// The G-code cannot be followed.
    #[error("{path}:{line}:{column}: {message}")]
    #[diagnostic(
        code(mcdpr::task::gcode),
        help(
            "G0 G1 G2 G3 G4 G17 G21 G90 G91 M3 M5 M2 M30 with X Y Z I J F P are understood; see docs/tasks.md"
        )
    )]
    GCode {
        /// Which file.
        path: PathBuf,
        /// Line, 1 for the first.
        line: usize,
        /// Column, 1 for the first.
        column: usize,
        /// What is wrong.
        message: String,
    },
    /// A leg of the file is not a valid path.
    #[error("leg {leg} of {path} is not a valid path")]
    #[diagnostic(
        code(mcdpr::task::leg),
        help("give each leg a length and finite numbers")
    )]
    BadLeg {
        /// Which file.
        path: PathBuf,
        /// Which leg, 1 for the first.
        leg: usize,
        /// Why.
        source: PathError,
    },
    /// Nothing that a robot could do was found.
    #[error("no circle fits the robot's work space")]
    #[diagnostic(
        code(mcdpr::task::fitting),
        help("correct box_mm of [limits] or home_mm of [tool], or name a task file")
    )]
    Fitting {
        /// Why the last one tried is impossible.
        source: Box<PlanError>,
    },
    /// A built-in task at an impossible height.
    #[error(transparent)]
    #[diagnostic(code(mcdpr::task::path))]
    Path(#[from] PathError),
}

fn meant(name: &str) -> String {
    let known = BUILT_IN.iter().map(|(known, _)| *known);
    nearest(name, known).map_or(String::new(), |known| format!("did you mean `{known}`? "))
}

fn names() -> String {
    let names: Vec<_> = BUILT_IN.iter().map(|(name, _)| *name).collect();
    names.join(", ")
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct TaskFile {
    name: Option<String>,
    start_mm: [f64; 3],
    start_attitude_deg: Option<[f64; 3]>,
    speed_mm_s: Option<f64>,
    #[serde(default)]
    leg: Vec<LegFile>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct LegFile {
    to_mm: Option<[f64; 3]>,
    points_mm: Option<Vec<[f64; 3]>>,
    through_mm: Option<Vec<[f64; 3]>>,
    circle_center_mm: Option<[f64; 3]>,
    dwell_s: Option<f64>,
    gripper: Option<GripperFile>,
    sweep_deg: Option<f64>,
    duration_s: Option<f64>,
    speed_mm_s: Option<f64>,
    attitude_deg: Option<[f64; 3]>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum GripperFile {
    Open,
    Close,
}

/// A step along a path as fast as the limits allow, or in a given time.
fn moved(path: Path, duration_s: Option<f64>) -> Step {
    Step::Move {
        path,
        duration_s,
        speed_mps: None,
    }
}

impl LegFile {
    /// The keys that define the kind of leg; exactly one must be given.
    fn kinds(&self) -> Vec<&'static str> {
        let all = [
            ("to_mm", self.to_mm.is_some()),
            ("points_mm", self.points_mm.is_some()),
            ("through_mm", self.through_mm.is_some()),
            ("circle_center_mm", self.circle_center_mm.is_some()),
            ("dwell_s", self.dwell_s.is_some()),
            ("gripper", self.gripper.is_some()),
        ];
        let given = all.into_iter().filter(|(_, given)| *given);
        given.map(|(name, _)| name).collect()
    }

    /// The pieces of path from `at_m` on; several if the tool rests between them.
    fn pieces(&self, at_m: Vector3<f64>, turned: &Rotation3<f64>) -> Result<Vec<Piece>, PathError> {
        // To the same place with another attitude: a turn in place.
        if let (Some(to), Some(angles)) = (self.to_mm, self.attitude_deg)
            && (point(to) - at_m).norm() < LEAST_LENGTH_M
        {
            return Ok(vec![Piece::turn(at_m, angle(turned, &attitude(angles)))?]);
        }
        if let Some(to) = self.to_mm {
            return Ok(vec![Piece::line(at_m, point(to))?]);
        }
        if let Some(points) = &self.points_mm {
            let mut from_m = at_m;
            return points
                .iter()
                .map(|to| Piece::line(std::mem::replace(&mut from_m, point(*to)), point(*to)))
                .collect();
        }
        if let Some(points) = &self.through_mm {
            let all: Vec<_> = std::iter::once(at_m)
                .chain(points.iter().map(|p| point(*p)))
                .collect();
            return Ok(vec![Piece::curve(&all)?]);
        }
        let Some(center) = self.circle_center_mm else {
            return Ok(Vec::new());
        };
        let center_m = point(center);
        let radius_m = (at_m - center_m).xy().norm();
        let sweep_rad = self.sweep_deg.unwrap_or(360.0).to_radians();
        Ok(vec![Piece::arc(center_m, radius_m, at_m, sweep_rad)?])
    }
}

impl Task {
    /// A built-in task by name. `z_m` is the height of the tool.
    ///
    /// # Errors
    /// [`TaskError::Unknown`] names the built-in tasks; a path error if the height is impossible.
    pub fn built_in(name: &str, z_m: f64) -> Result<Self, TaskError> {
        match name {
            "paper:table7" => Self::table7(z_m),
            "paper:table8" => Ok(Self {
                name: name.to_owned(),
                start_m: Some(start_of(&Path::paper_line(z_m)?)),
                start_attitude: None,
                steps: vec![moved(Path::paper_line(z_m)?, None)],
            }),
            _ => Err(TaskError::Unknown {
                name: name.to_owned(),
            }),
        }
    }

    /// Table 7: the approach as fast as the limits allow, then the circle in ten seconds.
    fn table7(z_m: f64) -> Result<Self, TaskError> {
        let whole = Path::paper_circle(z_m)?;
        let steps = whole.pieces().iter().map(|piece| {
            let duration_s = piece.radius_m().map(|_| CIRCLE_S);
            Ok(moved(Path::new(vec![piece.clone()])?, duration_s))
        });
        Ok(Self {
            name: "paper:table7".to_owned(),
            start_m: Some(start_of(&whole)),
            start_attitude: None,
            steps: steps.collect::<Result<_, PathError>>()?,
        })
    }

    /// Reads a task from the text of a G-code file; `path` names it in messages. `docs/tasks.md`
    /// lists the words that are understood.
    ///
    /// # Errors
    /// [`TaskError::GCode`] with line and column.
    pub fn parse_gcode(text: &str, path: PathBuf) -> Result<Self, TaskError> {
        let name = path.display().to_string();
        match gcode::read(text) {
            Ok(program) => Ok(Self {
                name,
                start_m: program.start_m,
                start_attitude: program.start_attitude,
                steps: program.steps,
            }),
            Err(error) => Err(TaskError::GCode {
                path,
                line: error.line,
                column: error.column,
                message: error.message,
            }),
        }
    }

    /// Reads a task from the text of the file at `path`: G-code where [`is_gcode`] says so, TOML otherwise.
    ///
    /// # Errors
    /// As [`Self::parse_gcode`] and [`Self::parse`].
    pub fn parse_file(text: &str, path: PathBuf) -> Result<Self, TaskError> {
        if is_gcode(&path) {
            return Self::parse_gcode(text, path);
        }
        Self::parse(text, path)
    }

    /// Reads a task from the text of a TOML file; `path` names it in messages.
    ///
    /// # Errors
    /// [`TaskError::Malformed`], [`TaskError::BadLeg`].
    pub fn parse(text: &str, path: PathBuf) -> Result<Self, TaskError> {
        let malformed = |message: String| TaskError::Malformed {
            path: path.clone(),
            message,
        };
        let file: TaskFile = toml::from_str(text).map_err(|error| malformed(error.to_string()))?;
        if file.leg.is_empty() {
            return Err(malformed("there is no [[leg]]".to_owned()));
        }
        let start_m = point(file.start_mm);
        let start_attitude = file.start_attitude_deg.map(attitude);
        let mut at_m = start_m;
        let mut turned = start_attitude.unwrap_or_default();
        let mut steps = Vec::new();
        let too_many = || malformed(format!("it has more than {MOST_STEPS} steps"));
        for (number, leg) in (1..).zip(&file.leg) {
            let wrong = |what: String| malformed(format!("leg {number}: {what}"));
            let kind = match leg.kinds()[..] {
                [kind] => kind,
                _ => {
                    return Err(wrong(
                        "it needs exactly one of to_mm, points_mm, through_mm, circle_center_mm, \
                         dwell_s, gripper"
                            .to_owned(),
                    ));
                }
            };
            let moves = !matches!(kind, "dwell_s" | "gripper");
            if leg.attitude_deg.is_some() && !moves {
                return Err(wrong(format!("attitude_deg does not go with {kind}")));
            }
            let angles = leg.attitude_deg.iter().flatten();
            if angles
                .chain(file.start_attitude_deg.iter().flatten())
                .any(|a| !a.is_finite())
            {
                return Err(wrong("an attitude is three finite angles".to_owned()));
            }
            for (key, value, fits) in [
                // Several lines with rests between them have no common duration.
                ("duration_s", leg.duration_s, moves && kind != "points_mm"),
                ("speed_mm_s", leg.speed_mm_s, moves),
                ("sweep_deg", leg.sweep_deg, kind == "circle_center_mm"),
            ] {
                if value.is_some() && !fits {
                    return Err(wrong(format!("{key} does not go with {kind}")));
                }
                // A sweep may be negative: clockwise.
                let positive = key == "sweep_deg" || value.is_none_or(|v| v > 0.0);
                if !positive || value.is_some_and(|v| !v.is_finite()) {
                    return Err(wrong(format!("{key} must be over 0")));
                }
            }
            if leg.duration_s.is_some() && leg.speed_mm_s.is_some() {
                return Err(wrong("give duration_s or speed_mm_s, not both".to_owned()));
            }
            if let Some(duration_s) = leg.dwell_s {
                if !(duration_s.is_finite() && duration_s >= 0.0) {
                    return Err(wrong("dwell_s must be 0 or more".to_owned()));
                }
                steps.push(Step::Dwell { duration_s });
            }
            if let Some(gripper) = leg.gripper {
                steps.push(Step::Gripper {
                    closed: gripper == GripperFile::Close,
                });
            }
            let bad = |source| TaskError::BadLeg {
                path: path.clone(),
                leg: number,
                source,
            };
            let to = leg.attitude_deg.map(attitude);
            let pieces = leg.pieces(at_m, &turned).map_err(bad)?;
            turned = to.unwrap_or(turned);
            let last = pieces.len().saturating_sub(1);
            if moves && pieces.is_empty() {
                return Err(wrong(format!("{kind} has no points")));
            }
            // A leg with its own time is not subject to the file's general speed.
            let general = file.speed_mm_s.filter(|_| leg.duration_s.is_none());
            if steps.len() + pieces.len() > MOST_STEPS {
                return Err(too_many());
            }
            for (index, piece) in pieces.into_iter().enumerate() {
                at_m = piece.end().position_m;
                steps.push(Step::Move {
                    // Several pieces turn on the last one.
                    path: Path::new(vec![piece])
                        .map_err(bad)?
                        .turning_to(to.filter(|_| index == last)),
                    duration_s: leg.duration_s,
                    speed_mps: leg.speed_mm_s.or(general).map(|mm_s| mm_s * 1e-3),
                });
            }
        }
        let name = file.name.unwrap_or_else(|| path.display().to_string());
        Ok(Self {
            name,
            start_m: Some(start_m),
            start_attitude,
            steps,
        })
    }

    /// A task from `start_m` on with the platform level, where the robot has an attitude to choose.
    pub(super) fn fitted(start_m: Vector3<f64>, steps: Vec<Step>) -> Self {
        let turns =
            |step: &Step| matches!(step, Step::Move { path, .. } if path.attitude().is_some());
        Self {
            name: FITTING.to_owned(),
            start_m: Some(start_m),
            start_attitude: steps.iter().any(turns).then(Rotation3::identity),
            steps,
        }
    }

    /// The task of the tool going straight to a position (world, m) from its current one.
    ///
    /// # Errors
    /// [`TaskError::Path`] for a position that is not finite.
    pub fn go_to(name: &str, place_m: Vector3<f64>) -> Result<Self, TaskError> {
        if place_m.iter().any(|value| !value.is_finite()) {
            return Err(PathError::NotFinite { what: "the place" }.into());
        }
        Ok(Self {
            name: name.to_owned(),
            start_m: Some(place_m),
            start_attitude: None,
            steps: Vec::new(),
        })
    }

    /// Where the task starts, world, m; `None`: the tool's current position.
    #[must_use]
    pub fn start_m(&self) -> Option<Vector3<f64>> {
        self.start_m
    }

    /// The same task with a straight move to its start from `from_m`, if that is a micrometre
    /// away or more; the move keeps `speed_mps` if one is given.
    ///
    /// # Errors
    /// [`TaskError::Path`].
    pub fn approached_from(
        self,
        from_m: &Vector3<f64>,
        speed_mps: Option<f64>,
    ) -> Result<Self, TaskError> {
        self.approached_turned(from_m, None, speed_mps)
    }

    /// As [`Task::approached_from`], from an attitude (world_from_platform) too: a task that gives one at
    /// its start is reached with it, by a turn in place where there is no way to go.
    ///
    /// # Errors
    /// [`TaskError::Path`].
    pub(crate) fn approached_turned(
        mut self,
        from_m: &Vector3<f64>,
        attitude: Option<Rotation3<f64>>,
        speed_mps: Option<f64>,
    ) -> Result<Self, TaskError> {
        let Some(start_m) = self.start_m else {
            return Ok(self);
        };
        let from = attitude.unwrap_or_default();
        let turned = self.start_attitude.map_or(0.0, |to| angle(&from, &to));
        let path = if (start_m - from_m).norm() >= LEAST_LENGTH_M {
            Path::through(&[*from_m, start_m])?
        } else if turned > LEAST_TURN_RAD {
            Path::new(vec![Piece::turn(start_m, turned)?])?
        } else {
            return Ok(self);
        };
        let way = Step::Move {
            path: path.turning_to(self.start_attitude),
            duration_s: None,
            speed_mps,
        };
        self.steps.insert(0, way);
        self.start_m = Some(*from_m);
        Ok(self)
    }
}

fn start_of(path: &Path) -> Vector3<f64> {
    let first = path.pieces().first().map(|piece| piece.start().position_m);
    first.unwrap_or_default()
}

/// Angle between two attitudes, rad; by a quaternion, which rounding does not take out of the domain.
fn angle(a: &Rotation3<f64>, b: &Rotation3<f64>) -> f64 {
    UnitQuaternion::from_rotation_matrix(&(a.inverse() * b)).angle()
}

/// Roll, pitch and yaw in degrees as a rotation, R = Rz Ry Rx.
fn attitude(degrees: [f64; 3]) -> Rotation3<f64> {
    rotation_from_rpy(degrees.map(f64::to_radians))
}

fn point([x, y, z]: [f64; 3]) -> Vector3<f64> {
    Vector3::new(x, y, z) / 1e3
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_start_at_any_small_distance_is_reached_or_is_here_already() {
        let text = "start_mm = [300, 0, -200]\n[[leg]]\nto_mm = [310, 0, -200]\n";
        let task = Task::parse(text, PathBuf::from("line.toml")).unwrap();
        for nanometres in 0..3000 {
            let from_m = Vector3::new(0.3 - f64::from(nanometres) * 1e-9, 0.0, -0.2);
            let whole = task.clone().approached_from(&from_m, None);
            let steps = whole.map(|whole| whole.steps.len());
            // Around the shortest piece that a path takes, rounding decides.
            match nanometres {
                0..999 => assert_eq!(steps.ok(), Some(1), "{nanometres} nm"),
                1001.. => assert_eq!(steps.ok(), Some(2), "{nanometres} nm"),
                _ => assert!(steps.is_ok(), "{nanometres} nm: {steps:?}"),
            }
        }
    }
}
