//! One example of every message, with its name and channel.
#![allow(dead_code, reason = "each test program uses a part")]

use mcdpr_protocol::frame::{MAX_FRAME, encode_bytes, encode_frame};
use mcdpr_protocol::*;

/// One message with its name.
pub enum Message {
    HelloQuery,
    Hello(Hello),
    Command(Command),
    Answer(Answer),
    Samples(SampleBlock),
    Status(Status),
}

impl Message {
    /// The whole frame, its delimiter included.
    pub fn frame(&self) -> Vec<u8> {
        let mut out = [0; MAX_FRAME];
        let used = match self {
            Self::HelloQuery => encode_bytes(Channel::HelloQuery, &[], &mut out),
            Self::Hello(hello) => encode_bytes(Channel::Hello, &hello.to_bytes(), &mut out),
            Self::Command(command) => encode_frame(Channel::Command, command, &mut out),
            Self::Answer(answer) => encode_frame(Channel::Answer, answer, &mut out),
            Self::Samples(block) => encode_frame(Channel::Samples, block, &mut out),
            Self::Status(status) => encode_frame(Channel::Status, status, &mut out),
        };
        out[..used.expect("every message fits a frame")].to_vec()
    }
}

pub fn list<T, const N: usize>(values: impl IntoIterator<Item = T>) -> List<T, N> {
    List::collect(values)
}

pub fn hello() -> Hello {
    Hello {
        major: 0,
        minor: 1,
        board_id: *b"\x01\x23\x45\x67\x89\xab\xcd\xef\x10\x32\x54\x76",
        git_hash: *b"2f674ec0",
        reset_cause: ResetCause::Pin,
    }
}

pub fn record() -> FaultRecord {
    FaultRecord {
        fault: FaultId::S2,
        cable: 3,
        tick: Tick(123_456),
        value: -1200,
        limit: 1000,
    }
}

pub fn knot() -> Knot {
    let cable = |k: i32| CableKnot {
        length: TenthMicrometres(8_000_000 + k),
        velocity: MicrometresPerSecond(-20_000 * k),
        tension: Millinewtons(10_000 + k),
    };
    let row = |k: i16| ResidualRow {
        lengths: list([0, k, -k, 4096].map(Coefficient)),
        tensions: list([1, -1, k, 256].map(Coefficient)),
        limit: Micrometres(1500),
    };
    Knot {
        index: 7,
        time_ms: 1400,
        last: false,
        cables: list((0..4).map(cable)),
        rows: list([row(300), row(-2)]),
    }
}

pub fn status() -> Status {
    Status {
        tick: Tick(u32::MAX - 1),
        state: BoardState::Moving,
        path_ms: 65_000,
        setpoints: list([1, -2, 3_000_000, 4].map(TenthMicrometres)),
        lengths: list([2, -3, 3_000_100, 5].map(TenthMicrometres)),
        tensions: list([10_000, 9000, -5, 39_130].map(Millinewtons)),
        knots_free: 9,
        next_knot: 300,
        fault: Some(record()),
        limits: Limits(0b1010_0001),
        config: Some(ConfigHash(0xDEAD_BEEF)),
        referenced: true,
        brakes_open: 0b1111,
        torque_on: 0b0111,
        gripper_closed: true,
        gripper_switch: false,
        frames_ok: 70_000,
        frames_bad: 3,
        sequence_errors: 2,
        tick_overruns: 1,
        telemetry_dropped: 128,
    }
}

/// A block of two ticks of four cables.
pub fn samples() -> SampleBlock {
    let mut block = SampleBlock {
        tick: Tick(5000),
        path_ms: 4000,
        lengths: list([8_000_000, 8_100_000, 8_200_000, 8_300_000].map(TenthMicrometres)),
        packed: List::new(),
    };
    let mut previous: Vec<_> = block.lengths.to_vec();
    for position in 0..2 {
        let rows: Vec<_> = previous
            .iter()
            .zip(0_i32..)
            .map(|(before, k)| Sample {
                length: TenthMicrometres(before.0 + 200 - 150 * k),
                tension: Millinewtons(10_000 + k),
                current: Milliamps(-300 * k),
            })
            .collect();
        assert!(block.append(position, &previous, &rows));
        previous = rows.iter().map(|row| row.length).collect();
    }
    block
}

