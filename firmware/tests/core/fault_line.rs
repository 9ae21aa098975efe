//! L19: the fault line between the boards of a robot, as one of them tells and sees it.

use crate::support::{ARMING_MS, Bench, entries, entries_with, hash_of};
use mcdpr_firmware::{Brake, State};
use mcdpr_protocol::{
    BENCH_FAULT_LINE, BENCH_OUTPUT_MS, BenchTest, BoardKey, ConfigEntry, ConfigKey, FaultId, Limit,
    Reject, Request,
};

const KEY: ConfigKey = ConfigKey::board(BoardKey::FaultLine);
const PULL: Request = Request::Bench {
    test: BenchTest::Output {
        output: BENCH_FAULT_LINE,
    },
};
const REMAINS: Reject = Reject::CauseRemains {
    fault: FaultId::L19,
};

fn with_line() -> Vec<ConfigEntry> {
    entries_with(KEY, 1)
}

#[test]
fn l19_the_second_tick_of_a_low_line_stops_along_the_path() {
    let mut bench = Bench::moving_with(&with_line(), 500);
    bench.tamper = |inputs| inputs.fault_line_low = true;
    bench.step();
    assert_eq!(bench.state(), State::Moving);
    bench.step();
    assert_eq!(bench.state(), State::Stopping);
    assert_eq!(bench.fault(), Some(FaultId::L19));
    assert!(bench.all_brakes(Brake::Open), "along the path, not at once");
    assert!(bench.status().limits.contains(Limit::FaultLine));
    bench.until(State::Fault, 1500);
    assert!(bench.all_brakes(Brake::Closed));
}

#[test]
fn l19_single_low_samples_do_not_count() {
    let mut bench = Bench::moving_with(&with_line(), 500);
    for _ in 0..100 {
        bench.tamper = |inputs| inputs.fault_line_low = true;
        bench.step();
        bench.tamper = |_| {};
        bench.step();
    }
    assert_eq!((bench.state(), bench.fault()), (State::Moving, None));
}

#[test]
fn l19_a_board_without_the_line_ignores_its_pin() {
    let mut bench = Bench::ready_with(&entries());
    bench.tamper = |inputs| inputs.fault_line_low = true;
    bench.run(10);
    bench.arm_with(&entries()).unwrap();
    bench.until(State::Holding, ARMING_MS);
    assert!(!bench.status().limits.contains(Limit::FaultLine));
}

#[test]
fn l19_a_low_line_forbids_arming_and_a_fault_of_it_can_be_cleared_while_it_is_low() {
    let mut bench = Bench::ready_with(&with_line());
    bench.tamper = |inputs| inputs.fault_line_low = true;
    bench.run(2);
    assert_eq!(bench.arm_with(&with_line()), Err(REMAINS));
    assert_eq!((bench.state(), bench.fault()), (State::Disarmed, None));
    bench.tamper = |_| {};
    bench.step();
    bench.arm_with(&with_line()).unwrap();
    bench.tamper = |inputs| inputs.fault_line_low = true;
    bench.until(State::Fault, 1500);
    assert_eq!(bench.fault(), Some(FaultId::L19));
    // Boards of one robot hold the line low for each other: one must be able to begin.
    bench.request(Request::ClearFault).unwrap();
    bench.step();
    assert!(bench.outputs.well);
    assert_eq!(bench.arm_with(&with_line()), Err(REMAINS));
}

#[test]
fn a_bare_winch_is_worked_on_without_the_other_boards() {
    let mut bench = Bench::ready_with(&with_line());
    bench.tamper = |inputs| inputs.fault_line_low = true;
    bench.run(10);
    bench
        .request(Request::Service {
            config_hash: hash_of(&with_line()),
            cable: 2,
            open: true,
        })
        .unwrap();
    bench.until(State::Holding, ARMING_MS);
    assert_eq!(bench.fault(), None);
}

#[test]
fn a_board_is_well_from_its_first_tick_until_a_fault_is_latched() {
    let mut bench = Bench::new();
    assert!(!bench.outputs.well, "before its first tick");
    assert!(bench.step().well);
    let mut bench = Bench::moving_with(&with_line(), 500);
    assert!(bench.outputs.well);
    bench.stop(mcdpr_protocol::StopKind::Stop);
    bench.until(State::Disarmed, 1500);
    assert!(bench.outputs.well, "an ordered stop is no fault");
    let mut bench = Bench::moving_with(&with_line(), 500);
    bench.tamper = |inputs| inputs.drives[1].fault = true;
    assert!(!bench.step().well, "in the tick of the fault");
    bench.tamper = |_| {};
    bench.until(State::Fault, 1500);
    assert!(!bench.outputs.well);
    bench.request(Request::ClearFault).unwrap();
    assert!(bench.step().well);
}

#[test]
fn l10_a_board_that_pulls_the_line_itself_does_not_stop_by_it() {
    let mut bench = Bench::moving_with(&with_line(), 500);
    bench.beats = false;
    while bench.fault().is_none() {
        bench.step();
    }
    assert!(!bench.outputs.well);
    bench.tamper = |inputs| inputs.fault_line_low = true;
    bench.run(500);
    assert_eq!(bench.state(), State::Holding);
    assert_eq!(bench.fault(), Some(FaultId::L10));
}

#[test]
fn a_disarmed_board_lets_go_of_the_line_on_request_and_for_a_while() {
    let mut bench = Bench::ready_with(&with_line());
    bench.request(PULL).unwrap();
    for _ in 0..BENCH_OUTPUT_MS {
        assert!(!bench.step().well);
        assert!(bench.all_brakes(Brake::Closed) && !bench.any_torque());
    }
    assert!(bench.step().well);
    // Arming ends it, and other outputs need a board without a configuration.
    bench.request(PULL).unwrap();
    bench.step();
    bench.arm_with(&with_line()).unwrap();
    assert!(bench.step().well);
    let state = State::Arming;
    assert_eq!(bench.request(PULL), Err(Reject::WrongState { state }));
    let mut bench = Bench::ready_with(&with_line());
    for output in 1..BENCH_FAULT_LINE {
        let test = BenchTest::Output { output };
        let refused = bench.request(Request::Bench { test });
        assert_eq!(refused, Err(Reject::Configured), "{output}");
    }
}

#[test]
fn f2_the_line_is_there_or_not() {
    for value in [-1, 2] {
        let refused = crate::support::build(&entries_with(KEY, value)).unwrap_err();
        assert_eq!(refused, Reject::ConfigValue { key: KEY.0 });
    }
}
