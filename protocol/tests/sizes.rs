//! The largest of every message, built and compared with its constant and the frame.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::indexing_slicing,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_possible_wrap,
    missing_docs
)]

mod common;

use common::{Encoded, list};
use mcdpr_protocol::frame::MAX_FRAME;
use mcdpr_protocol::message::{CONFIG_CHUNK, PANIC_BYTES};
use mcdpr_protocol::telemetry::SAMPLE_BYTES;
use mcdpr_protocol::*;
use postcard::experimental::max_size::MaxSize;

/// The largest encoding of every request: all lists full, all numbers at their longest.
fn largest_requests() -> Vec<Request> {
    let most = || PerCable::collect([TenthMicrometres(i32::MIN); MAX_CABLES]);
    let tensions = || PerCable::collect([Millinewtons(i32::MIN); MAX_CABLES]);
    let entry = ConfigEntry {
        key: ConfigKey(u16::MAX),
        value: i32::MIN,
    };
    let cable = CableKnot {
        length: TenthMicrometres(i32::MIN),
        velocity: MicrometresPerSecond(i32::MIN),
        tension: Millinewtons(i32::MIN),
    };
    let row = ResidualRow {
        lengths: list([Coefficient(i16::MIN); MAX_CABLES]),
        tensions: list([Coefficient(i16::MIN); MAX_CABLES]),
        limit: Micrometres(i32::MIN),
    };
    vec![
        Request::Heartbeat {
            host_time_us: u32::MAX,
        },
        Request::ConfigBegin { entries: u16::MAX },
        Request::ConfigPut {
            entries: list([entry; CONFIG_CHUNK]),
        },
        Request::ConfigCommit {
            hash: ConfigHash(u32::MAX),
        },
        Request::Reference {
            lengths: most(),
            tensions: tensions(),
        },
        Request::Arm {
            config_hash: ConfigHash(u32::MAX),
        },
        Request::Knot(Knot {
            index: u16::MAX,
            time_ms: u32::MAX,
            last: true,
            cables: list([cable; MAX_CABLES]),
            rows: list([row.clone(), row]),
        }),
    ]
}

fn largest_status() -> Status {
    let long = FaultRecord {
        fault: FaultId::F9,
        cable: 255,
        tick: Tick(u32::MAX),
        value: i32::MIN,
        limit: i32::MIN,
    };
    Status {
        tick: Tick(u32::MAX),
        state: BoardState::EStop,
        path_ms: u32::MAX,
        setpoints: list([TenthMicrometres(i32::MIN); MAX_CABLES]),
        lengths: list([TenthMicrometres(i32::MIN); MAX_CABLES]),
        tensions: list([Millinewtons(i32::MIN); MAX_CABLES]),
        knots_free: 255,
        next_knot: u16::MAX,
        fault: Some(long),
        limits: Limits(u16::MAX),
        config: Some(ConfigHash(u32::MAX)),
        referenced: true,
        brakes_open: 255,
        torque_on: 255,
        gripper_closed: true,
        gripper_switch: true,
        frames_ok: u32::MAX,
        frames_bad: u32::MAX,
        sequence_errors: u32::MAX,
        tick_overruns: u32::MAX,
        telemetry_dropped: u32::MAX,
    }
}

#[test]
fn the_largest_of_every_message_fits_a_frame_and_is_what_the_constant_says() {
    let mut largest = 0;
    for request in largest_requests() {
        let command = Command {
            session: SessionId(u32::MAX),
            sequence: SequenceNumber(u16::MAX),
            request,
        };
        let encoded = Encoded::of(&command);
        assert!(encoded.frame <= MAX_FRAME);
        largest = largest.max(encoded.body);
    }
    assert_eq!(largest, Command::POSTCARD_MAX_SIZE);
    let status = largest_status();
    assert_eq!(Encoded::of(&status).body, Status::POSTCARD_MAX_SIZE);
    let info = Info {
        cables: 255,
        knot_capacity: 255,
        ticks_per_second: u16::MAX,
        drive_kinds: 255,
        simulated: true,
        last_panic: list([255; PANIC_BYTES]),
    };
    let beat = Reply::Beat {
        host_time_us: u32::MAX,
        tick: Tick(u32::MAX),
        state: BoardState::EStop,
        path_ms: u32::MAX,
        knots_free: 255,
        next_knot: u16::MAX,
    };
    let mut largest = 0;
    for reply in [Reply::Info(info), Reply::Status(status), beat] {
        let answer = Answer {
            sequence: SequenceNumber(u16::MAX),
            result: Ok(reply),
        };
        let encoded = Encoded::of(&answer);
        assert!(encoded.frame <= MAX_FRAME);
        largest = largest.max(encoded.body);
    }
    let record = largest_status().fault.unwrap();
    let refused = Answer {
        sequence: SequenceNumber(u16::MAX),
        result: Err(Reject::Faulted { record }),
    };
    largest = largest.max(Encoded::of(&refused).body);
    assert_eq!(largest, Answer::POSTCARD_MAX_SIZE);
}

#[test]
fn the_largest_block_of_every_number_of_cables_fits_a_frame() {
    for cables in 1..=MAX_CABLES {
        let previous = vec![TenthMicrometres(i32::MIN); cables];
        let row = vec![
            Sample {
                length: TenthMicrometres(i32::MIN + 32_767),
                tension: Millinewtons(65_535),
                current: Milliamps(-1),
            };
            cables
        ];
        let mut block = SampleBlock {
            tick: Tick(u32::MAX),
            path_ms: u32::MAX,
            lengths: list(previous.iter().copied()),
            packed: List::new(),
        };
        for position in 0..SampleBlock::ticks(cables) {
            assert!(block.append(position, &previous, &row));
        }
        assert!(block.packed.len() <= SAMPLE_BYTES);
        let encoded = Encoded::of(&block);
        assert!(
            encoded.frame <= MAX_FRAME,
            "{cables} cables: {} bytes",
            encoded.frame
        );
    }
}
