//! Sessions, sequence numbers and telemetry.

use crate::support::{Bench, entries};
use mcdpr_firmware::State;
use mcdpr_firmware::sampler::Sampler;
use mcdpr_firmware::server::{Incoming, LinkCounters, Receiver};
use mcdpr_protocol::frame::{MAX_FRAME, encode_frame};
use mcdpr_protocol::{
    Channel, Command, Reject, Reply, Request, Sample, SequenceNumber, SessionId, StopKind, Tick,
};

const OTHER: SessionId = SessionId(1234);

#[test]
fn l4_a_duplicate_executes_once_and_is_answered_alike() {
    let mut bench = Bench::ready();
    let sequence = bench.next;
    let first = bench.send(bench.session, sequence, Bench::arm_request());
    assert_eq!(first.result, Ok(Reply::Done));
    let status = bench.status();
    let again = bench.send(bench.session, sequence, Bench::arm_request());
    assert_eq!(again, first, "a second arming would be a wrong state");
    assert_eq!(bench.status(), status);
    assert_eq!(
        bench
            .server
            .status(&LinkCounters::default())
            .sequence_errors,
        1
    );
}

#[test]
fn l4_every_outcome_of_the_window_is_answered_alike() {
    let mut bench = Bench::ready();
    // A mixture of done and refused.
    let mut sent = vec![];
    for k in 0..8_u16 {
        let request = if k % 2 == 0 {
            Request::Start
        } else {
            Request::Gripper { closed: k % 4 == 1 }
        };
        let sequence = bench.next;
        bench.next = sequence.next();
        sent.push((
            sequence,
            request.clone(),
            bench.send(bench.session, sequence, request),
        ));
    }
    let gripper = bench.status().gripper_closed;
    for (sequence, request, answer) in sent {
        assert_eq!(bench.send(bench.session, sequence, request), answer);
    }
    assert_eq!(bench.status().gripper_closed, gripper);
}

#[test]
fn l4_the_last_request_of_a_session_is_answered_alike_when_its_answer_was_lost() {
    let mut bench = Bench::ready();
    let sequence = bench.next;
    for _ in 0..3 {
        let answer = bench.send(bench.session, sequence, Request::Close);
        assert_eq!(answer.result, Ok(Reply::Done));
    }
    let late = bench.send(bench.session, sequence.next(), Request::Close);
    assert_eq!(late.result, Err(Reject::NoSession));
    // Another session has no effect on it.
    bench
        .send(OTHER, SequenceNumber(0), Request::Open)
        .result
        .unwrap();
    let answer = bench.send(bench.session, sequence, Request::Close);
    assert_eq!(answer.result, Err(Reject::NoSession));
    assert_eq!(
        bench
            .send(OTHER, SequenceNumber(1), Request::Discard)
            .result,
        Ok(Reply::Done)
    );
}

#[test]
fn l3_a_gap_is_answered_with_the_number_that_the_board_waits_for() {
    let mut bench = Bench::ready();
    let expected = bench.next;
    for ahead in [1, 2, 7, 8, 9, 100, 0x7FFF] {
        let sequence = SequenceNumber(expected.0.wrapping_add(ahead));
        let answer = bench.send(bench.session, sequence, Bench::arm_request());
        assert_eq!(answer.result, Err(Reject::Sequence { expected }));
        assert_eq!(answer.sequence, sequence);
    }
    assert_eq!(bench.state(), State::Disarmed);
    assert_eq!(
        bench
            .send(bench.session, expected, Bench::arm_request())
            .result,
        Ok(Reply::Done)
    );
}

#[test]
fn l5_what_is_older_than_the_window_is_refused_and_never_executed() {
    let mut bench = Bench::ready();
    for _ in 0..20 {
        bench.request(Request::Gripper { closed: false }).unwrap();
    }
    let expected = bench.next;
    for behind in [9, 10, 15, 100, 0x7FFF] {
        let sequence = SequenceNumber(expected.0.wrapping_sub(behind));
        let answer = bench.send(bench.session, sequence, Request::Gripper { closed: true });
        assert_eq!(
            answer.result,
            Err(Reject::Sequence { expected }),
            "{behind}"
        );
    }
    assert!(!bench.status().gripper_closed);
}

