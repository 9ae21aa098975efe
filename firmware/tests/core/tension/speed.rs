//! The law with a speed as its output.

use super::{DEFAULT, PAPER, speed_config};
use mcdpr_firmware::CableConfig;
use mcdpr_firmware::tension::{Demand, TensionLoop};

#[test]
fn eq_1_with_a_speed_as_output_is_eq_1() {
    // Filter and derivative by hand: alpha = w / (1 + w), w = 2 pi 0.03.
    let config = speed_config(&PAPER);
    let mut law = TensionLoop::at(10_000);
    let demand = Demand {
        setpoint_mn: 10_000,
        measured_mn: 9_900,
        // It does not use the plan.
        planned_speed_umps: 5_000,
        ..Demand::default()
    };
    let alpha = 0.188_50 / 1.188_50;
    let fall_n = 0.1 * alpha;
    // Kp e + Kd de/dt, with de/dt a thousand times the fall of a millisecond; it reels in.
    let expected_mmps = 2.5 * fall_n + 0.04 * fall_n * 1000.0;
    let speed = law.update_speed(&config, &demand);
    assert!(
        (f64::from(-speed) - expected_mmps * 1e3).abs() < 3.0,
        "{speed} of {expected_mmps} mm/s"
    );
    assert_eq!(law.hold(), 0, "no current is commanded");
}

#[test]
fn a_drum_at_rest_is_left_alone_within_its_band_and_only_there() {
    let config = speed_config(&DEFAULT);
    let mut law = TensionLoop::at(10_000);
    let mut demand = Demand {
        setpoint_mn: 10_000,
        measured_mn: 10_010,
        ..Demand::default()
    };
    for _ in 0..500 {
        law.update_speed(&config, &demand);
    }
    assert_eq!(law.update_speed(&config, &demand), 0);
    // 40 mN more do not start it, 100 mN do, and it pays out.
    demand.measured_mn = 10_040;
    let still = (0..500).all(|_| law.update_speed(&config, &demand) == 0);
    assert!(still);
    demand.measured_mn = 10_100;
    let last = (0..500).map(|_| law.update_speed(&config, &demand)).last();
    assert!(last.is_some_and(|speed| speed > 0), "{last:?}");
    // With a plan the drum follows it, however small the error.
    demand.measured_mn = 10_000;
    demand.planned_speed_umps = -2_000;
    for _ in 0..500 {
        law.update_speed(&config, &demand);
    }
    let speed = law.update_speed(&config, &demand);
    assert!((speed + 2_000).abs() < 200, "{speed}");
}

#[test]
fn a_shorter_cable_gets_less_gain_and_a_longer_one_no_more() {
    // Given at 0.45 m: 2^40 over 4,500,000.
    let config = CableConfig {
        gain_per_length_q40: 244_336,
        ..speed_config(&DEFAULT)
    };
    let speed_at = |length_m: f64| {
        let mut law = TensionLoop::at(10_000);
        let demand = Demand {
            setpoint_mn: 10_000,
            measured_mn: 12_000,
            length: (length_m * 1e7) as i32,
            ..Demand::default()
        };
        f64::from(law.update_speed(&config, &demand))
    };
    let full = speed_at(0.45);
    assert!(full > 0.0);
    for (length_m, share) in [(0.3, 2.0 / 3.0), (0.225, 0.5), (0.9, 1.0), (0.0, 0.125)] {
        let got = speed_at(length_m) / full;
        assert!((got - share).abs() < 1e-3, "{length_m} m: {got}");
    }
}

#[test]
fn whole_turns_per_minute_add_up_to_the_speed() {
    let config = speed_config(&DEFAULT);
    let mut law = TensionLoop::at(10_000);
    // 8000 rpm are 45.15 mm/s: 0.1772 rpm per um/s. 10 um/s are 1.77 rpm.
    let exact = f64::from(MOTOR_RPM_PER_UMPS) * 10.0;
    let sum: i32 = (0..1000).map(|_| i32::from(law.rpm(&config, 10))).sum();
    assert!((f64::from(sum) - exact * 1000.0).abs() < 2.0, "{sum}");
    assert_eq!(law.rpm(&config, 0), 0);
}

/// 1,520,148 counts a drum turn of 125.66 mm, 4096 a motor turn, 60 s a minute.
const MOTOR_RPM_PER_UMPS: f32 = 0.177_2;

#[test]
fn a_drum_that_accelerates_is_led_by_half_of_its_drives_lag() {
    let mut config = speed_config(&DEFAULT);
    config.lead_us = 6_000;
    let mut law = TensionLoop::at(10_000);
    let mut speed_at = |planned_acceleration_umps2| {
        let demand = Demand {
            setpoint_mn: 10_000,
            measured_mn: 10_000,
            planned_speed_umps: 20_000,
            planned_acceleration_umps2,
            ..Demand::default()
        };
        law.update_speed(&config, &demand)
    };
    // 1 m/s2 times 3 ms are 3 mm/s, within 5 %.
    for (acceleration, expected_umps) in [(0, 20_000), (1_000_000, 23_000), (-1_000_000, 17_000)] {
        let speed_umps = speed_at(acceleration);
        assert!(
            (speed_umps - expected_umps).abs() < 200,
            "{speed_umps} of {expected_umps}"
        );
    }
}
