//! Every detector fires at its bound and not a tick before; on the board: `watch_motion`.

use crate::support::{Bench, adc_of};
use mcdpr_firmware::adc::{RAIL_HIGH, RAIL_LOW};
use mcdpr_firmware::watch::{CableView, CableWatch, Persist};
use mcdpr_firmware::{Brake, Inputs, State};
use mcdpr_protocol::FaultId;

fn healthy(tick: u32) -> CableView {
    CableView {
        adc: 20_000 + (tick % 2) as u16,
        tension_mn: 10_000,
        expected_mn: 10_000,
        floor_mn: 500,
        ceiling_mn: 34_000,
        length_error_max: 10_000,
        feedback_timeout_ms: 10,
        ..CableView::default()
    }
}

/// Ticks of a condition until its fault, after a normal period; the first tick counts as 1.
fn ticks_until(change: impl Fn(&mut CableView)) -> (u32, FaultId, i32, i32) {
    let mut watch = CableWatch::default();
    for tick in 0..500 {
        assert_eq!(watch.update(&healthy(tick)), None, "healthy");
    }
    for tick in 1..=500 {
        let mut view = healthy(tick);
        change(&mut view);
        if let Some(found) = watch.update(&view) {
            return (tick, found.fault, found.value, found.limit);
        }
    }
    panic!("never");
}

#[test]
fn c1_slack_fires_after_20_ticks_and_c3_a_break_after_250() {
    // From 10 N at 100 N/s: under its floor of 0.5 N at tick 96.
    let mut watch = CableWatch::default();
    for tick in 0..300 {
        let view = CableView {
            tension_mn: 10_000 - 100 * tick as i32,
            ..healthy(tick)
        };
        if let Some(found) = watch.update(&view) {
            let seen = (found.fault, found.value, found.limit);
            assert_eq!((tick, seen), (95 + 20, (FaultId::C1, -1500, 500)));
            break;
        }
        assert!(tick < 200);
    }
    // From one tick to the next, and for good.
    assert_eq!(
        ticks_until(|v| v.tension_mn = 499),
        (250, FaultId::C3, 499, 500)
    );
}

/// A cable that falls slack from one tick to the next may be broken: the robot stops after ten ticks.
/// One that is tight again has slipped, or was pushed.
#[test]
fn c1_c3_a_cable_that_is_tight_again_was_slack_and_not_broken() {
    for slack_ticks in [1, 9, 10, 11, 100, 249] {
        let mut watch = CableWatch::default();
        for tick in 0..50 {
            assert_eq!(watch.update(&healthy(tick)), None);
        }
        for tick in 50..50 + slack_ticks {
            let view = CableView {
                tension_mn: 100,
                ..healthy(tick)
            };
            assert_eq!(watch.update(&view), None, "{slack_ticks}");
        }
        let found = watch.update(&healthy(50 + slack_ticks));
        let found = found.map(|found| (found.fault, found.limit));
        // Shorter than ten ticks it has stopped nothing.
        let is = (slack_ticks >= 10).then_some((FaultId::C1, 500));
        assert_eq!(found, is, "{slack_ticks}");
        assert_eq!(watch.update(&healthy(51 + slack_ticks)), None);
    }
}

#[test]
fn c3_the_robot_stops_ten_ticks_after_the_fall_and_the_name_follows() {
    let mut bench = Bench::moving(4000, 500);
    bench.tamper = |i| i.tension_adc[1] = adc_of(100) + i.encoders[0] % 5;
    bench.run(9);
    assert_eq!(bench.state(), State::Moving);
    bench.step();
    assert_eq!((bench.state(), bench.fault()), (State::Stopping, None));
    bench.run(239);
    assert_eq!(bench.fault(), None);
    bench.step();
    assert_eq!(bench.fault(), Some(FaultId::C3));
}

/// Other cables are unloaded by one that breaks: they are not the cause.
#[test]
fn c1_c3_a_cable_that_the_broken_one_unloads_is_not_reported() {
    let mut bench = Bench::moving(4000, 500);
    bench.tamper = |i| {
        i.tension_adc[1] = adc_of(100) + i.encoders[0] % 5;
        i.tension_adc[2] = adc_of(200) + i.encoders[0] % 5;
    };
    bench.run(100);
    assert_eq!(bench.fault(), None);
    bench.run(150);
    let record = bench.server.controller().fault().unwrap();
    assert_eq!((record.fault, record.cable), (FaultId::C3, 2));
}

