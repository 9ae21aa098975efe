//! The virtual board: the real control core on simulated pins.

use crate::plant::{DriveCommand, Mode, Plant, PlantError};
use mcdpr_firmware::drives::{BusCommand, Mode as CoreMode, Sequencer};
use mcdpr_firmware::server::{Incoming, Receiver, Server};
use mcdpr_firmware::{Brake, DriveInput, Inputs, Outputs};
use mcdpr_protocol::frame::{MAX_FRAME, encode_bytes, encode_frame};
use mcdpr_protocol::{
    Channel, FaultRecord, Hello, PROTOCOL_MAJOR, PROTOCOL_MINOR, ResetCause, Tick,
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
    /// One slice of time, for which the plant has just been advanced: takes the bytes that have
    /// arrived, leaves the bytes to send. `backlog` is what the line has not sent yet.
    ///
    /// # Errors
    /// The plant is no such robot; [`PlantError::Board`] where the board itself can not go on.
    fn tick(
        &mut self,
        plant: &mut Plant,
        received: &[u8],
        backlog: usize,
        send: &mut Vec<u8>,
    ) -> Result<(), PlantError>;
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
    sequencers: [Sequencer; N],
    last_feedback: [(u32, u16); N],
    outputs: Outputs<N>,
    now: Tick,
    version: (u16, u16),
}

impl<const N: usize> Board<N> {
    pub(crate) fn new(first_tick: Tick, version: Option<(u16, u16)>) -> Self {
        Self {
            server: Server::new(true),
            receiver: Receiver::default(),
            sequencers: [Sequencer::default(); N],
            last_feedback: [(0, u16::MAX); N],
            outputs: Outputs::default(),
            now: first_tick,
            version: version.unwrap_or((PROTOCOL_MAJOR, PROTOCOL_MINOR)),
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

    fn read(&mut self, plant: &mut Plant) -> Inputs<N> {
        let sensors = plant.read_sensors();
        let mut inputs = Inputs {
            e_stop: sensors.e_stop,
            ..Inputs::default()
        };
        for i in 0..N {
            inputs.encoders[i] = sensors.encoder_counts[i];
            inputs.tension_adc[i] = sensors.adc[i];
            let (sequence, age) = &mut self.last_feedback[i];
            *age = age.saturating_add(1);
            if let Some(feedback) = &sensors.feedback[i] {
                if feedback.sequence != *sequence {
                    (*sequence, *age) = (feedback.sequence, 0);
                }
                inputs.drives[i] = DriveInput {
                    ready: self.sequencers[i].is_ready(self.outputs.drives[i]),
                    fault: false,
                    age_ms: *age,
                    counts: feedback.counts,
                    rpm: feedback.rpm,
                    current_ma: feedback.current_ma,
                    ..DriveInput::default()
                };
            } else {
                inputs.drives[i].age_ms = u16::MAX;
            }
        }
        inputs
    }

    fn apply(&mut self, plant: &mut Plant, inputs: &Inputs<N>) -> Result<(), PlantError> {
        for i in 0..N {
            let answers = inputs.drives[i].age_ms < 20;
            let command = match self.sequencers[i].tick(self.outputs.drives[i], answers) {
                BusCommand::Nothing => None,
                BusCommand::Off => Some(DriveCommand::Off),
                BusCommand::Reset => Some(DriveCommand::Reset),
                BusCommand::Select(CoreMode::Position) => {
                    Some(DriveCommand::SelectMode(Mode::Position))
                }
                BusCommand::Select(CoreMode::Current) => {
                    Some(DriveCommand::SelectMode(Mode::Current))
                }
                BusCommand::Position { counts, rpm } => Some(DriveCommand::Position {
                    counts: i64::from(counts),
                    rpm_limit: rpm,
                }),
                BusCommand::Current { ma } => Some(DriveCommand::Current { milliamps: ma }),
            };
            if let Some(command) = command {
                plant.command(i, command)?;
            }
            plant.set_brake(i, self.outputs.brakes[i] == Brake::Closed)?;
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
                    let answer = self.server.receive(self.now, &command, &counters);
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
        if let Some(block) = self.server.take_samples() {
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
        received: &[u8],
        backlog: usize,
        send: &mut Vec<u8>,
    ) -> Result<(), PlantError> {
        self.now = self.now.after(1);
        self.answer(received, send);
        let inputs = self.read(plant);
        self.outputs = self.server.step(self.now, &inputs);
        self.tell(backlog, send);
        self.apply(plant, &inputs)
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
