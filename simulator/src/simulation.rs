//! The whole simulated robot behind a serial line, in virtual time.

pub(crate) mod several;

use crate::board::{BoardFailure, VirtualBoard};
use crate::camera::Cell;
use crate::can::DriveLine;
use crate::plant::{Plant, PlantError, Truth};
use crate::wire::{LinkOptions, Wire, WireFaults};
use mcdpr_firmware::State;
use mcdpr_protocol::{FaultRecord, Tick};
use several::Clock;

/// The true state in one tick. For reports and tests: a host cannot see it.
#[derive(Debug, Clone)]
pub struct TracePoint {
    /// Board tick.
    pub tick: Tick,
    /// The board's state.
    pub state: State,
    /// Path time of the motion, ms.
    pub path_ms: u32,
    /// The fault that the board has latched.
    pub fault: Option<FaultRecord>,
    /// Whether the board commanded any drive to give torque.
    pub torque_on: bool,
    /// The plant.
    pub truth: Truth,
}

/// A board with its bus and its line.
pub(crate) struct Port {
    pub(crate) board: Box<dyn VirtualBoard + Send>,
    pub(crate) drives: DriveLine,
    pub(crate) to_board: Wire,
    pub(crate) to_host: Wire,
    pub(crate) powered: bool,
    /// Its clock, where several boards have clocks of their own.
    pub(crate) clock: Clock,
    /// The plant's cables on it, where several boards share the plant.
    pub(crate) cables: Vec<usize>,
    /// Its connection to the fault line, where there are several boards.
    pub(crate) fault_line: several::FaultLineTap,
}

impl Port {
    pub(crate) fn new(
        drives: DriveLine,
        board: Box<dyn VirtualBoard + Send>,
        link: &LinkOptions,
        seed: u64,
        clock: Clock,
    ) -> Self {
        // A salt of its own for each direction: their faults do not coincide.
        let wire = |faults, salt| Wire::new(link.baud, link.latency_us, faults, seed ^ salt);
        Self {
            drives,
            board,
            to_board: wire(link.to_board, 0x746F_5F62),
            to_host: wire(link.to_host, 0x746F_5F68),
            powered: true,
            clock,
            cables: Vec::new(),
            fault_line: several::FaultLineTap::default(),
        }
    }

    /// One slice of time of a board without supply; the plant is not touched.
    pub(crate) fn lose_bytes(&mut self, now_us: u64, received: &mut Vec<u8>) {
        received.clear();
        // What arrives at a board without supply is lost.
        self.to_board.make_noise(now_us);
        self.to_board.receive(now_us, received);
        self.to_board.take_framing_errors(now_us);
    }

    /// One slice of a board's work: bytes in, bytes out.
    pub(crate) fn work(
        &mut self,
        plant: &mut Plant,
        now_us: u64,
        received: &mut Vec<u8>,
        send: &mut Vec<u8>,
    ) -> Result<(), PlantError> {
        received.clear();
        send.clear();
        self.to_board.make_noise(now_us);
        self.to_board.receive(now_us, received);
        let line_errors = self.to_board.take_framing_errors(now_us);
        self.board.line_errors(line_errors);
        let backlog = self.to_host.backlog(now_us);
        self.board
            .tick(plant, &mut self.drives, received, backlog, send)?;
        self.to_host.send(now_us, send);
        Ok(())
    }
}

/// A robot, its boards and the lines to them, advanced by the caller.
pub struct Simulation {
    pub(crate) plant: Plant,
    /// At least one.
    pub(crate) ports: Vec<Port>,
    pub(crate) now_us: u64,
    next_tick_us: u64,
    pub(crate) received: Vec<u8>,
    pub(crate) send: Vec<u8>,
    pub(crate) trace: Option<Vec<TracePoint>>,
    pub(crate) points: Option<Vec<several::BoardPoint>>,
    pub(crate) cell: Option<Cell>,
    /// Path time of the first board at which the robot's path begins, ms.
    pub(crate) path_zero_ms: u32,
    /// True time of the plant, ns, where several boards share it.
    pub(crate) plant_ns: u64,
}

impl Simulation {
    /// A board just after power-on, on a plant that was placed before.
    ///
    /// # Errors
    /// [`PlantError::CableCount`] for a number of cables that a board cannot drive.
    pub fn new(plant: Plant, link: &LinkOptions, seed: u64) -> Result<Self, PlantError> {
        let cables: Vec<usize> = (0..plant.cable_count()).collect();
        let board = crate::board::core(link, &cables, 0)?;
        Ok(Self::with_board(plant, board, link, seed))
    }

