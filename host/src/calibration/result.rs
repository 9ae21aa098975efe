//! A calibration as a file beside the robot file. It is written completely or not at all.

pub use mcdpr_calibration::result::*;

use super::answer::Answer;
use super::collect::{CollectError, of_this_robot};
use super::data::Data;
use crate::robot::Robot;
use crate::stamp::utc_stamp;
use miette::Diagnostic;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Why a calibration file cannot be used or written.
#[derive(Debug, thiserror::Error, Diagnostic)]
pub enum FileError {
    /// The file system failed.
    #[error("{}: {source}", path.display())]
    #[diagnostic(
        code(mcdpr::calibration::file),
        help(
            "check the folder's permissions and the room on the disk; an older calibration is as it was"
        )
    )]
    Io {
        /// Which file.
        path: PathBuf,
        /// The system's message.
        source: std::io::Error,
    },
    /// The content is invalid.
    #[error("{}: {what}", path.display())]
    #[diagnostic(
        code(mcdpr::calibration::file),
        help("calibrate again (`mcdpr calibrate all`), or run without it: --calibration none")
    )]
    Unusable {
        /// Which file.
        path: PathBuf,
        /// What is wrong.
        what: String,
    },
}

/// Path of a robot's calibration: beside its file, or in this folder for a built-in robot.
#[must_use]
pub(crate) fn path_for(robot: &str) -> PathBuf {
    let given = PathBuf::from(robot);
    if given.is_file() {
        return given.with_extension("calibration.json");
    }
    PathBuf::from(format!("{robot}.calibration.json"))
}

/// The file form of an answer for the robot on which the data were collected, made now.
///
/// # Errors
/// If the data do not name their robot.
pub fn document(robot: &Robot, data: &Data, answer: &Answer) -> Result<Value, CollectError> {
    of_this_robot(robot, robot.content_hash(), data)?;
    let date = utc_stamp();
    Ok(mcdpr_calibration::result::document(
        robot, data, answer, &date,
    ))
}

/// Writes a file completely or not at all.
///
/// # Errors
/// [`FileError::Io`]; an existing file is not changed.
pub fn write_whole(path: &Path, text: impl AsRef<[u8]>) -> Result<(), FileError> {
    crate::files::write_atomically(path, text).map_err(|source| FileError::Io {
        path: path.to_owned(),
        source,
    })
}

/// The robot with the calibration of a file applied.
///
/// # Errors
/// [`FileError`] if the file is unreadable, of another format, or of another description.
pub fn apply(robot: &Robot, path: &Path) -> Result<Robot, FileError> {
    let text = crate::files::read_text(path).map_err(|source| FileError::Io {
        path: path.to_owned(),
        source,
    })?;
    apply_text(robot, &text, path).map_err(|what| FileError::Unusable {
        path: path.to_owned(),
        what,
    })
}