pub fn requests() -> Vec<(&'static str, Request)> {
    let entry = |key: ConfigKey, value: i32| ConfigEntry { key, value };
    vec![
        ("Info", Request::Info),
        ("Status", Request::Status),
        ("Open", Request::Open),
        ("Close", Request::Close),
        (
            "Heartbeat",
            Request::Heartbeat {
                host_time_us: 4_000_000_000,
            },
        ),
        ("Stop.Hold", Request::Stop(StopKind::Hold)),
        ("Stop.Stop", Request::Stop(StopKind::Stop)),
        ("Stop.Emergency", Request::Stop(StopKind::Emergency)),
        ("ConfigBegin", Request::ConfigBegin { entries: 124 }),
        (
            "ConfigPut",
            Request::ConfigPut {
                entries: list([
                    entry(ConfigKey::board(BoardKey::Cables), 4),
                    entry(ConfigKey::cable(0, CableKey::EncoderSign), -1),
                    entry(ConfigKey::cable(3, CableKey::MotorCountsPerTurn), 1_520_148),
                ]),
            },
        ),
        (
            "ConfigCommit",
            Request::ConfigCommit {
                hash: ConfigHash(0xDEAD_BEEF),
            },
        ),
        (
            "Reference",
            Request::Reference {
                lengths: list([8_000_000, 8_100_000, 8_200_000, 8_300_000].map(TenthMicrometres)),
                tensions: list([10_000, 11_000, 12_000, 10_000].map(Millinewtons)),
            },
        ),
        (
            "Arm",
            Request::Arm {
                config_hash: ConfigHash(0xDEAD_BEEF),
            },
        ),
        ("Disarm", Request::Disarm),
        ("Knot", Request::Knot(knot())),
        (
            "Knot.last",
            Request::Knot(Knot {
                last: true,
                rows: List::new(),
                ..knot()
            }),
        ),
        ("Start", Request::Start),
        ("Resume", Request::Resume),
        ("Discard", Request::Discard),
        ("ClearFault", Request::ClearFault),
        ("Samples", Request::Samples { enabled: true }),
        ("Gripper", Request::Gripper { closed: true }),
        (
            "Service",
            Request::Service {
                config_hash: ConfigHash(0xDEAD_BEEF),
                cable: 2,
                open: true,
            },
        ),
        ("Winch", Request::Winch { cable: 4 }),
        ("Scan", Request::Scan { restart: true }),
        (
            "Bench",
            Request::Bench {
                test: BenchTest::Output { output: 5 },
            },
        ),
        ("Kept", Request::Kept),
    ]
}

pub fn replies() -> Vec<(&'static str, Reply)> {
    vec![
        ("Done", Reply::Done),
        (
            "Info",
            Reply::Info(Info {
                cables: 4,
                knot_capacity: 16,
                ticks_per_second: 1000,
                drive_kinds: 0b10,
                simulated: true,
                last_panic: list(*b"index out of bounds"),
            }),
        ),
        ("Status", Reply::Status(status())),
        (
            "Beat",
            Reply::Beat {
                host_time_us: 4_000_000_000,
                tick: Tick(99),
                state: BoardState::Holding,
                path_ms: 12,
                knots_free: 16,
                next_knot: 0,
            },
        ),
        ("Queued", Reply::Queued { free: 15 }),
        (
            "Configured",
            Reply::Configured {
                hash: ConfigHash(0xDEAD_BEEF),
            },
        ),
        (
            "Winch",
            Reply::Winch(Winch {
                ready: true,
                age_ms: 1,
                motor_counts: -1_520_148,
                current_ma: -250,
                drum_counts: 4096,
                tension_adc: 4677,
                ..Winch::default()
            }),
        ),
        (
            "Drives",
            Reply::Drives {
                done: true,
                nodes: [0b11110, 0, 0, 1],
            },
        ),
        (
            "Bench",
            Reply::Bench(Bench {
                id_code: 0x2003_6410,
                core_id: 0x411F_C231,
                maker: 0x20,
                flash_kib: 64,
                reset_flags: 0x0C,
                crystal: true,
                supply_mv: 3300,
                slow_hz: 40_000,
                can_errors: CanErrors {
                    transmit: 0,
                    receive: 1,
                },
                can_lost: 2,
                can_loop: Some(true),
                tick_cycles: 9000,
                stack_free: 3500,
                inputs: 1,
                outputs: 0,
            }),
        ),
        (
            "Kept",
            Reply::Kept(Kept {
                lengths: list([12_345_678, 9_000_000].map(TenthMicrometres)),
                brakes_open: 0b11,
                counted: true,
            }),
        ),
    ]
}

