//! The page's orders.

use super::{Stage, named};
use crate::Settings;
use mcdpr_core::control::Order;
use mcdpr_core::motion::{BUILT_IN, Task};
use mcdpr_core::robot;
use mcdpr_protocol::FaultId;
use mcdpr_twin::asked::{Asked, asked, jog_mps, text, three};
use mcdpr_twin::faults::{How, Injection, Scenario, When, how};
use mcdpr_twin::fingerprint::fingerprint;
use serde_json::{Value, json};
use std::sync::atomic::Ordering;

/// Every order, for the page.
pub(crate) const ORDERS: [&str; 24] = [
    "stop",
    "hold",
    "resume",
    "clear",
    "gripper",
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
    "sim_faults",
    "sim_inject",
    "sim_push",
    "sim_restart",
    "sim_state",
    "sim_fingerprint",
    "record_open",
    "record_robot",
    "document",
];
/// How long a jog order is valid without a new one, s.
const JOG_VALID_S: f64 = 0.2;
/// Most files that are kept, and their longest text, bytes.
const MOST_FILES: usize = 100;
const MOST_BYTES: usize = 48 << 10;
/// Greatest force of the hand on the platform, N.
const MOST_PUSH_N: f64 = 20.0;

impl Stage<'_> {
    /// Executes an order; returns its answer, or why it is refused.
    pub(crate) fn obey(&self, name: &str, message: &Value) -> Result<Value, String> {
        let done = Ok(Value::Null);
        match name {
            "may" => done,
            "stop" => {
                self.start.store(false, Ordering::SeqCst);
                self.handle.stop();
                done
            }
            "hold" => {
                self.handle.pause();
                done
            }
            "resume" => {
                self.handle.resume();
                done
            }
            "clear" => {
                self.handle.clear();
                done
            }
            "gripper" => {
                let closed = message["closed"].as_bool();
                let closed = closed.ok_or("a gripper order needs closed, true or false")?;
                self.handle.order(Order::Gripper { closed });
                done
            }
            "jog" => {
                let velocity_mps = jog_mps(message, self.model.robot().limits.speed_mps)?;
                let valid_s = JOG_VALID_S;
                self.handle.order(Order::Jog {
                    velocity_mps,
                    valid_s,
                });
                done
            }
            "start" => self.begin(message).map(|()| Value::Null),
            "tasks" => Ok(self.tasks()),
            "task_read" => {
                let name = text(message, "task")?;
                let files = self.kept.tasks.borrow();
                let found = files.get(name);
                let found = found.ok_or_else(|| format!("there is no file {name}"))?;
                Ok(json!({ "text": found }))
            }
            "task_save" => {
                let replace = message["replace"] == json!(true);
                self.save(text(message, "task")?, text(message, "text")?, replace)?;
                Ok(self.tasks())
            }
            "plan" => self.plan(message),
            "forget" => {
                self.plans.borrow_mut().forget();
                let nothing = json!({ "type": "preview", "id": null });
                self.feed.set_preview(nothing);
                done
            }
            "robot_read" => self.robot_file(),
            "robot_check" => {
                let new = text(message, "text")?;
                self.settings.changed(message)?.robot()?;
                let changes = robot::changes(&self.settings.text, new)?;
                Ok(json!({ "changes": changes }))
            }
            "robot_save" => {
                let new = Settings {
                    text: text(message, "text")?.to_owned(),
                    ..self.settings.clone()
                };
                self.replace(new)?;
                Ok(json!({ "words": "The robot begins anew with this text." }))
            }
            "record_open" => self.open_record(message),
            "record_robot" => self.take_robot(message),
            "document" => self.document(message),
            other => self.simulation(other, message),
        }
    }

    fn begin(&self, message: &Value) -> Result<(), String> {
        let live = self.feed.now().0;
        if live.is_busy() {
            return Err(format!("{} is under way: stop it first", live.task));
        }
        self.plans.borrow_mut().begin(message["plan"].as_u64())?;
        self.start.store(true, Ordering::SeqCst);
        Ok(())
    }

    fn tasks(&self) -> Value {
        let built_in = BUILT_IN
            .iter()
            .map(|(name, about)| json!({ "name": name, "built_in": true, "about": about }));
        let files = self.kept.tasks.borrow();
        let files = files
            .keys()
            .map(|name| json!({ "name": name, "built_in": false }));
        json!({ "folder": "this page", "tasks": built_in.chain(files).collect::<Vec<_>>() })
    }

    fn save(&self, name: &str, body: &str, replace: bool) -> Result<(), String> {
        parse(name, body)?;
        let mut files = self.kept.tasks.borrow_mut();
        if files.contains_key(name) && !replace {
            return Err(format!("{name} exists already: save again to replace it"));
        }
        if body.len() > MOST_BYTES || files.len() >= MOST_FILES {
            return Err(format!(
                "a page keeps at most {MOST_FILES} tasks of at most {} kB",
                MOST_BYTES >> 10
            ));
        }
        files.insert(name.to_owned(), body.to_owned());
        Ok(())
    }

    fn plan(&self, message: &Value) -> Result<Value, String> {
        let home_m = self.model.robot().tool.home_in_world_m;
        let pose = self.feed.now().0.pose;
        let task = match asked(message, home_m.into(), pose.map(|pose| pose.tool_m))? {
            Asked::Text { name, text } => parse(&name, &text)?,
            Asked::Named(name) => self.named(&name)?,
        };
        let mut plans = self.plans.borrow_mut();
        let number = plans.ask(task.clone());
        let about = mcdpr_twin::preview::message(&self.model, &self.feed, &task, number);
        plans.settle(number, about["ok"] == json!(true));
        self.feed.set_preview(about);
        Ok(json!({ "plan": number }))
    }

    fn named(&self, name: &str) -> Result<Task, String> {
        if let Some(text) = self.kept.tasks.borrow().get(name) {
            return parse(name, text);
        }
        named(&self.model, name)
    }

    fn robot_file(&self) -> Result<Value, String> {
        let text = &self.settings.text;
        Ok(json!({
            "file": "in this page",
            "name": self.settings.name,
            "settings": robot::settings(text)?,
            "mark": "",
            "text": text,
        }))
    }

    /// Puts another robot on the stage, if there is such a robot.
    pub(super) fn replace(&self, next: Settings) -> Result<(), String> {
        let model = next.model()?;
        let place_m = next.place_m();
        let rest = place_m.map_or_else(|| model.rest_at_home(), |at| model.rest(&at, None));
        rest.map_err(|error| error.to_string())?;
        *self.next.borrow_mut() = Some(next);
        Ok(())
    }

    /// Orders that only a simulated robot can execute.
    fn simulation(&self, name: &str, message: &Value) -> Result<Value, String> {
        match name {
            "sim_faults" => Ok(faults()),
            "sim_inject" => {
                let cables = self.model.robot().cables.len();
                let word = text(message, "fault")?;
                let words = [word.to_owned()];
                let scenario = Scenario::from_words(&words, cables).map_err(|e| e.to_string())?;
                let robot = self.model.robot();
                scenario.suits(robot).map_err(|e| e.to_string())?;
                let injection = scenario.injections[0];
                let at_once = matches!(injection.when, When::Motion(at_s) if at_s == 0.0);
                self.link.add(Injection {
                    when: if at_once { When::Start } else { injection.when },
                    ..injection
                });
                self.feed.say(&format!("fault injected: {word}"));
                Ok(Value::Null)
            }
            "sim_push" => {
                let force_n = three(message, "force_n").ok_or("a push is three numbers in N")?;
                let size_n = force_n.iter().map(|f| f * f).sum::<f64>().sqrt();
                if size_n > MOST_PUSH_N {
                    return Err(format!("a hand pushes with at most {MOST_PUSH_N:.0} N"));
                }
                let tcp_m = self.model.robot().tool.tcp_in_platform_m.into();
                let pushed = self
                    .plant
                    .with(|simulation| simulation.plant_mut().set_load(force_n, tcp_m, [0.0; 3]));
                pushed.map(|()| Value::Null).map_err(|e| e.to_string())
            }
            "sim_restart" => {
                self.replace(self.settings.changed(message)?)?;
                Ok(Value::Null)
            }
            "sim_state" => {
                let pose = self.feed.now().0.pose;
                let mut state = self.settings.clone();
                state.tool_m = pose.map(|pose| pose.tool_m);
                Ok(state.message())
            }
            "sim_fingerprint" => {
                let name = message["task"].as_str();
                let name = name.unwrap_or_else(|| Task::fitting_name(&self.model));
                let (task, seed) = (self.named(name)?, self.settings.seed);
                let began_ms = self.host.now_ms();
                let found = fingerprint(&self.model, task, &self.settings.mismatch(), seed)
                    .map_err(|error| error.to_string())?;
                let took_s = (self.host.now_ms() - began_ms) * 1e-3;
                Ok(json!({
                    "sha256": found.sha256,
                    "simulated_s": found.simulated_s,
                    "took_s": took_s,
                    "task": name,
                }))
            }
            other => Err(format!("there is no order {other}")),
        }
    }
}

/// Faults that can be injected, with what each does.
fn faults() -> Value {
    let rows = FaultId::ALL.iter().filter_map(|fault| match how(*fault) {
        How::Plant(words) | How::Line(words) => {
            Some(json!({ "fault": format!("{fault:?}"), "words": words }))
        }
        // There is no program of the host that could crash, but this page.
        How::Host(_) | How::Not(_) => None,
    });
    json!(rows.collect::<Vec<_>>())
}

fn parse(name: &str, text: &str) -> Result<Task, String> {
    Task::parse_file(text, name.into()).map_err(|error| error.to_string())
}
