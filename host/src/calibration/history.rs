//! The history of a robot's calibration: every one that was in use, and the way back to any of them.
//!
//! A file of one JSON object per line beside the calibration, which is only ever added to. Each entry has
//! the whole text of its calibration. A line that a cut of power left torn is skipped and said.

use super::result::{FileError, apply_text, write_whole};
use crate::robot::Robot;
use crate::stamp::utc_stamp;
use mcdpr_protocol::frame::crc32;
use serde::{Deserialize, Serialize};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Name of the format.
const SCHEMA: &str = "mcdpr-calibration-history-1";
/// A history is refused above this size: some thousands of calibrations.
const MOST_BYTES: u64 = 512 << 20;

/// One calibration that was put to use.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Entry {
    schema: String,
    /// From 1.
    pub(crate) number: usize,
    /// When it was put to use, UTC, as in 20260301-120000.
    pub(crate) date: String,
    /// Why.
    pub(crate) cause: String,
    /// Name of the robot.
    pub(crate) robot: String,
    /// Hash of the robot's description.
    pub(crate) robot_hash: String,
    /// Greatest distance by which an anchor moved against the entry before, mm; against the robot file for
    /// the first.
    pub(crate) moved_mm: Option<f64>,
    /// The cable of that anchor, from 1.
    pub(crate) moved_cable: Option<usize>,
    /// Predicted position error, mm.
    pub(crate) error_mm: Option<f64>,
    crc32: u32,
    /// The calibration file.
    text: String,
}

impl Entry {
    /// Whether the calibration file has this text.
    #[must_use]
    pub(crate) fn is(&self, text: &str) -> bool {
        self.text == text
    }
}

/// All entries of a robot.
#[derive(Debug, Clone, Default)]
pub(crate) struct History {
    /// In the order in which they were put to use.
    pub(crate) entries: Vec<Entry>,
    /// Lines that could not be read, from 1.
    pub(crate) torn: Vec<usize>,
}

/// The history beside a calibration file.
#[must_use]
pub(crate) fn history_path(calibration: &Path) -> PathBuf {
    let name = calibration.file_name().unwrap_or_default();
    let name = name.to_string_lossy();
    let stem = name.strip_suffix(".json").unwrap_or(&name);
    calibration.with_file_name(format!("{stem}.history.jsonl"))
}

fn unusable(path: &Path, what: impl Into<String>) -> FileError {
    FileError::Unusable {
        path: path.to_owned(),
        what: what.into(),
    }
}

fn failed(path: &Path) -> impl FnOnce(std::io::Error) -> FileError + '_ {
    |source| FileError::Io {
        path: path.to_owned(),
        source,
    }
}

/// The text of a file, if there is one.
pub(crate) fn text_of(path: &Path, most: u64) -> Result<Option<String>, FileError> {
    match crate::files::read_text_to(path, most) {
        Ok(text) => Ok(Some(text)),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(failed(path)(error)),
    }
}

/// Reads the history beside a calibration file; empty if there is none.
///
/// # Errors
/// [`FileError`]; a history of another robot is refused.
pub(crate) fn history(robot: &Robot, calibration: &Path) -> Result<History, FileError> {
    let path = history_path(calibration);
    let mut found = History::default();
    let Some(text) = text_of(&path, MOST_BYTES)? else {
        return Ok(found);
    };
    for (line, text) in (1..).zip(text.lines()) {
        let entry: Option<Entry> = serde_json::from_str(text).ok();
        let entry = entry.filter(|e| e.schema == SCHEMA && e.crc32 == crc32(e.text.as_bytes()));
        let Some(entry) = entry else {
            found.torn.push(line);
            continue;
        };
        if entry.robot != robot.name {
            let what = format!(
                "line {line} is of robot {}, this is {}: it is the history of another robot. Move it away, and \
                 the next calibration begins a new one",
                entry.robot, robot.name
            );
            return Err(unusable(&path, what));
        }
        found.entries.push(entry);
    }
    Ok(found)
}

