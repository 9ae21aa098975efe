//! Robots on several boards in motion, and what is done to them meanwhile.
#![allow(dead_code, reason = "each test program uses a part")]

use mcdpr_core::control::Handle;
use mcdpr_core::link::{Link, LinkError};
use mcdpr_core::motion::{Model, Plan, Task};
use mcdpr_core::robot::Robot;
use mcdpr_core::run::{Homing, NoStore, Recorder, RunError, Session};
use mcdpr_protocol::{BoardState, SessionId};
use mcdpr_simulator::{BoardPoint, BoardTime, FaultLineTap, LinkOptions, Simulation};
use mcdpr_twin::SimulatedLink;
use mcdpr_twin::line::in_process;
use mcdpr_twin::plant::{Mismatch, at_rest};
use std::cell::RefCell;
use std::rc::Rc;

/// The robot with two boards.
pub const TWO: &str = "eight-two-boards";
/// The robot with three boards.
pub const THREE: &str = "eight-three-boards";

/// Crystals of the first two boards 120 ppm apart, ticks three quarters of a millisecond apart; a third board is
/// between them. A robot with two boards has the first two.
pub const APART: [BoardTime; 3] = [clock(60.0, 110.0), clock(-60.0, 860.0), clock(-15.0, 430.0)];

/// All boards by one clock.
pub const IN_STEP: [BoardTime; 3] = [clock(0.0, 110.0); 3];

const fn clock(slow_ppm: f64, begins_us: f64) -> BoardTime {
    BoardTime {
        slow_ppm,
        begins_us,
        swing_ppm: 0.0,
        swing_s: 0.0,
    }
}

pub fn model_of(robot: &str) -> Model {
    Model::new(&Robot::built_in(robot).unwrap()).unwrap()
}

pub fn robot_line(model: &Model, seed: u64, times: &[BoardTime]) -> SimulatedLink {
    let robot = model.robot();
    let plant = at_rest(model, robot, &Mismatch::default(), seed, None).unwrap();
    let line = LinkOptions::default();
    SimulatedLink::timed(robot, plant, &line, seed, &in_process, times).unwrap()
}

/// Time, µs, and the states of all boards.
pub type Seen = Vec<(u64, Vec<BoardState>)>;

/// The states of all boards now.
pub fn states(simulation: &Simulation) -> Vec<BoardState> {
    let boards = 0..simulation.boards();
    boards.map(|board| simulation.look_at(board).0).collect()
}

/// What messages call a board, from 0.
pub fn name(board: usize) -> String {
    format!("board {0} (simulated {0:02})", board + 1)
}

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
                states(simulation)
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
    /// What the boards did in their ticks since then.
    pub points: Vec<BoardPoint>,
    /// True time of the disturbance, µs.
    pub at_us: f64,
    /// The boards' states at the end.
    pub last: Vec<BoardState>,
}

impl After {
    /// When a board, from 0, first was in one of these states, s.
    pub fn first_s(&self, board: usize, wanted: &[BoardState]) -> Option<f64> {
        let mut of_it = self.points.iter().filter(|point| point.board == board);
        let found = of_it.find(|point| wanted.contains(&point.state));
        found.map(|point| (point.at_us - self.at_us) * 1e-6)
    }

    /// The boards but this one.
    pub fn others(&self, board: usize) -> impl Iterator<Item = usize> + use<> {
        (0..self.last.len()).filter(move |other| *other != board)
    }
}

/// Boards whose transistors do not pull: each has the host alone. It is not noticed before the next arming.
pub fn without_line(simulation: &mut Simulation) {
    for board in 0..simulation.boards() {
        simulation.set_fault_line_of(board, FaultLineTap::Mute);
    }
}

/// Moves, and at 3 s of the motion does something; `then_us` after the host's end, what the boards do
/// by themselves is looked at.
pub fn disturbed(robot: &str, seed: u64, then_us: u64, act: impl Fn(&mut Simulation)) -> After {
    disturbed_again(robot, seed, then_us, |simulation, since_us| {
        if since_us == 0 {
            act(simulation);
        }
    })
}

/// As [`disturbed`], with the time since the first disturbance, µs, again and again.
pub fn disturbed_again(
    robot: &str,
    seed: u64,
    then_us: u64,
    mut act: impl FnMut(&mut Simulation, u64),
) -> After {
    let model = model_of(robot);
    let link = robot_line(&model, seed, &APART);
    let mut began_us = None;
    let (done, _) = run(&link, &model, &Handle::new(), |simulation, now_us| {
        if began_us.is_none() && simulation.path_ms() >= 3000 {
            began_us = Some(now_us);
            simulation.record_boards();
        }
        if let Some(began_us) = began_us {
            act(simulation, now_us - began_us);
        }
    });
    let at_us = began_us.expect("the motion came to its third second") as f64;
    // What the boards do by themselves after the host has gone.
    let last = link.with(|simulation| {
        let until_us = simulation.now_us() + then_us;
        while simulation.now_us() < until_us {
            let mut unread = vec![Vec::new(); simulation.boards()];
            simulation.advance_all(until_us, &mut unread).unwrap();
        }
        states(simulation)
    });
    After {
        done,
        points: link.with(Simulation::take_boards),
        at_us,
        last,
    }
}
