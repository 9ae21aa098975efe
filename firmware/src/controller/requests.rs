//! Requests of a host, and when they are allowed: a refused request changes nothing.

use super::{
    CAPACITY, ConfigHash, Controller, Event, FAULT_LINE_TICKS, FaultId, Info, List, PerCable,
    Persist, Reject, Reply, Request, Service, State, StopKind, TICKS_PER_SECOND, Tick, Winch,
};
use crate::watch::LinkHealth;
use mcdpr_protocol::{
    BENCH_FAULT_LINE, BENCH_OUTPUT_MS, BENCH_OUTPUTS, Bench, BenchTest, Kept, Millinewtons,
    TenthMicrometres,
};

/// Largest plausible length, 0.1 µm (200 m).
// 200 m leave a margin of 14 m to the range of 32 bits (214.7 m), for motions from there.
const LENGTH_LIMIT: i32 = 2_000_000_000;

impl<const N: usize> Controller<N> {
    /// Answers one request of the session that holds the board.
    ///
    /// # Errors
    /// The reason for a refusal; nothing changed then.
    pub fn handle(&mut self, now: Tick, request: &Request) -> Result<Reply, Reject> {
        match request {
            Request::Info => Ok(Reply::Info(Self::info())),
            Request::Status => Ok(Reply::Status(self.status())),
            Request::Open | Request::Close => self.handle_claim(now, request),
            Request::Heartbeat { host_time_us } => {
                // The reply carries what a host needs to stream: clock, path time and room in the
                // buffer.
                self.heartbeat.beat(now);
                Ok(Reply::Beat {
                    host_time_us: *host_time_us,
                    tick: now,
                    state: self.state,
                    path_ms: self.motion.path_ms(),
                    knots_free: self.motion.free(),
                    next_knot: self.motion.next_index(),
                })
            }
            Request::Stop(kind) => Ok(self.handle_stop(*kind)),
            Request::ConfigBegin { entries } => {
                self.only_in(&[State::Disarmed, State::Fault])?;
                self.store.begin(*entries).map(|()| Reply::Done)
            }
            Request::ConfigPut { entries } => {
                self.only_in(&[State::Disarmed, State::Fault])?;
                self.store.put(entries).map(|()| Reply::Done)
            }
            Request::ConfigCommit { hash } => {
                self.may_configure()?;
                // The server has prepared it over the ticks before: no slice is left here.
                while !self.prepare(*hash) {}
                // A refused configuration leaves the active one as it is.
                self.built.take().unwrap_or(Ok(()))?;
                self.store.clear();
                self.config_taken();
                Ok(Reply::Configured { hash: *hash })
            }
            Request::Reference { lengths, tensions } => self.handle_reference(lengths, tensions),
            Request::Arm { config_hash } => self.handle_arm(now, *config_hash, None),
            Request::Service {
                config_hash,
                cable,
                open,
            } => {
                // Only the check that there is such a winch.
                self.winch(*cable)?;
                let service = Service {
                    cable: *cable,
                    open: *open,
                };
                self.handle_arm(now, *config_hash, Some(service))
            }
            Request::Winch { cable } => self.winch(*cable).map(Reply::Winch),
            Request::Scan { restart } => {
                self.only_in(&[State::Disarmed, State::Fault])?;
                if self.active.is_none() {
                    return Err(Reject::NotConfigured);
                }
                // The scan begins with the next tick's outputs, so it does not count as done until
                // then.
                self.scan_asked |= *restart;
                Ok(Reply::Drives {
                    done: self.scan.done && !self.scan_asked,
                    nodes: self.scan.nodes,
                })
            }
            Request::Bench { test } => self.handle_bench(*test),
            // The board adds them.
            Request::Kept => Ok(Reply::Kept(Kept::default())),
            Request::Disarm => {
                self.only_in(&[State::Arming, State::Holding, State::Disarmed])?;
                // Disarming is a stop: brakes close and are tested under torque before torque is
                // switched off.
                self.raise(Event::Stop);
                Ok(Reply::Done)
            }
            Request::Knot(knot) => self.handle_knot(knot),
            Request::Start => {
                self.possible(Event::Start)?;
                // A hold keeps torque on with a latched fault: the robot must not move before it is
                // cleared.
                self.no_fault()?;
                // Two knots at least: a segment has a beginning and an end.
                if !self.motion.is_fresh() {
                    return Err(Reject::NothingToStart);
                }
                self.raise(Event::Start);
                Ok(Reply::Done)
            }
            Request::Resume => {
                self.possible(Event::Resume)?;
                self.no_fault()?;
                // After a stop segment the robot is not on its path: the rest of the motion is
                // void.
                if !self.motion.is_paused() {
                    return Err(Reject::NothingToStart);
                }
                self.raise(Event::Resume);
                Ok(Reply::Done)
            }
            Request::Discard => {
                self.only_in(&[State::Disarmed, State::Holding, State::Fault])?;
                self.motion.clear();
                Ok(Reply::Done)
            }
            Request::ClearFault => self.handle_clear(now),
            // The server executes it; a request for samples never comes here.
            Request::Samples { .. } => Err(Reject::Unsupported),
            Request::Gripper { closed } => {
                // A stop or a fault does not change the gripper: its load must not fall while
                // people come to look, and it must not snap while they reach in.
                self.only_in(&[
                    State::Disarmed,
                    State::Holding,
                    State::Moving,
                    State::Pausing,
                ])?;
                self.gripper_closed = *closed;
                Ok(Reply::Done)
            }
        }
    }

