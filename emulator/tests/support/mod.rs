//! The real firmware file on the emulated chip, and a host that communicates with it.
#![allow(dead_code, reason = "each test binary uses its part")]

pub mod power;

use mcdpr_emulator::{Chip, Port};
use mcdpr_protocol::frame::{MAX_FRAME, encode_bytes};
use mcdpr_protocol::message::{CONFIG_CHUNK, decode};
use mcdpr_protocol::{
    Answer, BoardKey, CableKey, Channel, Command, ConfigEntry, ConfigHash, ConfigKey, Deframer,
    Hello, List, Millinewtons, PerCable, Reply, Request, SampleBlock, SequenceNumber, SessionId,
    Status, TenthMicrometres, config_hash, encode_frame,
};

/// Slice of virtual time, microseconds.
pub const SLICE_US: u64 = 50;
/// Length of every cable at the reference, 0.1 um.
pub const START: i32 = 8_000_000;
/// 1264 * 3.3 V / 4095 = 1.0186 V; (1.0186 - 0.2355) V * 12.77 N/V = 10.0 N.
pub const RAW_10_N: u16 = 1264;

/// The output of `cargo fw`, or the file named by `MCDPR_FIRMWARE`.
pub fn firmware() -> Vec<u8> {
    let built = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../target/thumbv7m-none-eabi/firmware/mcdpr-firmware"
    );
    let path = std::env::var("MCDPR_FIRMWARE").unwrap_or_else(|_| built.to_owned());
    std::fs::read(&path).unwrap_or_else(|error| {
        panic!("{path}: {error}. Build the firmware with `cargo fw`, or set MCDPR_FIRMWARE")
    })
}

/// A chip on a bench, and its messages.
pub struct Bench {
    pub chip: Chip,
    deframer: Deframer,
    sequence: u16,
    pub hellos: Vec<Hello>,
    pub answers: Vec<Answer>,
    pub statuses: Vec<Status>,
    pub blocks: Vec<SampleBlock>,
    pub bad_frames: usize,
}

impl Bench {
    /// Powered up and running: emergency stop released, 10 N at every sensor.
    pub fn new() -> Self {
        Self::on(|_| {})
    }

    /// As [`Self::new`], on a board with a fault from power-on.
    pub fn on(prepare: impl FnOnce(&mut Chip)) -> Self {
        let mut chip = Chip::load(&firmware()).expect("the firmware file loads");
        chip.set_input(Port::B, 5, Some(false));
        for channel in [4, 5, 8, 9] {
            chip.set_adc(channel, RAW_10_N);
        }
        prepare(&mut chip);
        let mut bench = Self {
            chip,
            deframer: Deframer::new(),
            sequence: 0,
            hellos: Vec::new(),
            answers: Vec::new(),
            statuses: Vec::new(),
            blocks: Vec::new(),
            bad_frames: 0,
        };
        bench.run_ms(20);
        bench
    }

    /// The same chip once more, with the same session. Between two frames only.
    pub fn fork(&self) -> Self {
        Self {
            chip: self.chip.clone(),
            deframer: Deframer::new(),
            sequence: self.sequence,
            hellos: Vec::new(),
            answers: Vec::new(),
            statuses: Vec::new(),
            blocks: Vec::new(),
            bad_frames: 0,
        }
    }

    /// Runs, and decodes the received bytes.
    pub fn run_ms(&mut self, ms: u64) {
        for _ in 0..ms * 1000 / SLICE_US {
            let run = self.chip.run_us(SLICE_US);
            assert!(
                run.is_ok(),
                "at {} us: {}",
                self.chip.now_us(),
                run.unwrap_err()
            );
        }
        self.sort();
    }

    /// Decodes the received bytes into messages.
    pub fn sort(&mut self) {
        for byte in self.chip.uart_take() {
            match self.deframer.push(byte) {
                None => {}
                Some(Err(_)) => self.bad_frames += 1,
                Some(Ok((Channel::Hello, body))) => {
                    self.hellos
                        .push(Hello::from_bytes(body).expect("a greeting"));
                }
                Some(Ok((Channel::Answer, body))) => {
                    self.answers.push(decode(body).expect("an answer"));
                }
                Some(Ok((Channel::Status, body))) => {
                    self.statuses.push(decode(body).expect("a status"));
                }
                Some(Ok((Channel::Samples, body))) => {
                    self.blocks.push(decode(body).expect("a block"));
                }
                Some(Ok((channel, _))) => panic!("a board sends no {channel:?}"),
            }
        }
    }

    pub fn hello(&mut self) -> Hello {
        let mut frame = [0; MAX_FRAME];
        let used = encode_bytes(Channel::HelloQuery, &[], &mut frame).expect("fits");
        self.hellos.clear();
        self.chip.uart_send(&frame[..used]);
        self.run_ms(8);
        assert_eq!(self.hellos.len(), 1, "one greeting for one question");
        self.hellos[0]
    }

    /// Sends a request and returns its answer, which must arrive within 12 ms; that to a
    /// configuration, which the board builds in slices, within 32 ms.
    pub fn ask(&mut self, request: Request) -> Answer {
        let most_ms = match request {
            Request::ConfigCommit { .. } => 32,
            _ => 12,
        };
        let shown = format!("{request:?}");
        self.answers.clear();
        self.tell(request);
        self.run_ms(most_ms);
        assert_eq!(self.answers.len(), 1, "one answer for {shown}");
        self.answers.remove(0)
    }

