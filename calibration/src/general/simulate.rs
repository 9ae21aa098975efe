//! Simulated data of a known robot with the errors of real machines, to test the estimate.
//!
//! Geometry and statics are those of the kinematics crate, which the estimate uses too: this tests
//! the estimation, not the model.

use super::data::{Machine, Sample, Set, Stated, Tape, Tracker};
use super::model::swivel_reference;
use crate::space::Space;
use mcdpr_core::random::Random;
use mcdpr_kinematics::{Cable, Platform, Pose, Robot, rpy_from_rotation};
use nalgebra::{Rotation3, Vector3};

/// A cable that slips on its drum.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SimulatedSlip {
    /// The cable, 0 for the first.
    pub cable: usize,
    /// The first sample with the slip.
    pub from: usize,
    /// By how much the cable is longer than before, m.
    pub size_m: f64,
}

/// What to simulate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Case {
    /// Samples of each session.
    pub samples: [usize; 2],
    /// Gain of cable 1's drum beyond the others', share.
    pub drum: f64,
    /// A slip in the first session.
    pub slip: Option<SimulatedSlip>,
    /// Whether there are swivel sensors and an inclinometer.
    pub attitude: bool,
    /// Error of each coordinate of an anchor, standard deviation, m.
    pub anchor_m: f64,
    /// Instruments beside the robot.
    pub outside: Outside,
    /// Factor on all errors of the machine.
    pub off: f64,
    /// Seed of everything random.
    pub seed: u64,
}

impl Default for Case {
    fn default() -> Self {
        Self {
            samples: [27, 8],
            drum: 0.0,
            slip: None,
            attitude: true,
            anchor_m: 1e-3,
            outside: Outside::None,
            off: 1.0,
            seed: 1,
        }
    }
}

/// Instruments beside the robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outside {
    /// None.
    None,
    /// A tracker of positions and a tape; frame and target of the tracker are unknown.
    Positions,
    /// A tracker of poses and a tape.
    Poses,
}

/// The true values behind the data.
#[derive(Debug, Clone)]
pub struct Truth {
    /// world_from_platform of every sample.
    pub poses: Vec<Pose>,
    /// Gain of each drum, share.
    pub drums: [f64; 4],
    /// Gain of each load cell, share.
    pub gains: [f64; 4],
    /// The tracker's frame, tracker_from_world.
    pub frame: Pose,
    /// Its target on the platform, platform_from_target.
    pub target: Pose,
}

/// A frame of 2 m by 2 m with pulleys of 30 mm that swivel about level axes, and a platform of 12 kg.
fn nominal() -> Machine {
    let corner = |x: f64, y: f64| Cable {
        anchor_m: Vector3::new(x, y, 1.9),
        swivel_axis: Vector3::new(x.signum(), 0.0, 0.0),
        pulley_radius_m: 0.03,
        attachment_m: Vector3::new(0.08 * x.signum(), 0.08 * y.signum(), 0.25),
    };
    Machine {
        cables: vec![
            corner(1.0, -1.1),
            corner(1.0, 1.1),
            corner(-1.0, 1.1),
            corner(-1.0, -1.1),
        ],
        mass_kg: 12.0,
        center_of_mass_m: Vector3::new(0.0, 0.0, 0.17),
        routing_m: vec![0.0; 4],
        anchor_half_tolerance_m: None,
        absolute: true,
    }
}

/// Its pose.
const SPACE: Space = Space {
    middle_m: Vector3::new(0.0, 0.0, 0.9),
    half_m: Vector3::new(0.4, 0.4, 0.35),
    tension_n: [15.0, 250.0],
    held_n: [25.0, 170.0],
    tilt_max_rad: 0.5,
};

fn robot_of(machine: &Machine) -> Option<Robot<4>> {
    let platform = Platform {
        mass_kg: machine.mass_kg,
        center_of_mass_m: machine.center_of_mass_m,
        inertia_kg_m2: None,
    };
    Robot::new(
        <[Cable; 4]>::try_from(machine.cables.clone()).ok()?,
        platform,
    )
    .ok()
}

/// A tracker and a tape.
struct Beside {
    random: Random,
    frame: Pose,
    target: Pose,
    tape: Tape,
    zero_m: f64,
}

impl Beside {
    /// Describes them in the set, with a random generator of their own: the rest of the data does not change.
    fn new(case: &Case, set: &mut Set) -> Self {
        let mut random = Random::new(case.seed ^ 0x6f75_7473);
        let mut point = |half: f64| Vector3::from_fn(|_, _| random.within(half));
        let frame = Pose::new(point(3.0), Rotation3::new(point(1.5)));
        let target = Pose::new(point(0.15), Rotation3::new(point(1.0)));
        let tape = Tape {
            name: "to the wall".to_owned(),
            from_m: Vector3::new(2.0, 0.3, 0.4),
            to_m: Vector3::new(0.05, 0.0, 0.1),
            tolerance_m: 2e-3,
        };
        if case.outside != Outside::None {
            set.trackers.push(Tracker {
                name: "laser".to_owned(),
                target_m: None,
                tolerance_m: 2e-3,
                start: None,
            });
            set.tapes.push(tape.clone());
        }
        Self {
            zero_m: 2e-3 * random.normal(),
            random,
            frame,
            target,
            tape,
        }
    }

