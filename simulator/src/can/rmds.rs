//! A simulated RoboModule RMDS: effects of its manual's frames on the motor.

use super::nodes::{NodeFault, Outbox};
use crate::plant::{DriveCommand, DriveState, Mode, Plant, PlantError};
use mcdpr_firmware::drives::CanFrame;

/// One drive's electronics.
#[derive(Debug, Clone)]
pub(super) struct Rmds {
    number: u8,
    period_us: u64,
    next_us: u64,
}

impl Rmds {
    pub fn new(number: u8) -> Self {
        Self {
            number,
            period_us: 0,
            next_us: u64::MAX,
        }
    }

    pub fn hear(
        &mut self,
        plant: &mut Plant,
        index: usize,
        fault: &NodeFault,
        at_us: u64,
        frame: &CanFrame,
        out: Outbox<'_>,
    ) -> Result<(), PlantError> {
        let own = fault.node.unwrap_or(self.number);
        // Identifier: group, number, function, four bits each; number 0 calls the whole group.
        let (group, number) = ((frame.id >> 8) as u8, (frame.id >> 4) as u8 & 0xF);
        let called = group == own >> 4 && (number == own & 0xF || number == 0);
        if !called || frame.len != 8 {
            return Ok(());
        }
        let data = &frame.data;
        let word = |at: usize| i16::from_be_bytes([data[at], data[at + 1]]);
        let command = match frame.id & 0xF {
            0x0 if *data == [0x55; 8] => {
                self.period_us = 0;
                self.next_us = u64::MAX;
                DriveCommand::Reset
            }
            0x1 => match data[0] {
                2 => DriveCommand::SelectMode(Mode::Current),
                3 => DriveCommand::SelectMode(Mode::Velocity),
                5 => DriveCommand::SelectMode(Mode::Position),
                _ => return Ok(()),
            },
            0x3 => DriveCommand::Current { milliamps: word(2) },
            0x4 => DriveCommand::Velocity { rpm: word(2) },
            0x6 => DriveCommand::Position {
                counts: i64::from(i32::from_be_bytes([data[4], data[5], data[6], data[7]])),
                rpm_limit: u16::from_be_bytes([data[2], data[3]]),
            },
            0xA => {
                if answers(plant.drive_state(index)?) {
                    self.period_us = u64::from(data[0]) * 1000;
                    self.next_us = at_us + self.period_us;
                }
                return Ok(());
            }
            0xF => {
                // The electronics answer as soon as they have power, but not while they restart.
                if plant.drive_state(index)? != DriveState::Resetting {
                    out(at_us, self.frame(fault, 0xF, [0x55; 8]));
                }
                return Ok(());
            }
            _ => return Ok(()),
        };
        // A drive with a fault gives no torque, but can be reset.
        if fault.fault.is_some() && command != DriveCommand::Reset {
            return plant.command_drive(index, DriveCommand::Off);
        }
        plant.command_drive(index, command)
    }

    pub fn pass(
        &mut self,
        plant: &mut Plant,
        index: usize,
        fault: &NodeFault,
        now_us: u64,
        out: Outbox<'_>,
    ) -> Result<(), PlantError> {
        if !answers(plant.drive_state(index)?) {
            // Power was lost, and with it the setting.
            self.next_us = u64::MAX;
            return Ok(());
        }
        if self.period_us == 0 || now_us < self.next_us {
            return Ok(());
        }
        // From the time that was due, not from now: the period does not drift.
        self.next_us += self.period_us;
        let feedback = plant.drive_feedback(index)?;
        let [a, b] = feedback.current_ma.to_be_bytes();
        let [c, d] = feedback.rpm.to_be_bytes();
        let [e, f, g, h] = feedback.counts.to_be_bytes();
        out(now_us, self.frame(fault, 0xB, [a, b, c, d, e, f, g, h]));
        Ok(())
    }

    fn frame(&self, fault: &NodeFault, function: u16, data: [u8; 8]) -> CanFrame {
        let node = u16::from(fault.node.unwrap_or(self.number));
        CanFrame {
            id: (node << 4) | function,
            len: 8,
            data,
        }
    }
}

fn answers(state: DriveState) -> bool {
    !matches!(state, DriveState::Unpowered | DriveState::Resetting)
}
