//! The calibration of a simulated machine, by the procedure of a real one: it drives to poses, looks at its tags, and is
//! described by the joint estimate.

use super::SimulatedRobot;
use crate::calibration::collect::{CollectError, Options, collect};
use crate::calibration::simulate::Target;
use crate::calibration::{Answer, Data, Options as Estimator, joint, result, target};
use crate::motion::Model;
use crate::robot::Robot;
use crate::sight::{Scene, SimulatedTags, SimulatedTilt, WithTilt};

/// Noise of a tag's corner in one picture, px.
const CORNER_PX: f64 = 0.1;

/// Collects over the tags of the model's robot, with its inclinometer, if it has one. `seed` draws the places of the tags
/// and the noise of the looks.
///
/// # Errors
/// Those of [`collect`], and a machine that cannot hang at home.
pub(crate) fn collected(
    model: &Model,
    machine: &SimulatedRobot,
    seed: u64,
    options: &Options,
) -> Result<Data, CollectError> {
    let link = machine.at_home(model)?;
    let robot = model.robot();
    let tilt = robot.imu;
    let mut tags = WithTilt {
        tags: SimulatedTags::new(link.clone(), Scene::of(robot, seed), CORNER_PX, seed),
        tilt: tilt.map(|imu| SimulatedTilt::new(link.clone(), imu.noise_rad, seed)),
    };
    collect(model, link, &mut tags, options, None, |_| Ok(()), |_| {})
}

/// The robot over the board of tags.
#[must_use]
pub(crate) fn over_board(robot: &Robot) -> Robot {
    let mut over_board = robot.clone();
    over_board.tags = target::tags(Target::Board);
    over_board
}

/// The joint estimate, as `calibrate all` makes it.
///
/// # Errors
/// Its refusal, in words.
fn estimated(data: &Data) -> Result<Answer, String> {
    let estimator = Estimator {
        closer_looks: true,
        ..Estimator::default()
    };
    joint(data, &estimator).map_err(|error| error.to_string())
}

/// The robot by what the data say, and the estimate.
///
/// # Errors
/// The estimate's refusal, in words.
pub(crate) fn calibrated(robot: &Robot, data: &Data) -> Result<(Robot, Answer), String> {
    let answer = estimated(data)?;
    let document = result::document(robot, data, &answer).map_err(|error| error.to_string())?;
    let robot = result::applied(robot, &document).map_err(|error| error.to_string())?;
    Ok((robot, answer))
}
