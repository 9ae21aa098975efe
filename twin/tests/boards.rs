//! One robot on several boards: start, clocks, and stops that are those of all.

use mcdpr_core::control::{Handle, Order};
use mcdpr_core::link::{ClientError, Link, LinkError};
use mcdpr_core::motion::{Model, Plan, Task};
use mcdpr_core::robot::Robot;
use mcdpr_core::run::{Homing, NoStore, Recorder, RunError, Session};
use mcdpr_protocol::{BoardState, SessionId};
use mcdpr_simulator::{BoardTime, LinkOptions, Simulation, TracePoint, WireFaults};
use mcdpr_twin::SimulatedLink;
use mcdpr_twin::line::in_process;
use mcdpr_twin::plant::{Mismatch, at_rest};
use std::cell::RefCell;
use std::rc::Rc;

/// Crystals 120 ppm apart, ticks three quarters of a millisecond apart.
const APART: [BoardTime; 2] = [
    BoardTime {
        slow_ppm: 60.0,
        begins_us: 110.0,
    },
    BoardTime {
        slow_ppm: -60.0,
        begins_us: 860.0,
    },
];

fn model() -> Model {
    Model::new(&Robot::built_in("eight-two-boards").unwrap()).unwrap()
}

fn robot_line(model: &Model, seed: u64, times: &[BoardTime]) -> SimulatedLink {
    let robot = model.robot();
    let plant = at_rest(model, robot, &Mismatch::default(), seed, None).unwrap();
    let line = LinkOptions::default();
    SimulatedLink::timed(robot, plant, &line, seed, &in_process, times).unwrap()
}

/// A line that looks at the boards while its time passes, and disturbs the robot once.
struct Watching<F> {
    inner: SimulatedLink,
    act: F,
    seen: Rc<RefCell<Vec<(u64, [BoardState; 2])>>>,
}

impl<F: FnMut(&mut Simulation, u64)> Link for Watching<F> {
    fn now_us(&self) -> u64 {
        self.inner.now_us()
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.inner.send(bytes)
    }

    fn receive(&mut self, until_us: u64, into: &mut Vec<u8>) -> Result<u64, LinkError> {
        loop {
            let piece_us = until_us.min(self.inner.now_us() + 250);
            let before = into.len();
            let now = self.inner.receive(piece_us, into)?;
            let states = self.inner.with(|simulation| {
                (self.act)(simulation, now);
                [simulation.look_at(0).0, simulation.look_at(1).0]
            });
            let mut seen = self.seen.borrow_mut();
            if seen.last().is_none_or(|(_, last)| *last != states) {
                seen.push((now, states));
            }
            if into.len() > before || now >= until_us {
                return Ok(now);
            }
        }
    }
}

/// Moves along the robot's own path; `act` sees the simulation and the time in the motion.
fn run(
    link: &SimulatedLink,
    model: &Model,
    handle: &Handle,
    act: impl FnMut(&mut Simulation, u64),
) -> (Result<Plan, RunError>, Vec<(u64, [BoardState; 2])>) {
    let seen = Rc::new(RefCell::new(Vec::new()));
    let line = Watching {
        inner: link.clone(),
        act,
        seen: Rc::clone(&seen),
    };
    let home = Homing::Place(model.robot().tool.home_in_world_m);
    let mut drive = || {
        let mut session = Session::open(model, line, SessionId(1), handle, home, &NoStore)?;
        let task = Task::fitting(model)?;
        let plan = session.plan(task, None)?;
        session.arm()?;
        link.with(Simulation::record_truth);
        session.follow(&plan, &mut Recorder::default(), |_| {})?;
        session.disarm()?;
        Ok(plan)
    };
    let done = drive();
    let seen = seen.borrow().clone();
    (done, seen)
}

/// How much later the drums of a board are than the plan, s: least squares over the motion, a
/// constant offset of each length aside.
fn delay_s(plan: &Plan, trace: &[TracePoint], cables: std::ops::Range<usize>) -> f64 {
    let (mut vv, mut ve) = (0.0, 0.0);
    for cable in cables {
        let at = |time_s: f64| plan.state(time_s).map(|state| state.paid_out_m[cable]);
        let mut rows = Vec::new();
        for point in trace.iter().filter(|p| p.path_ms > 0 && p.path_ms % 5 == 0) {
            let time_s = f64::from(point.path_ms) * 1e-3;
            let (Some(before), Some(now), Some(after)) =
                (at(time_s - 1e-3), at(time_s), at(time_s + 1e-3))
            else {
                continue;
            };
            let late = point.truth.unstretched_lengths_m[cable] - now;
            rows.push(((after - before) / 2e-3, late));
        }
        let count = rows.len() as f64;
        let mean_v = rows.iter().map(|r| r.0).sum::<f64>() / count;
        let mean_e = rows.iter().map(|r| r.1).sum::<f64>() / count;
        for (v, e) in rows {
            vv += (v - mean_v).powi(2);
            ve += (v - mean_v) * (e - mean_e);
        }
    }
    -ve / vv
}

