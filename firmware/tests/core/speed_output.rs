//! A robot whose tension-held drum has a gear that rubs: the law commands the drum's speed.

use crate::support::{ARMING_MS, Bench, MOTOR_COUNTS, entries};
use mcdpr_firmware::{Brake, DriveDemand, State};
use mcdpr_protocol::{CableKey, ConfigEntry, ConfigKey, FaultId, StopKind};

/// The tension-held cable's index.
const HELD: usize = 3;
/// A release of this much force is in the drive's current, mA, when its brake has passed: half of the load of 10 N, an
/// eighth of the 15 N and three quarters of a newton of friction, at 50 N an ampere.
const PUSH_MA: i16 = 152;

fn geared() -> Vec<ConfigEntry> {
    let mut all = entries();
    for (key, value) in [
        (CableKey::TensionOutput, 1),
        (CableKey::SpeedCornerMhz, 30_000),
        // mm/s per N, and per N/s.
        (CableKey::TensionKp, 2500),
        (CableKey::TensionKd, 40_000),
    ] {
        let key = ConfigKey::cable(HELD as u8, key);
        all.iter_mut().find(|entry| entry.key == key).unwrap().value = value;
    }
    all
}

/// Turns per minute of the motor for this speed of the cable.
fn rpm_of(mmps: f64) -> f64 {
    let circumference_mm = std::f64::consts::TAU * 20.0;
    mmps / circumference_mm * f64::from(MOTOR_COUNTS) / 4096.0 * 60.0
}

fn rpm(bench: &Bench) -> i16 {
    match bench.outputs.drives[HELD] {
        DriveDemand::Speed { rpm } => rpm,
        other => panic!("{other:?}"),
    }
}

#[test]
fn arming_enables_speed_pushes_against_the_brake_both_ways_and_opens_it_at_rest() {
    let mut bench = Bench::ready_with(&geared());
    bench.arm_with(&geared()).unwrap();
    let (mut pushed, mut turned) = ((0, 0), 0);
    for tick in 1..=ARMING_MS {
        bench.step();
        let demand = bench.outputs.drives[HELD];
        if bench.state() == State::Holding {
            assert!(bench.all_brakes(Brake::Open));
            assert!(pushed.0 > PUSH_MA, "{pushed:?}");
            // Then it carries the load again: 10 N, and friction.
            assert!(pushed.1 < -200, "{pushed:?}");
            // Out and in again, by as much as shows a count of the encoder.
            assert!(turned > 0, "the drum was not moved");
            return;
        }
        match demand {
            DriveDemand::EnableSpeed => assert!(tick <= 10, "still enables after {tick} ticks"),
            DriveDemand::Speed { rpm } if bench.outputs.brakes[HELD] == Brake::Closed => {
                pushed.0 = pushed.0.max(bench.current_ma(HELD));
                pushed.1 = pushed.1.min(bench.current_ma(HELD));
                assert!(f64::from(rpm.abs()) <= rpm_of(5.0) + 1.0, "{rpm}");
            }
            DriveDemand::Speed { rpm } => turned += i32::from(rpm.abs()),
            other => panic!("{other:?} in tick {tick}"),
        }
    }
    panic!("not armed: {:?}", bench.fault());
}

#[test]
fn b2_a_weak_brake_behind_a_gear_aborts_arming() {
    let mut bench = Bench::ready_with(&geared());
    bench.weak[HELD] = true;
    bench.arm_with(&geared()).unwrap();
    bench.run(ARMING_MS);
    let record = bench.server.controller().fault().unwrap();
    assert_eq!((record.fault, record.cable), (FaultId::B2, 4));
}

#[test]
fn at_rest_the_drum_pays_out_under_too_much_tension_reels_in_under_too_little_and_stands_blind() {
    for (tension_mn, sign) in [(10_000, 0), (12_000, 1), (8_000, -1)] {
        let mut bench = Bench::holding_with(&geared());
        bench.run(200);
        bench.tension_mn = tension_mn;
        bench.run(20);
        assert_eq!(rpm(&bench).signum(), sign, "{tension_mn}");
        // An open input gives no information.
        bench.tamper = |i| i.tension_adc[HELD] = 65_520;
        bench.run(2);
        assert_eq!(rpm(&bench), 0);
    }
}

#[test]
fn in_motion_the_drum_turns_at_the_planned_speed_and_a_stop_ends_with_its_brake_closed() {
    let mut bench = Bench::moving_with(&geared(), 1000);
    let mean = (0..100)
        .map(|_| {
            bench.step();
            f64::from(rpm(&bench))
        })
        .sum::<f64>()
        / 100.0;
    let planned = rpm_of(20.0);
    assert!(
        (mean - planned).abs() < 0.01 * planned,
        "{mean} of {planned}"
    );
    bench.stop(StopKind::Stop);
    for _ in 0..3000 {
        bench.step();
        if bench.outputs.brakes[HELD] == Brake::Closed {
            break;
        }
        let most = planned + 1.0;
        // While it decelerates it is led by half of its drive's lead of 8 ms, so that at the end it is asked to turn back a
        // little: 2.5 times the mean deceleration of a stop of 300 ms.
        let least = -2.5 * planned / 0.3 * 0.004 - 1.0;
        assert!((least..=most).contains(&f64::from(rpm(&bench))));
    }
    bench.run(1500);
    assert_eq!((bench.state(), bench.fault()), (State::Disarmed, None));
    assert!(!bench.any_torque());
}

#[test]
fn d2_a_drive_that_turns_at_under_a_quarter_of_its_speed_is_named() {
    for (divisor, fault) in [(5, Some(FaultId::D2)), (3, None)] {
        let mut bench = Bench::moving_with(&geared(), 1000);
        bench.tamper = match divisor {
            5 => |i| i.drives[HELD].rpm /= 5,
            _ => |i| i.drives[HELD].rpm /= 3,
        };
        bench.run(19);
        assert_eq!(bench.fault(), None, "{divisor}");
        bench.run(2);
        assert_eq!(bench.fault(), fault, "{divisor}");
    }
}

#[test]
fn a_drive_that_gives_no_current_is_no_dead_motor_behind_a_gear() {
    // A speed says whether the motor lives; its current depends on the gear's friction.
    let mut bench = Bench::moving_with(&geared(), 1000);
    bench.tamper = |i| i.drives[HELD].current_ma = 0;
    bench.run(200);
    assert_eq!((bench.state(), bench.fault()), (State::Moving, None));
}
