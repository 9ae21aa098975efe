//! The virtual board: the real control core on simulated pins.

use crate::can::DriveLine;
use crate::plant::{Plant, PlantError};
use mcdpr_firmware::drives::DriveBus;
use mcdpr_firmware::sampler::Sampler;
use mcdpr_firmware::server::{Incoming, Receiver, Server};
use mcdpr_firmware::{Brake, Inputs, Outputs};
use mcdpr_protocol::frame::{MAX_FRAME, encode_bytes, encode_frame};
use mcdpr_protocol::{
    Channel, FaultRecord, Hello, PROTOCOL_MAJOR, PROTOCOL_MINOR, Reply, ResetCause, Tick,
};

/// Telemetry is dropped while this many bytes wait for the line: an answer must not queue behind.
const TELEMETRY_BACKLOG: usize = 600;

/// What a board looks like to the simulation, whatever its number of winches.
pub trait VirtualBoard {
    /// Time between two calls of [`Self::tick`], µs: a whole part of a millisecond.
    fn slice_us(&self) -> u64 {
        1000
    }
    /// Path times that are now known of ticks that have passed; nothing where
    /// [`Self::path_ms`] always is what the board itself knows.
    fn take_path_times(&mut self) -> Vec<(Tick, u32)> {
        Vec::new()
    }
    /// Ticks after which [`Self::take_path_times`] has told of a tick, if it ever does.
    fn path_times_behind(&self) -> usize {
        0
    }
    /// Lets plant and drives work until `until_us`, a slice from now. A board with a bus of its own
    /// does that itself, with the drives' electronics of `line` alone.
    ///
    /// # Errors
    /// The plant's.
    fn advance(
        &mut self,
        plant: &mut Plant,
        line: &mut DriveLine,
        until_us: u64,
    ) -> Result<(), PlantError> {
        line.advance(plant, until_us)
    }
    /// One slice of time, for which [`Self::advance`] was just called: takes the bytes that have
    /// arrived, leaves the bytes to send. `backlog` is what the line has not sent yet.
    ///
    /// # Errors
    /// The plant is no such robot; [`PlantError::Board`] where the board itself cannot go on.
    fn tick(
        &mut self,
        plant: &mut Plant,
        line: &mut DriveLine,
        received: &[u8],
        backlog: usize,
        send: &mut Vec<u8>,
    ) -> Result<(), PlantError>;
    /// Errors that the line's receiver has counted since the last tick. A board that has a receiver
    /// of its own counts for itself.
    fn line_errors(&mut self, errors: u16) {
        let _ = errors;
    }
    /// What the board does.
    fn state(&self) -> mcdpr_firmware::State;
    /// Path time of the motion under way, ms.
    fn path_ms(&self) -> u32;
    /// Ticks since it started.
    fn now(&self) -> Tick;
    /// The latched fault.
    fn fault(&self) -> Option<FaultRecord>;
    /// Whether any drive was told to give torque in the last tick.
    fn torque_on(&self) -> bool;
}

/// The control core for `N` winches with all that surrounds it on a board.
pub(crate) struct Board<const N: usize> {
    server: Server<N>,
    receiver: Receiver,
    sampler: Sampler<N>,
    drives: DriveBus<N>,
    outputs: Outputs<N>,
    now: Tick,
    version: (u16, u16),
    line_errors: u16,
}

impl<const N: usize> Board<N> {
    pub(crate) fn new(first_tick: Tick, version: Option<(u16, u16)>) -> Self {
        Self {
            server: Server::new(true),
            receiver: Receiver::default(),
            sampler: Sampler::default(),
            drives: DriveBus::default(),
            outputs: Outputs::default(),
            now: first_tick,
            version: version.unwrap_or((PROTOCOL_MAJOR, PROTOCOL_MINOR)),
            line_errors: 0,
        }
    }

    fn hello(&self) -> Hello {
        Hello {
            major: self.version.0,
            minor: self.version.1,
            board_id: *b"simulated 01",
            git_hash: [0; 8],
            reset_cause: ResetCause::Power,
        }
    }

