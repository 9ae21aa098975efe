//! Both production halves of the link over a line that drops, corrupts, duplicates and delays.

use mcdpr::experiment::{Experiment, SimulatedRobot};
use mcdpr::link::{Client, ClientError, Link, SimulatedLink};
use mcdpr::machine::Mismatch;
use mcdpr::motion::{Model, Task};
use mcdpr::robot::Robot;
use mcdpr::run::{self, RunError};
use mcdpr_firmware::State;
use mcdpr_protocol::{FaultId, PROTOCOL_MINOR, Request, SessionId};
use mcdpr_simulator::{LinkOptions, WireFaults, WireVersion};

fn model() -> Model {
    Model::new(&Robot::built_in("paper-table5").unwrap()).unwrap()
}

fn robot(model: &Model, options: &LinkOptions, seed: u64) -> SimulatedLink {
    SimulatedRobot::new(Mismatch::default(), seed)
        .line(*options)
        .at_home(model)
        .unwrap()
}

fn short_task() -> Task {
    let text = "start_mm = [255, -105, -180]\n[[leg]]\nto_mm = [285, -75, -180]\n\
                [[leg]]\ncircle_center_mm = [285, -65, -180]";
    Task::parse(text, "short.toml".into()).unwrap()
}

#[test]
fn l1_l3_l4_l9_a_motion_is_the_same_over_a_noisy_line_as_over_a_perfect_one() {
    let model = model();
    let path = |options: &LinkOptions, seed: u64| {
        let link = robot(&model, options, seed);
        link.with(mcdpr_simulator::Simulation::record_truth);
        let run = Experiment::new(&model, short_task()).run_on(link.clone());
        let run = run.unwrap_or_else(|error| panic!("seed {seed}: {error:?}"));
        let trace = link.with(mcdpr_simulator::Simulation::take_trace);
        let path = mcdpr::report::true_path(&trace);
        assert_eq!(link.with(|s| s.state()), State::Disarmed);
        (run.plan, path)
    };
    let (plan, clean) = path(&LinkOptions::default(), 1);
    for (name, faults) in [
        (
            "drops",
            WireFaults {
                drop: 0.002,
                ..WireFaults::default()
            },
        ),
        (
            "corrupts",
            WireFaults {
                corrupt: 0.002,
                ..WireFaults::default()
            },
        ),
        (
            "duplicates",
            WireFaults {
                duplicate: 0.002,
                ..WireFaults::default()
            },
        ),
        (
            "delays",
            WireFaults {
                delay: 0.001,
                longest_delay_us: 15_000,
                ..WireFaults::default()
            },
        ),
        (
            "everything",
            WireFaults {
                drop: 0.0005,
                corrupt: 0.0005,
                duplicate: 0.0005,
                delay: 0.0003,
                longest_delay_us: 10_000,
                noise_per_s: 0.0,
            },
        ),
    ] {
        for seed in 1..=4 {
            let options = LinkOptions {
                to_board: faults,
                to_host: faults,
                ..LinkOptions::default()
            };
            let (_, noisy) = path(&options, seed);
            assert_eq!(noisy.len(), clean.len(), "{name}, seed {seed}");
            for (a, b) in clean.iter().zip(&noisy) {
                for axis in 0..3 {
                    // Sensor noise is drawn anew, so the platform swings a little differently.
                    let gap = (a.tool_m[axis] - b.tool_m[axis]).abs();
                    let at_s = a.path_s;
                    assert!(gap < 0.3e-3, "{name}, seed {seed}, {at_s} s: {gap}");
                }
            }
        }
    }
    assert!(
        plan.knots.len() > 16,
        "the motion must outgrow the board's buffer"
    );
}

#[test]
fn l1_l3_a_noisy_line_costs_retransmissions_and_the_board_counts_them() {
    let model = model();
    let faults = WireFaults {
        drop: 0.003,
        corrupt: 0.003,
        ..WireFaults::default()
    };
    let options = LinkOptions {
        to_board: faults,
        to_host: faults,
        ..LinkOptions::default()
    };
    let mut client = Client::connect(robot(&model, &options, 5), SessionId(7)).unwrap();
    for _ in 0..40 {
        run::configure(&mut client, model.robot()).unwrap();
        client.request(Request::Discard).unwrap();
    }
    let (sent_again, damaged) = client.link_errors();
    assert!(sent_again > 0 && damaged > 0, "{sent_again} {damaged}");
    let status = run::status(&mut client).unwrap();
    assert!(status.frames_bad > 0, "{status:?}");
    assert_eq!(status.fault, None);
}

