//! Calibration data of a known robot, to test the estimators: equilibrium poses of the paper's
//! robot, with errors of its anchors, a camera on the platform and tags on the floor.
//!
//! Geometry and statics are those of the kinematics crate, which the estimators use too: this tests
//! the estimation, not the model.

use super::data::{Data, Noise, NominalRobot, Observation, Tag, View};
use super::fit::Options;
use super::plan;
use super::space::Space;
use super::unknowns::Priors;
use super::views::{SEEN_PX, views_within};
use mcdpr_core::random::Random;
use mcdpr_kinematics::{Cable, Platform, Pose, Robot, four_cables};
use mcdpr_vision::Camera;
use nalgebra::{Rotation3, Vector3};

/// What is on the floor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Target {
    /// One tag of 100 mm.
    Tag,
    /// A rigid board of 3 x 3 tags of 80 mm, 110 mm apart.
    Board,
    /// Three loose tags of 80 mm, each a separate body.
    Loose,
}

/// A true effect in the data that their description does not mention.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Silent {
    /// The tags are larger than stated by this part.
    pub tag: f64,
    /// The lens's k1.
    pub k1: f64,
    /// The drums are larger than assumed by this part.
    pub drum: f64,
    /// 1/EA of the cables, 1/N.
    pub compliance_per_n: f64,
    /// Each pulley loses up to this part of the tension, with either sign (hysteresis).
    pub loss: f64,
    /// Part of the measurements that are outliers.
    pub outliers: f64,
}

/// What to simulate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Setup {
    /// What is on the floor.
    pub target: Target,
    /// Number of poses.
    pub poses: usize,
    /// Noise of each corner coordinate, px.
    pub corner_px: f64,
    /// Anchors lie within +- this of nominal per coordinate, m.
    pub anchor_m: f64,
    /// Noise of each encoder length, m.
    pub encoder_m: f64,
    /// Poses as in the paper's simulation: any position and attitude, without regard to
    /// equilibrium.
    pub free_poses: bool,
    /// Choose the poses out of this many reachable ones (I-optimal); 0 takes them at random.
    pub chosen_from: usize,
    /// Draw the parameters that the estimators hold by priors from these priors (pulley radii,
    /// attachments, drums, lens, tag size, mass, centre of mass), instead of leaving them as
    /// stated.
    pub drawn: bool,
    /// Effects that the data's description does not mention.
    pub silent: Silent,
    /// Seed of everything random.
    pub seed: u64,
}

impl Default for Setup {
    fn default() -> Self {
        Self {
            target: Target::Board,
            poses: 20,
            corner_px: 0.1,
            anchor_m: 5e-3,
            encoder_m: 5e-5,
            free_poses: false,
            chosen_from: 0,
            drawn: false,
            silent: Silent::default(),
            seed: 1,
        }
    }
}

/// The robot behind the data.
#[derive(Debug, Clone)]
pub struct Truth {
    /// The true cables.
    pub robot: Robot<4>,
    /// Lengths when the encoders read zero, m.
    pub initial_length_m: [f64; 4],
    /// world_from_body.
    pub world_from_body: Vec<Pose>,
    /// camera_from_platform.
    pub camera_from_platform: Pose,
    /// True poses of the data, world_from_platform.
    pub poses: Vec<Pose>,
    /// True poses of the held-out set, world_from_platform.
    pub holdout: Vec<Pose>,
    /// Length per reading.
    pub drum_scale: f64,
}

/// The paper's robot with nominal anchors (Table 5, theoretical values) and 1 kg.
#[must_use]
pub(crate) fn nominal_robot() -> NominalRobot {
    let anchors = [
        [25.0, -370.0],
        [40.0, 385.0],
        [645.0, 370.0],
        [630.0, -385.0],
    ];
    let cables = four_cables();
    NominalRobot {
        cables: cables
            .cables()
            .iter()
            .zip(anchors)
            .map(|(cable, [x, y])| Cable {
                anchor_m: Vector3::new(x, y, 24.0) * 1e-3,
                ..*cable
            })
            .collect(),
        anchor_half_tolerance_m: 5e-3,
        mass_kg: 1.0,
        center_of_mass_m: Vector3::new(0.0, 0.0, -0.03),
        home: 0,
        routing_m: vec![0.0; 4],
        compliance_per_n: 0.0,
        limits: None,
    }
}

