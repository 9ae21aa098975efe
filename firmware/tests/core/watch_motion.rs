//! The detectors on a board in motion and at rest: what they stop, and in which tick.

use crate::support::{Bench, adc_of};
use mcdpr_firmware::{Brake, Inputs, State};
use mcdpr_protocol::FaultId;

/// Ticks from a manipulated input in motion to the latched fault, and the state of that tick.
fn ticks_in_motion(tamper: fn(&mut Inputs<4>)) -> (u32, FaultId, u8, State) {
    let mut bench = Bench::moving(4000, 500);
    assert_eq!(bench.fault(), None);
    bench.tamper = tamper;
    for tick in 1..=300 {
        bench.step();
        if let Some(record) = bench.server.controller().fault() {
            assert_eq!(record.tick, bench.now);
            return (tick, record.fault, record.cable, bench.state());
        }
    }
    panic!("never");
}

#[test]
fn detections_reach_every_axis_in_the_tick_of_their_bound() {
    let cases: [(fn(&mut Inputs<4>), u32, FaultId, u8); 6] = [
        (
            |i| i.tension_adc[1] = adc_of(100) + i.encoders[0] % 5,
            250,
            FaultId::C3,
            2,
        ),
        (
            |i| i.tension_adc[2] = adc_of(36_000) + i.encoders[0] % 5,
            2,
            FaultId::C2,
            3,
        ),
        (|i| i.tension_adc[3] = 65_520, 5, FaultId::S7, 4),
        (|i| i.tension_adc[0] = 0, 5, FaultId::S8, 1),
        (|i| i.drives[1].fault = true, 1, FaultId::D2, 2),
        (|i| i.drives[2].age_ms = 10, 1, FaultId::D3, 3),
    ];
    for (tamper, ticks, fault, cable) in cases {
        assert_eq!(
            ticks_in_motion(tamper),
            (ticks, fault, cable, State::Stopping)
        );
    }
}

#[test]
fn s11_a_frozen_sensor_stops_the_motion_ten_ticks_after_its_last_new_sample() {
    let (ticks, fault, cable, state) = ticks_in_motion(|i| i.tension_adc[1] = 20_123);
    // The first frozen sample is new; the next ten repeat it.
    assert_eq!(
        (ticks, fault, cable, state),
        (11, FaultId::S11, 2, State::Stopping)
    );
}

#[test]
fn s2_a_stuck_encoder_stops_within_20_ticks_of_a_millimetre_of_commanded_motion() {
    let (ticks, fault, cable, _) = ticks_in_motion(|i| i.encoders[0] = 0x1234);
    // At 20 mm/s a millimetre takes 50 ms; the jump to the stuck value is rejected twice.
    assert!(matches!(fault, FaultId::S2 | FaultId::S6), "{fault:?}");
    assert_eq!(cable, 1);
    assert!(ticks <= 70, "{ticks}");
}

#[test]
fn s6_an_encoder_that_jumps_three_times_stops_the_motion_and_its_reference_is_gone() {
    let mut bench = Bench::moving(4000, 500);
    bench.tamper = |i| i.encoders[2] = i.encoders[2].wrapping_add(20_000);
    bench.run(2);
    assert_eq!(bench.fault(), None);
    bench.step();
    assert_eq!(bench.fault(), Some(FaultId::S6));
    assert!(!bench.status().referenced, "lengths are guesses now");
}

#[test]
fn d3_a_lost_drives_brake_closes_at_once_and_stays_closed_when_the_drive_comes_back() {
    for tamper in [
        (|i: &mut Inputs<4>| i.drives[1].age_ms = 10) as fn(&mut Inputs<4>),
        |i| i.drives[1].fault = true,
    ] {
        let mut bench = Bench::moving(4000, 500);
        bench.tamper = tamper;
        let outputs = bench.step();
        assert_eq!(outputs.brakes[1], Brake::Closed);
        assert_eq!(
            outputs.brakes[0],
            Brake::Open,
            "the others decelerate first"
        );
        bench.tamper = |_| {};
        while bench.state() == State::Stopping {
            assert_eq!(bench.step().brakes[1], Brake::Closed);
        }
        assert_eq!(bench.state(), State::Fault);
    }
}

