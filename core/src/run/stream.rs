//! Feeding a motion to the board: buffer first, start, keep the buffer full, wait for the end.

use super::{Recorder, RunError, orders, stop_now};
use crate::link::{Client, ClientError, Event, Link};
use crate::motion::{Action, Plan, TimedAction};
use mcdpr_protocol::{BoardState, Knot, Reject, Request, StopKind};

/// Progress of a motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Progress {
    /// Path time reached, s.
    pub path_s: f64,
    /// The whole motion, s.
    pub duration_s: f64,
}

/// Streams the knots of one motion and returns when the robot holds at its end. The board's samples
/// go to `recorder`; `progress` is called about ten times a second.
///
/// # Errors
/// [`RunError::Fault`] if the board stopped by itself (it holds, or its brakes are closed),
/// [`RunError::Interrupted`] after a stop by the user, or the client's errors. If the board refuses
/// a knot, the motion is stopped first.
pub fn follow<L: Link>(
    client: &mut Client<L>,
    knots: &[Knot],
    recorder: &mut Recorder,
    progress: impl FnMut(Progress),
) -> Result<(), RunError> {
    feed(client, knots, &[], recorder, progress, |_| None)?;
    Ok(())
}

/// Why a motion should end early, and how.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Halt {
    /// [`StopKind::Hold`]: the robot holds under tension, and the rest of its motion is discarded.
    /// Any other: its brakes close.
    pub kind: StopKind,
    /// The reason in words.
    pub reason: String,
}

/// As [`follow`], until `watch` finds a reason in the samples so far: then the robot comes to rest
/// along its path, and the reason is returned.
///
/// # Errors
/// As [`follow`], and [`RunError::NoChange`] if it does not stop.
pub fn follow_watched<L: Link>(
    client: &mut Client<L>,
    knots: &[Knot],
    recorder: &mut Recorder,
    watch: impl FnMut(&Recorder) -> Option<Halt>,
) -> Result<Option<Halt>, RunError> {
    feed(client, knots, &[], recorder, |_| {}, watch)
}

/// As [`follow`], for a plan: its actions are executed when the path time reaches them. `knots` are
/// the plan's, joined to the robot's position.
///
/// # Errors
/// As [`follow`].
pub(crate) fn follow_plan<L: Link>(
    client: &mut Client<L>,
    plan: &Plan,
    knots: &[Knot],
    recorder: &mut Recorder,
    progress: impl FnMut(Progress),
) -> Result<(), RunError> {
    let actions = plan.timed.actions();
    feed(client, knots, actions, recorder, progress, |_| None)?;
    Ok(())
}

/// Returns the reason for which `watch` stopped it, if it did.
fn feed<L: Link>(
    client: &mut Client<L>,
    knots: &[Knot],
    actions: &[TimedAction],
    recorder: &mut Recorder,
    mut progress: impl FnMut(Progress),
    mut watch: impl FnMut(&Recorder) -> Option<Halt>,
) -> Result<Option<Halt>, RunError> {
    let mut actions = actions.iter().peekable();
    let duration_s = knots.last().map_or(0.0, |knot| knot.time_s());
    let capacity = usize::from(client.info().knot_capacity);
    let mut feeder = Feeder { knots, next: 0 };
    // A full buffer before the clock starts: the first stall of the line meets the largest reserve.
    feeder.fill(client, capacity)?;
    drain(client)?;
    client.request(Request::Start)?;
    client.handle().publish(|view| {
        view.duration_s = duration_s;
        view.paused = false;
    });
    let started_us = client.now_us();
    let (mut reported_us, mut asked_us) = (0, started_us);
    loop {
        client.step()?;
        if let Some(kind) = orders::stop_wanted(client) {
            return Err(stop_now(client, kind));
        }
        orders::obey_in_motion(client)?;
        // The refused knot is missing in the path: stop before the buffer comes to the gap.
        if let Err(error) = settle(client) {
            client.stop(StopKind::Stop)?;
            // A board that stopped by itself refuses requests in progress: the fault is the reason. It
            // may get its name while the board stops (C3).
            return Err(
                match super::wait_for(client, BoardState::Disarmed, super::PARKS_S) {
                    Err(fault @ RunError::Fault { .. }) => fault,
                    _ => error,
                },
            );
        }
        take_events(client, recorder, duration_s);
        if let Some(halt) = watch(recorder) {
            client.stop(halt.kind)?;
            if halt.kind == StopKind::Hold {
                super::wait_for(client, BoardState::Holding, 3.0)?;
                drain(client)?;
                // The board would otherwise continue the rest of the motion on the next resume.
                client.request(Request::Discard)?;
            } else {
                super::wait_for(client, BoardState::Disarmed, super::PARKS_S)?;
            }
            return Ok(Some(halt));
        }
        // An answer to a heartbeat from before the start says nothing about this motion.
        let Some(beat) = client.beat().filter(|beat| beat.sent_us >= started_us) else {
            continue;
        };
        let path_s = client.path_s().unwrap_or(0.0);
        while let Some(due) = actions.next_if(|timed| timed.time_s <= path_s) {
            act(client, due.action)?;
        }
        if beat.state == BoardState::Moving {
            if let Some(until_s) = feeder.confirmed_s(beat.next_knot) {
                recorder.buffered(until_s - path_s);
            }
            let sent_since = feeder.since(beat.next_knot);
            // The free room is that of the last beat: knots sent since then have taken part of it.
            let credit = usize::from(beat.knots_free).saturating_sub(sent_since);
            feeder.feed(client, credit)?;
        } else if let Some(fault) = client.status().and_then(|status| status.fault) {
            return Err(RunError::Fault {
                record: fault,
                why: None,
            });
        } else if beat.state == BoardState::Holding
            && feeder.next == knots.len()
            && beat.next_knot == 0
            && !client.handle().view().paused
        {
            // The end of a motion is also a time: actions at the end are executed.
            for timed in actions {
                act(client, timed.action)?;
            }
            progress(Progress {
                path_s: duration_s,
                duration_s,
            });
            return Ok(None);
        } else if client.now_us() >= asked_us + 100_000 {
            // Unsolicited messages of the board may be lost on a bad line: ask until the reason for
            // the standstill is known.
            asked_us = client.now_us();
            let status = super::status(client)?;
            if let Some(record) = status.fault {
                return Err(RunError::Fault { record, why: None });
            }
            let may_go_on = matches!(
                status.state,
                BoardState::Moving
                    | BoardState::Pausing
                    | BoardState::Holding
                    // A fault may get its name during the stop (C3).
                    | BoardState::Stopping
            );
            if !may_go_on {
                // Another program stopped it.
                return Err(RunError::Interrupted);
            }
        }
        let now = client.now_us();
        if now >= reported_us + 100_000 {
            reported_us = now;
            progress(Progress {
                path_s: f64::from(beat.path_ms) * 1e-3,
                duration_s,
            });
        }
    }
}