#[test]
fn l3_l5_numbers_wrap_at_65535() {
    let mut bench = Bench::new();
    bench.step();
    bench.next = SequenceNumber(65_530);
    bench.open();
    for k in 0..20_u16 {
        let sequence = bench.next;
        assert_eq!(sequence.0, 65_531_u16.wrapping_add(k));
        let closed = k % 2 == 0;
        bench.request(Request::Gripper { closed }).unwrap();
        let again = bench.send(
            bench.session,
            sequence,
            Request::Gripper { closed: !closed },
        );
        assert_eq!(again.result, Ok(Reply::Done));
        assert_eq!(bench.status().gripper_closed, closed, "executed once");
        let ahead = SequenceNumber(bench.next.0.wrapping_add(1));
        let gap = bench.send(bench.session, ahead, Request::Gripper { closed: !closed });
        assert_eq!(
            gap.result,
            Err(Reject::Sequence {
                expected: bench.next
            })
        );
    }
}

#[test]
fn l14_a_second_session_is_refused_while_the_first_lives() {
    let mut bench = Bench::ready();
    bench.run(10);
    assert_eq!(
        bench.send(OTHER, SequenceNumber(0), Request::Open).result,
        Err(Reject::SessionHeld)
    );
    for request in [
        Bench::arm_request(),
        Request::Disarm,
        Request::Heartbeat { host_time_us: 0 },
        Request::Close,
        Request::Samples { enabled: true },
    ] {
        let answer = bench.send(OTHER, bench.next, request);
        assert_eq!(answer.result, Err(Reject::NoSession));
    }
    // Any host may read, and any host may stop.
    assert!(
        bench
            .send(OTHER, SequenceNumber(9), Request::Status)
            .result
            .is_ok()
    );
    bench.arm().unwrap();
    let stop = Request::Stop(StopKind::Stop);
    assert_eq!(
        bench.send(OTHER, SequenceNumber(9), stop).result,
        Ok(Reply::Done)
    );
    assert_eq!(bench.state(), State::Stopping);
}

#[test]
fn session_0_is_nobody() {
    let mut bench = Bench::new();
    bench.step();
    let answer = bench.send(SessionId(0), SequenceNumber(0), Request::Open);
    assert_eq!(answer.result, Err(Reject::NoSession));
}

#[test]
fn l13_a_restarted_host_waits_for_the_hold_to_end_and_the_old_session_is_dead() {
    let mut bench = Bench::moving(4000, 500);
    bench.beats = false;
    let mut refused_for = 0;
    loop {
        bench.step();
        let answer = bench.send(OTHER, SequenceNumber(500), Request::Open);
        // The status can be read all the time.
        assert!(
            bench
                .send(OTHER, SequenceNumber(1), Request::Status)
                .result
                .is_ok()
        );
        match answer.result {
            Ok(reply) => {
                assert_eq!(reply, Reply::Done);
                break;
            }
            Err(reject) => assert_eq!(reject, Reject::SessionHeld),
        }
        refused_for += 1;
        assert!(refused_for < 3000);
    }
    assert_eq!(
        bench.state(),
        State::Fault,
        "brakes closed before anyone takes over"
    );
    let proof_ms = refused_for - 2100 - 30 - 150;
    assert!(crate::support::is_proof(proof_ms), "{refused_for}");
    let (old, number) = (bench.session, bench.next);
    for request in [
        Request::ClearFault,
        Bench::arm_request(),
        Request::Heartbeat { host_time_us: 0 },
    ] {
        assert_eq!(
            bench.send(old, number, request).result,
            Err(Reject::NoSession)
        );
    }
    // The new one clears and arms by its own numbers.
    bench.session = OTHER;
    bench.next = SequenceNumber(501);
    bench.beats = true;
    assert_eq!(bench.request(Request::ClearFault), Ok(Reply::Done));
    assert_eq!(bench.arm(), Ok(Reply::Done));
}

#[test]
fn an_open_that_arrives_twice_does_not_reset_the_numbers() {
    let mut bench = Bench::ready();
    let expected = bench.next;
    let again = bench.send(bench.session, SequenceNumber(0), Request::Open);
    assert_eq!(again.result, Ok(Reply::Done));
    assert_eq!(
        bench.send(bench.session, expected, Request::Discard).result,
        Ok(Reply::Done)
    );
}

