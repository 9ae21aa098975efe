//! The robot description file: frame, cables, winches, platform, tool, camera, tags, limits.
//!
//! [`Robot::find`] takes a built-in robot's name or a path, [`Robot::load`] a path, and
//! [`Robot::parse`] a text. All give a [`Robot`] in SI units with every default filled in, or a
//! [`RobotError`] that names file, line, key and remedy. The keys are those of [`schema`]; their
//! documentation for users is `docs/robot-file.md`.
//!
//! ```
//! use mcdpr::robot::Robot;
//!
//! let robot = Robot::find("paper-table5")?;
//! // 8000 motor rpm through 371.13:1 onto a 20 mm drum: 45 mm/s.
//! assert!((robot.winches[0].max_cable_speed_mps() - 0.0451).abs() < 1e-4);
//! # Ok::<(), mcdpr::robot::RobotError>(())
//! ```

mod build;
mod error;
mod json_schema;
mod keys;
mod model;
mod modules;
mod read;
mod scene;
pub mod schema;
#[cfg(test)]
mod tests;
mod winches;

use std::path::{Path, PathBuf};

pub use error::{Invalid, Problem, RobotError};
pub use json_schema::json_schema;
pub use model::{
    Bus, Cable, Calibrated, Camera, Control, DriveKind, Gear, Gripper, GripperKind, LawKind,
    Limits, Platform, Robot, Tag, TensionLaw, TensionOutput, Tool, Winch,
};

use modules::Modules;
use read::Reader;

/// The robots that the program carries: name and text of each file in `robots/`.
pub const BUILT_IN: &[(&str, &str)] = &[
    (
        "paper-table5",
        include_str!("../../../robots/paper-table5.toml"),
    ),
    (
        "paper-geared",
        include_str!("../../../robots/paper-geared.toml"),
    ),
    (
        "paper-table3",
        include_str!("../../../robots/paper-table3.toml"),
    ),
    ("lab-fast", include_str!("../../../robots/lab-fast.toml")),
    (
        "lab-direct",
        include_str!("../../../robots/lab-direct.toml"),
    ),
    (
        "eight-cable",
        include_str!("../../../robots/eight-cable.toml"),
    ),
    (
        "planar-four",
        include_str!("../../../robots/planar-four.toml"),
    ),
    (
        "point-anchor",
        include_str!("../../../robots/point-anchor.toml"),
    ),
];

/// The texts that [`Robot::find`] reads for a robot: the robot file first, then the winch modules
/// that it names, each with its path relative to the robot file. Empty where there is none.
pub fn sources(name_or_path: &str) -> Vec<(String, String)> {
    let as_path = PathBuf::from(name_or_path);
    let built_in = BUILT_IN.iter().find(|(name, _)| *name == name_or_path);
    let candidates = [
        as_path,
        PathBuf::from(format!("{name_or_path}.toml")),
        Path::new("robots").join(format!("{name_or_path}.toml")),
    ];
    let (first, rest) = candidates.split_at(1);
    let file = |paths: &[PathBuf]| paths.iter().find(|path| path.is_file()).cloned();
    let (name, text, modules) = match (file(first), built_in) {
        (None, Some((name, text))) => {
            (format!("{name}.toml"), (*text).to_owned(), Modules::BuiltIn)
        }
        (found, _) => {
            let Some(path) = found.or_else(|| file(rest)) else {
                return Vec::new();
            };
            let Ok(text) = crate::files::read_text_to(&path, crate::files::MOST_ROBOT_BYTES) else {
                return Vec::new();
            };
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            let folder = path.parent().unwrap_or(Path::new("")).to_owned();
            (name.into_owned(), text, Modules::Folder(folder))
        }
    };
    let mut files = vec![(name, text.clone())];
    let table: toml::Table = text.parse().unwrap_or_default();
    let winches = table.get("winch").and_then(toml::Value::as_array);
    for winch in winches.into_iter().flatten() {
        let module = winch.get("module").and_then(toml::Value::as_str);
        let Some(asked) = module.filter(|asked| files.iter().all(|(name, _)| name != asked)) else {
            continue;
        };
        if let Ok((_, text)) = modules.open(asked) {
            files.push((asked.to_owned(), text));
        }
    }
    files
}

impl Robot {
    /// Loads a robot by path or by the name of a built-in one.
    ///
    /// A file at that path comes first, then a built-in robot of that name, then `NAME.toml` here
    /// and in `robots/`.
    ///
    /// # Errors
    /// [`RobotError::NotFound`] names what was tried and the built-in robots; otherwise as
    /// [`Robot::load`].
    pub fn find(name_or_path: &str) -> Result<Self, RobotError> {
        let as_path = PathBuf::from(name_or_path);
        if as_path.is_file() {
            return Self::load(&as_path);
        }
        if let Some((name, text)) = BUILT_IN.iter().find(|(name, _)| *name == name_or_path) {
            return read_robot(text, &format!("{name}.toml (built in)"), &Modules::BuiltIn);
        }
        let mut tried = vec![as_path];
        if !name_or_path.is_empty() && !name_or_path.ends_with(".toml") {
            tried.push(PathBuf::from(format!("{name_or_path}.toml")));
            tried.push(Path::new("robots").join(format!("{name_or_path}.toml")));
        }
        match tried.iter().find(|path| path.exists()) {
            Some(path) => Self::load(path),
            None => Err(RobotError::NotFound {
                asked: name_or_path.to_owned(),
                tried,
                built_in: BUILT_IN.iter().map(|(name, _)| *name).collect(),
            }),
        }
    }

    /// Loads the robot file at `path`; winch module files are sought from its folder on.
    ///
    /// # Errors
    /// [`RobotError::NotFound`] or [`RobotError::Unreadable`] for the file itself, and
    /// [`RobotError::Invalid`] with every mistake in it.
    pub fn load(path: &Path) -> Result<Self, RobotError> {
        match crate::files::read_text_to(path, crate::files::MOST_ROBOT_BYTES) {
            Ok(text) => Self::parse(&text, path),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                Err(RobotError::NotFound {
                    asked: path.display().to_string(),
                    tried: vec![path.to_owned()],
                    built_in: BUILT_IN.iter().map(|(name, _)| *name).collect(),
                })
            }
            Err(source) => Err(RobotError::Unreadable {
                path: path.to_owned(),
                source,
            }),
        }
    }

    /// Reads a robot from the text of a robot file.
    ///
    /// `origin` names the text in messages, and winch module files are sought in its folder; it
    /// need not exist.
    ///
    /// # Errors
    /// [`RobotError::Invalid`] with every mistake found: a text that is not TOML, unknown keys,
    /// values of the wrong kind or range, and contradictions between keys.
    pub fn parse(text: &str, origin: &Path) -> Result<Self, RobotError> {
        let folder = origin.parent().unwrap_or(Path::new("")).to_owned();
        read_robot(
            text,
            &origin.display().to_string(),
            &Modules::Folder(folder),
        )
    }
}

fn read_robot(text: &str, name: &str, modules: &Modules) -> Result<Robot, RobotError> {
    let mut reader = Reader::default();
    let file = reader.add_file(name, text);
    let robot = reader
        .read(file, &schema::ROBOT, schema::ROBOT.title)
        .and_then(|values| build::build(&mut reader, values, modules));
    match (robot, reader.into_error()) {
        (_, Some(error)) => Err(error),
        (Some(robot), None) => Ok(robot),
        // A file that gives no robot has noted why; should it not have, that is said too.
        (None, None) => Err(RobotError::Unreadable {
            path: PathBuf::from(name),
            source: std::io::Error::other("it describes no robot"),
        }),
    }
}
