//! CAN through its registers and the bus, as seen by firmware and drives.

use super::can_line::{CanFrame, CanWiring};
use super::tests::{bus, misuse, read, wait, write};
use crate::bus::Bus;
use crate::trap::Trap;

const CAN: u32 = 0x4000_6400;
const AFIO_MAPR: u32 = 0x4001_0004;
const GPIOB_CRH: u32 = 0x4001_0C04;
const RCC_APB1ENR: u32 = 0x4002_101C;
const MCR: u32 = CAN;
const MSR: u32 = CAN + 4;
const TSR: u32 = CAN + 8;
const RF0R: u32 = CAN + 0xC;
const ESR: u32 = CAN + 0x18;
const BTR: u32 = CAN + 0x1C;
const TX0: u32 = CAN + 0x180;
const RX0: u32 = CAN + 0x1B0;
const FILTERS: u32 = CAN + 0x200;
/// A bit of 1 Mbit/s, in ticks of 1/72 us.
const BIT: u64 = 72;

/// Other nodes, without faults.
const NODES: CanWiring = CanWiring {
    bitrate: 1_000_000,
    others: true,
    shorted: false,
};

/// At 8 MHz, eight quanta a bit: 1 Mbit/s, on PB8 and PB9, all let through, nodes on the bus.
fn joined(mcr: u32) -> Bus {
    let mut bus = bus();
    write(&mut bus, AFIO_MAPR, 2 << 13);
    // PB8 input, PB9 alternate function at 50 MHz.
    write(&mut bus, GPIOB_CRH, 0x4444_44B4);
    bus.rewire_can(NODES);
    assert_eq!(read(&mut bus, MSR) & 3, 2, "asleep");
    write(&mut bus, MCR, mcr | 1);
    assert_eq!(read(&mut bus, MSR) & 3, 1, "being set up");
    write(&mut bus, BTR, 1 << 20 | 4 << 16);
    write(&mut bus, FILTERS + 0xC, 1);
    write(&mut bus, FILTERS + 0x1C, 1);
    write(&mut bus, FILTERS, 0x2A1C_0E00);
    write(&mut bus, MCR, mcr);
    assert_eq!(
        read(&mut bus, MSR) & 1,
        1,
        "not yet: the bus must be seen idle"
    );
    let now = bus.now;
    wait(&mut bus, now + 11 * BIT - 1);
    assert_eq!(read(&mut bus, MSR) & 1, 1);
    wait(&mut bus, now + 11 * BIT);
    assert_eq!(read(&mut bus, MSR) & 3, 0);
    bus
}

fn put(bus: &mut Bus, mailbox: u32, id: u32, byte: u32) {
    let at = TX0 + 16 * mailbox;
    write(bus, at + 4, 1);
    write(bus, at + 8, byte);
    write(bus, at, id << 21 | 1);
}

fn pass(bus: &mut Bus, bits: u64) {
    let until = bus.now + bits * BIT;
    wait(bus, until);
}

#[test]
fn nothing_without_clock_and_no_bit_timing_outside_of_the_set_up() {
    let mut bus = bus();
    assert_eq!(
        misuse(&mut bus, BTR, 0),
        "CAN's bit timing changes outside of its set-up"
    );
    write(&mut bus, RCC_APB1ENR, 0);
    assert_eq!(bus.read(MSR, 4), Err(Trap::ClockOff { address: MSR }));
}

#[test]
fn a_frame_takes_its_bits_and_frees_its_mailbox() {
    let mut bus = joined(0);
    let begin = bus.now;
    put(&mut bus, 0, 0x123, 0x5A);
    assert_eq!(
        misuse(&mut bus, TX0 + 4, 8),
        "a CAN mailbox changes while it waits to be sent"
    );
    let frame = CanFrame::standard(0x123, &[0x5A]);
    let bits = frame.bits();
    // 47 bits without data and stuffing, 8 of data.
    assert!((55..=60).contains(&bits), "{bits}");
    wait(&mut bus, begin + bits * BIT - 1);
    assert_eq!(read(&mut bus, TSR) & 1 << 26, 0);
    wait(&mut bus, begin + bits * BIT);
    assert_eq!(
        read(&mut bus, TSR) & 0x1C00_0003,
        0x1C00_0003,
        "empty, complete, good"
    );
    assert_eq!(bus.can_line.delivered, [(begin + bits * BIT, frame)]);
    write(&mut bus, TSR, 1);
    assert_eq!(read(&mut bus, TSR) & 3, 0);
}

