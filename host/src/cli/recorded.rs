//! The record that goes with every command that moves a robot.

use super::{Common, Failed};
use crate::control::Handle;
use crate::link::{Link, Paced, SimulatedLink};
use crate::machine::Mismatch;
use crate::motion::Model;
use crate::record::events::{Patience, TruthTap};
use crate::record::{
    Doing, EventBus, FILE_NAME, Machine, Recording, RobotText, Summary, TaskSource, Watched,
    starting_now,
};
use crate::report::RunFolder;
use crate::robot::Robot;
use crate::run::{RunError, interrupted, new_session};
use crate::serve::Feed;
use mcdpr_protocol::SessionId;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

/// A greater record is not read again at the end of its run: that would take seconds, and gigabytes.
const MOST_COUNTED_BYTES: u64 = 200 << 20;

/// Content of a record.
pub(crate) struct About<'a> {
    /// Name of the folder.
    pub(crate) name: &'a str,
    /// The task.
    pub(crate) task: TaskSource,
    /// Number of the session on the wire.
    pub(crate) session: SessionId,
    /// Mismatch of the simulated machine.
    pub(crate) mismatch: &'a Mismatch,
    /// Action of the host.
    pub(crate) doing: Doing,
    /// Whether the host assumes that the robot hangs at home.
    pub(crate) at_home: bool,
    /// Takes orders from a live page; without it, a page can only stop the command.
    pub(crate) orders: Option<&'a Handle>,
}

/// A run's folder, and the watchers of the run.
pub(crate) struct Recorded {
    /// Where the run's files go.
    pub(crate) folder: RunFolder,
    /// The watchers.
    pub(crate) events: EventBus,
    feed: Option<Feed>,
    summary: Option<Arc<Mutex<Summary>>>,
    lost: Option<Arc<AtomicU64>>,
    /// The robot whose cables the run wears: a real one.
    worn: Option<Robot>,
}

impl Recorded {
    /// The data for viewers, if there is a live page (`--serve`).
    pub(crate) const fn feed(&self) -> Option<&Feed> {
        self.feed.as_ref()
    }

    /// Makes the folder and starts the record. If a record cannot be started there is a warning,
    /// and the run continues without: only a folder that the user asked for is required. Without a
    /// model (a winch that holds no robot yet) no poses are recorded.
    ///
    /// # Errors
    /// If a folder cannot be made.
    pub(crate) fn start(
        common: &Common,
        model: Option<&Model>,
        about: About<'_>,
    ) -> Result<Self, Failed> {
        let About {
            name,
            task,
            session,
            mismatch,
            doing,
            at_home,
            orders,
        } = about;
        let asked = common.record.as_deref();
        let wanted = asked.map_or("runs".into(), std::path::Path::to_string_lossy);
        let what = format!("making the run's folder {wanted}");
        let failed = || Failed::from_error(&what);
        let folder = RunFolder::create(common.record.as_deref(), name).map_err(failed())?;
        let simulated = common.on == "sim";
        let machine = if let Some(wires) = common.controller.wires() {
            Machine::InTheLoop {
                mismatch: *mismatch,
                seed: common.seed,
                wires: wires.to_string(),
            }
        } else if simulated {
            Machine::Simulated {
                mismatch: *mismatch,
                seed: common.seed,
                firmware: common.controller.firmware_crc(),
            }
        } else {
            Machine::Port {
                name: common.on.clone(),
            }
        };
        let mut scenario = starting_now(&common.robot, task, session.0, machine);
        scenario.options = model.map_or_else(Default::default, Model::options);
        scenario.doing = doing;
        scenario.at_home = at_home;
        if model.is_some_and(|model| model.robot().calibrated.is_some()) {
            scenario.calibration = common.calibration_file().and_then(|path| {
                let text = crate::files::read_text(&path).ok()?;
                let name = path.file_name()?.to_string_lossy().into_owned();
                Some(RobotText { name, text })
            });
        }
        let mut recorded = Self {
            folder,
            events: EventBus::default(),
            feed: None,
            summary: None,
            lost: None,
            worn: model
                .filter(|_| !simulated)
                .map(|model| model.robot().clone()),
        };
        // A moving robot must not wait for a disk; virtual time may.
        let in_virtual_time = simulated && common.time_scale.is_none();
        let patience = if in_virtual_time {
            Patience::Wait
        } else {
            Patience::Drop
        };
        let path = recorded.folder.path().join(FILE_NAME);
        match Recording::create(&path, &scenario, model.cloned()) {
            Ok(recording) => {
                recorded.summary = Some(recording.summary());
                match recorded.events.add(recording, patience) {
                    Ok(lost) => recorded.lost = Some(lost),
                    Err(error) => warn(&error.to_string()),
                }
            }
            Err(error) => warn(&format!("{}: {error}", path.display())),
        }
        // Only a real robot outlasts the program, and needs a journal.
        if let Some(model) = model.filter(|_| !simulated) {
            let task = &scenario.task;
            let about = crate::recovery::About {
                session: session.0,
                robot: model.robot().name.clone(),
                scale: crate::run::saved::scale_of(model.robot()),
                task: task.name.clone(),
                task_hash: crate::recovery::task_hash(task),
            };
            let open = crate::recovery::FileDisk::of_board;
            let writer = crate::recovery::JournalWriter::new(about, open);
            if let Err(error) = recorded.events.add(writer, Patience::Drop) {
                eprintln!("warning: no journal is kept, after a loss of power home again: {error}");
            }
        }
        recorded.feed = common.show_live(model, doing, orders, &mut recorded.events)?;
        Ok(recorded)
    }