    fn read(&mut self, case: &Case, pose: &Pose, sample: &mut Sample) {
        if case.outside == Outside::None {
            return;
        }
        let seen = self.frame.compose(pose).compose(&self.target);
        let mut noise = |sigma: f64| case.off * sigma * self.random.normal();
        sample.position_m = vec![[0, 1, 2].map(|k| Some(seen.position_m[k] + noise(2e-4)))];
        let turn = Vector3::from_fn(|_, _| noise(1e-3));
        let turned = Rotation3::new(turn) * seen.rotation;
        sample.turned = vec![(case.outside == Outside::Poses).then_some(turned)];
        let way = pose.position_m + pose.rotation * self.tape.to_m - self.tape.from_m;
        sample.distance_m = vec![Some(way.norm() + self.zero_m + noise(1e-3))];
    }
}

/// Simulates two sessions; `None` if the numbers do not give a valid robot (never with these).
#[must_use]
pub fn simulate(case: &Case) -> Option<(Set, Truth)> {
    let mut random = Random::new(case.seed ^ 0x616c_6c73);
    let stated = nominal();
    let off = case.off;
    let mut point = |sigma: f64| Vector3::from_fn(|_, _| off * sigma * random.normal());
    let mut made = stated.clone();
    for cable in &mut made.cables {
        cable.anchor_m += point(case.anchor_m);
        cable.attachment_m += point(3e-4);
    }
    made.center_of_mass_m += point(3e-3);
    let mount = Rotation3::new(point(0.02));
    let mut four = |sigma: f64| std::array::from_fn::<f64, 4, _>(|_| off * sigma * random.normal());
    let mut drums = four(3e-3);
    drums[0] += case.drum;
    let (gains, zeros) = (four(0.08), four(8.0));
    let (offsets, swivels) = (four(3e-3), four(0.01));
    let loss: [f64; 4] = four(0.005).map(|l| off * 0.015 + l);
    let mut set = Set {
        id: format!("simulated-{}", case.seed),
        robot: stated,
        eye: None,
        trackers: Vec::new(),
        tapes: Vec::new(),
        sessions: vec!["first".to_owned(), "second".to_owned()],
        homed: vec![true; 2],
        samples: Vec::new(),
        notes: Vec::new(),
        stated: Stated::default(),
    };
    let mut beside = Beside::new(case, &mut set);
    let mut truth = Truth {
        poses: Vec::new(),
        drums,
        gains,
        frame: beside.frame,
        target: beside.target,
    };
    let weight = made.mass_kg * mcdpr_kinematics::GRAVITY_MPS2;
    for (session, count) in case.samples.into_iter().enumerate() {
        let mut four =
            |sigma: f64| std::array::from_fn::<f64, 4, _>(|_| off * sigma * random.normal());
        let (homing, drift) = (four(5e-4), four(0.7));
        let yaw = off * 0.02 * random.normal();
        for k in 0..count {
            // The equations of equilibrium have a residual: the platform hangs as if its weight and
            // its centre of mass were slightly different at every pose.
            let mut here = made.clone();
            here.mass_kg *= 1.0 + off * 0.004 * random.normal();
            here.center_of_mass_m += Vector3::from_fn(|_, _| off * 8e-4 * random.normal());
            let robot = robot_of(&here)?;
            let hanging = (0..1000).find_map(|_| SPACE.random(&robot, &mut random))?;
            let pose = hanging.pose;
            let inverse = robot.inverse(&pose).ok()?;
            let mut sample = Sample::empty(session, set.samples.len() + 1, 4);
            sample.time_s = Some(60.0 + 11.0 * k as f64);
            sample.speed_mps = Some(1e-4);
            for i in 0..4 {
                let sign = if random.unit() < 0.5 { -1.0 } else { 1.0 };
                sample.arrived[i] = Some(sign);
                let slip = match case.slip {
                    Some(slip) if slip.cable == i && session == 0 && k >= slip.from => slip.size_m,
                    _ => 0.0,
                };
                let offset = offsets[i] + homing[i] + slip + off * 2e-4 * random.normal();
                sample.length_m[i] = Some(inverse.lengths_m[i] * (1.0 - drums[i]) + offset);
                let lost = sign * loss[i] * (inverse.wraps_rad[i] / 2.0).sin();
                let felt = hanging.tensions_n[i] * (1.0 - lost) * (1.0 + gains[i]);
                let noise = off * 0.003 * weight * random.normal();
                sample.tension_n[i] = Some(felt + zeros[i] + drift[i] + noise);
                if case.attitude {
                    let [first, second] = swivel_reference(&made.cables[i].swivel_axis);
                    let d = pose.position_m + inverse.arm_m(i) - made.cables[i].anchor_m;
                    let angle = d.dot(&second).atan2(d.dot(&first)) + swivels[i];
                    sample.swivel_rad[i] = Some(angle + off * 3e-3 * random.normal());
                }
            }
            if case.attitude {
                let rpy = rpy_from_rotation(&(pose.rotation * mount));
                let drifted = [0.0, 0.0, yaw + off * 2e-4 * 11.0 * k as f64];
                sample.rpy_rad = std::array::from_fn(|axis| {
                    Some(rpy[axis] + drifted[axis] + off * 2e-3 * random.normal())
                });
            }
            beside.read(case, &pose, &mut sample);
            truth.poses.push(pose);
            set.samples.push(sample);
        }
    }
    Some((set, truth))
}
