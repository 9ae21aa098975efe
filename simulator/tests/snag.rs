//! The platform caught by a stiff hook while it moves: the control core on the plant, with the
//! winches of the paper's robot (34 kg at the cable) and of the lab's light ones (1.9 kg and 0.1 kg),
//! in every direction. The bounds are those of `docs/faults.md`, row C2.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::indexing_slicing,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    missing_docs
)]

use mcdpr_firmware::drives::DriveBus;
use mcdpr_firmware::server::LinkCounters;
use mcdpr_firmware::{Brake, Inputs, Server, State};
use mcdpr_protocol::{
    BoardKey, CableKey, CableKnot, Command, ConfigEntry, ConfigKey, FaultId, Knot, List,
    MicrometresPerSecond, Millinewtons, PerCable, Reject, Reply, Request, SequenceNumber,
    SessionId, TenthMicrometres, Tick, config_hash,
};
use mcdpr_simulator::can::DriveLine;
use mcdpr_simulator::plant::{Plant, PlantParams, Pose, WinchParams};

const CEILING_N: f64 = 34.0;
const TENSION_N: f64 = 10.0;
const HELD: usize = 3;
/// Time between two knots, ms.
const SPACING_MS: u32 = 40;

/// The winches under test.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Winches {
    /// 371:1, 34 kg at the cable, 45 mm/s (robots/paper-optimistic.toml).
    Geared,
    /// 27:1, 1.9 kg, 0.62 m/s (robots/lab-fast.toml).
    Light,
    /// As light, and cable 4 on a direct drive of 0.1 kg (robots/lab-direct.toml).
    Direct,
}

impl Winches {
    fn params(self) -> PlantParams {
        let mut params = PlantParams::paper_optimistic();
        for (index, winch) in params.winches.iter_mut().enumerate() {
            let direct = self == Self::Direct && index == HELD;
            // Gear, motor counts per drum turn, rpm, A, N m/A, kg m², kg.
            let (gear, counts, rpm, current, constant, inertia, drum) = match self {
                Self::Geared => (371.13, 1_520_148.0, 8000.0, 0.5, 0.006, 1e-7, 0.1),
                _ if direct => (1.0, 65_536.0, 300.0, 3.0, 0.5, 3e-5, 0.025),
                _ => (27.0, 110_592.0, 8000.0, 4.0, 0.02, 1e-6, 0.1),
            };
            winch.gear_ratio = gear;
            winch.motor_counts_per_drum_turn = counts;
            winch.max_motor_rpm = rpm;
            winch.max_current_a = current;
            winch.torque_constant_nm_per_a = constant;
            winch.rotor_inertia_kg_m2 = inertia;
            winch.drum_mass_kg = drum;
            winch.drive.max_acceleration_mps2 = 100.0;
        }
        params
    }

    /// Gains of cable 4's law as in its robot file: kp and ki in thousandths, damping in mN s/m,
    /// filter in mHz, kd in µs.
    fn law(self) -> [i32; 5] {
        match self {
            Self::Geared => [2000, 4000, 400_000, 50_000, 20_000],
            Self::Light => [200, 2000, 120_000, 80_000, 0],
            Self::Direct => [500, 20_000, 10_000, 80_000, 0],
        }
    }
}

fn cable_value(key: CableKey, index: usize, winch: &WinchParams, law: [i32; 5]) -> i32 {
    let round = |value: f64| value.round() as i32;
    match key {
        CableKey::Control => i32::from(index == HELD),
        CableKey::DrumRadius => 200_000,
        CableKey::EncoderCountsPerTurn => 4096,
        CableKey::MotorCountsPerRev => round(winch.motor_counts_per_drum_turn / winch.gear_ratio),
        CableKey::EncoderSign | CableKey::TensionLaw => 1,
        CableKey::MotorCountsPerTurn => round(winch.motor_counts_per_drum_turn),
        CableKey::MaxMotorRpm => round(winch.max_motor_rpm),
        CableKey::MaxCurrentMa => round(winch.max_current_a * 1e3),
        CableKey::ForcePerCurrent => round(-winch.force_per_ampere_n() * 1e3),
        CableKey::TensionGain => 12_770,
        CableKey::TensionZeroUv => 235_500,
        CableKey::TensionMax => 39_130,
        CableKey::TensionFloor => 1000,
        CableKey::TensionCeiling => round(CEILING_N * 1e3),
        CableKey::TensionKp => law[0],
        CableKey::TensionKi => law[1],
        CableKey::TensionDamping => law[2],
        CableKey::TensionFilterMhz => law[3],
        CableKey::TensionKd => law[4],
        CableKey::Friction => 500,
        CableKey::DrumMass => round(winch.effective_mass_kg() * 1e3),
        // 1 / 150 rad/s, half a period of 2 ms, and the bus.
        CableKey::LeadUs => 7917,
        CableKey::BrakeCloseMs => 30,
        CableKey::FollowingError => 1000,
        CableKey::MaxSpeed => round(winch.max_speed_mps() * 1.02e6),
        CableKey::LengthMin
        | CableKey::TensionOutput
        | CableKey::Play
        | CableKey::SpeedCornerMhz
        | CableKey::BrakePlay
        | CableKey::GainLength => 0,
        CableKey::LengthMax => 20_000_000,
        CableKey::Node => index as i32 + 1,
        CableKey::ReelSpeed => 5000,
        CableKey::MaxAcceleration => 20_000_000,
        CableKey::MaxJerk => 10_000_000,
    }
}

