//! True poses of a simulated robot's tags, and the true mounting of its camera.

use crate::machine;
use crate::motion::Model;
use crate::robot::{Robot, Tag, TagPlace};
use mcdpr_core::random::Random;
use mcdpr_kinematics::Pose;
use mcdpr_vision::Camera;
use nalgebra::{Rotation3, Vector3};

/// The true scene. Estimators do not see it.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    /// The true lens.
    pub lens: Camera,
    /// camera_from_platform as it is mounted.
    pub camera_from_platform: Pose,
    /// The true tags.
    pub tags: Vec<Tag>,
    /// Pose of each body of tags.
    pub places: Vec<TagPlace>,
}

/// Height of the floor below the lowest anchor, m.
const FLOOR_M: f64 = 0.725;
/// Where the tool reaches below that, tags lie so far below its box, m.
const BELOW_BOX_M: f64 = 0.3;
/// Position of the tags between the middle of the anchors and the tool's home, as a share.
const TOWARDS_HOME: f64 = 0.7;
/// Distance between loose bodies on the floor, m.
const APART_M: f64 = 0.14;

impl Scene {
    /// The robot's tags face up where the robot file puts them. Without that they lie on the floor between
    /// the middle of its anchors and the place where its tool hangs at home, so that they are seen from both.
    /// Bodies lie in a row, each turned and shifted a little. The camera is off its nominal mounting by up to
    /// `mounting_m` and `mounting_rad` per axis.
    #[must_use]
    pub fn on_floor(robot: &Robot, mounting_m: f64, mounting_rad: f64, seed: u64) -> Self {
        let mut random = Random::new(seed ^ 0x7363_656E);
        let middle = robot
            .surroundings
            .target_m
            .unwrap_or_else(|| default_target_m(robot));
        let mut bodies: Vec<u32> = robot.tags.iter().map(|tag| tag.body).collect();
        bodies.sort_unstable();
        bodies.dedup();
        let count = bodies.len() as f64;
        let places = bodies
            .into_iter()
            .enumerate()
            .map(|(i, body)| {
                let across = (i as f64 - (count - 1.0) / 2.0) * APART_M;
                let at = Vector3::new(
                    middle.x + random.within(0.01),
                    middle.y + across + random.within(0.01),
                    middle.z,
                );
                // Face up: a tag's z axis points into the floor.
                let turn = 0.5 + random.within(0.3);
                let face_up = Rotation3::from_euler_angles(std::f64::consts::PI, 0.0, turn);
                let tilt = Vector3::from_fn(|_, _| random.within(0.02));
                TagPlace {
                    body,
                    world_from_body: Pose::new(at, Rotation3::new(tilt) * face_up),
                }
            })
            .collect();
        let shift = Vector3::from_fn(|_, _| random.within(mounting_m));
        let turn = Vector3::from_fn(|_, _| random.within(mounting_rad));
        Self {
            lens: robot.camera.lens,
            camera_from_platform: robot.camera.camera_from_platform.displaced(&shift, &turn),
            tags: robot.tags.clone(),
            places,
        }
    }

    /// The scene of a robot on the simulator. A robot that was calibrated there has the scene that
    /// it was calibrated in; `seed` decides for any other, whose camera is off by up to 5 mm and
    /// 0.02 rad per axis.
    #[must_use]
    pub fn of(robot: &Robot, seed: u64) -> Self {
        let calibrated = robot.calibrated.as_ref();
        let known = calibrated.and_then(|c| Some((&c.designed, c.simulated_seed?)));
        let (machine, seed) = known.unwrap_or((robot, seed));
        Self::on_floor(machine, 5e-3, 0.02, seed)
    }

    /// Pose of the simulator's world frame in the world frame that a calibrated robot knows: they
    /// agree at the first body of tags; for a robot in a plane, which cannot find where its camera is across that, they
    /// agree there at the anchors, on average. `None` for a robot that was not calibrated on the
    /// simulator.
    #[must_use]
    pub(crate) fn known_from_true(robot: &Robot) -> Option<Pose> {
        let (machine, mismatch, seed) = machine::of_calibration(robot, 0)?;
        let built = machine::plant_params(machine, &mismatch, seed);
        let anchors_m: Vec<_> = built.cables.iter().map(|c| c.anchor_m.into()).collect();
        Self::of(robot, seed).known_from_this(robot, &anchors_m)
    }

    /// The same, of a robot that was calibrated over these tags, of a machine whose true anchors are `true_anchors_m`.
    #[must_use]
    pub(crate) fn known_from_this(
        &self,
        robot: &Robot,
        true_anchors_m: &[Vector3<f64>],
    ) -> Option<Pose> {
        let place = robot.calibrated.as_ref()?.places.first()?;
        let true_place = self.body(place.body)?;
        let agreed = place.world_from_body.compose(&true_place.inverse());
        Some(anchors_agree_across(robot, agreed, true_anchors_m))
    }

    /// The true pose of a body of tags.
    #[must_use]
    pub fn body(&self, number: u32) -> Option<&Pose> {
        let found = self.places.iter().find(|place| place.body == number);
        found.map(|place| &place.world_from_body)
    }
}

/// A pose of the true world frame in the one that a robot knows, shifted across the robot's plane, if it has one, so
/// that the anchors (`true_anchors_m`, true world frame, m) are on average where it knows them.
fn anchors_agree_across(
    robot: &Robot,
    known_from_true: Pose,
    true_anchors_m: &[Vector3<f64>],
) -> Pose {
    let model = Model::new(robot).ok();
    let Some(normal) = model.and_then(|model| model.holding().freedom().normal()) else {
        return known_from_true;
    };
    let pairs = robot.cables.iter().zip(true_anchors_m);
    let off_m = pairs.map(|(known, true_m)| {
        let seen_m = known_from_true.transform(true_m);
        normal.dot(&(known.anchor_in_world_m - seen_m))
    });
    let shift_m = normal * (off_m.sum::<f64>() / robot.cables.len().max(1) as f64);
    known_from_true.displaced(&shift_m, &Vector3::zeros())
}

/// Where the tags lie if the robot file does not say it, world, m. A frame whose lowest anchors are below all that the
/// tool reaches stands on them.
fn default_target_m(robot: &Robot) -> Vector3<f64> {
    let [low, high] = robot.anchor_box_in_world_m();
    let middle = (low + high) / 2.0;
    let mut target_m = middle + (robot.tool.home_in_world_m - middle) * TOWARDS_HOME;
    target_m.z = low.z - FLOOR_M;
    if let Some([box_low, _]) = robot.limits.box_in_world_m {
        if low.z < box_low.z {
            target_m.z = low.z;
        } else if target_m.z > box_low.z {
            target_m.z = box_low.z - BELOW_BOX_M;
        }
    }
    target_m
}