#[test]
fn a_claim_ends_by_close_or_100_ms_of_silence() {
    let mut bench = Bench::ready();
    bench.run(3);
    bench.beats = false;
    let waited = (1..200).find(|_| {
        bench.step();
        bench
            .send(OTHER, SequenceNumber(0), Request::Open)
            .result
            .is_ok()
    });
    assert_eq!(waited, Some(100));
    let mut bench = Bench::ready();
    assert_eq!(bench.request(Request::Close), Ok(Reply::Done));
    assert!(
        bench
            .send(OTHER, SequenceNumber(0), Request::Open)
            .result
            .is_ok()
    );
}

#[test]
fn l1_a_damaged_frame_is_answered_with_the_number_that_is_missing() {
    let mut bench = Bench::new();
    bench.step();
    assert_eq!(
        bench.server.complain(),
        None,
        "there is no host to report to"
    );
    bench.open();
    let complaint = bench.server.complain().unwrap();
    assert_eq!(
        complaint.result,
        Err(Reject::Sequence {
            expected: bench.next
        })
    );
}

#[test]
fn l1_l6_the_receiver_counts_whole_and_damaged_frames() {
    let command = Command {
        session: OTHER,
        sequence: SequenceNumber(3),
        request: Request::ConfigBegin { entries: 124 },
    };
    let mut frame = [0; MAX_FRAME];
    let used = encode_frame(Channel::Command, &command, &mut frame).unwrap();
    let mut receiver = Receiver::default();
    let mut feed = |bytes: &[u8]| -> Vec<Incoming> {
        bytes
            .iter()
            .filter_map(|&byte| receiver.push(byte))
            .collect()
    };
    assert_eq!(feed(&frame[..used]), [Incoming::Command(command)]);
    assert!(matches!(feed(&frame[1..used])[..], [Incoming::Damaged(_)]));
    assert!(matches!(feed(&frame[..used - 3])[..], []));
    assert!(matches!(feed(&[0])[..], [Incoming::Damaged(_)]));
    // A frame of the other direction, and one with bytes to spare.
    let used = encode_frame(Channel::Answer, &7_u8, &mut frame).unwrap();
    assert!(matches!(feed(&frame[..used])[..], [Incoming::Damaged(_)]));
    let used = encode_frame(Channel::Command, &(1_u32, 2_u16, 0_u8, 0_u8), &mut frame).unwrap();
    assert!(matches!(feed(&frame[..used])[..], [Incoming::Damaged(_)]));
    assert_eq!(
        (receiver.counters.frames_ok, receiver.counters.frames_bad),
        (1, 4)
    );
}

#[test]
fn the_state_is_reported_ten_times_a_second_and_at_every_change() {
    let mut bench = Bench::ready();
    let counters = LinkCounters {
        frames_ok: 5,
        frames_bad: 6,
        telemetry_dropped: 7,
    };
    let mut reported = vec![];
    bench.server.take_status(&counters);
    for tick in 1..=300_u32 {
        if tick == 250 {
            bench.arm().unwrap();
        }
        bench.step();
        if let Some(status) = bench.server.take_status(&counters) {
            assert_eq!(
                (
                    status.frames_ok,
                    status.frames_bad,
                    status.telemetry_dropped
                ),
                (5, 6, 7)
            );
            reported.push((tick, status.state));
        }
    }
    assert_eq!(
        reported,
        [
            (100, State::Disarmed),
            (200, State::Disarmed),
            (250, State::Arming)
        ]
    );
}

