//! What other parts of the program tell viewers: the latest message of each kind, lines of output, and the state
//! of a robot that another program moves meanwhile.

use serde_json::{Value, json};
use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Lines of output that a new viewer gets.
const LINES: usize = 500;
/// A longer line is cut, characters.
const LONGEST: usize = 400;

/// Messages for viewers. Clones share them.
#[derive(Debug, Clone)]
pub struct Notices {
    inner: Arc<Mutex<Inner>>,
    /// Any time that only grows, s.
    clock_s: fn() -> f64,
}

#[derive(Debug, Default)]
struct Inner {
    count: u64,
    /// The latest message of each kind, with its number.
    posts: BTreeMap<String, (u64, Value)>,
    lines: VecDeque<(u64, Value)>,
    /// The state that another program sends, with its number and when it came, s.
    live: Option<(u64, Value, f64)>,
}

/// What a viewer has got so far.
#[derive(Debug, Default)]
pub struct Seen {
    count: u64,
}

/// What a viewer has to get.
#[derive(Debug, Default)]
pub struct Others {
    /// Messages.
    pub messages: Vec<Value>,
    /// The state that another program sends.
    pub live: Option<Value>,
    /// Whether it is newer than the last one.
    pub live_is_new: bool,
    /// Age of the state's data, s; none before the first data.
    pub live_age_s: Option<f64>,
}

impl Inner {
    fn next(&mut self) -> u64 {
        self.count += 1;
        self.count
    }
}

impl Notices {
    /// None yet; `clock_s` gives any time that only grows, s.
    #[must_use]
    pub fn new(clock_s: fn() -> f64) -> Self {
        Self {
            inner: Arc::default(),
            clock_s,
        }
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        // A viewer that panicked must not affect the others.
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Tells viewers a message, instead of the last of its `type`.
    pub fn post(&self, message: Value) {
        let kind = message["type"].as_str().unwrap_or_default().to_owned();
        let mut inner = self.lock();
        let number = inner.next();
        inner.posts.insert(kind, (number, message));
    }

    /// A line of output of run `run`; `kind` says which output.
    pub fn line(&self, run: u64, kind: &str, text: &str) {
        let mut text: String = text.trim_end().to_owned();
        if let Some((end, _)) = text.char_indices().nth(LONGEST) {
            text.truncate(end);
            text.push_str(" ...");
        }
        let mut inner = self.lock();
        let number = inner.next();
        let line = json!({ "number": number, "run": run, "kind": kind, "text": text });
        inner.lines.push_back((number, line));
        if inner.lines.len() > LINES {
            inner.lines.pop_front();
        }
    }

    /// Shows the state of a robot that another program moves instead of this program's own; `None` ends that.
    pub fn set_live(&self, live: Option<Value>) {
        let mut inner = self.lock();
        let number = inner.next();
        inner.live = live.map(|live| (number, live, (self.clock_s)()));
    }

    /// What is new since the last call with this `seen`.
    pub fn since(&self, seen: &mut Seen) -> Others {
        let inner = self.lock();
        let mut others = Others::default();
        if let Some((number, live, at)) = &inner.live {
            others.live_is_new = *number > seen.count;
            let age_s = live["age_s"].as_f64();
            others.live_age_s = age_s.map(|age_s| age_s + (self.clock_s)() - at);
            others.live = Some(live.clone());
        }
        if inner.count == seen.count {
            return others;
        }
        let posts = inner.posts.values();
        let new = posts.filter(|(number, _)| *number > seen.count);
        others
            .messages
            .extend(new.map(|(_, message)| message.clone()));
        let lines = inner.lines.iter();
        let lines: Vec<_> = lines
            .filter(|(number, _)| *number > seen.count)
            .map(|(_, line)| line.clone())
            .collect();
        if !lines.is_empty() {
            others
                .messages
                .push(json!({ "type": "output", "lines": lines }));
        }
        seen.count = inner.count;
        others
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_viewer_gets_the_latest_of_each_kind_once_and_a_bounded_output() {
        let notices = Notices::new(|| 1.0);
        let mut seen = Seen::default();
        assert!(notices.since(&mut seen).messages.is_empty());
        notices.post(json!({ "type": "steps", "a": 1 }));
        notices.post(json!({ "type": "steps", "a": 2 }));
        notices.line(1, "out", &"x".repeat(1000));
        let got = notices.since(&mut seen).messages;
        assert_eq!(got.len(), 2);
        assert_eq!(got[0], json!({ "type": "steps", "a": 2 }));
        let text = got[1]["lines"][0]["text"].as_str().unwrap();
        assert_eq!(text.len(), LONGEST + 4);
        assert!(notices.since(&mut seen).messages.is_empty());
        for line in 0..2 * LINES {
            notices.line(2, "out", &line.to_string());
        }
        // A viewer that comes late gets what is kept.
        let late = notices.since(&mut Seen::default()).messages;
        let lines = late[1]["lines"].as_array().unwrap();
        assert_eq!(lines.len(), LINES);
        assert_eq!(lines[LINES - 1]["text"], (2 * LINES - 1).to_string());
    }

    #[test]
    fn the_state_of_another_program_stands_in_until_it_ends() {
        let notices = Notices::new(|| 1.0);
        let mut seen = Seen::default();
        notices.set_live(Some(json!({ "type": "live", "age_s": 0.25 })));
        let got = notices.since(&mut seen);
        assert!(got.live_is_new && got.live_age_s.unwrap() >= 0.25);
        assert!(!notices.since(&mut seen).live_is_new);
        notices.set_live(None);
        assert_eq!(notices.since(&mut seen).live, None);
    }
}
