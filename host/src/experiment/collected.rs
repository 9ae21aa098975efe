//! Calibration data of a simulated machine, by the procedure of a real one: it drives to poses and looks at its tags.

use super::SimulatedRobot;
use crate::calibration::Data;
use crate::calibration::collect::{CollectError, Options, collect};
use crate::motion::Model;
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
