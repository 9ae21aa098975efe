//! What the boards say, joined into what one board would say.

use super::{Asked, Boards, Lines};
use crate::link::LinkError;
use mcdpr_protocol::{
    BoardState, FaultRecord, Info, List, Reject, Reply, Request, Status, StopKind, Tick,
};

/// Time between two states that the host is told without asking, µs.
const TELL_US: u64 = 100_000;

/// The state of a robot whose boards have these states: the one that says most about what may still
/// move.
pub(super) fn joint_state(states: impl Iterator<Item = BoardState>) -> BoardState {
    use BoardState::{Arming, Boot, Disarmed, EStop, Fault, Holding, Moving, Pausing, Stopping};
    let weight = |state: BoardState| match state {
        Boot => 0,
        Disarmed => 1,
        Holding => 2,
        Arming => 3,
        Moving => 4,
        Pausing => 5,
        Fault => 6,
        EStop => 7,
        Stopping => 8,
    };
    states
        .max_by_key(|state| weight(*state))
        .unwrap_or_default()
}

impl<L: Lines> Boards<L> {
    /// The answer to a heartbeat; `None` before every board has answered one.
    pub(super) fn beat(&self, host_time_us: u32) -> Option<Reply> {
        let beats: Option<Vec<_>> = self.members.iter().map(|m| m.client.beat()).collect();
        let beats = beats?;
        let first = beats.first()?;
        let state = joint_state(self.members.iter().map(|member| member.state));
        #[expect(
            clippy::cast_precision_loss,
            reason = "hours of microseconds are exact"
        )]
        let now_us = self.lines.now_us() as f64;
        let phase = &self.members.first()?.phase;
        let (then, now) = (phase.count(first.tick)?, phase.count_at(now_us)?);
        let since = (now - then).floor().max(0.0);
        let moves = if first.state == BoardState::Moving {
            since
        } else {
            0.0
        };
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "positive, and saturates"
        )]
        let board_ms = first.path_ms + moves as u32;
        let ended = first.next_knot == 0 && first.state == BoardState::Holding;
        let path_ms = match &self.course {
            // The first board is at the end, another not yet.
            Some(course) if ended && state != BoardState::Holding => course.last_ms(),
            _ => self.robot_ms(board_ms),
        };
        let (knots_free, next_knot) = self.buffered();
        Some(Reply::Beat {
            host_time_us,
            tick: Tick(phase.number(then + since)),
            state,
            path_ms,
            knots_free,
            next_knot,
        })
    }

    /// Free knots of the fullest board, and the robot's knot that comes next.
    fn buffered(&self) -> (u8, u16) {
        let ahead = u16::try_from(self.ahead.len()).unwrap_or(u16::MAX);
        if self.course.is_none() {
            let free = u16::from(self.capacity()).saturating_sub(ahead);
            return (u8::try_from(free).unwrap_or(u8::MAX), ahead);
        }
        let beats = || self.members.iter().filter_map(|m| m.client.beat());
        let free = beats().map(|beat| beat.knots_free).min().unwrap_or(0);
        let next = beats().map(|beat| (beat.state, beat.next_knot));
        (free, robots_next(next))
    }

    /// The state of all boards as that of one.
    fn joint_status(&self, parts: &[&Status]) -> Status {
        let layout = &self.layout;
        let Some(first) = parts.first() else {
            return Status::default();
        };
        let slices = |of: fn(&Status) -> &[mcdpr_protocol::TenthMicrometres]| {
            let all: Vec<_> = parts.iter().map(|part| of(part)).collect();
            layout.whole(&all)
        };
        let tensions: Vec<&[_]> = parts.iter().map(|part| &part.tensions[..]).collect();
        let own = parts.iter().zip(&self.parts);
        let configured = own
            .clone()
            .all(|(part, (_, hash))| part.config == Some(*hash));
        let (knots_free, next_knot) = self.buffered();
        let sum = |of: fn(&Status) -> u32| parts.iter().map(|part| of(part)).sum();
        let mut limits = first.limits;
        for part in parts {
            limits.0 |= part.limits.0;
        }
        Status {
            tick: first.tick,
            state: joint_state(parts.iter().map(|part| part.state)),
            path_ms: self.robot_ms(first.path_ms),
            setpoints: slices(|part| &part.setpoints),
            lengths: slices(|part| &part.lengths),
            tensions: layout.whole(&tensions),
            knots_free,
            next_knot,
            fault: self.joint_fault(parts),
            limits,
            config: configured.then_some(self.whole.1),
            referenced: parts.iter().all(|part| part.referenced),
            brakes_open: layout.whole_bits(parts.iter().map(|part| part.brakes_open)),
            torque_on: layout.whole_bits(parts.iter().map(|part| part.torque_on)),
            gripper_closed: first.gripper_closed,
            gripper_switch: first.gripper_switch,
            frames_ok: sum(|part| part.frames_ok),
            frames_bad: sum(|part| part.frames_bad),
            sequence_errors: sum(|part| part.sequence_errors),
            tick_overruns: sum(|part| part.tick_overruns),
            telemetry_dropped: sum(|part| part.telemetry_dropped),
        }
    }

    /// The fault that came first.
    fn joint_fault(&self, parts: &[&Status]) -> Option<FaultRecord> {
        let of = |board: usize| {
            let record = parts.get(board)?.fault?;
            Some(self.layout.fault(board, record))
        };
        let first = self.culprit.and_then(of);
        let all = (0..parts.len()).filter_map(of);
        first.or_else(|| all.min_by_key(super::fault_line::follows))
    }

    /// Answers the requests besides the sequence that every board has answered.
    pub(super) fn settle_asked(&mut self) -> Result<(), LinkError> {
        let waits = self.seeks_cause();
        while let Some(place) = self.asked.iter().position(|asked| {
            let answered = asked.replies.iter().all(Option::is_some);
            answered && !(waits && asked.request == Request::Status)
        }) {
            let Asked {
                sequence,
                request,
                replies,
            } = self.asked.remove(place);
            let replies: Vec<_> = replies.into_iter().flatten().collect();
            let result = self.joint_reply(&request, &replies)?;
            self.answer(sequence, result);
        }
        Ok(())
    }

    fn joint_reply(
        &mut self,
        request: &Request,
        replies: &[Result<Reply, Reject>],
    ) -> Result<Result<Reply, Reject>, LinkError> {
        let refusal = replies.iter().enumerate().find_map(|(board, reply)| {
            let reject = reply.as_ref().err()?;
            Some(self.layout.reject(board, *reject))
        });
        if *request == Request::Open {
            return Ok(self.opened(replies, refusal));
        }
        if let Some(reject) = refusal {
            return Ok(Err(reject));
        }
        match request {
            Request::Info => self.joint_info(replies).map(Ok),
            Request::Status => {
                let parts = replies.iter().filter_map(|reply| match reply {
                    Ok(Reply::Status(status)) => Some(status),
                    _ => None,
                });
                let parts: Vec<&Status> = parts.collect();
                let configs: Vec<_> = parts.iter().map(|part| part.config).collect();
                self.check_configs(&configs)?;
                if parts.iter().all(|part| part.fault.is_none()) {
                    self.culprit = None;
                }
                Ok(Ok(Reply::Status(self.joint_status(&parts))))
            }
            // After a reset of one board the others still know their lengths: their joint state is not defined.
            Request::Kept => Ok(Ok(Reply::Kept(mcdpr_protocol::Kept::default()))),
            _ => {
                let winch = |reply: &&Result<Reply, Reject>| matches!(reply, Ok(Reply::Winch(_)));
                let reply = replies.iter().find(winch).and_then(|r| r.clone().ok());
                Ok(Ok(reply.unwrap_or(Reply::Done)))
            }
        }
    }

    /// All boards are claimed, or none.
    fn opened(
        &mut self,
        replies: &[Result<Reply, Reject>],
        refusal: Option<Reject>,
    ) -> Result<Reply, Reject> {
        let now_us = self.lines.now_us();
        for (member, reply) in self.members.iter_mut().zip(replies) {
            match (&refusal, reply) {
                (None, _) => {
                    member.client.claimed();
                    member.client.spread_heartbeats();
                    member.state_us = now_us;
                }
                (Some(_), Ok(_)) => member.todo.push_back(super::Errand {
                    request: Request::Close,
                    of: None,
                }),
                (Some(_), Err(_)) => {}
            }
        }
        refusal.map_or(Ok(Reply::Done), Err)
    }

    fn joint_info(&mut self, replies: &[Result<Reply, Reject>]) -> Result<Reply, LinkError> {
        let infos = replies.iter().filter_map(|reply| match reply {
            Ok(Reply::Info(info)) => Some(info.clone()),
            _ => None,
        });
        let infos: Vec<Info> = infos.collect();
        for (board, info) in infos.iter().enumerate() {
            let wanted = self.layout.of_board(board).len();
            if usize::from(info.cables) != wanted {
                return Err(LinkError::Boards {
                    what: format!(
                        "{} drives {} winches, the robot file has {wanted} cables on it",
                        self.name(board),
                        info.cables
                    ),
                    help: "correct `board` and `channel` of [[cable]]; nothing was moved".into(),
                });
            }
        }
        for (member, info) in self.members.iter_mut().zip(&infos) {
            member.client.set_info(info.clone());
        }
        let least = |of: fn(&Info) -> u8| infos.iter().map(of).min().unwrap_or(0);
        Ok(Reply::Info(Info {
            cables: u8::try_from(self.layout.cables()).unwrap_or(0),
            knot_capacity: super::motion::capacity(least(|info| info.knot_capacity)),
            ticks_per_second: infos.first().map_or(1000, |info| info.ticks_per_second),
            drive_kinds: infos
                .iter()
                .fold(u8::MAX, |all, info| all & info.drive_kinds),
            simulated: infos.iter().all(|info| info.simulated),
            last_panic: infos
                .iter()
                .map(|info| info.last_panic.clone())
                .find(|text| !text.is_empty())
                .unwrap_or_else(List::new),
        }))
    }

    /// Answers sequenced requests in their order, as far as every board has done them.
    pub(super) fn settle_waiting(&mut self, now_us: u64) {
        while let Some(first) = self.waiting.front() {
            let synced = self.course.as_ref().is_some_and(super::Course::is_synced);
            let begun = !first.start || (synced && self.ahead.is_empty()) || first.result.is_err();
            if first.left > 0 || !begun {
                return;
            }
            let Some(first) = self.waiting.pop_front() else {
                return;
            };
            if first.changes {
                self.since_us = now_us;
            }
            if first.result.is_err() && first.changes {
                // All or none: what some boards began, all end.
                let kind = if first.start {
                    self.ahead.clear();
                    StopKind::Hold
                } else {
                    StopKind::Stop
                };
                for member in &mut self.members {
                    // A line that is gone is noticed by its heartbeats.
                    let _ = member.client.post(Request::Stop(kind));
                }
            }
            self.answer(first.sequence, first.result);
        }
    }

    /// Tells the host what it did not ask for: samples, and the state ten times a second and when
    /// it changes.
    pub(super) fn tell(&mut self, now_us: u64) {
        let phases: Vec<_> = self.members.iter().map(|m| m.phase.clone()).collect();
        let lead_ms = self.course.as_ref().map_or(0, |_| super::course::LEAD_MS);
        for block in self.merger.joined(&self.layout, &phases, lead_ms) {
            let mut frame = [0; mcdpr_protocol::frame::MAX_FRAME];
            let used = block.encode(&mut frame).unwrap_or(0);
            self.out.extend(frame.iter().take(used));
        }
        let parts: Option<Vec<&Status>> = self.members.iter().map(|m| m.client.status()).collect();
        let tells = |parts: &Vec<&Status>| !(parts.is_empty() || self.seeks_cause());
        let Some(parts) = parts.filter(tells) else {
            return;
        };
        let state = joint_state(parts.iter().map(|part| part.state));
        let fault = self.joint_fault(&parts);
        let due = self.told.is_none_or(|(told, before, at_us)| {
            (told, before) != (state, fault) || now_us >= at_us + TELL_US
        });
        if due {
            let status = self.joint_status(&parts);
            self.told = Some((state, fault, now_us));
            self.tell_status(&status);
        }
        // All have reached the end.
        let ended = self.members.iter().all(|member| {
            let beat = member.client.beat();
            beat.is_some_and(|b| {
                b.sent_us >= self.since_us && b.state == BoardState::Holding && b.next_knot == 0
            })
        });
        let starting = self.waiting.iter().any(|waiting| waiting.start);
        if ended && !starting && self.course.is_some() {
            self.course = None;
        }
    }
}

