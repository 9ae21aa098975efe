//! The robot description file: frame, cables, winches, platform, tool, camera, tags, limits.
//!
//! [`Robot::parse`] takes a text, [`Robot::built_in`] the name of a robot that the program carries.
//! Both give a [`Robot`] in SI units with every default filled in, or a [`RobotError`] that names
//! file, line, key and remedy. The keys are those of [`schema`]; their documentation for users is
//! `docs/robot-file.md`.
//!
//! ```
//! use mcdpr_core::robot::Robot;
//!
//! let robot = Robot::built_in("paper-table5")?;
//! // 8000 motor rpm through 371.13:1 onto a 20 mm drum: 45 mm/s.
//! assert!((robot.winches[0].max_cable_speed_mps() - 0.0451).abs() < 1e-4);
//! # Ok::<(), mcdpr_core::robot::RobotError>(())
//! ```

mod auto;
mod boards;
mod build;
mod error;
mod json_schema;
mod keys;
mod model;
mod modules;
mod read;
mod scene;
pub mod schema;
mod settings;
#[cfg(test)]
mod tests;
mod winches;

use std::path::PathBuf;

pub use error::{Invalid, Problem, RobotError};
pub use json_schema::json_schema;
pub use model::{
    Board, Bus, Cable, Calibrated, Camera, Control, DriveKind, Gear, Gripper, GripperKind, Imu,
    LawKind, Limits, Platform, Robot, Surroundings, Tag, TagPlace, TensionLaw, TensionOutput, Tool,
    Winch,
};
pub use modules::{BuiltInModules, ModuleFiles};
pub use settings::{Change, Setting, changes, settings};

use read::Reader;

/// The robots that the program carries: name and text of each file in `robots/`.
pub const BUILT_IN: &[(&str, &str)] = &[
    (
        "paper-table5",
        include_str!("../../../robots/paper-table5.toml"),
    ),
    (
        "paper-optimistic",
        include_str!("../../../robots/paper-optimistic.toml"),
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
        "eight-two-boards",
        include_str!("../../../robots/eight-two-boards.toml"),
    ),
    (
        "eight-three-boards",
        include_str!("../../../robots/eight-three-boards.toml"),
    ),
    (
        "eight-suspended",
        include_str!("../../../robots/eight-suspended.toml"),
    ),
    ("six-cable", include_str!("../../../robots/six-cable.toml")),
    (
        "planar-vertical",
        include_str!("../../../robots/planar-vertical.toml"),
    ),
    (
        "three-point",
        include_str!("../../../robots/three-point.toml"),
    ),
    (
        "point-anchor",
        include_str!("../../../robots/point-anchor.toml"),
    ),
];

impl Robot {
    /// The built-in robot of this name.
    ///
    /// # Errors
    /// [`RobotError::NotFound`] names the built-in robots.
    pub fn built_in(name: &str) -> Result<Self, RobotError> {
        let Some((name, text)) = BUILT_IN.iter().find(|(known, _)| *known == name) else {
            return Err(RobotError::NotFound {
                asked: name.to_owned(),
                tried: Vec::new(),
                built_in: BUILT_IN.iter().map(|(name, _)| *name).collect(),
            });
        };
        Self::parse(text, &format!("{name}.toml (built in)"), &BuiltInModules)
    }

    /// Reads a robot from the text of a robot file.
    ///
    /// `name` names the text in messages; `modules` opens the winch module files that it names.
    ///
    /// # Errors
    /// [`RobotError::Invalid`] with every mistake found: a text that is not TOML, unknown keys,
    /// values of the wrong kind or range, and contradictions between keys.
    pub fn parse(text: &str, name: &str, modules: &dyn ModuleFiles) -> Result<Self, RobotError> {
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
}
