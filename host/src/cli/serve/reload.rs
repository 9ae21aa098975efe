//! Reading robot file and calibration again while the page is served.

use super::Cmd;
use crate::cli::Common;
use crate::cli::line::in_words;
use crate::cli::run::tool_height_m;
use crate::experiment::Experiment;
use crate::motion::{Model, Task};
use std::sync::{Arc, Mutex, PoisonError};

/// What robot file, calibration and task are read into.
#[derive(Debug, Clone)]
pub(super) struct Prepared {
    pub(super) model: Model,
    /// Height of a built-in task, of the tool, m.
    pub(super) height_m: f64,
    /// Name and task of the Start button.
    pub(super) name: String,
    pub(super) task: Task,
}

impl Prepared {
    /// A robot or a task that would be refused is refused before anything is shown.
    pub(super) fn read(cmd: &Cmd, common: &Common) -> miette::Result<Self> {
        let robot = common.robot()?;
        let model = Model::new(&robot)?;
        let height_m = tool_height_m(&robot, cmd.z_mm);
        let name = match &cmd.task {
            Some(name) => name.clone(),
            None => Task::fitting_name(&model).to_owned(),
        };
        let task = crate::motion::find_task_for(&model, &name, height_m)?;
        Experiment::new(&model, task.clone()).plan()?;
        Ok(Self {
            model,
            height_m,
            name,
            task,
        })
    }
}

/// The request to read them again. Clones share it.
#[derive(Debug, Clone)]
pub(crate) struct Reload {
    cmd: Cmd,
    common: Common,
    next: Arc<Mutex<Option<Prepared>>>,
}

impl Reload {
    pub(super) fn new(cmd: &Cmd, common: &Common) -> Self {
        Self {
            cmd: cmd.clone(),
            common: common.clone(),
            next: Arc::default(),
        }
    }

    /// Reads them now; they are used as soon as the robot's line is free.
    ///
    /// # Errors
    /// What is wrong with them, in words. Nothing is changed then.
    pub(super) fn ask(&self) -> Result<(), String> {
        let read = Prepared::read(&self.cmd, &self.common);
        let read = read.map_err(|error| in_words(error.as_ref()))?;
        *self.next.lock().unwrap_or_else(PoisonError::into_inner) = Some(read);
        Ok(())
    }

    /// Whether something was read that is not in use yet.
    pub(super) fn is_due(&self) -> bool {
        self.next
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .is_some()
    }

    /// What was read, once.
    pub(super) fn take(&self) -> Option<Prepared> {
        self.next
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take()
    }
}
