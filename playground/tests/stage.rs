//! The playground's robot without a browser: its page is a script, its clock is virtual.

use mcdpr_playground::stage::{Kept, Stage};
use mcdpr_playground::{Host, Settings};
use serde_json::{Value, json};
use std::cell::{Cell, RefCell};
use std::collections::VecDeque;

/// A page that sends each message as soon as what was delivered before allows it.
struct Script {
    now_ms: Cell<f64>,
    /// The robot's state in which each message is sent, and the message.
    steps: RefCell<VecDeque<(&'static str, Value)>>,
    state: RefCell<String>,
    answers: RefCell<Vec<Value>>,
    states: RefCell<Vec<String>>,
    files: RefCell<VecDeque<Vec<u8>>>,
}

impl Script {
    fn new(steps: impl IntoIterator<Item = (&'static str, Value)>) -> Self {
        Self {
            now_ms: Cell::new(1.0),
            steps: RefCell::new(steps.into_iter().collect()),
            state: RefCell::default(),
            answers: RefCell::default(),
            states: RefCell::default(),
            files: RefCell::default(),
        }
    }

    fn answer(&self, order: &str) -> Value {
        let answers = self.answers.borrow();
        let found = answers.iter().rev().find(|answer| answer["order"] == order);
        found.cloned().unwrap_or_default()
    }
}

impl Host for Script {
    fn pause(&self, ms: f64) {
        // Some time passes even where nobody waits.
        self.now_ms.set(self.now_ms.get() + ms.max(1.0));
        assert!(
            self.now_ms.get() < 120_000.0,
            "waited in vain for {:?}; the robot was {:?}; last answer {:?}",
            self.steps.borrow().front(),
            self.states.borrow(),
            self.answers.borrow().last()
        );
    }

    fn now_ms(&self) -> f64 {
        self.now_ms.get()
    }

    fn take(&self) -> Option<String> {
        let mut steps = self.steps.borrow_mut();
        let (state, _) = steps.front()?;
        if *state != *self.state.borrow() {
            return None;
        }
        steps.pop_front().map(|(_, message)| message.to_string())
    }

    fn file(&self) -> Option<Vec<u8>> {
        self.files.borrow_mut().pop_front()
    }

    fn deliver(&self, text: &str) {
        let message: Value = serde_json::from_str(text).unwrap();
        match message["type"].as_str() {
            Some("answer") => self.answers.borrow_mut().push(message),
            Some("live") => {
                let state = message["state"].as_str().unwrap().to_owned();
                if *self.state.borrow() != state {
                    self.states.borrow_mut().push(state.clone());
                    *self.state.borrow_mut() = state;
                }
            }
            _ => {}
        }
    }
}

fn clock_s() -> f64 {
    0.0
}

fn play(settings: Settings, script: &Script) {
    let kept = Kept::default();
    let stage = Stage::new(script, settings, clock_s, &kept).unwrap();
    stage.play();
}

#[test]
fn a_robot_moves_stops_plans_refuses_and_makes_room_for_another() {
    let far = json!({ "order": "plan", "to_mm": [0, 0, 5000] });
    let script = Script::new([
        (
            "Moving",
            json!({ "order": "sim_inject", "fault": "nonsense" }),
        ),
        (
            "Moving",
            json!({ "order": "sim_push", "force_n": [500, 0, 0] }),
        ),
        // The paper's drives do not report their temperature.
        (
            "Moving",
            json!({ "order": "sim_inject", "fault": "D6:1@0s" }),
        ),
        ("Moving", json!({ "order": "stop" })),
        ("Disarmed", far),
        ("Disarmed", json!({ "order": "start", "plan": 1 })),
        // Nor does a start from a button elsewhere begin another task than the one that is shown.
        ("Disarmed", json!({ "order": "start" })),
        (
            "Disarmed",
            json!({ "order": "plan", "to_mm": [300, 0, -200] }),
        ),
        ("Disarmed", json!({ "order": "start", "plan": 2 })),
        ("Moving", json!({ "order": "nothing" })),
        (
            "Disarmed",
            json!({ "order": "sim_restart", "robot": "none" }),
        ),
        (
            "Disarmed",
            json!({ "order": "sim_restart", "robot": "lab-fast" }),
        ),
    ]);
    play(Settings::default(), &script);
    let answers = script.answers.borrow();
    let refused: Vec<_> = answers.iter().filter(|a| a["ok"] == json!(false)).collect();
    let reason = |index: usize| refused[index]["reason"].as_str().unwrap();
    let words = [
        "nonsense",
        "20 N",
        "RMDS",
        "breaks a limit",
        "breaks a limit",
        "no order nothing",
        "lab-fast",
    ];
    assert_eq!(refused.len(), words.len(), "{refused:?}");
    for (index, word) in words.into_iter().enumerate() {
        assert!(reason(index).contains(word), "{}", reason(index));
    }
    // It moved twice, and each motion ended with closed brakes.
    let states = script.states.borrow();
    let moved = states.iter().filter(|state| *state == "Moving").count();
    assert_eq!((moved, states.last().unwrap().as_str()), (2, "Disarmed"));
}

#[test]
fn an_injected_fault_stops_the_robot_and_is_named() {
    let script = Script::new([
        (
            "Moving",
            json!({ "order": "sim_inject", "fault": "S7:3@0s" }),
        ),
        ("Fault", json!({ "order": "sim_restart", "seed": 4 })),
    ]);
    play(Settings::default(), &script);
    assert_eq!(script.answer("sim_restart")["ok"], json!(true));
}

#[test]
fn settings_are_changed_by_messages_and_come_back_from_them() {
    let first = Settings::default();
    let message = json!({ "robot": "lab-fast", "seed": 9, "exact": true, "tool_mm": [1, 2, -150] });
    let changed = first.changed(&message).unwrap();
    assert_eq!((changed.name.as_str(), changed.seed), ("lab-fast", 9));
    assert_eq!(first.changed(&changed.message()).unwrap(), changed);
    let own = Settings {
        text: format!("# own\n{}", changed.text),
        ..changed
    };
    assert_eq!(first.changed(&own.message()).unwrap(), own);
    for (wrong, word) in [
        (json!({ "robot": "none" }), "paper-table5"),
        (json!({ "seed": -1 }), "seed"),
        (json!({ "tool_mm": [1, 2] }), "three numbers"),
        (json!({ "text": "x".repeat(300_000) }), "256 kB"),
    ] {
        let reason = first.changed(&wrong).unwrap_err();
        assert!(reason.contains(word), "{reason}");
    }
    let text = first.changed(&json!({ "text": "name = 3" })).unwrap();
    assert!(text.robot().is_err());
}