    /// Any board just after power-on, on a plant that was placed before. The board itself handles
    /// `first_tick` and `version` of the options.
    #[must_use]
    pub fn with_board(
        plant: Plant,
        board: Box<dyn VirtualBoard + Send>,
        link: &LinkOptions,
        seed: u64,
    ) -> Self {
        let next_tick_us = board.slice_us();
        let drives = DriveLine::new(&plant);
        let port = Port::new(drives, board, link, seed, Clock::default());
        Self::of_ports(plant, vec![port], next_tick_us)
    }

    pub(crate) const fn of_ports(plant: Plant, ports: Vec<Port>, next_tick_us: u64) -> Self {
        Self {
            next_tick_us,
            plant,
            ports,
            now_us: 0,
            received: Vec::new(),
            send: Vec::new(),
            trace: None,
            points: None,
            cell: None,
            path_zero_ms: 0,
            plant_ns: 0,
        }
    }

    /// Virtual time, µs since the board got power.
    #[must_use]
    pub const fn now_us(&self) -> u64 {
        self.now_us
    }

    /// Whether time passes by itself, also while nobody calls: a real board is in the loop.
    #[must_use]
    pub fn goes_on(&self) -> bool {
        self.ports.iter().any(|port| port.board.goes_on())
    }

    /// The host sends bytes now.
    pub fn send(&mut self, bytes: &[u8]) {
        self.ports[0].to_board.send(self.now_us, bytes);
    }

    /// Advances until `until_us`, or until bytes have arrived for the host, which are appended to
    /// `into`. Time never runs backwards.
    ///
    /// # Errors
    /// The plant left the region in which its physics is valid.
    pub fn advance(&mut self, until_us: u64, into: &mut Vec<u8>) -> Result<(), PlantError> {
        loop {
            self.ports[0].to_host.receive(self.now_us, into);
            if !into.is_empty() || self.now_us >= until_us {
                return Ok(());
            }
            let arrival = self.ports[0].to_host.next_arrival_us().unwrap_or(u64::MAX);
            self.now_us = until_us
                .min(arrival)
                .min(self.next_tick_us)
                .max(self.now_us);
            if self.now_us == self.next_tick_us {
                self.tick()?;
            }
        }
    }

    /// Switches the board's own supply. Without it its outputs are low, so that its brakes close; it
    /// says and hears nothing, and its encoder counters stand at zero when it starts again. The
    /// supply of drives and brakes is [`Plant::set_power`].
    ///
    /// # Errors
    /// [`PlantError::Board`] where the board cannot start again.
    pub fn set_board_power(&mut self, on: bool) -> Result<(), PlantError> {
        self.set_power_of(0, on)
    }

    /// As [`Self::set_board_power`], for one of several boards, from 0.
    ///
    /// # Errors
    /// [`PlantError::Board`] where the board cannot start again.
    pub fn set_power_of(&mut self, board: usize, on: bool) -> Result<(), PlantError> {
        let port = &mut self.ports[board];
        if on && !port.powered {
            self.plant.restart_encoders(&port.cables);
            port.board.power_on()?;
        }
        port.powered = on;
        Ok(())
    }

    /// Fits the first board's battery, which keeps its backup registers without a supply.
    pub fn fit_battery(&mut self) {
        self.ports[0].board.fit_battery();
    }

    /// The first board fails and resets itself, or the cause is over. It keeps what a reset leaves.
    ///
    /// # Errors
    /// [`PlantError::Board`] where the board cannot start again.
    pub fn fail_board(&mut self, failure: BoardFailure, on: bool) -> Result<(), PlantError> {
        self.fail_board_of(0, failure, on)
    }

    /// A slice of time in which the board has no supply.
    fn unpowered(&mut self) -> Result<(), PlantError> {
        for cable in 0..self.plant.cable_count() {
            self.plant.set_brake(cable, true)?;
            self.plant.set_drive_enable(cable, false)?;
        }
        self.plant.set_gripper(false);
        let port = &mut self.ports[0];
        port.board
            .advance_unpowered(&mut self.plant, &mut port.drives, self.now_us)?;
        // After the plant: the jaws are where the slice ends.
        if let Some(cell) = &mut self.cell {
            cell.step(&mut self.plant)?;
        }
        port.lose_bytes(self.now_us, &mut self.received);
        self.next_tick_us += port.board.slice_us();
        let tick = port.board.now();
        self.note_unpowered(tick)
    }

