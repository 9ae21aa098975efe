//! A simulated CiA 402 drive: CANopen's services and the power state machine.

use super::nodes::{NodeFault, ObjectAddress, Outbox};
use super::objects::{NO_OBJECT, Objects};
use crate::plant::{DriveCommand, DriveState, Mode, Plant, PlantError, WinchParams};
use mcdpr_firmware::drives::CanFrame;

/// State of the communication (CiA 301).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Network {
    /// No power, or starting.
    Off,
    PreOperational,
    Operational,
    Stopped,
}

/// State of the power electronics (CiA 402).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Power {
    SwitchOnDisabled,
    ReadyToSwitchOn,
    SwitchedOn,
    OperationEnabled,
    Fault,
}

/// From a start of the communication to the boot-up message, µs.
const BOOT_US: u64 = 20_000;
/// Emergency code: the monitored heartbeat is missing.
const BOARD_LOST: u16 = 0x8130;
/// Emergency code: excess temperature of the drive.
const HOT: u16 = 0x4310;

/// One drive's electronics.
#[derive(Debug, Clone)]
pub(super) struct Cia402 {
    number: u8,
    rated_ma: u32,
    objects: Objects,
    network: Network,
    boots_at_us: u64,
    power: Power,
    last_control: u16,
    next_beat_us: u64,
    syncs: [u8; 3],
    heard_board_us: Option<u64>,
    emergency: u16,
    /// Set-points in position mode: the one before, the last, and when it came.
    way: Option<(i32, i32, u64)>,
}

impl Cia402 {
    pub fn new(number: u8, winch: &WinchParams) -> Self {
        // A motor may give half as much again as it is rated for.
        let rated_ma = (winch.max_current_a * 1e3 / 1.5).round().max(1.0) as u32;
        Self {
            number,
            rated_ma,
            objects: Objects::new(number, rated_ma),
            network: Network::Off,
            boots_at_us: 0,
            power: Power::SwitchOnDisabled,
            last_control: 0,
            next_beat_us: 0,
            syncs: [0; 3],
            heard_board_us: None,
            emergency: 0,
            way: None,
        }
    }

    fn node(&self, fault: &NodeFault) -> u16 {
        u16::from(fault.node.unwrap_or(self.number))
    }

    fn restart(&mut self, fault: &NodeFault, now_us: u64) {
        *self = Self {
            number: self.number,
            rated_ma: self.rated_ma,
            objects: Objects::new(self.node(fault) as u8, self.rated_ma),
            network: Network::Off,
            boots_at_us: now_us + BOOT_US + 1000 * u64::from(fault.boots_late_ms),
            power: self.power,
            last_control: 0,
            next_beat_us: u64::MAX,
            syncs: [0; 3],
            heard_board_us: None,
            emergency: 0,
            way: None,
        };
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
        let node = self.node(fault);
        let bytes = &frame.data[..usize::from(frame.len.min(8))];
        match (frame.id, bytes) {
            // Network management: a command and a node, of which 0 calls all.
            (0x000, &[command, called]) if called == 0 || u16::from(called) == node => {
                self.manage(plant, index, fault, at_us, command)
            }
            (0x080, []) if self.network == Network::Operational => {
                self.synchronise(plant, index, fault, at_us, out)
            }
            // The board's heartbeat: it is node 127 (0x700 + 0x7F).
            (0x77F, [_]) => {
                self.heard_board_us = Some(at_us);
                Ok(())
            }
            (id, bytes) if id == 0x600 + node && bytes.len() == 8 => {
                if matches!(self.network, Network::PreOperational | Network::Operational) {
                    self.serve(fault, at_us, bytes, out);
                }
                Ok(())
            }
            (id, bytes) if self.network == Network::Operational => {
                let entry = self.objects.get(0x1400, 1);
                // Bit 31 of a PDO's identifier switches it off.
                let mine = entry >> 31 == 0 && u32::from(id) == entry & 0x7FF;
                if mine && self.objects.unpack(0x1600, bytes) {
                    self.command(plant, index, fault, at_us, out)?;
                }
                Ok(())
            }
            _ => Ok(()),
        }
    }

