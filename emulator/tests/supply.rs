//! A supply that ramps, ripples and fails: each test runs the firmware file on a chip whose supply is
//! one voltage over time. Dips of a robot's supply are in `dips.rs`.

mod support;

use mcdpr_emulator::{Chip, ResetBy, SupplyLimits};
use mcdpr_protocol::{BoardState, FaultId, Reply, Request, ResetCause};
use std::f64::consts::TAU;
use support::power::{CHIPS, GOOD_V, Winches, floats, follow, resets, run};
use support::{Bench, SLICE_US};

/// A board that gets its supply later.
fn unsupplied(limits: SupplyLimits, volts: f64) -> Bench {
    Bench::on(|chip| {
        chip.set_supply_limits(limits);
        chip.set_supply_v(volts);
    })
}

/// Moves the supply at so many V/s; away from the chip's thresholds at 10 V/s at least.
fn ramp(chip: &mut Chip, limits: &SupplyLimits, from_v: f64, to_v: f64, rate: f64) {
    // The firmware's level of the detector: 2.78 V falling, 2.88 V rising, 0.12 V of tolerance.
    let low_v = 2.78 + 0.12 * limits.detector;
    let reset = limits.power_down_v - 0.02..limits.power_on_v + 0.02;
    let detector = low_v - 0.02..low_v + 0.12;
    let mut now_v = from_v;
    while now_v != to_v {
        let matters = reset.contains(&now_v) || detector.contains(&now_v);
        let rate = if matters { rate } else { rate.max(10.0) };
        let step_v = rate * SLICE_US as f64 * 1e-6;
        now_v += (to_v - now_v).clamp(-step_v, step_v);
        chip.set_supply_v(now_v);
        run(chip, SLICE_US);
    }
}

#[test]
fn a_supply_that_ramps_at_any_rate_opens_nothing_and_ends_in_a_board_that_answers() {
    for (name, limits) in CHIPS {
        // V/s. The slow ones begin just below the chip's thresholds.
        for (rate, from_v) in [(0.1, 1.7), (1.0, 1.7), (10.0, 0.0), (100.0, 0.0)] {
            // Nothing but a wait is longer at 0.1 V/s: one chip is enough.
            if rate < 1.0 && name != "typical" {
                continue;
            }
            let mut bench = unsupplied(limits, from_v);
            assert!(floats(&bench.chip) && bench.chip.uart_take().is_empty());
            ramp(&mut bench.chip, &limits, from_v, GOOD_V, rate);
            bench.chip.set_supply_v(GOOD_V);
            bench.run_ms(30);
            assert_eq!(
                bench.hello().reset_cause,
                ResetCause::Power,
                "{name} {rate}"
            );
            let status = bench.status();
            let state = (status.state, status.fault.is_some());
            assert_eq!(state, (BoardState::Disarmed, false), "{name} {rate}");
            assert_eq!(bench.chip.resets(), [ResetBy::Supply], "{name} {rate}");
            // The reset of the first line, P1 on the way down, and the power-down reset.
            ramp(&mut bench.chip, &limits, GOOD_V, from_v, rate);
            assert!(floats(&bench.chip));
            let all = [ResetBy::Supply, ResetBy::Software, ResetBy::Supply];
            assert_eq!(bench.chip.resets(), all, "{name} {rate}");
            assert!(!bench.chip.outputs_ever_high(), "{name} {rate}");
        }
    }
}

#[test]
fn a_slow_ramp_with_ripple_resets_often_and_opens_nothing() {
    for (name, limits) in CHIPS {
        let mut bench = unsupplied(limits, 1.7);
        // 1 V/s, and 100 mV at 100 Hz: both thresholds are crossed many times.
        follow(&mut bench.chip, GOOD_V - 1.7, SLICE_US, |s| {
            1.7 + s + 0.1 * (TAU * 100.0 * s).sin()
        });
        bench.chip.set_supply_v(GOOD_V);
        bench.chip.uart_take();
        bench.run_ms(30);
        let down = resets(&bench.chip, ResetBy::Supply) - 1;
        let low = resets(&bench.chip, ResetBy::Software);
        println!("{name}: {down} power-down resets, {low} times P1");
        assert!(down >= 3 && low >= 3, "{name}: {down}, {low}");
        assert_eq!(resets(&bench.chip, ResetBy::Watchdog), 0);
        assert!(!bench.chip.outputs_ever_high(), "{name}");
        // The last reset was P1, which the user clears.
        assert_eq!(bench.hello().reset_cause, ResetCause::Panic, "{name}");
        let fault = bench.status().fault.map(|record| record.fault);
        assert_eq!(fault, Some(FaultId::P1), "{name}");
        bench.prepare();
        assert_eq!(bench.done(Request::ClearFault), Reply::Done);
        assert_eq!(bench.status().state, BoardState::Disarmed, "{name}");
    }
}

