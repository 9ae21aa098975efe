//! A configuration, a random source, and a bench: a server with a trivial plant on its pins.

use mcdpr_firmware::server::LinkCounters;
use mcdpr_firmware::{Active, Brake, ConfigStore, DriveDemand, Inputs, Outputs, Server, State};
use mcdpr_protocol::{
    Answer, BoardKey, CableKey, CableKnot, Command, ConfigEntry, ConfigHash, ConfigKey, Knot, List,
    MicrometresPerSecond, Millinewtons, PerCable, Reject, Reply, Request, SequenceNumber,
    SessionId, Status, StopKind, TenthMicrometres, Tick, config_hash,
};

/// Splitmix64 (Steele, Lea and Flood 2014): the same numbers in every run.
pub struct Rng(pub u64);

impl Rng {
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// A whole number in `low..=high`.
    pub fn between(&mut self, low: i64, high: i64) -> i64 {
        low + (self.next() % (high - low + 1) as u64) as i64
    }
}

pub const CABLES: usize = 4;
/// Largest acceleration that the bench's cables may be commanded, µm/s².
pub const MOST_UMPS2: i32 = 4_000_000;
/// Largest jerk, mm/s³.
pub const MOST_MMPS3: i32 = 400_000;
/// Motor counts of a turn of the paper's 20 mm drum.
pub const MOTOR_COUNTS: i32 = 1_520_148;
/// Motor turns of a drum's turn, and its cable.
const MOTOR_TURNS: f64 = 371.13;
const DRUM_TURN_MM: f64 = 40.0 * std::f64::consts::PI;
pub const STOP_MS: u32 = 300;
pub const ENABLE_MS: u32 = 40;
pub const BRAKE_MS: u32 = 30;
/// Time in which the slowest of the bench's drives pushes for 200 ms in all, at most. The bench's drives
/// have no integral, so that they give the push in a part of the ticks only.
pub const PROOF_MS: u32 = 460;

/// Whether brakes were tested before torque went off: 200 ms of push, and the time to reach it.
pub fn is_proof(ms: u32) -> bool {
    (280..=PROOF_MS).contains(&ms)
}

/// Time in which the bench arms, at most: 30 ms of torque, the brakes' test, 50 ms to open, four drums
/// of 120 ms, 500 ms of rest.
pub const ARMING_MS: u32 = 2000;
pub const TENSION_MN: i32 = 10_000;
/// Length of every cable at the reference, 0.1 µm.
pub const START: i32 = 8_000_000;

/// The paper's winch at each of four cables; the fourth is held by its tension.
pub fn entries() -> Vec<ConfigEntry> {
    let mut all = Vec::new();
    for &key in BoardKey::ALL {
        let value = match key {
            BoardKey::Cables => 4,
            BoardKey::DriveKind => 1,
            BoardKey::BusBitrate => 1_000_000,
            BoardKey::BusPeriodUs | BoardKey::TensionPeriodUs => 2000,
            BoardKey::StopMs => STOP_MS as i32,
            BoardKey::ResidualMs => 100,
            BoardKey::EnableMs => ENABLE_MS as i32,
            BoardKey::FeedbackTimeoutMs => 10,
            BoardKey::HoldBrakes | BoardKey::FaultLine => 0,
        };
        all.push(ConfigEntry {
            key: ConfigKey::board(key),
            value,
        });
    }
    for index in 0..CABLES as u8 {
        for &key in CableKey::ALL {
            let value = match key {
                CableKey::Control => i32::from(index == 3),
                CableKey::DrumRadius => 200_000,
                CableKey::EncoderCountsPerTurn => 4096,
                CableKey::EncoderSign => {
                    if index % 2 == 0 {
                        1
                    } else {
                        -1
                    }
                }
                CableKey::MotorCountsPerTurn => MOTOR_COUNTS,
                CableKey::MaxMotorRpm => 8000,
                CableKey::MaxCurrentMa => 3000,
                CableKey::ForcePerCurrent => -50_000,
                CableKey::TensionGain => 12_770,
                CableKey::TensionZeroUv => 235_500,
                CableKey::TensionMax => 39_000,
                CableKey::TensionFloor => 500,
                CableKey::TensionCeiling => 34_000,
                CableKey::TensionLaw => 1,
                CableKey::TensionKp => 1000,
                CableKey::TensionKd => 20_000,
                CableKey::TensionKi => 2000,
                CableKey::TensionDamping => 50_000,
                CableKey::TensionFilterMhz => 30_000,
                CableKey::Friction => 500,
                CableKey::DrumMass => 2000,
                CableKey::LeadUs => 8000,
                CableKey::BrakeCloseMs => BRAKE_MS as i32,
                CableKey::FollowingError => 1000,
                CableKey::MaxSpeed => 46_000,
                CableKey::LengthMin => 0,
                CableKey::LengthMax => 200_000_000,
                CableKey::Node => i32::from(index) + 1,
                CableKey::MotorCountsPerRev => 4096,
                CableKey::ReelSpeed => 10_000,
                CableKey::MaxAcceleration => MOST_UMPS2,
                CableKey::MaxJerk => MOST_MMPS3,
                CableKey::TensionOutput
                | CableKey::Play
                | CableKey::SpeedCornerMhz
                | CableKey::BrakePlay
                | CableKey::GainLength => 0,
            };
            all.push(ConfigEntry {
                key: ConfigKey::cable(index, key),
                value,
            });
        }
    }
    all
}