/// The robot's knot that comes next, from the states of its boards and their next knots: that of the board that is
/// furthest behind. 0 where all have ended.
fn robots_next(boards: impl Iterator<Item = (BoardState, u16)>) -> u16 {
    // A board that has ended its motion waits for knot 0. One that moves waits for it again after 65 536 knots.
    let moves = |state: BoardState| matches!(state, BoardState::Moving | BoardState::Pausing);
    let under_way = boards.filter(|(state, next)| *next != 0 || moves(*state));
    let next = under_way.map(|(_, next)| next).reduce(|a, b| {
        if a.wrapping_sub(b).cast_signed() < 0 {
            a
        } else {
            b
        }
    });
    // The first two knots of a board are its rest.
    next.map_or(0, |next| next.wrapping_sub(2))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_board_that_is_behind_says_which_knot_is_next_also_when_their_numbers_begin_again() {
        use BoardState::{Holding, Moving, Stopping};
        for (boards, next) in [
            ([(Moving, 7), (Moving, 5)], 3),
            ([(Moving, 65_535), (Moving, 1)], 65_533),
            ([(Moving, 65_535), (Moving, 0)], 65_533),
            // Both wait for their knot number 65 536: they have not ended.
            ([(Moving, 0), (Moving, 0)], 65_534),
            ([(Moving, 2), (Moving, 4)], 0),
            ([(Holding, 0), (Moving, 9)], 7),
            ([(Holding, 0), (Holding, 0)], 0),
            ([(Stopping, 0), (Moving, 9)], 7),
        ] {
            assert_eq!(robots_next(boards.into_iter()), next, "{boards:?}");
        }
    }
}
