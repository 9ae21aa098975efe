//! Permission to give orders: only with the token, and one page at a time.

use super::feed::Feed;
use super::server::Desk;
use serde_json::{Value, json};
use std::hash::{BuildHasher, RandomState};
use std::sync::{Mutex, PoisonError};

/// Orders that stop the robot: every page with the token may give them.
const STOPS: [&str; 2] = ["stop", "hold"];

/// Orders that are not worth a line of the log: they come often, or move nothing.
const QUIET: [&str; 6] = ["jog", "tasks", "task_read", "plan", "forget", "step_line"];

/// State of the permission.
pub(super) struct Orders {
    token: String,
    /// Number of the page that has the controls.
    seat: Mutex<Option<u64>>,
}

impl Orders {
    /// For viewers with this token; without one, a random one is made. An empty token would admit
    /// everybody: it counts as none.
    pub(super) fn new(token: Option<String>) -> Self {
        let given = token.filter(|token| !token.trim().is_empty());
        Self {
            token: given.unwrap_or_else(new_token),
            seat: Mutex::default(),
        }
    }

    pub(super) fn token(&self) -> &str {
        &self.token
    }

    /// A page was closed: the controls are free, if it had them.
    pub(super) fn leave(&self, page: u64) {
        let mut seat = self.seat.lock().unwrap_or_else(PoisonError::into_inner);
        seat.take_if(|holder| *holder == page);
    }

    /// Whether this page has the controls; takes them if no page has.
    fn sits(&self, page: u64) -> bool {
        let mut seat = self.seat.lock().unwrap_or_else(PoisonError::into_inner);
        *seat.get_or_insert(page) == page
    }

    fn knows(&self, token: Option<&str>) -> bool {
        token.is_some_and(|token| same(token, &self.token))
    }

    fn may(&self, page: u64, order: &str, knows: bool) -> Result<(), &'static str> {
        if !knows {
            return Err("view only: orders need the address with the token");
        }
        // A stop needs the token but not the controls: a second page may stop the robot in danger.
        if STOPS.contains(&order) || self.sits(page) {
            return Ok(());
        }
        Err(
            "view only: another page has the controls until it is closed; Stop and Hold work from here, too",
        )
    }

    /// Executes a page's order, if permitted; returns the answer.
    pub(super) fn obey(&self, page: u64, text: &str, desk: &dyn Desk, feed: &Feed) -> Value {
        let message: Value = serde_json::from_str(text).unwrap_or_default();
        let knows = self.knows(message["token"].as_str());
        let outcome = match message["order"].as_str() {
            None => Err("this is not an order".to_owned()),
            Some(name) => match self.may(page, name, knows) {
                Err(reason) => Err(reason.to_owned()),
                // The page asks whether its buttons should work.
                Ok(()) if name == "may" => Ok(Value::Null),
                Ok(()) => give(name, &message, desk, feed),
            },
        };
        json!({
            "type": "answer",
            "id": message["id"],
            "order": message["order"],
            "ok": outcome.is_ok(),
            "may_stop": knows,
            "data": outcome.as_ref().ok(),
            "reason": outcome.as_ref().err(),
        })
    }
}

fn give(name: &str, message: &Value, desk: &dyn Desk, feed: &Feed) -> Result<Value, String> {
    let outcome = desk.order(name, message);
    if let Err(reason) = &outcome {
        feed.say(&format!("{name}: {reason}"));
    } else if !QUIET.contains(&name) {
        feed.say(&format!("order from the page: {name}"));
    }
    outcome
}

/// 128 random bits, from the randomness that hash maps are seeded with.
fn new_token() -> String {
    let one = || RandomState::new().hash_one(0_u8);
    format!("{:016x}{:016x}", one(), one())
}

/// Compares in constant time, so that the time does not reveal where they differ.
fn same(a: &str, b: &str) -> bool {
    let differ = a
        .bytes()
        .zip(b.bytes())
        .fold(0, |sum, (a, b)| sum | (a ^ b));
    a.len() == b.len() && differ == 0
}

#[cfg(test)]
mod tests {
    use super::Orders;

    #[test]
    fn one_page_has_the_controls_until_it_goes_and_stops_are_everybodys_who_has_the_token() {
        let orders = Orders::new(Some("letmein".to_owned()));
        let knows = orders.knows(Some("letmein"));
        assert!(knows && !orders.knows(Some("letmeout")) && !orders.knows(None));
        assert!(orders.may(1, "stop", false).is_err());
        // A request without the token does not take the controls.
        assert!(orders.may(9, "may", false).is_err());
        assert!(orders.may(2, "stop", knows).is_ok());
        assert!(orders.may(1, "may", knows).is_ok());
        let said = orders.may(2, "start", knows).unwrap_err();
        assert!(said.contains("another page has the controls"), "{said}");
        assert!(orders.may(2, "stop", knows).is_ok() && orders.may(2, "hold", knows).is_ok());
        orders.leave(2);
        assert!(orders.may(2, "resume", knows).is_err());
        orders.leave(1);
        assert!(orders.may(2, "resume", knows).is_ok());
        assert!(orders.may(1, "resume", knows).is_err());
    }

    #[test]
    fn tokens_are_long_and_new_each_time() {
        let (one, two) = (Orders::new(None), Orders::new(None));
        assert_eq!((one.token().len(), two.token().len()), (32, 32));
        assert_ne!(one.token(), two.token());
        for empty in ["", "  "] {
            let orders = Orders::new(Some(empty.to_owned()));
            assert!(!orders.knows(Some(empty)) && orders.token().len() == 32);
        }
    }
}
