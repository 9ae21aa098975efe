use crate::support::{BRAKE_MS, Bench, STOP_MS, adc_of, entries_with, hash_of, is_proof};
use mcdpr_firmware::{Brake, DriveDemand, State};
use mcdpr_protocol::{BoardKey, ConfigKey, FaultId, Reject, Reply, Request, StopKind, Tick};

/// From a stop on: ticks until brakes close, and ticks of torque under closed brakes.
fn stop_sequence(bench: &mut Bench) -> (u32, u32) {
    let (mut moving, mut held) = (0, 0);
    for _ in 0..2000 {
        bench.step();
        if bench.state() != State::Stopping {
            break;
        }
        if bench.all_brakes(Brake::Open) {
            assert_eq!(held, 0, "brakes never open again");
            moving += 1;
        } else {
            assert!(bench.all_brakes(Brake::Closed));
            assert!(
                bench
                    .outputs
                    .drives
                    .iter()
                    .all(|drive| drive.gives_torque())
            );
            held += 1;
        }
    }
    (moving, held)
}

#[test]
fn stop1_decelerates_closes_brakes_under_torque_holds_it_150_ms_longer_and_lets_go() {
    let mut bench = Bench::moving(4000, 500);
    bench.stop(StopKind::Stop);
    let (moving, held) = stop_sequence(&mut bench);
    assert!((STOP_MS - 2..=STOP_MS).contains(&moving), "{moving}");
    assert!(is_proof(held - BRAKE_MS - 150), "{held}");
    assert_eq!(bench.state(), State::Disarmed);
    assert!(bench.all_brakes(Brake::Closed));
    assert!(
        bench
            .outputs
            .drives
            .iter()
            .all(|drive| *drive == DriveDemand::Off)
    );
}

#[test]
fn disarm_from_holding_closes_the_brakes_at_once_and_ends_disarmed() {
    let mut bench = Bench::holding();
    assert_eq!(bench.request(Request::Disarm), Ok(Reply::Done));
    let (moving, held) = stop_sequence(&mut bench);
    assert_eq!(moving, 0);
    assert!(is_proof(held - BRAKE_MS - 150), "{held}");
    assert_eq!((bench.state(), bench.fault()), (State::Disarmed, None));
}

#[test]
fn c1_brakes_wait_for_a_cable_that_is_not_tight_yet_but_no_longer_than_a_stop_lasts() {
    // From rest, and the second cable never recovers.
    let mut bench = Bench::holding();
    bench.tamper = |i| i.tension_adc[1] = adc_of(100) + i.tension_adc[0] % 7;
    bench.stop(StopKind::Stop);
    let (waits, _) = stop_sequence(&mut bench);
    assert_eq!(waits, STOP_MS - 1);
    // It recovers in between.
    let mut bench = Bench::holding();
    bench.tamper = |i| i.tension_adc[1] = adc_of(100) + i.tension_adc[0] % 7;
    bench.stop(StopKind::Stop);
    bench.run(100);
    assert!(bench.all_brakes(Brake::Open));
    bench.tamper = |_| {};
    bench.run(1);
    assert!(bench.all_brakes(Brake::Closed));
}

#[test]
fn brakes_that_hold_a_standing_robot_do_not_open_for_a_stop() {
    let mut bench = Bench::at(Tick(0));
    bench.step();
    bench.open();
    let key = ConfigKey::board(BoardKey::HoldBrakes);
    let entries = entries_with(key, 1);
    bench.configure(&entries);
    bench.reference();
    let hash = hash_of(&entries);
    bench.request(Request::Arm { config_hash: hash }).unwrap();
    bench.until(State::Holding, 2000);
    bench.run(2);
    assert!(bench.all_brakes(Brake::Closed));
    bench.tamper = |i| i.tension_adc[1] = adc_of(100) + i.tension_adc[0] % 7;
    bench.stop(StopKind::Stop);
    assert_eq!(stop_sequence(&mut bench).0, 0);
}

