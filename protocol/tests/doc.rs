//! `docs/protocol.md` and `docs/faults.md` agree with the code: every name with its number, the
//! limits, and the bytes of the worked examples.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::indexing_slicing,
    clippy::cast_possible_truncation,
    missing_docs
)]

mod common;

use common::{hex, messages, rejects, replies, requests};
use mcdpr_protocol::frame::{MAX_BODY, MAX_FRAME, crc32};
use mcdpr_protocol::message::{CONFIG_CHUNK, PANIC_BYTES};
use mcdpr_protocol::telemetry::SAMPLE_BYTES;
use mcdpr_protocol::*;
use std::path::Path;

fn read(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../docs")
        .join(name);
    std::fs::read_to_string(path).expect("the document")
}

/// The part of a document under a heading.
fn section<'a>(text: &'a str, heading: &str) -> &'a str {
    let start = text
        .find(&format!("\n{heading}\n"))
        .unwrap_or_else(|| panic!("no {heading}"));
    let rest = &text[start + 1 + heading.len()..];
    let level = heading.split(' ').next().unwrap();
    let end = rest.find(&format!("\n{level} ")).unwrap_or(rest.len());
    &rest[..end]
}

/// The first two columns of the table rows of a text.
fn rows(text: &str) -> Vec<(String, String)> {
    let cells = |line: &str| {
        let mut cells = line.strip_prefix("| ")?.split(" | ").map(str::to_owned);
        Some((cells.next()?, cells.next()?))
    };
    text.lines().filter_map(cells).collect()
}

fn assert_rows(text: &str, expected: &[(String, String)]) {
    let actual = rows(text);
    for row in expected {
        let count = actual.iter().filter(|other| *other == row).count();
        assert_eq!(count, 1, "{row:?} is there {count} times");
    }
}

fn number_of<T: serde::Serialize>(value: &T) -> u8 {
    let mut buffer = [0; 256];
    postcard::to_slice(value, &mut buffer).unwrap()[0]
}

/// `| number | `Name` |` for each example, and no other rows.
fn assert_variants<T: serde::Serialize>(text: &str, heading: &str, examples: &[(&str, T)]) {
    let text = section(text, heading);
    let mut expected: Vec<(String, String)> = examples
        .iter()
        .map(|(name, value)| {
            let name = name.split('.').next().unwrap();
            (number_of(value).to_string(), format!("`{name}`"))
        })
        .collect();
    expected.dedup();
    assert_rows(text, &expected);
    let listed = rows(text)
        .iter()
        .filter(|(number, _)| number.parse::<u8>().is_ok())
        .count();
    assert_eq!(listed, expected.len(), "{heading} lists something else");
}

#[test]
fn every_message_is_described_with_its_number() {
    let text = read("protocol.md");
    assert_variants(&text, "## Requests", &requests());
    assert_variants(&text, "## Replies", &replies());
    assert_variants(&text, "## Refusals", &rejects());
    let sequenced = section(&text, "## Requests");
    for (name, request) in requests() {
        let name = name.split('.').next().unwrap();
        let yes = if request.is_sequenced() { "yes" } else { "no" };
        assert!(
            sequenced.contains(&format!("| `{name}` | {yes} |")),
            "{name}"
        );
    }
}

#[test]
fn every_field_is_named() {
    let text = read("protocol.md");
    // The names as the types print them.
    let debug = messages()
        .iter()
        .map(|(_, message)| match message {
            common::Message::Command(command) => format!("{command:?}"),
            common::Message::Answer(answer) => format!("{answer:?}"),
            common::Message::Status(status) => format!("{status:?}"),
            common::Message::Samples(block) => format!("{block:?}"),
            _ => String::new(),
        })
        .collect::<String>();
    let mut names: Vec<&str> = debug
        .split(|c: char| !c.is_alphanumeric() && c != '_' && c != ':')
        .filter_map(|word| word.strip_suffix(':'))
        .filter(|word| !word.is_empty() && word.starts_with(char::is_lowercase))
        .collect();
    names.sort_unstable();
    names.dedup();
    assert!(names.len() > 50, "{names:?}");
    for name in names {
        // A knot's cable is described by words.
        let known = text.contains(&format!("`{name}`"))
            || ["length", "velocity", "tension", "result", "request", "host"].contains(&name);
        assert!(known, "field {name} is not described");
    }
}

