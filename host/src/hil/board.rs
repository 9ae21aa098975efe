//! A board behind three wires as the board of a simulated robot.

use super::can::{self, CanWire};
use super::port::Port;
use super::signals::{self, CHANNELS, Got, Sentence, Set, VERSION, input, output};
use super::{HilError, Wires};
use crate::link::BAUD;
use mcdpr_firmware::State;
use mcdpr_firmware::drives::CanFrame;
use mcdpr_protocol::{FaultRecord, Tick};
use mcdpr_simulator::can::DriveLine;
use mcdpr_simulator::plant::{Plant, PlantError};
use mcdpr_simulator::{BEHIND_TICKS, BoardFailure, Overheard, Positions, VirtualBoard};
use std::time::{Duration, Instant};

/// Slice of time where the board's time passes only on request, and where it passes by itself, us.
const STEPPED_US: u64 = 250;
const FREE_US: u64 = 500;
/// Longest time between two looks at the drives, us.
const DRIVES_US: u64 = 100;
/// The signal board must answer the greeting in this time, and every sentence.
const GREETING: Duration = Duration::from_secs(2);
const ANSWER: Duration = Duration::from_secs(10);
/// A signal board in real time that is silent for so long is gone, us.
const SILENT_US: u64 = 200_000;
/// Where the simulation is later than this, its time stands still instead of catching up, us.
const LATE_US: f64 = 50_000.0;
/// Bytes of the line in a millisecond.
const BYTES_PER_MS: f64 = BAUD as f64 / 10_000.0;
/// How much faster than this computer a board's clock may be.
const CLOCKS_DIFFER: f64 = 2e-4;

/// A real board, or an emulated one in another process, in front of a plant.
pub(crate) struct HilBoard {
    line: Port,
    can: Box<dyn CanWire>,
    signals: Port,
    stepped: bool,
    slice_us: u64,
    time_scale: f64,
    heard: Overheard,
    positions: Positions<CHANNELS>,
    set: Set,
    got: Got,
    /// When the last answer of the signal board came, us.
    answered_at_us: u64,
    sentences: Vec<u8>,
    /// Frames from the board, and from the drives with the time from which they may be sent.
    from_board: Vec<CanFrame>,
    frames_received: u32,
    from_drives: Vec<(u64, CanFrame)>,
    bytes_received: u32,
    now_us: u64,
    /// Real time and simulated time (us) that go together.
    anchor: Option<(Instant, u64)>,
    /// The board's tick when simulated time was 0, and its present tick.
    tick_offset: Option<f64>,
    now: Tick,
    supply_low: bool,
    powered: bool,
    /// Bytes of this slice are to arrive damaged.
    disturbed: bool,
    /// Somebody wants its program to crash.
    shall_crash: bool,
}

impl HilBoard {
    /// Opens the wires, greets the signal board, which switches the board off and on if it can. The
    /// bus has this bit rate.
    ///
    /// # Errors
    /// A wire cannot be opened, or the signal board does not answer.
    pub(crate) fn open(wires: &Wires, bits_per_s: u32) -> Result<Self, HilError> {
        let mut signals = Port::open("signal board", &wires.signals, BAUD)?;
        let can = can::open(&wires.can, bits_per_s)?;
        let stepped = greet(&mut signals)?;
        // After the greeting, with which the board starts.
        let line = Port::open("board", &wires.line, BAUD)?;
        Ok(Self {
            line,
            can,
            signals,
            stepped,
            slice_us: if stepped { STEPPED_US } else { FREE_US },
            time_scale: wires.time_scale,
            heard: Overheard::new(CHANNELS),
            positions: Positions::default(),
            set: Set::default(),
            got: Got::default(),
            answered_at_us: 0,
            sentences: Vec::new(),
            from_board: Vec::new(),
            frames_received: 0,
            from_drives: Vec::new(),
            bytes_received: 0,
            now_us: 0,
            anchor: None,
            tick_offset: None,
            now: Tick(0),
            supply_low: false,
            powered: true,
            disturbed: false,
            shall_crash: false,
        })
    }

    /// Waits until real time has reached a simulated time.
    fn pace(&mut self, until_us: u64) {
        let (begun, begun_us) = *self.anchor.get_or_insert((Instant::now(), self.now_us));
        let due_us = (until_us - begun_us) as f64 / self.time_scale;
        let ahead_us = due_us - begun.elapsed().as_secs_f64() * 1e6;
        if ahead_us > 0.0 {
            std::thread::sleep(Duration::from_secs_f64(ahead_us * 1e-6));
        } else if ahead_us < -LATE_US {
            // The host was busy. The plant has stood still, and goes on from there.
            self.anchor = Some((Instant::now(), until_us));
        }
    }