    fn manage(
        &mut self,
        plant: &mut Plant,
        index: usize,
        fault: &NodeFault,
        at_us: u64,
        command: u8,
    ) -> Result<(), PlantError> {
        match command {
            // 0x01 starts, 0x02 stops, 0x80 back to pre-operational, 0x81 and 0x82 reset (CiA 301).
            0x01 if self.network != Network::Off => self.network = Network::Operational,
            0x02 if self.network != Network::Off => {
                self.network = Network::Stopped;
                self.disable(plant, index)?;
            }
            0x80 if self.network != Network::Off => self.network = Network::PreOperational,
            0x81 | 0x82 => {
                self.disable(plant, index)?;
                self.restart(fault, at_us);
            }
            _ => {}
        }
        Ok(())
    }

    /// Expedited transfers only: no object of such a drive is longer than four bytes.
    fn serve(&mut self, fault: &NodeFault, at_us: u64, request: &[u8], out: Outbox<'_>) {
        let node = self.node(fault);
        let address = ObjectAddress {
            index: u16::from_le_bytes([request[1], request[2]]),
            sub: request[3],
        };
        let value = u32::from_le_bytes([request[4], request[5], request[6], request[7]]);
        let outcome = match request[0] {
            _ if fault.lacks == Some(address) => Err(NO_OBJECT),
            0x40 => self.objects.read(address).map(|(size, value)| {
                let command = 0x43 | ((4 - size) << 2);
                (command, value)
            }),
            // Expedited with its size given: unused bytes in bits 2 and 3.
            command if command & 0xF3 == 0x23 => {
                let size = 4 - ((command >> 2) & 3);
                let written = self.objects.write(address, size, value);
                written.map(|()| (0x60, 0))
            }
            _ => Err(NO_OBJECT),
        };
        // 0x80 aborts the transfer; the code says why.
        let (command, value) = outcome.unwrap_or_else(|code| (0x80, code));
        let [low, high] = address.index.to_le_bytes();
        let [a, b, c, d] = value.to_le_bytes();
        let data = [command, low, high, address.sub, a, b, c, d];
        out(
            at_us,
            CanFrame {
                id: 0x580 + node,
                len: 8,
                data,
            },
        );
    }

    fn synchronise(
        &mut self,
        plant: &mut Plant,
        index: usize,
        fault: &NodeFault,
        at_us: u64,
        out: Outbox<'_>,
    ) -> Result<(), PlantError> {
        self.refresh(plant, index, fault)?;
        for pdo in 0..3_u16 {
            let entry = self.objects.get(0x1800 + pdo, 1);
            let kind = self.objects.get(0x1800 + pdo, 2) as u8;
            // 1 to 240: at every so many SYNCs.
            if entry >> 31 == 1 || !(1..=240).contains(&kind) {
                continue;
            }
            let passed = &mut self.syncs[usize::from(pdo)];
            *passed += 1;
            if *passed < kind {
                continue;
            }
            *passed = 0;
            let (data, len) = self.objects.pack(0x1A00 + pdo);
            let id = (entry & 0x7FF) as u16;
            out(at_us, CanFrame { id, len, data });
        }
        Ok(())
    }

    /// Brings what the bus can read up to date.
    fn refresh(
        &mut self,
        plant: &mut Plant,
        index: usize,
        fault: &NodeFault,
    ) -> Result<(), PlantError> {
        let ready = matches!(plant.drive_state(index)?, DriveState::Ready(_));
        // CiA 402: 0x0200 is remote, 0x10 voltage on, the other bits name the state.
        let status = match self.power {
            Power::SwitchOnDisabled => 0x0240,
            Power::ReadyToSwitchOn => 0x0231,
            Power::SwitchedOn => 0x0233,
            // Reported only when the motor is under control.
            Power::OperationEnabled if ready => 0x0237,
            Power::OperationEnabled => 0x0233,
            Power::Fault => 0x0208,
        };
        // Bit 7 is a warning: the drive continues.
        let warning = if fault.hot { 0x80 } else { 0 };
        self.objects.set(0x6041, 0, status | warning);
        let mode = fault.mode.unwrap_or(self.objects.get(0x6060, 0) as u8);
        self.objects.set(0x6061, 0, u32::from(mode));
        let feedback = plant.drive_feedback(index)?;
        self.objects.set(0x6064, 0, feedback.counts.cast_unsigned());
        // In thousandths of the rated current, with the sign of the current.
        let torque = i32::from(feedback.current_ma) * 1000 / self.rated_ma.max(1) as i32;
        self.objects.set(0x6077, 0, (torque as u32) & 0xFFFF);
        Ok(())
    }

