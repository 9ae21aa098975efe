//! What the chip refuses, as the core does: frames, requests, motions, hosts.

use super::{model, robot};
use mcdpr::link::{Client, ClientError, Link, LinkError, SimulatedLink};
use mcdpr::machine;
use mcdpr::run;
use mcdpr_firmware::State;
use mcdpr_protocol::frame::{MAX_FRAME, encode_bytes};
use mcdpr_protocol::{
    Answer, CableKnot, Channel, Command, ConfigHash, Deframer, FaultId, Hello, Knot, List,
    MicrometresPerSecond, Millinewtons, PerCable, Reject, Reply, Request, SequenceNumber,
    SessionId, StopKind, TenthMicrometres, encode_frame, message,
};
use mcdpr_tests::fuzz::mutate::Rng;

fn rejected(result: Result<Reply, ClientError>, why: fn(&Reject) -> bool, what: &str) {
    match result {
        Err(ClientError::Refused { reject, .. }) => assert!(why(&reject), "{what}: {reject:?}"),
        other => panic!("{what}: {other:?}"),
    }
}

/// Sends bytes and gives the answers that come within 30 ms.
pub(super) fn ask(link: &mut SimulatedLink, bytes: &[u8]) -> Vec<Answer> {
    link.send(bytes).unwrap();
    let until = link.now_us() + 30_000;
    let mut received = Vec::new();
    while link.now_us() < until {
        link.receive(until, &mut received).unwrap();
    }
    let mut deframer = Deframer::new();
    let mut answers = Vec::new();
    for byte in received {
        if let Some(Ok((Channel::Answer, body))) = deframer.push(byte) {
            answers.push(message::decode(body).unwrap());
        }
    }
    answers
}

fn command(session: u32, sequence: u16, request: Request) -> Vec<u8> {
    let command = Command {
        session: SessionId(session),
        sequence: SequenceNumber(sequence),
        request,
    };
    let mut frame = [0; MAX_FRAME];
    let used = encode_frame(Channel::Command, &command, &mut frame).unwrap();
    frame[..used].to_vec()
}

pub(super) fn status(link: &mut SimulatedLink) -> mcdpr_protocol::Status {
    let answers = ask(link, &command(9, 900, Request::Status));
    let found = answers.into_iter().find_map(|answer| match answer.result {
        Ok(Reply::Status(status)) => Some(status),
        _ => None,
    });
    found.expect("no status")
}

