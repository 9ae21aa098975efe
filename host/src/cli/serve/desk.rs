//! Orders of the page that need more than the robot's handle: tasks, plans, jogs.

use super::history::History;
use super::library::Library;
use super::planning::{Chosen, Planning};
use super::reload::Reload;
use super::robot_file::RobotFile;
use super::steps::Steps;
use crate::control::{Handle, Order};
use crate::motion::Model;
use crate::serve::{Desk, Feed};
use mcdpr_twin::asked::{Asked, asked, jog_mps, text};
use serde_json::{Value, json};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Time that an order may take before the page gets the answer "in progress": a stop that follows
/// on the same connection waits no longer.
const ANSWER: Duration = Duration::from_millis(50);
/// How long a jog order is valid without a new one, s.
const JOG_VALID_S: f64 = 0.2;

/// Passes the page's orders to the thread that moves the robot.
pub(crate) struct PageDesk {
    pub(crate) handle: Handle,
    /// What the page can start; `None` beside a program that does one thing.
    pub(crate) work: Option<Work>,
    /// Greatest speed of a jog, m/s.
    pub(crate) most_mps: f64,
}

/// What the page can start.
pub(crate) struct Work {
    pub(crate) model: Model,
    pub(crate) feed: Feed,
    /// Whether Start was pressed.
    pub(crate) start: Arc<AtomicBool>,
    pub(crate) library: Library,
    pub(crate) planning: Planning,
    pub(crate) history: History,
    pub(crate) robot_file: RobotFile,
    pub(crate) steps: Steps,
    pub(crate) reload: Reload,
}

/// Orders that are possible while a step has the robot: they move nothing.
const BESIDE_A_STEP: &[&str] = &[
    "tasks",
    "task_read",
    "task_save",
    "forget",
    "robot_read",
    "robot_check",
    "step_line",
    "step_answer",
];

impl PageDesk {
    /// The page does not wait for a jog either: it is repeated as long as its button is held.
    fn jog(&self, message: &Value) -> Result<(), String> {
        if self.work.is_none() {
            return Err("a task is under way: stop it first".to_owned());
        }
        let velocity_mps = jog_mps(message, self.most_mps)?;
        self.handle.order(Order::Jog {
            velocity_mps,
            valid_s: JOG_VALID_S,
        });
        Ok(())
    }

    fn work(&self) -> Result<&Work, String> {
        let work = self.work.as_ref();
        work.ok_or_else(|| "this page cannot start a task".to_owned())
    }
}

impl Work {
    /// What the robot does, if something other than a step is in progress or about to begin.
    fn in_progress(&self) -> Option<String> {
        let live = self.feed.now().0;
        let about = self.start.load(Ordering::SeqCst);
        if live.is_busy() {
            return Some(live.task);
        }
        about.then(|| "a task".to_owned())
    }

    /// An order while a step has the robot; `None`: as without a step.
    fn beside_a_step(&self, name: &str, message: &Value) -> Option<Result<Value, String>> {
        let step = self.steps.busy()?;
        match name {
            "hold" | "resume" | "clear" | "gripper" => {
                let mut order = json!({ "order": name });
                order["closed"] = message["closed"].clone();
                Some(self.steps.pass(&order).map(|()| Value::Null))
            }
            // A step that only waits for the robot is cancelled, and the robot stopped.
            "stop" => self.steps.stop().then_some(Ok(Value::Null)),
            name if BESIDE_A_STEP.contains(&name) => None,
            _ => Some(Err(format!("{step} is under way: stop it first"))),
        }
    }

    fn start(&self, message: &Value) -> Result<(), String> {
        let live = self.feed.now().0;
        if live.is_busy() {
            return Err(format!("{} is under way: stop it first", live.task));
        }
        self.planning.begin(message["plan"].as_u64())?;
        self.start.store(true, Ordering::SeqCst);
        Ok(())
    }

