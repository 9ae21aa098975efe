//! K8: every request in every state. A refusal leaves everything as it was, to the last output.

use crate::support::{Bench, CABLES, entries, entries_with, hash_of, knot};
use mcdpr_firmware::State;
use mcdpr_protocol::{
    CableKey, ConfigHash, ConfigKey, FaultId, List, PerCable, Reject, Request, StopKind,
    TenthMicrometres,
};

const STATES: [State; 9] = [
    State::Boot,
    State::Disarmed,
    State::Arming,
    State::Holding,
    State::Moving,
    State::Pausing,
    State::Stopping,
    State::Fault,
    State::EStop,
];

/// A board in the state, with a half-sent configuration, and a motion if one is possible.
fn bench_in(state: State) -> Bench {
    let mut bench = Bench::ready();
    bench.request(Request::ConfigBegin { entries: 5 }).unwrap();
    bench.request(put(0)).unwrap();
    match state {
        State::Boot => {
            bench = Bench::new();
            bench.open();
        }
        State::Disarmed => {}
        State::Arming => {
            bench.arm().unwrap();
            bench.run(3);
        }
        State::Holding | State::Moving | State::Pausing | State::Stopping => {
            bench.arm().unwrap();
            bench.until(State::Holding, crate::support::ARMING_MS);
            bench.buffer(4000, false);
            if state != State::Holding {
                bench.request(Request::Start).unwrap();
                bench.run(500);
            }
            if state == State::Pausing {
                bench.stop(StopKind::Hold);
            } else if state == State::Stopping {
                bench.stop(StopKind::Stop);
            }
            bench.run(10);
        }
        State::Fault => {
            bench.arm().unwrap();
            bench.until(State::Holding, crate::support::ARMING_MS);
            bench.tamper = |i| i.drives[0].fault = true;
            bench.until(State::Fault, 1000);
            bench.tamper = |_| {};
        }
        State::EStop => {
            bench.e_stop = true;
            bench.run(4);
        }
    }
    assert_eq!(bench.state(), state);
    bench
}

fn put(at: usize) -> Request {
    Request::ConfigPut {
        entries: List::collect([entries()[at]]),
    }
}

/// Every kind of request, built so that only the state decides; and the states that accept it.
fn requests(bench: &Bench) -> Vec<(Request, &'static [State])> {
    use State::{Arming, Disarmed, EStop, Fault, Holding, Moving, Pausing};
    let status = bench.status();
    let at: Vec<_> = status.setpoints.iter().map(|length| length.0).collect();
    let next = knot(
        status.next_knot,
        if status.next_knot == 0 { 0 } else { 4100 },
        false,
        &at.iter()
            .map(|length| {
                if status.next_knot == 0 {
                    (*length, 0)
                } else {
                    (8_780_000 + 20_000, 20_000)
                }
            })
            .collect::<Vec<_>>(),
    );
    let unarmed: &[State] = &[Disarmed, Fault];
    vec![
        (Request::Info, &STATES),
        (Request::Status, &STATES),
        (Request::Heartbeat { host_time_us: 1 }, &STATES),
        (Request::Stop(StopKind::Hold), &STATES),
        (Request::Stop(StopKind::Stop), &STATES),
        (Request::Stop(StopKind::Emergency), &STATES),
        (
            Request::Gripper { closed: true },
            &[Disarmed, Holding, Moving, Pausing],
        ),
        (Request::Samples { enabled: true }, &STATES),
        (Request::Close, &[Disarmed, Fault, EStop]),
        (Request::ConfigBegin { entries: 9 }, unarmed),
        (put(1), unarmed),
        // Never complete here: refused everywhere.
        (
            Request::ConfigCommit {
                hash: ConfigHash(1),
            },
            &[],
        ),
        (Bench::reference_request(), unarmed),
        (Bench::arm_request(), &[Disarmed]),
        (
            Request::Service {
                config_hash: crate::support::hash_of(&entries()),
                cable: 1,
                open: true,
            },
            &[Disarmed],
        ),
        (Request::Winch { cable: 1 }, &STATES),
        (Request::Kept, &STATES),
        (Request::Scan { restart: true }, unarmed),
        (Request::Disarm, &[Arming, Holding, Disarmed]),
        (Request::Knot(next), &[Holding, Moving, Pausing]),
        (Request::Start, &[Holding]),
        // Nothing was held here; see the test of a hold.
        (Request::Resume, &[]),
        (Request::Discard, &[Disarmed, Holding, Fault]),
        (Request::ClearFault, &[Disarmed, Holding, Fault]),
    ]
}

