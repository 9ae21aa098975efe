//! The steps of a board in each millisecond, on the chip and in the simulator alike.
//!
//! Order within a tick: read; find stops; step; apply; one request; report. Inputs are read first,
//! at a constant time after the tick's start. Stops are searched next among all bytes that arrived
//! since the last tick, so that a stop takes effect in this tick, whatever waits before it on the
//! line. Requests are executed after the outputs and take effect from the next tick on.

use crate::io::{Board, Inputs};
use crate::link::TickEnds;
use crate::server::Server;
use mcdpr_protocol::stop::StopFinder;
use mcdpr_protocol::{Reply, Tick};

/// The control core with its state from tick to tick.
#[derive(Debug)]
pub struct Cycle<const N: usize> {
    server: Server<N>,
    /// The inputs of this tick; stored here, so that they are not built anew in each.
    inputs: Inputs<N>,
    finder: StopFinder,
    /// Number of the next byte to be searched.
    searched: u32,
    /// Number of the byte after the last stop that was found, until everything before it has been
    /// executed.
    stop_at: Option<u32>,
    /// The last tick executed a request.
    executed_before: bool,
}

impl<const N: usize> Cycle<N> {
    /// A board that just started; `simulated` is reported in its identity.
    #[must_use]
    pub fn new(simulated: bool) -> Self {
        Self {
            server: Server::new(simulated),
            inputs: Inputs::default(),
            finder: StopFinder::default(),
            searched: 0,
            stop_at: None,
            executed_before: false,
        }
    }

    /// The core behind its sessions.
    #[must_use]
    pub const fn server(&self) -> &Server<N> {
        &self.server
    }

    /// See [`Server::start_in_fault`]. Must be called before the first tick.
    pub fn start_in_fault(&mut self, fault: mcdpr_protocol::FaultId) {
        self.server.start_in_fault(fault);
    }

    /// See [`Server::start_in_lasting_fault`]. Must be called before the first tick.
    pub fn start_in_lasting_fault(&mut self, fault: mcdpr_protocol::FaultId) {
        self.server.start_in_lasting_fault(fault);
    }

    /// One tick. `late`: it started late (P5).
    #[inline]
    pub fn tick<B: Board<N>>(
        &mut self,
        now: Tick,
        late: bool,
        board: &mut B,
        ends: &mut TickEnds<'_, N>,
    ) {
        self.control(now, late, board);
        let executed = self.execute(now, board, ends);
        // A request and the state each take time: they are not handled in the same tick, unless one
        // request follows the other.
        let tells_state = !executed || self.executed_before;
        self.executed_before = executed;
        self.report(tells_state, ends);
        board.show(self.server.controller().state(), now);
    }

    /// Out of line, like the others: the stack of one is released before the next one's is used.
    #[inline(never)]
    fn control<B: Board<N>>(&mut self, now: Tick, late: bool, board: &mut B) {
        board.read(&mut self.inputs);
        self.inputs.overrun = late;
        // Between reading and stepping: a stop that arrived a moment ago decelerates in this tick.
        self.find_stops(now, board);
        self.server.tick(now, &self.inputs);
        let controller = self.server.controller();
        board.apply(now, controller.config(), controller.outputs());
        board.keep(controller.to_keep().as_ref());
    }

    #[inline(never)]
    fn find_stops<B: Board<N>>(&mut self, now: Tick, board: &mut B) {
        let arrived = board.arrived();
        while self.searched != arrived {
            let byte = board.byte(self.searched);
            self.searched = self.searched.wrapping_add(1);
            if let Some(kind) = self.finder.push(byte) {
                self.server.stop(now, kind);
                // Wrapping numbers: only their differences are compared.
                self.stop_at = Some(self.searched);
            }
        }
    }

    /// Executes a request, if one waits; returns whether it did.
    #[inline(never)]
    fn execute<B: Board<N>>(
        &mut self,
        now: Tick,
        board: &mut B,
        ends: &mut TickEnds<'_, N>,
    ) -> bool {
        let mut executed = false;
        // One at most: the line brings up to eight, which wait on it.
        if let Some(waiting) = ends.commands.peek() {
            // A request without room for its answer waits: it must not be executed and then seem
            // lost.
            if !ends.answers.ready() {
                return false;
            }
            executed = true;
            // The command stays at the head of its queue and comes again in the next tick.
            if !self.server.prepare(&waiting.command) {
                return executed;
            }
            if let Some(stop_at) = self.stop_at {
                // It is older than a stop that has been executed: it must not start anything (K10).
                if stop_at.wrapping_sub(waiting.at).cast_signed() >= 0 {
                    self.server.outrun(now);
                } else {
                    self.stop_at = None;
                }
            }
            let counters = ends.state.counters();
            let mut answer = self.server.receive(now, &waiting.command, &counters);
            ends.commands.dequeue();
            match &mut answer.result {
                Ok(Reply::Info(info)) => board.complete(info),
                Ok(Reply::Bench(report)) => board.measure(report, &self.inputs),
                Ok(Reply::Kept(kept)) => board.kept(kept),
                _ => {}
            }
            // There is room: it was just checked, and there is no other producer.
            let _ = ends.answers.enqueue(answer);
        }
        if ends.state.is_damaged()
            && ends.answers.ready()
            && ends.state.take_damaged()
            && let Some(answer) = self.server.complain()
        {
            let _ = ends.answers.enqueue(answer);
        }
        executed
    }

    #[inline(never)]
    fn report(&mut self, tells_state: bool, ends: &mut TickEnds<'_, N>) {
        // The state waits, not the tick: a full queue means that the line is slow.
        if tells_state
            && self.server.status_is_due()
            && ends.states.ready()
            && let Some(status) = self.server.take_status(&ends.state.counters())
        {
            let _ = ends.states.enqueue(status);
        }
        if let Some(row) = self.server.take_row()
            && ends.rows.enqueue(row).is_err()
        {
            // Counted, so that a host sees a gap in its samples as what it is (L16).
            ends.state.drop_telemetry();
        }
    }
}
