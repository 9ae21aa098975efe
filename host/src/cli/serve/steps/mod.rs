//! Steps of set-up and picking from the page: each is a command of this program, in a process of its own.
//!
//! | module | what it is for |
//! |---|---|
//! | `catalogue` | the steps, with the words of their commands |
//! | `command` | the command line of a step |
//! | `child` | a command that runs: its output, its questions, its end |
//! | `output` | lines, questions, result and reason of a failure |
//! | `relay` | what the command's live page shows goes to this page, orders go back |
//! | `stopping` | a command that does not stop is interrupted |
//! | `kept` | a calibration is used once it is accepted; the one before is kept |
//!
//! A port admits one program. The thread that has the line to the robot releases it, carries the step out, and
//! opens the line again.

mod catalogue;
mod child;
mod command;
mod kept;
mod output;
mod relay;
mod stopping;

use crate::cli::Common;
use crate::serve::Feed;
use child::Child;
use command::{Base, Command, command};
use kept::Kept;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The steps of a server. Clones share them.
#[derive(Clone)]
pub(crate) struct Steps {
    feed: Feed,
    base: Base,
    kept: Kept,
    data: PathBuf,
    inner: Arc<Mutex<Inner>>,
}

#[derive(Default)]
struct Inner {
    /// A step that waits for the robot's line.
    due: Option<Due>,
    /// The step that runs, and its process once it was started.
    running: Option<&'static str>,
    child: Option<Arc<Child>>,
    states: BTreeMap<&'static str, Value>,
    /// Number of the last run.
    runs: u64,
}

#[derive(Clone)]
struct Due {
    id: &'static str,
    run: u64,
    command: Command,
}

impl Steps {
    pub(crate) fn new(common: &Common, feed: Feed) -> Self {
        let steps = Self {
            feed,
            base: Base::of(common),
            kept: Kept::of(common),
            data: crate::cli::calibrate::collect::data_path(&common.robot),
            inner: Arc::default(),
        };
        steps.publish(&steps.lock());
        steps
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        // A viewer that panicked must not make a stop impossible.
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Tells viewers the state of all steps.
    fn publish(&self, inner: &Inner) {
        let asks = inner.child.as_ref().and_then(|child| child.question());
        let waits = inner.due.as_ref().map(|due| due.id);
        self.feed.notices().post(json!({
            "type": "steps",
            "steps": catalogue::listed(),
            "states": inner.states,
            "running": inner.running.or(waits),
            "waits": waits.is_some(),
            "asks": asks,
            "calibration": self.kept.status(),
        }));
    }

    /// The step that has the robot, or waits for it.
    pub(crate) fn busy(&self) -> Option<&'static str> {
        let inner = self.lock();
        inner.running.or(inner.due.as_ref().map(|due| due.id))
    }

    /// Whether a step waits for the robot's line.
    pub(crate) fn is_due(&self) -> bool {
        self.lock().due.is_some()
    }

    /// Carries out the step that waits, if one does, until its command has ended. The line to the robot must be
    /// closed.
    pub(crate) fn carry_out(&self) {
        let mut inner = self.lock();
        let Some(due) = inner.due.take() else { return };
        inner.running = Some(due.id);
        inner
            .states
            .insert(due.id, due.state("running", &json!({})));
        self.publish(&inner);
        drop(inner);
        let ended = self.run(&due);
        let mut inner = self.lock();
        inner.running = None;
        inner.child = None;
        let state = match ended {
            Ok(more) => due.state("done", &more),
            Err(more) => {
                let reason = more["reason"].as_str().unwrap_or_default();
                self.feed.say(&format!("{}: {reason}", due.id));
                due.state("failed", &more)
            }
        };
        inner.states.insert(due.id, state);
        self.feed.notices().set_live(None);
        // The plan of the command is over; this program's own comes with its next motion.
        self.feed
            .notices()
            .post(json!({ "type": "plan", "duration_s": 0.0, "tool_m": [] }));
        self.publish(&inner);
    }

