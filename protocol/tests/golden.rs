//! The stored bytes of this version. While the major version is 0 they may change with a line in the
//! changelog: `MCDPR_BLESS=1 cargo test -p mcdpr-protocol --test golden` rewrites them.
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

use common::{Message, hex, messages, rejects, replies, requests, unhex};
use mcdpr_protocol::frame::MAX_FRAME;
use mcdpr_protocol::message::{decode, decode_command, encode_answer, encode_status};
use mcdpr_protocol::*;
use std::collections::BTreeMap;
use std::path::Path;

#[test]
fn every_message_has_its_golden_bytes() {
    let file = format!("tests/golden/v{PROTOCOL_MAJOR}.{PROTOCOL_MINOR}.txt");
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(file);
    let actual: Vec<_> = messages()
        .iter()
        .map(|(name, m)| (name.clone(), hex(&m.frame())))
        .collect();
    if std::env::var_os("MCDPR_BLESS").is_some_and(|value| value == "1") {
        let lines = actual.iter().map(|(name, hex)| format!("{name} = {hex}\n"));
        std::fs::write(&path, lines.collect::<String>()).unwrap();
    }
    let text = std::fs::read_to_string(&path).expect("golden bytes of this version");
    let mut golden = BTreeMap::new();
    for line in text.lines() {
        let (name, hex) = line.split_once(" = ").expect("name = hex");
        assert!(golden.insert(name, hex).is_none(), "{name} is there twice");
    }
    for (name, hex) in &actual {
        let kept = golden.remove(name.as_str());
        let kept = kept.unwrap_or_else(|| panic!("no golden bytes of {name}"));
        assert_eq!(hex, kept, "the bytes of {name} changed");
    }
    assert!(
        golden.is_empty(),
        "golden bytes of nothing: {:?}",
        golden.keys()
    );
}

#[test]
fn golden_bytes_decode_to_their_messages() {
    for (name, message) in messages() {
        let mut deframer = Deframer::new();
        let bytes = unhex(&hex(&message.frame()));
        let (last, rest) = bytes.split_last().unwrap();
        assert_eq!(*last, 0);
        for byte in rest {
            assert!(deframer.push(*byte).is_none());
        }
        let (channel, body) = deframer.push(*last).unwrap().unwrap();
        match (&message, channel) {
            (Message::HelloQuery, Channel::HelloQuery) => assert!(body.is_empty()),
            (Message::Hello(hello), Channel::Hello) => {
                assert_eq!(Hello::from_bytes(body).as_ref(), Some(hello));
            }
            (Message::Command(command), Channel::Command) => {
                assert_eq!(decode::<Command>(body).as_ref(), Some(command));
            }
            (Message::Answer(answer), Channel::Answer) => {
                assert_eq!(decode::<Answer>(body).as_ref(), Some(answer));
            }
            (Message::Samples(block), Channel::Samples) => {
                assert_eq!(decode::<SampleBlock>(body).as_ref(), Some(block));
            }
            (Message::Status(status), Channel::Status) => {
                assert_eq!(decode::<Status>(body).as_ref(), Some(status));
            }
            _ => panic!("{name} came on {channel:?}"),
        }
    }
}

/// A board encodes and decodes by functions of its own, for size.
#[test]
fn a_boards_encoders_and_decoder_agree_with_the_golden_bytes() {
    for (name, message) in messages() {
        let golden = message.frame();
        let mut out = [0xA5; MAX_FRAME];
        let used = match &message {
            Message::Answer(answer) => encode_answer(answer, &mut out),
            Message::Status(status) => encode_status(status, &mut out),
            Message::Samples(block) => block.encode(&mut out),
            Message::Command(command) => {
                let mut deframer = Deframer::new();
                let (last, rest) = golden.split_last().unwrap();
                assert!(rest.iter().all(|byte| deframer.push(*byte).is_none()));
                let (_, body) = deframer.push(*last).unwrap().unwrap();
                assert_eq!(decode_command(body).as_ref(), Some(command), "{name}");
                continue;
            }
            Message::Hello(_) | Message::HelloQuery => continue,
        };
        assert_eq!(&out[..used.unwrap()], &golden[..], "{name}");
    }
}

