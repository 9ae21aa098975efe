//! Peripherals through their registers, as firmware uses them.

use super::encoder_line::Edge;
use super::timer::Slice;
use crate::bus::{Bus, FLASH_BYTES, Halt, RAM, RAM_BYTES};
use crate::trap::Trap;

const RCC: u32 = 0x4002_1000;
const FLASH_ACR: u32 = 0x4002_2000;
const GPIOB: u32 = 0x4001_0C00;
const ADC: u32 = 0x4001_2400;
const TIM2: u32 = 0x4000_0000;
const USART: u32 = 0x4000_4800;
const DMA: u32 = 0x4002_0000;
const WATCHDOG: u32 = 0x4000_3000;

/// Everything clocked, at 8 MHz: nine ticks per cycle of any bus.
pub(super) fn bus() -> Bus {
    let mut bus = Bus::new(
        vec![0; FLASH_BYTES as usize],
        vec![0; RAM_BYTES as usize],
        0,
        0,
    );
    write(&mut bus, RCC + 0x14, u32::MAX);
    write(&mut bus, RCC + 0x18, u32::MAX);
    write(&mut bus, RCC + 0x1C, u32::MAX);
    bus
}

pub(super) fn write(bus: &mut Bus, address: u32, value: u32) {
    assert_eq!(bus.write(address, 4, value), Ok(()), "{address:#x}");
}

pub(super) fn read(bus: &mut Bus, address: u32) -> u32 {
    bus.read(address, 4).expect("a register")
}

pub(super) fn misuse(bus: &mut Bus, address: u32, value: u32) -> &'static str {
    match bus.write(address, 4, value) {
        Err(Trap::Misuse { what, .. }) => what,
        other => panic!("{other:?}"),
    }
}

pub(super) fn wait(bus: &mut Bus, until: u64) {
    while bus.next_event <= until {
        bus.now = bus.next_event;
        bus.service();
    }
    bus.now = until;
}

#[test]
fn clocks_follow_the_registers_and_their_limits() {
    let mut bus = bus();
    // HSE and PLL x9 (code 7), APB1 halved.
    write(&mut bus, RCC, 1 << 16);
    assert_eq!(
        misuse(&mut bus, RCC + 4, 1),
        "the system clock's source is not running"
    );
    bus.now += 72_000;
    assert_ne!(read(&mut bus, RCC) & 1 << 17, 0);
    write(&mut bus, RCC + 4, 7 << 18 | 1 << 16 | 4 << 8);
    write(&mut bus, RCC, 1 << 16 | 1 << 24);
    bus.now += 7200;
    let at_72 = 7 << 18 | 1 << 16 | 4 << 8 | 2;
    assert_eq!(
        misuse(&mut bus.clone(), RCC + 4, at_72),
        "too few flash wait states for this core clock"
    );
    write(&mut bus, FLASH_ACR, 0x12);
    assert_eq!(
        misuse(&mut bus.clone(), RCC + 4, at_72 & !(7 << 8)),
        "APB1 is over 36 MHz"
    );
    write(&mut bus, RCC + 4, at_72);
    let clocks = bus.clocks;
    assert_eq!(
        (clocks.core, clocks.apb1, clocks.timers1, clocks.apb2),
        (1, 2, 1, 1)
    );
}

#[test]
fn a_watchdog_that_is_not_fed_resets() {
    let mut bus = bus();
    assert_eq!(
        misuse(&mut bus, WATCHDOG + 8, 99),
        "the watchdog's registers are locked"
    );
    // 100 periods of 4 / 40 kHz: 10 ms, 720 000 ticks.
    write(&mut bus, WATCHDOG, 0x5555);
    write(&mut bus, WATCHDOG + 8, 99);
    write(&mut bus, WATCHDOG, 0xCCCC);
    wait(&mut bus, 700_000);
    write(&mut bus, WATCHDOG, 0xAAAA);
    wait(&mut bus, 1_419_999);
    assert_eq!(bus.halt, None);
    bus.now = 1_420_000;
    bus.service();
    assert_eq!(bus.halt, Some(Halt::Watchdog));
}

