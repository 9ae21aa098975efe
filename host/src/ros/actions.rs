//! Goals as actions of ROS 2: sent, watched, cancelled, and their results.
//!
//! An action is three services and two topics (design.ros2.org, "Actions"; action_msgs of ROS 2 Humble). A goal
//! that can be read is accepted if no other is under way; the planner's refusal is its result, because the reply of
//! `send_goal` has no room for words. To cancel a goal stops it along its path and closes the brakes.

use super::goals::{Ending, Verdict};
use super::pipe::{Call, Outlet};
use crate::record::cdr::Cdr;
use crate::record::ros2::Encoded;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{SystemTime, UNIX_EPOCH};

/// Goals that are remembered after their end, for late requests.
const REMEMBERED: usize = 16;
/// Looks at the robot between two feedbacks: ten a second.
const FEEDBACK_LOOKS: u32 = 5;
/// Bytes of a goal's identity.
const ID: usize = 16;

/// Kind of a goal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    MoveTo,
    RunTask,
    Calibrate,
}

/// The actions, in the order of their topics.
pub(super) const KINDS: [Kind; 3] = [Kind::MoveTo, Kind::RunTask, Kind::Calibrate];

impl Kind {
    /// Name of the action, and of its type.
    pub(super) const fn names(self) -> (&'static str, &'static str) {
        match self {
            Self::MoveTo => ("mcdpr/move_to", "MoveTo"),
            Self::RunTask => ("mcdpr/run_task", "RunTask"),
            Self::Calibrate => ("mcdpr/calibrate", "Calibrate"),
        }
    }
}

/// `action_msgs/msg/GoalStatus`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
enum Status {
    Unknown = 0,
    Accepted = 1,
    Executing = 2,
    Canceling = 3,
    Succeeded = 4,
    Canceled = 5,
    Aborted = 6,
}

/// `action_msgs/srv/CancelGoal`, the return code.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
enum Cancel {
    Done = 0,
    UnknownGoal = 2,
    Terminated = 3,
}

/// A goal's identity, as its client chose it.
pub(super) type GoalId = [u8; ID];

/// A goal, until it is forgotten.
struct Entry {
    kind: Kind,
    id: GoalId,
    time_ns: u64,
    status: Status,
    said: String,
    /// What is done and what is wanted; without it, that of the motion.
    progress: Option<[f64; 2]>,
    /// Clients that wait for the result.
    waiting: Vec<(Outlet, Call)>,
}

impl Entry {
    const fn ended(&self) -> bool {
        !matches!(
            self.status,
            Status::Accepted | Status::Executing | Status::Canceling
        )
    }
}

#[derive(Default)]
struct Book {
    entries: VecDeque<Entry>,
    /// Actions whose list of goals is to be published.
    changed: [bool; KINDS.len()],
    looks: u32,
}

impl Book {
    fn find(&mut self, id: &GoalId) -> Option<&mut Entry> {
        self.entries.iter_mut().find(|entry| entry.id == *id)
    }

    fn note(&mut self, kind: Kind) {
        for (changed, known) in self.changed.iter_mut().zip(KINDS) {
            *changed |= known == kind;
        }
    }
}

/// The goals of all actions. Clones have the same.
#[derive(Clone, Default)]
pub(crate) struct Actions {
    book: Arc<Mutex<Book>>,
}

impl Actions {
    fn lock(&self) -> MutexGuard<'_, Book> {
        self.book.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes note of a goal; false if there is one of that identity.
    pub(super) fn add(&self, kind: Kind, id: GoalId) -> bool {
        let mut book = self.lock();
        if book.find(&id).is_some() {
            return false;
        }
        // Only goals that have ended are forgotten: another must stay possible to cancel.
        while book.entries.len() >= REMEMBERED {
            let Some(old) = book.entries.iter().position(Entry::ended) else {
                break;
            };
            book.entries.remove(old);
        }
        book.entries.push_back(Entry {
            kind,
            id,
            time_ns: now_ns(),
            status: Status::Accepted,
            said: String::new(),
            progress: None,
            waiting: Vec::new(),
        });
        book.note(kind);
        true
    }

    /// A goal that was not accepted leaves no trace.
    pub(super) fn forget(&self, id: &GoalId) {
        self.lock().entries.retain(|entry| entry.id != *id);
    }

    /// The planner's verdict of a goal.
    pub(super) fn judged(&self, id: &GoalId, verdict: &Verdict) {
        match verdict {
            Ok(_) => {
                let mut book = self.lock();
                let Some(entry) = book.find(id) else { return };
                if entry.status == Status::Accepted {
                    entry.status = Status::Executing;
                }
                let kind = entry.kind;
                book.note(kind);
            }
            Err(reason) => self.ended(id, Ending::Failed(reason.clone())),
        }
    }

    /// How far a goal that is no single motion has come: what is done, what is wanted.
    pub(super) fn progress(&self, id: &GoalId, now: [f64; 2]) {
        if let Some(entry) = self.lock().find(id) {
            entry.progress = Some(now);
        }
    }

