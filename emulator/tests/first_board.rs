//! Properties of a real board that an ideal one does not have: each test runs the firmware file
//! with one property of the chip, its supply, its pins or its drives.

mod support;

use mcdpr_emulator::{CanFrame, CanWiring, Drive, Port, ResetBy, Stop};
use mcdpr_protocol::{BoardState, FaultId, Reject, Reply, Request, ResetCause};
use support::{Bench, SLICE_US, START};

/// Another node is on the bus, which acknowledges.
const WIRED: CanWiring = CanWiring {
    bitrate: 1_000_000,
    others: true,
    shorted: false,
};
/// Voltage of the emergency input: closed to ground, or open.
const RELEASED: Option<bool> = Some(false);
const PRESSED: Option<bool> = Some(true);

/// Runs to a reset and goes on after it; how long that took, us.
fn reset(bench: &mut Bench, by: ResetBy, most_ms: u64) -> u64 {
    let began = bench.chip.now_us();
    let stopped = (0..most_ms * 1000 / SLICE_US).find_map(|_| bench.chip.run_us(SLICE_US).err());
    assert!(
        matches!(&stopped, Some(Stop::Reset { by: found, .. }) if *found == by),
        "{stopped:?}"
    );
    let took = bench.chip.now_us() - began;
    bench.chip.restart(by);
    took
}

fn fault(bench: &mut Bench) -> (BoardState, Option<FaultId>) {
    let status = bench.status();
    (status.state, status.fault.map(|record| record.fault))
}

/// Levels of the LED, seen every 10 ms.
fn blinks(bench: &mut Bench, ms: u64) -> usize {
    let mut levels = Vec::new();
    for _ in 0..ms / 10 {
        for _ in 0..10_000 / SLICE_US {
            assert_eq!(bench.chip.run_us(SLICE_US), Ok(()));
        }
        levels.push(bench.chip.pins().led);
    }
    levels.windows(2).filter(|pair| pair[0] != pair[1]).count()
}

fn winch(bench: &mut Bench, cable: u8) -> mcdpr_protocol::Winch {
    match bench.done(Request::Winch { cable }) {
        Reply::Winch(winch) => winch,
        other => panic!("{other:?}"),
    }
}

#[test]
fn encoders_count_though_the_reload_register_is_zero_after_a_reset() {
    let mut bench = Bench::new();
    for timer in 1..=4 {
        let timer_u8 = u8::try_from(timer).expect("one of four");
        let before = winch(&mut bench, timer_u8).drum_counts;
        for step in 1..=200 {
            bench.chip.set_encoder(timer, step);
            bench.run_ms(1);
        }
        bench.run_ms(2);
        assert_eq!(winch(&mut bench, timer_u8).drum_counts - before, 200);
    }
}

#[test]
fn a_crystal_that_never_starts_leaves_a_board_that_says_p6_and_does_not_arm() {
    let mut bench = Bench::on(|chip| chip.set_crystal(false));
    bench.run_ms(30);
    assert_eq!(bench.hello().reset_cause, ResetCause::Power);
    assert_eq!(
        fault(&mut bench),
        (BoardState::Fault, Some(FaultId::P6)),
        "on its own oscillator"
    );
    let config_hash = bench.prepare();
    let p6 = FaultId::P6;
    let refused = bench.ask(Request::ClearFault).result;
    assert_eq!(refused, Err(Reject::CauseRemains { fault: p6 }));
    let refused = bench.ask(Request::Arm { config_hash }).result;
    assert!(
        matches!(
            refused,
            Err(Reject::WrongState { .. } | Reject::Faulted { .. })
        ),
        "{refused:?}"
    );
    assert!(blinks(&mut bench, 1000) >= 6, "its LED blinks");
    assert!(bench.chip.resets().is_empty() && !bench.chip.brakes_ever_opened());
    // The crystal works again: so does the board.
    bench.chip.set_crystal(true);
    bench.chip.inject_hard_fault();
    reset(&mut bench, ResetBy::Software, 5);
    bench.run_ms(30);
    assert_eq!(fault(&mut bench).1, Some(FaultId::P4));
}

#[test]
fn a_pll_that_never_locks_leaves_a_board_that_blinks_with_every_output_off() {
    let mut bench = Bench::on(|chip| chip.set_pll(false));
    assert!(blinks(&mut bench, 1000) >= 6, "its LED blinks");
    assert!(bench.chip.resets().is_empty(), "the watchdog is fed");
    let pins = bench.chip.pins();
    assert_eq!(pins.brakes, [Drive::Floating; 4]);
    assert_eq!(pins.drive_enable, Drive::Floating);
}

#[test]
fn the_watchdog_runs_before_the_clocks_do() {
    // The core waits for a crystal that does not start: 12 ms, after about 4 ms in which memory is
    // cleared.
    let mut bench = Bench::on(|chip| {
        chip.set_crystal(false);
        assert_eq!(chip.run_us(9000), Ok(()));
        chip.set_crystal(true);
        chip.halt();
        let stopped = (0..60_000 / SLICE_US).find_map(|_| chip.run_us(SLICE_US).err());
        let by_watchdog = matches!(
            stopped,
            Some(Stop::Reset {
                by: ResetBy::Watchdog,
                ..
            })
        );
        assert!(by_watchdog, "{stopped:?}");
        chip.restart(ResetBy::Watchdog);
    });
    bench.run_ms(20);
    assert_eq!(bench.hello().reset_cause, ResetCause::Watchdog);
}

