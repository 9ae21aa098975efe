//! Plans for the page: made by a thread of their own, shown to all viewers, started on request.

use crate::motion::{Margin, Model, Task, Watch};
use crate::record::TaskSource;
use crate::run::preview;
use crate::serve::Feed;
use nalgebra::{Quaternion, Rotation3, UnitQuaternion, Vector3};
use serde_json::{Value, json};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

/// Points of a plan that are drawn.
const DRAWN: usize = 600;

/// A task that was planned for the page.
#[derive(Debug, Clone)]
pub(crate) struct Chosen {
    pub(crate) task: Task,
    pub(crate) source: TaskSource,
}

/// The latest plan that was asked for.
#[derive(Debug, Default)]
struct Inner {
    /// Number of the latest request.
    asked: u64,
    waiting: Option<Chosen>,
    /// The planned task and its number, if it is within every limit.
    allowed: Option<(u64, Chosen)>,
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
pub(crate) struct Planning {
    shared: Arc<Shared>,
    end: Arc<End>,
}

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
        let end = Arc::new(End(Arc::clone(&shared)));
        Ok(Self { shared, end })
    }

    /// Asks for a plan; gives its number. Whatever was planned before can no longer be started.
    pub(super) fn ask(&self, wanted: Chosen) -> u64 {
        let mut inner = self.shared.lock();
        inner.asked += 1;
        inner.waiting = Some(wanted);
        inner.allowed = None;
        self.end.0.changed.notify_all();
        inner.asked
    }

    /// Forgets the plan.
    pub(super) fn forget(&self) {
        let mut inner = self.shared.lock();
        inner.asked += 1;
        (inner.waiting, inner.allowed) = (None, None);
    }

    /// Checks that the plan with this number can be started.
    ///
    /// # Errors
    /// The reason, in words.
    pub(super) fn check(&self, number: u64) -> Result<(), String> {
        let inner = self.shared.lock();
        match &inner.allowed {
            Some((known, _)) if *known == number => Ok(()),
            _ if inner.waiting.is_some() => Err("it is still being planned".to_owned()),
            _ if number != inner.asked => {
                Err("another plan has taken its place: plan it again".to_owned())
            }
            _ => Err("this plan breaks a limit: it cannot be started".to_owned()),
        }
    }

    /// The task that Start begins, if one was planned.
    pub(crate) fn chosen(&self) -> Option<Chosen> {
        let inner = self.shared.lock();
        inner.allowed.as_ref().map(|(_, chosen)| chosen.clone())
    }
}

/// Makes plans until the last [`Planning`] is dropped.
fn work(shared: &Shared, model: &Model, feed: &Feed) {
    loop {
        let mut inner = shared.lock();
        let wanted = loop {
            if inner.ended {
                return;
            }
            if let Some(wanted) = inner.waiting.clone() {
                break wanted;
            }
            inner = shared
                .changed
                .wait(inner)
                .unwrap_or_else(PoisonError::into_inner);
        };
        let number = inner.asked;
        drop(inner);
        let result = planned(model, feed, &wanted.task);
        let mut inner = shared.lock();
        // A newer request makes this result worthless.
        if inner.asked != number {
            continue;
        }
        inner.waiting = None;
        let mut about = match result {
            Ok(about) => about,
            Err(reason) => json!({ "ok": false, "reason": reason, "tool_m": [], "margins": [] }),
        };
        about["type"] = json!("preview");
        about["id"] = json!(number);
        about["name"] = json!(wanted.task.name);
        if about["ok"] == json!(true) {
            inner.allowed = Some((number, wanted));
        }
        // Under the lock: a plan that is discarded now must not appear afterwards.
        feed.set_preview(about);
        drop(inner);
    }
}

/// The plan of a task from where the robot hangs.
fn planned(model: &Model, feed: &Feed, task: &Task) -> Result<Value, String> {
    let pose = feed.now().0.pose;
    let (start_m, attitude) = match pose {
        Some(pose) => {
            let [x, y, z, w] = pose.rotation_xyzw;
            let turn = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
            (Vector3::from(pose.tool_m), turn.to_rotation_matrix())
        }
        None => (model.robot().tool.home_in_world_m, Rotation3::identity()),
    };
    let failed = |error: &dyn std::fmt::Display| error.to_string();
    let plan = preview(model, task.clone(), &start_m, attitude).map_err(|e| failed(&e))?;
    let seen = plan.extremes(&Watch::default()).map_err(|e| failed(&e))?;
    let duration_s = seen.duration_s;
    let times = (0..=DRAWN).map(|index| duration_s * index as f64 / DRAWN as f64);
    let points = times.filter_map(|time_s| plan.timed.tool_m(time_s).ok());
    let points: Vec<[f64; 3]> = points.map(Into::into).collect();
    Ok(json!({
        "ok": seen.broken.is_none(),
        "reason": seen.broken,
        "duration_s": duration_s,
        "speed_mps": seen.speed_mps,
        "tool_m": points,
        "tightest": seen.margins.first().map(words),
        "margins": seen.margins,
    }))
}

/// A margin as one line.
fn words(margin: &Margin) -> String {
    let Margin {
        what,
        value,
        limit,
        unit,
        left_percent,
        time_s,
        ..
    } = margin;
    format!("{what}: {value:.1} of {limit:.1} {unit}, {left_percent:.0} % left, at {time_s:.1} s")
}
