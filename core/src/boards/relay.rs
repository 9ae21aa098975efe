//! One board stops: all do.

use super::{Boards, Lines, Member};
use crate::link::{ClientError, LinkError};
use mcdpr_protocol::{BoardState, Request, StopKind};

/// A board that has not answered for this long is lost, µs: as long as a board waits for its host,
/// so that both sides of a broken line hold at the same time.
const SILENT_US: u64 = 100_000;
/// A loop that has not run for this long was suspended, µs: heartbeats make it run every 9 ms.
const PAUSED_US: u64 = 30_000;
/// Time after which a stop is passed on again to a board that has not obeyed, µs.
const AGAIN_US: u64 = 50_000;
/// Time for the other boards to confirm that they hold after one is lost, µs.
const CONFIRM_US: u64 = 60_000;
/// After a start or a hold the path clocks take this long to run evenly, µs.
const EVEN_US: u64 = 800_000;
/// Boards whose paths are this far apart are stopped, ms of path time: a motor at its limit slows
/// the clock of its own board only.
const APART_MS: f64 = 15.0;

/// Whether drives of a board in this state may give torque.
const fn works(state: BoardState) -> bool {
    use BoardState::{Arming, Holding, Moving, Pausing, Stopping};
    matches!(state, Arming | Holding | Moving | Pausing | Stopping)
}

impl Member {
    /// Whether it holds with a fault: a brake does not hold its load.
    fn holds_a_fault(&self) -> bool {
        let fault = self
            .client
            .status()
            .is_some_and(|status| status.fault.is_some());
        self.state == BoardState::Holding && fault
    }
}

impl<L: Lines> Boards<L> {
    /// When a silent board would be noticed, µs.
    pub(super) fn watch_due_us(&self) -> u64 {
        let armed = self.members.iter().filter(|member| works(member.state));
        let due = armed.map(|member| member.client.heard_us().max(self.awake_us) + SILENT_US + 1);
        due.min().unwrap_or(u64::MAX)
    }

    /// Passes a stop of one board on to the others, and notices a silent board.
    pub(super) fn watch(&mut self, now_us: u64) -> Result<(), LinkError> {
        // A pause of this program itself is no silence of a board.
        if now_us >= self.watched_us + PAUSED_US {
            self.awake_us = now_us;
        }
        self.watched_us = now_us;
        let awake_us = self.awake_us;
        let silent = self.members.iter().position(|member| {
            works(member.state) && now_us > member.client.heard_us().max(awake_us) + SILENT_US
        });
        if let Some(board) = silent {
            let error = ClientError::Lost {
                waiting: "heartbeat".into(),
            };
            return Err(self.give_up(board, &error));
        }
        // While boards obey an order one after the other, they differ.
        let changing = self.waiting.iter().any(|waiting| waiting.changes);
        if changing || self.members.iter().any(|m| m.state_us < self.since_us) {
            return Ok(());
        }
        use BoardState::{Arming, Disarmed, EStop, Fault, Holding, Moving, Pausing, Stopping};
        let any = |states: &[BoardState]| self.members.iter().any(|m| states.contains(&m.state));
        let (kind, to): (StopKind, &[BoardState]) = if any(&[EStop]) {
            (
                StopKind::Emergency,
                &[Arming, Holding, Moving, Pausing, Stopping],
            )
        } else if any(&[Stopping, Fault, Disarmed]) {
            (StopKind::Stop, &[Arming, Holding, Moving, Pausing])
        } else if any(&[Pausing]) {
            (StopKind::Hold, &[Moving])
        } else if self.is_apart(now_us) {
            (StopKind::Stop, &[Moving])
        } else {
            return Ok(());
        };
        let again = |(before, at_us)| before != kind || now_us >= at_us + AGAIN_US;
        if !self.relayed.is_none_or(again) {
            return Ok(());
        }
        for member in &mut self.members {
            if to.contains(&member.state) && !member.holds_a_fault() {
                self.relayed = Some((kind, now_us));
                member
                    .client
                    .post(Request::Stop(kind))
                    .map_err(|error| super::lost(&error))?;
            }
        }
        Ok(())
    }

    fn is_apart(&self, now_us: u64) -> bool {
        let Some(course) = &self.course else {
            return false;
        };
        let moves = |member: &Member| member.state == BoardState::Moving;
        if now_us < self.since_us + EVEN_US || !self.members.iter().all(moves) {
            return false;
        }
        let phases: Vec<_> = self.members.iter().map(|m| m.phase.clone()).collect();
        course.apart_ms(&phases) > APART_MS
    }

    /// One board is lost: the others hold, as the lost one does by itself, and the host is told.
    pub(super) fn give_up(&mut self, board: usize, error: &ClientError) -> LinkError {
        let others = |index: &usize| *index != board;
        let give_up = self.lines.now_us() + CONFIRM_US;
        for index in (0..self.members.len()).filter(others) {
            if let Some(member) = self.members.get_mut(index)
                && works(member.state)
            {
                // A second line that is gone changes nothing for the others.
                let _ = member.client.post(Request::Stop(StopKind::Hold));
            }
        }
        let mut arrived = vec![Vec::new(); self.lines.count()];
        while self.flush().is_ok() && self.lines.now_us() < give_up {
            let until_us = (self.lines.now_us() + 5000).min(give_up);
            let Ok(now_us) = self.lines.receive(until_us, &mut arrived) else {
                break;
            };
            for index in (0..self.members.len()).filter(others) {
                let line = self.line_of.get(index).copied().unwrap_or(index);
                let (Some(member), Some(bytes)) =
                    (self.members.get_mut(index), arrived.get_mut(line))
                else {
                    continue;
                };
                let port = member.client.link_mut();
                port.now_us = now_us;
                port.inbox.append(bytes);
                let _ = member.client.work();
            }
            // A board that was reset speaks on, to nobody: what it says must not end every wait at once.
            for bytes in &mut arrived {
                bytes.clear();
            }
        }
        let others = if self.fault_line {
            "stopped by the fault line, or were told to hold and close their brakes after 2 s"
        } else {
            "were told to hold, and close their brakes after 2 s"
        };
        LinkError::Boards {
            what: format!("{}: {error}; the other boards {others}", self.name(board)),
            help: "check power and line of that board, then connect again".into(),
        }
    }
}