#[test]
fn k8_every_state_takes_exactly_its_requests_and_a_refusal_changes_nothing() {
    let mut refused = 0;
    for state in STATES {
        let bench = bench_in(state);
        for (request, states) in requests(&bench) {
            let (mut asked, mut other) = (bench.clone(), bench.clone());
            let before = asked.status();
            let result = asked.request(request.clone());
            let taken = states.contains(&state);
            assert_eq!(
                result.is_ok(),
                taken,
                "{request:?} in {state:?}: {result:?}"
            );
            if taken {
                continue;
            }
            refused += 1;
            assert_eq!(asked.status(), before, "{request:?} in {state:?}");
            // And it continues exactly as a board that never got the request.
            for _ in 0..400 {
                assert_eq!(asked.step(), other.step(), "{request:?} in {state:?}");
                assert_eq!(asked.status(), other.status(), "{request:?} in {state:?}");
            }
        }
    }
    assert!(refused > 80, "{refused}");
}

#[test]
fn k8_a_refusal_for_the_state_names_the_state() {
    for (state, request) in [
        (State::Disarmed, Request::Start),
        (State::Moving, Bench::arm_request()),
        (State::Moving, Request::Discard),
        (State::Fault, Bench::arm_request()),
        (State::EStop, Request::ClearFault),
        (State::Boot, Request::Disarm),
    ] {
        let mut bench = bench_in(state);
        assert_eq!(bench.request(request), Err(Reject::WrongState { state }));
    }
}

/// A refused knot; the motion continues without it.
fn refuse(change: fn(&mut mcdpr_protocol::Knot)) -> Reject {
    let mut bench = bench_in(State::Moving);
    let mut next = knot(3, 4100, false, &[(8_800_000, 20_000); CABLES]);
    assert!(bench.clone().request(Request::Knot(next.clone())).is_ok());
    change(&mut next);
    let before = bench.status();
    let reject = bench.request(Request::Knot(next)).unwrap_err();
    assert_eq!(bench.status(), before);
    reject
}

#[test]
fn k3_l2_values_out_of_range_are_refused_with_their_cable() {
    assert_eq!(
        refuse(|k| k.cables[1].length = TenthMicrometres(-1)),
        Reject::KnotLength { cable: 2 }
    );
    assert_eq!(
        refuse(|k| k.cables[1].length = TenthMicrometres(i32::MAX)),
        Reject::KnotLength { cable: 2 }
    );
    assert_eq!(
        refuse(|k| k.cables[2].velocity.0 = 46_001),
        Reject::KnotSpeed { cable: 3 }
    );
    assert_eq!(
        refuse(|k| k.cables[2].velocity.0 = i32::MIN),
        Reject::KnotSpeed { cable: 3 }
    );
    assert_eq!(
        refuse(|k| k.cables[3].tension.0 = -1),
        Reject::KnotTension { cable: 4 }
    );
    assert_eq!(
        refuse(|k| k.cables[3].tension.0 = 35_001),
        Reject::KnotTension { cable: 4 }
    );
    // Slow at both knots, too fast in between.
    assert_eq!(
        refuse(|k| k.cables[0].length.0 += 30_000),
        Reject::KnotSpeed { cable: 1 }
    );
    assert_eq!(refuse(|k| k.last = true), Reject::KnotEnd);
}

#[test]
fn k3_a_segment_that_accelerates_too_much_or_too_abruptly_is_refused_with_its_cable() {
    use CableKey::{MaxAcceleration, MaxJerk};
    // From rest to 20 mm/s within 100 ms, on the half of that way: 0.2 m/s² all along.
    let evenly = (10_000, 20_000);
    let too_much = Some(Reject::KnotAcceleration { cable: 2 });
    assert_eq!(limited(MaxAcceleration, 200_000, evenly), None);
    assert_eq!(limited(MaxAcceleration, 199_999, evenly), too_much);
    assert_eq!(limited(MaxJerk, 1, evenly), None);
    // Back where it was: -0.4 m/s² at its start, 0.8 m/s² at its end.
    for back in [(0, 20_000), (0, -20_000)] {
        assert_eq!(limited(MaxAcceleration, 800_000, back), None);
        assert_eq!(limited(MaxAcceleration, 799_999, back), too_much);
        let too_abrupt = Some(Reject::KnotJerk { cable: 2 });
        assert_eq!(limited(MaxJerk, 12_000, back), None);
        assert_eq!(limited(MaxJerk, 11_999, back), too_abrupt);
    }
    // Most at the start: it slows down over 100 ms from there.
    let ahead = (10_000, 0);
    assert_eq!(limited(MaxAcceleration, 600_000, ahead), None);
    assert_eq!(limited(MaxAcceleration, 599_999, ahead), too_much);
}