/// The first byte of an enum is its variant: the examples must cover all of them, and the number
/// after the last must be invalid.
fn covers_every_variant<T>(values: &[T])
where
    T: serde_shim::Both,
{
    let mut seen: Vec<u8> = values.iter().map(|value| value.to_bytes()[0]).collect();
    seen.dedup();
    let all: Vec<u8> = (0..seen.len() as u8).collect();
    assert_eq!(seen, all, "variants without an example");
    let mut next = [0; 600];
    next[0] = seen.len() as u8;
    assert!(!T::decodes(&next), "variant {} has no example", seen.len());
    next[0] = 0;
    assert!(T::decodes(&next), "zeros are a first variant");
}

/// Encoding and decoding without naming serde here.
mod serde_shim {
    use super::*;
    use mcdpr_protocol::frame::{MAX_FRAME, encode_frame};

    pub trait Both {
        fn to_bytes(&self) -> Vec<u8>;
        /// Whether some leading part of these bytes is a value.
        fn decodes(bytes: &[u8]) -> bool;
    }

    macro_rules! both {
        ($($type:ty),*) => {$(
            impl Both for $type {
                fn to_bytes(&self) -> Vec<u8> {
                    let mut out = [0; MAX_FRAME];
                    let used = encode_frame(Channel::Command, self, &mut out).unwrap();
                    let mut deframer = Deframer::new();
                    for byte in &out[..used - 1] {
                        assert!(deframer.push(*byte).is_none());
                    }
                    deframer.push(0).unwrap().unwrap().1.to_vec()
                }
                fn decodes(bytes: &[u8]) -> bool {
                    (1..bytes.len()).any(|length| decode::<$type>(&bytes[..length]).is_some())
                }
            }
        )*};
    }
    both!(Request, Reply, Reject, BoardState, StopKind);
}

#[test]
fn every_variant_has_an_example() {
    covers_every_variant(&requests().into_iter().map(|(_, r)| r).collect::<Vec<_>>());
    covers_every_variant(&replies().into_iter().map(|(_, r)| r).collect::<Vec<_>>());
    covers_every_variant(&rejects().into_iter().map(|(_, r)| r).collect::<Vec<_>>());
}

#[test]
fn states_and_stops_keep_their_numbers() {
    use BoardState::*;
    let states = [
        Boot, Disarmed, Arming, Holding, Moving, Pausing, Stopping, Fault, EStop,
    ];
    covers_every_variant(&states);
    covers_every_variant(&[StopKind::Hold, StopKind::Stop, StopKind::Emergency]);
}

#[test]
fn channels_and_reset_causes_keep_their_numbers() {
    let channels = [
        (Channel::HelloQuery, 0x01),
        (Channel::Hello, 0x02),
        (Channel::Command, 0x10),
        (Channel::Answer, 0x20),
        (Channel::Samples, 0x30),
        (Channel::Status, 0x31),
    ];
    for (channel, number) in channels {
        assert_eq!(channel as u8, number);
    }
    let known = channels.map(|(_, number)| number);
    for number in 0..=255_u8 {
        // A frame made by hand: channel, no body, checksum.
        let mut plain = vec![number];
        plain.extend(frame::crc32(&[number]).to_le_bytes());
        let mut deframer = Deframer::new();
        for byte in cobs(&plain) {
            assert!(deframer.push(byte).is_none());
        }
        let result = deframer.push(0).unwrap();
        match known.contains(&number) {
            true => assert_eq!(result.unwrap().0 as u8, number),
            false => assert_eq!(result.err(), Some(FrameError::UnknownChannel)),
        }
    }
    let causes = [
        ResetCause::Unknown,
        ResetCause::Power,
        ResetCause::Pin,
        ResetCause::Software,
        ResetCause::Watchdog,
        ResetCause::Panic,
    ];
    for (number, cause) in (0..).zip(causes) {
        assert_eq!(cause as u8, number);
        let mut bytes = common::hello().to_bytes();
        bytes[30] = number;
        assert_eq!(Hello::from_bytes(&bytes).unwrap().reset_cause, cause);
    }
    let mut bytes = common::hello().to_bytes();
    bytes[30] = 200;
    assert_eq!(
        Hello::from_bytes(&bytes).unwrap().reset_cause,
        ResetCause::Unknown
    );
}