#[test]
fn stop0_closes_brakes_and_drops_torque_in_the_next_tick() {
    for mut bench in [Bench::holding(), Bench::moving(4000, 500)] {
        bench.stop(StopKind::Emergency);
        bench.step();
        assert!(bench.all_brakes(Brake::Closed));
        assert!(!bench.any_torque());
        assert_eq!(bench.state(), State::Fault);
    }
}

#[test]
fn p7_the_emergency_stop_acts_in_its_tick_in_every_phase_and_needs_a_release_and_a_clear() {
    let mut arming = Bench::ready();
    arming.arm().unwrap();
    arming.run(60);
    let mut stopping = Bench::moving(4000, 500);
    stopping.stop(StopKind::Stop);
    stopping.run(20);
    let pausing = {
        let mut bench = Bench::moving(4000, 500);
        bench.stop(StopKind::Hold);
        bench.run(20);
        bench
    };
    for mut bench in [
        Bench::ready(),
        arming,
        Bench::holding(),
        Bench::moving(4000, 500),
        pausing,
        stopping,
    ] {
        bench.e_stop = true;
        // One sample, or two, may be a disturbance.
        bench.run(3);
        assert_eq!(
            (bench.state(), bench.fault()),
            (State::EStop, Some(FaultId::P7))
        );
        assert!(bench.all_brakes(Brake::Closed));
        assert!(!bench.any_torque());
        assert_eq!(
            bench.request(Request::ClearFault),
            Err(Reject::WrongState {
                state: State::EStop
            })
        );
        assert_eq!(
            bench.arm(),
            Err(Reject::WrongState {
                state: State::EStop
            })
        );
        bench.run(100);
        bench.e_stop = false;
        bench.run(100);
        assert_eq!(bench.state(), State::Fault, "released is not cleared");
        assert_eq!(bench.request(Request::ClearFault), Ok(Reply::Done));
        assert_eq!((bench.state(), bench.fault()), (State::Disarmed, None));
        bench.arm().unwrap();
        bench.until(State::Holding, crate::support::ARMING_MS);
    }
}

#[test]
fn a_hold_rests_on_the_path_and_a_resume_ends_where_the_motion_ends() {
    let mut straight = Bench::moving(2000, 0);
    straight.until(State::Holding, 4000);
    let mut bench = Bench::moving(2000, 700);
    bench.stop(StopKind::Hold);
    let ticks = bench.until(State::Holding, crate::support::ARMING_MS);
    assert!(ticks <= STOP_MS, "{ticks}");
    let rest = bench.status().setpoints;
    bench.run(500);
    assert_eq!(bench.status().setpoints, rest);
    assert!(bench.all_brakes(Brake::Open) && bench.any_torque());
    assert_eq!(bench.request(Request::Resume), Ok(Reply::Done));
    bench.until(State::Holding, 4000);
    assert_eq!(bench.status().setpoints, straight.status().setpoints);
}

#[test]
fn k6_a_buffer_that_runs_empty_holds_with_its_fault_and_takes_a_new_motion_after_the_clear() {
    let mut bench = Bench::holding();
    bench.buffer(1000, false);
    bench.request(Request::Start).unwrap();
    bench.run(999);
    assert_eq!((bench.state(), bench.fault()), (State::Moving, None));
    bench.step();
    assert_eq!(
        (bench.state(), bench.fault()),
        (State::Pausing, Some(FaultId::K6))
    );
    let ticks = bench.until(State::Holding, crate::support::ARMING_MS);
    assert!(ticks <= STOP_MS + 1, "{ticks}");
    assert!(
        bench.all_brakes(Brake::Open) && bench.any_torque(),
        "it holds under tension"
    );
    assert_eq!(bench.request(Request::ClearFault), Ok(Reply::Done));
    assert_eq!(bench.request(Request::Resume), Err(Reject::NothingToStart));
    assert_eq!(bench.status().next_knot, 0);
    bench.buffer(1000, true);
    assert_eq!(bench.request(Request::Start), Ok(Reply::Done));
    bench.until(State::Holding, 2000);
    assert_eq!(bench.fault(), None);
}