#[test]
fn the_watchdog_waits_25_to_50_ms_with_any_oscillator_that_a_chip_may_have() {
    for (hz, least_ms, most_ms) in [(30_000, 45, 51), (40_000, 33, 39), (60_000, 22, 26)] {
        let mut bench = Bench::on(|chip| {
            chip.set_slow_oscillator(hz);
            // The slowest start: a crystal that never starts.
            chip.set_crystal(hz != 60_000);
        });
        bench.run_ms(500);
        assert!(bench.chip.resets().is_empty(), "{hz} Hz: it feeds in time");
        bench.chip.hang();
        let took = reset(&mut bench, ResetBy::Watchdog, 60) as f64 * 1e-3;
        assert!(
            (f64::from(least_ms)..=f64::from(most_ms)).contains(&took),
            "{hz} Hz: {took} ms"
        );
    }
}

#[test]
fn a_debugger_that_halts_the_core_ends_in_a_reset_and_a_short_halt_in_a_late_tick() {
    let mut bench = Bench::new();
    bench.prepare();
    bench.chip.halt();
    bench.run_ms(5);
    bench.chip.resume();
    bench.run_ms(50);
    assert!(bench.chip.resets().is_empty());
    assert!(bench.status().tick_overruns >= 1);
    bench.chip.halt();
    reset(&mut bench, ResetBy::Watchdog, 60);
    bench.run_ms(20);
    assert_eq!(fault(&mut bench).1, Some(FaultId::P3));
    assert_eq!(bench.chip.pins().brakes, [Drive::Low; 4]);
}

#[test]
fn nothing_is_slept_through_on_a_core_whose_exceptions_set_no_event() {
    let mut bench = Bench::new();
    bench.chip.set_can_wiring(WIRED);
    bench.prepare();
    bench.done(Request::Samples { enabled: true });
    for host_time_us in 0..40 {
        bench.done(Request::Heartbeat { host_time_us });
    }
    assert!(bench.chip.now_us() > 500_000);
    assert_eq!(bench.chip.slept_through(), 0);
}

#[test]
fn one_or_two_disturbed_samples_are_no_emergency_stop_and_four_are() {
    let mut bench = Bench::new();
    for _ in 0..5 {
        bench.chip.set_input(Port::B, 5, PRESSED);
        bench.run_ms(2);
        bench.chip.set_input(Port::B, 5, RELEASED);
        bench.run_ms(20);
        assert_eq!(fault(&mut bench), (BoardState::Disarmed, None));
    }
    bench.chip.set_input(Port::B, 5, PRESSED);
    bench.run_ms(4);
    bench.chip.set_input(Port::B, 5, RELEASED);
    bench.run_ms(20);
    assert_eq!(fault(&mut bench), (BoardState::Fault, Some(FaultId::P7)));
}

#[test]
fn a_tension_stays_what_it_is_while_the_supply_drifts() {
    let mut bench = Bench::new();
    bench.prepare();
    for supply_v in [3.3, 3.2, 3.1, 3.4, 3.5] {
        bench.chip.set_supply_v(supply_v);
        bench.run_ms(600);
        for (index, tension) in bench.status().tensions.iter().enumerate() {
            let off = tension.0 - 10_000;
            assert!(
                off.abs() < 60,
                "{supply_v} V, cable {}: {off} mN",
                index + 1
            );
        }
    }
    // An input at the supply is still open.
    bench.chip.set_supply_v(3.1);
    bench.chip.set_adc(4, 4095);
    bench.run_ms(300);
    assert!(winch(&mut bench, 1).tension_adc > 64_900);
}

/// Frames that the chip has sent since the last call, by identifier.
fn sent(bench: &mut Bench) -> Vec<(u64, u32)> {
    let frames = bench.chip.can_take().into_iter();
    frames
        .map(|sent| (sent.ends_at_us, sent.frame.id))
        .collect()
}

#[test]
fn after_any_reset_the_drives_of_before_are_stopped_and_their_power_is_off() {
    let mut bench = Bench::new();
    bench.chip.set_can_wiring(WIRED);
    assert_eq!(bench.chip.pins().drive_enable, Drive::Low);
    bench.run_ms(100);
    assert_eq!(sent(&mut bench), [], "noise in RAM stops nobody");
    bench.prepare();
    bench.run_ms(20);
    assert_eq!(bench.chip.pins().drive_enable, Drive::High);
    for by in [ResetBy::Watchdog, ResetBy::Software] {
        if by == ResetBy::Watchdog {
            bench.chip.hang();
        } else {
            bench.chip.inject_hard_fault();
        }
        reset(&mut bench, by, 60);
        assert_eq!(bench.chip.pins().drive_enable, Drive::Floating);
        sent(&mut bench);
        let began = bench.chip.now_us();
        bench.run_ms(100);
        let frames = sent(&mut bench);
        for node in 1..=4 {
            let mine = frames.iter().filter(|(_, id)| *id == node << 4);
            let mine: Vec<_> = mine.map(|(at, _)| at - began).collect();
            assert!(mine.len() >= 3, "{by:?}, node {node}: {mine:?}");
            assert!(mine[0] < 30_000, "{by:?}, node {node}: {mine:?}");
        }
        assert_eq!(bench.chip.pins().drive_enable, Drive::Low);
    }
}

