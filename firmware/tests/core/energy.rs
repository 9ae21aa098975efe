//! Over-tension is countered before it is reached, and faults behind closed brakes are detected.

use crate::support::{BRAKE_MS, Bench, CABLES, adc_of, build, entries_with};
use mcdpr_firmware::adc::RAIL_HIGH;
use mcdpr_firmware::watch::{CableView, CableWatch};
use mcdpr_firmware::{Brake, Inputs, State};
use mcdpr_protocol::{CableKey, ConfigKey, FaultId, Reject, Request, StopKind};

/// A cable at 10 N whose tension then rises by this much per tick up to the rail; returns the
/// tension in mN at which C2 is found, or the other fault.
fn rising(step_mn: i32, horizon_us: i32) -> (FaultId, i32) {
    let mut watch = CableWatch::default();
    let mut tension_mn = 10_000;
    for tick in 0..2000 {
        if tick >= 200 {
            tension_mn = (tension_mn + step_mn).min(39_000);
        }
        let open = tension_mn >= 38_700;
        let view = CableView {
            adc: if open { RAIL_HIGH } else { 20_000 + tick % 2 },
            tension_mn,
            expected_mn: 10_000,
            floor_mn: 500,
            ceiling_mn: 34_000,
            horizon_us,
            length_error_max: 10_000,
            feedback_timeout_ms: 10,
            ..CableView::default()
        };
        if let Some(found) = watch.update(&view) {
            return (found.fault, tension_mn);
        }
    }
    panic!("never");
}

#[test]
fn c2_is_found_before_the_ceiling_by_as_much_as_the_drum_needs_to_stop() {
    // Slowly: at the ceiling, in its second tick.
    let (fault, at_mn) = rising(20, 20_000);
    assert_eq!(fault, FaultId::C2);
    assert!((33_000..=34_100).contains(&at_mn), "{at_mn}");
    // 1 N a tick and 20 ms to stop: 20 N before, and a tick or two until the rate of rise is known.
    let (fault, at_mn) = rising(1000, 20_000);
    assert_eq!(fault, FaultId::C2);
    assert!((15_000..=17_000).contains(&at_mn), "{at_mn}");
    // Half the time to stop, or half the rate: 10 N before.
    for (step_mn, horizon_us) in [(1000, 10_000), (500, 20_000)] {
        let (fault, at_mn) = rising(step_mn, horizon_us);
        assert_eq!(fault, FaultId::C2);
        assert!((24_000..=26_000).contains(&at_mn), "{at_mn}");
    }
    // A smaller deviation from the plan gives no information: 3 N, and the second tick above it.
    assert_eq!(rising(1000, 40_000), (FaultId::C2, 15_000));
}

/// All tensions rise by 0.1 N a tick. The cable with the lowest ceiling is named, before it gets there.
#[test]
fn c2_each_cable_of_a_board_has_its_own_ceiling() {
    for index in 0..CABLES as u8 {
        for ceiling_mn in [15_000, 18_000] {
            let key = ConfigKey::cable(index, CableKey::TensionCeiling);
            let mut bench = Bench::holding_with(&entries_with(key, ceiling_mn));
            // The tension-held drum would give way.
            bench.stuck[3] = true;
            while bench.fault().is_none() {
                bench.tension_mn += 100;
                assert!(bench.tension_mn <= ceiling_mn, "{}", bench.tension_mn);
                bench.step();
            }
            let record = bench.server.controller().fault().unwrap();
            assert_eq!((record.fault, record.cable), (FaultId::C2, index + 1));
            assert_eq!(record.limit, ceiling_mn);
            assert!(bench.tension_mn > ceiling_mn - 3000, "{}", bench.tension_mn);
        }
    }
}

#[test]
fn c2_a_steep_rise_into_the_rail_is_no_open_sensor() {
    for step_mn in [3000, 6000, 9000, 12_000] {
        let (fault, _) = rising(step_mn, 8000);
        assert_eq!(fault, FaultId::C2, "{step_mn} mN a tick");
    }
    // A plug that comes off jumps.
    assert_eq!(rising(30_000, 8000).0, FaultId::S7);
}

#[test]
fn c2_a_ceiling_above_nine_tenths_of_the_rail_is_refused() {
    for index in 0..CABLES as u8 {
        let key = ConfigKey::cable(index, CableKey::TensionCeiling);
        // 38.72 N at the rail.
        assert!(build(&entries_with(key, 34_850)).is_ok());
        let refused = build(&entries_with(key, 34_860)).unwrap_err();
        assert_eq!(refused, Reject::ConfigValue { key: key.0 });
    }
}

