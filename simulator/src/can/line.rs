//! The board's bus with all its drives, for a board in the same process.

use super::bus::CanBus;
use super::nodes::DriveNodes;
use crate::plant::{Plant, PlantError};
use mcdpr_firmware::drives::{BusState, CanFrame, CanPort, Full};
use std::collections::VecDeque;

/// Time between two updates of the drives, µs: one step of the plant.
const STEP_US: u64 = 100;
/// The board's number on the bus.
const BOARD: usize = 0;
/// Frames that the board's controller holds until they are sent, and until they are read.
const QUEUE: usize = 16;
/// Time without a single frame sent, while some wait, after which the board drops them, µs: as the firmware does.
const STALE_US: u64 = 10_000;

/// The bus, the drives on it, and what the board has received.
#[derive(Debug, Clone)]
pub struct DriveLine {
    bus: CanBus,
    nodes: DriveNodes,
    received: VecDeque<CanFrame>,
    now_us: u64,
    /// When the board last had nothing to send, or sent something.
    sent_us: u64,
}

impl DriveLine {
    /// The drives of a plant on a bus of their bit rate.
    #[must_use]
    pub fn new(plant: &Plant) -> Self {
        let nodes = DriveNodes::new(plant);
        Self {
            bus: CanBus::new(plant.params().bus.bitrate, nodes.len()),
            nodes,
            received: VecDeque::new(),
            now_us: 0,
            sent_us: 0,
        }
    }

    /// The drives of these cables of a plant, on a bus of their bit rate.
    pub(crate) fn of(plant: &Plant, cables: &[usize]) -> Self {
        let mut line = Self::new(plant);
        line.nodes.keep(cables);
        line
    }

    /// Runs bus, drives and plant until `until_us`, a multiple of 100 µs later.
    ///
    /// # Errors
    /// The plant's.
    pub fn advance(&mut self, plant: &mut Plant, until_us: u64) -> Result<(), PlantError> {
        while self.now_us < until_us {
            let end_us = until_us.min(self.now_us + STEP_US);
            plant.advance(1e-6 * (end_us - self.now_us) as f64)?;
            self.follow(plant, end_us)?;
        }
        Ok(())
    }

    /// Runs bus and drives until `end_us`, at most 100 µs later. The plant is there already: several
    /// boards share it.
    ///
    /// # Errors
    /// The plant's.
    pub fn follow(&mut self, plant: &mut Plant, end_us: u64) -> Result<(), PlantError> {
        {
            // The plant's `bus_off` means dead wires: here they are shorted.
            self.bus.faults_mut().shorted = plant.faults().bus_off;
            for drive in 0..self.nodes.len() {
                self.bus.connect(drive + 1, plant.drive_has_supply(drive));
            }
            while let Some(delivery) = self.bus.next(end_us) {
                if delivery.from == BOARD {
                    self.sent_us = end_us;
                } else if self.received.len() < QUEUE {
                    self.received.push_back(delivery.frame);
                }
                let (bus, from) = (&mut self.bus, delivery.from.checked_sub(1));
                let mut send = |drive, at, frame| bus.offer(drive + 1, at, frame);
                self.nodes
                    .hear(plant, delivery.at_us, from, &delivery.frame, &mut send)?;
            }
            let bus = &mut self.bus;
            let mut send = |drive, at, frame| bus.offer(drive + 1, at, frame);
            self.nodes.pass(plant, end_us, &mut send)?;
            self.now_us = end_us;
            if self.bus.waiting(BOARD) == 0 {
                self.sent_us = end_us;
            } else if end_us >= self.sent_us + STALE_US {
                self.bus.drop_waiting(BOARD);
                self.sent_us = end_us;
            }
        }
        Ok(())
    }

    /// The board's CAN controller.
    pub const fn port(&mut self) -> BoardPort<'_> {
        BoardPort { line: self }
    }

    /// The wires.
    #[must_use]
    pub const fn bus(&self) -> &CanBus {
        &self.bus
    }

    /// The wires, to disturb.
    pub const fn bus_mut(&mut self) -> &mut CanBus {
        &mut self.bus
    }

    /// The drives' electronics, to break.
    pub const fn nodes_mut(&mut self) -> &mut DriveNodes {
        &mut self.nodes
    }
}

/// The board's CAN controller, at the time that the line has reached.
pub struct BoardPort<'a> {
    line: &'a mut DriveLine,
}

impl CanPort for BoardPort<'_> {
    fn set_bitrate(&mut self, bits_per_s: u32) {
        self.line.received.clear();
        self.line.bus.restart(BOARD, bits_per_s);
    }

    fn send(&mut self, frame: &CanFrame) -> Result<(), Full> {
        let off = self.line.bus.state(BOARD) == BusState::Off;
        if off || self.line.bus.waiting(BOARD) >= QUEUE {
            return Err(Full);
        }
        self.line.bus.offer(BOARD, self.line.now_us, *frame);
        Ok(())
    }

    fn receive(&mut self) -> Option<CanFrame> {
        self.line.received.pop_front()
    }

    fn state(&self) -> BusState {
        self.line.bus.state(BOARD)
    }
}