/// A cable that breaks loads others: a rise after it is no snag. A rise that came with it may have broken it.
#[test]
fn c2_a_rise_that_begins_after_a_break_is_its_consequence_and_one_that_comes_with_it_is_not() {
    type Tamper = fn(&mut Inputs<4>);
    let falls: Tamper = |i| i.tension_adc[1] = adc_of(100) + i.encoders[0] % 5;
    let rises: Tamper = |i| {
        i.tension_adc[1] = adc_of(100) + i.encoders[0] % 5;
        i.tension_adc[2] = adc_of(16_000) + i.encoders[0] % 5;
    };
    let rises_more: Tamper = |i| {
        i.tension_adc[1] = adc_of(100) + i.encoders[0] % 5;
        i.tension_adc[2] = adc_of(23_000) + i.encoders[0] % 5;
    };
    for (ticks, fault) in [
        (&[rises, rises_more][..], Some(FaultId::C2)),
        // A tick apart counts as the same moment.
        (&[falls, rises, rises_more], Some(FaultId::C2)),
        (&[falls, falls, rises, rises_more], None),
        (&[falls, falls, falls, falls, rises, rises_more], None),
    ] {
        let mut bench = Bench::moving(4000, 500);
        for tamper in ticks {
            assert_eq!(bench.fault(), None);
            bench.tamper = *tamper;
            bench.step();
        }
        assert_eq!(bench.fault(), fault);
    }
}

#[test]
fn s4_a_drum_that_turns_against_its_motor_fires_at_the_second_comparison() {
    // 30 mm/s are 300 of 0.1 µm per tick; four counts are 1227.
    let mut watch = CableWatch::default();
    let mut at = 0;
    let view = |tick: u32, at: i32, sign: i32| CableView {
        motor_length: at,
        drum_length: sign * at,
        polarity_way: 1227,
        ..healthy(tick)
    };
    for tick in 0..100 {
        at += 300;
        assert_eq!(watch.update(&view(tick, at, 1)), None);
    }
    let (from, mut found) = (at, None);
    for tick in 1..=20 {
        at += 300;
        let drum = from - (at - from);
        let view = CableView {
            drum_length: drum,
            ..view(tick, at, 1)
        };
        if let Some(seen) = watch.update(&view) {
            found = Some((tick, seen.fault));
            break;
        }
    }
    let (tick, fault) = found.unwrap();
    assert_eq!(fault, FaultId::S4);
    assert!(tick <= 10, "{tick}");
}

#[test]
fn s4_a_tension_loop_that_makes_it_worse_fires_after_10_ticks() {
    let slackens = ticks_until(|v| {
        (v.by_tension, v.expected_mn) = (true, 10_000);
        (v.tension_mn, v.too_fast_umps) = (4900, 2001);
    });
    assert_eq!((slackens.0, slackens.1), (10, FaultId::S4));
    let tightens = ticks_until(|v| {
        (v.by_tension, v.expected_mn) = (true, 10_000);
        (v.tension_mn, v.too_fast_umps) = (15_100, -2001);
    });
    assert_eq!((tightens.0, tightens.1), (10, FaultId::S4));
}

#[test]
fn d6_a_hot_drive_fires_after_100_ticks() {
    assert_eq!(ticks_until(|v| v.hot = true), (100, FaultId::D6, 100, 100));
}

#[test]
fn s9_noise_is_advice() {
    let mut watch = CableWatch::default();
    let mut noise = |amplitude: i32| {
        for tick in 0..1000 {
            let view = CableView {
                tension_mn: 10_000 + if tick % 2 == 0 { amplitude } else { -amplitude },
                ..healthy(tick)
            };
            assert_eq!(watch.update(&view), None);
        }
        watch.is_noisy()
    };
    assert!(!noise(50));
    assert!(noise(500));
}