#[test]
fn c2_ends_the_path_at_once_and_reels_nothing_in() {
    let mut bench = Bench::moving(4000, 500);
    bench.tamper = |i| i.tension_adc[2] = adc_of(36_000) + i.tension_adc[0] % 7;
    let mut last = None;
    for tick in 1..=400 {
        bench.step();
        if bench.state() != State::Stopping {
            assert!(tick <= 2, "tick {tick}: {:?}", bench.state());
            continue;
        }
        assert_eq!(bench.fault(), Some(FaultId::C2));
        let now = bench.status().setpoints;
        if let Some(last) = last.replace(now.clone()) {
            for (cable, (now, last)) in now.iter().zip(last.iter()).enumerate().take(3) {
                let cable = cable + 1;
                assert!(now.0 >= last.0, "cable {cable} reels in: {last:?} {now:?}");
                let out = now.0 - last.0;
                assert_eq!(out > 0, cable == 3, "cable {cable} goes {out}");
            }
        }
        assert!(
            bench.all_brakes(Brake::Open),
            "pulled, and braked in tick {tick}"
        );
        if tick == 300 {
            break;
        }
    }
    // It is free: brakes close.
    bench.tamper = |_| {};
    bench.until(State::Fault, 800);
    assert!(bench.all_brakes(Brake::Closed));
}

/// How fast the third cable is let out at these tensions after C2, 0.1 µm per tick.
fn let_out(ceiling_mn: i32, tampers: &[fn(&mut Inputs<CABLES>)]) -> Vec<f64> {
    let key = ConfigKey::cable(2, CableKey::TensionCeiling);
    let speed = |tamper: &fn(&mut Inputs<CABLES>)| {
        let mut bench = Bench::moving_with(&entries_with(key, ceiling_mn), 500);
        bench.tamper = |i| i.tension_adc[2] = adc_of(35_000) + i.tension_adc[0] % 7;
        bench.run(3);
        assert_eq!(bench.fault(), Some(FaultId::C2));
        bench.tamper = *tamper;
        bench.run(20);
        let before = bench.status().setpoints[2].0;
        bench.run(20);
        f64::from(bench.status().setpoints[2].0 - before) / 20.0
    };
    tampers.iter().map(speed).collect()
}

#[test]
fn c2_a_cable_is_let_out_the_faster_the_further_it_is_above_three_quarters_of_its_ceiling() {
    let speeds = let_out(
        34_000,
        &[
            |i| i.tension_adc[2] = adc_of(25_000) + i.tension_adc[0] % 7,
            |i| i.tension_adc[2] = adc_of(26_500) + i.tension_adc[0] % 7,
            |i| i.tension_adc[2] = adc_of(27_500) + i.tension_adc[0] % 7,
        ],
    );
    assert!(speeds[0] == 0.0 && speeds[1] > 1.0, "{speeds:?}");
    // 2.5 mm/s for a newton.
    assert!((22.5..28.0).contains(&speeds[1]), "{speeds:?}");
    assert!((speeds[2] / speeds[1] - 2.0).abs() < 0.2, "{speeds:?}");
}

#[test]
fn c2_a_cable_whose_plan_is_above_three_quarters_of_its_ceiling_is_let_out_to_its_plan() {
    // The plan is 10 N, three quarters are 9 N.
    let speeds = let_out(
        12_000,
        &[
            |i| i.tension_adc[2] = adc_of(9500) + i.tension_adc[0] % 7,
            |i| i.tension_adc[2] = adc_of(11_000) + i.tension_adc[0] % 7,
        ],
    );
    assert!(speeds[0] == 0.0 && speeds[1] > 1.0, "{speeds:?}");
}

/// Parked after a motion's worth of torque; longer than drums take to rest.
fn parked() -> Bench {
    let mut bench = Bench::holding();
    bench.request(Request::Disarm).unwrap();
    bench.until(State::Disarmed, 1000);
    bench.run(BRAKE_MS + 60);
    bench
}

