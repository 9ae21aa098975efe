//! Brakes: tested at arming against torque and by a motion, and before torque is switched off.

use crate::support::{BRAKE_MS, Bench, CABLES, PROOF_MS};
use mcdpr_firmware::{Brake, DriveDemand, Inputs, State};
use mcdpr_protocol::{FaultId, Limit, Request, StopKind};

/// Arms; returns the fault, its cable, and whether all brakes were ever open.
fn arm(mut bench: Bench) -> (Option<FaultId>, u8, bool) {
    bench.arm().unwrap();
    let mut opened = false;
    for _ in 0..3000 {
        bench.step();
        opened |= bench.all_brakes(Brake::Open);
        if !matches!(bench.state(), State::Arming | State::Stopping) {
            break;
        }
    }
    let record = bench.server.controller().fault();
    let cable = record.map_or(0, |record| record.cable);
    (record.map(|record| record.fault), cable, opened)
}

#[test]
fn b2_a_brake_that_slips_under_a_push_aborts_arming_and_no_brake_opens() {
    for index in 0..CABLES {
        let mut bench = Bench::ready();
        bench.weak[index] = true;
        let cable = index as u8 + 1;
        assert_eq!(arm(bench), (Some(FaultId::B2), cable, false));
    }
}

#[test]
fn b1_a_brake_that_stays_closed_aborts_arming_within_500_ticks_of_opening() {
    for index in 0..CABLES {
        let mut bench = Bench::ready();
        bench.stuck[index] = true;
        let cable = index as u8 + 1;
        assert_eq!(arm(bench), (Some(FaultId::B1), cable, true));
    }
}

const REVERSED: [fn(&mut Inputs<4>); 4] = [
    |i| i.encoders[0] = i.encoders[0].wrapping_neg(),
    |i| i.encoders[1] = i.encoders[1].wrapping_neg(),
    |i| i.encoders[2] = i.encoders[2].wrapping_neg(),
    |i| i.encoders[3] = i.encoders[3].wrapping_neg(),
];

/// A board whose encoder `index` counts the other way. The swap exists before the lengths are set.
fn reversed(index: usize) -> Bench {
    let mut bench = Bench::ready();
    bench.tamper = REVERSED[index];
    bench.run(5);
    bench.reference();
    bench
}

#[test]
fn s4_a_reversed_encoder_aborts_arming() {
    for index in 0..CABLES {
        let cable = index as u8 + 1;
        assert_eq!(arm(reversed(index)), (Some(FaultId::S4), cable, true));
    }
}

#[test]
fn s4_a_reversed_winch_gives_no_torque_at_once_and_the_others_hold_until_the_brakes_have_closed() {
    for index in 0..CABLES {
        let mut bench = reversed(index);
        bench.arm().unwrap();
        let mut outputs = bench.step();
        while bench.state() == State::Arming {
            outputs = bench.step();
        }
        assert_eq!(bench.fault(), Some(FaultId::S4));
        let mut held_ms = 0;
        while bench.state() == State::Stopping {
            for cable in 0..CABLES {
                let off = outputs.drives[cable] == DriveDemand::Off;
                assert_eq!(off, cable == index, "cable {cable} after {held_ms} ms");
            }
            assert_eq!(outputs.brakes[index], Brake::Closed);
            held_ms += 1;
            outputs = bench.step();
        }
        assert!(held_ms > BRAKE_MS, "{held_ms} ms");
        assert_eq!(bench.state(), State::Fault);
        assert!(
            outputs
                .drives
                .iter()
                .all(|drive| *drive == DriveDemand::Off)
        );
        // Mended, cleared and armed again, it works as before.
        bench.tamper = |_| {};
        bench.run(5);
        bench.request(Request::ClearFault).unwrap();
        bench.reference();
        bench.arm().unwrap();
        bench.until(State::Holding, 3000);
        assert_ne!(bench.step().drives[index], DriveDemand::Off);
        assert_eq!(bench.step().brakes[index], Brake::Open);
    }
}

#[test]
fn s2_an_encoder_that_is_dead_at_arming_is_distinguished_from_a_brake_that_is_stuck() {
    let mut bench = Bench::ready();
    bench.tamper = |i| i.encoders[1] = 7;
    bench.run(5);
    bench.reference();
    assert_eq!(arm(bench), (Some(FaultId::S2), 2, true));
}

#[test]
fn b2_torque_stays_on_for_as_long_as_a_brake_does_not_hold() {
    for index in 0..CABLES {
        let mut bench = Bench::holding();
        bench.weak[index] = true;
        let before = bench.status().lengths;
        bench.request(Request::Disarm).unwrap();
        for tick in 0..5000 {
            bench.step();
            let state = bench.state();
            let stands = matches!(state, State::Stopping | State::Holding);
            let fault = bench.server.controller().fault();
            assert!(
                stands,
                "cable {}: {state:?} in tick {tick}, {fault:?}",
                index + 1
            );
            let torque = bench.outputs.drives.iter().all(|d| d.gives_torque());
            assert!(torque && bench.all_brakes(Brake::Closed), "tick {tick}");
        }
        // Every push is taken back: there is no creep. A tension-held drum has no fixed position.
        assert_eq!(bench.state(), State::Holding);
        let after = bench.status().lengths;
        for (cable, (before, after)) in before.iter().zip(after.iter()).enumerate().take(3) {
            assert!(
                (before.0 - after.0).abs() < 320,
                "cable {}: {before:?} {after:?}",
                cable + 1
            );
        }
        let record = bench.server.controller().fault().unwrap();
        assert_eq!(
            (record.fault, usize::from(record.cable)),
            (FaultId::B2, index + 1)
        );
        assert!(bench.status().limits.contains(Limit::BrakeSlips));
        // What remains to be done: clear it and lower the platform by a motion, or hold the load by
        // other means; and switch off.
        bench.request(Request::ClearFault).unwrap();
        bench.buffer(500, true);
        bench.request(Request::Start).unwrap();
        bench.until(State::Moving, 5);
        bench.run(BRAKE_MS + 10);
        assert!(bench.all_brakes(Brake::Open));
        bench.until(State::Holding, 700);
        bench.stop(StopKind::Emergency);
        bench.step();
        assert!(!bench.any_torque());
        assert_eq!(bench.state(), State::Fault);
    }
}