    /// Plant and drives, until the end of a slice.
    fn go_on(
        &mut self,
        plant: &mut Plant,
        line: &mut DriveLine,
        until_us: u64,
    ) -> Result<(), PlantError> {
        if !self.stepped {
            self.pace(until_us);
            let can = self.can.receive(&mut self.from_board, false);
            can.map_err(failed)?;
        }
        if self.shall_crash {
            return Err(unable("its program cannot be made to crash from outside"));
        }
        if line.bus_mut().faults_mut().corrupt > 0 {
            return Err(unable("a frame on real wires cannot be damaged from here"));
        }
        let supplied = (0..CHANNELS).any(|cable| plant.drive_has_supply(cable));
        self.can.connect(supplied).map_err(failed)?;
        let queue = &mut self.from_drives;
        let mut send = |_: usize, at_us: u64, frame: CanFrame| queue.push((at_us, frame));
        let nodes = line.nodes_mut();
        for frame in self.from_board.drain(..) {
            nodes.hear(plant, self.now_us, None, &frame, &mut send)?;
        }
        while self.now_us < until_us {
            let step_us = DRIVES_US.min(until_us - self.now_us);
            plant.advance(1e-6 * step_us as f64)?;
            self.now_us += step_us;
            nodes.pass(plant, self.now_us, &mut send)?;
        }
        // Of one drive in the order of their times; the bus decides between drives.
        let due = |(at_us, _): &(u64, CanFrame)| *at_us <= until_us;
        let (due, later): (Vec<_>, Vec<_>) = self.from_drives.drain(..).partition(due);
        self.from_drives = later;
        if supplied && self.powered {
            for (_, frame) in due {
                self.can.send(&frame).map_err(failed)?;
                self.set.can_frames = self.set.can_frames.wrapping_add(1);
            }
        }
        Ok(())
    }

    /// The plant's sensors as inputs of the board.
    fn sense(&mut self, plant: &mut Plant) {
        let cables: [usize; CHANNELS] = std::array::from_fn(|cable| cable);
        // The noise is that of a reading as the firmware makes it: it is drawn once a tick.
        let sensors = if self.now_us.is_multiple_of(1000) {
            plant.read_sensors_of(&cables)
        } else {
            plant.read_sensors_again_of(&cables)
        };
        let counters = cables.map(|cable| sensors.encoder_counts[cable]);
        self.set.encoders = self.positions.follow(counters);
        self.set.tensions = cables.map(|cable| sensors.adc[cable]);
        let bits = [
            (sensors.e_stop, input::E_STOP),
            (!plant.gripper_switch(), input::GRIPPER_SWITCH),
            (self.powered, input::SUPPLY),
            (self.supply_low, input::SUPPLY_LOW),
            (plant.faults().bus_off, input::CAN_SHORTED),
            (self.disturbed, input::LINE_DISTURBED),
        ];
        let on = bits.iter().filter(|(on, _)| *on);
        self.set.inputs = on.fold(0, |all, (_, bit)| all | bit);
    }

    /// Sends the inputs, and takes what has come from the board meanwhile.
    fn exchange(&mut self, send: &mut Vec<u8>) -> Result<(), HilError> {
        self.set.sequence = self.set.sequence.wrapping_add(1);
        self.set.step_us = self.slice_us as u32;
        let text = Sentence::Set(self.set).to_text();
        self.signals.write(text.as_bytes())?;
        let begun = Instant::now();
        let before = send.len();
        loop {
            let waits = self.stepped && self.got.sequence != self.set.sequence;
            self.signals.read(&mut self.sentences, waits)?;
            for line in signals::take_lines(&mut self.sentences) {
                if let Some(Sentence::Got(got)) = Sentence::parse(&line) {
                    self.got = got;
                    self.answered_at_us = self.now_us;
                }
            }
            let answered = !self.stepped || self.got.sequence == self.set.sequence;
            let bytes_due = self.stepped && answered && self.bytes_received != self.got.line_bytes;
            let count = send.len();
            self.line.read(send, bytes_due)?;
            self.bytes_received = self
                .bytes_received
                .wrapping_add((send.len() - count) as u32);
            if self.stepped {
                let frames_due = answered && self.frames_received != self.got.can_frames;
                let count = self.from_board.len();
                self.can.receive(&mut self.from_board, frames_due)?;
                self.frames_received = self
                    .frames_received
                    .wrapping_add((self.from_board.len() - count) as u32);
            }
            let complete = self.bytes_received == self.got.line_bytes
                && self.frames_received == self.got.can_frames;
            if !self.stepped || (answered && complete) {
                break;
            }
            if begun.elapsed() > ANSWER {
                return Err(self.signals.failed("it no longer answers"));
            }
        }
        if self.now_us > self.answered_at_us + SILENT_US {
            return Err(self.signals.failed("it no longer answers"));
        }
        self.heard.listen(send.get(before..).unwrap_or_default());
        self.follow_ticks();
        Ok(())
    }

