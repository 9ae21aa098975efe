//! A run's bytes and times are all that the host's logic depends on: fed the same again, it sends
//! the same again. Longer recordings and their files are built on this.

use mcdpr::experiment::{Experiment, SimulatedRobot};
use mcdpr::link::{Direction, Link, LinkError, RawFrame, Tee};
use mcdpr::machine::Mismatch;
use mcdpr::motion::{Model, Task};
use mcdpr::robot::Robot;
use mcdpr_protocol::SessionId;
use mcdpr_simulator::{LinkOptions, WireFaults};
use std::collections::VecDeque;

/// Answers as recorded, and insists on being asked as recorded.
struct Replay {
    frames: VecDeque<RawFrame>,
    now_us: u64,
    sent: usize,
}

impl Replay {
    fn next(&mut self, direction: Direction) -> RawFrame {
        let frame = self
            .frames
            .pop_front()
            .expect("the host goes on after the record's end");
        assert_eq!(frame.direction, direction, "at {} us", frame.time_us);
        self.now_us = frame.time_us;
        frame
    }
}

impl Link for Replay {
    fn now_us(&self) -> u64 {
        self.now_us
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        let frame = self.next(Direction::ToBoard);
        assert_eq!(frame.bytes, bytes, "other bytes at {} us", frame.time_us);
        self.sent += bytes.len();
        Ok(())
    }

    fn receive(&mut self, _until_us: u64, into: &mut Vec<u8>) -> Result<u64, LinkError> {
        let frame = self.next(Direction::ToHost);
        into.extend_from_slice(&frame.bytes);
        Ok(frame.time_us)
    }
}

#[test]
fn a_recorded_run_replays_bit_by_bit_noise_and_retransmissions_included() {
    let model = Model::new(&Robot::built_in("paper-table5").unwrap()).unwrap();
    let text = "start_mm = [255, -105, -180]\n[[leg]]\nto_mm = [275, -85, -180]\n";
    let task = || Task::parse(text, "short.toml".into()).unwrap();
    let faults = WireFaults {
        drop: 0.001,
        corrupt: 0.001,
        ..WireFaults::default()
    };
    let options = LinkOptions {
        to_board: faults,
        to_host: faults,
        ..LinkOptions::default()
    };
    let robot = SimulatedRobot::new(Mismatch::realistic(), 3)
        .line(options)
        .at_home(&model)
        .unwrap();
    let mut frames = Vec::new();
    let tee = Tee::new(robot, |frame| frames.push(frame));
    let session = SessionId(11);
    let recorded = Experiment::new(&model, task())
        .session(session)
        .run_on(tee)
        .unwrap();
    assert!(frames.len() > 1000, "{}", frames.len());

    let mut replay = Replay {
        frames: frames.clone().into(),
        now_us: 0,
        sent: 0,
    };
    let again = Experiment::new(&model, task())
        .session(session)
        .run_on(&mut replay)
        .unwrap();
    assert_eq!(again.samples, recorded.samples);
    assert_eq!(
        replay.frames.len(),
        0,
        "the host stopped before the record's end"
    );
    let recorded_bytes = frames.iter().filter(|f| f.direction == Direction::ToBoard);
    assert_eq!(
        replay.sent,
        recorded_bytes.map(|f| f.bytes.len()).sum::<usize>()
    );
}
