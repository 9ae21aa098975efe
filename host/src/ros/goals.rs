//! Places, tasks and calibrations on their way to the thread that moves the robot: one at a time.

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
    /// Calibrate the robot. The robot must be idle, not held under tension.
    Calibrate {
        /// Poses to measure, home included.
        poses: usize,
    },
}

/// How a goal was judged: how long it takes (s), or why it is refused.
pub(crate) type Verdict = Result<f64, String>;

/// How a goal that was accepted ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Ending {
    /// It was done; what there is to say of it.
    Reached(String),
    /// It was stopped.
    Stopped,
    /// Why it could not be made.
    Failed(String),
}

/// Takes what is done and what is wanted.
type Progress = Box<dyn Fn([f64; 2]) + Send>;

/// A wish, with callbacks for its verdict, its progress and its end.
pub(crate) struct Goal {
    /// What is to be done.
    pub(crate) wish: Wish,
    report: Option<Box<dyn FnOnce(Verdict) + Send>>,
    progress: Option<Progress>,
    end: Option<Box<dyn FnOnce(Ending) + Send>>,
}

impl Goal {
    /// A wish, whose verdict is passed to `report`.
    pub(super) fn new(wish: Wish, report: impl FnOnce(Verdict) + Send + 'static) -> Self {
        Self {
            wish,
            report: Some(Box::new(report)),
            progress: None,
            end: None,
        }
    }

    /// Adds a callback for the end.
    pub(super) fn with_end(mut self, end: impl FnOnce(Ending) + Send + 'static) -> Self {
        self.end = Some(Box::new(end));
        self
    }

    /// Adds a callback for the progress of what is no single motion.
    pub(super) fn with_progress(mut self, progress: impl Fn([f64; 2]) + Send + 'static) -> Self {
        self.progress = Some(Box::new(progress));
        self
    }

    /// Reports what is done and what is wanted.
    pub(crate) fn came_to(&self, now: [f64; 2]) {
        if let Some(progress) = &self.progress {
            progress(now);
        }
    }

    /// Reports the verdict. A refused goal has no end of its own.
    pub(crate) fn judged(&mut self, verdict: Verdict) {
        if verdict.is_err() {
            self.end = None;
        }
        if let Some(report) = self.report.take() {
            report(verdict);
        }
    }

    /// Reports the end.
    pub(crate) fn ended(mut self, ending: Ending) {
        if let Some(end) = self.end.take() {
            end(ending);
        }
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
        if let Err(back) = self.try_offer(goal) {
            let (mut goal, reason) = *back;
            goal.judged(Err(reason.to_owned()));
        }
    }

    /// As [`Self::offer`]; a goal that is refused comes back unjudged, with the reason.
    pub(super) fn try_offer(&self, goal: Goal) -> Result<(), Box<(Goal, &'static str)>> {
        let mut slot = self.lock();
        if slot.under_way {
            let reason = "a motion is under way: stop it first, or wait for its end";
            return Err(Box::new((goal, reason)));
        }
        if slot.waiting.is_some() {
            return Err(Box::new((goal, "another goal came first")));
        }
        slot.waiting = Some(goal);
        Ok(())
    }

    /// The goal that waits. Others are refused from now on, until [`Self::done`].
    pub(crate) fn take(&self) -> Option<Goal> {
        let mut slot = self.lock();
        let goal = slot.waiting.take();
        slot.under_way |= goal.is_some();
        goal
    }

    /// As [`Self::take`], if the goal is a motion.
    pub(crate) fn take_motion(&self) -> Option<Goal> {
        if self.calibration_waits() {
            return None;
        }
        self.take()
    }

    /// Whether a calibration waits for an idle robot.
    pub(crate) fn calibration_waits(&self) -> bool {
        let is_calibration = |goal: &Goal| matches!(goal.wish, Wish::Calibrate { .. });
        self.lock().waiting.as_ref().is_some_and(is_calibration)
    }

    /// The goal that was taken is reached, refused or stopped.
    pub(crate) fn done(&self) {
        self.lock().under_way = false;
    }

    /// Refuses the goal that waits.
    pub(crate) fn refuse(&self, reason: &str) {
        let waiting = self.lock().waiting.take();
        if let Some(mut goal) = waiting {
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
        let mut taken = goals.take().unwrap();
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