/// The refusal of a motion from rest to here (0.1 µm, µm/s) within 100 ms by a board that has this
/// limit for its second cable.
fn limited(key: CableKey, limit: i32, (way, velocity): (i32, i32)) -> Option<Reject> {
    let mut bench = Bench::ready();
    let entries = entries_with(ConfigKey::cable(1, key), limit);
    let config_hash = hash_of(&entries);
    bench.configure(&entries);
    bench.reference();
    bench.request(Request::Arm { config_hash }).unwrap();
    bench.until(State::Holding, 2000);
    let at = bench.status().setpoints;
    let cables = |way: i32, velocity: i32| -> Vec<(i32, i32)> {
        at.iter().map(|at| (at.0 + way, velocity)).collect()
    };
    let first = knot(0, 0, false, &cables(0, 0));
    bench.request(Request::Knot(first)).unwrap();
    let next = knot(1, 100, false, &cables(way, velocity));
    bench.request(Request::Knot(next)).err()
}

#[test]
fn k5_times_that_run_backwards_overlap_lie_in_the_past_or_too_far_ahead_are_refused() {
    let early = Reject::KnotTime { earliest_ms: 4004 };
    assert_eq!(refuse(|k| k.time_ms = 4000), early);
    assert_eq!(refuse(|k| k.time_ms = 3999), early);
    assert_eq!(refuse(|k| k.time_ms = 0), early);
    assert_eq!(refuse(|k| k.time_ms = 4003), early);
    assert_eq!(refuse(|k| k.time_ms = 8001), early);
    assert_eq!(refuse(|k| k.time_ms = u32::MAX), early);
    assert_eq!(refuse(|k| k.index = 2), Reject::KnotIndex { expected: 3 });
    assert_eq!(refuse(|k| k.index = 4), Reject::KnotIndex { expected: 3 });
}

#[test]
fn a_knot_for_another_number_of_cables_is_refused() {
    let count = Reject::CableCount {
        expected: 4,
        got: 3,
    };
    assert_eq!(
        refuse(|k| k.cables = PerCable::collect(k.cables.iter().copied().take(3))),
        count
    );
    let rows = refuse(|k| {
        let mut row = mcdpr_protocol::ResidualRow::default();
        let three = [mcdpr_protocol::Coefficient(1); 3];
        row.lengths = PerCable::collect(three);
        row.tensions = PerCable::collect(three);
        k.rows = List::collect([row]);
    });
    assert_eq!(rows, count);
}

#[test]
fn k4_a_motion_that_does_not_start_where_the_robot_is_is_refused_with_its_gap() {
    let mut bench = Bench::holding();
    let at = bench.status().setpoints;
    let start = |gap: i32, velocity: i32| {
        let mut cables: Vec<_> = at.iter().map(|length| (length.0, 0)).collect();
        cables[1] = (cables[1].0 + gap, velocity);
        Request::Knot(knot(0, 0, false, &cables))
    };
    for gap in [51, -51, 190_000_000, -7_000_000] {
        let gap_told = TenthMicrometres(gap);
        let truth = Reject::KnotStart {
            cable: 2,
            gap: gap_told,
        };
        assert_eq!(bench.request(start(gap, 0)), Err(truth));
    }
    assert!(matches!(
        bench.request(start(0, 1)),
        Err(Reject::KnotStart { cable: 2, .. })
    ));
    assert!(bench.request(start(50, 0)).is_ok());
}

