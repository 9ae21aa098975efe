//! Knots and starts: one motion becomes one on each board.

use super::course::{Course, LEAD_MS};
use super::{Boards, Errand, Lines};
use crate::link::client::Beat;
use mcdpr_protocol::{BoardState, Knot, Reject, Reply, Request};

/// Knots of the robot that fit into every board's buffer: two are the rest at the start.
pub(super) fn capacity(board: u8) -> u8 {
    board.saturating_sub(2)
}

/// What a request becomes: its outcome so far, and what boards are asked.
type Parts = (Result<Reply, Reject>, Vec<(usize, Request)>);

impl<L: Lines> Boards<L> {
    /// Knots that fit into the buffers of all boards.
    pub(super) fn capacity(&self) -> u8 {
        let boards = self.members.iter().map(|m| m.client.info().knot_capacity);
        capacity(boards.min().unwrap_or(0))
    }

    pub(super) fn knot(&mut self, knot: &Knot) -> Parts {
        if let Some(course) = &mut self.course
            && course.is_synced()
        {
            let phases: Vec<_> = self.members.iter().map(|m| m.phase.clone()).collect();
            let Some(parts) = course.next(&self.layout, &phases, knot) else {
                return (Err(Reject::Unsupported), Vec::new());
            };
            let each = parts.into_iter().map(Request::Knot).enumerate();
            return (Ok(Reply::Queued { free: 0 }), each.collect());
        }
        let has = self.ahead.len();
        let expected = u16::try_from(has).unwrap_or(u16::MAX);
        let free = usize::from(self.capacity()).saturating_sub(has);
        if knot.index != expected {
            return (Err(Reject::KnotIndex { expected }), Vec::new());
        }
        if free == 0 {
            return (Err(Reject::BufferFull), Vec::new());
        }
        self.ahead.push_back(knot.clone());
        let free = u8::try_from(free - 1).unwrap_or(u8::MAX);
        (Ok(Reply::Queued { free }), Vec::new())
    }

    pub(super) fn start(&mut self) -> Parts {
        let Some(first) = self.ahead.front().filter(|_| self.ahead.len() > 1) else {
            return (Err(Reject::NothingToStart), Vec::new());
        };
        let course = Course::new(self.members.len(), first);
        let mut errands = Vec::new();
        for board in 0..self.members.len() {
            let knots = course.rest(&self.layout, board);
            errands.extend(knots.into_iter().map(|knot| (board, Request::Knot(knot))));
            errands.push((board, Request::Start));
        }
        self.course = Some(course);
        self.lines.path_begins(LEAD_MS);
        (Ok(Reply::Done), errands)
    }

    /// An answer to a heartbeat shows how far a board's path is.
    pub(super) fn see_motion(&mut self, board: usize, beat: &Beat) {
        let since_us = self.since_us;
        let (Some(course), Some(member)) = (&mut self.course, self.members.get(board)) else {
            return;
        };
        if beat.state == BoardState::Moving
            && beat.sent_us >= since_us
            && let Some(count) = member.phase.count(beat.tick)
        {
            course.seen(board, count, beat.path_ms);
        }
    }

    /// Once every board's start is known, the knots that waited for it follow.
    pub(super) fn go_on(&mut self) {
        let synced = self.course.as_ref().is_some_and(Course::is_synced);
        if !synced || self.ahead.is_empty() {
            return;
        }
        let Some(place) = self.waiting.iter().position(|waiting| waiting.start) else {
            return;
        };
        let phases: Vec<_> = self.members.iter().map(|m| m.phase.clone()).collect();
        for knot in std::mem::take(&mut self.ahead) {
            let course = self.course.as_mut();
            let parts = course.and_then(|course| course.next(&self.layout, &phases, &knot));
            let Some(waiting) = self.waiting.get_mut(place) else {
                return;
            };
            for (member, part) in self.members.iter_mut().zip(parts.into_iter().flatten()) {
                waiting.left += 1;
                let of = Some(waiting.sequence);
                let request = Request::Knot(part);
                member.todo.push_back(Errand { request, of });
            }
        }
    }

    /// Path time of the robot at a board's path time, ms.
    pub(super) fn robot_ms(&self, path_ms: u32) -> u32 {
        match self.course {
            Some(_) => path_ms.saturating_sub(LEAD_MS),
            None => path_ms,
        }
    }
}