#[test]
fn channels_states_stops_and_advice_are_described() {
    use BoardState::*;
    let text = read("protocol.md");
    let channels = [
        Channel::HelloQuery,
        Channel::Hello,
        Channel::Command,
        Channel::Answer,
        Channel::Samples,
        Channel::Status,
    ]
    .map(|channel| {
        (
            format!("`{:#04x}`", channel as u8),
            format!("`{channel:?}`"),
        )
    });
    assert_rows(section(&text, "## Frames"), &channels);
    let states = [
        Boot, Disarmed, Arming, Holding, Moving, Pausing, Stopping, Fault, EStop,
    ]
    .map(|state| (number_of(&state).to_string(), format!("`{state:?}`")));
    let status = section(&text, "## Status");
    let (by_state, by_bit) = status.split_once("| bit of").unwrap();
    assert_rows(by_state, &states);
    let limits = [
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
    ]
    .map(|limit| ((limit as u8).to_string(), format!("`{limit:?}`")));
    assert_rows(by_bit, &limits);
    for kind in [StopKind::Hold, StopKind::Stop, StopKind::Emergency] {
        assert!(text.contains(&format!("{} `{kind:?}`", number_of(&kind))));
    }
    for cause in [
        ResetCause::Unknown,
        ResetCause::Power,
        ResetCause::Pin,
        ResetCause::Software,
        ResetCause::Watchdog,
        ResetCause::Panic,
    ] {
        assert!(text.contains(&format!("{} `{cause:?}`", cause as u8)));
    }
}

#[test]
fn every_configuration_key_is_described_with_its_number() {
    let text = read("protocol.md");
    let text = section(&text, "## Configuration");
    let board: Vec<_> = BoardKey::ALL
        .iter()
        .map(|&key| {
            (
                format!("`{:#06x}`", ConfigKey::board(key).0),
                format!("`{}`", key.name()),
            )
        })
        .collect();
    let cable: Vec<_> = CableKey::ALL
        .iter()
        .map(|&key| (format!("`{:#04x}`", key as u8), format!("`{}`", key.name())))
        .collect();
    assert_rows(text, &board);
    assert_rows(text, &cable);
    let listed = rows(text)
        .iter()
        .filter(|(number, _)| number.starts_with("`0x"))
        .count();
    assert_eq!(listed, board.len() + cable.len());
}

#[test]
fn every_fault_is_in_both_documents_with_its_number_and_words() {
    let expected: Vec<_> = FaultId::ALL
        .iter()
        .map(|fault| (fault.name().to_owned(), fault.number().to_string()))
        .collect();
    let (protocol, faults) = (read("protocol.md"), read("faults.md"));
    for text in [section(&protocol, "## Faults"), &faults] {
        assert_rows(text, &expected);
        for fault in FaultId::ALL {
            let row = format!(
                "| {} | {} | {} |",
                fault.name(),
                fault.number(),
                fault.what()
            );
            assert!(text.contains(&row), "{row}");
        }
    }
    // Every row of the fault table has all its columns, and its status.
    for line in faults
        .lines()
        .filter(|line| line.starts_with("| ") && !line.starts_with("| id"))
    {
        let cells: Vec<_> = line.trim_matches('|').split(" | ").map(str::trim).collect();
        assert_eq!(cells.len(), 7, "{line}");
        assert!(cells.iter().all(|cell| !cell.is_empty()), "{line}");
    }
}

#[test]
fn the_worked_examples_are_what_the_code_sends() {
    let text = read("protocol.md");
    let line = |name: &str| -> String {
        let start = format!("{name} ");
        let line = text
            .lines()
            .find(|line| line.starts_with(&start))
            .expect(name);
        line[start.len()..]
            .chars()
            .filter(|c| !c.is_whitespace())
            .collect()
    };
    let sent = |wanted: &str| {
        let all = messages();
        let (_, message) = all.iter().find(|(name, _)| name == wanted).unwrap();
        hex(&message.frame())
    };
    assert_eq!(line("frame"), sent("command.Stop.Hold"));
    assert_eq!(line("answer"), sent("answer.ok.Done"));
    assert_eq!(line("query"), sent("hello_query"));
    let covered = common::unhex(&line("covered"));
    assert_eq!(line("covered"), format!("10{}", line("body")));
    assert_eq!(line("crc"), hex(&crc32(&covered).to_le_bytes()));
    assert_eq!(line("plain"), format!("{}{}", line("covered"), line("crc")));
}

#[test]
fn the_limits_of_the_wire_are_reported() {
    let text = read("protocol.md");
    for reported in [
        format!("version {PROTOCOL_MAJOR}.{PROTOCOL_MINOR}"),
        format!("at most {MAX_FRAME} bytes"),
        format!("up to {MAX_BODY} bytes"),
        format!("Up to {WINDOW} may be under way"),
        format!("at most {CONFIG_CHUNK} of"),
        format!("at most {PANIC_BYTES} bytes of UTF-8"),
        format!("`packed` list of at most {SAMPLE_BYTES} bytes"),
        format!("`rows` list of at most {}", ResidualRow::PER_KNOT),
        format!("times {}", ResidualRow::LENGTH_SCALE),
        format!("times {}", ResidualRow::TENSION_SCALE),
        format!("at most {MAX_CABLES}."),
        format!(
            "{} ticks for up to 4 cables,\n{} for 5, {} for 6, {} for 7 and {} for 8",
            SampleBlock::ticks(4),
            SampleBlock::ticks(5),
            SampleBlock::ticks(6),
            SampleBlock::ticks(7),
            SampleBlock::ticks(8)
        ),
    ] {
        assert!(text.contains(&reported), "{reported}");
    }
}
