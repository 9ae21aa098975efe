//! Recorded runs for the page: their list, figures, motion, report and comparison.

use crate::record::{self, RecordedRun};
use crate::replay::recorded_robot;
use crate::report::{Judgement, html, judge};
use crate::robot::Robot;
use mcdpr_twin::record::past::{self, anchors_m};
use mcdpr_twin::record::traces::Traces;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError, TryLockError};
use std::time::SystemTime;

/// Most runs that are listed, the latest first.
const MOST_RUNS: usize = 200;
/// Longest name of a run's folder.
const LONGEST_NAME: usize = 100;
/// Most bytes of a record that the page opens: some five minutes at full rate.
const MOST_BYTES: u64 = 64 << 20;

/// The folder of runs.
pub(crate) struct History {
    folder: PathBuf,
    anchors_m: Vec<nalgebra::Vector3<f64>>,
    /// One record is read at a time: it takes a processor for up to a second.
    reading: Mutex<()>,
    /// The traces of the run whose charts are looked at: zooming asks for them again and again.
    traces: Mutex<Option<(Version, Arc<Traces>)>>,
}

/// A record as it was when it was read: name, bytes and time of its last change.
type Version = (String, u64, Option<SystemTime>);

/// A run that was read.
struct Opened {
    run: RecordedRun,
    robot: Robot,
    judgement: Judgement,
}

impl History {
    /// Of the runs in a folder, which need not exist yet, for the page of a robot.
    pub(crate) fn new(folder: PathBuf, robot: &Robot) -> Self {
        Self {
            folder,
            anchors_m: anchors_m(robot),
            reading: Mutex::default(),
            traces: Mutex::default(),
        }
    }

    /// What a viewer asks for below `/runs`: media type and text. `None` for another path.
    pub(super) fn document(&self, path: &str) -> Option<Result<(&'static str, String), String>> {
        let path = path.strip_prefix("/runs")?;
        let parts: Vec<_> = path.split('/').skip(1).collect();
        let found = match parts[..] {
            [] => Ok(("application/json", self.list().to_string())),
            [name] => self
                .motion(name)
                .map(|value| ("application/json", value.to_string())),
            [name, "report"] => self.open(name).map(
                |Opened {
                     run,
                     robot,
                     judgement,
                 }| {
                    (
                        "text/html",
                        html::report(
                            &run,
                            &robot,
                            &judgement,
                            crate::cli::report::tube(&run).as_deref(),
                        ),
                    )
                },
            ),
            [name, "traces", from_s, to_s, columns] => self
                .part(name, [from_s, to_s], columns)
                .map(|value| ("application/json", value.to_string())),
            [name, "compare", other] => self.compared(name, other).map(|page| ("text/html", page)),
            _ => return None,
        };
        Some(found)
    }

    /// Names of the runs, the latest first.
    fn list(&self) -> Value {
        let entries = std::fs::read_dir(&self.folder).into_iter().flatten();
        let names = entries.flatten().map(|entry| entry.file_name());
        let names = names.filter_map(|name| name.into_string().ok());
        let is_run = |name: &String| check_name(name).is_ok() && self.file(name).is_file();
        let mut names: Vec<_> = names.filter(is_run).collect();
        // A folder's name begins with its date.
        names.sort_by(|a, b| b.cmp(a));
        names.truncate(MOST_RUNS);
        json!({ "folder": self.folder.display().to_string(), "runs": names })
    }

    fn file(&self, name: &str) -> PathBuf {
        self.folder.join(name).join(record::FILE_NAME)
    }

    fn open(&self, name: &str) -> Result<Opened, String> {
        check_name(name)?;
        let _one = match self.reading.try_lock() {
            Ok(guard) => guard,
            Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner(),
            Err(TryLockError::WouldBlock) => {
                return Err("another run is being read; try again".to_owned());
            }
        };
        let file = self.file(name);
        let size = std::fs::metadata(&file)
            .map_err(|error| format!("{name}: {error}"))?
            .len();
        if size > MOST_BYTES {
            return Err(format!(
                "{name} has {} MB, the page opens {} MB at most: use mcdpr report {}",
                size >> 20,
                MOST_BYTES >> 20,
                self.folder.join(name).display()
            ));
        }
        let run = record::load(&file).map_err(|error| error.to_string())?;
        let robot = recorded_robot(&run).map_err(|error| error.to_string())?;
        let judgement = judge(&run, &robot);
        Ok(Opened {
            run,
            robot,
            judgement,
        })
    }