#[test]
fn k6_a_stop_during_the_stop_segment_still_ends_with_brakes_and_no_torque() {
    for wait in [1, 100, 299] {
        let mut bench = Bench::holding();
        bench.buffer(1000, false);
        bench.request(Request::Start).unwrap();
        bench.run(1000 + wait);
        bench.stop(StopKind::Stop);
        let (moving, held) = stop_sequence(&mut bench);
        assert!(moving <= STOP_MS + 1 - wait, "{moving} after {wait}");
        assert!(is_proof(held - BRAKE_MS - 150), "{held}");
        assert_eq!(bench.state(), State::Fault);
    }
}

#[test]
fn k10_a_stop_in_the_same_tick_wins_over_arm_start_and_resume_in_either_order() {
    let mut bench = Bench::ready();
    bench.arm().unwrap();
    bench.stop(StopKind::Stop);
    for _ in 0..500 {
        bench.step();
        assert!(bench.all_brakes(Brake::Closed) && !bench.any_torque());
    }
    assert_eq!(bench.state(), State::Disarmed);

    let mut bench = Bench::ready();
    bench.stop(StopKind::Stop);
    assert_eq!(
        bench.arm(),
        Err(Reject::WrongState {
            state: State::Disarmed
        })
    );
    bench.run(1);
    assert_eq!(bench.state(), State::Disarmed);
    assert_eq!(
        bench.arm(),
        Ok(Reply::Done),
        "a tick later it is a new wish"
    );

    let mut bench = Bench::holding();
    bench.buffer(1000, true);
    bench.stop(StopKind::Hold);
    assert!(bench.request(Request::Start).is_err());
    bench.run(5);
    assert_eq!(bench.state(), State::Holding);
    bench.request(Request::Start).unwrap();
    bench.stop(StopKind::Stop);
    bench.run(1000);
    assert_eq!(bench.state(), State::Disarmed);
}

#[test]
fn the_first_cause_stays_latched_with_its_tick() {
    let mut bench = Bench::moving(4000, 500);
    bench.tamper = |i| i.drives[2].age_ms = 50;
    bench.step();
    let first = bench.server.controller().fault().unwrap();
    assert_eq!(
        (first.fault, first.cable, first.tick),
        (FaultId::D3, 3, bench.now)
    );
    assert_eq!((first.value, first.limit), (50, 10));
    bench.e_stop = true;
    bench.run(50);
    assert_eq!(bench.server.controller().fault(), Some(first));
}

/// A tension-held cable that was slack is needed in a stop: its set-point returns at 100 N/s, and in a motion at 20.
#[test]
fn c1_a_stop_takes_up_a_cable_that_was_slack_five_times_as_fast_as_a_motion() {
    let rise_ma = |stops: bool| {
        let mut bench = Bench::moving(4000, 500);
        // The drum stands, so that the current shows the law's set-point.
        bench.stuck[3] = true;
        // Too slowly for a break, too shortly for C1.
        while bench.tension_mn > -1000 {
            bench.tension_mn -= 1000;
            bench.step();
        }
        bench.run(10);
        bench.tension_mn = 10_000;
        if stops {
            bench.stop(StopKind::Stop);
        }
        bench.run(20);
        let before = bench.current_ma(3);
        bench.run(50);
        let expected = if stops {
            State::Stopping
        } else {
            State::Moving
        };
        assert_eq!((bench.state(), bench.fault()), (expected, None));
        // Reeling in is negative.
        i32::from(before - bench.current_ma(3))
    };
    // 50 N/A: 1 N are 20 mA. Of the plan's friction and damping 1.5 N go with the stop.
    let (moving, stopping) = (rise_ma(false), rise_ma(true));
    assert!((10..50).contains(&moving), "{moving} mA");
    assert!(stopping > 100, "{stopping} mA");
}
