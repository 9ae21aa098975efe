//! The test cycles on a simulated robot that is off from its description.

use super::cube::ORDER;
use super::{
    Arrival, Cube, DistanceFigures, POSES, PathFigures, PoseFigures, judge_arrival, judge_distance,
    judge_path, judge_pose,
};
use crate::control::Handle;
use crate::experiment::SimulatedRobot;
use crate::link::SimulatedLink;
use crate::machine::{Controller, Mismatch};
use crate::motion::{Model, Task};
use crate::run::{Homing, NoStore, Recorder, RunError, Session};
use mcdpr_protocol::SessionId;
use mcdpr_simulator::Simulation;
use nalgebra::Vector3;
use serde::Serialize;
use thiserror::Error;

/// Wait at each pose, s. A stabilisation time near it means that the tool did not settle.
pub(crate) const WAIT_S: f64 = 3.0;
/// The position attained is the mean over the last part of the wait, s.
const LOOK_S: f64 = 1.0;
/// Time between two entries of a trace, s.
const TICK_S: f64 = 1e-3;
/// Nearer than this the tool is at a pose, m.
const THERE_M: f64 = 1e-6;
/// Cycles along the line from P2 to P4 (ISO 9283:1998, 8.2).
const PATH_CYCLES: usize = 10;

/// How a test is made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Test {
    /// The cube.
    pub cube: Cube,
    /// Cycles over the five poses.
    pub cycles: usize,
    /// Speed of the tool, m/s.
    pub speed_mps: f64,
    /// Half width of the limit band of overshoot and stabilisation, m.
    pub band_m: f64,
}

/// The characteristics of one robot.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Figures {
    /// At P1 to P5.
    pub poses: Vec<PoseFigures>,
    /// Between P2 and P4.
    pub distance: DistanceFigures,
    /// Along the line from P2 to P4; `None` for a tracker's file, which has poses only.
    pub path: Option<PathFigures>,
    /// The greatest of all arrivals; `None` for a tracker's file.
    pub arrival: Option<Arrival>,
}

/// Why a test has no figures.
#[derive(Debug, Error)]
pub enum TestError {
    /// The robot did not complete it.
    #[error(transparent)]
    Run(#[from] RunError),
    /// No spread can be computed.
    #[error("{0} cycles are too few; at least 2 are needed, the standard asks for 30")]
    Few(usize),
}

/// Runs the test on the machine of this seed.
///
/// # Errors
/// [`TestError`]; [`RunError::Interrupted`] where the handle ordered a stop.
pub fn run(
    model: &Model,
    mismatch: &Mismatch,
    seed: u64,
    controller: &Controller,
    test: &Test,
    handle: &Handle,
) -> Result<Figures, TestError> {
    let robot = SimulatedRobot::new(*mismatch, seed).controller(controller);
    let link = robot.at_home(model)?;
    let home_m = model.robot().tool.home_in_world_m;
    let homing = Homing::Place(home_m);
    let mut session = Session::open(model, link.clone(), SessionId(1), handle, homing, &NoStore)?;
    session.arm()?;
    link.with(Simulation::record_truth);
    let poses_m = test.cube.poses_m();
    let mut drive = Drive {
        session: &mut session,
        link: &link,
        speed_mps: test.speed_mps,
    };
    // The robot may stand there already.
    if (drive.session.tool_m() - poses_m[0]).norm() > THERE_M {
        drive.go(&poses_m[0])?;
    }
    let mut attained_m: [Vec<Vector3<f64>>; POSES] = Default::default();
    let mut greatest = Arrival {
        overshoot_m: 0.0,
        stabilisation_s: 0.0,
    };
    for _ in 0..test.cycles {
        for pose in ORDER.iter().skip(1) {
            let (way, at_m) = drive.go(&poses_m[*pose])?;
            attained_m[*pose].push(at_m);
            if let Some(arrival) = judge_arrival(&way, TICK_S, &at_m, test.band_m) {
                greatest.overshoot_m = greatest.overshoot_m.max(arrival.overshoot_m);
                greatest.stabilisation_s = greatest.stabilisation_s.max(arrival.stabilisation_s);
            }
        }
    }
    let mut ways = Vec::new();
    for _ in 0..PATH_CYCLES {
        drive.go(&poses_m[1])?;
        ways.push(drive.go(&poses_m[3])?.0);
    }
    session.disarm()?;
    let found = figures(&test.cube, &attained_m).ok_or(TestError::Few(test.cycles))?;
    Ok(Figures {
        path: judge_path([&poses_m[1], &poses_m[3]], &ways),
        arrival: Some(greatest),
        ..found
    })
}

/// The figures of positions attained at P1 to P5; `None` for fewer than two cycles.
#[must_use]
pub fn figures(cube: &Cube, attained_m: &[Vec<Vector3<f64>>; POSES]) -> Option<Figures> {
    let commanded_m = cube.poses_m();
    let poses = commanded_m.iter().zip(attained_m);
    Some(Figures {
        poses: poses
            .map(|(c, a)| judge_pose(c, a))
            .collect::<Option<_>>()?,
        distance: judge_distance(
            [&commanded_m[1], &commanded_m[3]],
            [&attained_m[1], &attained_m[3]],
        )?,
        path: None,
        arrival: None,
    })
}

struct Drive<'s, 'm> {
    session: &'s mut Session<'m, SimulatedLink>,
    link: &'s SimulatedLink,
    speed_mps: f64,
}

impl Drive<'_, '_> {
    /// Goes straight to a place and waits there: the true way of the tool, wait included, and its
    /// mean place at the end of the wait, world, m.
    fn go(&mut self, to_m: &Vector3<f64>) -> Result<(Vec<Vector3<f64>>, Vector3<f64>), RunError> {
        self.link.with(Simulation::take_trace);
        let plan = self
            .session
            .plan(Task::go_to("pose", *to_m)?, Some(self.speed_mps))?;
        self.session
            .follow(&plan, &mut Recorder::default(), |_| {})?;
        let now_us = self.session.client().now_us();
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a second"
        )]
        self.session.client().pump(now_us + (WAIT_S * 1e6) as u64)?;
        let trace = self.link.with(Simulation::take_trace);
        let way: Vec<Vector3<f64>> = trace
            .iter()
            .map(|point| Vector3::from(point.truth.tool_position_m))
            .collect();
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a second"
        )]
        let look = ((LOOK_S / TICK_S) as usize).min(way.len());
        let last = way.get(way.len() - look..).unwrap_or_default();
        let at_m = super::mean(last).unwrap_or(*to_m);
        Ok((way, at_m))
    }
}
