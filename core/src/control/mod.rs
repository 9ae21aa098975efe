//! Orders to a robot that another thread is running: stop, pause, resume, jog, clear.
//!
//! Exactly one thread talks to a board. All others (a page, another terminal, a test) hold a
//! [`Handle`], which gives orders, or an [`Observer`], which only reads. The thread that feeds the
//! board takes the orders between two frames, at least every 8 ms.

mod view;

pub use view::View;

use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// What a user can order while the robot is being run.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "order")]
pub enum Order {
    /// Decelerate along the path, close brakes under torque, torque off; ends the session.
    Stop,
    /// Brakes and torque off at once; ends the session. Only where drive control is lost.
    Emergency,
    /// Decelerate along the path and hold under tension.
    Pause,
    /// Continue along the same path after a pause.
    Resume,
    /// Move the tool at this velocity, world, m/s, until another jog arrives or `valid_s` has
    /// passed.
    Jog {
        /// Velocity of the tool in the world, m/s.
        velocity_mps: [f64; 3],
        /// How long the order is valid without a new one, s; the jog then ends by itself.
        valid_s: f64,
    },
    /// Acknowledge the latched fault.
    Clear,
    /// Open or close the gripper.
    Gripper {
        /// Whether to close it.
        closed: bool,
    },
}

impl Order {
    /// Its name in messages.
    #[must_use]
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Stop => "stop",
            Self::Emergency => "emergency stop",
            Self::Pause => "pause",
            Self::Resume => "resume",
            Self::Jog { .. } => "jog",
            Self::Clear => "clear",
            Self::Gripper { .. } => "gripper",
        }
    }

    /// Whether it ends everything in progress.
    #[must_use]
    pub(crate) const fn is_stop(&self) -> bool {
        matches!(self, Self::Stop | Self::Emergency)
    }
}

/// An order of a recorded run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScriptedOrder {
    /// Number of polls of the feeding thread before it.
    pub polls: u64,
    /// The order.
    pub order: Order,
}

/// Number of an order, used to ask for its outcome.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Ticket(u64);

/// Outcome of an order: done (the board confirmed it), or the reason why not.
pub type Outcome = Result<(), String>;

/// Outcomes are kept for this many orders.
const OUTCOMES: usize = 64;
/// At most this many orders wait: a caller that sends them faster than one per 8 ms is faulty.
const WAITING: usize = 64;
/// Orders that are kept for the recorder until it takes them.
const ARRIVED: usize = 1000;

#[derive(Debug, Default)]
struct Inner {
    next: u64,
    waiting: VecDeque<(Ticket, Order)>,
    outcomes: VecDeque<(Ticket, Outcome)>,
    /// A stop was ordered and [`Handle::start_anew`] has not been called since.
    stop: Option<Order>,
    view: View,
    /// How often the thread that feeds the board has polled for orders.
    looks: u64,
    /// Orders with the number of polls before them, for the recorder.
    arrived: Vec<ScriptedOrder>,
    /// Recorded orders that are given again after the same number of polls.
    script: VecDeque<ScriptedOrder>,
}

impl Inner {
    /// Counts a poll and releases the recorded orders that are due.
    fn look(&mut self) {
        while let Some(due) = self.due() {
            place(self, due.order);
        }
        self.looks += 1;
    }

    fn due(&mut self) -> Option<ScriptedOrder> {
        let looks = self.looks;
        self.script.pop_front_if(|next| next.polls <= looks)
    }
}

#[derive(Debug, Default)]
struct Shared {
    inner: Mutex<Inner>,
    changed: Condvar,
}

impl Shared {
    /// A panic elsewhere must not make a stop impossible.
    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn wait_until<T>(
        &self,
        timeout: Duration,
        mut ready: impl FnMut(&Inner) -> Option<T>,
    ) -> Option<T> {
        let mut found = None;
        let not_yet = |inner: &mut Inner| {
            found = ready(inner);
            found.is_none()
        };
        // A panic elsewhere must not hide the outcome.
        let _ = self
            .changed
            .wait_timeout_while(self.lock(), timeout, not_yet);
        found
    }
}

/// Gives orders to the thread that feeds the board. Clones give orders to the same robot.
///
/// ```
/// use mcdpr_core::control::{Handle, Order};
/// let handle = Handle::new();
/// let ticket = handle.order(Order::Pause);
/// assert_eq!(handle.take(), Some((ticket, Order::Pause)));
/// handle.done(ticket, Ok(()));
/// assert_eq!(handle.outcome(ticket), Some(Ok(())));
/// ```
#[derive(Debug, Clone, Default)]
pub struct Handle {
    shared: Arc<Shared>,
}

impl Handle {
    /// A handle for one robot.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// A reader for this robot.
    #[must_use]
    pub fn observer(&self) -> Observer {
        Observer {
            shared: Arc::clone(&self.shared),
        }
    }