struct Feeder<'a> {
    knots: &'a [Knot],
    next: usize,
}

/// Executes a plan's actions besides moving.
fn act<L: Link>(client: &mut Client<L>, action: Action) -> Result<(), RunError> {
    match action {
        Action::Gripper { closed } => client.request(Request::Gripper { closed })?,
    };
    Ok(())
}

impl Feeder<'_> {
    /// Knots that were sent after the one that the board waits for; their numbers wrap.
    fn since(&self, waits_for: u16) -> usize {
        let next = self.next & usize::from(u16::MAX);
        let next = u16::try_from(next).unwrap_or(0);
        usize::from(next.wrapping_sub(waits_for))
    }

    /// Path time of the last knot that the board has confirmed, s; `None` if it has all.
    fn confirmed_s(&self, waits_for: u16) -> Option<f64> {
        let has = self.next.saturating_sub(self.since(waits_for));
        self.knots.get(has)?;
        let last = self.knots.get(has.checked_sub(1)?)?;
        Some(last.time_s())
    }

    /// Sends at most `credit` knots, as many as the window takes.
    fn feed<L: Link>(&mut self, client: &mut Client<L>, credit: usize) -> Result<(), ClientError> {
        for _ in 0..credit {
            let Some(knot) = self.knots.get(self.next) else {
                return Ok(());
            };
            if !client.has_room() {
                return Ok(());
            }
            client.enqueue(Request::Knot(knot.clone()))?;
            self.next += 1;
        }
        Ok(())
    }

    /// Fills the board's buffer before the start.
    fn fill<L: Link>(&mut self, client: &mut Client<L>, capacity: usize) -> Result<(), RunError> {
        while self.next < self.knots.len().min(capacity) {
            self.feed(client, capacity - self.next)?;
            client.step()?;
            settle(client)?;
        }
        while client.in_flight() > 0 {
            client.step()?;
            settle(client)?;
        }
        Ok(())
    }
}

/// Looks at the outcomes so far.
fn settle<L: Link>(client: &mut Client<L>) -> Result<(), RunError> {
    while let Some((request, result)) = client.next_outcome() {
        if let Err(reject) = result {
            let name = match &request {
                Request::Knot(knot) => format!("knot {} of the motion", knot.index),
                other => format!("{other:?}"),
            };
            if let Reject::Faulted { record } = reject {
                return Err(RunError::Fault { record, why: None });
            }
            return Err(ClientError::Refused {
                request: name,
                reject,
            }
            .into());
        }
    }
    Ok(())
}

/// Discards what the board sent before the motion.
fn drain<L: Link>(client: &mut Client<L>) -> Result<(), RunError> {
    while client.next_event().is_some() {}
    settle(client)
}

fn take_events<L: Link>(client: &mut Client<L>, recorder: &mut Recorder, duration_s: f64) {
    while let Some(event) = client.next_event() {
        if let Event::Samples(block) = event {
            recorder.take(&block, duration_s);
        }
    }
}
