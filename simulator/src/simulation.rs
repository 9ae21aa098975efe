//! The whole simulated robot behind a serial line, in virtual time.

use crate::board::{Board, VirtualBoard, WireVersion};
use crate::camera::Cell;
use crate::can::DriveLine;
use crate::plant::{Plant, PlantError, Truth};
use crate::wire::{Wire, WireFaults};
use mcdpr_firmware::State;
use mcdpr_protocol::{FaultRecord, Tick};

/// Properties of the line to the board.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinkOptions {
    /// Bit/s.
    pub baud: u32,
    /// One-way latency of bridges and drivers, µs.
    pub latency_us: u32,
    /// Faults on the way to the board.
    pub to_board: WireFaults,
    /// Faults on the way to the host.
    pub to_host: WireFaults,
    /// The board's tick when it starts (a test of the counter's wrap starts near the end).
    pub first_tick: u32,
    /// Wire format that the board reports, if not this one.
    pub version: Option<WireVersion>,
}

impl Default for LinkOptions {
    fn default() -> Self {
        Self {
            baud: 921_600,
            latency_us: 1000,
            to_board: WireFaults::default(),
            to_host: WireFaults::default(),
            first_tick: 0,
            version: None,
        }
    }
}

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

/// A robot, its board and the line to it, advanced by the caller.
pub struct Simulation {
    plant: Plant,
    drives: DriveLine,
    board: Box<dyn VirtualBoard + Send>,
    to_board: Wire,
    to_host: Wire,
    now_us: u64,
    next_tick_us: u64,
    received: Vec<u8>,
    send: Vec<u8>,
    trace: Option<Vec<TracePoint>>,
    cell: Option<Cell>,
    board_powered: bool,
}

impl Simulation {
    /// A board just after power-on, on a plant that was placed before.
    ///
    /// # Errors
    /// [`PlantError::CableCount`] for a number of cables that a board cannot drive.
    pub fn new(plant: Plant, link: &LinkOptions, seed: u64) -> Result<Self, PlantError> {
        let tick = Tick(link.first_tick);
        let count = plant.cable_count();
        let board: Box<dyn VirtualBoard + Send> = match count {
            1 => Box::new(Board::<1>::new(tick, link.version)),
            2 => Box::new(Board::<2>::new(tick, link.version)),
            3 => Box::new(Board::<3>::new(tick, link.version)),
            4 => Box::new(Board::<4>::new(tick, link.version)),
            5 => Box::new(Board::<5>::new(tick, link.version)),
            6 => Box::new(Board::<6>::new(tick, link.version)),
            7 => Box::new(Board::<7>::new(tick, link.version)),
            8 => Box::new(Board::<8>::new(tick, link.version)),
            _ => return Err(PlantError::CableCount { count }),
        };
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
        // A salt of its own for each direction: their faults do not coincide.
        let wire = |faults, salt| Wire::new(link.baud, link.latency_us, faults, seed ^ salt);
        Self {
            next_tick_us: board.slice_us(),
            drives: DriveLine::new(&plant),
            plant,
            board,
            to_board: wire(link.to_board, 0x746F_5F62),
            to_host: wire(link.to_host, 0x746F_5F68),
            now_us: 0,
            received: Vec::new(),
            send: Vec::new(),
            trace: None,
            cell: None,
            board_powered: true,
        }
    }

    /// Virtual time, µs since the board got power.
    #[must_use]
    pub const fn now_us(&self) -> u64 {
        self.now_us
    }

    /// The host sends bytes now.
    pub fn send(&mut self, bytes: &[u8]) {
        self.to_board.send(self.now_us, bytes);
    }