    fn run(&self, due: &Due) -> Result<Value, Value> {
        let failed = |reason: String| {
            let next = "read the reason, remove the cause, and run it again";
            json!({ "reason": reason, "next": next })
        };
        for line in kept::keep(&due.command.replaces).map_err(failed)? {
            self.feed.notices().line(due.run, "note", &line);
        }
        let step = catalogue::find(due.id).map_err(failed)?;
        let child = Child::start(due.id, &due.command, step.live, due.run, self.feed.clone());
        let child = Arc::new(
            child.map_err(|error| failed(format!("the program cannot be started: {error}")))?,
        );
        self.lock().child = Some(Arc::clone(&child));
        child.until_it_ends(|| self.publish(&self.lock()))
    }

    /// Stops the step that runs, and cancels one that waits; returns whether one runs.
    pub(crate) fn stop(&self) -> bool {
        let mut inner = self.lock();
        if let Some(due) = inner.due.take() {
            let more = json!({ "reason": "stopped before it began", "next": "run it again" });
            inner.states.insert(due.id, due.state("failed", &more));
            self.publish(&inner);
        }
        if let Some(child) = &inner.child {
            child.stop();
        }
        inner.running.is_some()
    }

    /// Passes an order to the command that runs.
    pub(crate) fn pass(&self, order: &Value) -> Result<(), String> {
        let child = self.lock().child.clone();
        let child = child.ok_or_else(|| "the command has not begun yet".to_owned())?;
        child.pass(order)
    }

    /// An order of the page; `busy` says what else the robot does.
    pub(crate) fn order(
        &self,
        name: &str,
        message: &Value,
        busy: Option<&str>,
    ) -> Result<Value, String> {
        let judged = || {
            let step = catalogue::find(message["step"].as_str().unwrap_or_default())?;
            let given = &message["options"];
            let command = command(step, given, &self.base, &self.kept.proposal(), &self.data)?;
            Ok::<_, String>((step, command))
        };
        match name {
            "step_line" => {
                let (_, command) = judged()?;
                Ok(json!({ "line": command.line(), "moves": command.moves }))
            }
            "step_run" => {
                let (step, command) = judged()?;
                if let Some(busy) = busy {
                    return Err(format!("{busy} is under way: stop it first"));
                }
                // What was confirmed is what is started, word by word.
                if !command.moves.is_empty() && message["confirmed"] != command.line() {
                    return Err(format!("confirm it first: {}", command.moves));
                }
                let mut inner = self.lock();
                if let Some(running) = inner.running.or(inner.due.as_ref().map(|due| due.id)) {
                    return Err(format!("{running} is under way: stop it first"));
                }
                inner.runs += 1;
                let run = inner.runs;
                if step.id == "pick" {
                    self.feed.notices().post(json!({ "type": "pick" }));
                }
                self.feed.notices().line(run, "note", &command.line());
                let due = Due {
                    id: step.id,
                    run,
                    command,
                };
                inner
                    .states
                    .insert(due.id, due.state("running", &json!({})));
                inner.due = Some(due);
                self.publish(&inner);
                Ok(json!({ "run": run }))
            }
            "step_answer" => {
                let text = message["text"].as_str().ok_or("an answer needs text")?;
                let child = self.lock().child.clone();
                let child = child.ok_or("no step asks anything")?;
                child.answer(text)?;
                self.publish(&self.lock());
                Ok(Value::Null)
            }
            "calibration_accept" => self.changed(busy, Kept::accept),
            "calibration_discard" => self.changed(busy, Kept::discard),
            "calibration_back" => self.changed(busy, Kept::back),
            other => Err(format!("there is no order {other}")),
        }
    }

    /// Changes which calibration is used.
    fn changed(
        &self,
        busy: Option<&str>,
        change: impl FnOnce(&Kept) -> Result<Value, String>,
    ) -> Result<Value, String> {
        let inner = self.lock();
        if let Some(busy) = inner.running.or(busy) {
            return Err(format!(
                "{busy} is under way: it uses the calibration; stop it first"
            ));
        }
        let status = change(&self.kept)?;
        self.publish(&inner);
        Ok(status)
    }
}

impl Due {
    /// Its state for viewers.
    fn state(&self, state: &str, more: &Value) -> Value {
        json!({
            "state": state,
            "run": self.run,
            "line": self.command.line(),
            "reason": more["reason"],
            "next": more["next"],
            "result": more["result"],
            "seconds": more["seconds"],
        })
    }
}
