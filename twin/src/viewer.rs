//! The messages that a viewer gets.

use crate::feed::{Feed, Picture};
use serde_json::{Value, json};
use std::sync::Arc;

/// A message to a viewer.
#[derive(Debug, Clone)]
pub enum Message {
    /// As JSON text.
    Text(Value),
    /// A picture: first its `about` as JSON text, then its bytes.
    Picture(Arc<Picture>),
}

/// What one viewer has been sent.
#[derive(Debug, Default)]
pub struct Viewer {
    revision: u64,
    plan: u64,
    logged: u64,
    pictures: u64,
    previews: u64,
}

impl Viewer {
    /// The first message: the robot's constant data, the orders that it takes, the program's version.
    #[must_use]
    pub fn hello(robot: &Value, orders: &[&str]) -> Value {
        json!({
            "type": "hello",
            "robot": robot,
            "orders": orders,
            "version": env!("CARGO_PKG_VERSION"),
        })
    }

    /// All that is new but the robot's state.
    pub fn news(&mut self, feed: &Feed) -> Vec<Message> {
        let mut news = Vec::new();
        if let Some((number, plan)) = feed.plan_after(self.plan) {
            self.plan = number;
            // Every fifth point, 0.1 s apart: enough for a drawing.
            let points: Vec<_> = plan.points.iter().step_by(5).map(|p| p.tool_m).collect();
            let (kind, duration_s) = ("plan", plan.duration_s);
            let message = json!({ "type": kind, "duration_s": duration_s, "tool_m": points });
            news.push(Message::Text(message));
        }
        if let Some((number, preview)) = feed.preview_after(self.previews) {
            self.previews = number;
            news.push(Message::Text(preview.as_ref().clone()));
        }
        if let Some((number, picture)) = feed.picture_after(self.pictures) {
            self.pictures = number;
            news.push(Message::Picture(picture));
        }
        let lines = feed.log_after(self.logged);
        if let Some(last) = lines.last() {
            self.logged = last.number;
            news.push(Message::Text(json!({ "type": "log", "lines": lines })));
        }
        news
    }

    /// The robot's state with its age, if it is new or `anyway`.
    pub fn live(&mut self, feed: &Feed, anyway: bool) -> Option<Value> {
        let (live, age_s) = feed.now();
        if live.revision == self.revision && !anyway {
            return None;
        }
        self.revision = live.revision;
        let mut message = serde_json::to_value(&live).ok()?;
        message["type"] = json!("live");
        message["age_s"] = json!(age_s);
        Some(message)
    }
}