    /// The task of a plan order: a named one, a text, a position, points, or home.
    fn wanted(&self, message: &Value) -> Result<Chosen, String> {
        let pose = self.feed.now().0.pose;
        let home_m = self.model.robot().tool.home_in_world_m;
        let asked = asked(message, home_m.into(), pose.map(|pose| pose.tool_m))?;
        let (task, source) = match asked {
            Asked::Named(name) => self.library.find(&self.model, &name)?,
            Asked::Text { name, text } => self.library.of_text(&name, text)?,
        };
        Ok(Chosen { task, source })
    }

    fn order(&self, name: &str, message: &Value) -> Result<Value, String> {
        match name {
            "start" => self.start(message).map(|()| Value::Null),
            "tasks" => Ok(self.library.list()),
            "task_read" => {
                let text = self.library.read(text(message, "task")?)?;
                Ok(json!({ "text": text }))
            }
            "task_save" => {
                let replace = message["replace"] == json!(true);
                let (task, body) = (text(message, "task")?, text(message, "text")?);
                self.library.save(task, body, replace)?;
                Ok(self.library.list())
            }
            "plan" => {
                let number = self.planning.ask(self.wanted(message)?);
                Ok(json!({ "plan": number }))
            }
            "step_line"
            | "step_run"
            | "step_answer"
            | "calibration_accept"
            | "calibration_discard"
            | "calibration_back" => self
                .steps
                .order(name, message, self.in_progress().as_deref()),
            "robot_read" => self.robot_file.read(),
            "robot_check" => self.robot_file.check(text(message, "text")?),
            "robot_save" => {
                let (new, before) = (text(message, "text")?, text(message, "before")?);
                let saved = self.robot_file.save(new, before)?;
                self.feed.say(&format!(
                    "{} saved; it is used once it is read again",
                    saved["file"]
                ));
                Ok(saved)
            }
            "reload" => match self.in_progress() {
                Some(task) => Err(format!("{task} is under way: stop it first")),
                None => self.reload.ask().map(|()| Value::Null),
            },
            "forget" => {
                self.planning.forget();
                self.feed
                    .set_preview(json!({ "type": "preview", "id": null }));
                Ok(Value::Null)
            }
            other => Err(format!("there is no order {other}")),
        }
    }
}

impl Desk for PageDesk {
    fn order(&self, name: &str, message: &Value) -> Result<Value, String> {
        if let Some(work) = &self.work
            && let Some(outcome) = work.beside_a_step(name, message)
        {
            return outcome;
        }
        let ticket = match name {
            "stop" => {
                if let Some(work) = &self.work {
                    work.start.store(false, Ordering::SeqCst);
                }
                // The page does not wait for a stop: it is in progress.
                self.handle.stop();
                return Ok(Value::Null);
            }
            "hold" => self.handle.pause(),
            "resume" => self.handle.resume(),
            "clear" => self.handle.clear(),
            "gripper" => {
                let closed = message["closed"].as_bool();
                let closed = closed.ok_or("a gripper order needs closed, true or false")?;
                self.handle.order(Order::Gripper { closed })
            }
            "jog" => return self.jog(message).map(|()| Value::Null),
            other => return self.work()?.order(other, message),
        };
        let outcome = self.handle.wait(ticket, ANSWER).unwrap_or(Ok(()));
        outcome.map(|()| Value::Null)
    }

    fn orders(&self) -> Vec<&'static str> {
        let mut orders = vec!["stop", "hold", "resume", "clear", "gripper"];
        if self.work.is_some() {
            orders.extend([
                "start",
                "jog",
                "tasks",
                "task_read",
                "task_save",
                "plan",
                "forget",
                "robot_read",
                "robot_check",
                "robot_save",
                "step_line",
                "step_run",
                "step_answer",
                "calibration_accept",
                "calibration_discard",
                "calibration_back",
                "reload",
            ]);
        }
        orders
    }

    fn document(&self, path: &str) -> Option<Result<(&'static str, String), String>> {
        self.work.as_ref()?.history.document(path)
    }
}