#[test]
fn bytes_take_their_time_on_the_line() {
    let mut bus = bus();
    // 8 MHz / 16 = 500 kbaud: ten bits are 20 us, 1440 ticks. PB10 is its output.
    write(&mut bus, GPIOB + 4, 0x4444_4B44 | 0xB00);
    write(&mut bus, USART + 8, 16);
    assert_eq!(
        misuse(&mut bus, USART + 4, 65),
        "a byte is sent while the transmitter is off"
    );
    write(&mut bus, USART + 0xC, 1 << 13 | 1 << 3);
    write(&mut bus, USART + 4, 65);
    write(&mut bus, USART + 4, 66);
    assert_eq!(
        misuse(&mut bus.clone(), USART + 4, 67),
        "a byte is sent before the last one has left the register"
    );
    wait(&mut bus, 1439);
    assert!(bus.usart.sent.is_empty());
    wait(&mut bus, 1440);
    assert_eq!(bus.usart.sent, [65]);
    assert_eq!(read(&mut bus, USART) & 0xC0, 0x80, "room, but not complete");
    wait(&mut bus, 2880);
    assert_eq!(bus.usart.sent, [65, 66]);
    assert_eq!(read(&mut bus, USART) & 0xC0, 0xC0);
}

#[test]
fn received_bytes_go_by_dma_or_overrun() {
    let mut bus = bus();
    write(&mut bus, USART + 8, 16);
    write(&mut bus, USART + 0xC, 1 << 13 | 1 << 2);
    let mut without = bus.clone();
    without.usart.send(b"ab", 0, 9);
    without.plan();
    wait(&mut without, 2880);
    assert_eq!(without.usart.overruns, 1);
    assert_eq!(read(&mut without, USART) & 0x28, 0x28, "RXNE and ORE");
    assert_eq!(read(&mut without, USART + 4), u32::from(b'a'));
    assert_eq!(read(&mut without, USART) & 0x28, 0, "reading both clears");

    // Channel 3, circular over two bytes.
    write(&mut bus, DMA + 0x34, 2);
    write(&mut bus, DMA + 0x38, USART + 4);
    write(&mut bus, DMA + 0x3C, RAM);
    write(&mut bus, DMA + 0x30, 1 << 7 | 1 << 5 | 1);
    write(&mut bus, USART + 0x14, 1 << 6);
    bus.usart.send(b"abc", 0, 9);
    bus.plan();
    wait(&mut bus, 3 * 1440);
    assert_eq!(&bus.ram[..3], b"cb\0");
    assert_eq!(read(&mut bus, DMA + 0x34), 1);
    assert_eq!(read(&mut bus, DMA) & 0xF00, 0x700, "half, complete, global");
    write(&mut bus, DMA + 4, 0x200);
    assert_eq!(read(&mut bus, DMA) & 0xF00, 0x500);
}

#[test]
fn a_pin_that_is_not_analog_is_not_converted_unnoticed() {
    let mut bus = bus();
    bus.adc.applied[8] = 1234 * 16;
    // Channel 8 is PB0: first as after reset, then analog. Software trigger.
    write(&mut bus, ADC + 0x34, 8);
    let start = 1 | 7 << 17 | 1 << 20 | 1 << 22;
    write(&mut bus, ADC + 8, start);
    wait(&mut bus, 1000);
    assert!(matches!(bus.dma_trap.take(), Some(Trap::Misuse { .. })));
    assert_eq!(read(&mut bus, ADC + 0x4C), 1234);
    write(&mut bus, GPIOB, 0x4444_4440);
    write(&mut bus, ADC + 8, start);
    // 1.5 + 12.5 cycles of 18 ticks.
    wait(&mut bus, 1000 + 251);
    assert_eq!(read(&mut bus, ADC) & 2, 0);
    wait(&mut bus, 1000 + 252);
    assert_eq!(read(&mut bus, ADC) & 2, 2);
    assert_eq!((read(&mut bus, ADC + 0x4C), bus.dma_trap), (1234, None));
}

#[test]
fn the_reference_is_converted_between_two_conversions_of_a_scan() {
    let mut bus = bus();
    write(&mut bus, GPIOB, 0x4444_4440);
    bus.adc.applied[8] = 1234 * 16;
    write(&mut bus, ADC + 0x34, 8);
    write(&mut bus, ADC + 0x38, 17 << 15);
    let on = 1 | 2 | 7 << 12 | 1 << 15 | 7 << 17 | 1 << 20;
    let injects = |bus: &mut Bus, cr2: u32| bus.write(ADC + 8, 4, cr2 | 1 << 21);
    assert!(injects(&mut bus, on).is_err(), "not connected (TSVREFE)");
    let on = on | 1 << 23;
    assert!(injects(&mut bus, on).is_err(), "sampled for 1.5 cycles");
    write(&mut bus, ADC + 0xC, 7 << 21);
    // A regular conversion takes 14 cycles of 18 ticks; half way through, the reference takes 252.
    write(&mut bus, ADC + 8, on);
    write(&mut bus, ADC + 8, on | 1 << 22);
    wait(&mut bus, 126);
    injects(&mut bus, on).unwrap();
    wait(&mut bus, 126 + 252 * 18 - 1);
    assert_eq!(read(&mut bus, ADC) & 6, 0, "neither has ended");
    wait(&mut bus, 126 + 252 * 18);
    assert_eq!(read(&mut bus, ADC) & 6, 4, "the injected one has");
    // 1.20 V of 3.3 V.
    assert_eq!(read(&mut bus, ADC + 0x3C), 1489);
    // The regular one begins anew.
    wait(&mut bus, 126 + 252 * 18 + 251);
    assert_eq!(read(&mut bus, ADC) & 2, 0);
    wait(&mut bus, 126 + 252 * 18 + 252);
    assert_eq!(read(&mut bus, ADC + 0x4C), 1234);
    bus.adc.set_supply_v(3.0);
    injects(&mut bus, on).unwrap();
    wait(&mut bus, 20_000);
    assert_eq!(read(&mut bus, ADC + 0x3C), 1638);
}