    fn read(&mut self, plant: &mut Plant, line: &mut DriveLine) -> Inputs<N> {
        let sensors = plant.read_sensors();
        let mut inputs = Inputs {
            e_stop: sensors.e_stop,
            gripper_switch: plant.gripper_switch(),
            line_errors: self.line_errors,
            ..Inputs::default()
        };
        inputs
            .encoders
            .copy_from_slice(&sensors.encoder_counts[..N]);
        inputs.tension_adc.copy_from_slice(&sensors.adc[..N]);
        self.drives.listen(&mut line.port());
        self.drives.fill(&mut inputs);
        inputs
    }

    fn apply(&mut self, plant: &mut Plant, line: &mut DriveLine) -> Result<(), PlantError> {
        plant.set_gripper(self.outputs.gripper_closed);
        let config = self.server.controller().config();
        let mut port = line.port();
        self.drives.tick(self.now, config, &self.outputs, &mut port);
        for (i, brake) in self.outputs.brakes.iter().enumerate() {
            plant.set_brake(i, *brake == Brake::Closed)?;
        }
        Ok(())
    }

    fn answer(&mut self, received: &[u8], send: &mut Vec<u8>) {
        let mut frame = [0; MAX_FRAME];
        for &byte in received {
            let Some(incoming) = self.receiver.push(byte) else {
                continue;
            };
            let used = match incoming {
                Incoming::HelloQuery => {
                    encode_bytes(Channel::Hello, &self.hello().to_bytes(), &mut frame)
                }
                Incoming::Command(command) => {
                    let counters = self.receiver.counters;
                    let mut answer = self.server.receive(self.now, &command, &counters);
                    if let Ok(Reply::Info(info)) = &mut answer.result {
                        // RMDS and CiA 402, as the board of the same core.
                        info.drive_kinds = 0b110;
                    }
                    encode_frame(Channel::Answer, &answer, &mut frame)
                }
                Incoming::Damaged(_) => match self.server.complain() {
                    Some(answer) => encode_frame(Channel::Answer, &answer, &mut frame),
                    None => continue,
                },
            };
            // Every message fits a frame: the protocol asserts it when it is compiled.
            send.extend_from_slice(&frame[..used.unwrap_or(0)]);
        }
    }

    fn tell(&mut self, backlog: usize, send: &mut Vec<u8>) {
        let mut frame = [0; MAX_FRAME];
        let counters = self.receiver.counters;
        let room = backlog + send.len() < TELEMETRY_BACKLOG;
        let row = self.server.take_row();
        if let Some(block) = row.and_then(|row| self.sampler.push(&row)) {
            if room {
                let used = encode_frame(Channel::Samples, &block, &mut frame);
                send.extend_from_slice(&frame[..used.unwrap_or(0)]);
            } else {
                self.receiver.counters.telemetry_dropped += 1;
            }
        }
        if room && let Some(status) = self.server.take_status(&counters) {
            let used = encode_frame(Channel::Status, &status, &mut frame);
            send.extend_from_slice(&frame[..used.unwrap_or(0)]);
        }
    }
}

impl<const N: usize> VirtualBoard for Board<N> {
    fn tick(
        &mut self,
        plant: &mut Plant,
        line: &mut DriveLine,
        received: &[u8],
        backlog: usize,
        send: &mut Vec<u8>,
    ) -> Result<(), PlantError> {
        self.now = self.now.after(1);
        self.answer(received, send);
        let inputs = self.read(plant, line);
        self.outputs = self.server.step(self.now, &inputs);
        self.tell(backlog, send);
        self.apply(plant, line)
    }

    fn line_errors(&mut self, errors: u16) {
        self.line_errors = errors;
    }

    fn state(&self) -> mcdpr_firmware::State {
        self.server.controller().state()
    }

    fn path_ms(&self) -> u32 {
        self.server.controller().path_ms()
    }

    fn now(&self) -> Tick {
        self.now
    }

    fn fault(&self) -> Option<FaultRecord> {
        self.server.controller().fault()
    }

    fn torque_on(&self) -> bool {
        self.outputs.drives.iter().any(|drive| drive.gives_torque())
    }
}
