//! Calibration data of a known robot, to test the estimators: equilibrium poses of the paper's
//! robot, with errors of its anchors, a camera on the platform and tags on the floor.
//!
//! Geometry and statics are those of the kinematics crate, which the estimators use too: this tests
//! the estimation, not the model.

mod scene;

pub use scene::Target;
use scene::{PAPER_SPACE, places_of, robot_of};
pub(crate) use scene::{nominal_robot, tags_of};

use super::data::{Data, Noise, NominalRobot, Observation, View};
use super::fit::Options;
pub use super::general::simulate::SimulatedSlip;
use super::plan;
use super::unknowns::Priors;
use super::views::{SEEN_PX, views_within};
use mcdpr_core::random::Random;
use mcdpr_kinematics::{Pose, Robot, rpy_from_rotation};
use mcdpr_vision::Camera;
use nalgebra::{Rotation3, Vector3};

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

/// Errors as found on a real machine beyond those of the priors, standard deviations (IRMA4U, University of
/// Bologna; see [`super::general::simulate`]).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Found {
    /// Radius of each drum, relative.
    pub drum: f64,
    /// Gain of each load cell, relative.
    pub gain: f64,
    /// Zero of each load cell, N: 0.7 % of 39 N.
    pub zero_n: f64,
    /// Noise of each load cell, N: 0.3 % of 39 N.
    pub noise_n: f64,
    /// Centre of mass per axis, m.
    pub center_of_mass_m: f64,
    /// Stiffness of the cables as specified, N; each is off by up to half of it.
    pub ea_n: f64,
    /// Vertical force that no model has, new at every pose, share of the weight.
    pub force: f64,
    /// Moment that no model has, new at every pose, over the weight, m.
    pub moment_m: f64,
    /// Loss at the pulleys, either sign, share.
    pub loss: f64,
    /// Mounting of an inclinometer about each axis, rad: 1.6 degrees.
    pub mount_rad: f64,
}

/// The machine as found, its winches calibrated.
pub(crate) const FOUND: Found = Found {
    drum: 3e-3,
    gain: 0.01,
    zero_n: 0.27,
    noise_n: 0.12,
    center_of_mass_m: 3e-3,
    ea_n: 5e4,
    force: 4e-3,
    moment_m: 8e-4,
    loss: 0.02,
    mount_rad: 0.028,
};

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
    /// Errors as found on a real machine, see `FOUND`: the description mentions none of them.
    pub found: bool,
    /// A cable that slips while the data are collected.
    pub slip: Option<SimulatedSlip>,
    /// Whether the last pose is the first one again, as `collect` does.
    pub revisit: bool,
    /// Noise of an inclinometer on the platform, turned by some degrees, rad; `None` without one.
    pub tilt_rad: Option<f64>,
    /// By how much the stated places of tags and camera are off, each in some direction: m, rad.
    pub start: [f64; 2],
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
            found: false,
            slip: None,
            revisit: false,
            tilt_rad: None,
            start: [0.0; 2],
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
    /// Length per reading of each drum.
    pub drum_scales: [f64; 4],
    /// Relative stretch of each cable at its mean tension.
    pub stretch: [f64; 4],
}

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
    /// Length per reading of each drum.
    drums: [f64; 4],
    gains: [f64; 4],
    zeros_n: [f64; 4],
    /// 1/EA of each cable, 1/N.
    compliances: [f64; 4],
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
            drums: [1.0; 4],
            gains: [0.0; 4],
            zeros_n: [0.0; 4],
            compliances: [setup.silent.compliance_per_n; 4],
        };
        if setup.found {
            let mut own = Random::new(setup.seed ^ 0x666f_756e);
            let mut four = |sigma: f64| std::array::from_fn(|_| sigma * own.normal());
            it.drums = four(FOUND.drum).map(|d: f64| 1.0 + d);
            it.gains = four(FOUND.gain);
            it.zeros_n = four(FOUND.zero_n);
            it.compliances =
                std::array::from_fn(|_| (1.0 + own.within(0.5)) * nominal.compliance_per_n);
            it.made.center_of_mass_m +=
                Vector3::from_fn(|_, _| FOUND.center_of_mass_m * own.normal());
            it.silent.loss = it.silent.loss.max(FOUND.loss);
        }
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
        it.drums = it.drums.map(|drum| drum + it.silent.drum);
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

