//! What the host asks of the robot, passed on to its boards.

use super::fault_line::LineProof;
use super::{Asked, Boards, Errand, Lines, Waiting, lost};
use crate::link::LinkError;
use mcdpr_protocol::{Command, ConfigHash, Reject, Reply, Request, SequenceNumber, SessionId};

impl<L: Lines> Boards<L> {
    /// A request of the host.
    pub(super) fn command(&mut self, command: Command) -> Result<(), LinkError> {
        let Command {
            session,
            sequence,
            request,
        } = command;
        if self.members.is_empty() {
            return Ok(());
        }
        match request {
            Request::Heartbeat { host_time_us } => {
                if let Some(beat) = self.beat(host_time_us) {
                    self.answer(sequence, Ok(beat));
                }
                Ok(())
            }
            request if !request.is_sequenced() => self.ask(session, sequence, request),
            request => {
                match sequence.since(self.expected) {
                    0 => self.expected = sequence.next(),
                    // It was heard before: its answer is under way.
                    ..0 => return Ok(()),
                    _ => {
                        let expected = self.expected;
                        self.answer(sequence, Err(Reject::Sequence { expected }));
                        return Ok(());
                    }
                }
                self.execute(sequence, request);
                Ok(())
            }
        }
    }

    /// A request besides the sequence.
    fn ask(
        &mut self,
        session: SessionId,
        sequence: SequenceNumber,
        request: Request,
    ) -> Result<(), LinkError> {
        // Asked again before the answer.
        if self.asked.iter().any(|asked| asked.sequence == sequence) {
            return Ok(());
        }
        if matches!(request, Request::Stop(_)) {
            self.drop_proof();
        }
        if request == Request::Open {
            if self.session != session {
                self.enter(session);
            }
            self.expected = sequence.next();
        }
        let only = match request {
            Request::Winch { cable } => {
                let place = usize::from(cable).checked_sub(1);
                let place = place.and_then(|cable| self.layout.place(cable));
                let Some((board, channel)) = place else {
                    self.answer(sequence, Err(Reject::Unsupported));
                    return Ok(());
                };
                let cable = u8::try_from(channel + 1).unwrap_or(0);
                Some((board, Request::Winch { cable }))
            }
            _ => None,
        };
        let mut replies = Vec::new();
        for (board, member) in self.members.iter_mut().enumerate() {
            let mine = match &only {
                Some((wanted, request)) if *wanted == board => request.clone(),
                Some(_) => {
                    replies.push(Some(Ok(Reply::Done)));
                    continue;
                }
                None => request.clone(),
            };
            replies.push(None);
            member.client.post(mine).map_err(|error| lost(&error))?;
        }
        self.asked.push(Asked {
            sequence,
            request,
            replies,
        });
        Ok(())
    }

    /// A sequenced request.
    fn execute(&mut self, sequence: SequenceNumber, request: Request) {
        // A host that does not wait for its arming has given it up.
        self.drop_proof();
        let now_us = self.lines.now_us();
        let done = |result| (result, Vec::new());
        let boards = self.members.len();
        let all = |request: &Request| {
            let each = (0..boards).map(|board| (board, request.clone()));
            (Ok(Reply::Done), each.collect::<Vec<_>>())
        };
        let (result, errands) = match &request {
            Request::ConfigBegin { .. } => {
                self.entries.clear();
                done(Ok(Reply::Done))
            }
            Request::ConfigPut { entries } => {
                self.entries.extend(entries.iter().copied());
                done(Ok(Reply::Done))
            }
            Request::ConfigCommit { hash } => self.commit(*hash),
            Request::Reference { lengths, tensions } => {
                let each = (0..boards).map(|board| {
                    let lengths = self.layout.part(board, lengths);
                    let tensions = self.layout.part(board, tensions);
                    (board, Request::Reference { lengths, tensions })
                });
                (Ok(Reply::Done), each.collect())
            }
            Request::Arm { config_hash } if *config_hash != self.whole.1 => {
                done(Err(Reject::ConfigHash {
                    board: self.whole.1,
                    host: *config_hash,
                }))
            }
            Request::Arm { .. } => {
                let parts = self.parts.iter().enumerate();
                let each = parts.map(|(board, (_, hash))| {
                    let config_hash = *hash;
                    (board, Request::Arm { config_hash })
                });
                (Ok(Reply::Done), each.collect())
            }
            Request::Knot(knot) => self.knot(knot),
            Request::Start => self.start(),
            Request::Discard => {
                self.ahead.clear();
                self.course = None;
                all(&request)
            }
            // The gripper is on the first board.
            Request::Gripper { .. } => (Ok(Reply::Done), vec![(0, request.clone())]),
            Request::Close
            | Request::Disarm
            | Request::Resume
            | Request::ClearFault
            | Request::Samples { .. } => all(&request),
            // Work on one winch or one board is done with that board's own line.
            _ => done(Err(Reject::Unsupported)),
        };
        let changes = matches!(
            request,
            Request::Arm { .. }
                | Request::Disarm
                | Request::Start
                | Request::Resume
                | Request::ClearFault
        );
        if changes {
            self.since_us = now_us;
            self.relayed = None;
        }
        let left = errands.len();
        let arms = matches!(request, Request::Arm { .. }) && result.is_ok();
        let errands = if arms && self.proves_line() {
            self.line_proof = Some(LineProof::begun(sequence, errands, boards, now_us));
            Vec::new()
        } else {
            errands
        };
        self.waiting.push_back(Waiting {
            sequence,
            left,
            start: request == Request::Start && result.is_ok(),
            result,
            changes,
        });
        for (board, request) in errands {
            if let Some(member) = self.members.get_mut(board) {
                let of = Some(sequence);
                member.todo.push_back(Errand { request, of });
            }
        }
    }

    /// The configuration of every board, if the host's is the robot's.
    fn commit(&self, hash: ConfigHash) -> (Result<Reply, Reject>, Vec<(usize, Request)>) {
        if hash != self.whole.1 || self.entries != self.whole.0 {
            let board = self.whole.1;
            return (Err(Reject::ConfigHash { board, host: hash }), Vec::new());
        }
        let mut errands = Vec::new();
        for (board, (entries, hash)) in self.parts.iter().enumerate() {
            let count = u16::try_from(entries.len()).unwrap_or(u16::MAX);
            errands.push((board, Request::ConfigBegin { entries: count }));
            for chunk in entries.chunks(mcdpr_protocol::message::CONFIG_CHUNK) {
                let entries = mcdpr_protocol::List::collect(chunk.iter().copied());
                errands.push((board, Request::ConfigPut { entries }));
            }
            errands.push((board, Request::ConfigCommit { hash: *hash }));
        }
        (Ok(Reply::Configured { hash }), errands)
    }
}
