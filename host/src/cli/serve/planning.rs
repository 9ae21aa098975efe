//! Plans for the page: made by a thread of their own, shown to all viewers, started on request.

use crate::motion::{Model, Task};
use crate::record::TaskSource;
use crate::serve::Feed;
use mcdpr_twin::plans::Plans;
use serde_json::json;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

/// A task that was planned for the page.
#[derive(Debug, Clone)]
pub(crate) struct Chosen {
    pub(crate) task: Task,
    pub(crate) source: TaskSource,
}

#[derive(Debug, Default)]
struct Inner {
    plans: Plans<Chosen>,
    ended: bool,
}

#[derive(Debug, Default)]
struct Shared {
    inner: Mutex<Inner>,
    changed: Condvar,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Plans what the page asks for. Only the latest request counts.
#[derive(Debug, Clone)]
pub(crate) struct Planning(Arc<End>);

/// Ends the thread with the last clone.
#[derive(Debug)]
struct End(Arc<Shared>);

impl Drop for End {
    fn drop(&mut self) {
        self.0.lock().ended = true;
        self.0.changed.notify_all();
    }
}

impl Planning {
    /// Starts the thread. Plans begin where the robot hangs, or at home while that is unknown; the
    /// result goes to the viewers of `feed`.
    ///
    /// # Errors
    /// The system's, if no thread can be started.
    pub(crate) fn start(model: Model, feed: Feed) -> std::io::Result<Self> {
        let shared = Arc::<Shared>::default();
        let mine = Arc::clone(&shared);
        std::thread::Builder::new()
            .name("plans".to_owned())
            .spawn(move || work(&mine, &model, &feed))?;
        Ok(Self(Arc::new(End(shared))))
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.0.0.lock()
    }

    /// Asks for a plan; gives its number. Whatever was planned before can no longer be started.
    pub(super) fn ask(&self, wanted: Chosen) -> u64 {
        let number = self.lock().plans.ask(wanted);
        self.0.0.changed.notify_all();
        number
    }

    /// Forgets the plan.
    pub(super) fn forget(&self) {
        self.lock().plans.forget();
    }

    /// Decides what a start begins, as [`Plans::begin`].
    ///
    /// # Errors
    /// The reason, in words.
    pub(super) fn begin(&self, number: Option<u64>) -> Result<(), &'static str> {
        self.lock().plans.begin(number)
    }

    /// The task that was started last; `None`: the program's own.
    pub(crate) fn begun(&self) -> Option<Chosen> {
        self.lock().plans.begun()
    }
}

/// Makes plans until the last [`Planning`] is dropped.
fn work(shared: &Shared, model: &Model, feed: &Feed) {
    loop {
        let mut inner = shared.lock();
        let (number, wanted) = loop {
            if inner.ended {
                return;
            }
            if let Some(waiting) = inner.plans.waiting() {
                break waiting;
            }
            inner = shared
                .changed
                .wait(inner)
                .unwrap_or_else(PoisonError::into_inner);
        };
        drop(inner);
        let about = mcdpr_twin::preview::message(model, feed, &wanted.task, number);
        let mut inner = shared.lock();
        // Shown under the lock: a plan that is discarded now must not appear afterwards.
        if inner.plans.settle(number, about["ok"] == json!(true)) {
            feed.set_preview(about);
        }
        drop(inner);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Robot;
    use std::path::PathBuf;
    use std::time::{Duration, Instant};

    fn chosen(name: &str, x_mm: f64) -> Chosen {
        let text = format!("start_mm = [300, 0, -200]\n[[leg]]\nto_mm = [{x_mm:?}, 0, -200]\n");
        let mut task = Task::parse(&text, PathBuf::from("line.toml")).unwrap();
        name.clone_into(&mut task.name);
        let source = TaskSource {
            name: name.to_owned(),
            text: Some(text),
            tool_z_m: -0.2,
        };
        Chosen { task, source }
    }

    /// Waits for the plan with this number.
    fn wait(planning: &Planning, number: u64) {
        let give_up = Instant::now() + Duration::from_secs(60);
        while planning.begin(Some(number)) == Err("it is still being planned") {
            assert!(Instant::now() < give_up, "no plan was made");
            std::thread::yield_now();
        }
    }

    #[test]
    fn a_start_begins_what_is_shown_and_nothing_else() {
        let model = Model::new(&Robot::built_in("paper-optimistic").unwrap()).unwrap();
        let feed = crate::serve::feed();
        let planning = Planning::start(model, feed.clone()).unwrap();
        let begun = || planning.begun().map(|chosen| chosen.task.name);
        // Without a plan it is the program's own task, but not for a page that shows a plan.
        assert!(planning.begin(Some(1)).is_err());
        assert_eq!((planning.begin(None), begun()), (Ok(()), None));
        let first = planning.ask(chosen("first", 330.0));
        wait(&planning, first);
        assert_eq!(planning.begin(None), Ok(()));
        assert_eq!(begun().as_deref(), Some("first"));
        // A plan that is asked for afterwards changes nothing of what was started.
        let far = planning.ask(chosen("far", 3000.0));
        assert_eq!(begun().as_deref(), Some("first"));
        wait(&planning, far);
        // One that breaks a limit is not replaced by the program's own task, nor by an older plan.
        for number in [None, Some(far), Some(first)] {
            assert!(planning.begin(number).is_err(), "{number:?}");
        }
        let (_, shown) = feed.preview_after(0).unwrap();
        assert_eq!(
            (shown["id"].as_u64(), &shown["ok"]),
            (Some(far), &json!(false))
        );
        planning.forget();
        assert!(planning.begin(Some(far)).is_err());
        assert_eq!((planning.begin(None), begun()), (Ok(()), None));
    }
}
