//! Dips of the supply, to any depth and for any time, of a board that is configured and of one that holds its
//! robot: each test runs the firmware file on a chip whose supply is one voltage over time.

mod support;

use mcdpr_emulator::{Drive, SupplyLimits};
use mcdpr_protocol::{FaultId, Reply, Request, ResetCause};
use support::SLICE_US;
use support::power::{CHIPS, GOOD_V, Winches, follow, open};

/// Fastest fall of the supply that the data sheet allows (DS5319, table "Operating conditions at
/// power-up / power-down"), s/V.
const FALL_S_PER_V: f64 = 20e-6;
/// After a dip the board has so much time to start, s.
const START_S: f64 = 0.06;

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

#[test]
fn brakes_close_at_any_moment_of_the_tick() {
    let mut winches = Winches::new(SupplyLimits::TYPICAL);
    assert_eq!(winches.arm(), None);
    for (low_v, most_us) in [(2.5, 300), (0.0, 100)] {
        let longest_us = (0..50).map(|moment| {
            let mut winches = winches.fork();
            follow(
                &mut winches.bench.chip,
                20e-6 * f64::from(moment),
                20,
                |_| GOOD_V,
            );
            let (outcome, open_us) = dip(&mut winches, low_v, 1.0);
            assert!(matches!(outcome, Outcome::Restarts(..)), "{outcome:?}");
            open_us
        });
        let longest_us = longest_us.max().unwrap_or(0);
        println!(
            "{low_v} V: a brake is open for {longest_us} us at most after the supply began to fall"
        );
        assert!(longest_us < most_us, "{low_v} V");
    }
}

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