/// The ceiling is the cable's own: a constant of one robot would pass with one value.
#[test]
fn c2_over_tension_fires_after_2_ticks_whatever_the_ceiling_is() {
    for ceiling_mn in [5000, 12_000, 20_000, 34_000, 200_000] {
        let over = ticks_until(|v| {
            v.ceiling_mn = ceiling_mn;
            v.tension_mn = ceiling_mn + 1;
        });
        assert_eq!(over, (2, FaultId::C2, ceiling_mn + 1, ceiling_mn));
        let mut watch = CableWatch::default();
        for tick in 0..500 {
            let view = CableView {
                ceiling_mn,
                tension_mn: ceiling_mn,
                ..healthy(tick)
            };
            assert_eq!(watch.update(&view), None, "at {ceiling_mn}");
        }
    }
}

#[test]
fn s7_an_open_sensor_fires_after_5_ticks_and_is_no_over_tension() {
    let open = ticks_until(|v| {
        v.adc = RAIL_HIGH;
        v.tension_mn = 39_000;
    });
    assert_eq!((open.0, open.1), (5, FaultId::S7));
}

#[test]
fn s8_a_shorted_sensor_fires_after_5_ticks_and_is_no_slack() {
    let short = ticks_until(|v| {
        v.adc = RAIL_LOW;
        v.tension_mn = -2500;
    });
    assert_eq!((short.0, short.1), (5, FaultId::S8));
}

#[test]
fn s11_a_frozen_reading_fires_after_10_repetitions() {
    // The healthy reading of tick 499 is 20001: the first frozen one repeats it.
    assert_eq!(ticks_until(|v| v.adc = 20_001).0, 10);
    assert_eq!(ticks_until(|v| v.adc = 20_001).1, FaultId::S11);
}

/// Readings of a sensor with Gaussian noise of so many steps, rounded to whole conversions where
/// `coarse`; the longest run of one reading and whether S11 fired in so many ticks.
fn quiet_channel(sigma: f64, coarse: bool, seed: u64, ticks: u32) -> (u32, bool) {
    let mut rng = crate::support::Rng(seed);
    let mut watch = CableWatch::default();
    let (mut last, mut run, mut longest) = (0, 0, 0);
    let mut fired = false;
    for tick in 0..ticks {
        // The sum of twelve even ones is nearly Gaussian.
        let sum: f64 = (0..12).map(|_| rng.between(0, 1000) as f64 * 1e-3).sum();
        let step = if coarse { 16.0 } else { 1.0 };
        let adc = (((20_004.0 + (sum - 6.0) * sigma) / step).round() * step) as u16;
        run = if adc == last { run + 1 } else { 1 };
        (last, longest) = (adc, longest.max(run));
        if tick < 200 {
            watch.learn(adc);
            continue;
        }
        let view = CableView {
            adc,
            ..healthy(tick)
        };
        fired |= watch.update(&view).is_some();
    }
    (longest, fired)
}

#[test]
fn s11_a_quiet_channel_is_not_frozen() {
    for seed in 1..=20 {
        for (sigma, coarse) in [
            (0.25, false),
            (0.4, false),
            (1.0, false),
            (6.0, true),
            (4.0, true),
        ] {
            let (longest, fired) = quiet_channel(sigma, coarse, seed, 60_000);
            assert!(!fired, "seed {seed}, sigma {sigma}: {longest} alike");
        }
    }
    // They repeat themselves for longer than ten ticks, the former limit.
    assert!(quiet_channel(0.4, false, 1, 60_000).0 > 10);
    assert!(quiet_channel(4.0, true, 1, 60_000).0 > 30);
}

#[test]
fn d4_saturation_fires_after_100_ticks() {
    assert_eq!(
        ticks_until(|v| v.saturated = true),
        (100, FaultId::D4, 100, 100)
    );
}

#[test]
fn d4_while_a_motor_gives_all_it_can_the_path_takes_longer_and_its_end_is_reached() {
    let path_ms = |bench: &Bench| bench.status().path_ms;
    let mut bench = Bench::moving(2000, 500);
    let before = path_ms(&bench);
    bench.tamper = |i| i.drives[1].current_ma = 2950;
    bench.run(90);
    bench.tamper = |_| {};
    let way = path_ms(&bench) - before;
    // The rate falls by a 300th a tick: 90 - 90 * 90 / 600.
    assert!((74..=80).contains(&way), "{way} ms of path in 90");
    assert_eq!((bench.fault(), bench.state()), (None, State::Moving));
    bench.until(State::Holding, 2500);
    assert_eq!(bench.fault(), None);
    // In a hundred ticks it would have been a fault.
    let mut bench = Bench::moving(2000, 500);
    bench.tamper = |i| i.drives[1].current_ma = 2950;
    bench.run(101);
    assert_eq!(bench.fault(), Some(FaultId::D4));
}