#[test]
fn b2_a_drum_that_turns_while_parked_is_latched_and_nothing_switches_on() {
    for index in 0..CABLES {
        let mut bench = parked();
        // An encoder count is 371 motor counts: half a one a tick.
        for tick in 1..=20 {
            bench.motor[index] += 186;
            bench.step();
            assert!(tick > 15 || bench.fault().is_none(), "tick {tick}");
        }
        let record = bench.server.controller().fault().unwrap();
        let cable = index as u8 + 1;
        assert_eq!((record.fault, record.cable), (FaultId::B2, cable));
        assert_eq!(bench.state(), State::Fault);
        for _ in 0..2000 {
            bench.step();
            assert!(!bench.any_torque() && bench.all_brakes(Brake::Closed));
        }
        assert!(bench.arm().is_err());
        // Acknowledged: the drum is at rest in its new position.
        bench.request(Request::ClearFault).unwrap();
        bench.run(500);
        assert_eq!(bench.fault(), None);
    }
}

#[test]
fn s7_s8_s11_c2_are_latched_while_parked() {
    let cases: [(fn(&mut Inputs<4>), FaultId, u8, u32); 4] = [
        (|i| i.tension_adc[0] = 65_520, FaultId::S7, 1, 5),
        (|i| i.tension_adc[3] = 0, FaultId::S8, 4, 5),
        (|i| i.tension_adc[1] = 20_123, FaultId::S11, 2, 11),
        (
            |i| i.tension_adc[2] = adc_of(36_000) + i.tension_adc[0] % 7,
            FaultId::C2,
            3,
            2,
        ),
    ];
    for (tamper, fault, cable, ticks) in cases {
        let mut bench = parked();
        bench.tamper = tamper;
        bench.run(ticks - 1);
        assert_eq!(bench.fault(), None, "{fault:?}");
        bench.step();
        let record = bench.server.controller().fault().unwrap();
        assert_eq!((record.fault, record.cable), (fault, cable));
        assert!(!bench.any_torque());
    }
}

/// Somebody pushes the parked platform, or shakes its frame: a stiff cable falls slack from one tick to
/// the next and is tight again. A cable that broke stays slack.
#[test]
fn c3_a_parked_platform_that_is_pushed_has_no_broken_cable() {
    let mut bench = parked();
    for _ in 0..5 {
        bench.tamper = |i| i.tension_adc[1] = adc_of(100) + i.tension_adc[0] % 7;
        bench.run(120);
        bench.tamper = |_| {};
        bench.run(120);
        assert_eq!((bench.fault(), bench.state()), (None, State::Disarmed));
    }
    bench.tamper = |i| i.tension_adc[1] = adc_of(100) + i.tension_adc[0] % 7;
    bench.run(249);
    assert_eq!(bench.fault(), None);
    bench.step();
    let record = bench.server.controller().fault().unwrap();
    assert_eq!((record.fault, record.cable), (FaultId::C3, 2));
    assert!(!bench.any_torque());
}

#[test]
fn a_robot_that_never_hung_on_its_drives_may_be_handled_before_it_arms() {
    let mut bench = Bench::ready();
    bench.tamper = |i| i.tension_adc[0] = 65_520;
    bench.run(1000);
    assert_eq!(bench.fault(), None);
    // Nor does one whose lengths were set anew.
    let mut bench = parked();
    bench.reference();
    for _ in 0..200 {
        bench.motor[1] += 186;
        bench.step();
    }
    assert_eq!(bench.fault(), None);
}

#[test]
fn s7_s11_c3_d3_are_latched_while_brakes_close() {
    let cases: [(fn(&mut Inputs<4>), FaultId, u8); 4] = [
        (|i| i.tension_adc[0] = 65_520, FaultId::S7, 1),
        (|i| i.tension_adc[1] = 20_123, FaultId::S11, 2),
        (
            |i| i.tension_adc[2] = adc_of(0) + i.encoders[0] % 5 + (i.tension_adc[0] % 3),
            FaultId::C3,
            3,
        ),
        (|i| i.drives[3].age_ms = 10, FaultId::D3, 4),
    ];
    for (tamper, fault, cable) in cases {
        let mut bench = Bench::moving(1500, 1400);
        bench.stop(StopKind::Stop);
        while bench.all_brakes(Brake::Open) {
            bench.step();
        }
        assert_eq!(bench.fault(), None);
        bench.tamper = tamper;
        // A cable that may be broken has its name 250 ms after its fall.
        bench.run(if fault == FaultId::C3 { 250 } else { 12 });
        let record = bench.server.controller().fault();
        let record = record.unwrap_or_else(|| panic!("{fault:?}: nothing"));
        assert_eq!((record.fault, record.cable), (fault, cable));
        assert!(bench.all_brakes(Brake::Closed));
        bench.until(State::Fault, 1000);
    }
}