    /// A command: control word, then the target of the mode.
    fn command(
        &mut self,
        plant: &mut Plant,
        index: usize,
        fault: &NodeFault,
        at_us: u64,
        out: Outbox<'_>,
    ) -> Result<(), PlantError> {
        let control = self.objects.get(0x6040, 0) as u16;
        // A fault is reset by a rising edge of bit 7: a bit that stays set resets nothing more.
        let rises = control & 0x80 != 0 && self.last_control & 0x80 == 0;
        self.last_control = control;
        let next = match (self.power, control & 0x0F) {
            (Power::Fault, _) if rises && fault.fault.is_none() => {
                self.send_emergency(fault, 0, at_us, out);
                Power::SwitchOnDisabled
            }
            (Power::Fault, _) => Power::Fault,
            // Bit 1 clear disables the voltage, bit 2 clear is a quick stop: both end the torque
            // here.
            (_, bits) if bits & 0x02 == 0 || bits & 0x04 == 0 => Power::SwitchOnDisabled,
            (Power::SwitchOnDisabled, 0x06) => Power::ReadyToSwitchOn,
            (Power::ReadyToSwitchOn, 0x07) => Power::SwitchedOn,
            (Power::SwitchedOn, 0x0F) => Power::OperationEnabled,
            (Power::SwitchedOn | Power::OperationEnabled, 0x06) => Power::ReadyToSwitchOn,
            (Power::OperationEnabled, 0x07) => Power::SwitchedOn,
            (state, _) => state,
        };
        if next != self.power {
            let was_on = self.power == Power::OperationEnabled;
            self.power = next;
            if was_on {
                self.way = None;
                return plant.command_drive(index, DriveCommand::Off);
            }
            if next == Power::OperationEnabled {
                // Cyclic synchronous modes of CiA 402: position, velocity, torque.
                let mode = match self.objects.get(0x6060, 0) {
                    8 => Mode::Position,
                    9 => Mode::Velocity,
                    10 => Mode::Current,
                    _ => return Ok(()),
                };
                plant.command_drive(index, DriveCommand::SelectMode(mode))?;
            }
        }
        if self.power != Power::OperationEnabled {
            return Ok(());
        }
        match plant.drive_state(index)? {
            DriveState::Ready(Mode::Position) => {
                // The first set-point has none before it: the drive goes there without
                // interpolation.
                let target = self.objects.get(0x607A, 0).cast_signed();
                let from = self.way.map_or(target, |(_, last, _)| last);
                self.way = Some((from, target, at_us));
                Ok(())
            }
            DriveState::Ready(Mode::Velocity) => {
                let most = self.objects.get(0x6080, 0).min(0x7FFF) as i32;
                let asked = self.objects.get(0x60FF, 0).cast_signed();
                let rpm = asked.clamp(-most, most) as i16;
                plant.command_drive(index, DriveCommand::Velocity { rpm })
            }
            DriveState::Ready(Mode::Current) => {
                let most = self.objects.get(0x6072, 0).min(0x7FFF) as i32;
                let share = i32::from(self.objects.get(0x6071, 0) as u16 as i16);
                let ma = share.clamp(-most, most) * self.rated_ma as i32 / 1000;
                let milliamps = ma.clamp(-0x7FFF, 0x7FFF) as i16;
                plant.command_drive(index, DriveCommand::Current { milliamps })
            }
            _ => Ok(()),
        }
    }

    pub fn pass(
        &mut self,
        plant: &mut Plant,
        index: usize,
        fault: &NodeFault,
        now_us: u64,
        out: Outbox<'_>,
    ) -> Result<(), PlantError> {
        match plant.drive_state(index)? {
            // The supply is back: the electronics start as after delivery, and so does the motor.
            DriveState::Unpowered if plant.drive_has_supply(index) => {
                self.power = Power::SwitchOnDisabled;
                self.restart(fault, now_us);
                return plant.command_drive(index, DriveCommand::Reset);
            }
            DriveState::Unpowered | DriveState::Resetting => {
                self.network = Network::Off;
                return Ok(());
            }
            _ => {}
        }
        if self.network == Network::Off {
            if now_us >= self.boots_at_us {
                self.network = Network::PreOperational;
                self.next_beat_us = now_us;
                self.beat(fault, now_us, 0x00, out);
            }
            return Ok(());
        }
        self.keep_beating(fault, now_us, out);
        self.watch(plant, index, fault, now_us, out)?;
        self.go_on(plant, index, now_us)
    }

