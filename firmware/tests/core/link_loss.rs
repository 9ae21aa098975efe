//! The one timeline of a lost link: 20 ms warn, 100 ms decelerate, hold two seconds, brakes, off.

use crate::support::{BRAKE_MS, Bench, STOP_MS, is_proof};
use mcdpr_firmware::watch::{Heartbeat, LinkHealth};
use mcdpr_firmware::{Brake, State};
use mcdpr_protocol::{FaultId, Limit, Reject, Reply, Request, Tick};

#[test]
fn l9_l10_the_timeline_changes_at_20_100_and_2100_ms_exactly() {
    for first in [
        Tick(0),
        Tick(12_345),
        Tick(u32::MAX - 10),
        Tick(u32::MAX - 2050),
    ] {
        let mut heartbeat = Heartbeat::default();
        assert_eq!(
            heartbeat.health(first),
            LinkHealth::Expired,
            "there never was one"
        );
        heartbeat.beat(first);
        for age in 0..5000 {
            let truth = match age {
                0..20 => LinkHealth::Good,
                20..100 => LinkHealth::Late,
                100..2100 => LinkHealth::Lost,
                _ => LinkHealth::Expired,
            };
            assert_eq!(
                heartbeat.health(first.after(age)),
                truth,
                "{age} ms after {first:?}"
            );
        }
    }
}

#[test]
fn k9_a_silent_link_is_still_silent_when_the_counter_has_gone_half_around() {
    let mut bench = Bench::ready();
    bench.beats = false;
    bench.run(2200);
    // The board continues for 25 days; only the counter matters to the core.
    bench.now = bench.now.after(1 << 31);
    bench.run(2);
    assert_eq!(
        bench.server.controller().link_health(bench.now),
        LinkHealth::Expired
    );
    bench.session = mcdpr_protocol::SessionId(99);
    assert_eq!(
        bench.request(Request::Open),
        Ok(Reply::Done),
        "a new host is let in"
    );
}

/// Runs from the last heartbeat in a motion that is buffered for long: returns the ages of each
/// reaction.
fn timeline(mut bench: Bench) -> (u32, u32, u32, u32, u32) {
    bench.beats = false;
    let (mut warned, mut pausing, mut holding, mut braked, mut off) = (0, 0, 0, 0, 0);
    for age in 1..4000 {
        let before = bench.state();
        bench.step();
        let once = |slot: &mut u32, now: bool| {
            if now && *slot == 0 {
                *slot = age;
            }
        };
        once(
            &mut warned,
            bench.status().limits.contains(Limit::HeartbeatLate),
        );
        once(&mut pausing, bench.state() == State::Pausing);
        once(&mut holding, bench.state() == State::Holding);
        once(&mut braked, bench.all_brakes(Brake::Closed));
        once(&mut off, !bench.any_torque());
        if before != bench.state() {
            assert_ne!(bench.state(), State::Disarmed, "the fault is latched");
        }
        if bench.all_brakes(Brake::Closed) && off == 0 {
            assert!(bench.any_torque());
        }
    }
    assert_eq!(bench.state(), State::Fault);
    assert_eq!(bench.fault(), Some(FaultId::L10));
    (warned, pausing, holding, braked, off)
}

#[test]
fn l10_l12_l15_a_moving_robot_decelerates_holds_closes_its_brakes_and_lets_go() {
    let (warned, pausing, holding, braked, off) = timeline(Bench::moving(4000, 500));
    assert_eq!((warned, pausing), (20, 100));
    assert!(
        (100 + STOP_MS - 2..=100 + STOP_MS).contains(&holding),
        "{holding}"
    );
    assert_eq!(braked, 2100);
    assert!(is_proof(off - 2100 - BRAKE_MS - 150), "{off}");
}

#[test]
fn k9_the_timeline_is_the_same_across_the_wrap_of_the_tick_counter() {
    let truth = timeline(Bench::moving(4000, 500));
    // Bring-up takes about 1000 ticks: the wrap falls into each phase in turn.
    for before_wrap in [1200, 1700, 1850, 2500, 3800, 4000] {
        let mut bench = Bench::holding_at(Tick(0_u32.wrapping_sub(before_wrap)));
        bench.buffer(4000, true);
        bench.request(Request::Start).unwrap();
        bench.run(500);
        assert_eq!(bench.fault(), None);
        assert_eq!(
            timeline(bench),
            truth,
            "{before_wrap} ticks before the wrap"
        );
    }
}

#[test]
fn l9_a_gap_under_100_ms_leaves_the_motion_alone() {
    let mut bench = Bench::moving(4000, 500);
    for _ in 0..5 {
        bench.beats = false;
        bench.run(98);
        bench.beats = true;
        bench.run(3);
        assert_eq!((bench.state(), bench.fault()), (State::Moving, None));
    }
}

#[test]
fn l10_a_host_that_returns_while_the_robot_holds_clears_and_goes_on_along_the_path() {
    let mut bench = Bench::moving(4000, 500);
    bench.beats = false;
    bench.until(State::Holding, crate::support::ARMING_MS);
    assert_eq!(
        bench.request(Request::ClearFault),
        Err(Reject::CauseRemains {
            fault: FaultId::L10
        })
    );
    bench.beats = true;
    bench.run(1);
    assert!(matches!(
        bench.request(Request::Resume),
        Err(Reject::Faulted { .. })
    ));
    assert_eq!(bench.request(Request::ClearFault), Ok(Reply::Done));
    assert_eq!(bench.request(Request::Resume), Ok(Reply::Done));
    let end = bench.status().setpoints[0].0;
    bench.until(State::Holding, 6000);
    assert!(
        bench.status().setpoints[0].0 > end + 500_000,
        "it went on to the end"
    );
    assert_eq!(bench.fault(), None);
}

#[test]
fn l10_while_arming_the_board_stops_with_its_brakes_closed() {
    let mut bench = Bench::ready();
    bench.enable_ticks = [400; 4];
    bench.arm().unwrap();
    bench.beats = false;
    for _ in 0..1000 {
        bench.step();
        assert!(bench.all_brakes(Brake::Closed));
        assert!(!bench.any_torque());
    }
    assert_eq!(
        (bench.state(), bench.fault()),
        (State::Fault, Some(FaultId::L10))
    );
}