#[test]
fn l3_l4_l5_l6_l7_l8_l13_l14_f9_k8_the_chip_refuses_what_the_core_refuses() {
    let model = model();
    let (mut link, _) = robot(&model);
    drop(Client::connect(link.clone(), SessionId(1)).unwrap());
    // L14: the first session is alive; another one is refused, and may look and stop.
    let held = |answers: Vec<Answer>| answers[0].result == Err(Reject::SessionHeld);
    ask(&mut link, &command(1, 50, Request::Open));
    ask(
        &mut link,
        &command(1, 0, Request::Heartbeat { host_time_us: 0 }),
    );
    assert!(held(ask(&mut link, &command(2, 7, Request::Open))), "L14");
    assert_eq!(status(&mut link).state, State::Disarmed);
    // L13: a session that never opened moves nothing.
    let arm = Request::Arm {
        config_hash: ConfigHash(1),
    };
    let answer = &ask(&mut link, &command(3, 8, arm.clone()))[0];
    assert_eq!(answer.result, Err(Reject::NoSession), "L13");

    // A new claim after 100 ms of silence.
    let until = link.now_us() + 150_000;
    while link.now_us() < until {
        link.receive(until, &mut Vec::new()).unwrap();
    }
    let open = ask(&mut link, &command(5, 100, Request::Open));
    assert_eq!(open[0].result, Ok(Reply::Done), "{open:?}");
    // F9, K8: nothing arms without a configuration, nothing starts while disarmed.
    let refused = &ask(&mut link, &command(5, 101, arm))[0];
    assert!(refused.result.is_err(), "F9: {refused:?}");
    let refused = &ask(&mut link, &command(5, 102, Request::Start))[0];
    assert!(
        matches!(refused.result, Err(Reject::WrongState { .. })),
        "K8: {refused:?}"
    );
    // L4: a duplicate is executed once and answered alike.
    let gripper = command(5, 103, Request::Gripper { closed: true });
    let (first, again) = (ask(&mut link, &gripper), ask(&mut link, &gripper));
    assert_eq!(first[0].result, Ok(Reply::Done));
    assert_eq!(first, again, "L4");
    // L5, L3: out of order is refused with the number that is missing, and not executed.
    let ahead = &ask(
        &mut link,
        &command(5, 110, Request::Gripper { closed: false }),
    )[0];
    let expected = SequenceNumber(104);
    assert_eq!(ahead.result, Err(Reject::Sequence { expected }), "L5");
    assert!(status(&mut link).gripper_closed);
    // L6: a frame without its end costs itself, and the one that it runs into.
    let whole = command(5, 104, Request::Gripper { closed: false });
    let mut stream = whole[..whole.len() / 2].to_vec();
    stream.push(0);
    stream.extend(&whole);
    assert!(
        ask(&mut link, &stream)
            .iter()
            .any(|answer| answer.result == Ok(Reply::Done)),
        "L6"
    );
    // L7: a kilobyte without an end.
    let mut stream = vec![0x55; 1024];
    stream.push(0);
    stream.extend(command(5, 105, Request::Gripper { closed: true }));
    let answers = ask(&mut link, &stream);
    assert!(
        answers
            .iter()
            .any(|answer| answer.result == Ok(Reply::Done)),
        "L7: {answers:?}"
    );
    // L8: random bytes, and random bodies with a valid checksum.
    let before = status(&mut link);
    let mut rng = Rng(8);
    for k in 0..60 {
        let noise = rng.bytes(400);
        link.send(&noise).unwrap();
        let count = rng.below(60);
        let mut frame = [0; MAX_FRAME];
        let mut body = rng.bytes(count);
        if let [session, sequence, kind, ..] = body.as_mut_slice() {
            (*session, *sequence, *kind) = (k % 8, k, *kind % 23);
        }
        let used = encode_bytes(Channel::Command, &body, &mut frame).unwrap();
        ask(&mut link, &[&[0], &frame[..used]].concat());
    }
    let after = status(&mut link);
    assert_eq!(
        (after.state, after.torque_on, after.brakes_open),
        (State::Disarmed, 0, 0),
        "L8"
    );
    assert_eq!(after.tick_overruns, before.tick_overruns, "L8");
    assert!(after.tick.0 > before.tick.0 + 1000, "L8: the board ran on");
}

#[test]
fn k3_k4_k5_k7_k10_f2_the_chip_refuses_motions_that_the_core_refuses() {
    let model = model();
    let (link, _) = robot(&model);
    let mut client = Client::connect(link.clone(), SessionId(1)).unwrap();
    let hash = run::configure(&mut client, model.robot()).unwrap();
    let home = model.rest_at_home().unwrap();
    // F2: tensions that the statics of the described robot do not give.
    let wrong: Vec<f64> = home.tensions_n().iter().map(|n| n + 6.0).collect();
    client
        .request(machine::reference(&home.paid_out_m, &wrong))
        .unwrap();
    assert!(run::arm(&mut client, hash).is_err(), "F2");
    while client.request(Request::ClearFault).is_err() {
        let status = run::status(&mut client).unwrap();
        let stops = matches!(status.state, State::Stopping | State::Fault);
        assert!(stops && status.brakes_open == 0, "F2: {status:?}");
    }
    client
        .request(machine::reference(&home.paid_out_m, home.tensions_n()))
        .unwrap();
    run::arm(&mut client, hash).unwrap();

    let Ok(Reply::Status(status)) = client.request(Request::Status) else {
        panic!("no status")
    };
    let knot = |index: u16, time_ms: u32, way: i32, velocity: i32| {
        let cables = status.setpoints.iter().map(|at| CableKnot {
            length: TenthMicrometres(at.0 + way),
            velocity: MicrometresPerSecond(velocity),
            tension: Millinewtons(5000),
        });
        Request::Knot(Knot {
            index,
            time_ms,
            last: false,
            cables: PerCable::collect(cables),
            rows: List::new(),
        })
    };
    rejected(
        client.request(knot(0, 0, 0, 9_000_000)),
        |r| !matches!(r, Reject::WrongState { .. }),
        "K3",
    );
    rejected(
        client.request(knot(0, 0, 30_000, 0)),
        |r| !matches!(r, Reject::WrongState { .. }),
        "K4",
    );
    client.request(knot(0, 0, 0, 0)).unwrap();
    // From rest to rest, 1 mm within 4 ms; and at the end of 20 ms as fast as the winch allows.
    rejected(
        client.request(knot(1, 4, 100, 0)),
        |r| matches!(r, Reject::KnotAcceleration { cable: 1 }),
        "K3",
    );
    rejected(client.request(knot(1, 0, 0, 0)), |_| true, "K5");
    let free = (1..=40_u16).find(|&at| client.request(knot(at, 50 * u32::from(at), 0, 0)).is_err());
    assert!(
        (2..=40).contains(&free.expect("K7: the buffer takes everything")),
        "{free:?}"
    );
    // K10: a stop and a start in one go: whichever comes first, it stands.
    client.enqueue(Request::Start).unwrap();
    client.stop(StopKind::Stop).unwrap();
    let until = client.now_us() + 2_000_000;
    client.pump(until).unwrap();
    let state = link.with(|simulation| simulation.state());
    assert_eq!(state, State::Disarmed, "K10");
}