#[test]
fn k4_a_start_400_m_away_is_not_taken_for_a_small_gap() {
    use mcdpr_protocol::{CableKey, ConfigKey, Millinewtons};
    let far = 2_000_000_000;
    let mut all = entries();
    for entry in &mut all {
        for index in 0..CABLES as u8 {
            if entry.key == ConfigKey::cable(index, CableKey::LengthMin) {
                entry.value = -far;
            } else if entry.key == ConfigKey::cable(index, CableKey::LengthMax) {
                entry.value = far;
            }
        }
    }
    let mut bench = Bench::ready();
    bench.configure(&all);
    let lengths = PerCable::collect([TenthMicrometres(far); CABLES]);
    let tensions = PerCable::collect([Millinewtons(10_000); CABLES]);
    bench
        .request(Request::Reference { lengths, tensions })
        .unwrap();
    let config_hash = crate::support::hash_of(&all);
    bench.request(Request::Arm { config_hash }).unwrap();
    bench.until(State::Holding, crate::support::ARMING_MS);
    let away = Request::Knot(knot(0, 0, false, &[(-far, 0); CABLES]));
    assert!(matches!(
        bench.request(away),
        Err(Reject::KnotStart { cable: 1, .. })
    ));
}

#[test]
fn k7_a_full_buffer_refuses_and_loses_nothing() {
    let mut bench = Bench::holding();
    let at = bench.status().setpoints[0].0;
    let steady = |k: u16| {
        let way = if k == 0 {
            0
        } else {
            100_000 + 200_000 * (i32::from(k) - 1)
        };
        let velocity = if k == 0 { 0 } else { 20_000 };
        let cables: Vec<_> = (0..CABLES).map(|_| (way, velocity)).collect();
        (u32::from(k) * 1000, cables)
    };
    let setpoints = bench.status().setpoints;
    let request = |k: u16| {
        let (time_ms, cables) = steady(k);
        let cables: Vec<_> = cables
            .iter()
            .zip(setpoints.iter())
            .map(|(c, s)| (c.0 + s.0, c.1))
            .collect();
        Request::Knot(knot(k, time_ms, false, &cables))
    };
    for k in 0..16 {
        let free = 15 - k as u8;
        assert_eq!(
            bench.request(request(k)),
            Ok(mcdpr_protocol::Reply::Queued { free })
        );
    }
    let before = bench.status();
    assert_eq!((before.knots_free, before.next_knot), (0, 16));
    assert_eq!(bench.request(request(16)), Err(Reject::BufferFull));
    assert_eq!(bench.status(), before);
    bench.request(Request::Start).unwrap();
    bench.run(5000);
    assert_eq!(bench.fault(), None);
    assert_eq!(bench.status().setpoints[0].0 - at, 100_000 + 200_000 * 4);
}

#[test]
fn references_out_of_range_or_for_other_cables_are_refused() {
    use mcdpr_protocol::Millinewtons;
    let mut bench = Bench::ready();
    let mut ask = |lengths: &[i32], tensions: &[i32]| {
        bench.request(Request::Reference {
            lengths: PerCable::collect(lengths.iter().map(|&l| TenthMicrometres(l))),
            tensions: PerCable::collect(tensions.iter().map(|&t| Millinewtons(t))),
        })
    };
    assert!(ask(&[0, 1, 2, 3], &[0; 4]).is_ok());
    let count = Err(Reject::CableCount {
        expected: 4,
        got: 3,
    });
    assert_eq!(ask(&[0; 3], &[0; 4]), count);
    assert_eq!(ask(&[0; 4], &[0; 3]), count);
    for far in [2_000_000_001, i32::MIN, i32::MAX] {
        assert_eq!(
            ask(&[0, far, 0, 0], &[0; 4]),
            Err(Reject::KnotLength { cable: 2 })
        );
    }
    for strong in [10_000_001, i32::MIN] {
        assert_eq!(
            ask(&[0; 4], &[0, 0, 0, strong]),
            Err(Reject::KnotTension { cable: 4 })
        );
    }
}

#[test]
fn a_fault_in_motion_refuses_more_knots_with_its_record() {
    let mut bench = Bench::moving(4000, 500);
    bench.beats = false;
    bench.run(101);
    assert_eq!(bench.fault(), Some(FaultId::L10));
    let at = knot(4, 4300, false, &[(8_800_000, 0); CABLES]);
    assert!(matches!(
        bench.request(Request::Knot(at)),
        Err(Reject::Faulted { .. })
    ));
}
