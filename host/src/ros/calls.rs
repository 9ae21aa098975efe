//! The services, and their requests as orders.

use super::actions::{Actions, GoalId, Kind, accepted};
use super::goals::{Goal, Goals, Verdict, Wish};
use super::pipe::{Call, Outlet, ToNode};
use crate::calibration::check::POSES_MIN;
use crate::control::{Handle, Ticket};
use crate::motion::Task;
use crate::record::cdr::Cdr;
use crate::serve::Feed;
use nalgebra::Vector3;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Duration;

/// How long an order's outcome is waited for. A stop that takes longer remains ordered.
const ANSWER: Duration = Duration::from_secs(2);
/// Orders whose outcome is waited for.
const WAITING: usize = 64;

/// Types of the services, as DDS has them.
const TRIGGER: &str = "std_srvs::srv::dds_::Trigger";
const MOVE_TO: &str = "mcdpr_msgs::srv::dds_::MoveTo";
const RUN_TASK: &str = "mcdpr_msgs::srv::dds_::RunTask";
const CANCEL: &str = "action_msgs::srv::dds_::CancelGoal";

/// A service of the node.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Service {
    Stop,
    Hold,
    Resume,
    Clear,
    MoveTo,
    RunTask,
    /// Of an action: `send_goal`, `cancel_goal`, `get_result`.
    Send(Kind),
    Cancel,
    Result,
}

/// Their names and types; the place here is the number on the lines.
const SERVICES: [(&str, &str, Service); 15] = [
    ("mcdpr/stop", TRIGGER, Service::Stop),
    ("mcdpr/hold", TRIGGER, Service::Hold),
    ("mcdpr/resume", TRIGGER, Service::Resume),
    ("mcdpr/clear", TRIGGER, Service::Clear),
    ("mcdpr/move_to", MOVE_TO, Service::MoveTo),
    ("mcdpr/run_task", RUN_TASK, Service::RunTask),
    (
        "mcdpr/move_to/_action/send_goal",
        "mcdpr_msgs::action::dds_::MoveTo_SendGoal",
        Service::Send(Kind::MoveTo),
    ),
    ("mcdpr/move_to/_action/cancel_goal", CANCEL, Service::Cancel),
    (
        "mcdpr/move_to/_action/get_result",
        "mcdpr_msgs::action::dds_::MoveTo_GetResult",
        Service::Result,
    ),
    (
        "mcdpr/run_task/_action/send_goal",
        "mcdpr_msgs::action::dds_::RunTask_SendGoal",
        Service::Send(Kind::RunTask),
    ),
    (
        "mcdpr/run_task/_action/cancel_goal",
        CANCEL,
        Service::Cancel,
    ),
    (
        "mcdpr/run_task/_action/get_result",
        "mcdpr_msgs::action::dds_::RunTask_GetResult",
        Service::Result,
    ),
    (
        "mcdpr/calibrate/_action/send_goal",
        "mcdpr_msgs::action::dds_::Calibrate_SendGoal",
        Service::Send(Kind::Calibrate),
    ),
    (
        "mcdpr/calibrate/_action/cancel_goal",
        CANCEL,
        Service::Cancel,
    ),
    (
        "mcdpr/calibrate/_action/get_result",
        "mcdpr_msgs::action::dds_::Calibrate_GetResult",
        Service::Result,
    ),
];

/// Poses of a calibration that names no number.
const POSES: u32 = 20;
/// The most poses of a calibration: some ten minutes of motion.
const POSES_MAX: u32 = 200;

/// The lines that make the services.
pub(super) fn greeting() -> impl Iterator<Item = String> {
    let services = SERVICES.iter().enumerate();
    services.map(|(id, (name, kind, _))| ToNode::Service { id, name, kind }.line())
}

/// Passes the requests of services on, and their outcomes back.
pub(crate) struct Desk {
    handle: Handle,
    goals: Goals,
    actions: Actions,
    feed: Feed,
    tasks: Vec<(String, Task)>,
    orders: SyncSender<(Outlet, Call, Ticket)>,
}