    /// The board's tick at this time.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a tick counts milliseconds, and saturates"
    )]
    fn tick_now(&self) -> Tick {
        let offset = self.tick_offset.unwrap_or(0.0);
        Tick((self.now_us as f64 * 1e-3 + offset).round().max(0.0) as u32)
    }

    /// The board's clock, by the blocks of samples that waited least.
    fn follow_ticks(&mut self) {
        let now_ms = self.now_us as f64 * 1e-3;
        if let Some((last, bytes)) = self.heard.take_last_tick() {
            // A block is queued in the tick after its last, and its bytes take their time.
            let on_the_line_ms = 1.0 + bytes as f64 / BYTES_PER_MS;
            let offset = f64::from(last.0) + on_the_line_ms - now_ms;
            let known = self.tick_offset.unwrap_or(offset);
            self.tick_offset = Some(known.max(offset));
        } else if let Some(offset) = &mut self.tick_offset {
            *offset -= CLOCKS_DIFFER * self.slice_us as f64 * 1e-3;
        }
    }

    /// The board's outputs to the plant.
    fn act(&self, plant: &mut Plant) -> Result<(), PlantError> {
        for cable in 0..CHANNELS {
            plant.set_brake(cable, self.got.outputs >> cable & 1 == 0)?;
            plant.set_drive_enable(cable, self.got.outputs & output::DRIVE_ENABLE != 0)?;
        }
        plant.set_gripper(self.got.outputs & output::GRIPPER != 0);
        Ok(())
    }
}

/// Greets the signal board, and learns whether its time is stepped.
fn greet(signals: &mut Port) -> Result<bool, HilError> {
    let begun = Instant::now();
    let mut bytes = Vec::new();
    signals.write(Sentence::Hello.to_text().as_bytes())?;
    while begun.elapsed() < GREETING {
        signals.read(&mut bytes, true)?;
        for line in signals::take_lines(&mut bytes) {
            match Sentence::parse(&line) {
                Some(Sentence::Here { version, stepped }) if version == VERSION => {
                    return Ok(stepped);
                }
                Some(Sentence::Here { version, .. }) => {
                    let reason = format!("it speaks version {version}, this program {VERSION}");
                    return Err(signals.failed(reason));
                }
                _ => {}
            }
        }
    }
    Err(signals.failed("it does not answer the greeting"))
}

fn failed(error: HilError) -> PlantError {
    PlantError::Board {
        reason: error.to_string(),
    }
}

fn unable(what: &str) -> PlantError {
    PlantError::Board {
        reason: format!("board in the loop: {what}"),
    }
}

impl VirtualBoard for HilBoard {
    fn slice_us(&self) -> u64 {
        self.slice_us
    }

    fn goes_on(&self) -> bool {
        !self.stepped
    }

    fn advance(
        &mut self,
        plant: &mut Plant,
        line: &mut DriveLine,
        until_us: u64,
    ) -> Result<(), PlantError> {
        self.go_on(plant, line, until_us)
    }

    fn advance_unpowered(
        &mut self,
        plant: &mut Plant,
        line: &mut DriveLine,
        until_us: u64,
    ) -> Result<(), PlantError> {
        self.powered = false;
        self.go_on(plant, line, until_us)?;
        self.sense(plant);
        // What a board without a supply seems to send is noise.
        self.exchange(&mut Vec::new()).map_err(failed)
    }

    fn tick(
        &mut self,
        plant: &mut Plant,
        _line: &mut DriveLine,
        received: &[u8],
        _backlog: usize,
        send: &mut Vec<u8>,
    ) -> Result<(), PlantError> {
        if plant.cable_count() != CHANNELS {
            let count = plant.cable_count();
            return Err(unable(&format!(
                "the robot has {count} cables, and a board drives four"
            )));
        }
        self.sense(plant);
        if !received.is_empty() {
            self.line.write(received).map_err(failed)?;
            self.set.line_bytes = self.set.line_bytes.wrapping_add(received.len() as u32);
        }
        self.exchange(send).map_err(failed)?;
        // A tick of the record once a millisecond.
        if self.now_us.is_multiple_of(1000) {
            self.now = self.tick_now();
        }
        self.act(plant)
    }

    fn power_on(&mut self) -> Result<(), PlantError> {
        self.powered = true;
        self.positions.restart();
        self.heard.restart();
        self.tick_offset = None;
        Ok(())
    }

    fn fit_battery(&mut self) {
        // A board has its battery or it has none.
    }

    fn restart(&mut self, _: BoardFailure) -> Result<(), PlantError> {
        // It resets itself.
        Ok(())
    }

    fn fail(&mut self, failure: BoardFailure, on: bool) -> bool {
        match failure {
            BoardFailure::SupplyLow => self.supply_low = on,
            BoardFailure::Crash => self.shall_crash |= on,
        }
        true
    }

    fn line_errors(&mut self, errors: u16) {
        self.disturbed = errors > 0;
    }

    fn state(&self) -> State {
        self.heard.state
    }

    fn path_ms(&self) -> u32 {
        0
    }

    fn take_path_times(&mut self) -> Vec<(Tick, u32)> {
        self.heard.take_path_times()
    }

    fn path_times_behind(&self) -> usize {
        BEHIND_TICKS
    }

    fn now(&self) -> Tick {
        self.now
    }

    fn fault(&self) -> Option<FaultRecord> {
        self.heard.fault
    }

    fn torque_on(&self) -> bool {
        self.heard.torque_on
    }
}