#[test]
fn k6_a_buffer_that_runs_empty_while_the_host_lives_holds_the_robot_of_the_chip() {
    let model = model();
    let (link, _) = robot(&model);
    let mut client = Client::connect(link.clone(), SessionId(1)).unwrap();
    let hash = run::configure(&mut client, model.robot()).unwrap();
    let home = model.rest_at_home().unwrap();
    client
        .request(machine::reference(&home.paid_out_m, home.tensions_n()))
        .unwrap();
    run::arm(&mut client, hash).unwrap();
    let Ok(Reply::Status(status)) = client.request(Request::Status) else {
        panic!("no status")
    };
    // 400 ms upwards by 20 mm/s on all cables, and no end.
    for (index, ms) in (0_u16..).zip((0..=400).step_by(100)) {
        let way = |rising: i32| -rising * i32::from(ms > 0);
        let cables = status.setpoints.iter().map(|at| CableKnot {
            length: TenthMicrometres(at.0 + way(10 * (ms - 50).max(0))),
            velocity: MicrometresPerSecond(way(1000)),
            tension: Millinewtons(5000),
        });
        let knot = Knot {
            index,
            time_ms: u32::try_from(ms).unwrap(),
            last: false,
            cables: PerCable::collect(cables),
            rows: List::new(),
        };
        client.request(Request::Knot(knot)).unwrap();
    }
    client.request(Request::Start).unwrap();
    let until = client.now_us() + 1_500_000;
    client.pump(until).unwrap();
    let fault = link
        .with(|simulation| simulation.fault())
        .map(|record| record.fault);
    let state = link.with(|simulation| simulation.state());
    assert_eq!((fault, state), (Some(FaultId::K6), State::Holding));
}

/// A line on which the board's greeting says another version.
struct Older(SimulatedLink, Deframer);

impl Link for Older {
    fn now_us(&self) -> u64 {
        self.0.now_us()
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.0.send(bytes)
    }

    fn receive(&mut self, until_us: u64, into: &mut Vec<u8>) -> Result<u64, LinkError> {
        let mut bytes = Vec::new();
        let now_us = self.0.receive(until_us, &mut bytes)?;
        for byte in bytes {
            if let Some(Ok((channel, body))) = self.1.push(byte) {
                let mut body = body.to_vec();
                if channel == Channel::Hello {
                    let mut hello = Hello::from_bytes(&body).unwrap();
                    hello.major += 1;
                    body = hello.to_bytes().to_vec();
                }
                let mut frame = [0; MAX_FRAME];
                let used = encode_bytes(channel, &body, &mut frame).unwrap();
                into.extend_from_slice(&frame[..used]);
            }
        }
        Ok(now_us)
    }
}

#[test]
fn l17_a_chip_of_another_version_is_not_armed_and_both_versions_are_named() {
    let model = model();
    let (link, seen) = robot(&model);
    let Err(error) = Client::connect(Older(link.clone(), Deframer::new()), SessionId(1)) else {
        panic!("a board of another version was taken")
    };
    assert!(matches!(error, ClientError::Version { .. }), "{error}");
    let ours = mcdpr_protocol::PROTOCOL_MAJOR;
    for version in [ours, ours + 1] {
        assert!(
            error.to_string().contains(&format!("{version}.")),
            "{error}"
        );
    }
    assert!(!seen.any_brake_open());
    if let Some(chip) = &seen.chip {
        assert!(!chip.with(|chip| chip.brakes_ever_opened()));
    }
}