fn robot_of(nominal: &NominalRobot, anchors_off: &[Vector3<f64>]) -> Option<Robot<4>> {
    let cables: Vec<Cable> = nominal
        .cables
        .iter()
        .zip(anchors_off)
        .map(|(cable, off)| Cable {
            anchor_m: cable.anchor_m + off,
            ..*cable
        })
        .collect();
    let platform = Platform {
        mass_kg: nominal.mass_kg,
        center_of_mass_m: nominal.center_of_mass_m,
        inertia_kg_m2: None,
    };
    Robot::new(<[Cable; 4]>::try_from(cables).ok()?, platform).ok()
}

/// The tags of a target and the number of bodies.
#[must_use]
pub(crate) fn tags_of(target: Target) -> (Vec<Tag>, usize) {
    let square = |id: u32, size_m: f64, x: f64, y: f64, body: usize| {
        let h = size_m / 2.0;
        let corner = |sx: f64, sy: f64| Vector3::new(x + sx * h, y + sy * h, 0.0);
        Tag {
            id,
            size_m,
            body,
            corners_in_body_m: [
                corner(-1.0, -1.0),
                corner(1.0, -1.0),
                corner(1.0, 1.0),
                corner(-1.0, 1.0),
            ],
        }
    };
    match target {
        Target::Tag => (vec![square(0, 0.1, 0.0, 0.0, 0)], 1),
        Target::Board => {
            let at = |i: u32| (f64::from(i) - 1.0) * 0.11;
            let tags = (0..9).map(|i| square(i, 0.08, at(i / 3), at(i % 3), 0));
            (tags.collect(), 1)
        }
        Target::Loose => (
            (0..3)
                .map(|i| square(i, 0.08, 0.0, 0.0, i as usize))
                .collect(),
            3,
        ),
    }
}

/// The space of the paper's robot, which is the one that is simulated here: 25 degrees of tilt at
/// most, and tensions up to its sensors' 39 N.
const PAPER_SPACE: Space = Space {
    middle_m: Vector3::new(0.335, 0.0, -0.295),
    half_m: Vector3::new(0.19, 0.19, 0.235),
    tension_n: [0.5, 39.0],
    held_n: [0.5, 28.0],
    tilt_max_rad: 25.0 * std::f64::consts::PI / 180.0,
};

impl Truth {
    /// Evaluates the methods at these poses (world_from_platform) instead of random ones.
    pub fn judge_at(&mut self, data: &mut Data, poses: &[Pose]) {
        let Some(body) = self.world_from_body.first() else {
            return;
        };
        let from_body = body.inverse();
        data.holdout = poses.iter().map(|pose| from_body.compose(pose)).collect();
        self.holdout = poses.to_vec();
    }
}

/// The machine behind the data, where it differs from its description.
struct Machine {
    made: NominalRobot,
    silent: Silent,
    camera: Camera,
}

impl Machine {
    /// Draws the parameters that the estimators hold by priors, with a random generator of its own:
    /// the rest of the data does not change.
    fn new(setup: &Setup, nominal: &NominalRobot, camera: Camera) -> Self {
        let mut own = Random::new(setup.seed ^ 0x6472_6177);
        let priors = Priors::default();
        let mut it = Self {
            made: nominal.clone(),
            silent: setup.silent,
            camera,
        };
        if setup.drawn {
            for cable in &mut it.made.cables {
                cable.pulley_radius_m += priors.radius_m * own.normal();
                cable.attachment_m += Vector3::from_fn(|_, _| priors.attachment_m * own.normal());
            }
            it.made.mass_kg *= 1.0 + priors.mass * own.normal();
            it.made.center_of_mass_m +=
                Vector3::from_fn(|_, _| priors.center_of_mass_m * own.normal());
            it.silent.drum += priors.drum * own.normal();
            it.silent.tag += priors.tag * own.normal();
            it.silent.k1 += priors.k1 * own.normal();
        }
        it.camera.distortion[0] = it.silent.k1;
        if setup.drawn {
            let focal = 1.0 + priors.focal * own.normal();
            it.camera.focal_px = it.camera.focal_px.map(|f| f * focal);
            let center_px = it.camera.center_px;
            it.camera.center_px = center_px.map(|c| c + priors.center_px * own.normal());
        }
        it
    }
}

