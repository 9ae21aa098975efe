//! The live page of a command that moves a robot (`--serve`): one place for all commands.
//!
//! The page begins with the first record of the command and stays until the command ends, so a command that
//! records several motions has one page.

use super::line::in_words;
use super::serve::announce;
use super::{Common, Failed};
use crate::control::Handle;
use crate::motion::Model;
use crate::record::events::Patience;
use crate::record::{Doing, EventBus};
use crate::serve::{CameraWatcher, Desk, Feed, FeedWatcher, Server};
use crate::sight::{Shown, TagMark, TagView};
use mcdpr_vision::RgbImage;
use serde_json::Value;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Commands with a live page: those that record a motion of a robot.
const COMMANDS: &[&str] = &[
    "arm",
    "calibrate all",
    "calibrate camera",
    "calibrate check",
    "calibrate collect",
    "calibrate frame",
    "calibrate tension",
    "calibrate winch",
    "commission",
    "jog",
    "move",
    "park",
    "pick",
    "rig attach",
    "rig lower",
    "rig spool",
    "rig tension",
    "run",
    "tune tension",
];
/// Least time between two pictures of a real camera: to pack one takes a tenth of a second.
const PICTURE: Duration = Duration::from_secs(1);
/// What fails, in messages.
const WHAT: &str = "the live page";
/// Time that an order may take before the page gets the answer "in progress".
const ANSWER: Duration = Duration::from_millis(50);

/// Refuses `--serve` for a command that shows nothing.
///
/// # Errors
/// The reason.
pub(super) fn check(words: &str, serve: Option<u16>) -> Result<(), Failed> {
    if serve.is_none() || COMMANDS.contains(&words) {
        return Ok(());
    }
    Err(Failed::from_error("--serve")(format!(
        "`mcdpr {words}` moves no robot that could be shown; these do: {}",
        COMMANDS.join(", ")
    )))
}

/// The live page of a command, once it has begun. Clones share it.
#[derive(Clone, Default)]
pub(crate) struct LivePage {
    begun: Arc<Mutex<Option<Begun>>>,
}

struct Begun {
    feed: Feed,
    desk: Arc<LiveDesk>,
    _server: Server,
}

impl std::fmt::Debug for LivePage {
    fn fmt(&self, to: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        to.debug_struct("LivePage").finish_non_exhaustive()
    }
}

impl LivePage {
    /// For a camera: shows its pictures with the tags in them, once the page has begun and while there are
    /// viewers.
    pub(super) fn pictures(&self) -> impl FnMut(&RgbImage, &[TagView]) + Send + 'static {
        let page = self.clone();
        let mut shown: Option<Instant> = None;
        move |picture, tags| {
            if shown.is_some_and(|at| at.elapsed() < PICTURE) {
                return;
            }
            let feed = lock(&page.begun).as_ref().map(|begun| begun.feed.clone());
            let Some(feed) = feed.filter(Feed::is_watched) else {
                return;
            };
            shown = Some(Instant::now());
            let marks = tags.iter().map(|tag| TagMark {
                id: tag.id,
                corners_px: tag.corners_px,
            });
            feed.show(&Shown {
                picture: Arc::new(picture.clone()),
                source: "what the tool's camera sees",
                tags: marks.collect(),
                grasp: None,
            });
        }
    }
}

