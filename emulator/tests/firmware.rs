//! The firmware file on the emulated chip: its answers to a host over the line, and its pins.

mod support;

use mcdpr_emulator::{Drive, ResetBy, Stop};
use mcdpr_protocol::{
    BoardState, FaultId, PROTOCOL_MAJOR, Reply, Request, ResetCause, TenthMicrometres,
};
use support::{Bench, SLICE_US, START};

/// Top of the stack (memory.x).
const STACK_TOP: u32 = 0x2000_1800;
/// Core cycles of a tick at most, with configuration, moving encoders and full telemetry, by the
/// emulator's estimate: a quarter of the millisecond, 18,000, is the limit; this is the measured
/// value.
const TICK_CYCLES: u64 = 7300;
/// As above, for start and configuration, which the board takes in slices, one a tick.
const CONFIGURING_CYCLES: u64 = 8000;

/// Static RAM and the deepest stack together, bytes.
const RAM_AND_STACK: u64 = 13 * 1024;

/// Bytes of static RAM.
fn static_ram() -> u64 {
    use object::{Object, ObjectSection, SectionFlags};
    let bytes = support::firmware();
    let file = object::File::parse(&*bytes).expect("an ELF file");
    let in_ram = file.sections().filter(|section| {
        let SectionFlags::Elf { sh_flags } = section.flags() else {
            return false;
        };
        sh_flags & u64::from(object::elf::SHF_ALLOC) != 0 && section.address() >= 0x2000_0000
    });
    in_ram.map(|section| section.size()).sum()
}

#[test]
fn boots_and_says_who_it_is() {
    let mut bench = Bench::new();
    let hello = bench.hello();
    assert_eq!(hello.major, PROTOCOL_MAJOR);
    assert_eq!(hello.reset_cause, ResetCause::Power);
    assert_ne!(hello.board_id, [0; 12]);
    let Reply::Info(info) = bench.done(Request::Info) else {
        panic!("no info");
    };
    assert_eq!((info.cables, info.ticks_per_second), (4, 1000));
    assert!(!info.simulated);
    assert!(
        info.last_panic.is_empty(),
        "noise in RAM was taken for a panic"
    );
    assert_eq!(bench.chip.pins().brakes, [Drive::Low; 4]);
    assert!(!bench.chip.rtt_take().is_empty(), "it logs its start");
}

#[test]
fn encoders_and_tensions_arrive_in_physical_units() {
    let mut bench = Bench::new();
    bench.prepare();
    bench.done(Request::Samples { enabled: true });
    // 100 counts in 100 ms; 2 pi 20 mm / 4096 = 30.68 um per count.
    for step in 1..=2000 {
        for timer in 1..=4 {
            bench.chip.set_encoder(timer, step / 20);
        }
        assert_eq!(bench.chip.run_us(SLICE_US), Ok(()));
    }
    bench.run_ms(20);
    let status = bench.status();
    assert!(status.referenced);
    for (index, length) in status.lengths.iter().enumerate() {
        let sign = 1 - 2 * (index as i32 % 2);
        let moved = length.0 - START;
        assert!(
            (moved - sign * 30_680).abs() <= 2,
            "cable {}: {moved}",
            index + 1
        );
    }
    for (index, tension) in status.tensions.iter().enumerate() {
        assert!(
            (tension.0 - 10_000).abs() < 30,
            "cable {}: {tension:?}",
            index + 1
        );
    }
    let mut last = Vec::new();
    let block = bench.blocks.last().expect("samples were switched on");
    block.unpack(|_, row| last = row.iter().map(|sample| sample.length).collect());
    assert_eq!(last, status.lengths.to_vec());
    assert!((1..=4).all(|timer| bench.chip.lost_counts(timer) == 0));
}

#[test]
fn the_input_filter_swallows_edges_that_no_drum_makes() {
    let mut bench = Bench::new();
    bench.prepare();
    // 100 counts in 50 us: each input would change every microsecond, under the filter's 1.8 us.
    bench.chip.set_encoder(1, 100);
    bench.run_ms(5);
    assert_eq!(bench.chip.lost_counts(1), 100);
    assert_eq!(
        bench.status().lengths.first(),
        Some(&TenthMicrometres(START))
    );
}