fn entries(winches: Winches, params: &PlantParams) -> Vec<ConfigEntry> {
    let board = |key: &BoardKey| match key {
        BoardKey::Cables => 4,
        BoardKey::DriveKind => 1,
        BoardKey::BusBitrate => 1_000_000,
        BoardKey::BusPeriodUs | BoardKey::TensionPeriodUs => 2000,
        BoardKey::StopMs => 300,
        BoardKey::ResidualMs => 100,
        BoardKey::EnableMs => 1100,
        BoardKey::FeedbackTimeoutMs => 10,
        BoardKey::HoldBrakes | BoardKey::FaultLine => 0,
    };
    let entry = |key, value| ConfigEntry { key, value };
    let of_board = |key: &BoardKey| entry(ConfigKey::board(*key), board(key));
    let mut all: Vec<_> = BoardKey::ALL.iter().map(of_board).collect();
    for (index, winch) in params.winches.iter().enumerate() {
        for &key in CableKey::ALL {
            let value = cable_value(key, index, winch, winches.law());
            all.push(entry(ConfigKey::cable(index as u8, key), value));
        }
    }
    all
}

fn tenths(length_m: f64) -> TenthMicrometres {
    TenthMicrometres((length_m * 1e7).round() as i32)
}

fn millinewtons(tension_n: f64) -> Millinewtons {
    Millinewtons((tension_n * 1e3).round() as i32)
}

/// The robot at rest, `way_m` along a line from the middle of its workspace.
fn hang(params: &PlantParams, along: [f64; 3], way_m: f64) -> Plant {
    let mut plant = Plant::new(params.clone(), 5).unwrap();
    let middle = [0.33, 0.0, -0.22];
    let at = [0, 1, 2].map(|axis| middle[axis] + along[axis] * way_m);
    let pose = Pose::level(at);
    plant.settle_with_tension(&pose, HELD, TENSION_N).unwrap();
    plant
}

/// Unstretched lengths and tensions of the platform at rest, at five points of a line.
struct Line {
    points: Vec<([f64; 4], [f64; 4])>,
    way_m: f64,
}

impl Line {
    const POINTS: usize = 5;

    fn new(params: &PlantParams, along: [f64; 3], way_m: f64) -> Self {
        let points = (0..Self::POINTS).map(|point| {
            let plant = hang(params, along, way_m * point as f64 / 4.0);
            let truth = plant.truth().unwrap();
            let four = |values: [f64; 8]| [values[0], values[1], values[2], values[3]];
            let lengths = four(truth.unstretched_lengths_m);
            (lengths, four(truth.tensions_winch_n))
        });
        let points = points.collect();
        Self { points, way_m }
    }

    /// Lagrange's polynomial through the points, at a share of the line.
    fn at(&self, share: f64) -> ([f64; 4], [f64; 4]) {
        let mut sum = ([0.0; 4], [0.0; 4]);
        for (i, (lengths, tensions)) in self.points.iter().enumerate() {
            let others = (0..Self::POINTS).filter(|&j| j != i);
            let weight: f64 = others
                .map(|j| (4.0 * share - j as f64) / (i as f64 - j as f64))
                .product();
            for cable in 0..4 {
                sum.0[cable] += weight * lengths[cable];
                sum.1[cable] += weight * tensions[cable];
            }
        }
        sum
    }