#[test]
fn the_most_urgent_identifier_goes_first_whoever_sends_it() {
    let mut bus = joined(0);
    let now = bus.now;
    // The bus is busy while all of these come.
    bus.can_line.offer(now, CanFrame::standard(0x700, &[]));
    bus.plan();
    pass(&mut bus, 5);
    put(&mut bus, 0, 0x300, 1);
    put(&mut bus, 1, 0x100, 2);
    let now = bus.now;
    bus.can_line.offer(now, CanFrame::standard(0x200, &[3]));
    bus.can_line.offer(now, CanFrame::standard(0x050, &[4]));
    pass(&mut bus, 1000);
    let sent: Vec<_> = bus.can_line.delivered.iter().map(|(_, f)| f.id).collect();
    assert_eq!(sent, [0x100, 0x300]);
    let mut heard = Vec::new();
    while read(&mut bus, RF0R) & 3 != 0 {
        heard.push(read(&mut bus, RX0) >> 21);
        write(&mut bus, RF0R, 1 << 5);
    }
    assert_eq!(heard, [0x700, 0x050, 0x200]);
    assert_eq!(read(&mut bus, TSR) & 4, 4, "0x300 had lost an arbitration");
}

#[test]
fn a_full_fifo_overruns_and_says_so() {
    let mut bus = joined(0);
    for id in 1..=4 {
        let now = bus.now;
        bus.can_line.offer(now, CanFrame::standard(id, &[id as u8]));
        bus.plan();
        pass(&mut bus, 200);
    }
    assert_eq!(read(&mut bus, RF0R), 0b1_1011, "overrun, full, three");
    let first = (read(&mut bus, RX0) >> 21, read(&mut bus, RX0 + 8));
    assert_eq!(first, (1, 1));
    write(&mut bus, RF0R, 1 << 5);
    write(&mut bus, RF0R, 1 << 5);
    assert_eq!(
        read(&mut bus, RX0) >> 21,
        4,
        "the newest took the last place"
    );
}

#[test]
fn filters_choose_fifo_and_match_index() {
    let mut bus = joined(0);
    write(&mut bus, FILTERS, 1);
    // Bank 0: a mask of 32 bits for 0x1xx, FIFO 1. Bank 1: two identifiers of 32 bits, FIFO 0.
    write(&mut bus, FILTERS + 0x40, 0x100 << 21);
    write(&mut bus, FILTERS + 0x44, 0x700 << 21);
    write(&mut bus, FILTERS + 0x48, 0x201 << 21);
    write(&mut bus, FILTERS + 0x4C, 0x202 << 21);
    write(&mut bus, FILTERS + 4, 2);
    write(&mut bus, FILTERS + 0xC, 3);
    write(&mut bus, FILTERS + 0x14, 1);
    write(&mut bus, FILTERS + 0x1C, 3);
    write(&mut bus, FILTERS, 0);
    for id in [0x155, 0x202, 0x300] {
        let now = bus.now;
        bus.can_line.offer(now, CanFrame::standard(id, &[]));
    }
    bus.plan();
    pass(&mut bus, 1000);
    assert_eq!(
        (read(&mut bus, RF0R) & 3, read(&mut bus, RF0R + 4) & 3),
        (1, 1)
    );
    assert_eq!(read(&mut bus, RX0) >> 21, 0x202);
    assert_eq!(
        read(&mut bus, RX0 + 4) >> 8,
        1,
        "the second of its FIFO's filters"
    );
    assert_eq!(read(&mut bus, RX0 + 16) >> 21, 0x155);
}