#[test]
fn p2_without_drives_it_does_not_arm_and_no_brake_ever_opens() {
    let mut bench = Bench::new();
    let config_hash = bench.prepare();
    assert_eq!(bench.done(Request::Arm { config_hash }), Reply::Done);
    let asked = bench.status();
    assert_eq!(asked.state, BoardState::Arming);
    // Every 12 ms.
    for beat in 0..50 {
        bench.done(Request::Heartbeat { host_time_us: beat });
    }
    let status = bench.status();
    let fault = status.fault.expect("a fault is latched");
    assert_eq!((fault.fault, fault.cable), (FaultId::P2, 0));
    // Drives may take 40 ms, as configured, and 500 ms more.
    assert_eq!(fault.limit, 540);
    let took = fault.tick.0 - asked.tick.0;
    assert!((515..=545).contains(&took), "{took} ticks");
    assert_eq!(status.brakes_open, 0);
    assert!(!bench.chip.brakes_ever_opened());
}

#[test]
fn garbage_from_power_up_on_costs_only_itself() {
    let mut bench = Bench::new();
    let mut noise = 1_u32;
    let garbage: Vec<u8> = std::iter::repeat_with(|| {
        noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (noise >> 24) as u8
    })
    .take(4000)
    .chain([0])
    .collect();
    bench.chip.uart_send(&garbage);
    bench.run_ms(60);
    assert_eq!(bench.hello().major, PROTOCOL_MAJOR);
    let status = bench.status();
    assert!(status.frames_bad > 5, "{} bad frames", status.frames_bad);
    assert_eq!(status.state, BoardState::Disarmed);
    assert_eq!(bench.chip.uart_overruns(), 0);
    assert_eq!(bench.bad_frames, 0);
}

#[test]
fn l16_full_telemetry_loses_no_tick_and_stays_in_budget() {
    // Ten seconds, or as many as asked for.
    let seconds = std::env::var("MCDPR_EMULATED_SECONDS");
    let seconds: u32 = seconds.map_or(10, |text| text.parse().expect("a number of seconds"));
    let mut bench = Bench::new();
    bench.prepare();
    bench.done(Request::Samples { enabled: true });
    bench.blocks.clear();
    let first = bench.chip.take_tick_stats();
    let (began, instructions) = (bench.chip.now_us(), bench.chip.instructions());
    for beat in 0..10 * seconds {
        for timer in 1..=4 {
            bench.chip.set_encoder(timer, i64::from(beat));
        }
        bench.done(Request::Heartbeat { host_time_us: beat });
        bench.run_ms(88);
    }
    let status = bench.status();
    let stats = bench.chip.tick_stats();
    let ms = (bench.chip.now_us() - began) / 1000;
    let stack = STACK_TOP - bench.chip.stack_low_water();
    println!("start and configuration: most {} cycles", first.cycles_max);
    println!(
        "tick: median {} instructions, most {}, or {} cycles; latest start {} cycles; stack {stack} bytes; {} instructions per ms",
        stats.median,
        stats.max,
        stats.cycles_max,
        stats.latency_max,
        (bench.chip.instructions() - instructions) / ms,
    );
    let ram = static_ram();
    println!(
        "{ram} bytes of static RAM, {} with the stack",
        ram + u64::from(stack)
    );
    assert!(ram > 4096 && ram + u64::from(stack) <= RAM_AND_STACK);
    assert_eq!(stats.lost, 0);
    assert!(stats.count.abs_diff(ms as usize) <= 1);
    assert!(status.referenced);
    assert_eq!((status.tick_overruns, status.telemetry_dropped), (0, 0));
    assert_eq!((status.frames_bad, bench.bad_frames), (0, 0));
    for pair in bench.blocks.windows(2) {
        assert_eq!(pair[1].tick.0 - pair[0].tick.0, 10, "a block is missing");
    }
    assert!(bench.blocks.len() as u64 >= ms / 10 - 2);
    assert!(first.cycles_max <= CONFIGURING_CYCLES);
    assert!(stats.cycles_max <= TICK_CYCLES);
    // 2 us at 72 MHz, entry included.
    assert!(stats.latency_max <= 144, "{} cycles", stats.latency_max);
}

#[test]
fn each_situation_stays_within_a_quarter_of_the_tick() {
    let mut bench = Bench::new();
    bench.chip.take_tick_stats();
    let check = |name: &str, bench: &mut Bench| {
        let stats = bench.chip.take_tick_stats();
        println!(
            "{name}: median {} instructions, most {}, or {} cycles",
            stats.median, stats.max, stats.cycles_max
        );
        assert!(stats.count > 10, "{name}: {} ticks", stats.count);
        assert!(stats.cycles_max <= CONFIGURING_CYCLES, "{name}");
    };
    bench.run_ms(300);
    check("without a configuration", &mut bench);
    bench.prepare();
    check("taking a configuration", &mut bench);
    bench.run_ms(300);
    check("configured", &mut bench);
    for host_time_us in 0..20 {
        bench.done(Request::Heartbeat { host_time_us });
    }
    check("with heartbeats", &mut bench);
    bench.status();
    check("asked for its status", &mut bench);
    bench.done(Request::Samples { enabled: true });
    bench.run_ms(300);
    check("with samples", &mut bench);
}