    /// Gives an order and returns at once. A stop goes before all waiting orders; a jog replaces a
    /// waiting jog.
    pub fn order(&self, order: Order) -> Ticket {
        let mut inner = self.shared.lock();
        let looks = inner.looks;
        // There may be no recorder; the list is bounded.
        if inner.arrived.len() < ARRIVED {
            inner.arrived.push(ScriptedOrder {
                polls: looks,
                order,
            });
        }
        let ticket = place(&mut inner, order);
        drop(inner);
        self.shared.changed.notify_all();
        ticket
    }

    /// [`Order::Stop`].
    pub fn stop(&self) -> Ticket {
        self.order(Order::Stop)
    }

    /// [`Order::Pause`].
    pub fn pause(&self) -> Ticket {
        self.order(Order::Pause)
    }

    /// [`Order::Pause`] by its other name.
    pub fn hold(&self) -> Ticket {
        self.order(Order::Pause)
    }

    /// [`Order::Resume`].
    pub fn resume(&self) -> Ticket {
        self.order(Order::Resume)
    }

    /// [`Order::Jog`] for a fifth of a second.
    pub fn jog(&self, velocity_mps: [f64; 3]) -> Ticket {
        self.order(Order::Jog {
            velocity_mps,
            valid_s: 0.2,
        })
    }

    /// [`Order::Clear`].
    pub fn clear(&self) -> Ticket {
        self.order(Order::Clear)
    }

    /// The outcome of an order so far; `None` while it waits, or when it is too old to be kept.
    #[must_use]
    pub fn outcome(&self, ticket: Ticket) -> Option<Outcome> {
        find(&self.shared.lock(), ticket)
    }

    /// Waits for the outcome of an order.
    #[must_use]
    pub fn wait(&self, ticket: Ticket, timeout: Duration) -> Option<Outcome> {
        self.shared.wait_until(timeout, |inner| find(inner, ticket))
    }

    /// The next order, for the thread that feeds the board.
    #[must_use]
    pub fn take(&self) -> Option<(Ticket, Order)> {
        let mut inner = self.shared.lock();
        inner.look();
        inner.waiting.pop_front()
    }

    /// A handle that repeats recorded orders. Each is given at the same poll of the feeding thread
    /// as in the record, so a run with orders replays exactly.
    #[must_use]
    pub fn scripted(orders: impl IntoIterator<Item = ScriptedOrder>) -> Self {
        let handle = Self::new();
        handle.shared.lock().script.extend(orders);
        handle
    }

    /// Orders that arrived since the last call.
    #[must_use]
    pub fn arrived(&self) -> Vec<ScriptedOrder> {
        std::mem::take(&mut self.shared.lock().arrived)
    }

    /// Counts polls from zero again: a new run begins.
    pub fn count_anew(&self) {
        let mut inner = self.shared.lock();
        inner.looks = 0;
        inner.arrived.clear();
    }

    /// [`Order::Stop`] by the user's interrupt, which the feeding thread has seen at its last poll.
    pub fn interrupt(&self) {
        let mut inner = self.shared.lock();
        // The poll that saw the interrupt is counted already: a replay stops at the same one.
        let looks = inner.looks.saturating_sub(1);
        if inner.stop.is_none() && inner.arrived.len() < ARRIVED {
            let order = Order::Stop;
            inner.arrived.push(ScriptedOrder {
                polls: looks,
                order,
            });
            place(&mut inner, Order::Stop);
        }
    }

    /// Reports the outcome of an order.
    pub fn done(&self, ticket: Ticket, outcome: Outcome) {
        finish(&mut self.shared.lock(), ticket, outcome);
        self.shared.changed.notify_all();
    }

    /// The stop that was ordered, if one was; it stays until [`Handle::start_anew`].
    #[must_use]
    pub fn stop_ordered(&self) -> Option<Order> {
        let mut inner = self.shared.lock();
        inner.look();
        inner.stop
    }

    /// Forgets an old stop: the user starts new work on purpose.
    pub fn start_anew(&self) {
        self.shared.lock().stop = None;
    }

    /// Refuses all waiting orders because no thread feeds the robot any more. Stops count as done:
    /// the robot is at rest with its brakes closed.
    pub fn close(&self, reason: &str) {
        let mut inner = self.shared.lock();
        let late: Vec<_> = inner.waiting.drain(..).collect();
        for (ticket, order) in late {
            let outcome = if order.is_stop() {
                Ok(())
            } else {
                Err(reason.to_owned())
            };
            finish(&mut inner, ticket, outcome);
        }
        self.shared.changed.notify_all();
    }

    /// Changes what observers see.
    pub fn publish(&self, change: impl FnOnce(&mut View)) {
        let mut inner = self.shared.lock();
        change(&mut inner.view);
        inner.view.revision += 1;
        self.shared.changed.notify_all();
    }

    /// What observers see now.
    #[must_use]
    pub fn view(&self) -> View {
        self.shared.lock().view.clone()
    }
}

/// Reads the state of a robot that is being run; cannot give orders.
#[derive(Debug, Clone)]
pub struct Observer {
    shared: Arc<Shared>,
}

impl Observer {
    /// The current view.
    #[must_use]
    pub fn view(&self) -> View {
        self.shared.lock().view.clone()
    }

