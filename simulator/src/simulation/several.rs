//! Several boards on one plant, each with its own clock, bus and line.
//!
//! Every board counts its own milliseconds: its crystal is off by some parts in a million, and its
//! first tick begins somewhere within a millisecond. The plant has the true time. It advances to
//! each board's next step in turn, so that every board reads its sensors and sets its outputs when
//! its own clock says so.

use crate::board::{BoardFailure, VirtualBoard, core};
use crate::can::DriveLine;
use crate::plant::{Plant, PlantError};
use crate::wire::LinkOptions;

use super::{Port, Simulation};
use mcdpr_firmware::State;
use mcdpr_protocol::{PerCable, TenthMicrometres, Tick};
use std::f64::consts::TAU;

/// Step of a board's bus, µs of the board's time: one step of the plant.
const STEP_US: u64 = 100;

/// A board's clock against true time.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct BoardTime {
    /// How much slower than true its crystal is, parts in a million; negative is faster.
    pub slow_ppm: f64,
    /// When its first millisecond begins, true time, µs.
    pub begins_us: f64,
    /// Greatest further change by temperature, parts in a million: a sine over time, slower first; negative is faster
    /// first.
    pub swing_ppm: f64,
    /// Period of that change, s; 0 for none.
    pub swing_s: f64,
}

impl BoardTime {
    /// True time of a moment of the board's own time, both µs.
    #[must_use]
    pub(crate) fn true_us(&self, own_us: f64) -> f64 {
        let steady_us = self.begins_us + own_us * (1.0 + self.slow_ppm * 1e-6);
        if self.swing_s <= 0.0 {
            return steady_us;
        }
        // The sine of the rate, integrated.
        let per_us = TAU / (self.swing_s * 1e6);
        steady_us + self.swing_ppm * 1e-6 * (1.0 - libm::cos(own_us * per_us)) / per_us
    }
}

/// What one of several boards does in a tick. For studies and tests: a host cannot see it.
#[derive(Debug, Clone)]
pub struct BoardPoint {
    /// Board, from 0.
    pub board: usize,
    /// True time of the tick, µs.
    pub at_us: f64,
    /// The board's state.
    pub state: State,
    /// The board's path time from the moment at which the robot's path begins on the first board, ms.
    pub path_ms: u32,
    /// Paid-out lengths that it wants, by channel.
    pub lengths: PerCable<TenthMicrometres>,
}

/// A board's clock and how far it has come.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Clock {
    time: BoardTime,
    /// Steps done.
    steps: u64,
}

impl Clock {
    /// True time of the end of a step, ns.
    #[expect(
        clippy::cast_precision_loss,
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "hours in ns are exact"
    )]
    fn end_ns(&self, step_us: u64) -> u64 {
        let own_us = ((self.steps + 1) * step_us) as f64;
        (self.time.true_us(own_us) * 1e3) as u64
    }
}

/// A board's connection to the fault line that all boards of a robot share.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum FaultLineTap {
    /// As in the wiring guide.
    #[default]
    Whole,
    /// Its plug is pulled: it sees its own pull-down, and no other board sees it.
    Cut,
    /// Its transistor does not pull: no board sees it, but it sees the others.
    Mute,
    /// Its input is shorted to 3.3 V: it sees nothing, the others see it.
    Deaf,
}

/// One of several boards.
pub struct BoardPlace {
    /// The plant's cable on each of its channels, from 0.
    pub cables: Vec<usize>,
    /// Its clock.
    pub time: BoardTime,
    /// Its line.
    pub link: LinkOptions,
    /// The board; `None` is the control core in this process.
    pub board: Option<Box<dyn VirtualBoard + Send>>,
}

fn step_of(port: &Port) -> u64 {
    port.board.slice_us().min(STEP_US)
}

