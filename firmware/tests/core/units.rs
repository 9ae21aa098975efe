use crate::support::{Rng, adc_of, build, entries, entries_with};
use mcdpr_firmware::axis::{Axis, Target, motor_speed_umps};
use mcdpr_firmware::io::DriveInput;
use mcdpr_firmware::tension::measured_mn;
use mcdpr_protocol::{CableKey, ConfigKey};
use std::f64::consts::TAU;

#[test]
fn tension_follows_eq_52_with_the_papers_gain_and_zero() {
    let config = build(&entries()).unwrap().cables[0];
    for adc in 0..=65_520_u16 {
        let volts = f64::from(adc) / 65_536.0 * 3.3;
        let truth = 12.77 * (volts - 0.2355) * 1e3;
        let measured = f64::from(measured_mn(&config, adc));
        assert!(
            (measured - truth).abs() <= 0.51,
            "adc {adc}: {measured} {truth}"
        );
    }
    // Full scale is 39.13 N at 3.3 V; the last step reads 3.3 V less 16/65536 of it.
    assert_eq!(measured_mn(&config, 65_520), 39_123);
    assert_eq!(measured_mn(&config, adc_of(10_000)), 10_000);
}

#[test]
fn a_turn_of_the_drum_is_1520148_motor_counts() {
    let config = build(&entries()).unwrap().cables[0];
    let turn = (TAU * 200_000.0).round() as i32;
    let axis = Axis::zeroed(500, 1_000_000);
    let counts = |length: i32| {
        axis.counts(
            &config,
            &Target {
                length,
                ..Target::default()
            },
        )
    };
    assert!((counts(1_000_000 + turn) - 500 - 1_520_148).abs() <= 1);
    assert!((counts(1_000_000 - turn) - 500 + 1_520_148).abs() <= 1);
    assert_eq!(counts(1_000_000), 500);
}

#[test]
fn motor_counts_follow_eq_54_with_lead_over_the_whole_range() {
    let mut rng = Rng(9);
    for counts_per_turn in [1_520_148, -1_520_148, 110_592, -4096] {
        let key = ConfigKey::cable(0, CableKey::MotorCountsPerTurn);
        let config = build(&entries_with(key, counts_per_turn)).unwrap().cables[0];
        let axis = Axis::zeroed(-7000, 3_000_000);
        for _ in 0..5000 {
            let target = Target {
                length: 3_000_000 + rng.between(-20_000_000, 20_000_000) as i32,
                speed_umps: rng.between(-500_000, 500_000) as i32,
                acceleration_umps2: rng.between(-5_000_000, 5_000_000) as i32,
            };
            // x(t + lead) with lead = 8 ms, in 0.1 µm.
            let lead_s = 8e-3;
            let way = f64::from(target.length - 3_000_000)
                + 10.0 * f64::from(target.speed_umps) * lead_s
                + 5.0 * f64::from(target.acceleration_umps2) * lead_s * lead_s;
            let per_length = f64::from(counts_per_turn) / (TAU * 200_000.0);
            let truth = -7000.0 + way * per_length;
            let counts = f64::from(axis.counts(&config, &target));
            // Two roundings of 0.1 µm each, and one of a count.
            let allowed = 1.0 + 3.0 * per_length.abs();
            assert!(
                (counts - truth).abs() <= allowed,
                "{counts} {truth} {target:?}"
            );
        }
    }
}

/// A gear that turns the drum by a little more than its description says is no dead drive: the motor is compared with the
/// target by what its drum has shown.
#[test]
fn d7_how_far_a_motor_is_behind_counts_from_where_its_drum_is() {
    let config = build(&entries()).unwrap().cables[0];
    let most = f64::from(config.half_count);
    for off in [-4000, 0, 4000] {
        let mut axis = Axis::zeroed(0, 3_000_000);
        let target = Target {
            length: 3_000_000 + off,
            ..Target::default()
        };
        for _ in 0..5000 {
            axis.learn(&config, &target, 3_000_000, 3_000_000 + off);
        }
        for behind in [-20_000, -500, 0, 500, 20_000] {
            let target = Target {
                length: 3_000_000 + off + behind,
                ..Target::default()
            };
            let error = axis.motor_error(&target, 3_000_000);
            assert!(
                f64::from(error - behind).abs() <= most + 2.0,
                "{off} {behind}: {error}"
            );
        }
    }
}

#[test]
fn rpm_limits_and_motor_speeds_follow_the_gear() {
    for (counts_per_turn, per_rev) in [(1_520_148, 4096), (-110_592, 4096), (40_000, 4000)] {
        let mut all = entries_with(
            ConfigKey::cable(0, CableKey::MotorCountsPerTurn),
            counts_per_turn,
        );
        let key = ConfigKey::cable(0, CableKey::MotorCountsPerRev);
        all.iter_mut().find(|e| e.key == key).unwrap().value = per_rev;
        let config = build(&all).unwrap().cables[0];
        let ratio = f64::from(counts_per_turn) / f64::from(per_rev);
        let rpm_of = |mps: f64| mps / (TAU * 0.02) * ratio * 60.0;
        for speed_umps in [0, 100, -3000, 20_000, -30_000] {
            let target = Target {
                speed_umps,
                ..Target::default()
            };
            // A fifth of the largest speed to catch up with.
            let truth = rpm_of(f64::from(speed_umps) * 1e-6).abs() + 1600.0;
            let rpm = f64::from(Axis::rpm(&config, &target));
            assert!((rpm - truth.min(8000.0)).abs() <= 1.0, "{rpm} {truth}");
        }
        for rpm in [-8000_i16, -1, 0, 1, 777, 8000] {
            let drive = DriveInput {
                rpm,
                ..DriveInput::default()
            };
            let truth = f64::from(rpm) / 60.0 / ratio * TAU * 0.02 * 1e6;
            let speed = f64::from(motor_speed_umps(&config, &drive));
            assert!(
                (speed - truth).abs() <= 1.0 + truth.abs() * 2e-6,
                "{speed} {truth}"
            );
        }
    }
    let fastest = Target {
        speed_umps: 46_000,
        ..Target::default()
    };
    assert_eq!(
        Axis::rpm(&build(&entries()).unwrap().cables[0], &fastest),
        8000
    );
}
