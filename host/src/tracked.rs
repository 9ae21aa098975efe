//! A robot's tracked state beside its description, and the history of it.
//!
//! `NAME.tracked.json` has the state in use, `NAME.tracked.history.jsonl` one line for each session that tracked.
//! A history is only added to, and its lines are whole states: any of them can be used again.

use crate::calibration::history::{append, text_of};
use crate::calibration::result::{FileError, path_for, write_whole};
use crate::motion::Model;
use crate::run::tracking::{Lesson, Tracking};
use crate::stamp::{unix_s, utc_stamp};
use mcdpr_core::estimate::friction::Friction;
use mcdpr_core::estimate::track::{Kept, KeptError, Prior, Tracker};
use mcdpr_protocol::frame::crc32;
use miette::Diagnostic;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use thiserror::Error;

const FILE: &str = "mcdpr-tracked-file-1";
const LINE: &str = "mcdpr-tracked-history-1";
/// A history is refused above this size: some thousands of sessions.
const MOST_BYTES: u64 = 512 << 20;
/// A state that was kept longer ago than this is used as if it had been kept then, s: creep has long ended.
const LONGEST_S: u64 = 30 * 86_400;

/// Why a tracked state cannot be used.
#[derive(Debug, Error, Diagnostic)]
pub(crate) enum TrackedError {
    /// A file.
    #[error(transparent)]
    #[diagnostic(transparent)]
    File(#[from] FileError),
    /// The state.
    #[error("{}: {source}", path.display())]
    #[diagnostic(
        code(mcdpr::track::state),
        help(
            "`mcdpr track --back-to N` goes back to an earlier state, `mcdpr track --forget` begins anew"
        )
    )]
    State {
        /// Its file.
        path: PathBuf,
        /// What is wrong.
        source: KeptError,
    },
    /// The file is not one.
    #[error("{}: it is not a tracked state: {what}", path.display())]
    #[diagnostic(
        code(mcdpr::track::file),
        help(
            "`mcdpr track --back-to N` goes back to an earlier state, `mcdpr track --forget` begins anew"
        )
    )]
    NotOne {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        what: String,
    },
    /// No such entry.
    #[error("the history {} has no entry {number}: it has {count}", path.display())]
    #[diagnostic(code(mcdpr::track::entry), help("`mcdpr track` lists them"))]
    NoEntry {
        /// The history.
        path: PathBuf,
        /// Which was asked for.
        number: usize,
        /// How many there are.
        count: usize,
    },
}

/// The state in use.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct InUse {
    schema: String,
    /// When it was kept, UTC.
    pub(crate) date: String,
    /// The same, s since 1970.
    pub(crate) unix_s: u64,
    /// Tensions then, N.
    pub(crate) tensions_n: Vec<f64>,
    /// The state.
    pub(crate) state: Kept,
    /// Friction of each cable's winch relative to the robot file; none in files of before it was tracked.
    #[serde(default)]
    pub(crate) frictions: Vec<Option<Friction>>,
}

/// One session in the history.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct Entry {
    schema: String,
    /// From 1.
    pub(crate) number: usize,
    /// When it ended, UTC.
    pub(crate) date: String,
    /// The task, or what was done.
    pub(crate) cause: String,
    /// Rests that were taken note of, and how many of them fitted.
    pub(crate) rests: [usize; 2],
    /// Sum of the steps of the planned tool, mm.
    pub(crate) step_mm: f64,
    /// What moved, in words.
    pub(crate) named: Vec<String>,
    crc32: u32,
    /// An [`InUse`], as text.
    text: String,
}

/// The files of one robot.
#[derive(Debug, Clone)]
pub(crate) struct Store {
    file: PathBuf,
}

impl Store {
    /// Those beside a robot file, or in this folder for a built-in robot.
    pub(crate) fn beside(robot: &str) -> Self {
        let calibration = path_for(robot);
        let name = calibration.file_name().unwrap_or_default();
        let name = name.to_string_lossy();
        let stem = name.strip_suffix(".calibration.json").unwrap_or(&name);
        Self {
            file: calibration.with_file_name(format!("{stem}.tracked.json")),
        }
    }

    /// The file with the state in use.
    pub(crate) fn file(&self) -> &Path {
        &self.file
    }

    /// The history.
    pub(crate) fn history_file(&self) -> PathBuf {
        self.file.with_extension("history.jsonl")
    }

    /// The state in use, if there is one.
    ///
    /// # Errors
    /// [`TrackedError`] if the file is none.
    pub(crate) fn in_use(&self) -> Result<Option<InUse>, TrackedError> {
        let text = text_of(&self.file, crate::files::MOST_TEXT_BYTES)?;
        text.map(|text| self.read(&text)).transpose()
    }

    fn read(&self, text: &str) -> Result<InUse, TrackedError> {
        let not_one = |what: String| TrackedError::NotOne {
            path: self.file.clone(),
            what,
        };
        let read: InUse = serde_json::from_str(text).map_err(|error| not_one(error.to_string()))?;
        if read.schema != FILE {
            return Err(not_one(format!("its format is {:?}", read.schema)));
        }
        Ok(read)
    }