#[test]
fn two_boards_with_clocks_of_their_own_move_as_one() {
    let model = model();
    let link = robot_line(&model, 1, &APART);
    let (plan, _) = run(&link, &model, &Handle::new(), |_, _| {});
    let plan = plan.unwrap();
    let trace = link.with(Simulation::take_trace);
    let (first, second) = (delay_s(&plan, &trace, 0..4), delay_s(&plan, &trace, 4..8));
    let skew_us = (second - first) * 1e6;
    println!("delays {:.1} and {:.1} us, skew {skew_us:.1} us", first * 1e6, second * 1e6);
    assert!(skew_us.abs() < 100.0, "{skew_us} us");
}

/// When each board first was in one of these states, µs.
fn first_us(
    seen: &[(u64, [BoardState; 2])],
    since_us: u64,
    wanted: &[BoardState],
) -> [Option<u64>; 2] {
    [0, 1].map(|board| {
        let mut later = seen.iter().filter(|(at_us, _)| *at_us >= since_us);
        let found = later.find(|(_, states)| wanted.contains(&states[board]));
        found.map(|(at_us, _)| *at_us)
    })
}

/// Moves, and at 3 s of the motion does something; gives when, and the states that followed.
fn disturbed(
    seed: u64,
    act: impl Fn(&mut Simulation),
) -> (Result<Plan, RunError>, u64, Vec<(u64, [BoardState; 2])>) {
    let model = model();
    let link = robot_line(&model, seed, &APART);
    let when = Rc::new(RefCell::new(0));
    let noted = Rc::clone(&when);
    let (done, seen) = run(&link, &model, &Handle::new(), move |simulation, now_us| {
        if *noted.borrow() == 0 && simulation.path_ms() >= 3000 {
            *noted.borrow_mut() = now_us;
            act(simulation);
        }
    });
    let at_us = *when.borrow();
    assert!(at_us > 0, "the motion came to its third second");
    // What the boards do by themselves after the host has gone.
    let mut line = Watching {
        inner: link,
        act: |_: &mut Simulation, _| {},
        seen: Rc::new(RefCell::new(seen)),
    };
    let until_us = line.now_us() + 500_000;
    while line.now_us() < until_us {
        // A board that is lost is one error more.
        if line.receive(until_us, &mut Vec::new()).is_err() {
            break;
        }
    }
    let seen = line.seen.borrow().clone();
    (done, at_us, seen)
}

#[test]
fn a_stop_is_the_same_stop_on_both_boards() {
    let model = model();
    let link = robot_line(&model, 2, &APART);
    let handle = Handle::new();
    let orders = handle.clone();
    let mut given = 0;
    let (done, seen) = run(&link, &model, &handle, |simulation, now_us| {
        if given == 0 && simulation.path_ms() >= 3000 {
            given = now_us;
            orders.order(Order::Stop);
        }
    });
    assert!(matches!(done, Err(RunError::Interrupted)), "{done:?}");
    let [first, second] = first_us(&seen, given, &[BoardState::Stopping]).map(Option::unwrap);
    println!("stop: {} and {} us after the order", first - given, second - given);
    assert!(first.abs_diff(second) <= 5_000 && first.max(second) - given < 50_000);
}

#[test]
fn a_fault_on_one_board_stops_the_other() {
    use BoardState::{Fault, Stopping};
    // The sixth cable is on the second board.
    let silent = |simulation: &mut Simulation| {
        simulation.plant_mut().faults_mut().cables[5].drive.silent = true;
    };
    let (done, at_us, seen) = disturbed(3, silent);
    let Err(RunError::Fault { record }) = done else {
        panic!("{done:?}");
    };
    assert_eq!(record.cable, 6, "{record:?}");
    let stops = first_us(&seen, at_us, &[Stopping, Fault]);
    let [first, second] = stops.map(Option::unwrap);
    println!("fault: {} and {} us", first - at_us, second - at_us);
    assert!(first - second < 150_000, "{stops:?}");
}

#[test]
fn a_dead_line_of_one_board_makes_both_hold() {
    use BoardState::{Fault, Holding, Pausing, Stopping};
    let dead = WireFaults {
        drop: 1.0,
        ..WireFaults::default()
    };
    let (done, at_us, seen) = disturbed(4, |simulation| simulation.set_faults_of(1, dead, dead));
    let Err(RunError::Client(ClientError::Link(LinkError::Boards { what, .. }))) = done else {
        panic!("{done:?}");
    };
    assert!(what.contains("board 2 (simulated 02)"), "{what}");
    let [first, second] = first_us(&seen, at_us, &[Pausing, Holding, Stopping, Fault]);
    let [first, second] = [first, second].map(Option::unwrap);
    println!("dead line: {} and {} us", first - at_us, second - at_us);
    assert!(first - at_us < 150_000 && second - at_us < 150_000);
}

#[test]
fn a_board_without_supply_stops_the_other() {
    use BoardState::{Holding, Pausing, Stopping};
    let (done, at_us, seen) = disturbed(5, |simulation| {
        simulation.set_power_of(1, false).unwrap();
    });
    assert!(done.is_err());
    let [first, _] = first_us(&seen, at_us, &[Pausing, Holding, Stopping]);
    let first = first.unwrap() - at_us;
    println!("no supply: {first} us");
    assert!(first < 150_000, "{first} us");
}