#[test]
fn rubbish_on_the_line_at_power_up_does_not_hide_the_board() {
    let model = model();
    let mut link = robot(&model, &LinkOptions::default(), 1);
    let rubbish: Vec<u8> = (0..3000_u32).map(|i| (i * 97 % 251) as u8).collect();
    link.send(&rubbish).unwrap();
    let client = Client::connect(link, SessionId(9)).unwrap();
    assert!(client.info().simulated);
    assert_eq!(client.info().cables, 4);
}

#[test]
fn a_board_of_another_protocol_version_is_named_and_never_moved_l17() {
    let model = model();
    let minor = PROTOCOL_MINOR;
    for (version, remedy) in [
        (
            WireVersion {
                major: 0,
                minor: minor - 1,
                git_hash: [0; 8],
            },
            "flash",
        ),
        (
            WireVersion {
                major: 0,
                minor: minor + 1,
                git_hash: [0; 8],
            },
            "update",
        ),
        (
            WireVersion {
                major: 1,
                minor: 0,
                git_hash: [0; 8],
            },
            "update",
        ),
    ] {
        let options = LinkOptions {
            version: Some(version),
            ..LinkOptions::default()
        };
        let link = robot(&model, &options, 1);
        let error = Experiment::new(&model, short_task()).run_on(link.clone());
        let Err(RunError::Client(error @ ClientError::Version { .. })) = error else {
            panic!("{version:?}: {error:?}");
        };
        let text = error.to_string();
        assert!(
            text.contains(&format!("{}.{}", version.major, version.minor)),
            "{text}"
        );
        assert!(
            text.contains(&format!("0.{minor}")) && text.contains("nothing was moved"),
            "{text}"
        );
        let help = miette_help(&error);
        assert!(help.contains(remedy), "{help}");
        assert_eq!(link.with(|s| s.state()), State::Disarmed);
        assert!(link.with(|s| {
            s.plant().truth().unwrap().brakes_closed[..4]
                .iter()
                .all(|c| *c)
        }));
    }
}

fn miette_help(error: &dyn miette::Diagnostic) -> String {
    error
        .help()
        .map(|help| help.to_string())
        .unwrap_or_default()
}

#[test]
fn a_silent_line_is_distinguished_from_a_board() {
    struct Silence(u64);
    impl Link for Silence {
        fn now_us(&self) -> u64 {
            self.0
        }
        fn send(&mut self, _: &[u8]) -> Result<(), mcdpr::link::LinkError> {
            Ok(())
        }
        fn receive(&mut self, until: u64, _: &mut Vec<u8>) -> Result<u64, mcdpr::link::LinkError> {
            self.0 = self.0.max(until);
            Ok(self.0)
        }
    }
    let error = Client::connect(Silence(0), SessionId(1)).err().unwrap();
    assert!(matches!(error, ClientError::Silent), "{error:?}");
}

#[test]
fn a_motion_runs_across_the_wrap_of_the_tick_counter_k9() {
    let model = model();
    // When the motion begins depends on how long the board arms.
    let link = robot(&model, &LinkOptions::default(), 1);
    let run = Experiment::new(&model, short_task()).run_on(link).unwrap();
    let ticks = || run.samples.iter().map(|sample| sample.tick);
    let (first, last) = (ticks().min().unwrap(), ticks().max().unwrap());
    for tenths in [1, 5, 9] {
        let before_wrap = first + (last - first) * tenths / 10;
        let options = LinkOptions {
            first_tick: u32::MAX - before_wrap,
            ..LinkOptions::default()
        };
        let link = robot(&model, &options, 1);
        let run = Experiment::new(&model, short_task()).run_on(link).unwrap();
        let ticks: Vec<_> = run.samples.iter().map(|sample| sample.tick).collect();
        assert!(
            ticks
                .windows(2)
                .all(|pair| pair[1].wrapping_sub(pair[0]) == 1)
        );
        assert!(
            ticks.first() > ticks.last(),
            "the run did not cross the wrap"
        );
    }
}

