//! A simulated robot calibrated by the project's own calibration.
//!
//! The errors left by a calibration are not independent per anchor: they are small where poses were
//! measured, and partly cancel. So they are not drawn here but result from the normal procedure:
//! the machine as built, the printed board, chosen poses, the joint estimate.

use super::PickError;
use crate::calibration::collect::{CollectError, Options};
use crate::experiment::{self, SimulatedRobot};
use crate::machine::{Controller, Mismatch};
use crate::motion::Model;
use crate::robot::Robot;
use crate::run::RunError;
use mcdpr_protocol::SessionId;
use std::fmt::Display;

/// Poses to measure, and number of candidates.
const POSES: usize = 14;
const CANDIDATES: usize = 100;
/// Sets of poses that are tried if a limit stops the robot on a move: as built it hangs slightly
/// differently from the plan, and some poses are near a limit.
const SETS: u64 = 3;
/// From one set's seed to the next one's: far from the seeds of other machines.
const SET_SEED: u64 = 1_000_003;

/// The robot with the result of a calibration of the machine with this seed. It represents that
/// machine (`kind` as `--machine` names it, as built without) from then on, as after `mcdpr calibrate all --target board`.
///
/// # Errors
/// If the poses cannot be reached, or the estimate is refused.
pub fn calibrated(
    robot: &Robot,
    seed: u64,
    controller: &Controller,
    kind: Option<&str>,
) -> Result<Robot, PickError> {
    calibrated_by(POSES, robot, seed, controller, kind)
}

/// As [`calibrated`], by this many poses; with the robot's inclinometer, if it has one.
///
/// # Errors
/// As [`calibrated`].
pub fn calibrated_by(
    poses: usize,
    robot: &Robot,
    seed: u64,
    controller: &Controller,
    kind: Option<&str>,
) -> Result<Robot, PickError> {
    let failed = |error: &dyn Display| PickError::Calibration {
        reason: error.to_string(),
    };
    let model = Model::new(&experiment::over_board(robot))?;
    let mismatch = kind
        .and_then(Mismatch::named)
        .unwrap_or(Mismatch::as_built());
    let measure = |set: u64| {
        let machine = SimulatedRobot::new(mismatch, seed).controller(controller);
        let options = Options {
            poses,
            candidates: CANDIDATES,
            seed: seed.wrapping_add(set * SET_SEED),
            simulated_seed: Some(seed),
            simulated_machine: kind.map(str::to_owned),
            described: Some(robot.content_hash()),
            session: Some(SessionId(1)),
            ..Options::default()
        };
        experiment::collected(&model, &machine, seed, &options).map_err(|error| match error {
            CollectError::Run(RunError::Interrupted) => RunError::Interrupted.into(),
            error => failed(&error),
        })
    };
    let mut measured = measure(0);
    for set in 1..SETS {
        if matches!(measured, Ok(_) | Err(PickError::Run(RunError::Interrupted))) {
            break;
        }
        measured = measure(set);
    }
    let data = measured?;
    let (robot, _) = experiment::calibrated(robot, &data).map_err(|error| failed(&error))?;
    Ok(robot)
}