    /// The event bus by itself, for more watchers; [`RecordEnd::finish`] after it has finished.
    pub(crate) fn split(self) -> (EventBus, RecordEnd) {
        let rest = RecordEnd {
            folder: self.folder,
            summary: self.summary,
            lost: self.lost,
            worn: self.worn,
        };
        (self.events, rest)
    }

    /// Ends the record and reports its gaps.
    pub(crate) fn finish(self) -> RunFolder {
        let (events, rest) = self.split();
        events.finish();
        rest.finish()
    }
}

/// The rest of a record after its event bus has finished.
pub(crate) struct RecordEnd {
    folder: RunFolder,
    summary: Option<Arc<Mutex<Summary>>>,
    lost: Option<Arc<AtomicU64>>,
    worn: Option<Robot>,
}

impl RecordEnd {
    /// Reports the record's gaps.
    pub(crate) fn finish(self) -> RunFolder {
        let summary = self
            .summary
            .as_ref()
            .and_then(|summary| summary.lock().ok());
        if let Some(reason) = summary.and_then(|summary| summary.stopped.clone()) {
            warn(&format!("it ends early: {reason}"));
        }
        let lost = self.lost.map_or(0, |lost| lost.load(Ordering::Relaxed));
        if lost > 0 {
            warn(&format!(
                "the disk was too slow, {lost} entries are missing"
            ));
        }
        if let Some(robot) = &self.worn {
            wear(robot, &self.folder.path().join(FILE_NAME));
        }
        self.folder
    }
}

/// Counts what a run did to cables, drums and brakes.
fn wear(robot: &Robot, record: &Path) {
    let large = std::fs::metadata(record).is_ok_and(|file| file.len() > MOST_COUNTED_BYTES);
    let failed = if large {
        "it is large".to_owned()
    } else {
        match crate::care::count(robot, record) {
            Ok(_) => return,
            Err(error) => error.to_string(),
        }
    };
    eprintln!(
        "the wear of this run is not counted yet ({failed}): mcdpr care --add {}",
        record.display()
    );
}

/// The record of work that opens its own line to the robot: experiments, rigging, service.
pub(crate) struct OnRecord<'a> {
    events: &'a EventBus,
    cables: usize,
    /// Simulated seconds per second for viewers.
    pace: Option<f64>,
    /// Number of the session to open.
    pub(crate) session: SessionId,
}

impl OnRecord<'_> {
    /// A line, recorded.
    pub(crate) const fn watched<L: Link>(&self, link: L) -> Watched<'_, L, EventBus> {
        Watched::new(link, self.events)
    }

    /// A line to a simulated robot, recorded with its true states.
    pub(crate) fn watched_simulated(
        &self,
        link: SimulatedLink,
    ) -> Watched<'_, SimulatedLink, EventBus> {
        let tap = TruthTap::forgetful(link.clone(), self.cables);
        self.watched(link).with_truth(tap)
    }

    /// A line to a board, recorded.
    pub(crate) fn line<'l>(&'l self, link: impl Link + 'l) -> Box<dyn Link + 'l> {
        Box::new(self.watched(link))
    }

    /// A line to a simulated robot, recorded with its true states.
    pub(crate) fn simulated(&self, link: SimulatedLink) -> Box<dyn Link + '_> {
        let line = self.watched_simulated(link);
        match self.pace {
            Some(scale) => Box::new(Paced::new(line, scale)),
            None => Box::new(line),
        }
    }

    /// The same, for a caller that also reads the truth from this tap.
    pub(crate) fn tapped(&self, link: SimulatedLink, tap: TruthTap) -> Box<dyn Link + '_> {
        Box::new(self.watched(link).with_truth(tap))
    }
}

