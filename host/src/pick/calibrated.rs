//! A simulated robot that went through the project's own calibration.
//!
//! What a calibration leaves is no independent error of each anchor: it is small where poses were
//! measured, and in directions that cancel. So it is not drawn here but had the way that any robot
//! gets it: the machine as it was built, the printed board, chosen poses, the joint estimate.

use super::PickError;
use crate::calibration::collect::{Options, collect};
use crate::calibration::simulate::Target;
use crate::calibration::{Options as Estimator, joint, result, target};
use crate::experiment::SimulatedRobot;
use crate::machine::{Controller, Mismatch};
use crate::motion::Model;
use crate::robot::Robot;
use crate::sight::{Scene, SimulatedTags};
use mcdpr_protocol::SessionId;
use std::fmt::Display;

/// Poses that are measured, out of so many that can be.
const POSES: usize = 14;
const CANDIDATES: usize = 100;
/// Sets of poses that are tried where a limit stops the robot on its way to one: as built it hangs a
/// little otherwise than planned, and some poses are near a limit.
const SETS: u64 = 3;
/// From one set's seed to the next one's: far from the seeds of other machines.
const SET_SEED: u64 = 1_000_003;
/// Noise of a tag's corner in one picture, px.
const CORNER_PX: f64 = 0.1;

/// The robot with what a calibration of the machine with this seed finds. It stands for that machine
/// from then on, as after `mcdpr calibrate all --target board`.
///
/// # Errors
/// Where the poses cannot be driven to, or the estimate is refused.
pub fn calibrated(robot: &Robot, seed: u64, controller: &Controller) -> Result<Robot, PickError> {
    let failed = |error: &dyn Display| PickError::Calibration {
        reason: error.to_string(),
    };
    let mut with_board = robot.clone();
    with_board.tags = target::tags(Target::Board);
    let model = Model::new(&with_board)?;
    let mismatch = Mismatch::as_built();
    let measure = |set: u64| {
        let link = SimulatedRobot::new(mismatch, seed)
            .controller(controller)
            .at_home(&model)?;
        let scene = Scene::of(&with_board, seed);
        let mut tags = SimulatedTags::new(link.clone(), scene, CORNER_PX, seed);
        let options = Options {
            poses: POSES,
            candidates: CANDIDATES,
            seed: seed.wrapping_add(set * SET_SEED),
            simulated_seed: Some(seed),
            described: Some(robot.content_hash()),
            ..Options::default()
        };
        let line = (link, Some(SessionId(1)));
        let keep = |_: &_| Ok(());
        collect(&model, line, &mut tags, &options, None, keep, |_| {})
            .map_err(|error| failed(&error))
    };
    let mut measured = measure(0);
    for set in 1..SETS {
        if measured.is_ok() {
            break;
        }
        measured = measure(set);
    }
    let data = measured?;
    let estimator = Estimator {
        closer_looks: true,
        ..Estimator::default()
    };
    let answer = joint(&data, &estimator).map_err(|error| failed(&error))?;
    let document = result::document(robot, &data, &answer).map_err(|error| failed(&error))?;
    result::applied(robot, &document).map_err(|error| failed(&error))
}
