//! The fault line between the boards: proved before the robot arms, and whose fault came first.
//!
//! Each board in turn lets go of the line for a while, and every board must see that it falls. A wire that is cut would
//! otherwise be noticed only when it is needed.

use super::{Boards, Errand, Lines};
use crate::link::LinkError;
use mcdpr_protocol::{
    BENCH_FAULT_LINE, BenchTest, BoardState, FaultId, FaultRecord, Limit, Reject, Request,
    SequenceNumber, Status,
};

/// Time for all boards to see the line fall or rise, µs: a board lets go for 300 ms, and tells its state every 100 ms.
const PATIENCE_US: u64 = 800_000;
/// Time for the cause of a stop by the line to become known, µs: a silent board is lost after 100 ms.
const CAUSE_US: u64 = 150_000;

/// What the boards shall see.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Step {
    /// The line is high.
    Rise,
    /// A board lets go of it.
    Fall,
}

/// The proof in progress.
#[derive(Debug)]
pub(super) struct LineProof {
    /// The host's request to arm, and what the boards are asked after the proof.
    of: SequenceNumber,
    then: Vec<(usize, Request)>,
    step: Step,
    /// The board that lets go next, or does now.
    board: usize,
    begun_us: u64,
    /// Boards that have seen this step.
    seen: Vec<bool>,
}

impl LineProof {
    pub(super) fn begun(
        of: SequenceNumber,
        then: Vec<(usize, Request)>,
        boards: usize,
        now_us: u64,
    ) -> Self {
        Self {
            of,
            then,
            step: Step::Rise,
            board: 0,
            begun_us: now_us,
            seen: vec![false; boards],
        }
    }

    /// A board tells its state. Its mark of a low line is of any moment since it last did, so that none is missed.
    pub(super) fn hear(&mut self, board: usize, status: &Status) {
        let low = status.limits.contains(Limit::FaultLine);
        if low == (self.step == Step::Fall)
            && let Some(seen) = self.seen.get_mut(board)
        {
            *seen = true;
        }
    }

    fn enter(&mut self, step: Step, now_us: u64) {
        self.step = step;
        self.begun_us = now_us;
        self.seen.fill(false);
    }

    pub(super) const fn due_us(&self) -> u64 {
        self.begun_us + PATIENCE_US
    }
}

/// Whether a board stopped because another one did.
pub(super) fn follows(record: &FaultRecord) -> bool {
    record.fault == FaultId::L19
}

impl<L: Lines> Boards<L> {
    /// Whether the line must be proved before these boards arm. A board that refuses to arm anyway gives its own reason.
    pub(super) fn proves_line(&self) -> bool {
        let ready = |member: &super::Member| {
            let status = member.client.status();
            member.state == BoardState::Disarmed && status.is_none_or(|s| s.fault.is_none())
        };
        self.fault_line && self.members.iter().all(ready)
    }

    /// The proof's next step, once every board has seen the last one.
    pub(super) fn prove_line(&mut self, now_us: u64) -> Result<(), LinkError> {
        // A board that has a fault meanwhile pulls the line.
        if self.line_proof.is_some() && !self.proves_line() {
            self.drop_proof();
        }
        let Some(proof) = &mut self.line_proof else {
            return Ok(());
        };
        if proof.seen.contains(&false) {
            return if now_us < proof.due_us() {
                Ok(())
            } else {
                Err(self.line_fails())
            };
        }
        let mut errands = Vec::new();
        let mut of = None;
        match proof.step {
            Step::Rise if proof.board < proof.seen.len() => {
                proof.enter(Step::Fall, now_us);
                let output = BENCH_FAULT_LINE;
                let test = BenchTest::Output { output };
                errands.push((proof.board, Request::Bench { test }));
            }
            Step::Rise => {
                of = Some(proof.of);
                errands = std::mem::take(&mut proof.then);
                self.line_proof = None;
            }
            Step::Fall => {
                proof.enter(Step::Rise, now_us);
                proof.board += 1;
            }
        }
        for (board, request) in errands {
            if let Some(member) = self.members.get_mut(board) {
                member.todo.push_back(Errand { request, of });
            }
        }
        Ok(())
    }

    /// Ends the proof, and the arming with it: the host has ordered something else, or a board has a fault.
    pub(super) fn drop_proof(&mut self) {
        let Some(proof) = self.line_proof.take() else {
            return;
        };
        let states = self.members.iter().map(|member| member.state);
        let state = super::state::joint_state(states);
        let faults = self.members.iter().enumerate().filter_map(|(board, m)| {
            let record = m.client.status()?.fault?;
            Some(self.layout.fault(board, record))
        });
        let why = match faults.min_by_key(follows) {
            Some(record) => Reject::Faulted { record },
            None => Reject::WrongState { state },
        };
        let waiting = self.waiting.iter_mut().find(|w| w.sequence == proof.of);
        if let Some(waiting) = waiting {
            waiting.left = 0;
            waiting.result = Err(why);
        }
    }

    /// Which board's wire is at fault.
    fn line_fails(&mut self) -> LinkError {
        let Some(proof) = self.line_proof.take() else {
            return super::lost_line(String::new());
        };
        let blind: Vec<String> = (0..proof.seen.len())
            .filter(|board| proof.seen.get(*board) == Some(&false))
            .map(|board| self.name(board))
            .collect();
        let all = blind.len() == proof.seen.len();
        let (names, pulls) = (blind.join(", "), self.name(proof.board));
        super::lost_line(match (proof.step, all) {
            (Step::Rise, true) => {
                "the fault line is low at every board: one of them pulls it, or it has no supply"
                    .to_owned()
            }
            (Step::Rise, false) => {
                format!("the fault line's wire to {names} is cut: it is low there alone")
            }
            (Step::Fall, true) => {
                format!("{pulls} does not pull the fault line low: the wire from it is cut")
            }
            (Step::Fall, false) => format!(
                "the fault line's wire to {names} is cut: {pulls} pulled it low, which was not seen"
            ),
        })
    }

    /// A board tells a fault: it came first, unless it only followed.
    pub(super) fn blame(&mut self, board: usize, record: &FaultRecord) {
        let fault_of = |board: usize| self.members.get(board)?.client.status()?.fault;
        match self.culprit {
            None => {
                self.culprit = Some(board);
                self.blamed_us = self.lines.now_us();
            }
            Some(before) => {
                let followed = fault_of(before).is_some_and(|record| follows(&record));
                if followed && !follows(record) {
                    self.culprit = Some(board);
                }
            }
        }
    }

    /// A board has stopped because of another one, of which nothing is known yet: the host is told no fault until the
    /// cause is known.
    pub(super) fn seeks_cause(&self) -> bool {
        let culprit = self.culprit.and_then(|board| self.members.get(board));
        let fault = culprit.and_then(|member| member.client.status()?.fault);
        fault.is_some_and(|record| follows(&record))
            && self.lines.now_us() < self.blamed_us + CAUSE_US
    }
}