    /// Waits for a view newer than the given revision ([`View::revision`]).
    #[must_use]
    #[cfg(test)]
    pub(crate) fn newer_than(&self, revision: u64, timeout: Duration) -> Option<View> {
        self.shared.wait_until(timeout, |inner| {
            (inner.view.revision > revision).then(|| inner.view.clone())
        })
    }
}

/// Queues an order.
fn place(inner: &mut Inner, order: Order) -> Ticket {
    inner.next += 1;
    let ticket = Ticket(inner.next);
    if order.is_stop() {
        // A stop goes before everything: waiting orders are answered, and never executed after it.
        let late: Vec<_> = inner.waiting.drain(..).collect();
        for (old, _) in late {
            finish(inner, old, Err("a stop came first".to_owned()));
        }
        // An emergency is never weakened by a later stop.
        if inner.stop != Some(Order::Emergency) {
            inner.stop = Some(order);
        }
    }
    // Only the latest wish of a jog counts: older ones would move the tool after the button's
    // release.
    if let (Order::Jog { .. }, Some(&(old, Order::Jog { .. }))) = (order, inner.waiting.back()) {
        inner.waiting.pop_back();
        finish(inner, old, Ok(()));
    }
    if inner.waiting.len() >= WAITING {
        finish(
            inner,
            ticket,
            Err(format!(
                "{WAITING} orders wait already: no thread takes them"
            )),
        );
    } else {
        inner.waiting.push_back((ticket, order));
    }
    ticket
}

fn finish(inner: &mut Inner, ticket: Ticket, outcome: Outcome) {
    if inner.outcomes.len() >= OUTCOMES {
        inner.outcomes.pop_front();
    }
    inner.outcomes.push_back((ticket, outcome));
}

fn find(inner: &Inner, ticket: Ticket) -> Option<Outcome> {
    let mut outcomes = inner.outcomes.iter().rev();
    outcomes
        .find(|(known, _)| *known == ticket)
        .map(|(_, outcome)| outcome.clone())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stop_goes_before_everything_and_stays() {
        let handle = Handle::new();
        let pause = handle.pause();
        let stop = handle.stop();
        assert_eq!(handle.take(), Some((stop, Order::Stop)));
        assert_eq!(handle.take(), None);
        assert!(handle.outcome(pause).is_some_and(|o| o.is_err()));
        assert_eq!(handle.stop_ordered(), Some(Order::Stop));
        handle.start_anew();
        assert_eq!(handle.stop_ordered(), None);
    }

    #[test]
    fn an_emergency_is_not_weakened_by_a_stop() {
        let handle = Handle::new();
        handle.order(Order::Emergency);
        handle.stop();
        assert_eq!(handle.stop_ordered(), Some(Order::Emergency));
    }

    #[test]
    fn jogs_replace_each_other_and_a_flood_is_refused() {
        let handle = Handle::new();
        let first = handle.jog([0.1, 0.0, 0.0]);
        let second = handle.jog([0.2, 0.0, 0.0]);
        assert_eq!(handle.outcome(first), Some(Ok(())));
        assert_eq!(handle.take().map(|(ticket, _)| ticket), Some(second));
        for _ in 0..WAITING {
            handle.pause();
        }
        let over = handle.pause();
        assert!(handle.outcome(over).is_some_and(|o| o.is_err()));
    }

    #[test]
    fn observers_see_what_was_published_and_can_wait_for_it() {
        let handle = Handle::new();
        let observer = handle.observer();
        let seen = observer.view().revision;
        assert!(observer.newer_than(seen, Duration::ZERO).is_none());
        handle.publish(|view| view.path_s = 1.5);
        let newer = observer.newer_than(seen, Duration::ZERO);
        assert_eq!(newer.map(|view| view.path_s), Some(1.5));
    }

    #[test]
    fn a_script_gives_orders_at_the_look_at_which_they_came() {
        let handle = Handle::new();
        assert_eq!(handle.take(), None);
        assert_eq!(handle.stop_ordered(), None);
        handle.pause();
        assert!(matches!(handle.take(), Some((_, Order::Pause))));
        handle.stop();
        assert_eq!(handle.stop_ordered(), Some(Order::Stop));
        let script = handle.arrived();
        let given = |polls, order| ScriptedOrder { polls, order };
        assert_eq!(script, [given(2, Order::Pause), given(3, Order::Stop)]);
        let again = Handle::scripted(script);
        assert_eq!(again.take(), None);
        assert_eq!(again.stop_ordered(), None);
        assert!(matches!(again.take(), Some((_, Order::Pause))));
        assert_eq!(again.stop_ordered(), Some(Order::Stop));
    }

    #[test]
    fn closing_answers_everybody() {
        let handle = Handle::new();
        let pause = handle.pause();
        handle.close("the run has ended");
        assert_eq!(
            handle.outcome(pause),
            Some(Err("the run has ended".to_owned()))
        );
        let stop = handle.stop();
        handle.close("the run has ended");
        assert_eq!(handle.outcome(stop), Some(Ok(())));
    }
}
