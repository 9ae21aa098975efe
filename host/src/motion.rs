//! Motion planning, with tasks from files.

pub use mcdpr_core::motion::*;

use crate::files::read_text_to;
use std::path::PathBuf;

/// Most bytes of a task file: far more than one plan's steps need.
const MOST_BYTES: u64 = 4 << 20;

/// A built-in task by name, or a task file by path. `z_m` is the height of the tool for the
/// built-in ones.
///
/// # Errors
/// [`TaskError`] with what is wrong and where.
pub(crate) fn find_task(name: &str, z_m: f64) -> Result<Task, TaskError> {
    match Task::built_in(name, z_m) {
        Err(TaskError::Unknown { .. }) => load(name),
        found => found,
    }
}

/// A built-in task by name, a task file by path, or the task that fits any robot. `z_m` is the height of
/// the tool for the paper's ones.
///
/// # Errors
/// [`TaskError`] with what is wrong and where; [`TaskError::Fitting`] where nothing fits.
pub fn find_task_for(model: &Model, name: &str, z_m: f64) -> Result<Task, TaskError> {
    if name == FITTING {
        return Task::fitting(model).map_err(|source| TaskError::Fitting {
            source: Box::new(source),
        });
    }
    find_task(name, z_m)
}

fn load(name: &str) -> Result<Task, TaskError> {
    let path = PathBuf::from(name);
    let text = match read_text_to(&path, MOST_BYTES) {
        Ok(text) => text,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            return Err(TaskError::Unknown {
                name: name.to_owned(),
            });
        }
        Err(source) => return Err(TaskError::Unreadable { path, source }),
    };
    Task::parse_file(&text, path)
}