/// COBS as Cheshire and Baker (1999) describe it, for frames under 254 bytes.
fn cobs(plain: &[u8]) -> Vec<u8> {
    assert!(plain.len() < 254);
    let mut out = vec![];
    for part in plain.split(|byte| *byte == 0) {
        out.push(part.len() as u8 + 1);
        out.extend_from_slice(part);
    }
    out
}

#[test]
fn the_frozen_hello_is_where_it_always_is() {
    let bytes = common::hello().to_bytes();
    assert_eq!(bytes.len(), 31);
    assert_eq!(&bytes[..6], b"MCDPR\0");
    assert_eq!(bytes[6..10], [0, 0, 1, 0]);
    assert_eq!(bytes[10..22], common::hello().board_id);
    assert_eq!(&bytes[22..30], b"2f674ec0");
    assert_eq!(bytes[30], 2);
    // Later boards append; shorter messages and other devices are rejected.
    let mut longer = bytes.to_vec();
    longer.extend(b"and more");
    assert_eq!(Hello::from_bytes(&longer), Some(common::hello()));
    for short in 0..31 {
        assert_eq!(Hello::from_bytes(&bytes[..short]), None);
    }
    assert_eq!(Hello::from_bytes(&[0; 31]), None);
}

#[test]
fn l17_while_the_major_version_is_0_only_the_same_minor_version_moves() {
    let of = |major, minor| {
        Hello {
            major,
            minor,
            ..common::hello()
        }
        .compatibility()
    };
    assert_eq!(of(0, PROTOCOL_MINOR), Compatibility::Full);
    assert_eq!(of(0, PROTOCOL_MINOR - 1), Compatibility::BoardOlder);
    assert_eq!(of(0, PROTOCOL_MINOR + 1), Compatibility::BoardNewer);
    assert_eq!(of(1, 0), Compatibility::BoardNewer);
    assert_eq!(of(1, 1), Compatibility::BoardNewer);
}

#[test]
fn faults_keep_their_numbers() {
    let rows: [(u8, &str, u8); 8] = [
        (0, "L", 19),
        (32, "S", 12),
        (48, "D", 7),
        (64, "B", 3),
        (80, "P", 7),
        (96, "C", 5),
        (112, "K", 10),
        (128, "F", 9),
    ];
    let expected: Vec<(String, u8)> = rows
        .iter()
        .flat_map(|&(base, group, count)| {
            (1..=count).map(move |row| (format!("{group}{row}"), base + row))
        })
        .collect();
    let actual: Vec<(String, u8)> = FaultId::ALL
        .iter()
        .map(|fault| (fault.name().to_owned(), fault.number()))
        .collect();
    assert_eq!(actual, expected);
    for number in 0..=255 {
        let known = expected.iter().any(|(_, n)| *n == number);
        assert_eq!(
            FaultId::from_number(number).map(FaultId::number),
            known.then_some(number)
        );
        // One byte on the wire, and no other is accepted.
        assert_eq!(decode::<FaultId>(&[number]).is_some(), known);
    }
}