impl Desk {
    /// Orders go to `handle`, places and these tasks (by name) to `goals`, what becomes of those that came as actions
    /// to `actions`; viewers see what was asked for.
    ///
    /// # Errors
    /// If the system has no thread for the answers.
    pub(crate) fn new(
        handle: &Handle,
        goals: &Goals,
        actions: &Actions,
        feed: &Feed,
        tasks: Vec<(String, Task)>,
    ) -> std::io::Result<Self> {
        let (orders, asked) = sync_channel(WAITING);
        let answering = handle.clone();
        std::thread::Builder::new()
            .name("answers".to_owned())
            .spawn(move || answer(&answering, &asked))?;
        Ok(Self {
            handle: handle.clone(),
            goals: goals.clone(),
            actions: actions.clone(),
            feed: feed.clone(),
            tasks,
            orders,
        })
    }

    /// Executes a call; the reply follows by itself.
    pub(crate) fn called(&self, outlet: &Outlet, call: Call) {
        let Some((name, _, service)) = SERVICES.get(call.service) else {
            return;
        };
        let ticket = match service {
            Service::Stop => {
                let ticket = self.handle.stop();
                // A goal that still waits must not start after the stop.
                self.goals.refuse("a stop came first");
                ticket
            }
            Service::Hold => self.handle.hold(),
            Service::Resume => self.handle.resume(),
            Service::Clear => self.handle.clear(),
            Service::MoveTo => return self.offer(outlet, call, Self::place),
            Service::RunTask => return self.offer(outlet, call, Self::task),
            Service::Send(kind) => return self.send(outlet, &call, *kind),
            Service::Cancel => return self.cancel(outlet, &call),
            Service::Result => {
                let id = goal_id(&call.data).unwrap_or_default();
                return self.actions.result(&id, outlet, call);
            }
        };
        self.feed.say(&format!("order from ROS: {name}"));
        // Outcomes come in the order of orders; a stop ends the wait for those before it.
        if let Err(full) = self.orders.try_send((outlet.clone(), call, ticket)) {
            let (std::sync::mpsc::TrySendError::Full((outlet, call, _))
            | std::sync::mpsc::TrySendError::Disconnected((outlet, call, _))) = full;
            let reason = format!("{WAITING} orders wait already; this one was given all the same");
            outlet.reply(&call, &triggered(Err(reason)));
        }
    }

    fn offer(
        &self,
        outlet: &Outlet,
        call: Call,
        read: impl FnOnce(&Self, &[u8]) -> Result<Wish, String>,
    ) {
        let wish = read(self, &call.data);
        let (outlet, feed) = (outlet.clone(), self.feed.clone());
        let report = move |verdict: Verdict| {
            match &verdict {
                Ok(seconds) => feed.say(&format!("goal from ROS: {seconds:.1} s")),
                Err(reason) => feed.say(&format!("goal from ROS refused: {reason}")),
            }
            outlet.reply(&call, &judged(&verdict));
        };
        match wish {
            Ok(wish) => self.goals.offer(Goal::new(wish, report)),
            Err(reason) => report(Err(reason)),
        }
    }

    /// A goal of an action: identity, and what a request of the service has.
    fn send(&self, outlet: &Outlet, call: &Call, kind: Kind) {
        let taken = self.taken(&call.data, kind);
        match &taken {
            Ok(()) => self.feed.say("goal from ROS accepted"),
            Err(reason) => self.feed.say(&format!("goal from ROS refused: {reason}")),
        }
        outlet.reply(call, &accepted(taken.is_ok()));
    }

    fn taken(&self, data: &[u8], kind: Kind) -> Result<(), String> {
        let id = goal_id(data).ok_or("the request is shorter than a goal")?;
        let asked = data.get(id.len()..).unwrap_or_default();
        let wish = match kind {
            Kind::MoveTo => self.place(asked)?,
            Kind::RunTask => self.task(asked)?,
            Kind::Calibrate => calibration(asked)?,
        };
        if !self.actions.add(kind, id) {
            return Err("there is a goal of that identity".to_owned());
        }
        let [judging, coming, ending] = [(); 3].map(|()| self.actions.clone());
        let feed = self.feed.clone();
        let report = move |verdict: Verdict| {
            if let Err(reason) = &verdict {
                feed.say(&format!("goal from ROS given up: {reason}"));
            }
            judging.judged(&id, &verdict);
        };
        let goal = Goal::new(wish, report)
            .with_progress(move |now| coming.progress(&id, now))
            .with_end(move |how| ending.ended(&id, how));
        self.goals.try_offer(goal).map_err(|back| {
            self.actions.forget(&id);
            back.1.to_owned()
        })
    }