/// The same work without a record.
pub(crate) fn off_record<T>(
    common: &Common,
    cables: usize,
    work: impl FnOnce(&OnRecord<'_>) -> miette::Result<T>,
) -> miette::Result<T> {
    work(&OnRecord {
        events: &EventBus::default(),
        cables,
        pace: None,
        session: session(common),
    })
}

/// A session's number: in virtual time there is no other program on the line.
fn session(common: &Common) -> SessionId {
    if common.on == "sim" && common.time_scale.is_none() {
        return SessionId(1);
    }
    new_session()
}

/// Content of such a record.
pub(crate) struct Work<'a> {
    /// Name of the folder.
    pub(crate) name: &'a str,
    /// The action.
    pub(crate) doing: Doing,
    /// Mismatch of the simulated machine.
    pub(crate) mismatch: Mismatch,
    /// Number of cables.
    pub(crate) cables: usize,
    /// The robot's model, if there is a robot already.
    pub(crate) model: Option<&'a Model>,
    /// Takes orders from a live page.
    pub(crate) orders: Option<&'a Handle>,
    /// Nothing moves before the only plan is judged: a refusal leaves no folder.
    pub(crate) plans_first: bool,
}

impl<'a> Work<'a> {
    /// Work on a robot.
    pub(crate) fn new(name: &'a str, doing: Doing, mismatch: Mismatch, model: &'a Model) -> Self {
        Self {
            name,
            doing,
            mismatch,
            cables: model.robot().cables.len(),
            model: Some(model),
            orders: None,
            plans_first: false,
        }
    }

    /// Nothing moves before the only plan is judged.
    pub(crate) const fn planned_first(self) -> Self {
        Self {
            plans_first: true,
            ..self
        }
    }

    /// With orders from a live page.
    pub(crate) const fn with_orders(self, orders: &'a Handle) -> Self {
        Self {
            orders: Some(orders),
            ..self
        }
    }
}

/// Runs an action with a record, and returns its result with the folder. If it fails, the record is
/// kept.
pub(crate) fn on_record<T>(
    common: &Common,
    about: &Work<'_>,
    work: impl FnOnce(&OnRecord<'_>) -> miette::Result<T>,
) -> miette::Result<(T, RunFolder)> {
    // A command with several motions arms no more after a stop.
    if interrupted() {
        return Err(RunError::Interrupted.into());
    }
    let session = session(common);
    let task = TaskSource {
        name: about.name.to_owned(),
        text: None,
        tool_z_m: 0.0,
    };
    let start = About {
        name: about.name,
        task,
        session,
        mismatch: &about.mismatch,
        doing: about.doing,
        at_home: common.on == "sim",
        orders: about.orders,
    };
    let recorded = Recorded::start(common, about.model, start)?;
    let done = work(&OnRecord {
        events: &recorded.events,
        cables: about.cables,
        pace: recorded
            .feed
            .is_some()
            .then(|| common.pace())
            .transpose()?
            .flatten(),
        session,
    });
    let folder = recorded.finish();
    if let Err(error) = &done {
        if about.plans_first && common.record.is_none() && is_refused(error) {
            // Nothing moved: there is nothing to look at.
            let _ = std::fs::remove_dir_all(folder.path());
            return Ok((done?, folder));
        }
        eprintln!("what happened is recorded in {}", folder.path().display());
    }
    Ok((done?, folder))
}

/// Whether a plan was refused.
fn is_refused(error: &miette::Report) -> bool {
    matches!(error.downcast_ref(), Some(RunError::Plan(_)))
}

/// The record is incomplete; the run is not affected.
fn warn(reason: &str) {
    eprintln!("warning: the record of this run is incomplete: {reason}");
}