#[test]
fn decoders_count_what_passes_their_filter() {
    let mut bus = bus();
    write(&mut bus, TIM2 + 8, 3);
    // Its reload value after a reset is not relied on.
    write(&mut bus, TIM2 + 0x2C, 0xFFFF);
    // Filters of 16 * 8 cycles: 1152 ticks at 8 MHz.
    write(&mut bus, TIM2 + 0x18, 0xC1C1);
    write(&mut bus, TIM2, 1);
    bus.timers[1].turn(-10, 0, 72_000, 9, true);
    bus.now = 1152 + 36_000;
    assert_eq!(
        read(&mut bus, TIM2 + 0x24),
        0xFFFB,
        "half of the way, later by the filter"
    );
    bus.now = 72_000 + 1152;
    assert_eq!(read(&mut bus, TIM2 + 0x24), 0xFFF6);
    let now = bus.now;
    bus.timers[1].turn(200, now, 72_000, 9, true);
    assert_eq!(
        bus.timers[1].lost(),
        200,
        "720 ticks of each level are too short"
    );
    bus.timers[1].turn(5, now, 72_000, 9, false);
    assert_eq!(bus.timers[1].lost(), 205, "no wire, no counts");
    assert_eq!(
        misuse(&mut bus, TIM2 + 8, 0),
        "only quadrature decoding is emulated"
    );
}

#[test]
fn a_decoder_follows_lines_that_bounce_and_a_counter_that_is_written() {
    let mut bus = bus();
    write(&mut bus, TIM2 + 8, 3);
    write(&mut bus, TIM2 + 0x2C, 0xFFFF);
    write(&mut bus, TIM2 + 0x18, 0xC1C1);
    write(&mut bus, TIM2, 1);
    // A rises at 10,000 and bounces once, for twice the filter's 1152 ticks; B rises at 50,000.
    let edges = [
        (10_000, 0, true),
        (12_304, 0, false),
        (14_608, 0, true),
        (50_000, 1, true),
    ];
    let edges = edges.map(|(at, line, level)| Edge { at, line, level });
    let slice = Slice {
        levels: [false; 2],
        edges: &edges,
        counts: 2,
        from: 0,
        until: 72_000,
    };
    let mut turned = bus.clone();
    turned.timers[1].pass(slice, 9, true);
    let at = |bus: &mut Bus, now: u64| {
        bus.now = now;
        read(bus, TIM2 + 0x24)
    };
    let times = [10_000, 11_300, 13_600, 16_000, 49_000, 52_000];
    let found = times.map(|now| at(&mut turned, now));
    assert_eq!(found, [0, 1, 0, 1, 1, 2]);
    assert_eq!(turned.timers[1].lost(), 0);
    // What was counted before a write is gone, what comes later is added.
    turned.now = 30_000;
    write(&mut turned, TIM2 + 0x24, 100);
    assert_eq!([30_000, 60_000].map(|now| at(&mut turned, now)), [100, 101]);
    // One inverted input turns the direction; both filters count.
    let mut turned = bus.clone();
    write(&mut turned, TIM2 + 0x20, 2);
    turned.timers[1].pass(slice, 9, true);
    assert_eq!(at(&mut turned, 60_000), 0xFFFE);
    // Without wires nothing is counted, nor when they are there again.
    bus.timers[1].pass(slice, 9, false);
    let still = Slice {
        levels: [true; 2],
        edges: &[],
        counts: 0,
        from: 72_000,
        until: 144_000,
    };
    bus.timers[1].pass(still, 9, true);
    assert_eq!(at(&mut bus, 144_000), 0);
    assert_eq!(bus.timers[1].lost(), 2);
}
