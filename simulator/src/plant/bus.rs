//! The bus between board and drives: slots, waiting commands, transport time.

use super::drive::{Drive, DriveCommand};
use super::faults::DriveFault;
use super::params::BusParams;

/// Feedback of a drive in its slot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Feedback {
    /// Motor current (mA), saturated at the type's range.
    pub current_ma: i16,
    /// Motor speed (rpm), saturated at the type's range.
    pub rpm: i16,
    /// Motor position since the last reset (counts), wrapping.
    pub counts: i32,
    /// Counts feedbacks of this drive from 1, wrapping: unchanged means no new one.
    pub sequence: u32,
    /// Simulated time at which it was measured (s).
    pub measured_at_s: f64,
}

impl Feedback {
    /// Saturating and wrapping conversions as the drive's own registers do them.
    #[allow(clippy::cast_possible_truncation)]
    pub(crate) fn measure(drive: &Drive, motor_m: f64, motor_rate: f64, now_s: f64) -> Self {
        Self {
            current_ma: (drive.current_a * 1e3).round() as i16,
            rpm: drive.rpm(motor_rate).round() as i16,
            counts: drive.counts(motor_m) as i64 as i32,
            sequence: 0,
            measured_at_s: now_s,
        }
    }
}

/// Commands that are not set-points and wait for their slot.
const QUEUE: usize = 4;

/// One drive's place on the bus.
#[derive(Debug, Clone)]
pub(crate) struct Port {
    offset_s: f64,
    slot: u64,
    next_slot_s: f64,
    waiting: [Option<DriveCommand>; QUEUE],
    set_point: Option<DriveCommand>,
    to_drive: Option<(f64, DriveCommand)>,
    to_board: Option<(f64, Feedback)>,
    /// The latest feedback that reached the board.
    pub received: Option<Feedback>,
    sequence: u32,
}

impl Port {
    pub(crate) fn new(index: usize, count: usize, bus: &BusParams) -> Self {
        #[allow(clippy::cast_precision_loss)]
        let offset_s = bus.period_s * index as f64 / count as f64;
        Self {
            offset_s,
            slot: 0,
            next_slot_s: offset_s,
            waiting: [None; QUEUE],
            set_point: None,
            to_drive: None,
            to_board: None,
            received: None,
            sequence: 0,
        }
    }

    /// The board passes a command. A set-point replaces the one still waiting. `Off` and `Reset`
    /// void everything before them; other commands wait in order.
    pub(crate) fn submit(&mut self, command: DriveCommand) {
        if command.is_set_point() {
            self.set_point = Some(command);
            return;
        }
        if matches!(command, DriveCommand::Off | DriveCommand::Reset) {
            self.waiting = [None; QUEUE];
            self.set_point = None;
        }
        let last = self.waiting.iter().rposition(Option::is_some);
        match last {
            // A repeated command takes no second slot.
            Some(i) if self.waiting[i] == Some(command) => {}
            // A full queue keeps its first commands; the newest takes the last place.
            Some(i) => self.waiting[(i + 1).min(QUEUE - 1)] = Some(command),
            None => self.waiting[0] = Some(command),
        }
    }

    /// Drops everything in transit.
    pub(crate) fn clear(&mut self) {
        self.waiting = [None; QUEUE];
        self.set_point = None;
        self.to_drive = None;
        self.to_board = None;
    }

    /// Runs the bus up to `now_s`.
    #[inline(always)]
    pub(crate) fn poll(
        &mut self,
        now_s: f64,
        bus: &BusParams,
        bus_off: bool,
        fault: &DriveFault,
        drive: &mut Drive,
        motor: (f64, f64),
    ) {
        if now_s >= self.next_slot_s {
            self.work_slot(now_s, bus, bus_off, fault, drive, motor);
        }
        if let Some((at, command)) = self.to_drive
            && now_s >= at
        {
            self.to_drive = None;
            if !fault.ignores_commands {
                drive.receive(command, now_s, motor.1);
            }
        }
        if let Some((at, feedback)) = self.to_board
            && now_s >= at
        {
            self.to_board = None;
            self.received = Some(feedback);
        }
    }

    #[inline(never)]
    fn work_slot(
        &mut self,
        now_s: f64,
        bus: &BusParams,
        bus_off: bool,
        fault: &DriveFault,
        drive: &Drive,
        motor: (f64, f64),
    ) {
        self.slot += 1;
        #[allow(clippy::cast_precision_loss)]
        let periods = self.slot as f64;
        // From the slot's number, so that rounding does not add up over hours.
        // 1 ns early: the time of a step is a rounded product and must not miss its slot.
        self.next_slot_s = self.offset_s + periods * bus.period_s - 1e-9;
        // Modes before set-points: a drive ignores a set-point of a mode that it is not in.
        let command = if let Some(first) = self.waiting[0] {
            self.waiting.rotate_left(1);
            self.waiting[QUEUE - 1] = None;
            Some(first)
        } else {
            self.set_point.take()
        };
        // The command is lost: nobody repeats it on a dead bus.
        if bus_off {
            return;
        }
        if let Some(command) = command {
            self.to_drive = Some((now_s + bus.latency_s - 1e-9, command));
        }
        if drive.answers() && !fault.silent {
            self.sequence = self.sequence.wrapping_add(1);
            let mut feedback = Feedback::measure(drive, motor.0, motor.1, now_s);
            feedback.sequence = self.sequence;
            self.to_board = Some((now_s + bus.latency_s - 1e-9, feedback));
        }
    }
}