    /// Stops a goal of an action along its path.
    fn cancel(&self, outlet: &Outlet, call: &Call) {
        let (reply, stops) = match goal_id(&call.data) {
            Some(id) => self.actions.cancel(&id),
            None => return self.feed.say("a request to cancel is too short"),
        };
        if stops {
            self.feed.say("goal from ROS cancelled");
            // Its end is the goal's result.
            let _ = self.handle.stop();
            self.goals.refuse("cancelled");
        }
        outlet.reply(call, &reply);
    }

    /// `MoveTo`: target (m, world), greatest speed (m/s; 0: the robot file's).
    fn place(&self, data: &[u8]) -> Result<Wish, String> {
        let mut read = Reader(data);
        let numbers = [(); 4].map(|()| read.f64());
        let [Some(x), Some(y), Some(z), Some(speed)] = numbers else {
            return Err("the request is shorter than a MoveTo".to_owned());
        };
        let to_m = Vector3::new(x, y, z);
        if !to_m.iter().all(|value| value.is_finite()) {
            return Err(format!("the target ({x}, {y}, {z}) m is not finite"));
        }
        if !(speed.is_finite() && speed >= 0.0) {
            return Err(format!(
                "the speed {speed} m/s is negative or not finite; 0 takes the robot file's limit"
            ));
        }
        let speed_mps = (speed > 0.0).then_some(speed);
        Ok(Wish::Move { to_m, speed_mps })
    }

    /// `RunTask`: the task's name.
    fn task(&self, data: &[u8]) -> Result<Wish, String> {
        let name = Reader(data).text();
        let name = name.ok_or("the request is shorter than a RunTask")?;
        let found = self.tasks.iter().find(|(known, _)| *known == name);
        let known: Vec<_> = self.tasks.iter().map(|(name, _)| name.as_str()).collect();
        let found = found.ok_or_else(|| {
            let known = known.join(", ");
            format!("there is no task {name}; `mcdpr ros --task` offers: {known}")
        });
        Ok(Wish::Task(found?.1.clone()))
    }
}

/// Waits for the outcomes of orders, and replies.
fn answer(handle: &Handle, asked: &Receiver<(Outlet, Call, Ticket)>) {
    while let Ok((outlet, call, ticket)) = asked.recv() {
        let outcome = handle.wait(ticket, ANSWER).unwrap_or_else(|| {
            let seconds = ANSWER.as_secs();
            Err(format!("no answer within {seconds} s; the order waits"))
        });
        outlet.reply(&call, &triggered(outcome));
    }
}

/// `std_srvs/srv/Trigger`, the response.
fn triggered(outcome: Result<(), String>) -> Vec<u8> {
    let said = outcome.as_ref().err().map_or("", String::as_str);
    Cdr::new().u8(outcome.is_ok().into()).text(said).done()
}

/// `MoveTo` and `RunTask`, the response: accepted, message, duration (s).
fn judged(verdict: &Verdict) -> Vec<u8> {
    let said = verdict.as_ref().err().map_or("", String::as_str);
    let seconds = verdict.as_ref().map_or(0.0, |seconds| *seconds);
    let mut out = Cdr::new();
    out.u8(verdict.is_ok().into()).text(said).f64(seconds);
    out.done()
}

/// `Calibrate`: number of poses, home included; 0 takes [`POSES`].
fn calibration(data: &[u8]) -> Result<Wish, String> {
    let poses = Reader(data).u32();
    let poses = match poses.ok_or("the request is shorter than a Calibrate")? {
        0 => POSES,
        poses => poses,
    };
    let few = u32::try_from(POSES_MIN).unwrap_or(u32::MAX);
    if !(few..=POSES_MAX).contains(&poses) {
        return Err(format!(
            "{poses} poses: a calibration takes {few} to {POSES_MAX}, and {POSES} is a good number"
        ));
    }
    let poses = usize::try_from(poses).unwrap_or_default();
    Ok(Wish::Calibrate { poses })
}

/// The identity that a request of an action begins with.
fn goal_id(data: &[u8]) -> Option<GoalId> {
    data.first_chunk().copied()
}