#[test]
fn p2_drives_that_all_fall_silent_have_lost_their_supply_and_every_brake_closes_at_once() {
    let mut bench = Bench::moving(4000, 500);
    // They are asked one after the other: their last answers are some ticks apart.
    bench.tamper = |i| {
        for (drive, age_ms) in i.drives.iter_mut().zip([7, 10, 9, 8]) {
            drive.age_ms = age_ms;
        }
    };
    let outputs = bench.step();
    let record = bench.server.controller().fault().unwrap();
    assert_eq!((record.fault, record.cable), (FaultId::P2, 0));
    assert_eq!(outputs.brakes, [Brake::Closed; 4]);
    // Three of four: these drives are lost, not their supply.
    let (ticks, fault, cable, state) = ticks_in_motion(|i| {
        for (drive, age_ms) in i.drives.iter_mut().zip([1, 10, 10, 10]) {
            drive.age_ms = age_ms;
        }
    });
    assert_eq!(
        (ticks, fault, cable, state),
        (1, FaultId::D3, 2, State::Stopping)
    );
}

#[test]
fn one_braked_axis_does_not_blind_the_watch_over_the_others() {
    let mut bench = Bench::moving(4000, 500);
    bench.tamper = |i| i.drives[1].age_ms = 10;
    bench.step();
    bench.tamper = |i| {
        i.drives[1].age_ms = 11;
        i.tension_adc[0] = adc_of(100);
    };
    bench.run(3);
    assert_eq!(bench.state(), State::Stopping);
    assert!(
        bench
            .status()
            .limits
            .contains(mcdpr_protocol::Limit::CableSlack)
    );
}

#[test]
fn s7_s8_a_rail_has_no_say_in_the_current_of_a_tension_held_cable() {
    let currents = |tamper: fn(&mut mcdpr_firmware::Inputs<4>)| {
        let mut bench = Bench::moving(4000, 500);
        let current = |bench: &Bench| match bench.outputs.drives[3] {
            mcdpr_firmware::DriveDemand::Current { ma } => ma,
            _ => 0,
        };
        let before = current(&bench);
        assert_ne!(before, 0);
        bench.tamper = tamper;
        let mut all = Vec::new();
        // Until its brake is tested, when the drive releases it on purpose.
        for _ in 0..450 {
            bench.step();
            all.push(current(&bench));
        }
        (before, all)
    };
    let short = currents(|i| i.tension_adc[3] = 0);
    let open = currents(|i| i.tension_adc[3] = 65_520);
    assert_eq!(short, open, "what cannot be true enters nowhere");
    // Only the plan may raise it: 2 kg from 20 mm/s in 300 ms are 0.13 N, the friction of 0.5 N
    // that the drum no longer overcomes is less; at 50 N/A about 12 mA.
    let most = short.0.abs() + 12;
    assert!(short.1.iter().all(|ma| ma.abs() <= most), "{short:?}");
}

#[test]
fn p5_one_late_tick_is_counted_and_two_in_a_row_stop() {
    let mut bench = Bench::moving(4000, 500);
    bench.tamper = |i| i.overrun = true;
    bench.step();
    assert_eq!(bench.fault(), None);
    bench.tamper = |_| {};
    bench.run(5);
    bench.tamper = |i| i.overrun = true;
    bench.run(2);
    assert_eq!(
        (bench.fault(), bench.state()),
        (Some(FaultId::P5), State::Stopping)
    );
    assert_eq!(bench.status().tick_overruns, 3);
    // Late ticks are counted in every state.
    let mut idle = Bench::ready();
    idle.tamper = |i| i.overrun = true;
    idle.run(4);
    assert_eq!(idle.status().tick_overruns, 4);
}