    /// The end of a goal: waiting clients get its result.
    pub(super) fn ended(&self, id: &GoalId, ending: Ending) {
        let mut book = self.lock();
        let Some(entry) = book.find(id) else { return };
        if entry.ended() {
            return;
        }
        (entry.status, entry.said) = match (ending, entry.status) {
            (Ending::Reached(said), _) => (Status::Succeeded, said),
            (_, Status::Canceling) => (Status::Canceled, "cancelled".to_owned()),
            (Ending::Stopped, _) => (Status::Aborted, "stopped".to_owned()),
            (Ending::Failed(reason), _) => (Status::Aborted, reason),
        };
        let (status, said, kind) = (entry.status, entry.said.clone(), entry.kind);
        let waiting = std::mem::take(&mut entry.waiting);
        book.note(kind);
        // Replies go out without the lock: a slow client must not stop the robot's thread.
        drop(book);
        for (outlet, call) in waiting {
            outlet.reply(&call, &result(status, &said));
        }
    }

    /// Asks for the end of a goal, of whichever moves with an identity of zeros; the reply, and whether there is one
    /// to stop.
    pub(super) fn cancel(&self, id: &GoalId) -> (Vec<u8>, bool) {
        let mut book = self.lock();
        let any = *id == [0; ID];
        let mut found = book.entries.iter_mut();
        let entry = if any {
            found.find(|entry| !entry.ended())
        } else {
            found.find(|entry| entry.id == *id)
        };
        let (code, stopped) = match entry {
            // Nothing was under way: all of it is cancelled.
            None if any => (Cancel::Done, None),
            None => (Cancel::UnknownGoal, None),
            Some(entry) if entry.ended() => (Cancel::Terminated, None),
            Some(entry) => {
                entry.status = Status::Canceling;
                (Cancel::Done, Some((entry.id, entry.time_ns, entry.kind)))
            }
        };
        let mut out = Cdr::new();
        out.u8(code as u8).count(usize::from(stopped.is_some()));
        if let Some((id, time_ns, kind)) = stopped {
            info(&mut out, &id, time_ns);
            book.note(kind);
        }
        (out.done(), stopped.is_some())
    }

    /// Replies with a goal's result, now or at its end.
    pub(super) fn result(&self, id: &GoalId, outlet: &Outlet, call: Call) {
        let mut book = self.lock();
        let reply = match book.find(id) {
            Some(entry) if !entry.ended() => {
                entry.waiting.push((outlet.clone(), call));
                return;
            }
            Some(entry) => result(entry.status, &entry.said),
            None => result(Status::Unknown, "there is no such goal"),
        };
        drop(book);
        outlet.reply(&call, &reply);
    }

    /// What is to be published at a look at the robot, whose motion has come to `path_s` of `duration_s`: the
    /// topic's place among those of the actions, and the message.
    pub(super) fn due(&self, path_s: f64, duration_s: f64) -> Vec<(usize, Encoded)> {
        let mut book = self.lock();
        let mut out = Vec::new();
        let changed = std::mem::take(&mut book.changed);
        for (place, kind) in KINDS.into_iter().enumerate() {
            if changed.get(place) == Some(&true) {
                let of_kind = book.entries.iter().filter(|entry| entry.kind == kind);
                out.push((2 * place + 1, statuses(of_kind)));
            }
        }
        book.looks += 1;
        if book.looks < FEEDBACK_LOOKS {
            return out;
        }
        book.looks = 0;
        let moving = |entry: &&Entry| entry.status == Status::Executing;
        for entry in book.entries.iter().filter(moving) {
            let place = KINDS.iter().position(|kind| *kind == entry.kind);
            let mut message = Cdr::new();
            let [done, wanted] = entry.progress.unwrap_or([path_s, duration_s]);
            identity(&mut message, &entry.id).f64(done).f64(wanted);
            let data = message.done();
            out.extend(place.map(|place| (2 * place, Encoded { kind: "", data })));
        }
        out
    }
}

/// Topics of the actions in the order of their places, with their types and whether late readers get the last one.
pub(super) fn topics() -> impl Iterator<Item = (String, String, bool)> {
    KINDS.into_iter().flat_map(|kind| {
        let (name, of_type) = kind.names();
        let feedback = format!("mcdpr_msgs::action::dds_::{of_type}_FeedbackMessage_");
        let list = "action_msgs::msg::dds_::GoalStatusArray_".to_owned();
        [
            (format!("rt/{name}/_action/feedback"), feedback, false),
            (format!("rt/{name}/_action/status"), list, true),
        ]
    })
}

/// The reply of `send_goal`.
pub(super) fn accepted(yes: bool) -> Vec<u8> {
    let mut out = Cdr::new();
    out.u8(yes.into());
    stamp(&mut out, now_ns()).done()
}

