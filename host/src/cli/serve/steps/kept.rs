//! The calibration that a step has made: it is used only once somebody accepts it, and the one before is kept.

use crate::cli::Common;
use crate::files::{read_text, write_atomically};
use serde_json::{Value, json};
use std::io;
use std::path::{Path, PathBuf};

/// The files of a robot's calibration.
#[derive(Debug, Clone)]
pub(super) struct Kept {
    /// The calibration in use.
    used: PathBuf,
    /// Commands apply it.
    applied: bool,
    /// The robot, by name or file.
    robot: String,
}

impl Kept {
    pub(super) fn of(common: &Common) -> Self {
        let beside = crate::calibration::result::path_for(&common.robot);
        let (used, applied) = match common.calibration.as_deref() {
            Some("none") => (beside, false),
            Some(file) => (PathBuf::from(file), true),
            None => (beside, true),
        };
        Self {
            used,
            applied,
            robot: common.robot.clone(),
        }
    }

    /// Where a step puts its result.
    pub(super) fn proposal(&self) -> PathBuf {
        self.used.with_extension("new.json")
    }

    fn before(&self) -> PathBuf {
        with_ending(&self.used, "before")
    }

    /// Which files there are.
    pub(super) fn status(&self) -> Value {
        let there = |path: &Path| path.is_file().then(|| path.display().to_string());
        json!({
            "used": there(&self.used),
            "proposal": there(&self.proposal()),
            "before": there(&self.before()),
            "applied": self.applied,
            "made": made(&self.used),
        })
    }

    /// Uses the proposal from now on; the calibration of before is kept.
    pub(super) fn accept(&self) -> Result<Value, String> {
        if !self.applied {
            let reason =
                "this server was started with --calibration none: its steps use no calibration";
            return Err(reason.to_owned());
        }
        let proposal = self.proposal();
        let text = read(&proposal)?;
        match read_text(&self.used) {
            Ok(old) => write(&self.before(), &old)?,
            // Nothing was calibrated before: to go back is to be without.
            Err(error) if error.kind() == io::ErrorKind::NotFound => write(&self.before(), "")?,
            Err(error) => return Err(failed(&self.used, &error)),
        }
        let before = self.remember("found in use");
        write(&self.used, &text)?;
        remove(&proposal)?;
        Ok(self.remembered(before, "accepted on the page"))
    }

    /// Takes the calibration in use into its history.
    fn remember(&self, cause: &str) -> Result<(), String> {
        let robot = crate::robot::find(&self.robot).map_err(|error| error.to_string())?;
        let done = crate::calibration::history::remember(&robot, &self.used, cause);
        done.map(|_| ()).map_err(|error| error.to_string())
    }

    /// The state after a change. What is used counts, also where its history cannot be written: that is said.
    fn remembered(&self, before: Result<(), String>, cause: &str) -> Value {
        let mut status = self.status();
        if let Err(reason) = before.and_then(|()| self.remember(cause)) {
            status["history_failed"] = json!(reason);
        }
        status
    }

    /// Does not use the proposal. It stays as a file.
    pub(super) fn discard(&self) -> Result<Value, String> {
        let (from, to) = (self.proposal(), with_ending(&self.proposal(), "discarded"));
        std::fs::rename(&from, &to).map_err(|error| failed(&from, &error))?;
        Ok(self.status())
    }

    /// Uses the calibration of before again, or none if there was none. The present one is kept.
    pub(super) fn back(&self) -> Result<Value, String> {
        let old = read(&self.before())?;
        let now = read(&self.used)?;
        write(&with_ending(&self.used, "undone"), &now)?;
        if old.is_empty() {
            remove(&self.used)?;
        } else {
            write(&self.used, &old)?;
        }
        remove(&self.before())?;
        Ok(self.remembered(Ok(()), "went back on the page"))
    }
}

/// Copies the text of files that a command will replace, with `.before` at the end; says which.
pub(super) fn keep(files: &[PathBuf]) -> Result<Vec<String>, String> {
    let mut said = Vec::new();
    for file in files.iter().filter(|file| file.is_file()) {
        let kept = with_ending(file, "before");
        std::fs::copy(file, &kept).map_err(|error| failed(file, &error))?;
        said.push(format!("{} is kept as {}", file.display(), kept.display()));
    }
    Ok(said)
}

/// When a calibration was made.
fn made(path: &Path) -> Option<String> {
    let value: Value = serde_json::from_str(&read_text(path).ok()?).ok()?;
    value["date"].as_str().map(str::to_owned)
}

fn with_ending(path: &Path, ending: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(format!(".{ending}"));
    PathBuf::from(name)
}

fn failed(path: &Path, error: &io::Error) -> String {
    format!("{}: {error}", path.display())
}

fn read(path: &Path) -> Result<String, String> {
    read_text(path).map_err(|error| failed(path, &error))
}

fn write(path: &Path, text: &str) -> Result<(), String> {
    write_atomically(path, text).map_err(|error| failed(path, &error))
}

fn remove(path: &Path) -> Result<(), String> {
    std::fs::remove_file(path).map_err(|error| failed(path, &error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_proposal_is_accepted_and_taken_back_and_no_text_is_lost() {
        let folder = std::env::temp_dir().join(format!("mcdpr-kept-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let used = folder.join("own.calibration.json");
        let kept = Kept {
            used: used.clone(),
            applied: true,
            robot: "lab-fast".to_owned(),
        };
        let read = |path: &Path| std::fs::read_to_string(path).ok();
        assert!(kept.accept().is_err() && kept.back().is_err() && kept.discard().is_err());
        // The first calibration: to go back is to be without.
        std::fs::write(kept.proposal(), "one").unwrap();
        assert_eq!(kept.proposal(), folder.join("own.calibration.new.json"));
        assert!(kept.status()["used"].is_null() && !kept.status()["proposal"].is_null());
        kept.accept().unwrap();
        assert_eq!(read(&used).as_deref(), Some("one"));
        let status = kept.back().unwrap();
        assert!(status["used"].is_null() && status["before"].is_null());
        assert_eq!(read(&with_ending(&used, "undone")).as_deref(), Some("one"));
        // The second replaces the first, which is kept.
        for text in ["one", "two"] {
            std::fs::write(kept.proposal(), text).unwrap();
            kept.accept().unwrap();
        }
        assert_eq!(read(&used).as_deref(), Some("two"));
        kept.back().unwrap();
        assert_eq!(read(&used).as_deref(), Some("one"));
        std::fs::write(kept.proposal(), "three").unwrap();
        kept.discard().unwrap();
        assert_eq!(read(&used).as_deref(), Some("one"));
        let said = keep(&[used.clone(), folder.join("none")]).unwrap();
        assert!(said.len() == 1 && read(&with_ending(&used, "before")).as_deref() == Some("one"));
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