    /// Does a slice of activating a configuration; returns whether it is done, so that
    /// [`Self::handle`] has little left to do. A control tick has no time for all of it.
    pub fn prepare(&mut self, hash: ConfigHash) -> bool {
        // The commit itself gives the refusal.
        if self.may_configure().is_err() {
            return true;
        }
        if self.built.is_none() {
            self.built = self.store.build_slice(hash, &mut self.active);
        }
        self.built.is_some()
    }

    /// Whether a configuration may be exchanged. An exchange that has begun is completed even if
    /// the emergency stop is pressed in between: torque cannot be switched on before that.
    fn may_configure(&self) -> Result<(), Reject> {
        if self.built.is_some() || self.store.is_taking() {
            return Ok(());
        }
        self.only_in(&[State::Disarmed, State::Fault])
    }

    /// Arms every winch, or a single one.
    fn handle_arm(
        &mut self,
        now: Tick,
        host: ConfigHash,
        service: Option<Service>,
    ) -> Result<Reply, Reject> {
        self.possible(Event::Arm)?;
        let active = self.active.as_ref().ok_or(Reject::NotConfigured)?;
        let board = active.hash;
        // Host and board must mean the same robot: an old file's gains or limits would be used
        // otherwise (F9).
        if board != host {
            return Err(Reject::ConfigHash { board, host });
        }
        if !self.referenced {
            return Err(Reject::NotReferenced);
        }
        self.no_fault()?;
        if service.is_none() && self.fault_line.ticks() >= FAULT_LINE_TICKS {
            let fault = FaultId::L19;
            return Err(Reject::CauseRemains { fault });
        }
        self.service = service;
        if service.is_some() {
            self.forget_parked();
        }
        // The request is a sign of life. Without this the first tick under torque could report L10.
        self.heartbeat.beat(now);
        self.raise(Event::Arm);
        Ok(Reply::Done)
    }

    /// The board fills in the values that only it has.
    fn handle_bench(&mut self, test: BenchTest) -> Result<Reply, Reject> {
        self.only_in(&[State::Disarmed, State::Fault, State::EStop])?;
        if test != BenchTest::Look {
            // Outputs are tried only without a configuration: with one, pins move real brakes of a
            // robot that hangs. The fault line moves nothing.
            self.only_in(&[State::Disarmed])?;
            let output = BENCH_FAULT_LINE;
            if self.active.is_some() && test != (BenchTest::Output { output }) {
                return Err(Reject::Configured);
            }
        }
        match test {
            BenchTest::Look => {}
            BenchTest::CanLoop => self.loop_asked = true,
            BenchTest::Output { output } if (1..=BENCH_FAULT_LINE).contains(&output) => {
                self.trial = (output, BENCH_OUTPUT_MS);
            }
            BenchTest::Output { output } => {
                return Err(Reject::CableCount {
                    expected: BENCH_OUTPUTS,
                    got: output,
                });
            }
        }
        Ok(Reply::Bench(Bench::default()))
    }

    /// One winch; refuses the number of a winch that does not exist.
    fn winch(&self, number: u8) -> Result<Winch, Reject> {
        let index = usize::from(number).wrapping_sub(1);
        let cable = self.cables.get(index);
        let pins = self.drives.get(index).zip(self.adc.get(index));
        let Some((cable, (drive, &tension_adc))) = cable.zip(pins) else {
            return Err(Reject::CableCount {
                expected: u8::try_from(N).unwrap_or(u8::MAX),
                got: number,
            });
        };
        Ok(Winch {
            ready: drive.ready,
            fault: drive.fault,
            hot: drive.over_temperature,
            bus_off: drive.bus_off,
            age_ms: drive.age_ms,
            motor_counts: drive.counts,
            current_ma: drive.current_ma,
            drum_counts: crate::fixed::saturate(cable.encoder.counts()),
            tension_adc,
        })
    }