impl Common {
    /// Shows a motion that begins to the viewers of the live page, if there is one: its events, and on the
    /// simulator what the robot's camera sees. Orders of the page go to `orders`.
    ///
    /// # Errors
    /// If the page cannot be served, or the robot cannot be drawn.
    pub(super) fn show_live(
        &self,
        model: Option<&Model>,
        doing: Doing,
        orders: Option<&Handle>,
        events: &mut EventBus,
    ) -> Result<Option<Feed>, Failed> {
        let Some(port) = self.serve else {
            return Ok(None);
        };
        // A bare winch has no hanging robot; the page draws the one of the file.
        let model = match model {
            Some(model) => model.clone(),
            None => {
                let robot = crate::robot::find(&self.robot);
                let robot = robot.map_err(|error| Failed::from_error(WHAT)(in_words(&error)))?;
                Model::new(&robot).map_err(|error| Failed::from_error(WHAT)(in_words(&error)))?
            }
        };
        let mut begun = lock(&self.page.begun);
        if begun.is_none() {
            let feed = crate::serve::feed();
            let desk = Arc::new(LiveDesk::default());
            let server = Server::start(port, None, model.robot(), feed.clone(), desk.clone())
                .map_err(|error| Failed::from_error(WHAT)(in_words(&error)))?;
            if !self.json {
                announce(&server, self).map_err(Failed::from_error(WHAT))?;
            }
            *begun = Some(Begun {
                feed,
                desk,
                _server: server,
            });
        }
        let Some(begun) = begun.as_ref() else {
            return Ok(None);
        };
        *lock(&begun.desk.orders) = orders.cloned();
        let watcher = FeedWatcher::new(begun.feed.clone(), model.clone());
        events
            .add(watcher, Patience::Drop)
            .map_err(Failed::from_error(WHAT))?;
        // Picking shows its own pictures, and a robot on its stand sees nothing.
        if self.on == "sim" && matches!(doing, Doing::Task | Doing::Orders) {
            let camera = CameraWatcher::new(begun.feed.clone(), model.robot(), self.seed)
                .at_pace(self.pace()?.unwrap_or(1.0));
            events
                .add(camera, Patience::Drop)
                .map_err(Failed::from_error(WHAT))?;
        }
        Ok(Some(begun.feed.clone()))
    }
}

/// Passes the page's orders to the thread that moves the robot.
#[derive(Default)]
struct LiveDesk {
    /// The present motion's; without it, the page can only stop the command, as Ctrl-C does.
    orders: Mutex<Option<Handle>>,
}

impl Desk for LiveDesk {
    fn order(&self, name: &str, message: &Value) -> Result<Value, String> {
        use crate::control::Order;
        let Some(handle) = lock(&self.orders).clone() else {
            return match name {
                "stop" => {
                    mcdpr_core::run::interrupt();
                    Ok(Value::Null)
                }
                "hold" => Err("this command cannot hold: Stop ends it".to_owned()),
                other => Err(format!("there is no order {other}")),
            };
        };
        let ticket = match name {
            "stop" => {
                // The page does not wait for a stop: it is in progress.
                handle.stop();
                return Ok(Value::Null);
            }
            "hold" => handle.pause(),
            "resume" => handle.resume(),
            "clear" => handle.clear(),
            "gripper" => {
                let closed = message["closed"].as_bool();
                let closed = closed.ok_or("a gripper order needs closed, true or false")?;
                handle.order(Order::Gripper { closed })
            }
            "jog" => return Err("a task is under way: stop it first".to_owned()),
            _ => return Err("this page cannot start a task".to_owned()),
        };
        let outcome = handle.wait(ticket, ANSWER).unwrap_or(Ok(()));
        outcome.map(|()| Value::Null)
    }

    fn orders(&self) -> Vec<&'static str> {
        vec!["stop", "hold", "resume", "clear", "gripper"]
    }
}

fn lock<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    // A viewer that panicked must not make a stop impossible.
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_is_refused_where_nothing_would_be_shown() {
        assert!(check("states", None).is_ok());
        assert!(check("pick", Some(0)).is_ok());
        let error = check("states", Some(0)).unwrap_err().to_string();
        assert!(
            error.contains("mcdpr states") && error.contains("tune tension"),
            "{error}"
        );
        for words in COMMANDS {
            assert!(
                super::super::DRY_RUNS
                    .iter()
                    .any(|(known, _)| known == words),
                "there is no command {words}"
            );
        }
    }
}