/// `GetResult`, the response: status, and the result's two fields.
fn result(status: Status, said: &str) -> Vec<u8> {
    let mut out = Cdr::new();
    out.u8(status as u8)
        .u8((status == Status::Succeeded).into())
        .text(said);
    out.done()
}

fn statuses<'a>(entries: impl Iterator<Item = &'a Entry>) -> Encoded {
    let entries: Vec<_> = entries.collect();
    let mut out = Cdr::new();
    out.count(entries.len());
    for entry in entries {
        info(&mut out, &entry.id, entry.time_ns).u8(entry.status as u8);
    }
    let data = out.done();
    Encoded { kind: "", data }
}

fn identity<'a>(out: &'a mut Cdr, id: &GoalId) -> &'a mut Cdr {
    for byte in id {
        out.u8(*byte);
    }
    out
}

/// `action_msgs/msg/GoalInfo`.
fn info<'a>(out: &'a mut Cdr, id: &GoalId, time_ns: u64) -> &'a mut Cdr {
    stamp(identity(out, id), time_ns)
}

fn stamp(out: &mut Cdr, time_ns: u64) -> &mut Cdr {
    let seconds = u32::try_from(time_ns / 1_000_000_000).unwrap_or(u32::MAX);
    let rest = u32::try_from(time_ns % 1_000_000_000).unwrap_or(0);
    out.u32(seconds).u32(rest)
}

fn now_ns() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.map_or(0, |since| {
        u64::try_from(since.as_nanos()).unwrap_or(u64::MAX)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const A: GoalId = [1; ID];
    const B: GoalId = [2; ID];

    fn statuses_of(actions: &Actions) -> Vec<u8> {
        let book = actions.lock();
        book.entries
            .iter()
            .map(|entry| entry.status as u8)
            .collect()
    }

    #[test]
    fn a_goal_ends_once_and_a_cancelled_one_as_cancelled() {
        let actions = Actions::default();
        assert!(actions.add(Kind::MoveTo, A));
        assert!(!actions.add(Kind::MoveTo, A), "one goal of an identity");
        actions.judged(&A, &Ok(2.0));
        assert_eq!(statuses_of(&actions), [Status::Executing as u8]);
        actions.ended(&A, Ending::Reached(String::new()));
        actions.ended(&A, Ending::Stopped);
        assert!(actions.add(Kind::RunTask, B));
        let (reply, stops) = actions.cancel(&B);
        assert!(stops);
        assert_eq!(reply[4..12], [0, 0, 0, 0, 1, 0, 0, 0], "no error, one goal");
        assert_eq!(reply[12..28], B);
        actions.ended(&B, Ending::Stopped);
        let ended = [Status::Succeeded as u8, Status::Canceled as u8];
        assert_eq!(statuses_of(&actions), ended);
        assert!(!actions.cancel(&B).1 && !actions.cancel(&[9; ID]).1);
        assert_eq!(actions.cancel(&B).0[4], Cancel::Terminated as u8);
        assert_eq!(actions.cancel(&[9; ID]).0[4], Cancel::UnknownGoal as u8);
    }

    #[test]
    fn lists_come_once_for_a_change_and_feedback_ten_times_a_second() {
        let actions = Actions::default();
        actions.add(Kind::RunTask, A);
        actions.judged(&A, &Ok(2.0));
        let places = |out: Vec<(usize, Encoded)>| -> Vec<usize> {
            out.into_iter().map(|(place, _)| place).collect()
        };
        assert_eq!(places(actions.due(0.0, 2.0)), [3]);
        let later: Vec<_> = (0..5).flat_map(|_| actions.due(0.1, 2.0)).collect();
        assert_eq!(later.len(), 1);
        let (place, feedback) = &later[0];
        assert_eq!(*place, 2);
        assert_eq!(feedback.data[4..20], A);
        assert_eq!(feedback.data[20..28], 0.1_f64.to_le_bytes());
    }

    #[test]
    fn a_calibration_has_feedback_and_a_result_of_its_own() {
        let actions = Actions::default();
        actions.add(Kind::Calibrate, A);
        actions.judged(&A, &Ok(0.0));
        actions.progress(&A, [3.0, 20.0]);
        let sent: Vec<_> = (0..5).flat_map(|_| actions.due(0.1, 2.0)).collect();
        let (_, feedback) = sent.iter().find(|(place, _)| *place == 4).unwrap();
        assert_eq!(feedback.data[20..28], 3.0_f64.to_le_bytes());
        assert_eq!(feedback.data[28..36], 20.0_f64.to_le_bytes());
        actions.ended(&A, Ending::Reached("0.4 mm".to_owned()));
        assert_eq!(actions.lock().entries[0].said, "0.4 mm");
    }

    #[test]
    fn a_long_day_keeps_the_last_goals_alone() {
        let actions = Actions::default();
        for number in 0..100_u8 {
            assert!(actions.add(Kind::MoveTo, [number; ID]));
            actions.ended(&[number; ID], Ending::Reached(String::new()));
        }
        assert_eq!(actions.lock().entries.len(), REMEMBERED);
    }
}
