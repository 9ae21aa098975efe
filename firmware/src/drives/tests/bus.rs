//! What a bus does besides commanding its drives: stopping those of before a reset, and the search for drives.

use super::super::last::LastDrives;
use super::*;
use std::vec::Vec as List;

/// What a board that was reset sends to these drives in its first ticks, with the times.
fn stopped(kind: DriveKind, ticks: u32) -> (u32, List<(u32, std::string::String)>) {
    let last = LastDrives {
        kind,
        bits_per_s: 500_000,
        nodes: [3, 0],
    };
    let mut bus = DriveBus::<2>::default();
    let mut port = Port::default();
    bus.stop_at_start(&last, &mut port);
    for now in 0..ticks {
        (port.now, port.room) = (now, 3);
        bus.listen(&mut port);
        bus.tick(Tick(now), None, &Outputs::default(), &mut port);
    }
    let frames = port.sent.iter().map(|(at, frame)| {
        let bytes = Vec::from_slice(&frame.data[..usize::from(frame.len)]).unwrap();
        (*at, hex(&[(frame.id, bytes)]).remove(0))
    });
    (port.bitrate, frames.collect())
}

#[test]
fn p3_drives_that_follow_their_last_command_after_a_reset_are_stopped_five_times_within_50_ms() {
    for (kind, frame) in [
        (DriveKind::Rmds, "030 55 55 55 55 55 55 55 55"),
        (DriveKind::Cia402, "000 81 03"),
    ] {
        let (bitrate, frames) = stopped(kind, 1000);
        assert_eq!(bitrate, 500_000, "that of the drives");
        // Once each ten ticks, to the drive that was there and to no other.
        let expected: List<_> = [0, 10, 20, 30, 40].map(|at| (at, frame.into())).into();
        assert_eq!(frames, expected, "{kind:?}");
    }
}

#[test]
fn a_board_that_had_no_drives_sends_nothing_without_a_configuration() {
    let mut bus = DriveBus::<2>::default();
    let mut port = Port::default();
    for now in 0..1000 {
        (port.now, port.room) = (now, 3);
        bus.listen(&mut port);
        bus.tick(Tick(now), None, &Outputs::default(), &mut port);
    }
    assert!(port.sent.is_empty());
    assert_eq!(bus.take_new(), None);
}

#[test]
fn the_drives_of_a_new_configuration_are_to_be_kept_once() {
    let mut bench = Bench::new(DriveKind::Rmds);
    let expected = LastDrives {
        kind: DriveKind::Rmds,
        bits_per_s: 1_000_000,
        nodes: [3, 5],
    };
    assert_eq!(bench.bus.take_new(), Some(expected));
    bench.tick(OFF);
    assert_eq!(bench.bus.take_new(), None);
}

/// Searches a bus on which these nodes answer, by answers of this kind, each when it is asked. The port has room for one
/// frame in every `nth` tick. The ticks until the search is done, the numbers asked, and those found.
fn search(
    kind: DriveKind,
    nodes: &[u8],
    nth: u32,
    asked: fn(u16, &[u8]) -> Option<u8>,
    answer: fn(u8) -> (u16, [u8; 8]),
) -> (u32, List<u8>, List<u8>) {
    let mut bus = DriveBus::<2>::default();
    let mut port = Port::default();
    let active = active(kind);
    let mut numbers = List::new();
    for now in 0..10_000 {
        // The drives of the configuration have no supply in the first 100 ms, and nothing is sent to them.
        port.room = usize::from(now % nth == 0);
        bus.listen(&mut port);
        let mut inputs = Inputs::<2>::default();
        bus.fill(&mut inputs);
        if now > 0 && inputs.scan.done {
            let found = (0..=127)
                .filter(|node| inputs.scan.nodes[usize::from(node / 32)] & (1 << (node % 32)) != 0);
            return (now, numbers, found.collect());
        }
        let outputs = Outputs {
            scan: now == 0,
            ..Outputs::default()
        };
        bus.tick(Tick(now), Some(&active), &outputs, &mut port);
        for (_, frame) in &port.sent {
            if let Some(number) = asked(frame.id, &frame.data[..usize::from(frame.len)]) {
                numbers.push(number);
                if nodes.contains(&number) {
                    let (id, data) = answer(number);
                    port.given.push_back(CanFrame { id, len: 8, data }).unwrap();
                }
            }
        }
        port.sent.clear();
    }
    panic!("the search does not end");
}

/// The function 0xF of an RMDS: whether it is there.
fn asks_rmds(id: u16, _: &[u8]) -> Option<u8> {
    let node = u8::try_from(id >> 4).ok()?;
    (id & 0xF == 0xF).then_some(node)
}

fn rmds_answers(node: u8) -> (u16, [u8; 8]) {
    (u16::from(node) << 4 | 0xF, [0x55; 8])
}

fn every_number() -> List<u8> {
    (1..=126).collect()
}

#[test]
fn a_search_asks_every_number_once_and_finds_the_rmds_that_answer() {
    // Group times 16 and number, which is never 0.
    let nodes = [1, 3, 14, 31, 33, 65, 126];
    let (ticks, numbers, found) = search(DriveKind::Rmds, &nodes, 1, asks_rmds, rmds_answers);
    assert_eq!(numbers, every_number());
    assert_eq!(found, nodes);
    // One number a tick, the first in tick 0, and 50 ms for the last answers.
    assert_eq!(ticks, 126 + 50 - 1);
}

#[test]
fn a_search_on_a_full_bus_asks_no_number_less() {
    // Room in every second tick, until the drives take it for their own frames: they come after the search.
    let (_, numbers, found) = search(DriveKind::Rmds, &[2, 40], 2, asks_rmds, rmds_answers);
    assert_eq!((numbers, found), (every_number(), std::vec![2, 40]));
}

#[test]
fn a_search_finds_drives_of_the_profile_and_no_other_devices() {
    // An upload of the device type, 0x1000.
    let asked = |id: u16, data: &[u8]| {
        let asks = data == [0x40, 0x00, 0x10, 0, 0, 0, 0, 0];
        let node = u8::try_from(id & 0x7F).ok()?;
        (asks && id & 0x780 == 0x600).then_some(node)
    };
    // Profile 402; node 7 is an input module of profile 401, node 9 answers another question.
    let answer = |node: u8| {
        let profile = if node == 7 { 0x91 } else { 0x92 };
        let index = if node == 9 { 0x18 } else { 0x10 };
        let data = [0x43, 0x00, index, 0, profile, 0x01, 0x02, 0];
        (0x580 + u16::from(node), data)
    };
    let nodes = [1, 7, 9, 33, 126];
    let (_, numbers, found) = search(DriveKind::Cia402, &nodes, 1, asked, answer);
    assert_eq!(numbers, every_number());
    assert_eq!(found, [1, 33, 126]);
}