    fn keep_beating(&mut self, fault: &NodeFault, now_us: u64, out: Outbox<'_>) {
        let every_us = u64::from(self.objects.get(0x1017, 0)) * 1000;
        if every_us == 0 || now_us < self.next_beat_us || fault.no_heartbeat {
            return;
        }
        self.next_beat_us = now_us + every_us;
        let state = match self.network {
            Network::Operational => 0x05,
            Network::Stopped => 0x04,
            Network::PreOperational | Network::Off => 0x7F,
        };
        self.beat(fault, now_us, state, out);
    }

    fn beat(&self, fault: &NodeFault, now_us: u64, state: u8, out: Outbox<'_>) {
        let mut data = [0; 8];
        data[0] = state;
        let id = 0x700 + self.node(fault);
        out(now_us, CanFrame { id, len: 1, data });
    }

    /// Its own faults, heat, and the board's heartbeat.
    fn watch(
        &mut self,
        plant: &mut Plant,
        index: usize,
        fault: &NodeFault,
        now_us: u64,
        out: Outbox<'_>,
    ) -> Result<(), PlantError> {
        let watched = self.objects.get(0x1016, 1);
        let most_us = u64::from(watched & 0xFFFF) * 1000;
        let lost = most_us > 0
            && self
                .heard_board_us
                .is_some_and(|at| now_us.saturating_sub(at) > most_us);
        // Without an abort connection option it reports the error, and continues.
        let acts = self.objects.get(0x6007, 0) != 0;
        if lost && !acts && self.emergency != BOARD_LOST {
            self.send_emergency(fault, BOARD_LOST, now_us, out);
        }
        let code = fault.fault.or((lost && acts).then_some(BOARD_LOST));
        if let Some(code) = code
            && self.power != Power::Fault
        {
            self.send_emergency(fault, code, now_us, out);
            self.disable(plant, index)?;
            self.power = Power::Fault;
        }
        let heat = if fault.hot { HOT } else { 0 };
        if self.power != Power::Fault && heat != self.emergency {
            self.send_emergency(fault, heat, now_us, out);
        }
        Ok(())
    }

    /// Reports an error code, 0 for none.
    fn send_emergency(&mut self, fault: &NodeFault, code: u16, at_us: u64, out: Outbox<'_>) {
        self.emergency = code;
        let [low, high] = code.to_le_bytes();
        // Error register of CiA 301: bit 0 any error, bit 3 temperature, bit 4 communication.
        let register = match code >> 12 {
            _ if code == 0 => 0x00,
            0x4 => 0x09,
            0x8 => 0x11,
            _ => 0x01,
        };
        self.objects.set(0x1001, 0, u32::from(register));
        let data = [low, high, register, 0, 0, 0, 0, 0];
        let id = 0x080 + self.node(fault);
        out(at_us, CanFrame { id, len: 8, data });
    }

    /// In position mode it interpolates between two set-points.
    fn go_on(&mut self, plant: &mut Plant, index: usize, now_us: u64) -> Result<(), PlantError> {
        let Some((from, to, since_us)) = self.way else {
            return Ok(());
        };
        let period_us = u64::from(self.objects.get(0x60C2, 1)) * 1000;
        let passed_us = now_us.saturating_sub(since_us);
        let way = i64::from(to.wrapping_sub(from));
        let counts = if passed_us >= period_us {
            i64::from(to)
        } else {
            i64::from(from) + way * passed_us as i64 / period_us as i64
        };
        let rpm_limit = self.objects.get(0x6080, 0).min(0xFFFF) as u16;
        plant.command_drive(index, DriveCommand::Position { counts, rpm_limit })
    }

    fn disable(&mut self, plant: &mut Plant, index: usize) -> Result<(), PlantError> {
        self.way = None;
        if self.power != Power::Fault {
            self.power = Power::SwitchOnDisabled;
        }
        plant.command_drive(index, DriveCommand::Off)
    }
}