#[test]
fn the_state_reports_the_torque_that_a_drive_has_not_the_commanded_one() {
    let mut bench = Bench::new();
    bench.chip.set_can_wiring(WIRED);
    bench.prepare();
    bench.chip.hang();
    reset(&mut bench, ResetBy::Watchdog, 60);
    bench.run_ms(20);
    assert_eq!(bench.status().torque_on, 0);
    // Drive 2 continues: 1500 mA.
    for _ in 0..10 {
        let now = bench.chip.now_us();
        let frame = CanFrame::standard(0x2B, &[0x05, 0xDC, 0, 0, 0, 0, 0, 0]);
        bench.chip.can_send(now, frame);
        bench.run_ms(2);
    }
    assert_eq!(bench.status().torque_on, 0b0010);
    bench.run_ms(50);
    assert_eq!(bench.status().torque_on, 0, "it has fallen silent");
}

/// Turns every drum by so many counts, one every 300 us.
fn turn(bench: &mut Bench, place: &mut i64, counts: i64) {
    for _ in 0..counts {
        *place += 1;
        for timer in 1..=4 {
            bench.chip.set_encoder(timer, *place);
        }
        for _ in 0..300 / SLICE_US {
            assert_eq!(bench.chip.run_us(SLICE_US), Ok(()));
        }
    }
}

fn kept(bench: &mut Bench) -> mcdpr_protocol::Kept {
    match bench.done(Request::Kept) {
        Reply::Kept(kept) => kept,
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_fault_of_the_program_costs_no_lengths() {
    let mut bench = Bench::new();
    assert_eq!(
        kept(&mut bench),
        mcdpr_protocol::Kept::default(),
        "registers at power-on"
    );
    bench.prepare();
    let mut place = 0;
    turn(&mut bench, &mut place, 90);
    bench.run_ms(2);
    let before = bench.status();
    assert!(before.referenced);
    assert_eq!(kept(&mut bench).lengths.len(), 0, "it was not reset yet");
    // The drums go on while the board starts.
    bench.chip.inject_hard_fault();
    reset(&mut bench, ResetBy::Software, 1);
    turn(&mut bench, &mut place, 60);
    bench.run_ms(20);
    let kept_lengths = kept(&mut bench);
    assert!(kept_lengths.counted);
    assert_eq!(kept_lengths.brakes_open, 0);
    assert_eq!(kept_lengths.lengths, before.lengths);
    // Lengths of a configured board without a reference are the way since its start.
    bench.configure();
    bench.run_ms(2);
    let since = bench.status();
    assert!(!since.referenced);
    for (cable, (way, length)) in (1..).zip(since.lengths.iter().zip(before.lengths.iter())) {
        // 90 counts before the reset, 60 since: to a count, as the filter starts from any level.
        let count = f64::from(length.0 - START) / 90.0;
        let counts = f64::from(way.0) / count;
        assert!(
            (counts - 60.0).abs() < 1.01,
            "cable {cable}: {counts} counts"
        );
    }
    // A second reset: what the drums did in between is not known to anybody.
    bench.chip.inject_hard_fault();
    reset(&mut bench, ResetBy::Software, 1);
    bench.run_ms(20);
    assert_eq!(kept(&mut bench).lengths.len(), 0);
}

#[test]
fn a_board_that_hung_or_whose_supply_fell_has_not_counted() {
    for battery in [false, true] {
        let mut bench = Bench::on(|chip| {
            if battery {
                chip.fit_battery();
            }
        });
        bench.prepare();
        bench.run_ms(2);
        let lengths = bench.status().lengths;
        bench.chip.hang();
        reset(&mut bench, ResetBy::Watchdog, 60);
        bench.run_ms(20);
        let hung = kept(&mut bench);
        assert_eq!((&hung.lengths, hung.counted), (&lengths, false));
        bench.prepare();
        bench.run_ms(2);
        // Under 2.9 V the encoders may have too little, too.
        assert!(bench.chip.set_supply_low(true), "it is watched");
        reset(&mut bench, ResetBy::Software, 1);
        bench.chip.set_supply_low(false);
        bench.run_ms(20);
        let dipped = kept(&mut bench);
        assert_eq!((&dipped.lengths, dipped.counted), (&lengths, false));
        bench.prepare();
        bench.run_ms(2);
        bench.chip.power_on();
        bench.run_ms(20);
        let kept = kept(&mut bench);
        assert!(!kept.counted);
        assert_eq!(kept.lengths.len(), if battery { 4 } else { 0 });
    }
}
