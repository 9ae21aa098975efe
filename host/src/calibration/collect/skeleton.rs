//! Calibration data of a robot file, to which poses are added as they are measured.

use super::super::data::{Data, Limits, Noise, NominalRobot, Origin, Tag, View};
use super::super::plan::Candidate;
use super::super::pnp::{Square, sightings_of};
use super::still::MeanTag;
use super::{CollectError, Still, observation, still};
use crate::motion::StaticState;
use crate::robot::Robot;
use crate::stamp::utc_stamp;
use mcdpr_kinematics::{Cable, Pose};
use mcdpr_vision::Camera;

/// Noise of the encoders as used here: counts of 0.03 mm and how cable lies on a drum, m.
const ENCODER_M: f64 = 2e-5;
/// Noise of a mean tension: sensor, its zero, friction, N.
const TENSION_N: f64 = 0.1;
/// Error of a frame relative to its drawing if not stated otherwise, m.
pub(crate) const ANCHOR_TOLERANCE_M: f64 = 5e-3;

/// Data in progress.
#[derive(Debug, Clone)]
pub(crate) struct Sketch {
    /// The data so far. Bodies and tags are those seen so far.
    pub data: Data,
    robot: Robot,
    /// Number in the robot file of each body of the data.
    bodies: Vec<u32>,
    home_m: Vec<f64>,
}

/// Seed and kind of a simulated machine; `None` for a real one, and for one as built.
pub(super) type Simulated = (Option<u64>, Option<String>);

impl Sketch {
    /// Data without poses; `hash` is that of the robot's description.
    #[must_use]
    pub fn new(robot: &Robot, hash: u32, home: &StaticState, machine: Simulated) -> Self {
        Self {
            data: empty(robot, hash, machine),
            robot: robot.clone(),
            bodies: Vec::new(),
            home_m: home.paid_out_m.clone(),
        }
    }

    /// Data begun earlier.
    ///
    /// # Errors
    /// If they belong to another robot.
    pub fn resumed(
        robot: &Robot,
        hash: u32,
        data: Data,
        machine: Simulated,
    ) -> Result<Self, CollectError> {
        of_this_robot(robot, hash, &data)?;
        let origin = data.origin.as_ref();
        let begun = origin.map_or((None, None), |origin| {
            (origin.simulated_seed, origin.simulated_machine.clone())
        });
        if begun != machine {
            let name = |(seed, kind): &Simulated| {
                seed.map_or("a real machine".to_owned(), |n| {
                    let kind = kind.as_deref().unwrap_or("as-built");
                    format!("the simulated machine of seed {n} ({kind})")
                })
            };
            return Err(CollectError::impossible(
                format!(
                    "the data were begun on {}, this is {}",
                    name(&begun),
                    name(&machine)
                ),
                "resume on the same machine (--on, --seed, --machine), or start again without --resume",
            ));
        }
        let unknown = data
            .tags
            .iter()
            .find(|tag| robot.tags.iter().all(|known| known.id != tag.id));
        if let Some(tag) = unknown {
            return Err(CollectError::impossible(
                format!(
                    "the data were begun with tag {}, which the target has not",
                    tag.id
                ),
                "resume with the same --target",
            ));
        }
        let bodies = (0..data.world_from_body.len())
            .filter_map(|index| {
                let tag = data.tags.iter().find(|tag| tag.body == index)?;
                robot.tags.iter().find(|t| t.id == tag.id).map(|t| t.body)
            })
            .collect();
        let model = crate::motion::Model::new(robot)?;
        let home = model.rest_at_home()?;
        Ok(Self {
            data,
            robot: robot.clone(),
            bodies,
            home_m: home.paid_out_m,
        })
    }

    /// Edge of a tag of the robot file, m.
    #[must_use]
    pub fn size_m(&self, id: u32) -> Option<f64> {
        let tag = self.robot.tags.iter().find(|tag| tag.id == id);
        tag.map(|tag| tag.size_m)
    }

    /// Adds what was measured; `near` is where the platform should be. A body of tags that was not
    /// seen before gets its start value from this picture.
    pub fn add(&mut self, near: &Pose, still: &Still) {
        let mut views = Vec::new();
        for MeanTag { id, corners_px } in &still.tags {
            let number = self.robot.tags.iter().find(|tag| tag.id == *id);
            let Some(number) = number.map(|tag| tag.body) else {
                continue;
            };
            if self.body(number, near, still).is_none() {
                continue;
            }
            let Some(index) = self.data.tags.iter().position(|t| t.id == *id) else {
                continue;
            };
            views.push(View {
                tag: index,
                corners_px: *corners_px,
            });
        }
        if still.tilt_rad.is_some() {
            let imu = self.robot.imu.as_ref();
            self.data.noise.tilt_rad = imu.map(|imu| imu.noise_rad);
        }
        let nominal = self.data.noise.corner_px;
        let factor = (still.sigma_px / nominal).max(1.0);
        let seen = observation(&self.home_m, still, views, factor);
        self.data.poses.push(seen);
    }

