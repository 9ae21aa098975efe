//! A simulated robot, and the page's orders to it.

mod desk;
mod paced;
mod records;

use crate::{Host, Settings};
use mcdpr_core::control::Handle;
use mcdpr_core::motion::{FITTING, Model, PAPER_HEIGHT_M, Task};
use mcdpr_core::robot::BUILT_IN;
use mcdpr_core::run::{Homing, NoStore, Recorder, RunError, Session};
use mcdpr_protocol::SessionId;
use mcdpr_simulator::LinkOptions;
use mcdpr_twin::attend::{Attendant, Wanted};
use mcdpr_twin::faults::FaultyLink;
use mcdpr_twin::feed::describe;
use mcdpr_twin::line::{SimulatedLink, in_process};
use mcdpr_twin::plans::Plans;
use mcdpr_twin::viewer::{Message, Viewer};
use mcdpr_twin::{Feed, FeedWatcher, RunEvent, Sink, TruthTap, Watched, Watcher as _};
use paced::{Pace, Paced};
use serde_json::{Value, json};
use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};

/// Time between two states of the robot for the page, ms: 60 a second.
const FRAME_MS: f64 = 16.0;

/// What stays when another robot comes.
#[derive(Debug, Default)]
pub struct Kept {
    /// Texts of tasks by their names.
    pub(crate) tasks: RefCell<BTreeMap<String, String>>,
    pub(crate) records: RefCell<Vec<records::Opened>>,
}

/// A robot on its stage, until another takes its place.
pub struct Stage<'a> {
    pub(crate) host: &'a dyn Host,
    pub(crate) settings: Settings,
    pub(crate) model: Model,
    pub(crate) feed: Feed,
    pub(crate) handle: Handle,
    pub(crate) start: AtomicBool,
    pub(crate) link: FaultyLink,
    pub(crate) plant: SimulatedLink,
    pub(crate) pace: Pace,
    pub(crate) plans: RefCell<Plans<Task>>,
    /// The task that is repeated as long as no plan is started.
    own: Task,
    pub(crate) kept: &'a Kept,
    /// The next robot's settings, as soon as this one is to go.
    pub(crate) next: RefCell<Option<Settings>>,
    viewer: RefCell<Viewer>,
    due_ms: Cell<f64>,
}

/// Passes what happens on the line to the page's data at once.
struct Watching(RefCell<FeedWatcher>);

impl Sink for Watching {
    fn publish(&self, event: RunEvent) {
        self.0.borrow_mut().see(&event);
    }

    fn is_empty(&self) -> bool {
        false
    }
}

/// Simulates one robot after another for the page, for ever.
pub fn run(host: &dyn Host, clock_s: fn() -> f64) {
    let kept = Kept::default();
    let mut settings = Settings::default();
    // The page's first message says which robot a link asks for.
    let first = wait_for_message(host);
    let mut refused = settings.changed(&first).map(|asked| settings = asked).err();
    loop {
        match Stage::new(host, settings.clone(), clock_s, &kept) {
            Ok(stage) => {
                if let Some(reason) = refused.take() {
                    stage.feed.set_trouble(&reason);
                    // A start would remove the reason.
                    stage.start.store(false, Ordering::SeqCst);
                }
                stage.play();
                if let Some(next) = stage.next.take() {
                    settings = next;
                }
            }
            Err(reason) => {
                refused = Some(reason);
                settings = Settings::default();
            }
        }
    }
}

/// A built-in task.
///
/// # Errors
/// That there is none of this name, or that none fits.
pub(crate) fn named(model: &Model, name: &str) -> Result<Task, String> {
    if name == FITTING {
        return Task::fitting(model).map_err(|error| error.to_string());
    }
    let height_m = PAPER_HEIGHT_M + model.robot().tool.tcp_in_platform_m.z;
    Task::built_in(name, height_m).map_err(|error| error.to_string())
}

/// The next message that the page sends.
fn wait_for_message(host: &dyn Host) -> Value {
    loop {
        if let Some(text) = host.take() {
            return serde_json::from_str(&text).unwrap_or_default();
        }
        host.pause(5.0);
    }
}

impl<'a> Stage<'a> {
    /// The robot of these settings, at rest.
    ///
    /// # Errors
    /// Why there is no such robot, in words.
    pub fn new(
        host: &'a dyn Host,
        settings: Settings,
        clock_s: fn() -> f64,
        kept: &'a Kept,
    ) -> Result<Self, String> {
        let model = settings.model()?;
        let words = |error: RunError| error.to_string();
        let (mismatch, seed) = (settings.mismatch(), settings.seed);
        let place_m = settings.place_m();
        let plant = mcdpr_twin::plant::at_rest(&model, model.robot(), &mismatch, seed, place_m)
            .map_err(words)?;
        let line = LinkOptions::default();
        let plant = SimulatedLink::of(model.robot(), plant, &line, seed, &in_process)
            .map_err(|error| error.to_string())?;
        let own = named(&model, Task::fitting_name(&model))?;
        let stage = Self {
            host,
            feed: Feed::new(clock_s),
            handle: Handle::new(),
            start: AtomicBool::new(place_m.is_none()),
            link: FaultyLink::new(plant.clone(), &[]),
            plant,
            pace: Pace::default(),
            plans: RefCell::default(),
            own,
            kept,
            next: RefCell::default(),
            viewer: RefCell::default(),
            due_ms: Cell::new(0.0),
            settings,
            model,
        };
        let mut hello = Viewer::hello(&describe(stage.model.robot()), &desk::ORDERS);
        hello["playground"] = stage.settings.message();
        hello["robots"] = json!(BUILT_IN.iter().map(|(name, _)| name).collect::<Vec<_>>());
        stage.deliver(&hello);
        Ok(stage)
    }

