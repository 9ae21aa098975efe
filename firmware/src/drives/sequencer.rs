//! Bringing a drive into its mode: what the RoboModule RMDS needs between "off" and "obeys".
//!
//! The drive restarts for half a second after a reset, during which it is silent, and takes half a
//! second to enter a mode (`docs/paper-notes.md`: the drive is inferred, so are its times).

use super::drive::Mode;
use super::rmds::{MODE_MS, RESET_MS};
use crate::io::DriveDemand;

/// Slack for the bus: a command may wait for its slot.
const SLOT_MS: u16 = 10;

/// What goes to the drive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BusCommand {
    /// Nothing new.
    Nothing,
    /// Torque off.
    Off,
    /// Restart.
    Reset,
    /// Choose a mode.
    Select(Mode),
    /// Go there, no faster than this.
    Position {
        /// Motor counts.
        counts: i32,
        /// Speed limit, rpm.
        rpm: u16,
    },
    /// Give this current.
    Current {
        /// Milliamperes.
        ma: i16,
    },
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
enum Phase {
    #[default]
    Cold,
    Resetting(u16),
    Idle,
    Selecting(Mode, u16),
    Ready(Mode),
}

/// One drive's way from cold to obeying.
#[derive(Debug, Clone, Copy, Default)]
pub struct Sequencer {
    phase: Phase,
}

impl Sequencer {
    /// Whether the drive obeys the demand's mode.
    #[must_use]
    pub fn is_ready(&self, demand: DriveDemand) -> bool {
        mode(demand).is_some_and(|mode| self.phase == Phase::Ready(mode))
    }

    /// One tick: what to send. `answers` is whether feedback is fresh.
    pub fn tick(&mut self, demand: DriveDemand, answers: bool) -> BusCommand {
        let Some(wanted) = mode(demand) else {
            let was_on = matches!(self.phase, Phase::Selecting(..) | Phase::Ready(_));
            if was_on {
                self.phase = Phase::Idle;
            }
            return if was_on {
                BusCommand::Off
            } else {
                BusCommand::Nothing
            };
        };
        match self.phase {
            Phase::Cold => {
                self.phase = Phase::Resetting(RESET_MS + SLOT_MS);
                BusCommand::Reset
            }
            Phase::Resetting(0) if answers => self.select(wanted),
            Phase::Resetting(left) => {
                self.phase = Phase::Resetting(left.saturating_sub(1));
                BusCommand::Nothing
            }
            Phase::Idle => self.select(wanted),
            Phase::Selecting(mode, _) | Phase::Ready(mode) if mode != wanted => self.select(wanted),
            Phase::Selecting(mode, 0) => {
                self.phase = Phase::Ready(mode);
                BusCommand::Nothing
            }
            Phase::Selecting(mode, left) => {
                self.phase = Phase::Selecting(mode, left - 1);
                BusCommand::Nothing
            }
            Phase::Ready(_) => match demand {
                DriveDemand::Position { counts, rpm } => BusCommand::Position { counts, rpm },
                DriveDemand::Current { ma } => BusCommand::Current { ma },
                DriveDemand::Off | DriveDemand::EnablePosition | DriveDemand::EnableCurrent => {
                    BusCommand::Nothing
                }
            },
        }
    }

    fn select(&mut self, mode: Mode) -> BusCommand {
        self.phase = Phase::Selecting(mode, MODE_MS + SLOT_MS);
        BusCommand::Select(mode)
    }
}

fn mode(demand: DriveDemand) -> Option<Mode> {
    match demand {
        DriveDemand::Off => None,
        DriveDemand::EnablePosition | DriveDemand::Position { .. } => Some(Mode::Position),
        DriveDemand::EnableCurrent | DriveDemand::Current { .. } => Some(Mode::Current),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cold_drive_is_reset_then_put_in_its_mode_and_only_then_commanded() {
        let mut sequencer = Sequencer::default();
        let demand = DriveDemand::Current { ma: 7 };
        let mut sent = heapless::Vec::<(u32, BusCommand), 8>::new();
        for tick in 0..1100 {
            let command = sequencer.tick(demand, tick > 505);
            if command != BusCommand::Nothing
                && sent.last().is_none_or(|(_, last)| *last != command)
            {
                sent.push((tick, command)).unwrap();
            }
            assert_eq!(sequencer.is_ready(demand), tick > 1021, "tick {tick}");
        }
        assert_eq!(
            sent.as_slice(),
            [
                (0, BusCommand::Reset),
                (511, BusCommand::Select(Mode::Current)),
                (1023, BusCommand::Current { ma: 7 })
            ]
        );
        assert_eq!(sequencer.tick(DriveDemand::Off, true), BusCommand::Off);
        assert!(!sequencer.is_ready(demand));
    }

    #[test]
    fn a_silent_drive_never_becomes_ready() {
        let mut sequencer = Sequencer::default();
        for _ in 0..5000 {
            sequencer.tick(DriveDemand::EnablePosition, false);
            assert!(!sequencer.is_ready(DriveDemand::EnablePosition));
        }
    }
}