/// Where the bodies of tags lie on the floor: world_from_body.
fn places_of(target: Target) -> Vec<Pose> {
    // Tags lie face up: AprilTag's z axis points into the floor.
    let down = |x: f64, y: f64, yaw: f64| {
        Pose::new(
            Vector3::new(x, y, -0.7),
            Rotation3::from_euler_angles(std::f64::consts::PI, 0.0, yaw),
        )
    };
    match target {
        Target::Loose => vec![
            down(0.24, -0.05, 0.2),
            down(0.36, 0.08, 1.0),
            down(0.43, -0.06, -0.7),
        ],
        Target::Tag | Target::Board => vec![down(0.32, 0.0, 0.53)],
    }
}

/// The poses of the data, one after another.
struct Poses<'a> {
    setup: &'a Setup,
    robot: &'a Robot<4>,
    /// Chosen poses, the next one last.
    planned: Vec<plan::Candidate>,
}

impl<'a> Poses<'a> {
    /// Poses chosen for the nominal robot, driven to with the true one: it hangs slightly
    /// differently.
    fn new(setup: &'a Setup, robot: &'a Robot<4>, data: &Data) -> Option<Self> {
        let mut planned = Vec::new();
        if setup.chosen_from > 0 {
            let (space, seed) = (&PAPER_SPACE, setup.seed);
            let all = plan::candidates(data, space, setup.chosen_from, seed.wrapping_add(7))?;
            let work = plan::work_poses(data, space, 100, seed)?;
            let plan = plan::choose(data, space, &all, &work, setup.poses, &Options::default())?;
            planned = plan.spare;
            planned.reverse();
            planned.extend(plan.chosen.into_iter().rev());
        }
        Some(Self {
            setup,
            robot,
            planned,
        })
    }

    /// A pose and its tensions, N; `None` where the robot cannot hang as drawn.
    fn next(&mut self, random: &mut Random) -> Option<(Pose, [f64; 4])> {
        if self.setup.free_poses {
            let tilt = 15f64.to_radians();
            let at = Vector3::new(
                0.335 + random.within(0.15),
                random.within(0.15),
                -0.1 - 0.4 * random.unit(),
            );
            let turn = [(); 3].map(|()| random.within(tilt));
            return Some((Pose::from_rpy(at, turn), [0.0; 4]));
        }
        let hung = if let Some(next) = self.planned.pop() {
            let (at, held) = (next.pose.position_m, next.held);
            PAPER_SPACE.hang(self.robot, &at, held, next.tensions_n[held])
        } else {
            PAPER_SPACE.random(self.robot, random)
        };
        hung.map(|hung| (hung.pose, hung.tensions_n))
    }
}