/// The same with one value changed.
pub fn entries_with(key: ConfigKey, value: i32) -> Vec<ConfigEntry> {
    let mut all = entries();
    all.iter_mut().find(|entry| entry.key == key).unwrap().value = value;
    all
}

pub fn hash_of(entries: &[ConfigEntry]) -> ConfigHash {
    config_hash(entries.iter().copied())
}

/// Through the store, as on a board.
pub fn build(entries: &[ConfigEntry]) -> Result<Active<CABLES>, Reject> {
    let mut store = ConfigStore::<CABLES>::default();
    store.begin(entries.len() as u16)?;
    store.put(entries)?;
    commit(&mut store, hash_of(entries))
}

pub fn commit(store: &mut ConfigStore<CABLES>, hash: ConfigHash) -> Result<Active<CABLES>, Reject> {
    let mut active = None;
    store.build_into(hash, &mut active)?;
    Ok(active.unwrap())
}

/// Reading of the tension channel at this tension (Eq. 52 inverted).
pub fn adc_of(tension_mn: i32) -> u16 {
    let volts = f64::from(tension_mn) / 12_770.0 + 0.2355;
    (volts / 3.3 * 65_536.0).round() as u16
}

pub fn knot(index: u16, time_ms: u32, last: bool, cables: &[(i32, i32)]) -> Knot {
    Knot {
        index,
        time_ms,
        last,
        cables: PerCable::collect(cables.iter().map(|&(length, velocity)| CableKnot {
            length: TenthMicrometres(length),
            velocity: MicrometresPerSecond(velocity),
            tension: Millinewtons(TENSION_MN),
        })),
        rows: List::new(),
    }
}

/// A server whose drives obey at once, whose drums follow, and whose tensions stay.
#[derive(Clone)]
pub struct Bench {
    pub server: Server<CABLES>,
    pub now: Tick,
    pub outputs: Outputs<CABLES>,
    pub session: SessionId,
    pub next: SequenceNumber,
    /// Whether heartbeats are sent.
    pub beats: bool,
    /// Ticks from a demand until a drive is ready; `u32::MAX` for never.
    pub enable_ticks: [u32; CABLES],
    enabling: [u32; CABLES],
    /// Motor counts.
    pub motor: [i32; CABLES],
    /// Motor current, mA, and speed of the tension-held drum, mm/s.
    current: [i16; CABLES],
    speed: f64,
    /// Brakes that never open, and brakes that do not hold.
    pub stuck: [bool; CABLES],
    pub weak: [bool; CABLES],
    pub tension_mn: i32,
    pub e_stop: bool,
    pub line_errors: u16,
    /// Changes the board's inputs, last.
    pub tamper: fn(&mut Inputs<CABLES>),
}

impl Bench {
    pub fn at(first: Tick) -> Self {
        Self {
            server: Server::new(true),
            now: first,
            outputs: Outputs::default(),
            session: SessionId(77),
            next: SequenceNumber(0),
            beats: true,
            enable_ticks: [5; CABLES],
            enabling: [0; CABLES],
            motor: [1000, -2000, 3_000_000, 0],
            current: [0; CABLES],
            speed: 0.0,
            stuck: [false; CABLES],
            weak: [false; CABLES],
            tension_mn: TENSION_MN,
            e_stop: false,
            line_errors: 0,
            tamper: |_| {},
        }
    }

    pub fn new() -> Self {
        Self::at(Tick(0))
    }

    /// A board that ran its first tick and accepts this session, configured and referenced.
    pub fn ready() -> Self {
        Self::ready_at(Tick(0))
    }

    pub fn ready_at(first: Tick) -> Self {
        let mut bench = Self::at(first);
        bench.step();
        bench.open();
        bench.configure(&entries());
        bench.reference();
        bench
    }

    pub fn holding() -> Self {
        Self::holding_at(Tick(0))
    }

    pub fn holding_at(first: Tick) -> Self {
        let mut bench = Self::ready_at(first);
        bench.arm().unwrap();
        bench.until(State::Holding, ARMING_MS);
        bench
    }