/// The poses of the data, one after another.
struct Poses<'a> {
    setup: &'a Setup,
    robot: &'a Robot<4>,
    made: &'a NominalRobot,
    off: &'a [Vector3<f64>],
    /// Chosen poses, the next one last.
    planned: Vec<plan::Candidate>,
}

impl<'a> Poses<'a> {
    /// Poses chosen for the nominal robot, driven to with the true one: it hangs slightly
    /// differently.
    fn new(
        setup: &'a Setup,
        robot: &'a Robot<4>,
        (made, off): (&'a NominalRobot, &'a [Vector3<f64>]),
        data: &Data,
    ) -> Option<Self> {
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
            made,
            off,
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
        let here = self.setup.found.then(|| self.disturbed(random));
        let robot = here.as_ref().and_then(Option::as_ref).unwrap_or(self.robot);
        let hung = if let Some(next) = self.planned.pop() {
            let (at, held) = (next.pose.position_m, next.held);
            PAPER_SPACE.hang(robot, &at, held, next.tensions_n[held])
        } else {
            PAPER_SPACE.random(robot, random)
        };
        hung.map(|hung| (hung.pose, hung.tensions_n))
    }
}

impl Poses<'_> {
    /// The equations of equilibrium have a residual: the platform hangs as if its weight and its centre of
    /// mass were slightly different at every pose.
    fn disturbed(&self, random: &mut Random) -> Option<Robot<4>> {
        let mut here = self.made.clone();
        here.mass_kg *= 1.0 + FOUND.force * random.normal();
        here.center_of_mass_m += Vector3::from_fn(|_, _| FOUND.moment_m * random.normal());
        robot_of(&here, self.off)
    }
}

/// Simulates data; `None` if no robot could be made of the numbers (never with the built-in ones).
#[must_use]
pub fn simulate(setup: &Setup) -> Option<(Data, Truth)> {
    let mut random = Random::new(setup.seed);
    let mut nominal = nominal_robot();
    nominal.anchor_half_tolerance_m = setup.anchor_m;
    if setup.found {
        nominal.compliance_per_n = 1.0 / FOUND.ea_n;
    }
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
        tilt_rad: setup.tilt_rad,
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
    misplace(setup, &mut data);
    let mut next = Poses::new(setup, &robot, (&machine.made, &off), &data)?;
    let seen_at = |pose: &Pose| {
        let from_world = camera_from_platform.compose(&pose.inverse());
        let (camera, bodies) = (&machine.camera, &world_from_body);
        views_within(
            camera,
            &data.tags,
            bodies,
            &from_world,
            1.0 + silent.tag,
            margin_px,
        )
    };
    let mut taken = Vec::new();
    while taken.len() < setup.poses {
        let Some((pose, tensions_n)) = next.next(&mut random) else {
            continue;
        };
        let views = seen_at(&pose);
        if !views.is_empty() {
            taken.push((pose, tensions_n, views));
        }
    }
    if setup.revisit
        && let Some((pose, tensions_n, views)) = taken.first().cloned()
    {
        let disturbed = next.disturbed(&mut random).filter(|_| setup.found);
        let here = disturbed.as_ref().unwrap_or(&robot);
        let again = PAPER_SPACE.hang(here, &pose.position_m, 3, tensions_n[3]);
        taken.push(again.map_or((pose, tensions_n, views), |hung| {
            let views = seen_at(&hung.pose);
            (hung.pose, hung.tensions_n, views)
        }));
    }
    let mut holdout = Vec::new();
    while holdout.len() < 120 {
        let hung = PAPER_SPACE.random(&robot, &mut random);
        holdout.extend(hung.map(|hung| hung.pose));
    }
    let taken_poses: Vec<Pose> = taken.iter().map(|(pose, ..)| *pose).collect();
    let count = taken.len().max(1) as f64;
    let stretch = std::array::from_fn(|i| {
        let sum: f64 = taken.iter().map(|(_, tensions, _)| tensions[i]).sum();
        // Without cables as found the held-out lengths are those of taut cables.
        f64::from(u8::from(setup.found)) * machine.compliances[i] * sum / count
    });
    let observed = observe(setup, &machine, &robot, &noise, taken, &mut random)?;
    data.poses = observed.0;
    read_tilt(setup, &mut data, &taken_poses);
    data.holdout = holdout
        .iter()
        .map(|pose| world_from_body[0].inverse().compose(pose))
        .collect();
    let truth = Truth {
        robot,
        initial_length_m: observed.1,
        world_from_body,
        camera_from_platform,
        poses: taken_poses,
        holdout,
        drum_scales: machine.drums,
        stretch,
    };
    Some((data, truth))
}