    fn deliver(&self, message: &Value) {
        self.host.deliver(&message.to_string());
    }

    /// Whether another robot takes this one's place.
    pub(crate) fn is_over(&self) -> bool {
        self.next.borrow().is_some()
    }

    /// Executes the page's orders, and sends it what is new.
    pub(crate) fn attend(&self) {
        while let Some(text) = self.host.take() {
            let message: Value = serde_json::from_str(&text).unwrap_or_default();
            let outcome = match message["order"].as_str() {
                None => Err("this is not an order".to_owned()),
                Some(name) => self.obey(name, &message),
            };
            self.deliver(&json!({
                "type": "answer",
                "id": message["id"],
                "order": message["order"],
                "ok": outcome.is_ok(),
                "may_stop": true,
                "data": outcome.as_ref().ok(),
                "reason": outcome.as_ref().err(),
            }));
        }
        let now_ms = self.host.now_ms();
        if now_ms < self.due_ms.get() {
            return;
        }
        self.due_ms.set(now_ms + FRAME_MS);
        let mut viewer = self.viewer.borrow_mut();
        for message in viewer.news(&self.feed) {
            // A playground has no camera.
            if let Message::Text(text) = message {
                self.deliver(&text);
            }
        }
        if let Some(live) = viewer.live(&self.feed, false) {
            self.deliver(&live);
        }
    }

    /// Does what the page asks of the robot, until another robot takes its place.
    pub fn play(&self) {
        let tap = TruthTap::forgetful(self.plant.clone(), self.model.robot().cables.len());
        let watcher = FeedWatcher::new(self.feed.clone(), self.model.clone());
        let watching = Watching(RefCell::new(watcher));
        while !self.is_over() {
            let paced = Paced {
                inner: self.link.clone(),
                stage: self,
            };
            let line = Watched::new(paced, &watching).with_truth(tap.clone());
            if let Err(error) = self.round(line) {
                if self.is_over() {
                    return;
                }
                self.feed.set_trouble(&error.to_string());
                self.handle.close(&error.to_string());
                self.start.store(false, Ordering::SeqCst);
                self.host.pause(200.0);
                self.attend();
            }
        }
    }

    /// Waits for a request and executes it once.
    fn round(&self, mut line: impl mcdpr_core::link::Link) -> Result<(), RunError> {
        let attendant = Attendant {
            model: &self.model,
            feed: &self.feed,
            handle: &self.handle,
            start: &self.start,
            hands_over: &|| false,
        };
        let wanted = attendant.wait(&mut line, self.session(), |_| Ok(()))?;
        self.feed.clear_trouble();
        let homing = |referenced: bool| {
            if referenced {
                Homing::Known
            } else {
                let home_m = self.model.robot().tool.home_in_world_m;
                Homing::Place(self.settings.place_m().unwrap_or(home_m))
            }
        };
        let outcome = match wanted {
            Wanted::Nothing | Wanted::Line => return Ok(()),
            Wanted::Jogs { referenced } => {
                self.feed.set_task("jogging");
                let homing = homing(referenced);
                let done = attendant.jog(&mut line, self.session(), homing, &NoStore);
                done.map(|()| "jogging is over: brakes closed")
            }
            Wanted::Task { referenced } => {
                let planned = self.plans.borrow().begun();
                let repeats = planned.is_none();
                let task = planned.unwrap_or_else(|| self.own.clone());
                self.feed.set_task(&task.name);
                let done = self.task(&mut line, task, homing(referenced));
                if done.is_ok() && repeats && self.handle.stop_ordered().is_none() {
                    self.start.store(true, Ordering::SeqCst);
                }
                done.map(|()| "the task is done")
            }
        };
        self.feed.set_task("");
        match outcome {
            Ok(words) => self.feed.say(words),
            Err(RunError::Interrupted) => self.feed.say("stopped; Start goes on"),
            Err(error) if self.is_over() => return Err(error),
            Err(error) => self.feed.set_trouble(&error.to_string()),
        }
        Ok(())
    }

    fn task(
        &self,
        line: impl mcdpr_core::link::Link,
        task: Task,
        homing: Homing<'_>,
    ) -> Result<(), RunError> {
        let number = self.session();
        let mut session = Session::open(&self.model, line, number, &self.handle, homing, &NoStore)?;
        let plan = session.plan(task, None)?;
        session.arm()?;
        session.follow(&plan, &mut Recorder::default(), |_| {})?;
        session.disarm()
    }

    /// A number for a session: different ones within a second.
    fn session(&self) -> SessionId {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "the low bits count"
        )]
        let number = (self.host.now_ms() * 1e3) as u64 as u32;
        SessionId(number.max(1))
    }
}
