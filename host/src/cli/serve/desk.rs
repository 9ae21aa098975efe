//! Orders of the page that need more than the robot's handle: tasks, plans, jogs.

use super::history::History;
use super::library::Library;
use super::planning::{Chosen, Planning};
use super::robot_file::RobotFile;
use super::steps::Steps;
use crate::control::{Handle, Order};
use crate::motion::Model;
use crate::serve::{Desk, Feed};
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Time that an order may take before the page gets the answer "in progress": a stop that follows
/// on the same connection waits no longer.
const ANSWER: Duration = Duration::from_millis(50);
/// How long a jog order is valid without a new one, s.
const JOG_VALID_S: f64 = 0.2;
/// Most points of a path that the page makes.
const MOST_POINTS: usize = 500;

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

/// Three finite numbers of an order.
fn three(message: &Value, key: &str) -> Option<[f64; 3]> {
    let axes = message[key].as_array().into_iter().flatten();
    let axes: Vec<_> = axes.filter_map(Value::as_f64).collect();
    let found: Option<[f64; 3]> = axes.try_into().ok();
    found.filter(|axes| axes.iter().all(|value| value.is_finite()))
}

fn text<'a>(message: &'a Value, key: &str) -> Result<&'a str, String> {
    let text = message[key].as_str();
    text.ok_or_else(|| format!("this order needs {key}, a text"))
}

impl PageDesk {
    /// The page does not wait for a jog either: it is repeated as long as its button is held.
    fn jog(&self, message: &Value) -> Result<(), String> {
        if self.work.is_none() {
            return Err("a task is under way: stop it first".to_owned());
        }
        let velocity_mps = three(message, "velocity_mps")
            .ok_or_else(|| "a jog needs velocity_mps, three numbers in m/s".to_owned())?;
        let speed = velocity_mps.iter().map(|v| v * v).sum::<f64>().sqrt();
        if speed > self.most_mps {
            let most = self.most_mps * 1e3;
            return Err(format!(
                "a jog of {:.0} mm/s is asked for, the robot's limit is {most:.0} mm/s",
                speed * 1e3
            ));
        }
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
        let (task, source) = if let Some(name) = message["task"].as_str() {
            match message["text"].as_str() {
                Some(text) => self.library.of_text(name, text.to_owned())?,
                None => self.library.find(&self.model, name)?,
            }
        } else if message["home"] == json!(true) {
            let home_m = self.model.robot().tool.home_in_world_m;
            let text = path_text("home", &[(home_m * 1e3).into()], None);
            self.library.of_text("home.toml", text)?
        } else if !message["to_mm"].is_null() {
            let to_mm = three(message, "to_mm").ok_or("a place is three numbers in mm")?;
            // From where the tool is, so that the speed holds for the whole way.
            let pose = self.feed.now().0.pose;
            let from_mm = pose.map(|pose| pose.tool_m.map(|v| (v * 1e6).round() * 1e-3));
            let points: Vec<_> = from_mm.into_iter().chain([to_mm]).collect();
            let text = path_text("go to", &points, speed_mm_s(message)?);
            self.library.of_text("go-to.toml", text)?
        } else {
            let points = message["points_mm"].as_array();
            let points = points.ok_or("a plan needs task, home, to_mm or points_mm")?;
            if points.is_empty() || points.len() > MOST_POINTS {
                return Err(format!("a path has 1 to {MOST_POINTS} points"));
            }
            let points = points.iter().map(|point| {
                let point = json!({ "point": point });
                three(&point, "point").ok_or("a point is three numbers in mm")
            });
            let points = points.collect::<Result<Vec<_>, _>>()?;
            let text = path_text("taught points", &points, speed_mm_s(message)?);
            self.library.of_text("points.toml", text)?
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
                    "{} saved; it is used from the next start on",
                    saved["file"]
                ));
                Ok(saved)
            }
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

/// The speed of an order, mm/s; `None`: as fast as the robot file allows.
fn speed_mm_s(message: &Value) -> Result<Option<f64>, String> {
    match &message["speed_mm_s"] {
        Value::Null => Ok(None),
        value => match value.as_f64() {
            Some(speed) if speed.is_finite() && speed > 0.0 => Ok(Some(speed)),
            _ => Err("a speed is a number over 0, in mm/s".to_owned()),
        },
    }
}

/// A task file through points (mm): the first is its start.
fn path_text(name: &str, points_mm: &[[f64; 3]], speed_mm_s: Option<f64>) -> String {
    let mut text = format!("name = \"{name}\"\n");
    let [first, rest @ ..] = points_mm else {
        return text;
    };
    let list = |[x, y, z]: [f64; 3]| format!("[{x:?}, {y:?}, {z:?}]");
    if let Some(speed) = speed_mm_s {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "speed_mm_s = {speed:?}");
    }
    let _ = writeln!(text, "start_mm = {}", list(*first));
    for point in rest {
        let _ = writeln!(text, "\n[[leg]]\nto_mm = {}", list(*point));
    }
    if rest.is_empty() {
        text.push_str("\n[[leg]]\ndwell_s = 0.0\n");
    }
    text
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
            ]);
        }
        orders
    }

    fn document(&self, path: &str) -> Option<Result<(&'static str, String), String>> {
        self.work.as_ref()?.history.document(path)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::Task;

    #[test]
    fn a_path_of_points_is_a_task_file() {
        let points = [
            [0.0, 0.0, -200.0],
            [50.5, -1e-3, -200.0],
            [0.0, 10.0, -150.0],
        ];
        let text = path_text("points", &points, Some(20.0));
        let task = Task::parse(&text, "points.toml".into()).unwrap();
        assert_eq!((task.steps.len(), task.name.as_str()), (2, "points"));
        let start_m = task.start_m().unwrap();
        assert!((start_m.z + 0.2).abs() < 1e-12, "{start_m}");
        let one = path_text("home", &points[..1], None);
        let task = Task::parse(&one, "home.toml".into()).unwrap();
        assert_eq!(task.steps.len(), 1);
    }

    #[test]
    fn numbers_that_are_none_are_refused() {
        let message = json!({ "to_mm": [1, 2], "speed_mm_s": -1 });
        assert_eq!(three(&message, "to_mm"), None);
        assert!(speed_mm_s(&message).is_err());
        assert_eq!(
            three(&json!({ "to_mm": [1, 2, 3.5] }), "to_mm"),
            Some([1.0, 2.0, 3.5])
        );
        assert_eq!(speed_mm_s(&json!({})), Ok(None));
    }
}