    /// The knots of half a cosine with this largest speed, from the line's start to its end.
    fn knots(&self, speed_mps: f64) -> Vec<Knot> {
        let takes_ms = std::f64::consts::FRAC_PI_2 * self.way_m / speed_mps * 1e3;
        let count = (takes_ms / f64::from(SPACING_MS)).ceil() as u32;
        let takes_ms = f64::from(count * SPACING_MS);
        let share = |ms: f64| {
            let ms = ms.clamp(0.0, takes_ms);
            0.5 - 0.5 * (std::f64::consts::PI * ms / takes_ms).cos()
        };
        let knot = |index: u32| {
            let ms = f64::from(index * SPACING_MS);
            let (lengths, tensions) = self.at(share(ms));
            let (before, after) = (self.at(share(ms - 0.5)).0, self.at(share(ms + 0.5)).0);
            let moves = index != 0 && index != count;
            let cable = |cable: usize| CableKnot {
                length: tenths(lengths[cable]),
                velocity: MicrometresPerSecond(if moves {
                    ((after[cable] - before[cable]) * 1e9).round() as i32
                } else {
                    0
                }),
                tension: millinewtons(tensions[cable]),
            };
            Knot {
                index: index as u16,
                time_ms: index * SPACING_MS,
                last: index == count,
                cables: PerCable::collect((0..4).map(cable)),
                rows: List::new(),
            }
        };
        (0..=count).map(knot).collect()
    }
}

/// The core with its drives on the plant, and a host that feeds it.
struct Robot {
    plant: Plant,
    line: DriveLine,
    drives: DriveBus<4>,
    server: Server<4>,
    now: Tick,
    next: SequenceNumber,
    knots: std::collections::VecDeque<Knot>,
}

impl Robot {
    fn holding(winches: Winches, params: &PlantParams, line: &Line, along: [f64; 3]) -> Self {
        let plant = hang(params, along, 0.0);
        let mut robot = Self {
            line: DriveLine::new(&plant),
            plant,
            drives: DriveBus::default(),
            server: Server::new(true),
            now: Tick(0),
            next: SequenceNumber(0),
            knots: std::collections::VecDeque::new(),
        };
        robot.tick();
        robot.ask(Request::Open).unwrap();
        let all = entries(winches, params);
        let hash = config_hash(all.iter().copied());
        let entries = all.len() as u16;
        robot.ask(Request::ConfigBegin { entries }).unwrap();
        for chunk in all.chunks(8) {
            let entries = List::collect(chunk.iter().copied());
            robot.ask(Request::ConfigPut { entries }).unwrap();
        }
        robot.ask(Request::ConfigCommit { hash }).unwrap();
        let (lengths, tensions) = line.at(0.0);
        let lengths = PerCable::collect(lengths.into_iter().map(tenths));
        let tensions = PerCable::collect(tensions.into_iter().map(millinewtons));
        robot.ask(Request::Reference { lengths, tensions }).unwrap();
        // The drives are set up meanwhile.
        robot.run(1200);
        robot.ask(Request::Arm { config_hash: hash }).unwrap();
        for _ in 0..5000 {
            robot.tick();
            if robot.state() == State::Holding {
                return robot;
            }
        }
        panic!("{:?} {:?}", robot.state(), robot.fault());
    }

    fn ask(&mut self, request: Request) -> Result<Reply, Reject> {
        let numbered = request.is_sequenced() || request == Request::Open;
        let command = Command {
            session: SessionId(7),
            sequence: self.next,
            request,
        };
        let counters = LinkCounters::default();
        let answer = self.server.receive(self.now, &command, &counters);
        if numbered {
            self.next = self.next.next();
        }
        answer.result
    }

    fn tick(&mut self) {
        self.now = self.now.after(1);
        let until_us = u64::from(self.now.0) * 1000;
        self.line.advance(&mut self.plant, until_us).unwrap();
        let _ = self.ask(Request::Heartbeat { host_time_us: 0 });
        while let Some(knot) = self.knots.front().cloned() {
            if self.ask(Request::Knot(knot)).is_err() {
                break;
            }
            self.knots.pop_front();
        }
        let sensors = self.plant.read_sensors();
        let mut inputs = Inputs::default();
        let counts = &sensors.encoder_counts[..4];
        inputs.encoders.copy_from_slice(counts);
        inputs.tension_adc.copy_from_slice(&sensors.adc[..4]);
        self.drives.listen(&mut self.line.port());
        self.drives.fill(&mut inputs);
        let outputs = self.server.step(self.now, &inputs);
        let config = self.server.controller().config();
        let mut port = self.line.port();
        self.drives.tick(self.now, config, &outputs, &mut port);
        for (cable, brake) in outputs.brakes.iter().enumerate() {
            let closed = *brake == Brake::Closed;
            self.plant.set_brake(cable, closed).unwrap();
        }
    }