    /// Advances until `until_us`, or until bytes have arrived for the host, which are appended to
    /// `into`. Time never runs backwards.
    ///
    /// # Errors
    /// The plant left the region in which its physics is valid.
    pub fn advance(&mut self, until_us: u64, into: &mut Vec<u8>) -> Result<(), PlantError> {
        loop {
            self.to_host.receive(self.now_us, into);
            if !into.is_empty() || self.now_us >= until_us {
                return Ok(());
            }
            let arrival = self.to_host.next_arrival_us().unwrap_or(u64::MAX);
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
        if on && !self.board_powered {
            self.plant.restart_encoders();
            self.board.power_on()?;
        }
        self.board_powered = on;
        Ok(())
    }

    /// A slice of time in which the board has no supply.
    fn unpowered(&mut self) -> Result<(), PlantError> {
        for cable in 0..self.plant.cable_count() {
            self.plant.set_brake(cable, true)?;
        }
        self.plant.set_gripper(false);
        let (plant, line) = (&mut self.plant, &mut self.drives);
        self.board.advance_unpowered(plant, line, self.now_us)?;
        // After the plant: the jaws are where the slice ends.
        if let Some(cell) = &mut self.cell {
            cell.step(&mut self.plant)?;
        }
        self.received.clear();
        // What arrives at a board without supply is lost.
        self.to_board.make_noise(self.now_us);
        self.to_board.receive(self.now_us, &mut self.received);
        self.to_board.take_framing_errors(self.now_us);
        self.next_tick_us += self.board.slice_us();
        if let Some(trace) = &mut self.trace
            && self.now_us.is_multiple_of(1000)
        {
            trace.push(TracePoint {
                tick: self.board.now(),
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
        if !self.board_powered {
            return self.unpowered();
        }
        let slice_us = self.board.slice_us();
        self.board
            .advance(&mut self.plant, &mut self.drives, self.now_us)?;
        if let Some(cell) = &mut self.cell {
            cell.step(&mut self.plant)?;
        }
        let before = self.board.now();
        self.received.clear();
        self.send.clear();
        self.to_board.make_noise(self.now_us);
        self.to_board.receive(self.now_us, &mut self.received);
        let line_errors = self.to_board.take_framing_errors(self.now_us);
        self.board.line_errors(line_errors);
        let backlog = self.to_host.backlog(self.now_us);
        self.board.tick(
            &mut self.plant,
            &mut self.drives,
            &self.received,
            backlog,
            &mut self.send,
        )?;
        self.to_host.send(self.now_us, &self.send);
        self.next_tick_us += slice_us;
        let Some(trace) = &mut self.trace else {
            return Ok(());
        };
        // A slice may be a part of a tick: one point per tick.
        if self.board.now() != before {
            trace.push(TracePoint {
                tick: self.board.now(),
                state: self.board.state(),
                path_ms: self.board.path_ms(),
                fault: self.board.fault(),
                torque_on: self.board.torque_on(),
                truth: self.plant.truth()?,
            });
        }
        // Some boards know a tick's path time only ticks later.
        for (tick, path_ms) in self.board.take_path_times() {
            let known = trace.iter_mut().rev().find(|point| point.tick == tick);
            if let Some(point) = known {
                point.path_ms = path_ms;
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
        let behind = self.board.path_times_behind();
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
    pub const fn drives(&self) -> &DriveLine {
        &self.drives
    }

    /// The drives' bus, to disturb: wires and electronics.
    pub const fn drives_mut(&mut self) -> &mut DriveLine {
        &mut self.drives
    }

    /// The board's state; for tests, a host asks over the line.
    #[must_use]
    pub fn state(&self) -> State {
        self.board.state()
    }

    /// Path time of the motion in progress, ms; for tests and fault injection.
    #[must_use]
    pub fn path_ms(&self) -> u32 {
        self.board.path_ms()
    }

    /// The fault that the board has latched; for tests, a host asks over the line.
    #[must_use]
    pub fn fault(&self) -> Option<FaultRecord> {
        self.board.fault()
    }

    /// Changes the faults on the line from now on.
    pub fn set_link_faults(&mut self, to_board: WireFaults, to_host: WireFaults) {
        self.to_board.set_faults(to_board);
        self.to_host.set_faults(to_host);
    }
}