/// Runs to the expected reset, continues, and returns the board's messages after it.
fn after_reset(bench: &mut Bench) -> (ResetCause, String) {
    let stopped = (0..40).find_map(|_| bench.chip.run_us(SLICE_US).err());
    assert!(
        matches!(
            stopped,
            Some(Stop::Reset {
                by: ResetBy::Software,
                ..
            })
        ),
        "{stopped:?}"
    );
    assert_eq!(bench.chip.pins().brakes, [Drive::Low; 4]);
    bench.chip.restart(ResetBy::Software);
    bench.run_ms(20);
    let cause = bench.hello().reset_cause;
    let Reply::Info(info) = bench.done(Request::Info) else {
        panic!("no info");
    };
    (
        cause,
        String::from_utf8_lossy(&info.last_panic).into_owned(),
    )
}

#[test]
fn p4_a_fault_closes_the_brakes_and_is_reported_after_the_reset() {
    let mut bench = Bench::new();
    bench.chip.inject_hard_fault();
    let (cause, text) = after_reset(&mut bench);
    assert_eq!(cause, ResetCause::Panic);
    assert!(text.starts_with("fault at 0x0800"), "{text}");
    assert!(!bench.chip.brakes_ever_opened());
    shows(&mut bench, FaultId::P4);
}

/// The board is in `Fault` for this reason, until it is cleared.
fn shows(bench: &mut Bench, fault: FaultId) {
    let status = bench.status();
    let why = status.fault.map(|record| record.fault);
    assert_eq!((status.state, why), (BoardState::Fault, Some(fault)));
    bench.open();
    assert_eq!(bench.done(Request::ClearFault), Reply::Done);
    assert_eq!(bench.status().state, BoardState::Disarmed);
}

#[test]
fn p1_a_falling_supply_closes_the_brakes_and_keeps_the_board_down_until_it_is_back() {
    let mut bench = Bench::new();
    assert!(bench.chip.set_supply_low(true), "the supply is watched");
    // It restarts once, and waits: brakes closed, no tick, and the watchdog is fed.
    let stopped = (0..200).find_map(|_| bench.chip.run_us(SLICE_US).err());
    assert!(matches!(
        stopped,
        Some(Stop::Reset {
            by: ResetBy::Software,
            ..
        })
    ));
    bench.chip.restart(ResetBy::Software);
    for _ in 0..200_000 / SLICE_US {
        assert_eq!(bench.chip.run_us(SLICE_US), Ok(()));
    }
    assert_eq!(bench.chip.uart_take(), [], "it says nothing");
    assert!(
        bench
            .chip
            .pins()
            .brakes
            .iter()
            .all(|pin| *pin == Drive::Low),
        "{:?}",
        bench.chip.pins()
    );
    bench.chip.set_supply_low(false);
    bench.run_ms(20);
    assert_eq!(bench.hello().reset_cause, ResetCause::Panic);
    shows(&mut bench, FaultId::P1);
    assert!(!bench.chip.brakes_ever_opened());
}

#[test]
fn p3_firmware_that_hangs_is_reset_within_50_ms_and_says_so() {
    let mut bench = Bench::new();
    bench.chip.hang();
    let slices = 50_000 / SLICE_US;
    let stopped = (0..slices).find_map(|_| bench.chip.run_us(SLICE_US).err());
    assert!(
        matches!(
            stopped,
            Some(Stop::Reset {
                by: ResetBy::Watchdog,
                ..
            })
        ),
        "{stopped:?}"
    );
    bench.chip.restart(ResetBy::Watchdog);
    bench.run_ms(20);
    assert_eq!(bench.hello().reset_cause, ResetCause::Watchdog);
    shows(&mut bench, FaultId::P3);
}

#[test]
fn p6_a_stopped_crystal_is_reported_after_the_reset() {
    let mut bench = Bench::new();
    assert!(bench.chip.stop_crystal(), "the clock is watched");
    let (cause, text) = after_reset(&mut bench);
    assert_eq!(
        (cause, text.as_str()),
        (ResetCause::Panic, "P6: crystal stopped")
    );
    shows(&mut bench, FaultId::P6);
}

#[test]
fn two_runs_are_equal() {
    let run = || {
        let mut bench = Bench::new();
        bench.prepare();
        bench.run_ms(200);
        (
            bench.chip.instructions(),
            bench.statuses,
            bench.chip.now_us(),
        )
    };
    assert_eq!(run(), run());
}
