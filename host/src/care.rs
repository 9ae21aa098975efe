//! The wear of a robot in a file of the user: `$XDG_STATE_HOME/mcdpr/care-ROBOT.json`.

use crate::robot::Robot;
use crate::run::{Measured, state_folder};
use mcdpr_core::care::{Rope, Wear};
use miette::Diagnostic;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Why the wear of a robot cannot be read or kept.
#[derive(Debug, Error, Diagnostic)]
pub(crate) enum CareError {
    /// The file system failed.
    #[error("{}: {source}", path.display())]
    #[diagnostic(
        code(mcdpr::care::file),
        help("check the folder's permissions and the room on the disk; the file is as it was")
    )]
    Io {
        /// Which file.
        path: PathBuf,
        /// The system's message.
        source: std::io::Error,
    },
    /// The content is another robot's, or is none.
    #[error("{}: {what}", path.display())]
    #[diagnostic(
        code(mcdpr::care::other),
        help(
            "nothing was counted; name the robot with --robot, or move a file of wear away to begin anew"
        )
    )]
    Other {
        /// Which file.
        path: PathBuf,
        /// What is wrong.
        what: String,
    },
}

/// Where the wear of a robot is kept.
///
/// # Errors
/// Where the user has no folder for state.
pub(crate) fn path_of(robot: &Robot) -> Result<PathBuf, CareError> {
    let folder = state_folder().ok_or_else(|| CareError::Io {
        path: PathBuf::from("~/.local/state/mcdpr"),
        source: std::io::ErrorKind::NotFound.into(),
    })?;
    let name: String = robot
        .name
        .chars()
        .map(|c| {
            if c.is_alphanumeric() || c == '-' {
                c
            } else {
                '_'
            }
        })
        .collect();
    Ok(folder.join(format!("care-{name}.json")))
}

/// The wear of a robot so far; of new cables if none is kept.
///
/// # Errors
/// [`CareError`]; a file of another robot is refused.
pub(crate) fn load(robot: &Robot) -> Result<Wear, CareError> {
    let path = path_of(robot)?;
    let text = match crate::files::read_text(&path) {
        Ok(text) => text,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Wear::of(robot)),
        Err(source) => return Err(CareError::Io { path, source }),
    };
    let wear: Wear = serde_json::from_str(&text).map_err(|error| CareError::Other {
        path: path.clone(),
        what: format!("not a file of wear: {error}"),
    })?;
    if wear.robot != robot.name || wear.cables.len() != robot.cables.len() {
        let what = format!(
            "it is of robot {} with {} cables, this is {} with {}",
            wear.robot,
            wear.cables.len(),
            robot.name,
            robot.cables.len()
        );
        return Err(CareError::Other { path, what });
    }
    Ok(wear)
}

/// Keeps the wear of a robot: completely, or as it was.
///
/// # Errors
/// [`CareError::Io`].
pub(crate) fn keep(robot: &Robot, wear: &Wear) -> Result<(), CareError> {
    let path = path_of(robot)?;
    let failed = |source| CareError::Io {
        path: path.clone(),
        source,
    };
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(failed)?;
    }
    let text = serde_json::to_vec(wear).map_err(|error| failed(error.into()))?;
    crate::files::write_atomically(&path, text).map_err(failed)
}

/// Adds a recorded run to the wear of a robot; `false` if it was counted before.
///
/// # Errors
/// [`CareError`]: an unreadable record, or one of another robot. Nothing was counted.
pub(crate) fn add(robot: &Robot, wear: &mut Wear, path: &Path) -> Result<bool, CareError> {
    let refused = |what: String| CareError::Other {
        path: path.to_owned(),
        what,
    };
    let run = crate::record::load(path).map_err(|error| refused(error.to_string()))?;
    let designed = run.designed_robot();
    let name = designed.map_err(|error| refused(error.to_string()))?.name;
    if name != robot.name {
        let what = format!("it is a run of robot {name}, this is {}", robot.name);
        return Err(refused(what));
    }
    let samples: Vec<Measured> = run.ticks().into_iter().map(measured).collect();
    wear.take(robot, &named(&samples), &samples)
        .map_err(refused)
}

/// The same for a run that has just ended, in the robot's file.
///
/// # Errors
/// As [`add`]; where the file cannot be written.
pub(crate) fn count(robot: &Robot, path: &Path) -> Result<bool, CareError> {
    let mut wear = load(robot)?;
    let new = add(robot, &mut wear, path)?;
    if new {
        keep(robot, &wear)?;
    }
    Ok(new)
}

/// A run by what it measured: the same wherever its record lies.
fn named(samples: &[Measured]) -> String {
    let some = samples.iter().step_by(100);
    let values = some.flat_map(|sample| sample.lengths_m.iter().chain(&sample.tensions_n));
    let bytes: Vec<u8> = values.flat_map(|value| value.to_le_bytes()).collect();
    let hash = mcdpr_protocol::frame::crc32(&bytes);
    format!("{hash:08x}-{}", samples.len())
}

fn measured(tick: crate::record::decode::Tick) -> Measured {
    Measured {
        tick: tick.tick,
        path_s: tick.path_s,
        lengths_m: tick.lengths_m,
        tensions_n: tick.tensions_n,
        currents_a: tick.currents_a,
    }
}

/// The wear in one sentence; `None` before the first run.
#[must_use]
pub(crate) fn sentence(wear: &Wear) -> Option<String> {
    if wear.runs.is_empty() {
        return None;
    }
    let worst = (1..).zip(&wear.cables).max_by(|a, b| {
        let of = |cable: &mcdpr_core::care::CableWear| (cable.used().unwrap_or(0.0), cable.worst());
        let (a, b) = (of(a.1), of(b.1));
        a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1))
    });
    let (number, cable) = worst?;
    let life = match (cable.used(), cable.rope) {
        (Some(used), _) => format!("about {:.1} % of its life", used * 100.0),
        (None, Rope::Polymer { .. }) => {
            "its life is not known: tell `mcdpr care` what its maker tested".to_owned()
        }
        (None, Rope::Steel) => "its life is not known".to_owned(),
    };
    Some(format!(
        "{} runs; cable {number} was bent {:.0} times at its worst place, {life}; brakes closed {} times",
        wear.runs.len(),
        cable.worst(),
        wear.brake_closings
    ))
}