    fn run(&mut self, ticks: u32) {
        for _ in 0..ticks {
            self.tick();
        }
    }

    fn state(&self) -> State {
        self.server.controller().state()
    }

    fn fault(&self) -> Option<FaultId> {
        self.server.controller().fault().map(|record| record.fault)
    }
}

/// Result of a snag.
#[derive(Debug)]
struct Snagged {
    /// Largest tension over its limit, on the way and at the end.
    peak: f64,
    end: f64,
    /// Longest time over the limit, ms.
    over_ms: u32,
    fault: Option<FaultId>,
    after_ms: u32,
    state: State,
}

/// The robot moves along a line with this largest speed and is caught in its middle: in every
/// direction, or in one.
fn snagged(
    winches: Winches,
    along: [f64; 3],
    (way_m, speed_mps): (f64, f64),
    against: Option<[f64; 3]>,
) -> Snagged {
    let params = winches.params();
    let line = Line::new(&params, along, way_m);
    let mut robot = Robot::holding(winches, &params, &line, along);
    let knots = line.knots(speed_mps);
    let half_ms = knots.last().unwrap().time_ms / 2;
    robot.knots = knots.into();
    robot.tick();
    robot.ask(Request::Start).unwrap();
    robot.run(half_ms);
    let so_far = (robot.state(), robot.fault());
    assert_eq!(so_far, (State::Moving, None), "{winches:?} {along:?}");
    robot.plant.hook(params.platform.tcp_m, against).unwrap();
    let mut out = Snagged {
        peak: 0.0,
        end: 0.0,
        over_ms: 0,
        fault: None,
        after_ms: 0,
        state: State::Moving,
    };
    let mut over = [0_u32; 4];
    for ms in 0..4000 {
        robot.tick();
        let tensions_n = robot.plant.truth().unwrap().tensions_winch_n;
        out.end = 0.0;
        for (cable, over) in over.iter_mut().enumerate() {
            let share = tensions_n[cable] / CEILING_N;
            out.peak = out.peak.max(share);
            out.end = out.end.max(share);
            *over = if share > 1.0 { *over + 1 } else { 0 };
            out.over_ms = out.over_ms.max(*over);
        }
        if let (None, Some(fault)) = (out.fault, robot.fault()) {
            (out.fault, out.after_ms) = (Some(fault), ms);
        }
    }
    out.state = robot.state();
    out
}

const DIRECTIONS: [[f64; 3]; 6] = [
    [1.0, 0.0, 0.0],
    [-1.0, 0.0, 0.0],
    [0.0, 1.0, 0.0],
    [0.0, -1.0, 0.0],
    [0.0, 0.0, 1.0],
    [0.0, 0.0, -1.0],
];

/// The worst of a set of snags: peak, longest time over the limit in ms, tension at the end.
fn worst(winches: Winches, motion: (f64, f64)) -> (f64, u32, f64) {
    let mut worst = (0.0_f64, 0, 0.0_f64);
    for along in DIRECTIONS {
        for against in [None, Some(along)] {
            let out = snagged(winches, along, motion, against);
            println!("{winches:?} {motion:?} along {along:?} {against:?}: {out:?}");
            assert!(out.fault.is_some() && out.state == State::Fault, "{out:?}");
            worst.0 = worst.0.max(out.peak);
            worst.1 = worst.1.max(out.over_ms);
            worst.2 = worst.2.max(out.end);
        }
    }
    println!("{winches:?} {motion:?}: {worst:?}");
    worst
}

/// A cable is never over 1.3 times its limit, and under it again within 50 ms.
fn keeps_the_bound(winches: Winches, motion: (f64, f64)) {
    let (peak, over_ms, end) = worst(winches, motion);
    assert!(
        peak <= 1.3,
        "{winches:?} {motion:?}: {peak} times the limit"
    );
    assert!(
        over_ms <= 50,
        "{winches:?} {motion:?}: over for {over_ms} ms"
    );
    assert!(end < 1.0, "{winches:?} {motion:?}: braked at {end}");
}

#[test]
fn c2_geared_drums_at_30_mm_per_s() {
    keeps_the_bound(Winches::Geared, (0.06, 0.03));
}

#[test]
fn c2_light_drums_at_100_mm_per_s() {
    keeps_the_bound(Winches::Light, (0.1, 0.1));
}

#[test]
fn c2_a_direct_drive_at_100_mm_per_s() {
    keeps_the_bound(Winches::Direct, (0.1, 0.1));
}
