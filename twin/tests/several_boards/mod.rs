//! The robot `eight-two-boards` in motion, and what is done to it meanwhile.
#![allow(dead_code, reason = "each test program uses a part")]

use mcdpr_core::control::Handle;
use mcdpr_core::link::{Link, LinkError};
use mcdpr_core::motion::{Model, Plan, Task};
use mcdpr_core::robot::Robot;
use mcdpr_core::run::{Homing, NoStore, Recorder, RunError, Session};
use mcdpr_protocol::{BoardState, SessionId};
use mcdpr_simulator::{BoardTime, FaultLineTap, LinkOptions, Simulation};
use mcdpr_twin::SimulatedLink;
use mcdpr_twin::line::in_process;
use mcdpr_twin::plant::{Mismatch, at_rest};
use std::cell::RefCell;
use std::rc::Rc;

/// Crystals 120 ppm apart, ticks three quarters of a millisecond apart.
pub const APART: [BoardTime; 2] = [
    BoardTime {
        slow_ppm: 60.0,
        begins_us: 110.0,
    },
    BoardTime {
        slow_ppm: -60.0,
        begins_us: 860.0,
    },
];

/// Both boards by one clock.
pub const IN_STEP: [BoardTime; 2] = [BoardTime {
    slow_ppm: 0.0,
    begins_us: 110.0,
}; 2];

pub fn model() -> Model {
    Model::new(&Robot::built_in("eight-two-boards").unwrap()).unwrap()
}

pub fn robot_line(model: &Model, seed: u64, times: &[BoardTime]) -> SimulatedLink {
    let robot = model.robot();
    let plant = at_rest(model, robot, &Mismatch::default(), seed, None).unwrap();
    let line = LinkOptions::default();
    SimulatedLink::timed(robot, plant, &line, seed, &in_process, times).unwrap()
}

/// Time, µs, and the states of both boards.
pub type Seen = Vec<(u64, [BoardState; 2])>;

/// A line that looks at the boards while its time passes, and disturbs the robot once.
struct Watching<F> {
    inner: SimulatedLink,
    act: F,
    seen: Rc<RefCell<Seen>>,
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
            let piece_us = until_us.min(self.inner.now_us() + 100);
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
pub fn run(
    link: &SimulatedLink,
    model: &Model,
    handle: &Handle,
    act: impl FnMut(&mut Simulation, u64),
) -> (Result<Plan, RunError>, Seen) {
    let seen = Rc::new(RefCell::new(Vec::new()));
    let line = Watching {
        inner: link.clone(),
        act,
        seen: Rc::clone(&seen),
    };
    let done = run_over(line, link, model, handle);
    let seen = seen.borrow().clone();
    (done, seen)
}

/// The same over this line to the robot.
pub fn run_over(
    line: impl Link,
    link: &SimulatedLink,
    model: &Model,
    handle: &Handle,
) -> Result<Plan, RunError> {
    let home = Homing::Place(model.robot().tool.home_in_world_m);
    let mut session = Session::open(model, line, SessionId(1), handle, home, &NoStore)?;
    let task = Task::fitting(model)?;
    let plan = session.plan(task, None)?;
    session.arm()?;
    link.with(Simulation::record_truth);
    session.follow(&plan, &mut Recorder::default(), |_| {})?;
    session.disarm()?;
    Ok(plan)
}

/// What came of a disturbance.
pub struct After {
    pub done: Result<Plan, RunError>,
    /// State of the first board in every tick, with the time since the disturbance, s.
    pub first: Vec<(f64, BoardState)>,
    /// State of the second board at the end.
    pub second: BoardState,
    /// Changes of both boards' states while the host was there.
    pub both: Seen,
}

impl After {
    /// When the first board was in one of these states, s.
    pub fn first_s(&self, wanted: &[BoardState]) -> Option<f64> {
        let found = self.first.iter().find(|(_, state)| wanted.contains(state));
        found.map(|(after_s, _)| *after_s)
    }
}

/// Boards whose transistors do not pull: each has the host alone. It is not noticed before the next arming.
pub fn without_line(simulation: &mut Simulation) {
    for board in 0..2 {
        simulation.set_fault_line_of(board, FaultLineTap::Mute);
    }
}

/// Moves, and at 3 s of the motion does something; `then_us` after the host's end, what the boards do
/// by themselves is looked at.
pub fn disturbed(seed: u64, then_us: u64, act: impl Fn(&mut Simulation)) -> After {
    disturbed_again(seed, then_us, |simulation, since_us| {
        if since_us == 0 {
            act(simulation);
        }
    })
}

/// As [`disturbed`], with the time since the first disturbance, µs, again and again.
pub fn disturbed_again(
    seed: u64,
    then_us: u64,
    mut act: impl FnMut(&mut Simulation, u64),
) -> After {
    let model = model();
    let link = robot_line(&model, seed, &APART);
    let when = Rc::new(RefCell::new(None));
    let noted = Rc::clone(&when);
    let mut began_us = None;
    let (done, both) = run(&link, &model, &Handle::new(), |simulation, now_us| {
        if noted.borrow().is_none() && simulation.path_ms() >= 3000 {
            *noted.borrow_mut() = Some(simulation.plant().time_s());
            began_us = Some(now_us);
        }
        if let Some(began_us) = began_us {
            act(simulation, now_us - began_us);
        }
    });
    let at_s = when.borrow().expect("the motion came to its third second");
    // What the boards do by themselves after the host has gone.
    link.with(|simulation| {
        let until_us = simulation.now_us() + then_us;
        while simulation.now_us() < until_us {
            let mut unread = [Vec::new(), Vec::new()];
            simulation.advance_all(until_us, &mut unread).unwrap();
        }
    });
    let trace = link.with(Simulation::take_trace);
    let after = trace.iter().map(|p| (p.truth.time_s - at_s, p.state));
    After {
        done,
        first: after.filter(|(after_s, _)| *after_s >= 0.0).collect(),
        second: link.with(|simulation| simulation.look_at(1).0),
        both,
    }
}