/// Moves the stated places of tags and camera by their full error, with a random generator of its own.
fn misplace(setup: &Setup, data: &mut Data) {
    let mut own = Random::new(setup.seed ^ 0x7374_6172);
    let [off_m, off_rad] = setup.start;
    let mut place = |pose: &mut Pose| {
        let mut aim = || Vector3::from_fn(|_, _| own.normal()).normalize();
        *pose = pose.displaced(&(aim() * off_m), &Vector3::zeros());
        pose.rotation = Rotation3::new(aim() * off_rad) * pose.rotation;
    };
    if setup.start != [0.0; 2] {
        data.world_from_body.iter_mut().for_each(&mut place);
        place(&mut data.camera_from_platform);
    }
}

/// Adds the readings of an inclinometer, with a random generator of its own.
fn read_tilt(setup: &Setup, data: &mut Data, poses: &[Pose]) {
    let Some(sigma) = setup.tilt_rad else { return };
    let mut own = Random::new(setup.seed ^ 0x7469_6c74);
    let mount = Vector3::from_fn(|_, _| FOUND.mount_rad * own.normal());
    for (seen, pose) in data.poses.iter_mut().zip(poses) {
        let [roll, pitch, _] = rpy_from_rotation(&(pose.rotation * Rotation3::new(mount)));
        seen.tilt_rad = Some([roll, pitch].map(|angle| angle + sigma * own.normal()));
    }
}

/// Cable off a drum at a pose that its encoder did not count, m.
fn slipped(setup: &Setup, cable: usize, pose: usize) -> f64 {
    let slip = setup
        .slip
        .filter(|slip| slip.cable == cable && pose >= slip.from);
    slip.map_or(0.0, |slip| slip.size_m)
}

type Taken = (Pose, [f64; 4], Vec<View>);

/// Readings with noise, silent effects and outliers; and the initial lengths.
fn observe(
    setup: &Setup,
    machine: &Machine,
    robot: &Robot<4>,
    noise: &Noise,
    taken: Vec<Taken>,
    random: &mut Random,
) -> Option<(Vec<Observation>, [f64; 4])> {
    let silent = &machine.silent;
    let paid_out = |pose: &Pose, tensions: &[f64; 4]| {
        let lengths = robot.lengths_m(pose).ok()?;
        Some(std::array::from_fn::<f64, 4, _>(|i| {
            lengths[i] * (1.0 - machine.compliances[i] * tensions[i])
        }))
    };
    let (first, first_tensions, _) = taken.first()?;
    // The encoders are zeroed at the first pose.
    let initial = paid_out(first, first_tensions)?;
    let sigma = if setup.found {
        FOUND.noise_n
    } else {
        noise.tension_n.unwrap_or(0.0)
    };
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
                (lengths[i] - initial[i] - slipped(setup, i, poses.len())) / machine.drums[i]
                    + noise.encoder_m * random.normal()
                    + slip,
            ));
            let jump = if random.unit() < silent.outliers {
                random.within(5.0)
            } else {
                0.0
            };
            let felt = tensions[i] * (1.0 + random.within(silent.loss)) * (1.0 + machine.gains[i]);
            tension_n.push(felt + machine.zeros_n[i] + sigma * random.normal() + jump);
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
            tilt_rad: None,
            noise_factor: 1.0,
        });
    }
    Some((poses, initial))
}
