//! Tasks: what the tool shall do, by name or from a file.

use super::path::{Path, PathError, Piece};
use super::plan::Leg;
use miette::Diagnostic;
use nalgebra::Vector3;
use serde::Deserialize;
use std::path::PathBuf;
use thiserror::Error;

/// Names of the built-in tasks, with what they are.
pub const BUILT_IN: &[(&str, &str)] = &[
    (
        "paper:table7",
        "the paper's approach and circle of 65 mm, in 10 s (Table 7)",
    ),
    ("paper:table8", "the paper's line of 500 mm (Table 8)"),
];

/// Time for the paper's circle: what its geared drives allow, s.
const CIRCLE_S: f64 = 10.0;

/// A motion of the tool.
#[derive(Debug, Clone)]
pub struct Task {
    /// Its name.
    pub name: String,
    /// Pieces from rest to rest, each starting where the one before ends.
    pub legs: Vec<Leg>,
}

/// Why there is no such task.
#[derive(Debug, Error, Diagnostic)]
pub enum TaskError {
    /// Neither a built-in task nor a file.
    #[error("there is no task {name}")]
    #[diagnostic(
        code(mcdpr::task::unknown),
        help(
            "built in are {}; anything else must be a task file (TOML), see docs/tasks.md",
            names()
        )
    )]
    Unknown {
        /// What was asked for.
        name: String,
    },
    /// The file can not be read.
    #[error("task file {path} can not be read")]
    #[diagnostic(code(mcdpr::task::unreadable))]
    Unreadable {
        /// Which.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The file is no task.
    #[error("task file {path} is malformed: {message}")]
    #[diagnostic(
        code(mcdpr::task::malformed),
        help(
            "a task has start_mm and [[leg]] tables with to_mm or circle_center_mm; see docs/tasks.md"
        )
    )]
    Malformed {
        /// Which.
        path: PathBuf,
        /// What is wrong and where.
        message: String,
    },
    /// A leg of the file is no path.
    #[error("leg {leg} of {path} is no path")]
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
    /// A built-in task at an impossible height.
    #[error(transparent)]
    #[diagnostic(code(mcdpr::task::path))]
    Path(#[from] PathError),
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
    #[serde(default)]
    leg: Vec<LegFile>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct LegFile {
    to_mm: Option<[f64; 3]>,
    circle_center_mm: Option<[f64; 3]>,
    sweep_deg: Option<f64>,
    duration_s: Option<f64>,
}

impl Task {
    /// A built-in task by name, or a task file by path. `z_m` is the height of the tool for the
    /// built-in ones.
    ///
    /// # Errors
    /// [`TaskError`] says what is wrong and where.
    pub fn find(name: &str, z_m: f64) -> Result<Self, TaskError> {
        match name {
            "paper:table7" => Self::table7(z_m),
            "paper:table8" => Ok(Self {
                name: name.to_owned(),
                legs: vec![Leg {
                    path: Path::paper_line(z_m)?,
                    duration_s: None,
                }],
            }),
            _ => Self::load(name),
        }
    }

    /// Table 7: the approach as fast as the limits allow, then the circle in ten seconds.
    fn table7(z_m: f64) -> Result<Self, TaskError> {
        let whole = Path::paper_circle(z_m)?;
        let legs = whole.pieces().iter().map(|piece| {
            Ok(Leg {
                path: Path::new(vec![*piece])?,
                duration_s: piece.radius_m().map(|_| CIRCLE_S),
            })
        });
        Ok(Self {
            name: "paper:table7".to_owned(),
            legs: legs.collect::<Result<_, PathError>>()?,
        })
    }

    fn load(name: &str) -> Result<Self, TaskError> {
        let path = PathBuf::from(name);
        let text = match std::fs::read_to_string(&path) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                return Err(TaskError::Unknown {
                    name: name.to_owned(),
                });
            }
            Err(source) => return Err(TaskError::Unreadable { path, source }),
        };
        Self::parse(&text, path)
    }

    /// Reads a task from the text of a file; `path` names it in messages.
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
        let mut at_m = point(file.start_mm);
        let mut legs = Vec::new();
        for (index, leg) in file.leg.iter().enumerate() {
            let bad = |source| TaskError::BadLeg {
                path: path.clone(),
                leg: index + 1,
                source,
            };
            let piece = match (leg.to_mm, leg.circle_center_mm) {
                (Some(to), None) => Piece::line(at_m, point(to)).map_err(bad)?,
                (None, Some(center)) => {
                    let center_m = point(center);
                    let radius_m = (at_m - center_m).xy().norm();
                    let sweep_rad = leg.sweep_deg.unwrap_or(360.0).to_radians();
                    Piece::arc(center_m, radius_m, at_m, sweep_rad).map_err(bad)?
                }
                _ => {
                    let number = index + 1;
                    return Err(malformed(format!(
                        "leg {number} needs either to_mm or circle_center_mm"
                    )));
                }
            };
            if leg.duration_s.is_some_and(|s| !s.is_finite() || s <= 0.0) {
                let number = index + 1;
                return Err(malformed(format!(
                    "leg {number}: duration_s must be over 0"
                )));
            }
            at_m = piece.end().position_m;
            legs.push(Leg {
                path: Path::new(vec![piece]).map_err(bad)?,
                duration_s: leg.duration_s,
            });
        }
        let name = file.name.unwrap_or_else(|| path.display().to_string());
        Ok(Self { name, legs })
    }

    /// Where the task starts, world, m.
    #[must_use]
    pub fn start_m(&self) -> Option<Vector3<f64>> {
        let first = self.legs.first()?.path.pieces().first()?;
        Some(first.start().position_m)
    }

    /// The same task with a straight way to its start from `from_m`, where that is further than
    /// half a micrometre.
    ///
    /// # Errors
    /// [`TaskError::Path`].
    pub fn approached_from(mut self, from_m: &Vector3<f64>) -> Result<Self, TaskError> {
        if let Some(start_m) = self.start_m()
            && (start_m - from_m).norm() > 5e-7
        {
            let way = Leg {
                path: Path::through(&[*from_m, start_m])?,
                duration_s: None,
            };
            self.legs.insert(0, way);
        }
        Ok(self)
    }
}

fn point([x, y, z]: [f64; 3]) -> Vector3<f64> {
    Vector3::new(x, y, z) / 1e3
}