    /// Sends a request without waiting for its answer.
    pub fn tell(&mut self, request: Request) {
        let sequenced = request.is_sequenced();
        let command = Command {
            session: SessionId(0x1234),
            sequence: SequenceNumber(self.sequence),
            request,
        };
        let mut frame = [0; MAX_FRAME];
        let used = encode_frame(Channel::Command, &command, &mut frame).expect("fits");
        self.chip.uart_send(&frame[..used]);
        if sequenced {
            self.sequence += 1;
        }
    }

    /// As [`Self::ask`]; a refusal fails the test.
    pub fn done(&mut self, request: Request) -> Reply {
        let shown = format!("{request:?}");
        let answer = self.ask(request);
        answer
            .result
            .unwrap_or_else(|reject| panic!("{shown} was refused: {reject:?}"))
    }

    pub fn status(&mut self) -> Status {
        match self.done(Request::Status) {
            Reply::Status(status) => status,
            other => panic!("{other:?} is not a status"),
        }
    }

    /// Opens the session: its numbers continue from the next one.
    pub fn open(&mut self) {
        assert_eq!(self.done(Request::Open), Reply::Done);
        self.sequence += 1;
    }

    /// Opens, configures four cables and references them; returns the configuration's hash.
    pub fn prepare(&mut self) -> ConfigHash {
        let hash = self.configure();
        let lengths = PerCable::collect([TenthMicrometres(START); 4]);
        let tensions = PerCable::collect([Millinewtons(10_000); 4]);
        let reply = self.done(Request::Reference { lengths, tensions });
        assert_eq!(reply, Reply::Done);
        hash
    }

    /// Opens and configures four cables, without a reference.
    pub fn configure(&mut self) -> ConfigHash {
        self.open();
        let entries = entries();
        let count = entries.len() as u16;
        assert_eq!(
            self.done(Request::ConfigBegin { entries: count }),
            Reply::Done
        );
        for chunk in entries.chunks(CONFIG_CHUNK) {
            let entries = List::collect(chunk.iter().copied());
            assert_eq!(self.done(Request::ConfigPut { entries }), Reply::Done);
        }
        let hash = config_hash(entries.iter().copied());
        let reply = self.done(Request::ConfigCommit { hash });
        assert_eq!(reply, Reply::Configured { hash });
        hash
    }
}

/// Four of the paper's winches; encoders of cables 2 and 4 are mounted the other way round.
fn entries() -> Vec<ConfigEntry> {
    let board = BoardKey::ALL.iter().map(|&key| {
        let value = match key {
            BoardKey::Cables => 4,
            BoardKey::DriveKind => 1,
            BoardKey::BusBitrate => 1_000_000,
            BoardKey::BusPeriodUs | BoardKey::TensionPeriodUs => 2000,
            BoardKey::StopMs => 300,
            BoardKey::ResidualMs => 100,
            BoardKey::EnableMs => 40,
            BoardKey::FeedbackTimeoutMs => 10,
            BoardKey::HoldBrakes | BoardKey::FaultLine => 0,
        };
        (ConfigKey::board(key), value)
    });
    let cables = (0..4_u8).flat_map(|index| {
        CableKey::ALL.iter().map(move |&key| {
            let value = match key {
                CableKey::Control => i32::from(index == 3),
                CableKey::DrumRadius => 200_000,
                CableKey::EncoderCountsPerTurn | CableKey::MotorCountsPerRev => 4096,
                CableKey::EncoderSign => 1 - 2 * i32::from(index % 2),
                CableKey::MotorCountsPerTurn => 1_520_148,
                CableKey::MaxMotorRpm | CableKey::LeadUs => 8000,
                CableKey::MaxCurrentMa => 3000,
                CableKey::ForcePerCurrent => -50_000,
                CableKey::TensionGain => 12_770,
                CableKey::TensionZeroUv => 235_500,
                CableKey::TensionMax => 39_000,
                CableKey::TensionFloor | CableKey::Friction => 500,
                CableKey::TensionCeiling => 34_000,
                CableKey::TensionLaw => 1,
                CableKey::TensionKp | CableKey::FollowingError => 1000,
                CableKey::TensionKd => 20_000,
                CableKey::TensionKi | CableKey::DrumMass => 2000,
                CableKey::TensionDamping => 50_000,
                CableKey::TensionFilterMhz => 30_000,
                CableKey::BrakeCloseMs => 30,
                CableKey::ReelSpeed => 10_000,
                CableKey::MaxSpeed => 46_000,
                CableKey::MaxAcceleration | CableKey::MaxJerk => 10_000_000,
                CableKey::LengthMin
                | CableKey::TensionOutput
                | CableKey::Play
                | CableKey::SpeedCornerMhz
                | CableKey::BrakePlay
                | CableKey::GainLength => 0,
                CableKey::LengthMax => 200_000_000,
                CableKey::Node => i32::from(index) + 1,
            };
            (ConfigKey::cable(index, key), value)
        })
    });
    let all = board.chain(cables);
    all.map(|(key, value)| ConfigEntry { key, value }).collect()
}
