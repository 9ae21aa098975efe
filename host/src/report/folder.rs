//! The folder that keeps a run.

use super::PathPoint;
use crate::chart::{Figure, PlotFormat};
use crate::motion::{Plan, PlanError};
use crate::run::Measured;
use crate::stamp::utc_stamp;
use serde::Serialize;
use std::fmt::Write as _;
use std::io;
use std::path::{Path, PathBuf};

/// A folder with one of these files holds results.
const RESULTS: [&str; 3] = ["run.mcap", "summary.json", "plan.json"];

/// The folder of runs in the current one.
pub(crate) const RUNS: &str = "runs";

/// A folder for one run.
#[derive(Debug, Clone)]
pub(crate) struct RunFolder {
    path: PathBuf,
}

impl RunFolder {
    /// Makes the folder: the given one, or `runs/DATE-TIME-NAME` here, with a number appended if
    /// that exists. A given folder that contains a run or a plan is not overwritten.
    ///
    /// # Errors
    /// The file system's.
    pub fn create(given: Option<&Path>, name: &str) -> io::Result<Self> {
        if let Some(path) = given {
            return Self::given(path);
        }
        let runs = PathBuf::from(RUNS);
        std::fs::create_dir_all(&runs)?;
        let name: String = name
            .chars()
            .map(|c| if c.is_ascii_alphanumeric() { c } else { '-' })
            .collect();
        let stem = format!("{}-{name}", utc_stamp());
        for number in 1.. {
            let path = runs.join(if number == 1 {
                stem.clone()
            } else {
                format!("{stem}-{number}")
            });
            match std::fs::create_dir(&path) {
                Ok(()) => return Ok(Self { path }),
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                Err(error) => return Err(error),
            }
        }
        Err(io::Error::other("no free name for a run folder"))
    }

    fn given(asked: &Path) -> io::Result<Self> {
        let mut path = asked.to_owned();
        let mut number = 1;
        while RESULTS.iter().any(|file| path.join(file).exists()) {
            number += 1;
            let mut numbered = asked.as_os_str().to_owned();
            numbered.push(format!("-{number}"));
            path = PathBuf::from(numbered);
        }
        if number > 1 {
            let (asked, path) = (asked.display(), path.display());
            eprintln!("{asked} holds a run already: this one goes into {path}");
        }
        std::fs::create_dir_all(&path)?;
        Ok(Self { path })
    }

    /// Its path.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Writes a file: first under another name, then renamed, so that no partial file stays.
    ///
    /// # Errors
    /// The file system's.
    pub fn write(&self, name: &str, contents: &str) -> io::Result<()> {
        crate::files::write_atomically(&self.path.join(name), contents)
    }

    /// Draws a plot into the folder; gives the file's name, with the ending of its kind.
    ///
    /// # Errors
    /// The file system's; a figure that cannot be drawn.
    pub(crate) fn plot(&self, stem: &str, figure: &Figure, kind: PlotFormat) -> io::Result<String> {
        let name = format!("{stem}.{}", kind.ending());
        let bytes = figure.file(kind).map_err(io::Error::other)?;
        crate::files::write_atomically(&self.path.join(&name), bytes)?;
        Ok(name)
    }

    /// Writes a value as JSON.
    ///
    /// # Errors
    /// The file system's.
    pub(crate) fn write_json(&self, name: &str, value: &impl Serialize) -> io::Result<()> {
        let text = serde_json::to_string_pretty(value)?;
        self.write(name, &format!("{text}\n"))
    }
}

/// Samples of a run as CSV, one line per tick; empty cells for missing values.
///
/// # Errors
/// [`PlanError::Path`]: never for a plan that was run.
pub(crate) fn write_samples(
    plan: &Plan,
    samples: &[Measured],
    true_path: Option<&[PathPoint]>,
) -> Result<String, PlanError> {
    let cables = samples.first().map_or(0, |sample| sample.lengths_m.len());
    let mut text = String::from("tick,path_s");
    for (what, unit) in [
        ("length", "m"),
        ("planned_length", "m"),
        ("tension", "n"),
        ("current", "a"),
    ] {
        for cable in 1..=cables {
            // Writing to a string cannot fail.
            let _ = write!(text, ",{what}_{cable}_{unit}");
        }
    }
    text.push_str(",desired_x_m,desired_y_m,desired_z_m,true_x_m,true_y_m,true_z_m\n");
    let mut truth = true_path.unwrap_or_default().iter().peekable();
    for sample in samples {
        let time_s = sample.path_s;
        let _ = write!(text, "{},{}", sample.tick, cell(time_s, 3));
        let state = time_s.and_then(|time_s| plan.state(time_s));
        for value in &sample.lengths_m {
            let _ = write!(text, ",{value:.7}");
        }
        for cable in 0..cables {
            let planned = state.as_ref().and_then(|state| state.paid_out_m.get(cable));
            let _ = write!(text, ",{}", cell(planned.copied(), 7));
        }
        for value in &sample.tensions_n {
            let _ = write!(text, ",{value:.3}");
        }
        for value in &sample.currents_a {
            let _ = write!(text, ",{value:.3}");
        }
        let desired = time_s.map(|time_s| plan.timed.tool_m(time_s)).transpose()?;
        let actual = time_s.and_then(|time_s| {
            while truth
                .next_if(|point| point.path_s < time_s - 5e-4)
                .is_some()
            {}
            truth
                .peek()
                .filter(|point| (point.path_s - time_s).abs() <= 5e-4)
        });
        for axis in 0..3 {
            let _ = write!(text, ",{}", cell(desired.map(|at| at[axis]), 6));
        }
        for axis in 0..3 {
            let _ = write!(text, ",{}", cell(actual.map(|point| point.tool_m[axis]), 6));
        }
        text.push('\n');
    }
    Ok(text)
}

fn cell(value: Option<f64>, digits: usize) -> String {
    value.map_or(String::new(), |value| format!("{value:.digits$}"))
}

#[cfg(test)]
mod tests {
    use super::RunFolder;

    #[test]
    fn a_folder_that_holds_a_run_is_left_alone() {
        let path = std::env::temp_dir().join(format!("mcdpr-runs-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        let asked = path.join("circle");
        let names: Vec<_> = (0..3)
            .map(|round| {
                let folder = RunFolder::create(Some(&asked), "any").unwrap();
                // Without results the same folder is used.
                let again = RunFolder::create(Some(&asked), "any").unwrap();
                assert_eq!(folder.path(), again.path());
                folder.write("run.mcap", &format!("{round}")).unwrap();
                folder.path().file_name().unwrap().to_owned()
            })
            .collect();
        assert_eq!(names, ["circle", "circle-2", "circle-3"]);
        let kept = std::fs::read_to_string(asked.join("run.mcap")).unwrap();
        assert_eq!(kept, "0");
        std::fs::remove_dir_all(path).unwrap();
    }
}
