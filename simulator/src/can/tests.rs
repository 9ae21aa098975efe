//! The bus, and complete sequences: the board's code against the drives' own code.

use super::{CanBus, DriveLine};
use crate::plant::{DriveState, Mode, Plant, PlantParams, Protocol};
use mcdpr_firmware::drives::{BusState, CanFrame, CanPort as _};

mod whole;

fn frame(id: u16, bytes: &[u8]) -> CanFrame {
    let mut data = [0; 8];
    data[..bytes.len()].copy_from_slice(bytes);
    CanFrame {
        id,
        len: bytes.len() as u8,
        data,
    }
}

#[test]
fn the_lowest_identifier_wins_and_frames_take_their_time() {
    let mut bus = CanBus::new(500_000, 3);
    bus.offer(3, 0, frame(0x300, &[1; 8]));
    bus.offer(1, 10, frame(0x200, &[2]));
    bus.offer(2, 10, frame(0x100, &[3]));
    let mut ends = Vec::new();
    while let Some(delivery) = bus.next(10_000) {
        ends.push((delivery.from, delivery.at_us));
    }
    let bits = |id, bytes: &[u8]| super::frame_bits(&frame(id, bytes));
    // The first one was alone when it began; two microseconds a bit.
    let first = 2 * bits(0x300, &[1; 8]);
    let second = first + 2 * bits(0x100, &[3]);
    let third = second + 2 * bits(0x200, &[2]);
    assert_eq!(ends, [(3, first), (2, second), (1, third)]);
    assert_eq!(bus.counters().busy_us, third);
}

#[test]
fn a_destroyed_frame_is_sent_again_and_counted_by_all() {
    let mut bus = CanBus::new(1_000_000, 2);
    bus.faults_mut().corrupt = 2;
    bus.offer(1, 0, frame(0x10, &[7]));
    let delivery = bus.next(10_000).expect("it passes in the end");
    assert_eq!(delivery.frame.data[0], 7);
    // Eight for each failure, one back; one for each failure heard, one back.
    assert_eq!(bus.errors(1), (15, 0));
    assert_eq!(bus.errors(0), (0, 1));
    assert_eq!(bus.counters().destroyed, 2);
}

#[test]
fn a_dropped_frame_is_one_that_its_sender_believes_in() {
    let mut bus = CanBus::new(1_000_000, 2);
    bus.faults_mut().drop = 1;
    bus.offer(1, 0, frame(0x10, &[]));
    assert_eq!(bus.next(10_000), None);
    assert_eq!(bus.waiting(1), 0);
    assert_eq!(bus.counters().frames, 1);
}

#[test]
fn a_short_takes_the_sender_off_the_bus_and_mending_it_brings_it_back() {
    let mut bus = CanBus::new(1_000_000, 2);
    bus.faults_mut().shorted = true;
    bus.offer(0, 0, frame(0x10, &[]));
    // 24 bits for each of 16 failures, 32 from then on: passive after 384 us, off after 896.
    assert_eq!(bus.next(500), None);
    assert_eq!(bus.state(0), BusState::Passive);
    assert_eq!(bus.next(1000), None);
    assert_eq!(bus.state(0), BusState::Off);
    bus.faults_mut().shorted = false;
    assert_eq!(bus.next(6000), None);
    assert_eq!(bus.state(0), BusState::Active);
    bus.offer(0, 6000, frame(0x10, &[]));
    assert!(bus.next(7000).is_some());
}

#[test]
fn alone_on_the_wires_a_controller_becomes_passive_but_never_silent() {
    let mut bus = CanBus::new(1_000_000, 1);
    bus.connect(1, false);
    bus.offer(0, 0, frame(0x10, &[]));
    assert_eq!(bus.next(1_000_000), None);
    assert_eq!(bus.state(0), BusState::Passive);
    bus.connect(1, true);
    assert!(bus.next(1_001_000).is_some());
}

#[test]
fn another_bit_rate_lets_nothing_pass() {
    let mut bus = CanBus::new(1_000_000, 1);
    bus.restart(0, 500_000);
    bus.offer(0, 0, frame(0x10, &[]));
    assert_eq!(bus.next(100_000), None);
    assert!(bus.counters().destroyed > 10);
}

#[test]
fn two_drives_of_one_number_destroy_each_others_frames() {
    let mut bus = CanBus::new(1_000_000, 2);
    bus.offer(1, 0, frame(0x3B, &[1]));
    bus.offer(2, 0, frame(0x3B, &[2]));
    assert_eq!(bus.next(100_000), None);
    assert_eq!(bus.state(1), BusState::Active, "off, and back again");
    assert_eq!(bus.counters().destroyed, 32, "256 errors, eight a frame");
    // With the same data no node can detect that there are two.
    bus.offer(1, 200_000, frame(0x3B, &[1]));
    bus.offer(2, 200_000, frame(0x3B, &[1]));
    assert!(bus.next(201_000).is_some());
    assert_eq!((bus.waiting(1), bus.waiting(2)), (0, 0));
}

/// As the firmware does: a drive that returns must not follow outdated commands.
#[test]
fn the_board_drops_frames_that_nobody_acknowledges() {
    let mut plant = Plant::new(PlantParams::paper_optimistic(), 1).expect("good parameters");
    let mut line = DriveLine::new(&plant);
    for cable in 0..4 {
        plant.set_drive_enable(cable, false).expect("cable");
    }
    line.port().send(&frame(0x10, &[0; 8])).expect("room");
    line.advance(&mut plant, 9_000).expect("no failure");
    assert_eq!(line.bus().waiting(0), 1);
    line.advance(&mut plant, 11_000).expect("no failure");
    assert_eq!(line.bus().waiting(0), 0);
    // One that is acknowledged in time is sent, however long the bus was silent before.
    for cable in 0..4 {
        plant.set_drive_enable(cable, true).expect("cable");
    }
    line.advance(&mut plant, 200_000).expect("no failure");
    let before = line.bus().counters().frames;
    line.port().send(&frame(0x10, &[0; 8])).expect("room");
    line.advance(&mut plant, 202_000).expect("no failure");
    assert_eq!(line.bus().counters().frames, before + 1);
}
