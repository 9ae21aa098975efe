//! A supply that ramps, ripples and dips: each test runs the firmware file on a chip whose supply is
//! one voltage over time.

mod support;

use mcdpr_emulator::{Chip, Drive, ResetBy, SupplyLimits};
use mcdpr_protocol::{BoardState, FaultId, Reply, Request, ResetCause};
use std::f64::consts::TAU;
use support::power::{CHIPS, GOOD_V, Winches, floats, follow, open, resets, run};
use support::{Bench, SLICE_US};

/// Fastest fall of the supply that the data sheet allows (DS5319, table "Operating conditions at
/// power-up / power-down"), s/V.
const FALL_S_PER_V: f64 = 20e-6;
/// After a dip the board has so much time to start, s.
const START_S: f64 = 0.06;

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

/// The bench's drums stand, and the first one's test says so after 0.2 s, whatever the supply does.
const BENCH: FaultId = FaultId::B1;

/// What a dip has led to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Outcome {
    /// Nothing.
    GoesOn,
    /// It runs, with this fault.
    Faults(FaultId),
    /// It restarted for this cause, with this fault.
    Restarts(ResetCause, Option<FaultId>),
}

impl std::fmt::Display for Outcome {
    fn fmt(&self, to: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::GoesOn => write!(to, "-"),
            Self::Faults(fault) => write!(to, "{fault:?}"),
            Self::Restarts(ResetCause::Power, None) => write!(to, "power"),
            Self::Restarts(ResetCause::Panic, Some(fault)) => write!(to, "{fault:?} reset"),
            Self::Restarts(cause, fault) => write!(to, "{cause:?} {fault:?}"),
        }
    }
}

/// Lets the supply dip to `low_v` for `ms`, and looks what has become of the board. Also how long a
/// brake was open after the supply had left its range, us.
fn dip(winches: &mut Winches, low_v: f64, ms: f64) -> (Outcome, u64) {
    let armed = open(&winches.bench.chip);
    let edge_s = FALL_S_PER_V * (GOOD_V - low_v);
    let length_s = 2.0 * edge_s + ms * 1e-3;
    let volts = |s: f64| {
        let fallen = (s / FALL_S_PER_V).min((length_s - s).max(0.0) / FALL_S_PER_V);
        (GOOD_V - fallen).max(low_v)
    };
    let (mut reset_at, mut open_us) = (None, 0);
    let (mut at_us, mut told_us) = (0, 0);
    while (at_us as f64) < (length_s + START_S) * 1e6 {
        let chip = &mut winches.bench.chip;
        let before = chip.resets().len();
        let now_v = volts(at_us as f64 * 1e-6);
        chip.set_supply_v(now_v);
        // The edges in steps of 0.25 V.
        let falls_or_rises = at_us < 100 || (now_v > low_v && now_v < GOOD_V);
        let step_us = if falls_or_rises { 5 } else { SLICE_US };
        winches.drives.step(chip, step_us);
        at_us += step_us;
        if at_us >= told_us {
            // The host goes on, whatever the board does.
            winches.bench.tell(Request::Heartbeat { host_time_us: 0 });
            told_us += 20_000;
        }
        let chip = &winches.bench.chip;
        if chip.resets().len() > before {
            reset_at.get_or_insert(at_us);
        }
        if open(chip) {
            assert_eq!(reset_at, None, "a brake opened after a reset");
            open_us = at_us;
        }
    }
    // What was on the line when the supply fell is not whole.
    winches.bench.chip.uart_take();
    let status = winches.status();
    let cause = reset_at.map(|_| winches.bench.hello().reset_cause);
    let fault = status.fault.map(|record| record.fault);
    let referenced = status.referenced;
    let outcome = match (cause, fault) {
        (Some(cause), _) => Outcome::Restarts(cause, fault),
        (None, Some(fault)) if fault != BENCH => Outcome::Faults(fault),
        (None, _) => Outcome::GoesOn,
    };
    assert_eq!(referenced, reset_at.is_none());
    if reset_at.is_some() || !armed {
        // Without a command no brake opens, whatever the drives say.
        winches.run_ms(100);
        assert!(!open(&winches.bench.chip));
        let allowed = [Drive::Low, Drive::High][usize::from(reset_at.is_none())];
        assert_eq!(winches.bench.chip.pins().drive_enable, allowed);
    }
    (outcome, open_us)
}

/// Which of the outcomes is right: by the lowest voltage alone.
fn expected(limits: &SupplyLimits, low_v: f64) -> [Outcome; 2] {
    let detector_v = 2.78 + 0.12 * limits.detector;
    if low_v < limits.power_down_v {
        [Outcome::Restarts(ResetCause::Power, None); 2]
    } else if low_v < detector_v {
        [Outcome::Restarts(ResetCause::Panic, Some(FaultId::P1)); 2]
    } else {
        // A dip below the converter's range that lasts is S8, if the sensors are in use.
        [Outcome::GoesOn, Outcome::Faults(FaultId::S8)]
    }
}

const DIPS_V: [f64; 8] = [3.0, 2.8, 2.5, 2.0, 1.9, 1.7, 1.0, 0.0];
const DIPS_MS: [f64; 4] = [0.1, 1.0, 10.0, 100.0];

/// Every dip on every chip, on copies of one board.
fn dips(ready: impl Fn(SupplyLimits) -> Winches, check: impl Fn(&mut Winches, Outcome)) {
    for (name, limits) in CHIPS {
        let ready = ready(limits);
        println!("{name}: dip to V, for {DIPS_MS:?} ms");
        for low_v in DIPS_V {
            let mut row = format!("{low_v:4.1}");
            let mut longest_us = 0;
            for ms in DIPS_MS {
                let mut winches = ready.fork();
                let (outcome, open_us) = dip(&mut winches, low_v, ms);
                assert!(
                    expected(&limits, low_v).contains(&outcome),
                    "{name}, {low_v} V, {ms} ms: {outcome:?}"
                );
                row += &format!(" | {outcome:8}");
                if matches!(outcome, Outcome::Restarts(..)) {
                    longest_us = longest_us.max(open_us);
                }
                check(&mut winches, outcome);
            }
            println!("{row} | a brake was open for {longest_us} us at most");
            assert!(longest_us < 100, "{name}, {low_v} V");
        }
    }
}

#[test]
fn a_dip_of_a_disarmed_board_is_unnoticed_or_named_and_no_brake_opens() {
    dips(Winches::new, |winches, outcome| {
        assert!(!winches.bench.chip.brakes_ever_opened());
        assert!(!matches!(outcome, Outcome::Faults(_)));
        // Lengths are the right ones or none, and nobody says that the drums were watched.
        let Reply::Kept(kept) = winches.bench.done(Request::Kept) else {
            panic!("no lengths")
        };
        let right = kept.lengths.iter().all(|length| length.0 == support::START);
        assert!(right && !kept.counted, "{kept:?}");
    });
}

#[test]
fn a_dip_while_brakes_are_open_closes_them_at_once_or_is_unnoticed() {
    let armed = |limits| {
        let mut winches = Winches::new(limits);
        assert_eq!(winches.arm(), None);
        assert!(open(&winches.bench.chip));
        winches
    };
    dips(armed, |_, _| {});
}