#[test]
fn the_chip_starts_above_its_threshold_after_its_time() {
    for (name, limits) in CHIPS {
        let mut bench = unsupplied(limits, 0.0);
        let chip = &mut bench.chip;
        let runs = |chip: &mut Chip, us: u64| {
            let before = chip.instructions();
            assert_eq!(chip.run_us(us), Ok(()), "{name}");
            chip.instructions() > before
        };
        chip.set_supply_v(limits.power_on_v - 0.001);
        assert!(!runs(chip, 10_000), "{name}");
        chip.set_supply_v(limits.power_on_v + 0.001);
        assert!(!runs(chip, limits.start_us - 1), "{name}");
        // A fall in this time begins it anew.
        chip.set_supply_v(limits.power_down_v - 0.001);
        assert!(!runs(chip, 10), "{name}");
        chip.set_supply_v(GOOD_V);
        assert!(!runs(chip, limits.start_us - 1), "{name}");
        assert!(runs(chip, 2), "{name}");
        // Down to the lower threshold it runs.
        chip.set_supply_v(limits.power_down_v + 0.001);
        assert!(runs(chip, 10), "{name}");
        chip.set_supply_v(limits.power_down_v - 0.001);
        assert!(!runs(chip, 10_000), "{name}");
        assert_eq!(resets(chip, ResetBy::Supply), 2, "{name}");
    }
}

#[test]
fn a_storm_of_dips_opens_nothing_and_ends_in_a_board_that_answers() {
    for (name, limits) in CHIPS {
        let mut bench = Bench::on(|chip| chip.set_supply_limits(limits));
        let mut noise = 1_u32;
        let mut draw = |most: u32| {
            noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (noise >> 8) % most
        };
        // Into the start, too: it takes 5 to 25 ms.
        for _ in 0..100 {
            let low_v = f64::from(draw(300)) * 0.01;
            for volts in [low_v, GOOD_V] {
                bench.chip.set_supply_v(volts);
                run(&mut bench.chip, 10 + u64::from(draw(25_000)));
            }
        }
        bench.chip.uart_take();
        bench.run_ms(30);
        let counts = [ResetBy::Supply, ResetBy::Software].map(|by| resets(&bench.chip, by));
        println!("{name}: {counts:?} resets by the supply and by P1");
        assert!(counts.iter().all(|count| *count > 10), "{name}");
        assert_eq!(resets(&bench.chip, ResetBy::Watchdog), 0, "{name}");
        assert!(!bench.chip.outputs_ever_high(), "{name}");
        bench.hello();
        bench.prepare();
    }
}

/// What the board knows after a loss of its supply: whether it stops the drives of before, which it has
/// in RAM, and how many lengths it has, which are in the backup registers.
fn knows(lowest_v: f64, battery: bool) -> (bool, usize) {
    let mut winches = Winches::new(SupplyLimits::TYPICAL);
    if battery {
        winches.bench.chip.fit_battery();
    }
    winches.bench.chip.can_take();
    let length_s = 0.01;
    follow(&mut winches.bench.chip, length_s, SLICE_US, |_| lowest_v);
    follow(&mut winches.bench.chip, 0.03, SLICE_US, |_| GOOD_V);
    let sent = winches.bench.chip.can_take();
    winches.bench.chip.uart_take();
    let Reply::Kept(kept) = winches.bench.done(Request::Kept) else {
        panic!("no lengths")
    };
    // Function 0 of an RMDS.
    let stops = sent.iter().any(|sent| sent.frame.id == 0x10);
    (stops, kept.lengths.len())
}

#[test]
fn memory_outlives_a_dip_as_its_voltage_says_and_a_battery_keeps_the_lengths() {
    // The typical chip is assumed to keep all down to 1.5 V and nothing at 0.5 V.
    assert_eq!(knows(1.7, false), (true, 4));
    assert_eq!(knows(1.0, false), (false, 0));
    assert_eq!(knows(0.0, false), (false, 0));
    assert_eq!(knows(1.0, true), (false, 4));
    assert_eq!(knows(0.0, true), (false, 4));
}

/// RM0008, 7.3.10: a system reset leaves the flags of the resets before it.
#[test]
fn a_reset_before_the_first_one_was_read_leaves_the_power_as_the_cause() {
    let mut bench = Bench::on(|chip| {
        assert_eq!(chip.run_us(1000), Ok(()));
        chip.restart(ResetBy::Software);
    });
    assert_eq!(bench.hello().reset_cause, ResetCause::Power);
}

/// The firmware compares the supply with a reference of 1.16 to 1.24 V. With the typical 1.20 V of
/// this chip its range is 2.90 to 3.73 V.
#[test]
fn arming_ends_in_s8_before_a_brake_opens_while_the_supply_is_outside_of_its_range() {
    // Its voltage detector is the last to notice, at 2.66 V.
    let ready = Winches::new(SupplyLimits::LOWEST);
    for (volts, fault) in [
        (2.70, Some(FaultId::S8)),
        (2.88, Some(FaultId::S8)),
        (2.93, None),
        (3.30, None),
        (3.70, None),
        (3.75, Some(FaultId::S8)),
    ] {
        let mut winches = ready.fork();
        winches.bench.chip.set_supply_v(volts);
        // The measured supply is a mean of 64 ms.
        winches.run_ms(500);
        let found = winches.arm().map(|record| record.fault);
        assert_eq!(found, fault, "{volts} V");
        let opened = winches.bench.chip.brakes_ever_opened();
        assert_eq!(opened, fault.is_none(), "{volts} V");
        assert!(winches.bench.chip.resets().is_empty(), "{volts} V");
    }
}