#[test]
fn a_second_session_is_refused_while_the_first_is_armed_l14() {
    let model = model();
    let link = robot(&model, &LinkOptions::default(), 1);
    let mut first = Client::connect(link.clone(), SessionId(1)).unwrap();
    let hash = run::configure(&mut first, model.robot()).unwrap();
    let home = model.rest_at_home().unwrap();
    let reference = mcdpr::machine::reference(&home.paid_out_m, home.tensions_n());
    first.request(reference).unwrap();
    run::arm(&mut first, hash).unwrap();
    // The second host asks while the first is silent for less than the link may be late.
    let mut second = Asker { link };
    let refused = second.ask_to_open(SessionId(2), 30_000);
    assert!(refused, "a second session was let in");
    run::disarm(&mut first).unwrap();
}

/// A host that only asks once.
struct Asker {
    link: SimulatedLink,
}

impl Asker {
    fn ask_to_open(&mut self, session: SessionId, within_us: u64) -> bool {
        use mcdpr_protocol::{Answer, Channel, Command, Deframer, Reject, SequenceNumber, message};
        let command = Command {
            session,
            sequence: SequenceNumber(100),
            request: Request::Open,
        };
        let mut frame = [0; mcdpr_protocol::frame::MAX_FRAME];
        let used = mcdpr_protocol::encode_frame(Channel::Command, &command, &mut frame).unwrap();
        self.link.send(&frame[..used]).unwrap();
        let give_up = self.link.now_us() + within_us;
        let mut deframer = Deframer::new();
        while self.link.now_us() < give_up {
            let mut bytes = Vec::new();
            self.link.receive(give_up, &mut bytes).unwrap();
            for byte in bytes {
                let Some(Ok((Channel::Answer, body))) = deframer.push(byte) else {
                    continue;
                };
                let answer: Answer = message::decode(body).unwrap();
                if answer.sequence == SequenceNumber(100) {
                    return answer.result == Err(Reject::SessionHeld);
                }
            }
        }
        panic!("the board did not answer the second host");
    }
}

#[test]
fn a_dead_host_is_noticed_and_the_platform_does_not_fall_l10_l12_l15() {
    let model = model();
    let link = robot(&model, &LinkOptions::default(), 1);
    link.with(mcdpr_simulator::Simulation::record_truth);
    // The host dies in the middle of the motion: its client simply stops being run.
    let died = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
        let _ = Experiment::new(&model, short_task())
            .progress(|progress| {
                assert!(progress.path_s < 1.0, "the host dies here");
            })
            .run_on(link.clone());
    }));
    assert!(died.is_err());
    link.with(mcdpr_simulator::Simulation::take_trace);
    let began = link.now_us();
    let mut host = link.clone();
    let mut unread = Vec::new();
    while host.now_us() < began + 4_000_000 {
        host.receive(began + 4_000_000, &mut unread).unwrap();
    }
    let trace = link.with(mcdpr_simulator::Simulation::take_trace);
    let after = |state: State| trace.iter().position(|point| point.state == state);
    let pausing = after(State::Pausing).expect("it must decelerate");
    assert!(
        (60..=110).contains(&pausing),
        "decelerated after {pausing} ms"
    );
    let holding = after(State::Holding).expect("it must hold");
    assert!(
        holding - pausing <= 301,
        "at rest after {} ms",
        holding - pausing
    );
    let stopping = after(State::Stopping).expect("it must close the brakes");
    assert!(
        (1990..=2110).contains(&stopping),
        "held until {stopping} ms"
    );
    let end = trace.last().unwrap();
    assert_eq!(end.state, State::Fault);
    assert!(end.truth.brakes_closed[..4].iter().all(|closed| *closed));
    let at_rest = trace[holding].truth.tool_position_m[2];
    let drop = trace[holding..]
        .iter()
        .map(|p| at_rest - p.truth.tool_position_m[2]);
    let drop = drop.fold(0.0, f64::max);
    assert!(drop < 5e-3, "dropped by {drop} m");
    // The next host reads the fault, clears it, and moves on from where the robot is.
    let error = Experiment::new(&model, short_task())
        .run_on(link.clone())
        .unwrap_err();
    let RunError::Latched { record } = error else {
        panic!("{error:?}");
    };
    assert_eq!(record.fault, FaultId::L10);
    let mut client = Client::connect(link.clone(), SessionId(77)).unwrap();
    client.request(Request::ClearFault).unwrap();
    client.request(Request::Close).unwrap();
    Experiment::new(&model, short_task()).run_on(link).unwrap();
}
