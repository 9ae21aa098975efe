//! Measured cost of keeping a journal: bytes and processor time of its thread.

use super::disk::{Disk, FileDisk};
use super::writer::{About, JournalWriter};
use crate::experiment::{Experiment, SimulatedRobot};
use crate::link::{Paced, SimulatedLink};
use crate::machine::Mismatch;
use crate::motion::{Model, Task};
use crate::record::EventBus;
use crate::record::events::{Patience, RunEvent, Watched, Watcher};
use crate::run::RunError;
use crate::sight::SightError;
use mcdpr_core::recovery::journal::Mark;
use mcdpr_protocol::SessionId;
use serde::Serialize;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// Cost of a journal, measured while a simulated robot moved in real time.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Cost {
    /// Time from the first to the last frame while it was kept, s.
    pub duration_s: f64,
    /// Bytes written to its files, 10^6 a minute.
    pub mb_per_min: f64,
    /// Processor time of its thread over that time; absent where the system does not say.
    pub core_share: Option<f64>,
}

/// Counts the bytes that reach a disk.
struct Counted {
    disk: FileDisk,
    bytes: Arc<AtomicU64>,
}

impl Counted {
    fn add(&self, bytes: &[u8]) {
        self.bytes.fetch_add(bytes.len() as u64, Ordering::Relaxed);
    }
}

impl Disk for Counted {
    fn begin(&mut self, bytes: &[u8]) -> std::io::Result<()> {
        self.add(bytes);
        self.disk.begin(bytes)
    }

    fn append(&mut self, bytes: &[u8]) -> std::io::Result<()> {
        self.add(bytes);
        self.disk.append(bytes)
    }

    fn sync(&mut self, mark: Mark) -> std::io::Result<()> {
        self.add(&mark.to_bytes());
        self.disk.sync(mark)
    }
}

/// Processor time of the calling thread, s, by the system's scheduler (Linux only).
fn thread_s() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    let nanoseconds: f64 = text.split_whitespace().next()?.parse().ok()?;
    Some(nanoseconds * 1e-9)
}

/// A watcher with the processor time of its thread.
struct Timed<W> {
    inner: W,
    bytes: Arc<AtomicU64>,
    /// Time of the first and of the last frame while the journal was kept, µs.
    frames_us: Option<[u64; 2]>,
    cost: Arc<Mutex<Cost>>,
}

impl<W: Watcher> Watcher for Timed<W> {
    fn see(&mut self, event: &RunEvent) {
        self.inner.see(event);
        if let RunEvent::Wire { frame, .. } = event
            && self.bytes.load(Ordering::Relaxed) > 0
        {
            let first_us = self.frames_us.map_or(frame.time_us, |[first, _]| first);
            self.frames_us = Some([first_us, frame.time_us]);
        }
    }

    fn idle(&mut self) {
        self.inner.idle();
    }

    fn end(&mut self) {
        self.inner.end();
        let Some([first_us, last_us]) = self.frames_us.filter(|[first, last]| last > first) else {
            return;
        };
        let duration_s = (last_us - first_us) as f64 * 1e-6;
        let bytes = self.bytes.load(Ordering::Relaxed) as f64;
        *self.cost.lock().unwrap_or_else(PoisonError::into_inner) = Cost {
            duration_s,
            mb_per_min: bytes * 60.0 / duration_s * 1e-6,
            core_share: thread_s().map(|used_s| used_s / duration_s),
        };
    }
}

/// Measures the cost of the journal of a simulated robot that does a task in real time, in a folder of
/// the system's temporary files.
///
/// # Errors
/// Those of the run, and of the folder.
pub fn cost(model: &Model, task: &Task) -> Result<Cost, RunError> {
    let failed = |error: std::io::Error| {
        let what = error.to_string();
        RunError::Sight(SightError::Simulation { what })
    };
    let robot = SimulatedRobot::new(Mismatch::realistic(), 1).at_home(model)?;
    let folder = temporary_folder();
    let about = About {
        session: 1,
        robot: model.robot().name.clone(),
        scale: crate::run::saved::scale_of(model.robot()),
        task: task.name.clone(),
        task_hash: 0,
    };
    let bytes = Arc::new(AtomicU64::new(0));
    let (counted, place) = (Arc::clone(&bytes), folder.clone());
    let open = move |_: &str| {
        Ok(Counted {
            disk: FileDisk::in_folder(&place)?,
            bytes: Arc::clone(&counted),
        })
    };
    let cost = Arc::new(Mutex::new(Cost::default()));
    let timed = Timed {
        inner: JournalWriter::new(about, open),
        bytes,
        frames_us: None,
        cost: Arc::clone(&cost),
    };
    let mut events = EventBus::default();
    events.add(timed, Patience::Drop).map_err(failed)?;
    let line: Paced<SimulatedLink> = Paced::new(robot, 1.0);
    let outcome = Experiment::new(model, task.clone())
        .session(SessionId(1))
        .at_home()
        .run_on(Watched::new(line, &events));
    events.finish();
    // A folder that remains is one of temporary files.
    let _ = std::fs::remove_dir_all(&folder);
    outcome?;
    let cost = *cost.lock().unwrap_or_else(PoisonError::into_inner);
    Ok(cost)
}

fn temporary_folder() -> PathBuf {
    std::env::temp_dir().join(format!("mcdpr-journal-cost-{}", std::process::id()))
}