pub fn rejects() -> Vec<(&'static str, Reject)> {
    vec![
        (
            "WrongState",
            Reject::WrongState {
                state: BoardState::Fault,
            },
        ),
        ("SessionHeld", Reject::SessionHeld),
        ("NoSession", Reject::NoSession),
        (
            "Sequence",
            Reject::Sequence {
                expected: SequenceNumber(65_535),
            },
        ),
        ("Unsupported", Reject::Unsupported),
        (
            "CableCount",
            Reject::CableCount {
                expected: 4,
                got: 8,
            },
        ),
        ("NotConfigured", Reject::NotConfigured),
        (
            "ConfigHash",
            Reject::ConfigHash {
                board: ConfigHash(1),
                host: ConfigHash(u32::MAX),
            },
        ),
        ("ConfigSequence", Reject::ConfigSequence),
        ("ConfigUnknownKey", Reject::ConfigUnknownKey { key: 0x0920 }),
        ("ConfigValue", Reject::ConfigValue { key: 0x0102 }),
        ("NotReferenced", Reject::NotReferenced),
        ("BufferFull", Reject::BufferFull),
        ("KnotIndex", Reject::KnotIndex { expected: 8 }),
        ("KnotTime", Reject::KnotTime { earliest_ms: 4004 }),
        (
            "KnotStart",
            Reject::KnotStart {
                cable: 2,
                gap: TenthMicrometres(-51),
            },
        ),
        ("KnotLength", Reject::KnotLength { cable: 1 }),
        ("KnotSpeed", Reject::KnotSpeed { cable: 2 }),
        ("KnotTension", Reject::KnotTension { cable: 3 }),
        ("KnotEnd", Reject::KnotEnd),
        ("NothingToStart", Reject::NothingToStart),
        ("Faulted", Reject::Faulted { record: record() }),
        (
            "CauseRemains",
            Reject::CauseRemains {
                fault: FaultId::L10,
            },
        ),
        ("KnotAcceleration", Reject::KnotAcceleration { cable: 8 }),
        ("KnotJerk", Reject::KnotJerk { cable: 1 }),
        ("Configured", Reject::Configured),
    ]
}

/// Everything, named.
pub fn messages() -> Vec<(String, Message)> {
    let sequence = SequenceNumber(1000);
    let mut all = vec![
        ("hello_query".to_owned(), Message::HelloQuery),
        ("hello".to_owned(), Message::Hello(hello())),
    ];
    for (name, request) in requests() {
        let session = SessionId(0x1234_5678);
        let command = Command {
            session,
            sequence,
            request,
        };
        all.push((format!("command.{name}"), Message::Command(command)));
    }
    for (name, reply) in replies() {
        let answer = Answer {
            sequence,
            result: Ok(reply),
        };
        all.push((format!("answer.ok.{name}"), Message::Answer(answer)));
    }
    for (name, reject) in rejects() {
        let answer = Answer {
            sequence,
            result: Err(reject),
        };
        all.push((format!("answer.refused.{name}"), Message::Answer(answer)));
    }
    all.push(("samples".to_owned(), Message::Samples(samples())));
    all.push(("status".to_owned(), Message::Status(status())));
    all.push((
        "status.fresh".to_owned(),
        Message::Status(Status::default()),
    ));
    all
}

pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

pub fn unhex(text: &str) -> Vec<u8> {
    let digits: Vec<u32> = text.chars().filter_map(|c| c.to_digit(16)).collect();
    digits
        .chunks(2)
        .map(|pair| (pair[0] * 16 + pair[1]) as u8)
        .collect()
}

/// Sizes of an encoded message.
pub struct Encoded {
    pub body: usize,
    pub frame: usize,
}

impl Encoded {
    pub fn of<T: serde::Serialize>(message: &T) -> Self {
        let mut out = [0; MAX_FRAME];
        let frame = encode_frame(Channel::Answer, message, &mut out).expect("fits a frame");
        let mut deframer = Deframer::new();
        let mut bodies = 0;
        for byte in &out[..frame] {
            if let Some(received) = deframer.push(*byte) {
                bodies += received.expect("what was just framed").1.len();
            }
        }
        Self {
            body: bodies,
            frame,
        }
    }
}