/// Simulates data; `None` if no robot could be made of the numbers (never with the built-in ones).
#[must_use]
pub fn simulate(setup: &Setup) -> Option<(Data, Truth)> {
    let mut random = Random::new(setup.seed);
    let mut nominal = nominal_robot();
    nominal.anchor_half_tolerance_m = setup.anchor_m;
    let half = nominal.anchor_half_tolerance_m;
    let off: Vec<_> = (0..4).map(|_| random.point(half)).collect();
    let camera = Camera {
        focal_px: [920.0; 2],
        center_px: [640.0, 360.0],
        size_px: [1280, 720],
        distortion: [0.0; 5],
    };
    let machine = Machine::new(setup, &nominal, camera);
    let silent = machine.silent;
    let robot = robot_of(&machine.made, &off)?;
    let (tags, bodies) = tags_of(setup.target);
    let nominal_bodies: Vec<Pose> = places_of(setup.target).into_iter().take(bodies).collect();
    let looking_down = Rotation3::from_matrix_unchecked(nalgebra::Matrix3::new(
        0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0,
    ));
    let nominal_camera = Pose::new(Vector3::new(0.0, 0.05, -0.03), looking_down);
    let world_from_body: Vec<Pose> = nominal_bodies
        .iter()
        .map(|body| random.turned(body, 5e-3, 0.02))
        .collect();
    let camera_from_platform = random.turned(&nominal_camera, 5e-3, 0.02);
    let noise = Noise {
        encoder_m: setup.encoder_m,
        corner_px: setup.corner_px,
        tension_n: Some(0.1),
    };
    // The paper's simulation has the tag in view at every pose of the camera.
    let margin_px = if setup.free_poses {
        f64::NEG_INFINITY
    } else {
        SEEN_PX
    };
    let mut data = Data {
        id: format!("simulated-{}", setup.seed),
        robot: nominal,
        camera,
        tags,
        noise,
        world_from_body: nominal_bodies,
        camera_from_platform: nominal_camera,
        poses: Vec::new(),
        at_rest: !setup.free_poses,
        holdout: Vec::new(),
        origin: None,
    };
    let mut next = Poses::new(setup, &robot, &data)?;
    let mut taken = Vec::new();
    while taken.len() < setup.poses {
        let Some((pose, tensions_n)) = next.next(&mut random) else {
            continue;
        };
        let from_world = camera_from_platform.compose(&pose.inverse());
        let bodies = &world_from_body;
        let size = 1.0 + silent.tag;
        let views = views_within(
            &machine.camera,
            &data.tags,
            bodies,
            &from_world,
            size,
            margin_px,
        );
        if !views.is_empty() {
            taken.push((pose, tensions_n, views));
        }
    }
    let mut holdout = Vec::new();
    while holdout.len() < 120 {
        let hung = PAPER_SPACE.random(&robot, &mut random);
        holdout.extend(hung.map(|hung| hung.pose));
    }
    let poses = taken.iter().map(|(pose, ..)| *pose).collect();
    let observed = observe(setup, &silent, &robot, &noise, taken, &mut random)?;
    data.poses = observed.0;
    data.holdout = holdout
        .iter()
        .map(|pose| world_from_body[0].inverse().compose(pose))
        .collect();
    let truth = Truth {
        robot,
        initial_length_m: observed.1,
        world_from_body,
        camera_from_platform,
        poses,
        holdout,
        drum_scale: 1.0 + silent.drum,
    };
    Some((data, truth))
}

type Taken = (Pose, [f64; 4], Vec<View>);

/// Readings with noise, silent effects and outliers; and the initial lengths.
fn observe(
    setup: &Setup,
    silent: &Silent,
    robot: &Robot<4>,
    noise: &Noise,
    taken: Vec<Taken>,
    random: &mut Random,
) -> Option<(Vec<Observation>, [f64; 4])> {
    let drum = 1.0 + silent.drum;
    let paid_out = |pose: &Pose, tensions: &[f64; 4]| {
        let lengths = robot.lengths_m(pose).ok()?;
        Some(std::array::from_fn::<f64, 4, _>(|i| {
            lengths[i] * (1.0 - silent.compliance_per_n * tensions[i])
        }))
    };
    let (first, first_tensions, _) = taken.first()?;
    // The encoders are zeroed at the first pose.
    let initial = paid_out(first, first_tensions)?;
    let sigma = noise.tension_n.unwrap_or(0.0);
    let mut poses = Vec::with_capacity(taken.len());
    for (pose, tensions, mut views) in taken {
        let lengths = paid_out(&pose, &tensions)?;
        let mut encoder_m = Vec::new();
        let mut tension_n = Vec::new();
        for i in 0..4 {
            let slip = if random.unit() < silent.outliers {
                random.within(5e-3)
            } else {
                0.0
            };
            encoder_m.push(Some(
                (lengths[i] - initial[i]) / drum + noise.encoder_m * random.normal() + slip,
            ));
            let jump = if random.unit() < silent.outliers {
                random.within(5.0)
            } else {
                0.0
            };
            let felt = tensions[i] * (1.0 + random.within(silent.loss));
            tension_n.push(felt + sigma * random.normal() + jump);
        }
        for view in &mut views {
            for corner in &mut view.corners_px {
                let wild = random.unit() < silent.outliers;
                for value in corner {
                    let jump = if wild { random.within(10.0) } else { 0.0 };
                    *value += noise.corner_px * random.normal() + jump;
                }
            }
        }
        poses.push(Observation {
            encoder_m,
            tension_n: (!setup.free_poses).then_some(tension_n),
            views,
            noise_factor: 1.0,
        });
    }
    Some((poses, initial))
}