    /// A point of the record while the first board has no supply.
    pub(crate) fn note_unpowered(&mut self, tick: Tick) -> Result<(), PlantError> {
        if let Some(trace) = &mut self.trace
            && self.now_us.is_multiple_of(1000)
        {
            trace.push(TracePoint {
                tick,
                state: State::Boot,
                path_ms: 0,
                fault: None,
                torque_on: false,
                truth: self.plant.truth()?,
            });
        }
        Ok(())
    }

    fn tick(&mut self) -> Result<(), PlantError> {
        let port = &mut self.ports[0];
        if !port.powered {
            return self.unpowered();
        }
        let slice_us = port.board.slice_us();
        port.board
            .advance(&mut self.plant, &mut port.drives, self.now_us)?;
        if let Some(cell) = &mut self.cell {
            cell.step(&mut self.plant)?;
        }
        let before = port.board.now();
        port.work(
            &mut self.plant,
            self.now_us,
            &mut self.received,
            &mut self.send,
        )?;
        self.next_tick_us += slice_us;
        self.note_tick(before)
    }

    /// The record's point of a tick, if the first board's tick is no longer `before`.
    pub(crate) fn note_tick(&mut self, before: Tick) -> Result<(), PlantError> {
        let Some(trace) = &mut self.trace else {
            return Ok(());
        };
        let board = &mut self.ports[0].board;
        let zero_ms = self.path_zero_ms;
        // A slice may be a part of a tick: one point per tick.
        if board.now() != before {
            trace.push(TracePoint {
                tick: board.now(),
                state: board.state(),
                path_ms: board.path_ms().saturating_sub(zero_ms),
                fault: board.fault(),
                torque_on: board.torque_on(),
                truth: self.plant.truth()?,
            });
        }
        // Some boards know a tick's path time only ticks later.
        for (tick, path_ms) in board.take_path_times() {
            let known = trace.iter_mut().rev().find(|point| point.tick == tick);
            if let Some(point) = known {
                point.path_ms = path_ms.saturating_sub(zero_ms);
            }
        }
        Ok(())
    }

    /// Starts recording the true state of every tick.
    pub fn record_truth(&mut self) {
        self.trace.get_or_insert_default();
    }

    /// The true states since the last call, tick by tick: up to now, or to the last tick whose path
    /// time is known.
    pub fn take_trace(&mut self) -> Vec<TracePoint> {
        let behind = self.ports[0].board.path_times_behind();
        let Some(trace) = &mut self.trace else {
            return Vec::new();
        };
        let known = trace.len().saturating_sub(behind);
        trace.drain(..known).collect()
    }

    /// Puts the robot into a workcell: from now on its gripper moves the objects there.
    pub fn set_cell(&mut self, cell: Cell) {
        self.cell = Some(cell);
    }

    /// The workcell, if there is one.
    #[must_use]
    pub const fn cell(&self) -> Option<&Cell> {
        self.cell.as_ref()
    }

    /// The workcell, to change it or to take pictures in it.
    pub const fn cell_mut(&mut self) -> Option<&mut Cell> {
        self.cell.as_mut()
    }

    /// The plant, to look at.
    #[must_use]
    pub const fn plant(&self) -> &Plant {
        &self.plant
    }

    /// The plant, to disturb: faults, loads, the e-stop button.
    pub const fn plant_mut(&mut self) -> &mut Plant {
        &mut self.plant
    }

    /// The drives' bus, to look at.
    #[must_use]
    pub fn drives(&self) -> &DriveLine {
        &self.ports[0].drives
    }

    /// The drives' bus, to disturb: wires and electronics.
    pub fn drives_mut(&mut self) -> &mut DriveLine {
        &mut self.ports[0].drives
    }

    /// The board's state; for tests, a host asks over the line.
    #[must_use]
    pub fn state(&self) -> State {
        self.ports[0].board.state()
    }

    /// Path time of the motion in progress, ms; for tests and fault injection.
    #[must_use]
    pub fn path_ms(&self) -> u32 {
        let port = &self.ports[0];
        port.board.path_ms().saturating_sub(self.path_zero_ms)
    }

    /// The fault that the board has latched; for tests, a host asks over the line.
    #[must_use]
    pub fn fault(&self) -> Option<FaultRecord> {
        self.ports.iter().find_map(|port| port.board.fault())
    }

    /// Changes the faults on the line from now on.
    pub fn set_link_faults(&mut self, to_board: WireFaults, to_host: WireFaults) {
        self.set_faults_of(0, to_board, to_host);
    }

    /// Changes the faults on the line to one of several boards, from 0.
    pub fn set_faults_of(&mut self, board: usize, to_board: WireFaults, to_host: WireFaults) {
        let port = &mut self.ports[board];
        port.to_board.set_faults(to_board);
        port.to_host.set_faults(to_host);
    }
}