    /// Index of a body of the robot file in the data.
    fn body(&mut self, number: u32, near: &Pose, still: &Still) -> Option<usize> {
        if let Some(index) = self.bodies.iter().position(|b| *b == number) {
            return Some(index);
        }
        let on_body: Vec<Square> = still
            .tags
            .iter()
            .filter_map(|MeanTag { id, corners_px }| {
                let mut tags = self.robot.tags.iter();
                let tag = tags.find(|tag| tag.id == *id && tag.body == number)?;
                Some(Square {
                    corners_in_body_m: tag.corners_in_body_m,
                    corners_px: *corners_px,
                })
            })
            .collect();
        let camera_from_platform = self.data.camera_from_platform;
        let world_from_camera = near.compose(&camera_from_platform.inverse());
        // Of two that look alike, the one that is more level: tags lie on floors and tables.
        let found = sightings_of(&self.data.camera, &on_body);
        let level = |pose: &Pose| pose.rotation.matrix()[(2, 2)].abs();
        let place = found
            .iter()
            .map(|s| world_from_camera.compose(&s.camera_from_body))
            .max_by(|a, b| level(a).total_cmp(&level(b)))?;
        let index = self.bodies.len();
        self.bodies.push(number);
        self.data.world_from_body.push(place);
        let on_body = self.robot.tags.iter().filter(|tag| tag.body == number);
        self.data.tags.extend(on_body.map(|tag| Tag {
            id: tag.id,
            size_m: tag.size_m,
            body: index,
            corners_in_body_m: tag.corners_in_body_m,
        }));
        Some(index)
    }

    /// The measured poses as candidates of a plan.
    #[must_use]
    pub fn candidates(&self, held: usize) -> Vec<Candidate> {
        let data = &self.data;
        let place = |pose: &super::super::data::Observation| {
            let view = pose.views.first()?;
            let tag = data.tags.get(view.tag)?;
            let squares: Vec<Square> = pose
                .views
                .iter()
                .filter(|v| data.tags.get(v.tag).is_some_and(|t| t.body == tag.body))
                .filter_map(|v| {
                    Some(Square {
                        corners_in_body_m: data.tags.get(v.tag)?.corners_in_body_m,
                        corners_px: v.corners_px,
                    })
                })
                .collect();
            let found = sightings_of(&data.camera, &squares);
            let camera = found.first()?.camera_from_body.inverse();
            let world_from_camera = data.world_from_body.get(tag.body)?.compose(&camera);
            Some(world_from_camera.compose(&data.camera_from_platform))
        };
        data.poses
            .iter()
            .filter_map(|pose| {
                Some(Candidate {
                    pose: place(pose)?,
                    tensions_n: pose.tension_n.clone()?,
                    held,
                    views: pose.views.clone(),
                })
            })
            .collect()
    }
}

/// Refuses data of another robot than the one whose description has this hash.
///
/// # Errors
/// [`CollectError::Impossible`] that names both.
pub(crate) fn of_this_robot(robot: &Robot, hash: u32, data: &Data) -> Result<(), CollectError> {
    match &data.origin {
        Some(origin) if origin.robot_hash == hash => Ok(()),
        Some(origin) => Err(CollectError::impossible(
            format!(
                "the data were collected on robot {} with hash {:08x}, this is {} with hash {hash:08x}",
                origin.robot, origin.robot_hash, robot.name
            ),
            "give the robot file that the data were collected with, or collect anew",
        )),
        None => Err(CollectError::impossible(
            "the data do not say which robot they are of",
            "collect data with `mcdpr calibrate collect`, or only look at the answer: `mcdpr \
             calibrate all --data FILE`",
        )),
    }
}

/// The robot file's limits, its box moved from the tool to the platform's origin above it.
fn limits(robot: &Robot) -> Limits {
    let corners = robot.search_box_in_world_m();
    let winches = robot.winches.iter().map(|winch| winch.tension_max_n);
    let most_n = winches.fold(robot.limits.tension_max_n, f64::min);
    // Slack cables cannot be planned for, even if the file allows them.
    let least_n = robot.limits.tension_min_n.max(0.01 * most_n);
    Limits {
        box_in_world_m: corners.map(|corner| corner - robot.tool.tcp_in_platform_m),
        tension_n: [least_n, most_n],
        held_n: [
            robot.tension.floor_n.max(least_n),
            robot.tension.ceiling_n.min(most_n),
        ],
        tilt_max_rad: robot.limits.tilt_max_rad,
    }
}

fn empty(robot: &Robot, hash: u32, (simulated_seed, simulated_machine): Simulated) -> Data {
    let camera: Camera = robot.camera.lens;
    let ea: Vec<f64> = robot.cables.iter().map(|cable| cable.ea_n).collect();
    let origin = Origin {
        robot: robot.name.clone(),
        robot_hash: hash,
        simulated_seed,
        simulated_machine,
        date: utc_stamp(),
    };
    Data {
        id: format!("{}-{}", origin.robot, origin.date),
        robot: NominalRobot {
            cables: robot
                .cables
                .iter()
                .map(|cable| Cable {
                    anchor_m: cable.anchor_in_world_m,
                    swivel_axis: cable.swivel_axis_in_world,
                    pulley_radius_m: cable.pulley_radius_m,
                    attachment_m: cable.attachment_in_platform_m,
                })
                .collect(),
            anchor_half_tolerance_m: ANCHOR_TOLERANCE_M,
            mass_kg: robot.platform.mass_kg,
            center_of_mass_m: robot.platform.center_of_mass_m,
            home: 0,
            routing_m: robot.cables.iter().map(|c| c.routing_length_m).collect(),
            compliance_per_n: ea.iter().map(|ea| 1.0 / ea).sum::<f64>() / ea.len().max(1) as f64,
            limits: Some(limits(robot)),
        },
        camera,
        tags: Vec::new(),
        noise: Noise {
            encoder_m: ENCODER_M,
            corner_px: still::CORNER_FLOOR_PX * 1.2,
            tension_n: Some(TENSION_N),
            tilt_rad: None,
        },
        world_from_body: Vec::new(),
        camera_from_platform: robot.camera.camera_from_platform,
        poses: Vec::new(),
        at_rest: true,
        holdout: Vec::new(),
        origin: Some(origin),
    }
}
