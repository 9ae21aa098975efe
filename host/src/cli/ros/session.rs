//! One goal after another on a robot, and the wait for the first.

use super::Node;
use crate::cli::line::{in_words, watched};
use crate::cli::recorded::{About, Recorded};
use crate::cli::{Failed, Outcome};
use crate::control::Order;
use crate::link::{Client, ClientError, Link};
use crate::machine::Mismatch;
use crate::motion::{Plan, Task};
use crate::record::events::{Patience, TruthTap};
use crate::record::{Doing, EventBus, TaskSource};
use crate::ros::{Ending, Goal, Wish};
use crate::run::{
    self, Homing, LengthFiles, Recorder, RunError, Session, interrupted, new_session, plan_from,
    stop_now, stop_wanted,
};
use crate::serve::{CameraWatcher, FeedWatcher};
use mcdpr_protocol::{Request, SessionId};

/// Polling interval of an idle board, µs.
const LOOK_US: u64 = 40_000;
/// Polling interval for a plan's end, µs: a stop is noticed within this time.
const PLAN_LOOK_US: u64 = 4_000;
/// A goal this near is reached, m.
const THERE_M: f64 = 1e-6;
/// While the robot holds, goals are looked for this often, s.
const GOAL_LOOK_S: f64 = 0.02;

/// A goal for an idle robot, and whether its lengths are known.
struct Wanted {
    goal: Goal,
    referenced: bool,
}