#[test]
fn samples_unpack_to_what_was_measured_tick_by_tick() {
    let mut bench = Bench::moving(4000, 500);
    bench.request(Request::Samples { enabled: true }).unwrap();
    bench.tamper = |i| {
        for (k, drive) in i.drives.iter_mut().enumerate() {
            drive.current_ma = (i.encoders[0] as i16).wrapping_mul(k as i16 + 1);
        }
    };
    let (mut measured, mut unpacked): (Vec<(Tick, Vec<Sample>)>, Vec<_>) = (vec![], vec![]);
    let mut sampler = Sampler::default();
    for _ in 0..200 {
        bench.step();
        let rows = bench.server.controller().measured();
        let samples = rows.iter().map(|row| Sample {
            length: row.length.into(),
            tension: row.tension_mn.into(),
            current: i32::from(row.current_ma).into(),
        });
        measured.push((bench.now, samples.collect()));
        let row = bench.server.take_row();
        if let Some(block) = row.and_then(|row| sampler.push(&row)) {
            assert_eq!(block.packed.len(), 200);
            block.unpack(|tick, row| unpacked.push((tick, row.to_vec())));
        }
    }
    assert_eq!(unpacked.len(), 200);
    for (k, (got, truth)) in unpacked.iter().zip(&measured).enumerate() {
        assert_eq!(got.0, truth.0);
        for (cable, (g, t)) in got.1.iter().zip(&truth.1).enumerate() {
            assert_eq!(
                (g.length, g.tension),
                (t.length, t.tension),
                "tick {k} cable {}",
                cable + 1
            );
            // Currents of odd ticks are those of the tick before.
            assert_eq!(g.current, measured[k - k % 2].1[cable].current);
        }
    }
    bench.request(Request::Samples { enabled: false }).unwrap();
    bench.run(50);
    assert_eq!(bench.server.take_row(), None);
}

#[test]
fn what_a_board_tells_about_itself() {
    let mut bench = Bench::ready();
    let Ok(Reply::Info(info)) = bench.request(Request::Info) else {
        panic!("no info");
    };
    assert_eq!(
        (info.cables, info.knot_capacity, info.ticks_per_second),
        (4, 16, 1000)
    );
    assert!(info.simulated);
    let Ok(Reply::Status(status)) = bench.request(Request::Status) else {
        panic!("no status");
    };
    assert_eq!(status.config, Some(crate::support::hash_of(&entries())));
    let beat = bench.request(Request::Heartbeat { host_time_us: 42 });
    assert_eq!(
        beat,
        Ok(Reply::Beat {
            host_time_us: 42,
            tick: bench.now,
            state: State::Disarmed,
            path_ms: 0,
            knots_free: 16,
            next_knot: 0
        })
    );
}

/// Requests from random bytes that happen to decode; the session and the number are right.
fn random_requests(seed: u64, count: usize) -> Vec<Request> {
    let mut rng = crate::support::Rng(seed);
    let mut all = vec![];
    while all.len() < count {
        let length = rng.between(1, 60) as usize;
        let mut bytes: Vec<u8> = (0..length).map(|_| rng.next() as u8).collect();
        bytes[0] = rng.between(0, 18) as u8;
        // Small numbers are the plausible ones.
        if rng.next().is_multiple_of(2) {
            bytes[1..].iter_mut().for_each(|byte| *byte &= 0x07);
        }
        let longest = (1..=length).rev();
        let mut decoded = longest.filter_map(|n| mcdpr_protocol::message::decode(&bytes[..n]));
        all.extend(decoded.next());
    }
    all
}

#[test]
fn l8_random_requests_with_valid_checksums_never_enable_a_board_without_configuration() {
    let mut bench = Bench::new();
    bench.step();
    bench.open();
    let mut armed = 0;
    for (k, request) in random_requests(1, 100_000).into_iter().enumerate() {
        if request == Request::Close {
            continue;
        }
        armed += usize::from(matches!(request, Request::Arm { .. }));
        let _ = bench.request(request);
        if k % 8 == 0 {
            bench.step();
        }
        assert!(!bench.any_torque() && bench.all_brakes(mcdpr_firmware::Brake::Closed));
        assert!(!bench.server.controller().is_armed());
    }
    assert!(armed > 100, "{armed} of them asked to arm");
}

#[test]
fn l8_random_requests_to_a_holding_robot_never_move_it_or_drop_it_but_by_a_stop() {
    let mut bench = Bench::holding();
    let at = bench.status().setpoints;
    for (k, request) in random_requests(2, 100_000).into_iter().enumerate() {
        if matches!(request, Request::Close | Request::Disarm | Request::Stop(_)) {
            continue;
        }
        let _ = bench.request(request);
        if k % 8 == 0 {
            bench.step();
        }
        assert_eq!((bench.state(), bench.fault()), (State::Holding, None));
        assert!(bench.all_brakes(mcdpr_firmware::Brake::Open));
    }
    assert_eq!(bench.status().setpoints, at);
}