    /// Goes on from the state in use, with the time since it was kept; a new one if there is none, or if it is
    /// relative to another description of this robot, which is said.
    ///
    /// # Errors
    /// [`TrackedError`]: another robot's state, or a damaged one.
    pub(crate) fn resume(
        &self,
        model: &Model,
        prior: &Prior,
    ) -> Result<(Tracking, Option<u64>), TrackedError> {
        let Some(kept) = self.in_use()? else {
            return Ok((Tracking::new(model, prior), None));
        };
        let seconds = unix_s().saturating_sub(kept.unix_s).min(LONGEST_S);
        match Tracking::resume(model, prior, &kept.state, seconds as f64, &kept.tensions_n) {
            Ok(tracking) => {
                let tracking = tracking.with_frictions(&kept.frictions, seconds as f64);
                Ok((tracking, Some(kept.unix_s)))
            }
            Err(KeptError::Description) => {
                eprintln!(
                    "{}: {}; tracking begins anew",
                    self.file.display(),
                    KeptError::Description
                );
                Ok((Tracking::new(model, prior), None))
            }
            Err(source) => Err(TrackedError::State {
                path: self.file.clone(),
                source,
            }),
        }
    }

    /// Keeps the state completely, in place of the one before.
    ///
    /// # Errors
    /// The disk's.
    pub(crate) fn keep(&self, tracking: &Tracking) -> Result<(), TrackedError> {
        let kept = InUse {
            schema: FILE.to_owned(),
            date: utc_stamp(),
            unix_s: unix_s(),
            tensions_n: tracking.last_n().to_vec(),
            state: tracking.kept(),
            frictions: tracking.frictions(),
        };
        let text = serde_json::to_string(&kept).map_err(|error| TrackedError::NotOne {
            path: self.file.clone(),
            what: error.to_string(),
        })?;
        Ok(write_whole(&self.file, &text)?)
    }

    /// Adds the state in use to the history.
    ///
    /// # Errors
    /// The disk's; a history that is not one.
    pub(crate) fn remember(&self, cause: &str, lessons: &[Lesson]) -> Result<(), TrackedError> {
        let Some(text) = text_of(&self.file, crate::files::MOST_TEXT_BYTES)? else {
            return Ok(());
        };
        let number = self.history()?.0.last().map_or(0, |last| last.number) + 1;
        let fit = lessons.iter().filter(|lesson| lesson.fits).count();
        let entry = Entry {
            schema: LINE.to_owned(),
            number,
            date: utc_stamp(),
            cause: cause.to_owned(),
            rests: [lessons.len(), fit],
            step_mm: lessons.iter().map(|lesson| lesson.step_mm).sum(),
            named: lessons.iter().filter_map(|l| l.named.clone()).collect(),
            crc32: crc32(text.as_bytes()),
            text,
        };
        Ok(append(&self.history_file(), &entry)?)
    }

    /// All entries, and the numbers of lines that are torn.
    ///
    /// # Errors
    /// The disk's.
    pub(crate) fn history(&self) -> Result<(Vec<Entry>, Vec<usize>), TrackedError> {
        let (mut entries, mut torn) = (Vec::new(), Vec::new());
        let text = text_of(&self.history_file(), MOST_BYTES)?.unwrap_or_default();
        for (number, line) in (1..).zip(text.lines()) {
            let entry: Option<Entry> = serde_json::from_str(line).ok();
            match entry.filter(|e| e.schema == LINE && e.crc32 == crc32(e.text.as_bytes())) {
                Some(entry) => entries.push(entry),
                None => torn.push(number),
            }
        }
        Ok((entries, torn))
    }

    /// Uses the state of an earlier session again. The one in use is added to the history first.
    ///
    /// # Errors
    /// [`TrackedError`]; the state in use is as it was.
    pub(crate) fn back_to(
        &self,
        model: &Model,
        prior: &Prior,
        number: usize,
    ) -> Result<(), TrackedError> {
        let (entries, _) = self.history()?;
        let Some(entry) = entries.iter().find(|entry| entry.number == number) else {
            return Err(TrackedError::NoEntry {
                path: self.history_file(),
                number,
                count: entries.len(),
            });
        };
        let kept = self.read(&entry.text)?;
        Tracker::resume(model, prior, &kept.state).map_err(|source| TrackedError::State {
            path: self.history_file(),
            source,
        })?;
        self.save_unless_last(&entries)?;
        write_whole(&self.file, &entry.text)?;
        self.remember(&format!("went back to {number}"), &[])
    }

    /// Moves the state in use away, into the history: tracking then begins anew.
    ///
    /// # Errors
    /// The disk's.
    pub(crate) fn forget(&self) -> Result<(), TrackedError> {
        let (entries, _) = self.history()?;
        self.save_unless_last(&entries)?;
        match std::fs::remove_file(&self.file) {
            Err(source) if source.kind() != std::io::ErrorKind::NotFound => Err(FileError::Io {
                path: self.file.clone(),
                source,
            }
            .into()),
            _ => Ok(()),
        }
    }

    fn save_unless_last(&self, entries: &[Entry]) -> Result<(), TrackedError> {
        let now = text_of(&self.file, crate::files::MOST_TEXT_BYTES)?;
        match (now, entries.last()) {
            (Some(now), Some(last)) if last.text == now => Ok(()),
            (Some(_), _) => self.remember("found in use", &[]),
            (None, _) => Ok(()),
        }
    }
}