impl Simulation {
    /// Several boards just after power-on, on a plant that was placed before. The gripper is on the
    /// first.
    ///
    /// # Errors
    /// [`PlantError::CableCount`] for a number of cables that a board cannot drive, and for no board.
    pub fn with_boards(
        plant: Plant,
        places: Vec<BoardPlace>,
        seed: u64,
    ) -> Result<Self, PlantError> {
        let mut ports = Vec::new();
        for (number, place) in (0_u8..).zip(places) {
            let board = match place.board {
                Some(board) => board,
                None => core(&place.link, &place.cables, number)?,
            };
            let clock = Clock {
                time: place.time,
                steps: 0,
            };
            let drives = DriveLine::of(&plant, &place.cables);
            let seed = seed ^ (u64::from(number) << 32);
            let mut port = Port::new(drives, board, &place.link, seed, clock);
            port.cables = place.cables;
            ports.push(port);
        }
        if ports.is_empty() {
            return Err(PlantError::CableCount { count: 0 });
        }
        Ok(Self::of_ports(plant, ports, 0))
    }

    /// Boards.
    #[must_use]
    pub fn boards(&self) -> usize {
        self.ports.len()
    }

    /// The host sends bytes now, to one of several boards, from 0.
    pub fn send_to(&mut self, board: usize, bytes: &[u8]) {
        self.ports[board].to_board.send(self.now_us, bytes);
    }

    /// As [`Simulation::advance`] for several lines: until bytes have arrived on any of them, which
    /// are appended to its place of `into`.
    ///
    /// # Errors
    /// The plant left the region in which its physics is valid.
    pub fn advance_all(&mut self, until_us: u64, into: &mut [Vec<u8>]) -> Result<(), PlantError> {
        loop {
            for (port, into) in self.ports.iter_mut().zip(into.iter_mut()) {
                port.to_host.receive(self.now_us, into);
            }
            if into.iter().any(|bytes| !bytes.is_empty()) || self.now_us >= until_us {
                return Ok(());
            }
            let arrivals = self
                .ports
                .iter()
                .filter_map(|p| p.to_host.next_arrival_us());
            let arrival_us = arrivals.min().unwrap_or(u64::MAX);
            let next = self.ports.iter().enumerate();
            let next = next.map(|(index, port)| (port.clock.end_ns(step_of(port)), index));
            let Some((due_ns, board)) = next.min() else {
                return Ok(());
            };
            let due_us = due_ns.div_ceil(1000);
            let wait_us = until_us.min(arrival_us);
            if wait_us < due_us {
                self.now_us = self.now_us.max(wait_us);
                continue;
            }
            self.now_us = self.now_us.max(due_us);
            self.step_board(board, due_ns)?;
        }
    }

    /// Lets one board do its next step, at true time `due_ns`.
    fn step_board(&mut self, board: usize, due_ns: u64) -> Result<(), PlantError> {
        #[expect(clippy::cast_precision_loss, reason = "at most a step")]
        let duration_s = due_ns.saturating_sub(self.plant_ns) as f64 * 1e-9;
        self.plant.advance(duration_s)?;
        self.plant_ns = self.plant_ns.max(due_ns);
        let now_us = self.now_us;
        let port = &mut self.ports[board];
        let step_us = step_of(port);
        port.clock.steps += 1;
        let own_us = port.clock.steps * step_us;
        let (plant, drives) = (&mut self.plant, &mut port.drives);
        if !port.powered {
            for &cable in &port.cables {
                plant.set_brake(cable, true)?;
                plant.set_drive_enable(cable, false)?;
            }
            port.board.follow_unpowered(plant, drives, own_us)?;
            port.lose_bytes(now_us, &mut self.received);
            let tick = port.board.now();
            return if board == 0 && own_us.is_multiple_of(1000) {
                self.note_unpowered(tick)
            } else {
                Ok(())
            };
        }
        port.board.follow(plant, drives, own_us)?;
        if !own_us.is_multiple_of(port.board.slice_us()) {
            return Ok(());
        }
        if board == 0
            && let Some(cell) = &mut self.cell
        {
            cell.step(&mut self.plant)?;
        }
        let high = self.fault_line_at(board);
        let port = &mut self.ports[board];
        port.board.hear_fault_line(high);
        let before = port.board.now();
        port.work(&mut self.plant, now_us, &mut self.received, &mut self.send)?;
        self.note_board(board, before, due_ns);
        if board == 0 {
            self.note_tick(before)
        } else {
            Ok(())
        }
    }