/// Takes the calibration in use into the history, unless it is the last entry; gives the last entry.
///
/// # Errors
/// [`FileError`]: nothing was written, and the calibration is as it was.
pub(crate) fn remember(
    robot: &Robot,
    calibration: &Path,
    cause: &str,
) -> Result<Option<Entry>, FileError> {
    let Some(text) = text_of(calibration, crate::files::MOST_TEXT_BYTES)? else {
        return Ok(None);
    };
    let known = history(robot, calibration)?;
    if let Some(last) = known.entries.last().filter(|last| last.text == text) {
        return Ok(Some(last.clone()));
    }
    let now = apply_text(robot, &text, calibration).map_err(|what| unusable(calibration, what))?;
    let before = known
        .entries
        .last()
        .and_then(|last| apply_text(robot, &last.text, calibration).ok());
    let before = before.as_ref().unwrap_or(robot);
    let moved = now
        .cables
        .iter()
        .zip(&before.cables)
        .map(|(now, then)| (now.anchor_in_world_m - then.anchor_in_world_m).norm() * 1e3);
    let moved = (1..).zip(moved).max_by(|a, b| a.1.total_cmp(&b.1));
    let predicted = now.calibrated.as_ref().and_then(|c| c.predicted_error_m);
    let entry = Entry {
        schema: SCHEMA.to_owned(),
        number: known.entries.last().map_or(0, |last| last.number) + 1,
        date: utc_stamp(),
        cause: cause.to_owned(),
        robot: robot.name.clone(),
        robot_hash: format!("{:08x}", robot.content_hash()),
        moved_mm: moved.map(|(_, mm)| mm),
        moved_cable: moved.map(|(cable, _)| cable),
        error_mm: predicted.map(|m| m * 1e3),
        crc32: crc32(text.as_bytes()),
        text,
    };
    append(&history_path(calibration), &entry)?;
    Ok(Some(entry))
}

/// Adds a line, on the disk when it returns.
pub(crate) fn append(path: &Path, entry: &impl Serialize) -> Result<(), FileError> {
    let line = serde_json::to_string(entry).map_err(|error| unusable(path, error.to_string()))?;
    let torn =
        text_of(path, MOST_BYTES)?.is_some_and(|text| !text.is_empty() && !text.ends_with('\n'));
    let mut file = std::fs::OpenOptions::new()
        .create(true)
        .append(true)
        .open(path)
        .map_err(failed(path))?;
    // What a cut of power left ends here: the new line is whole.
    let begin = if torn { "\n" } else { "" };
    file.write_all(format!("{begin}{line}\n").as_bytes())
        .map_err(failed(path))?;
    file.sync_all().map_err(failed(path))
}

/// Uses the calibration of an earlier entry again. The one in use is taken into the history first, and kept
/// as a file with `.before` at its end.
///
/// # Errors
/// [`FileError`]; the calibration in use is as it was.
pub(crate) fn back_to(
    robot: &Robot,
    calibration: &Path,
    number: usize,
) -> Result<Entry, FileError> {
    let path = history_path(calibration);
    let known = history(robot, calibration)?;
    let wanted = known.entries.iter().find(|entry| entry.number == number);
    let Some(wanted) = wanted else {
        let count = known.entries.len();
        let what =
            format!("it has no entry {number}: it has {count}, see `mcdpr calibrate history`");
        return Err(unusable(&path, what));
    };
    apply_text(robot, &wanted.text, calibration)
        .map_err(|what| unusable(&path, format!("entry {number}: {what}")))?;
    let now = text_of(calibration, crate::files::MOST_TEXT_BYTES)?;
    if let Some(now) = now.filter(|now| *now != wanted.text) {
        // One that no command of this program put there may be of another description: kept as a file only.
        if apply_text(robot, &now, calibration).is_ok() {
            remember(robot, calibration, "found in use")?;
        }
        let mut before = calibration.as_os_str().to_owned();
        before.push(".before");
        write_whole(Path::new(&before), &now)?;
    }
    write_whole(calibration, &wanted.text)?;
    remember(robot, calibration, &format!("went back to {number}"))?;
    Ok(wanted.clone())
}