#[test]
fn configuration_keys_keep_their_numbers() {
    let board = [
        "Cables",
        "DriveKind",
        "BusBitrate",
        "BusPeriodUs",
        "StopMs",
        "ResidualMs",
        "EnableMs",
        "FeedbackTimeoutMs",
        "TensionPeriodUs",
        "HoldBrakes",
        "FaultLine",
    ];
    let cable = [
        "Control",
        "DrumRadius",
        "EncoderCountsPerTurn",
        "EncoderSign",
        "MotorCountsPerTurn",
        "MaxMotorRpm",
        "MaxCurrentMa",
        "ForcePerCurrent",
        "TensionGain",
        "TensionZeroUv",
        "TensionMax",
        "TensionFloor",
        "TensionCeiling",
        "TensionLaw",
        "TensionKp",
        "TensionKd",
        "TensionKi",
        "TensionDamping",
        "TensionFilterMhz",
        "Friction",
        "DrumMass",
        "LeadUs",
        "BrakeCloseMs",
        "FollowingError",
        "MaxSpeed",
        "LengthMin",
        "LengthMax",
        "Node",
        "MotorCountsPerRev",
        "ReelSpeed",
        "MaxAcceleration",
        "MaxJerk",
        "TensionOutput",
        "Play",
        "SpeedCornerMhz",
        "BrakePlay",
        "GainLength",
    ];
    let names: Vec<_> = BoardKey::ALL.iter().map(|key| key.name()).collect();
    assert_eq!(names, board);
    let names: Vec<_> = CableKey::ALL.iter().map(|key| key.name()).collect();
    assert_eq!(names, cable);
    for key in 0..=u16::MAX {
        let [group, field] = key.to_be_bytes();
        let meaning = ConfigKey(key).meaning();
        let field_index = usize::from(field).wrapping_sub(1);
        match group {
            0 => {
                let name = board.get(field_index).copied();
                let got = meaning.map(|meaning| match meaning {
                    KeyMeaning::Board(key) => {
                        assert_eq!(ConfigKey::board(key).0, u16::from(field));
                        key.name()
                    }
                    KeyMeaning::Cable(..) => panic!("{field} is a cable's"),
                });
                assert_eq!(got, name);
            }
            1..=8 => {
                let name = cable.get(field_index).copied();
                let got = meaning.map(|meaning| match meaning {
                    KeyMeaning::Cable(index, k) => {
                        assert_eq!(index + 1, group);
                        assert_eq!(ConfigKey::cable(index, k).0, key);
                        k.name()
                    }
                    KeyMeaning::Board(_) => panic!("{field} is the board's"),
                });
                assert_eq!(got, name);
            }
            _ => assert_eq!(meaning, None),
        }
    }
}

#[test]
fn limits_keep_their_bits() {
    let bits = [
        Limit::HeartbeatLate,
        Limit::CurrentSaturated,
        Limit::TensionOff,
        Limit::ResidualHigh,
        Limit::CableSlack,
        Limit::TelemetryDropped,
        Limit::BufferShort,
        Limit::TrimSaturated,
        Limit::BrakeSlips,
        Limit::TensionNoisy,
        Limit::DriveWarns,
        Limit::FaultLine,
    ];
    for (bit, limit) in (0..).zip(bits) {
        let mut limits = Limits::default();
        limits.insert(limit);
        assert_eq!(limits.0, 1 << bit);
        assert!(
            bits.iter()
                .all(|&other| limits.contains(other) == (other == limit))
        );
    }
}

#[test]
fn the_configuration_hash_is_the_crc_of_keys_and_values() {
    let entries = [(0x0001_u16, 4_i32), (0x0102, 200_000), (0x0404, -1)];
    let mut bytes = vec![];
    for (key, value) in entries {
        bytes.extend(key.to_le_bytes());
        bytes.extend(value.to_le_bytes());
    }
    let hash = config_hash(entries.map(|(key, value)| ConfigEntry {
        key: ConfigKey(key),
        value,
    }));
    assert_eq!(hash.0, frame::crc32(&bytes));
}