    /// A motion of `ms` at 20 mm/s in between, running for `run` ticks.
    pub fn moving(ms: u32, run: u32) -> Self {
        let mut bench = Self::holding();
        bench.buffer(ms, true);
        bench.request(Request::Start).unwrap();
        bench.run(run);
        bench
    }

    /// As [`Self::ready`], with another configuration; and so the next ones.
    pub fn ready_with(entries: &[ConfigEntry]) -> Self {
        let mut bench = Self::new();
        bench.step();
        bench.open();
        bench.configure(entries);
        bench.reference();
        bench
    }

    pub fn holding_with(entries: &[ConfigEntry]) -> Self {
        let mut bench = Self::ready_with(entries);
        bench.arm_with(entries).unwrap();
        bench.until(State::Holding, ARMING_MS);
        bench
    }

    pub fn moving_with(entries: &[ConfigEntry], run: u32) -> Self {
        let mut bench = Self::holding_with(entries);
        bench.buffer(4000, true);
        bench.request(Request::Start).unwrap();
        bench.run(run);
        bench
    }

    pub fn open(&mut self) {
        self.request(Request::Open).unwrap();
    }

    pub fn configure(&mut self, entries: &[ConfigEntry]) {
        let count = entries.len() as u16;
        self.request(Request::ConfigBegin { entries: count })
            .unwrap();
        for chunk in entries.chunks(24) {
            let entries = List::collect(chunk.iter().copied());
            self.request(Request::ConfigPut { entries }).unwrap();
        }
        let hash = hash_of(entries);
        let reply = self.request(Request::ConfigCommit { hash });
        assert_eq!(reply, Ok(Reply::Configured { hash }));
    }

    pub fn reference_request() -> Request {
        Request::Reference {
            lengths: PerCable::collect([TenthMicrometres(START); CABLES]),
            tensions: PerCable::collect([Millinewtons(TENSION_MN); CABLES]),
        }
    }

    pub fn reference(&mut self) {
        self.request(Self::reference_request()).unwrap();
    }

    pub fn arm_request() -> Request {
        Request::Arm {
            config_hash: hash_of(&entries()),
        }
    }

    pub fn arm(&mut self) -> Result<Reply, Reject> {
        self.request(Self::arm_request())
    }

    pub fn arm_with(&mut self, entries: &[ConfigEntry]) -> Result<Reply, Reject> {
        self.request(Request::Arm {
            config_hash: hash_of(entries),
        })
    }

    /// Buffers rest, 20 mm/s from 200 ms on, and a constant speed until `ms`; `ends` adds a
    /// deceleration to rest of 200 ms.
    pub fn buffer(&mut self, ms: u32, ends: bool) {
        let at = self.status().setpoints;
        let point = |way: i32, velocity: i32| -> Vec<(i32, i32)> {
            at.iter().map(|length| (length.0 + way, velocity)).collect()
        };
        // 20 mm/s is 200 LSB per ms; the ramp of 200 ms takes half of that.
        let cruise = 20_000 + 200 * (ms as i32 - 200);
        let mut knots = vec![
            knot(0, 0, false, &point(0, 0)),
            knot(1, 200, false, &point(20_000, 20_000)),
            knot(2, ms, false, &point(cruise, 20_000)),
        ];
        if ends {
            knots.push(knot(3, ms + 200, true, &point(cruise + 20_000, 0)));
        }
        for knot in knots {
            self.request(Request::Knot(knot)).unwrap();
        }
    }

    pub fn send(
        &mut self,
        session: SessionId,
        sequence: SequenceNumber,
        request: Request,
    ) -> Answer {
        let command = Command {
            session,
            sequence,
            request,
        };
        self.server
            .receive(self.now, &command, &LinkCounters::default())
    }

    pub fn request(&mut self, request: Request) -> Result<Reply, Reject> {
        let sequence = self.next;
        let takes_number = request.is_sequenced() || request == Request::Open;
        let answer = self.send(self.session, sequence, request);
        assert_eq!(answer.sequence, sequence);
        if takes_number {
            self.next = sequence.next();
        }
        answer.result
    }

    pub fn stop(&mut self, kind: StopKind) {
        assert_eq!(self.request(Request::Stop(kind)), Ok(Reply::Done));
    }

    /// One tick: heartbeat, inputs from the plant, the core's step, the plant's motion.
    pub fn step(&mut self) -> Outputs<CABLES> {
        self.now = self.now.after(1);
        if self.beats {
            // Refused before the session is open: this bench does not check that.
            let _ = self.request(Request::Heartbeat { host_time_us: 0 });
        }
        let inputs = self.inputs();
        self.outputs = self.server.step(self.now, &inputs);
        for i in 0..CABLES {
            let enabled = self.outputs.drives[i] != DriveDemand::Off;
            self.enabling[i] = if enabled {
                self.enabling[i].saturating_add(1)
            } else {
                0
            };
            self.turn(i);
        }
        self.outputs
    }

