//! Orders to a robot that moves: how soon they reach it, and what it does then.

use mcdpr::control::{Handle, Order};
use mcdpr::experiment::{self, Experiment, SimulatedRobot};
use mcdpr::link::SimulatedLink;
use mcdpr::machine::Mismatch;
use mcdpr::motion::{Model, Task};
use mcdpr::robot::Robot;
use mcdpr::run::{Progress, RunError};
use mcdpr_firmware::State;
use mcdpr_protocol::SessionId;
use mcdpr_simulator::{Simulation, TracePoint};

struct Rig {
    model: Model,
    link: SimulatedLink,
    handle: Handle,
}

impl Rig {
    fn new() -> Self {
        let model = Model::new(&Robot::built_in("paper-table5").unwrap()).unwrap();
        let mismatch = Mismatch::realistic();
        let link = SimulatedRobot::new(mismatch, 1).at_home(&model).unwrap();
        link.with(Simulation::record_truth);
        Self {
            model,
            link,
            handle: Handle::new(),
        }
    }

    fn run(&self, progress: impl FnMut(Progress)) -> Result<experiment::Run, RunError> {
        let task = Task::built_in("paper:table7", -0.18).unwrap();
        let link = self.link.clone();
        Experiment::new(&self.model, task)
            .session(SessionId(1))
            .handle(&self.handle)
            .progress(progress)
            .run_on(link)
    }

    fn trace(&self) -> Vec<TracePoint> {
        self.link.with(Simulation::take_trace)
    }
}

/// Ticks from the tick of an order until the board is first in a state.
fn ticks_until(trace: &[TracePoint], ordered: u32, state: State) -> u32 {
    let mut later = trace.iter().filter(|point| point.tick.0 >= ordered);
    let found = later.find(|point| point.state == state);
    found.map_or(u32::MAX, |point| point.tick.0 - ordered)
}

#[test]
fn a_stop_decelerates_within_100_ms_and_leaves_the_brakes_closed() {
    for order in [Order::Stop, Order::Emergency] {
        let rig = Rig::new();
        let mut ordered = None;
        let outcome = rig.run(|progress| {
            if progress.path_s > 2.0 && ordered.is_none() {
                ordered = Some((
                    rig.link.with(|s| s.now_us() / 1000),
                    rig.handle.order(order),
                ));
            }
        });
        let expected = match order {
            Order::Stop => matches!(outcome, Err(RunError::Interrupted)),
            _ => matches!(outcome, Err(RunError::Emergency)),
        };
        assert!(expected, "{order:?}: {:?}", outcome.err());
        let (ordered, ticket) = ordered.unwrap();
        assert_eq!(rig.handle.outcome(ticket), Some(Ok(())));
        let trace = rig.trace();
        let ordered = u32::try_from(ordered).unwrap();
        let reached = match order {
            Order::Stop => ticks_until(&trace, ordered, State::Stopping),
            _ => ticks_until(&trace, ordered, State::Fault).min(ticks_until(
                &trace,
                ordered,
                State::Disarmed,
            )),
        };
        assert!(reached <= 100, "{order:?}: {reached} ms to the board");
        if order == Order::Stop {
            assert_eq!(rig.link.with(|s| s.state()), State::Disarmed);
        }
        assert!(!mcdpr_firmware::supervisor::may_give_torque(
            trace.last().unwrap().state
        ));
    }
}

#[test]
fn a_pause_holds_on_the_path_and_a_resume_finishes_it() {
    let rig = Rig::new();
    let (mut pause, mut resume, mut paused_at) = (None, None, 0);
    let mut refused = None;
    let observer = rig.handle.observer();
    let outcome = rig.run(|progress| {
        let now = rig.link.with(|s| s.now_us());
        if progress.path_s > 3.0 && pause.is_none() {
            pause = Some(rig.handle.pause());
            refused = Some(rig.handle.jog([0.1, 0.0, 0.0]));
            paused_at = now;
        } else if pause.is_some() && resume.is_none() && now > paused_at + 3_000_000 {
            assert!(observer.view().paused);
            assert_eq!(observer.view().task.as_deref(), Some("paper:table7"));
            resume = Some(rig.handle.resume());
        }
    });
    let run = outcome.unwrap();
    assert_eq!(rig.handle.outcome(pause.unwrap()), Some(Ok(())));
    assert_eq!(rig.handle.outcome(resume.unwrap()), Some(Ok(())));
    assert!(rig.handle.outcome(refused.unwrap()).unwrap().is_err());
    let trace = rig.trace();
    let ordered = u32::try_from(paused_at / 1000).unwrap();
    assert!(ticks_until(&trace, ordered, State::Pausing) <= 100);
    // While it held, torque was on, no cable was slack, and the tool stayed on its path.
    let held: Vec<_> = trace
        .iter()
        .filter(|p| p.state == State::Holding && p.path_ms > 0 && p.tick.0 > ordered + 600)
        .take_while(|p| p.tick.0 < ordered + 3000)
        .collect();
    assert!(held.len() > 2000, "held for {} ms", held.len());
    for point in held {
        let tensions = &point.truth.tensions_winch_n[..4];
        assert!(tensions.iter().all(|&t| t > 1.0), "{tensions:?}");
        let wanted = run
            .plan
            .timed
            .tool_m(f64::from(point.path_ms) * 1e-3)
            .unwrap();
        let miss = (wanted - nalgebra::Vector3::from(point.truth.tool_position_m)).norm();
        assert!(miss < 1.5e-3, "{:.3} mm off while it holds", miss * 1e3);
    }
}

#[test]
fn a_stop_before_the_motion_keeps_it_from_starting() {
    let rig = Rig::new();
    rig.handle.stop();
    assert!(matches!(rig.run(|_| {}), Err(RunError::Interrupted)));
    assert!(rig.trace().iter().all(|point| point.state != State::Moving));
}