    /// The record's point of a board's tick.
    fn note_board(&mut self, board: usize, before: Tick, due_ns: u64) {
        let (Some(points), Some(port)) = (&mut self.points, self.ports.get(board)) else {
            return;
        };
        // A slice may be a part of a tick: one point per tick.
        if port.board.now() != before {
            #[expect(clippy::cast_precision_loss, reason = "days in ns are exact")]
            let at_us = due_ns as f64 * 1e-3;
            points.push(BoardPoint {
                board,
                at_us,
                state: port.board.state(),
                path_ms: port.board.path_ms().saturating_sub(self.path_zero_ms),
                lengths: port.board.wanted(),
            });
        }
    }

    /// Starts recording what each of several boards does in its ticks.
    pub fn record_boards(&mut self) {
        self.points.get_or_insert_default();
    }

    /// What the boards did since the last call, in the order of time.
    pub fn take_boards(&mut self) -> Vec<BoardPoint> {
        self.points.as_mut().map(std::mem::take).unwrap_or_default()
    }

    /// Level of the fault line at a board's input.
    fn fault_line_at(&self, board: usize) -> bool {
        let pulled = self.ports.iter().any(|port| {
            let reaches = matches!(port.fault_line, FaultLineTap::Whole | FaultLineTap::Deaf);
            // A transistor whose gate nobody holds low pulls: its supply comes with the line.
            reaches && !(port.powered && port.board.lets_fault_line_rise())
        });
        match self.ports[board].fault_line {
            FaultLineTap::Whole | FaultLineTap::Mute => !pulled,
            FaultLineTap::Cut => false,
            FaultLineTap::Deaf => true,
        }
    }

    /// Damages one board's connection to the fault line, from 0, or mends it.
    pub fn set_fault_line_of(&mut self, board: usize, tap: FaultLineTap) {
        if let Some(port) = self.ports.get_mut(board) {
            port.fault_line = tap;
        }
    }

    /// As [`Simulation::fail_board`], for one of several boards, from 0.
    ///
    /// # Errors
    /// As there.
    pub fn fail_board_of(
        &mut self,
        board: usize,
        failure: BoardFailure,
        on: bool,
    ) -> Result<(), PlantError> {
        let port = &mut self.ports[board];
        if port.board.fail(failure, on) {
            return Ok(());
        }
        if on && port.powered {
            // Its counters start at zero with the chip, some 20 us after the failure.
            self.plant.restart_encoders(&port.cables);
            port.powered = false;
        } else if !on && !port.powered {
            port.board.restart(failure)?;
            port.powered = true;
        }
        Ok(())
    }

    /// The robot's path begins when the first board's path time is this, ms: the record counts from
    /// there.
    pub const fn set_path_zero(&mut self, ms: u32) {
        self.path_zero_ms = ms;
    }

    /// Path time of one of several boards, ms, and its state; for tests.
    #[must_use]
    pub fn look_at(&self, board: usize) -> (mcdpr_firmware::State, u32) {
        let board = &self.ports[board].board;
        (board.state(), board.path_ms())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 30 ppm slow, and up to 10 ppm more or less by temperature, within 20 minutes.
    const WARMED: BoardTime = BoardTime {
        slow_ppm: 30.0,
        begins_us: 700.0,
        swing_ppm: 10.0,
        swing_s: 1200.0,
    };

    #[test]
    fn a_crystals_rate_swings_with_its_temperature() {
        // Rate over a second, less that of true time, ppm.
        let ppm_at = |own_s: f64| {
            let at = |second: f64| WARMED.true_us(second * 1e6);
            at(own_s + 1.0) - at(own_s) - 1e6
        };
        for (own_s, ppm) in [(0.0, 30.0), (300.0, 40.0), (600.0, 30.0), (900.0, 20.0)] {
            assert!(
                (ppm_at(own_s) - ppm).abs() < 0.1,
                "{own_s} s: {}",
                ppm_at(own_s)
            );
        }
        // Nothing is left of it after a period.
        let whole_us = WARMED.true_us(1.2e9) - 700.0;
        assert!(
            (whole_us - 1.2e9 * (1.0 + 30e-6)).abs() < 1e-3,
            "{whole_us}"
        );
    }
}