    /// A tick of one drum: a stiff drive against a brake, or one that follows at once; or a force
    /// on a drum of 2 kg with half a newton of friction. 50 N are an ampere; a positive one pays
    /// out.
    fn turn(&mut self, i: usize) {
        let free = self.weak[i] || (self.outputs.brakes[i] == Brake::Open && !self.stuck[i]);
        let load_ma = -self.tension_mn / 50;
        match self.outputs.drives[i] {
            DriveDemand::Position { counts, .. } if free => {
                // As fast as a drum may turn: two of its encoder's counts, without a jump.
                let behind = counts.wrapping_sub(self.motor[i]);
                self.motor[i] += behind.clamp(-742, 742);
                self.current[i] = load_ma as i16;
            }
            DriveDemand::Position { counts, .. } => {
                let behind = counts.wrapping_sub(self.motor[i]);
                self.current[i] = (behind * 2).clamp(-3000, 3000) as i16;
            }
            DriveDemand::Current { ma } => {
                self.current[i] = ma;
                let pull_n = f64::from(self.tension_mn) * 1e-3;
                let force_n = pull_n + f64::from(ma) * 0.05;
                let rubs_n = if self.speed == 0.0 {
                    force_n.clamp(-0.5, 0.5)
                } else {
                    0.5_f64.copysign(self.speed)
                };
                // N over kg in a millisecond is mm/s.
                let before = self.speed;
                self.speed += (force_n - rubs_n) / 2.0;
                if before * self.speed < 0.0 || !free {
                    self.speed = 0.0;
                }
                let counts = self.speed * 1e-3 / DRUM_TURN_MM * f64::from(MOTOR_COUNTS);
                self.motor[i] += counts.round() as i32;
            }
            DriveDemand::Speed { rpm } => {
                self.speed = if free {
                    self.current[i] = load_ma as i16;
                    f64::from(rpm) / MOTOR_TURNS / 60.0 * DRUM_TURN_MM
                } else {
                    // The integral of its loop: 10 mA per tick at 50 rpm.
                    self.current[i] = (self.current[i] + rpm / 5).clamp(-3000, 3000);
                    0.0
                };
                let counts = self.speed * 1e-3 / DRUM_TURN_MM * f64::from(MOTOR_COUNTS);
                self.motor[i] += counts.round() as i32;
            }
            _ => self.current[i] = 0,
        }
    }

    /// What the drive reports.
    pub fn current_ma(&self, index: usize) -> i16 {
        self.current[index]
    }

    fn inputs(&mut self) -> Inputs<CABLES> {
        let mut inputs = Inputs {
            e_stop: self.e_stop,
            line_errors: self.line_errors,
            ..Inputs::default()
        };
        for i in 0..CABLES {
            let turns = f64::from(self.motor[i]) / f64::from(MOTOR_COUNTS);
            let counts = (turns * 4096.0).floor() as i64;
            let sign = if i % 2 == 0 { 1 } else { -1 };
            inputs.encoders[i] = (sign * counts) as u16;
            // A sensor is never constant to the last bit.
            let dither = (self.now.0 % 7) as u16;
            inputs.tension_adc[i] = adc_of(self.tension_mn) + dither;
            inputs.drives[i].ready = self.enabling[i] >= self.enable_ticks[i];
            inputs.drives[i].counts = self.motor[i];
            inputs.drives[i].current_ma = self.current[i];
            if i == 3 {
                inputs.drives[i].rpm = (self.speed * 60.0 * MOTOR_TURNS / DRUM_TURN_MM) as i16;
            }
        }
        (self.tamper)(&mut inputs);
        inputs
    }

    pub fn run(&mut self, ticks: u32) {
        for _ in 0..ticks {
            self.step();
        }
    }

    /// Runs until the state is reached; the ticks that took.
    pub fn until(&mut self, state: State, most: u32) -> u32 {
        for tick in 1..=most {
            self.step();
            if self.state() == state {
                return tick;
            }
        }
        panic!("{state:?} not reached in {most} ticks: {:?}", self.status());
    }

    pub fn state(&self) -> State {
        self.server.controller().state()
    }

    pub fn status(&self) -> Status {
        self.server.controller().status()
    }

    pub fn fault(&self) -> Option<mcdpr_protocol::FaultId> {
        self.server.controller().fault().map(|record| record.fault)
    }

    pub fn all_brakes(&self, brake: Brake) -> bool {
        self.outputs.brakes == [brake; CABLES]
    }

    pub fn any_torque(&self) -> bool {
        self.outputs.drives.iter().any(|drive| drive.gives_torque())
    }
}