#[test]
fn b3_a_brake_that_closes_late_keeps_torque_until_it_holds_and_is_reported() {
    let mut bench = Bench::holding();
    bench.weak[0] = true;
    bench.request(Request::Disarm).unwrap();
    bench.run(BRAKE_MS + 150 + 300);
    assert_eq!((bench.state(), bench.fault()), (State::Stopping, None));
    assert!(bench.any_torque());
    bench.weak[0] = false;
    bench.until(State::Fault, 50 + 2 * PROOF_MS + 60);
    assert_eq!(bench.fault(), Some(FaultId::B3));
    assert!(!bench.any_torque());
}

#[test]
fn p1_p3_p4_a_board_that_starts_after_a_crash_is_in_fault_until_it_is_cleared() {
    for cause in [FaultId::P1, FaultId::P3, FaultId::P4] {
        let mut bench = Bench::new();
        bench.server.start_in_fault(cause);
        bench.step();
        bench.open();
        assert_eq!((bench.state(), bench.fault()), (State::Fault, Some(cause)));
        bench.configure(&crate::support::entries());
        bench.reference();
        assert!(bench.arm().is_err());
        assert!(!bench.any_torque() && bench.all_brakes(Brake::Closed));
        bench.request(Request::ClearFault).unwrap();
        bench.arm().unwrap();
        bench.until(State::Holding, 3000);
    }
}

#[test]
fn d1_bus_off_is_stop0_in_the_same_tick() {
    let mut bench = Bench::moving(4000, 500);
    bench.tamper = |i| {
        for drive in &mut i.drives {
            drive.bus_off = true;
        }
    };
    bench.step();
    assert_eq!(
        (bench.state(), bench.fault()),
        (State::Fault, Some(FaultId::D1))
    );
    assert!(bench.all_brakes(Brake::Closed) && !bench.any_torque());
}

#[test]
fn l18_errors_on_the_line_stop_the_robot_at_150_per_second_and_not_at_40() {
    let ticks = |every: u32| {
        let mut bench = Bench::moving(4000, 500);
        // One error in every so many ticks; the encoder's count has no fixed timing, the dither has.
        for tick in 1..=2000 {
            bench.line_errors = u16::from(tick % every == 0);
            bench.step();
            if bench.state() == State::Stopping {
                return Some((tick, bench.fault()));
            }
        }
        assert_eq!(bench.fault(), None);
        None
    };
    let (tick, fault) = ticks(6).unwrap();
    assert_eq!(fault, Some(FaultId::L18));
    assert!(tick <= 100, "{tick}");
    assert_eq!(ticks(25), None);
}

#[test]
fn c2_c1_in_a_stop_a_tight_cable_is_let_out_and_a_slack_one_taken_up_slowly_and_not_far() {
    let way = |adc_n: i32| {
        let mut bench = Bench::moving(4000, 500);
        bench.stop(StopKind::Stop);
        bench.step();
        let (slack, tight): (fn(&mut Inputs<4>), fn(&mut Inputs<4>)) = (
            |i| i.tension_adc[1] = crate::support::adc_of(100) + i.tension_adc[0] % 7,
            |i| i.tension_adc[1] = crate::support::adc_of(36_000) + i.tension_adc[0] % 7,
        );
        bench.tamper = if adc_n > 0 { tight } else { slack };
        let gap = |bench: &Bench| {
            let at = bench.status().setpoints;
            at[1].0 - at[0].0
        };
        let (before, mut last) = (gap(&bench), gap(&bench));
        while bench.all_brakes(Brake::Open) {
            bench.step();
            // 20 mm/s in; out as fast as a cable may move, from the drum's position by its encoder.
            let most = if adc_n > 0 { 460 + 310 } else { 200 };
            let step = (gap(&bench) - last).abs();
            assert!(step <= most, "{step} in a tick");
            last = gap(&bench);
        }
        last - before
    };
    let (tight, slack) = (way(1), way(-1));
    assert!((99_000..=101_500).contains(&tight), "{tight}");
    assert!((-100_000..=-20_000).contains(&slack), "{slack}");
}

#[test]
fn c1_in_a_stop_from_rest_a_slack_cable_is_taken_up_as_slowly() {
    let mut bench = Bench::holding();
    bench.stop(StopKind::Stop);
    bench.tamper = |i| i.tension_adc[1] = crate::support::adc_of(100) + i.tension_adc[0] % 7;
    let at = |bench: &Bench| bench.status().setpoints[1].0;
    let before = at(&bench);
    let (mut last, mut taken) = (before, 0);
    for _ in 0..400 {
        if !bench.all_brakes(Brake::Open) {
            break;
        }
        bench.step();
        let step = last - at(&bench);
        // 20 mm/s, and never out again.
        assert!((0..=200).contains(&step), "{step} in a tick");
        last = at(&bench);
        taken = before - last;
    }
    // The stop ends after 300 ms: 6 mm of the 10 mm at most.
    assert!((20_000..=100_000).contains(&taken), "{taken}");
    assert!(!bench.all_brakes(Brake::Open));
}