/// A motion at rest with one residual row: a quarter of a µm per mN of cable 2, limit 500 µm.
fn with_a_row() -> Bench {
    use mcdpr_protocol::{Coefficient, List, Micrometres, PerCable, Request, ResidualRow};
    let mut bench = Bench::holding();
    let at = bench.status().setpoints;
    let row = ResidualRow {
        lengths: PerCable::collect([0; 4].map(Coefficient)),
        tensions: PerCable::collect([0, 64, 0, 0].map(Coefficient)),
        limit: Micrometres(500),
    };
    for (index, time_ms) in [(0, 0), (1, 4000)] {
        let cables: Vec<_> = at.iter().map(|length| (length.0, 0)).collect();
        let mut knot = crate::support::knot(index, time_ms, index == 1, &cables);
        knot.rows = List::collect([row.clone()]);
        bench.request(Request::Knot(knot)).unwrap();
    }
    bench.request(Request::Start).unwrap();
    bench.run(50);
    bench
}

#[test]
fn s5_a_residual_row_over_its_limit_warns_at_once_and_stops_after_its_time() {
    // A quarter of a micrometre per mN on cable 2: 225 µm, 375 µm and 625 µm.
    let cases: [(fn(&mut Inputs<4>), bool, bool); 3] = [
        (|i| i.tension_adc[1] += 1400, false, false),
        (|i| i.tension_adc[1] += 2333, true, false),
        (|i| i.tension_adc[1] += 3888, true, true),
    ];
    for (tamper, warns, stops) in cases {
        let mut bench = with_a_row();
        assert_eq!(bench.fault(), None);
        bench.tamper = tamper;
        bench.step();
        let limits = bench.status().limits;
        assert_eq!(limits.contains(mcdpr_protocol::Limit::ResidualHigh), warns);
        bench.run(98);
        assert_eq!(bench.fault(), None);
        bench.step();
        let record = bench.server.controller().fault();
        let fault = record.map(|r| (r.fault, r.cable, r.limit));
        assert_eq!(fault, stops.then_some((FaultId::S5, 0, 500)));
        if let Some(record) = record {
            assert!((record.value - 625).abs() <= 2, "{} µm", record.value);
        }
    }
}

#[test]
fn s10_a_tension_off_its_expected_value_is_advice_in_motion_and_no_fault() {
    let mut bench = Bench::moving(4000, 500);
    let advised = |bench: &Bench| {
        bench
            .status()
            .limits
            .contains(mcdpr_protocol::Limit::TensionOff)
    };
    // Its brake stays closed: this bench's cable has no elasticity to restore its tension.
    bench.stuck[3] = true;
    bench.tension_mn = 12_900;
    bench.run(50);
    assert!(!advised(&bench));
    bench.tension_mn = 13_100;
    bench.run(50);
    assert!(advised(&bench));
    assert_eq!(bench.fault(), None);
}

/// Cable 4, held by its tension, at 0.3 N; it became slack slowly enough not to be a break.
fn slacken(bench: &mut Bench) -> Option<u32> {
    // The bench's cable does not stretch: its drum is at rest.
    bench.stuck[3] = true;
    bench.tension_mn = 5200;
    bench.run(50);
    assert_eq!(bench.fault(), None);
    bench.tamper = |i| i.tension_adc[3] = adc_of(300) + i.encoders[0] % 5 + i.tension_adc[0] % 3;
    (1..=2500).find(|_| {
        bench.step();
        bench.fault() == Some(FaultId::C1)
    })
}

#[test]
fn c1_a_slack_tension_held_cable_stops_a_motion_after_20_ticks_and_is_reeled_in_for_2_s_at_rest() {
    let mut bench = Bench::moving(4000, 500);
    assert_eq!(slacken(&mut bench), Some(20));
    assert_eq!(bench.state(), State::Stopping);
    let mut bench = Bench::holding();
    assert_eq!(slacken(&mut bench), Some(2000));
}