#[test]
fn s2_and_d7_fire_after_20_ticks_beyond_a_millimetre_and_tell_encoder_from_drive() {
    let stuck = ticks_until(|v| v.length_error = -10_001);
    assert_eq!(stuck, (20, FaultId::S2, -1000, 1000));
    let dead = ticks_until(|v| {
        v.length_error = 10_001;
        v.motor_error = 5001;
    });
    assert_eq!((dead.0, dead.1), (20, FaultId::D7));
    let farthest = ticks_until(|v| {
        v.length_error = i32::MIN;
        v.motor_error = i32::MIN;
    });
    assert_eq!((farthest.0, farthest.1), (20, FaultId::D7));
}

#[test]
fn d2_a_motor_that_gives_under_a_quarter_of_its_current_fires_after_20_ticks() {
    let (given, reported) = (-99_i32, 400);
    let found = ticks_until(|v| (v.commanded, v.given) = (400, 99));
    assert_eq!(found, (20, FaultId::D2, given.abs(), reported / 4));
    let mut watch = CableWatch::default();
    for tick in 0..500 {
        // A current that changes its sign and is seen late passes through zero, but does not stay.
        let view = CableView {
            commanded: reported,
            given: if tick % 20 == 0 { 100 } else { 99 },
            ..healthy(tick)
        };
        assert_eq!(watch.update(&view), None, "{tick}");
    }
}

#[test]
fn d2_a_dead_motor_is_found_on_the_tension_held_cable_alone_and_its_brake_closes() {
    // The bench's motors give the commanded value; the fourth cable is held by its tension.
    for (drive, divisor, fault) in [(3, 5, Some(FaultId::D2)), (3, 3, None), (0, 5, None)] {
        let mut bench = Bench::moving(4000, 500);
        bench.tamper = match (drive, divisor) {
            (3, 5) => |i| i.drives[3].current_ma /= 5,
            (3, _) => |i| i.drives[3].current_ma /= 3,
            _ => |i| i.drives[0].current_ma /= 5,
        };
        bench.run(25);
        assert_eq!(bench.fault(), fault, "{drive} by {divisor}");
        let braked = [0, 1, 2, 3].map(|i| bench.outputs.brakes[i] == Brake::Closed);
        assert_eq!(braked, [false, false, false, fault.is_some()]);
    }
}

#[test]
fn d2_and_d3_fire_at_once() {
    assert_eq!(ticks_until(|v| v.drive_fault = true).0, 1);
    let lost = ticks_until(|v| v.feedback_age_ms = 10);
    assert_eq!(lost, (1, FaultId::D3, 10, 10));
    // A drive that reported its fault and fell silent: the fault is the cause.
    let both = ticks_until(|v| {
        v.drive_fault = true;
        v.feedback_age_ms = 10;
        // Nothing else is odd: this reading is no repetition.
        v.adc = 20_007;
    });
    assert_eq!((both.0, both.1), (1, FaultId::D2));
}

#[test]
fn at_its_limit_nothing_fires() {
    let mut watch = CableWatch::default();
    for tick in 0..1000 {
        let view = CableView {
            tension_mn: if tick < 500 { 500 } else { 34_000 },
            length_error: 10_000,
            motor_error: 10_000,
            feedback_age_ms: 9,
            ..healthy(tick)
        };
        assert_eq!(watch.update(&view), None);
    }
}

#[test]
fn a_gap_of_one_tick_starts_the_count_again() {
    let mut persist = Persist::default();
    for _ in 0..10 {
        for tick in 1..20 {
            assert!(!persist.update(true, 20), "{tick}");
        }
        assert!(!persist.update(false, 20));
    }
    let mut long = Persist::default();
    for _ in 0..70_000 {
        long.update(true, 100);
    }
    assert!(long.update(true, 100), "the counter saturates");
}