    fn info() -> Info {
        Info {
            cables: u8::try_from(N).unwrap_or(u8::MAX),
            knot_capacity: u8::try_from(CAPACITY).unwrap_or(u8::MAX),
            ticks_per_second: TICKS_PER_SECOND,
            // The board reports which protocols it supports.
            drive_kinds: 0,
            simulated: false,
            last_panic: List::new(),
        }
    }

    pub(super) fn only_in(&self, states: &[State]) -> Result<(), Reject> {
        if states.contains(&self.state) {
            Ok(())
        } else {
            Err(Reject::WrongState { state: self.state })
        }
    }

    fn possible(&self, event: Event) -> Result<(), Reject> {
        crate::supervisor::transition(self.state, event, self.latch.get().is_some())
            .map(|_| ())
            .ok_or(Reject::WrongState { state: self.state })
    }

    pub(super) fn no_fault(&self) -> Result<(), Reject> {
        self.latch
            .get()
            .map_or(Ok(()), |record| Err(Reject::Faulted { record }))
    }

    /// The server manages sessions; the controller only decides whether a session may be taken
    /// over.
    fn handle_claim(&mut self, now: Tick, request: &Request) -> Result<Reply, Reject> {
        if matches!(request, Request::Close) {
            self.only_in(&[State::Disarmed, State::Fault, State::EStop])?;
        } else if self.is_armed() {
            // The session that armed may have fallen silent: a new host waits until the robot has
            // stopped by itself (L10).
            return Err(Reject::SessionHeld);
        } else {
            self.heartbeat.beat(now);
        }
        Ok(Reply::Done)
    }

    fn handle_stop(&mut self, kind: StopKind) -> Reply {
        self.raise(match kind {
            StopKind::Hold => Event::Hold,
            StopKind::Stop => Event::Stop,
            StopKind::Emergency => Event::Emergency,
        });
        Reply::Done
    }

    fn config_taken(&mut self) {
        self.forget_parked();
        self.fault_line = Persist::default();
        let Some(active) = &self.active else { return };
        for (cable, config) in self.cables.iter_mut().zip(&active.cables) {
            // Lengths counted with another scale are invalid; other gains do not affect them.
            self.referenced &= cable.scale.per_count_q24 == config.per_count_q24;
            cable.scale.per_count_q24 = config.per_count_q24;
        }
    }

    fn handle_reference(
        &mut self,
        lengths: &PerCable<TenthMicrometres>,
        tensions: &PerCable<Millinewtons>,
    ) -> Result<Reply, Reject> {
        self.only_in(&[State::Disarmed, State::Fault])?;
        if self.active.is_none() {
            return Err(Reject::NotConfigured);
        }
        Self::count(lengths.len())?;
        Self::count(tensions.len())?;
        for (number, (length, tension)) in (1..).zip(lengths.iter().zip(tensions.iter())) {
            if length.0.saturating_abs() > LENGTH_LIMIT {
                return Err(Reject::KnotLength { cable: number });
            }
            // 10 kN: the largest full scale that a configuration may state.
            if tension.0.saturating_abs() > 10_000_000 {
                return Err(Reject::KnotTension { cable: number });
            }
        }
        // All values were valid: only now is any of them taken.
        let values = lengths.iter().zip(tensions.iter());
        for (cable, (length, tension)) in self.cables.iter_mut().zip(values) {
            cable.scale.reference_counts = cable.encoder.counts();
            cable.scale.reference = length.0;
            cable.length = length.0;
            cable.reference_mn = tension.0;
        }
        self.referenced = true;
        self.forget_parked();
        Ok(Reply::Done)
    }

    pub(super) fn count(got: usize) -> Result<(), Reject> {
        if got == N {
            return Ok(());
        }
        Err(Reject::CableCount {
            expected: u8::try_from(N).unwrap_or(u8::MAX),
            got: u8::try_from(got).unwrap_or(u8::MAX),
        })
    }

    fn handle_clear(&mut self, now: Tick) -> Result<Reply, Reject> {
        self.possible(Event::Clear)?;
        let link = self.heartbeat.health(now);
        match self.latch.get().map(|record| record.fault) {
            // The request to clear is not a heartbeat: the link is still lost.
            Some(FaultId::L10) if link >= LinkHealth::Lost => {
                return Err(Reject::CauseRemains {
                    fault: FaultId::L10,
                });
            }
            Some(FaultId::P7) if self.e_stop => {
                return Err(Reject::CauseRemains { fault: FaultId::P7 });
            }
            Some(fault) if self.lasting == Some(fault) => {
                return Err(Reject::CauseRemains { fault });
            }
            _ => {}
        }
        self.latch.clear();
        self.raise(Event::Clear);
        Ok(Reply::Done)
    }
}