    /// A part of a run's traces: between two times, s, in so many columns.
    fn part(&self, name: &str, times: [&str; 2], columns: &str) -> Result<Value, String> {
        self.traces(name)?.asked(times, columns)
    }

    fn version(&self, name: &str) -> Result<Version, String> {
        check_name(name)?;
        let about = std::fs::metadata(self.file(name));
        let about = about.map_err(|error| format!("{name}: {error}"))?;
        Ok((name.to_owned(), about.len(), about.modified().ok()))
    }

    fn traces(&self, name: &str) -> Result<Arc<Traces>, String> {
        let version = self.version(name)?;
        let known = self.traces.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((read, traces)) = &*known
            && *read == version
        {
            return Ok(Arc::clone(traces));
        }
        drop(known);
        let Opened { run, robot, .. } = self.open(name)?;
        Ok(self.keep(version, Traces::of(&run, &robot)))
    }

    fn keep(&self, version: Version, traces: Traces) -> Arc<Traces> {
        let traces = Arc::new(traces);
        let mut known = self.traces.lock().unwrap_or_else(PoisonError::into_inner);
        *known = Some((version, Arc::clone(&traces)));
        traces
    }

    fn compared(&self, name: &str, other: &str) -> Result<String, String> {
        let (a, b) = (self.open(name)?, self.open(other)?);
        Ok(html::compare([
            (&a.run, &a.judgement),
            (&b.run, &b.judgement),
        ]))
    }

    /// Figures of a run, and its motion for the drawing.
    fn motion(&self, name: &str) -> Result<Value, String> {
        let version = self.version(name)?;
        let Opened {
            run,
            robot,
            judgement,
        } = self.open(name)?;
        // Its charts are asked for next: the record is read once.
        self.keep(version, Traces::of(&run, &robot));
        Ok(past::message(
            name,
            &run,
            &robot,
            &judgement,
            &self.anchors_m,
        ))
    }
}

/// The name of a folder directly below that of the runs, and of no other place.
fn check_name(name: &str) -> Result<(), String> {
    let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
    let is_one = !name.is_empty() && name.len() <= LONGEST_NAME && name.chars().all(allowed);
    if is_one && !name.starts_with('.') && Path::new(name).components().count() == 1 {
        return Ok(());
    }
    Err("a run's name has letters, digits, - and _".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_folders_of_runs_are_opened() {
        let robot = Robot::built_in("paper-optimistic").unwrap();
        let folder = std::env::temp_dir().join(format!("mcdpr-history-{}", std::process::id()));
        let history = History::new(folder, &robot);
        for path in [
            "/runs/..",
            "/runs/.x",
            "/runs/",
            "/runs/a%2Fb",
            "/runs/../report",
        ] {
            let refused = history.document(path);
            assert!(matches!(refused, Some(Err(_))), "{path}: {refused:?}");
        }
        assert!(history.document("/runs/a/b/c/d").is_none());
        for part in ["x/1/10", "0/inf/10", "0/1/-3", "0/1/10"] {
            let refused = history.document(&format!("/runs/nothing/traces/{part}"));
            assert!(matches!(refused, Some(Err(_))), "{part}: {refused:?}");
        }
        assert!(history.document("/other").is_none());
        let (kind, text) = history.document("/runs").unwrap().unwrap();
        assert_eq!(kind, "application/json");
        assert!(text.contains("\"runs\":[]"), "{text}");
        assert!(
            history
                .document("/runs/nothing")
                .unwrap()
                .unwrap_err()
                .contains("nothing")
        );
    }
}