#[test]
fn alone_it_becomes_passive_but_never_silent() {
    let mut bus = joined(0);
    bus.can_line.wiring.others = false;
    put(&mut bus, 0, 1, 1);
    pass(&mut bus, 100_000);
    assert_eq!(read(&mut bus, ESR) >> 16 & 0xFF, 128);
    assert_eq!(
        read(&mut bus, ESR) & 0x77,
        0x33,
        "no acknowledge, passive, warning"
    );
    // A node joins: the repeated frame gets through.
    bus.can_line.wiring.others = true;
    pass(&mut bus, 500);
    assert_eq!(bus.can_line.delivered.len(), 1);
    assert_eq!(read(&mut bus, ESR) >> 16 & 0xFF, 127);
}

#[test]
fn a_shorted_bus_ends_in_bus_off_and_recovers_by_itself_when_asked_to() {
    for (mcr, recovers) in [(0, false), (1 << 6, true)] {
        let mut bus = joined(mcr);
        bus.rewire_can(CanWiring {
            shorted: true,
            ..NODES
        });
        put(&mut bus, 0, 1, 1);
        // 32 errors of under 70 bits.
        pass(&mut bus, 32 * 70);
        assert_eq!(read(&mut bus, ESR) & 7, 7, "bus-off, passive, warning");
        bus.rewire_can(NODES);
        pass(&mut bus, 128 * 11 + 200);
        assert_eq!(read(&mut bus, ESR) & 4 == 0, recovers);
        if !recovers {
            // Through the set-up, then 128 times 11 bits.
            write(&mut bus, MCR, 1);
            write(&mut bus, MCR, 0);
            pass(&mut bus, 128 * 11 - 1);
            assert_eq!(read(&mut bus, ESR) & 4, 4);
            pass(&mut bus, 200);
            assert_eq!(read(&mut bus, ESR) & 4, 0);
        }
        assert_eq!(bus.can_line.delivered.len(), 1, "what waited was sent");
    }
}

#[test]
fn without_retransmission_a_destroyed_frame_is_given_up() {
    let mut bus = joined(1 << 4);
    bus.can_line.destroy = 1;
    put(&mut bus, 0, 1, 1);
    pass(&mut bus, 300);
    assert_eq!(
        read(&mut bus, TSR) & 0xB,
        0b1001,
        "complete, not good, an error"
    );
    assert!(bus.can_line.delivered.is_empty());
    let mut bus = joined(0);
    bus.can_line.destroy = 2;
    put(&mut bus, 0, 1, 1);
    pass(&mut bus, 300);
    assert_eq!(bus.can_line.delivered.len(), 1);
    assert_eq!(read(&mut bus, ESR) >> 16 & 0xFF, 15);
}

#[test]
fn another_bit_rate_or_unmapped_pins_understand_nothing() {
    let mut bus = joined(0);
    bus.can_line.wiring.bitrate = 500_000;
    let now = bus.now;
    bus.can_line.offer(now, CanFrame::standard(1, &[1]));
    bus.plan();
    pass(&mut bus, 300);
    assert_eq!(read(&mut bus, RF0R) & 3, 0);
    assert_eq!(read(&mut bus, ESR) >> 24, 8);
    let mut bus = joined(0);
    write(&mut bus, AFIO_MAPR, 0);
    put(&mut bus, 0, 1, 1);
    pass(&mut bus, 32 * 70);
    assert_eq!(read(&mut bus, ESR) & 4, 4, "what it sends never comes back");
}

#[test]
fn a_waiting_mailbox_can_be_given_up() {
    let mut bus = joined(0);
    let now = bus.now;
    bus.can_line.offer(now, CanFrame::standard(0, &[]));
    bus.plan();
    pass(&mut bus, 1);
    put(&mut bus, 2, 5, 1);
    write(&mut bus, TSR, 0x80 << 16);
    assert_eq!(read(&mut bus, TSR) >> 16 & 3, 1, "complete, not sent");
    pass(&mut bus, 500);
    assert!(bus.can_line.delivered.is_empty());
}