/// Reads plain CDR, little-endian, from its first number on.
struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (now, rest) = self.0.split_first_chunk::<N>()?;
        self.0 = rest;
        Some(*now)
    }

    fn f64(&mut self) -> Option<f64> {
        self.take().map(f64::from_le_bytes)
    }

    fn u32(&mut self) -> Option<u32> {
        self.take().map(u32::from_le_bytes)
    }

    /// A text, without the zero at its end.
    fn text(&mut self) -> Option<&'a str> {
        let count = usize::try_from(self.u32()?).ok()?;
        let bytes = self.0.get(..count)?;
        std::str::from_utf8(bytes.strip_suffix(&[0])?).ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn desk() -> Desk {
        let task = Task::built_in("paper:table8", -0.1).unwrap();
        let tasks = vec![("line".to_owned(), task)];
        let (goals, actions) = (Goals::default(), Actions::default());
        Desk::new(
            &Handle::new(),
            &goals,
            &actions,
            &crate::serve::feed(),
            tasks,
        )
        .unwrap()
    }

    fn numbers(values: [f64; 4]) -> Vec<u8> {
        values
            .iter()
            .flat_map(|value| value.to_le_bytes())
            .collect()
    }

    #[test]
    fn requests_are_read_and_what_is_none_is_refused_in_words() {
        let desk = desk();
        let place = desk.place(&numbers([0.1, 0.2, -0.3, 0.0]));
        assert!(
            matches!(place, Ok(Wish::Move { to_m, speed_mps: None }) if to_m == Vector3::new(0.1, 0.2, -0.3))
        );
        for (wrong, word) in [
            ([f64::NAN, 0.0, 0.0, 0.0], "m is not finite"),
            ([0.0, f64::INFINITY, 0.0, 0.0], "m is not finite"),
            ([0.0, 0.0, 0.0, -1.0], "m/s is negative"),
            ([0.0, 0.0, 0.0, f64::NAN], "or not finite"),
        ] {
            let said = desk.place(&numbers(wrong)).unwrap_err();
            assert!(said.contains(word), "{said}");
        }
        assert!(desk.place(&[0; 31]).unwrap_err().contains("shorter"));
        let named = |text: &str| Cdr::new().text(text).done().split_off(4);
        assert!(matches!(desk.task(&named("line")), Ok(Wish::Task(_))));
        let said = desk.task(&named("/etc/passwd")).unwrap_err();
        assert!(said.contains("offers: line"), "{said}");
        for short in [&[][..], &[9, 0, 0, 0, b'a', 0], &[1, 0, 0, 0, b'a']] {
            assert!(desk.task(short).unwrap_err().contains("shorter"));
        }
    }

    #[test]
    fn a_goal_of_an_action_is_taken_once_and_one_at_a_time() {
        let desk = desk();
        let goal = |id: u8| [vec![id; 16], numbers([0.1, 0.2, -0.3, 0.0])].concat();
        assert_eq!(desk.taken(&goal(1), Kind::MoveTo), Ok(()));
        let again = desk.taken(&goal(1), Kind::MoveTo).unwrap_err();
        assert!(again.contains("of that identity"), "{again}");
        let second = desk.taken(&goal(2), Kind::MoveTo).unwrap_err();
        assert!(second.contains("came first"), "{second}");
        let short = desk.taken(&[3; 20], Kind::MoveTo).unwrap_err();
        assert!(short.contains("shorter"), "{short}");
        // What was refused can be sent again.
        desk.goals.refuse("enough");
        assert_eq!(desk.taken(&goal(2), Kind::MoveTo), Ok(()));
    }

    #[test]
    fn a_calibration_has_enough_poses_and_not_too_many() {
        let poses = |count: u32| match calibration(&count.to_le_bytes()) {
            Ok(Wish::Calibrate { poses }) => Ok(poses),
            Ok(_) => Err("another wish".to_owned()),
            Err(reason) => Err(reason),
        };
        assert_eq!((poses(0), poses(7), poses(200)), (Ok(20), Ok(7), Ok(200)));
        for wrong in [1, 6, 201, u32::MAX] {
            assert!(poses(wrong).unwrap_err().contains("takes 7 to 200"));
        }
        assert!(calibration(&[7, 0, 0]).is_err());
    }

    #[test]
    fn replies_are_those_of_the_message_files() {
        let done = triggered(Ok(()));
        assert_eq!(done, [0, 1, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 0]);
        let refused = judged(&Err("no".to_owned()));
        let wanted = [
            &[0, 1, 0, 0, 0, 0, 0, 0, 3, 0, 0, 0, b'n', b'o', 0, 0][..],
            &[0, 0, 0, 0],
            &0.0_f64.to_le_bytes(),
        ];
        assert_eq!(refused, wanted.concat());
    }
}
