//! What viewers of a live page see of picking.

use crate::pick::{News, Outcome};
use crate::serve::Feed;
use serde_json::{Value, json};
use std::cell::RefCell;

/// Most refused grasps that are shown.
const MOST: usize = 40;

/// Collects the news of a picking task into one message for viewers.
pub(super) struct Board {
    feed: Feed,
    shown: RefCell<Value>,
}

impl Board {
    pub(super) fn new(feed: &Feed) -> Self {
        Self {
            feed: feed.clone(),
            shown: RefCell::new(json!({
                "type": "pick", "phase": "preparing", "phases": [], "picked": 0, "failed": 0, "refused": [], "objects": [],
                "attempts": [],
            })),
        }
    }

    /// Adds news, and shows them.
    pub(super) fn take(&self, news: &News) {
        let mut shown = self.shown.borrow_mut();
        add(&mut shown, news);
        self.feed.notices().post(shown.clone());
    }
}

fn add(shown: &mut Value, news: &News) {
    let more = |value: &Value| json!(value.as_u64().unwrap_or(0) + 1);
    match news {
        News::Places {
            tray_m,
            half_m,
            release_m,
        } => {
            shown["tray"] = json!({ "middle_m": tray_m, "half_m": half_m, "release_m": release_m });
        }
        News::Objects(objects) => shown["objects"] = json!(objects),
        News::Phase(phase) => {
            let phase = json!(phase);
            // A short phase may begin and end between two messages.
            if let Some(all) = shown["phases"].as_array_mut()
                && !all.contains(&phase)
            {
                all.push(phase.clone());
            }
            shown["phase"] = phase;
        }
        News::Judged {
            grasps,
            possible,
            refused,
        } => {
            shown["grasps"] = json!(grasps);
            shown["possible"] = json!(possible);
            shown["chosen"] = Value::Null;
            shown["refused"] = json!(refused.iter().take(MOST).collect::<Vec<_>>());
        }
        News::Chosen(chosen) => {
            shown["chosen"] = json!(chosen);
            shown["weight_n"] = Value::Null;
        }
        News::Weighed { weight_n } => shown["weight_n"] = json!(weight_n),
        News::Refused(refusal) => {
            if let Some(all) = shown["refused"].as_array_mut()
                && all.len() < MOST
            {
                all.push(json!(refusal));
            }
        }
        News::Attempt { outcome, weight_n } => {
            shown["outcome"] = json!(outcome);
            if let Some(all) = shown["attempts"].as_array_mut() {
                all.push(json!({ "outcome": outcome, "weight_n": weight_n }));
            }
            let count = if *outcome == Outcome::Delivered {
                "picked"
            } else {
                "failed"
            };
            shown[count] = more(&shown[count]);
        }
        News::End(end) => {
            shown["phase"] = json!("ended");
            shown["end"] = json!(super::end(end));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pick::{End, Phase, Refusal};

    #[test]
    fn viewers_see_counts_reasons_and_the_end() {
        let feed = crate::serve::feed();
        let board = Board::new(&feed);
        board.take(&News::Phase(Phase::LookingAgain));
        let refusal = Refusal {
            at_m: [0.1, 0.2, 0.3],
            width_m: 0.02,
            reason: "out of reach",
        };
        board.take(&News::Judged {
            grasps: 80,
            possible: 0,
            refused: vec![refusal.clone(); 80],
        });
        board.take(&News::Refused(refusal));
        board.take(&News::Weighed { weight_n: 0.5 });
        assert_eq!(board.shown.borrow()["weight_n"], 0.5);
        let ended = |outcome, weight_n| board.take(&News::Attempt { outcome, weight_n });
        ended(Outcome::Delivered, Some(0.5));
        ended(Outcome::Missed, None);
        ended(Outcome::Lost, Some(0.1));
        let shown = board.shown.borrow().clone();
        assert_eq!(shown["phase"], "looking_again");
        assert_eq!(shown["phases"], json!(["looking_again"]));
        assert_eq!(shown["refused"].as_array().unwrap().len(), MOST);
        assert_eq!(shown["refused"][0]["reason"], "out of reach");
        let attempts = json!([
            { "outcome": "delivered", "weight_n": 0.5 },
            { "outcome": "missed", "weight_n": null },
            { "outcome": "lost", "weight_n": 0.1 },
        ]);
        assert_eq!(shown["attempts"], attempts);
        assert_eq!((&shown["picked"], &shown["failed"]), (&json!(1), &json!(2)));
        board.take(&News::End(End::Empty));
        assert_eq!(board.shown.borrow()["end"], "the tray is empty");
    }
}