impl Node<'_> {
    fn watch(&self, events: &mut EventBus, simulated: bool) -> Outcome {
        let failed = || Failed::from_error("starting a watcher's thread");
        let viewers = FeedWatcher::new(self.feed.clone(), self.model.clone());
        events.add(viewers, Patience::Drop).map_err(failed())?;
        if simulated && self.camera {
            let (robot, seed) = (self.model.robot(), self.common.seed);
            let camera = CameraWatcher::new(self.feed.clone(), robot, seed);
            events.add(camera, Patience::Drop).map_err(failed())?;
        }
        Ok(())
    }

    /// Waits for a goal, and executes it and those that follow it; returns whether the program continues.
    pub(super) fn round<L: Link>(
        &self,
        link: &mut L,
        tap: Option<&TruthTap>,
    ) -> miette::Result<bool> {
        let mut idle = EventBus::default();
        self.watch(&mut idle, tap.is_some())?;
        let wanted = self.wait(watched(&mut *link, &idle, tap));
        idle.finish();
        let Some(Wanted { goal, referenced }) = wanted? else {
            return Ok(false);
        };
        self.feed.clear_trouble();
        let number = new_session();
        // A chip's firmware does not know that its robot is simulated.
        let at_home = tap.is_some() && !referenced;
        let record = tap.is_none() || self.common.record.is_some();
        let recorded = record.then(|| self.record(number, at_home)).transpose()?;
        let (mut events, rest) = match recorded.map(Recorded::split) {
            Some((events, rest)) => (events, Some(rest)),
            None => (EventBus::default(), None),
        };
        self.watch(&mut events, tap.is_some())?;
        let homing = if at_home {
            Homing::Place(self.model.robot().tool.home_in_world_m)
        } else {
            Homing::Known
        };
        let line = watched(&mut *link, &events, tap).with_orders(&self.handle);
        let outcome = match goal.wish {
            Wish::Calibrate { poses } => self.calibrated(line, number, goal, poses),
            _ => self.session(line, number, homing, goal),
        };
        self.goals.done();
        self.feed.set_task("");
        events.finish();
        if let Some(rest) = rest {
            rest.finish();
        }
        match outcome {
            Ok(()) => self.feed.say("brakes closed"),
            Err(RunError::Interrupted) if interrupted() => return Ok(false),
            Err(RunError::Interrupted) => self.feed.say("stopped; brakes closed"),
            // The robot answers, but the request failed.
            Err(error @ RunError::Client(ClientError::Refused { .. })) => {
                self.feed.set_trouble(&in_words(&error));
            }
            Err(error @ RunError::Client(_)) => return Err(error.into()),
            Err(error) => self.feed.set_trouble(&in_words(&error)),
        }
        Ok(true)
    }

    fn record(&self, session: SessionId, at_home: bool) -> Result<Recorded, Failed> {
        let mismatch = Mismatch::realistic();
        let about = About {
            name: "ros",
            task: TaskSource {
                name: "ros".to_owned(),
                text: None,
                tool_z_m: 0.0,
            },
            session,
            mismatch: &mismatch,
            doing: Doing::Orders,
            at_home,
            orders: None,
        };
        Recorded::start(self.common, Some(self.model), about)
    }

    /// Executes a goal and those that follow it while the robot holds. Brakes are closed at the end.
    fn session(
        &self,
        link: impl Link,
        number: SessionId,
        homing: Homing<'_>,
        mut first: Goal,
    ) -> Result<(), RunError> {
        let opened = Session::open(self.model, link, number, &self.handle, homing, &LengthFiles);
        let mut session = match opened {
            Ok(session) => session,
            Err(error) => {
                first.judged(Err(in_words(&error)));
                return Err(error);
            }
        };
        let mut armed = false;
        let mut next = Some(first);
        while let Some(mut goal) = next {
            match self.planned(&mut session, &goal.wish) {
                Ok(None) => {
                    goal.judged(Ok(0.0));
                    goal.ended(Ending::Reached(String::new()));
                }
                Ok(Some(plan)) => {
                    goal.judged(Ok(plan.timed.duration_s()));
                    let moved = moved(&mut session, &plan, &mut armed);
                    goal.ended(match &moved {
                        Ok(()) => Ending::Reached(String::new()),
                        Err(RunError::Interrupted) => Ending::Stopped,
                        Err(error) => Ending::Failed(in_words(error)),
                    });
                    moved?;
                }
                Err(error) => {
                    goal.judged(Err(in_words(&error)));
                    if ends(&error) {
                        return Err(error);
                    }
                }
            }
            // A client may send its next goal as soon as it sees that no task runs.
            self.goals.done();
            self.feed.set_task("");
            if !armed {
                return session.close();
            }
            next = self.held(&mut session)?;
        }
        session.disarm()
    }

    /// Holds under tension until there is another goal, or for as long as the user said. A calibration is left to
    /// the next round.
    fn held<L: Link>(&self, session: &mut Session<'_, L>) -> Result<Option<Goal>, RunError> {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "at most ten minutes, checked"
        )]
        let until_us = session.client().now_us() + (self.hold_s * 1e6) as u64;
        loop {
            session.hold(Some(GOAL_LOOK_S))?;
            let goal = self.goals.take_motion();
            // A calibration begins with closed brakes.
            let over = self.goals.calibration_waits() || session.client().now_us() >= until_us;
            if goal.is_some() || over {
                return Ok(goal);
            }
        }
    }

    /// Plans on another thread while this one keeps the connection alive, and obeys a stop meanwhile. None: the tool
    /// is there already.
    fn planned<L: Link>(
        &self,
        session: &mut Session<'_, L>,
        wish: &Wish,
    ) -> Result<Option<Plan>, RunError> {
        let (model, from_m) = (self.model, session.tool_m());
        let (task, speed_mps) = match wish {
            // A motion without length cannot be planned.
            Wish::Move { to_m, .. } if (to_m - from_m).norm() < THERE_M => return Ok(None),
            Wish::Move { to_m, speed_mps } => (Task::go_to("move", *to_m)?, *speed_mps),
            Wish::Task(task) => (task.clone(), None),
            // It has no plan of its own: `round` and `held` keep it from coming here.
            Wish::Calibrate { .. } => return Ok(None),
        };
        self.feed.set_task(&task.name);
        std::thread::scope(|scope| {
            let worker = scope.spawn(move || plan_from(model, task, &from_m, speed_mps));
            let client = session.client();
            loop {
                if let Some(kind) = stop_wanted(client) {
                    return Err(stop_now(client, kind));
                }
                if worker.is_finished() {
                    break;
                }
                client.pump(client.now_us() + PLAN_LOOK_US)?;
            }
            match worker.join() {
                Ok(plan) => plan.map(Some),
                Err(panic) => std::panic::resume_unwind(panic),
            }
        })
    }

    /// Polls the idle robot until there is a goal; none if the program ends.
    fn wait(&self, link: impl Link) -> Result<Option<Wanted>, RunError> {
        let mut client = Client::connect(link, new_session())?;
        if self.lost.replace(false) {
            self.feed.clear_trouble();
            self.feed.say("the robot answers again");
        }
        let wanted = loop {
            if interrupted() {
                break None;
            }
            while let Some((ticket, order)) = self.handle.take() {
                let outcome = match order {
                    Order::Clear => self.clear(&mut client),
                    // Nothing moves.
                    Order::Stop | Order::Emergency => Ok(Ok(())),
                    other => Ok(Err(format!(
                        "{} is not possible: nothing moves",
                        other.name()
                    ))),
                };
                match outcome {
                    Ok(said) => self.handle.done(ticket, said),
                    Err(error) => {
                        self.handle.done(ticket, Err(error.to_string()));
                        return Err(error.into());
                    }
                }
            }
            // The last motion has been stopped by now; a stop that comes later ends the next one.
            self.handle.start_anew();
            let status = run::status(&mut client)?;
            if let Some(mut goal) = self.goals.take() {
                if status.fault.is_none() {
                    let referenced = status.referenced;
                    break Some(Wanted { goal, referenced });
                }
                self.goals.done();
                let reason = "a fault is latched; remove its cause, then clear it";
                goal.judged(Err(reason.to_owned()));
            }
            let look = client.now_us() + LOOK_US;
            client.pump(look)?;
        };
        client.request(Request::Close)?;
        Ok(wanted)
    }

    /// Acknowledges a fault; a refusal by the board is an answer.
    fn clear<L: Link>(&self, client: &mut Client<L>) -> Result<Result<(), String>, ClientError> {
        match client.request(Request::ClearFault) {
            Ok(_) => {
                self.feed.clear_trouble();
                Ok(Ok(()))
            }
            Err(refused @ ClientError::Refused { .. }) => {
                let reason = refused.to_string();
                self.feed.set_trouble(&reason);
                Ok(Err(reason))
            }
            Err(error) => Err(error),
        }
    }
}

/// Makes a motion; arms before the first one.
fn moved<L: Link>(
    session: &mut Session<'_, L>,
    plan: &Plan,
    armed: &mut bool,
) -> Result<(), RunError> {
    if !*armed {
        session.arm()?;
        *armed = true;
    }
    session.follow(plan, &mut Recorder::default(), |_| {})?;
    Ok(())
}

/// Whether an error while planning ends the session: not where only the goal is wrong.
const fn ends(error: &RunError) -> bool {
    !matches!(error, RunError::Plan(_) | RunError::Task(_))
}
