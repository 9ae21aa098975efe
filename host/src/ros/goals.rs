//! Places and tasks on their way to the thread that moves the robot: one at a time.

use crate::motion::Task;
use nalgebra::Vector3;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// What the robot is to do.
#[derive(Debug, Clone)]
pub(crate) enum Wish {
    /// Take the tool straight to a place.
    Move {
        /// The place, world, m.
        to_m: Vector3<f64>,
        /// Greatest speed, m/s; none: the robot file's limit.
        speed_mps: Option<f64>,
    },
    /// Run a task.
    Task(Task),
}

/// How a goal was judged: how long it takes (s), or why it is refused.
pub(crate) type Verdict = Result<f64, String>;

/// A wish, and whom to tell the verdict.
pub(crate) struct Goal {
    /// What is to be done.
    pub(crate) wish: Wish,
    tell: Box<dyn FnOnce(Verdict) + Send>,
}

impl Goal {
    /// A wish, whose verdict is passed to `tell`.
    pub(super) fn new(wish: Wish, tell: impl FnOnce(Verdict) + Send + 'static) -> Self {
        let tell = Box::new(tell);
        Self { wish, tell }
    }

    /// Tells the verdict.
    pub(crate) fn judged(self, verdict: Verdict) {
        (self.tell)(verdict);
    }
}

#[derive(Default)]
struct Slot {
    waiting: Option<Goal>,
    under_way: bool,
}

/// The goal that waits, if there is one. Clones have the same.
#[derive(Clone, Default)]
pub(crate) struct Goals {
    slot: Arc<Mutex<Slot>>,
}

impl Goals {
    fn lock(&self) -> MutexGuard<'_, Slot> {
        // A panic elsewhere must not make a stop impossible.
        self.slot.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Gives a goal to the thread that moves the robot; refuses it while there is another.
    pub(super) fn offer(&self, goal: Goal) {
        let mut slot = self.lock();
        let reason = if slot.under_way {
            "a motion is under way: stop it first, or wait for its end"
        } else if slot.waiting.is_some() {
            "another goal came first"
        } else {
            slot.waiting = Some(goal);
            return;
        };
        drop(slot);
        goal.judged(Err(reason.to_owned()));
    }

    /// The goal that waits. Others are refused from now on, until [`Self::done`].
    pub(crate) fn take(&self) -> Option<Goal> {
        let mut slot = self.lock();
        let goal = slot.waiting.take();
        slot.under_way |= goal.is_some();
        goal
    }

    /// The goal that was taken is reached, refused or stopped.
    pub(crate) fn done(&self) {
        self.lock().under_way = false;
    }

    /// Refuses the goal that waits.
    pub(crate) fn refuse(&self, reason: &str) {
        let waiting = self.lock().waiting.take();
        if let Some(goal) = waiting {
            goal.judged(Err(reason.to_owned()));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::channel;

    #[test]
    fn there_is_one_goal_at_a_time_and_each_is_judged_once() {
        let (sender, verdicts) = channel();
        let goal = |number: u32| {
            let sender = sender.clone();
            let wish = Wish::Move {
                to_m: Vector3::zeros(),
                speed_mps: None,
            };
            Goal::new(wish, move |verdict| sender.send((number, verdict)).unwrap())
        };
        let goals = Goals::default();
        goals.offer(goal(1));
        goals.offer(goal(2));
        let (number, verdict) = verdicts.try_recv().unwrap();
        assert!(number == 2 && verdict.unwrap_err().contains("came first"));
        let taken = goals.take().unwrap();
        assert!(goals.take().is_none());
        goals.offer(goal(3));
        let (number, verdict) = verdicts.try_recv().unwrap();
        assert!(number == 3 && verdict.unwrap_err().contains("under way"));
        taken.judged(Ok(2.5));
        assert_eq!(verdicts.try_recv().unwrap(), (1, Ok(2.5)));
        goals.done();
        goals.offer(goal(4));
        goals.refuse("a stop came first");
        assert_eq!(
            verdicts.try_recv().unwrap(),
            (4, Err("a stop came first".to_owned()))
        );
        assert!(goals.take().is_none());
    }
}
