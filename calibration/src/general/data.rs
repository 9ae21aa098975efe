//! A data set: a robot as designed, and samples of any combination of sensors.

use crate::data::{Tag, View};
use mcdpr_kinematics::{Cable, Pose};
use mcdpr_vision::Camera;
use nalgebra::{Rotation3, Vector3};

/// Samples of one robot, taken in one or several sessions.
#[derive(Debug, Clone)]
pub struct Set {
    /// Name of the data set.
    pub id: String,
    /// The robot as designed.
    pub robot: Machine,
    /// The camera on the platform and the tags it looks at; `None` without a camera.
    pub eye: Option<Eye>,
    /// Trackers beside the robot.
    pub trackers: Vec<Tracker>,
    /// Tapes between the frame and the platform.
    pub tapes: Vec<Tape>,
    /// Names of the sessions: within one, encoders and load cells keep their zeros.
    pub sessions: Vec<String>,
    /// Whether each session began at the common home. Otherwise its lengths have offsets of their own.
    pub homed: Vec<bool>,
    /// The samples in the order in which they were taken.
    pub samples: Vec<Sample>,
    /// Notes on what was left out while reading.
    pub notes: Vec<String>,
    /// Stated noise of the sensors. The estimate starts from it and follows the data.
    pub stated: Stated,
}

/// The robot as designed.
#[derive(Debug, Clone, PartialEq)]
pub struct Machine {
    /// Nominal cables, m.
    pub cables: Vec<Cable>,
    /// Platform mass, kg.
    pub mass_kg: f64,
    /// Centre of mass, platform frame, m.
    pub center_of_mass_m: Vector3<f64>,
    /// Cable between each drum and its anchor, m; it stretches as well.
    pub routing_m: Vec<f64>,
    /// Half the width within which each coordinate of an anchor lies, m; `None`: see
    /// [`super::Priors`].
    pub anchor_half_tolerance_m: Option<f64>,
    /// Whether lengths are absolute. Otherwise they are changes since a homing.
    pub absolute: bool,
}

/// A camera on the platform that looks at tags.
#[derive(Debug, Clone, PartialEq)]
pub struct Eye {
    /// The lens as stated.
    pub camera: Camera,
    /// The tags.
    pub tags: Vec<Tag>,
    /// Start value per rigid body of tags, world_from_body.
    pub world_from_body: Vec<Pose>,
    /// Start value of the camera's place, camera_from_platform.
    pub camera_from_platform: Pose,
}

/// An instrument beside the robot that measures a target on the platform in a frame of its own: a laser tracker, a
/// total station, motion capture. Its frame is estimated.
#[derive(Debug, Clone, PartialEq)]
pub struct Tracker {
    /// Its name in the file.
    pub name: String,
    /// The target, platform frame, m; `None` where it is unknown.
    pub target_m: Option<Vector3<f64>>,
    /// Standard deviation of each of its coordinates, m.
    pub tolerance_m: f64,
    /// Start value of tracker_from_world and of the target's attitude on the platform.
    pub start: Option<(Pose, Rotation3<f64>)>,
}

/// Distances between a point of the frame and one of the platform, by tape or laser.
#[derive(Debug, Clone, PartialEq)]
pub struct Tape {
    /// Its name in the file.
    pub name: String,
    /// The point of the frame, world, m.
    pub from_m: Vector3<f64>,
    /// The point of the platform, platform frame, m.
    pub to_m: Vector3<f64>,
    /// Standard deviation of its zero, m: it also stands for the errors of both points.
    pub tolerance_m: f64,
}

/// Stated standard deviations; `None` if not stated.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Stated {
    /// Lengths, m.
    pub length_m: Option<f64>,
    /// Tensions, N.
    pub tension_n: Option<f64>,
    /// Corners, px.
    pub corner_px: Option<f64>,
    /// Each coordinate of a tracker's position, m.
    pub position_m: Option<f64>,
    /// Distances of tapes, m.
    pub distance_m: Option<f64>,
}

/// The measurements at one moment. Any of them may be missing.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Sample {
    /// Index into [`Set::sessions`].
    pub session: usize,
    /// Number in the file, from 1.
    pub number: usize,
    /// Time within the session, s.
    pub time_s: Option<f64>,
    /// Length of each cable as its encoder reports it, arc on the pulley included, m.
    pub length_m: Vec<Option<f64>>,
    /// Tension of each cable at its winch, N.
    pub tension_n: Vec<Option<f64>>,
    /// Angle of each pulley about its swivel axis, rad: see `model::swivel_reference`.
    pub swivel_rad: Vec<Option<f64>>,
    /// Roll, pitch and yaw of an inclinometer or inertial unit, R = Rz Ry Rx, rad.
    pub rpy_rad: [Option<f64>; 3],
    /// Sign of each cable's last motion, +1 paid out, -1 wound up.
    pub arrived: Vec<Option<f64>>,
    /// The fastest cable around the sample, m/s.
    pub speed_mps: Option<f64>,
    /// Position of each tracker's target, tracker's frame, m; empty without trackers.
    pub position_m: Vec<[Option<f64>; 3]>,
    /// Attitude of each tracker's target, tracker's frame; empty without trackers.
    pub turned: Vec<Option<Rotation3<f64>>>,
    /// Reading of each tape, m; empty without tapes.
    pub distance_m: Vec<Option<f64>>,
    /// The tags seen.
    pub views: Vec<View>,
    /// Factor on the scatter of tensions, corners and equilibrium: above 1 where the platform swung.
    pub noise_factor: f64,
    /// Approximate pose of the platform, if a picture gives one.
    pub start: Option<Pose>,
}

impl Sample {
    /// A sample of `cables` cables without any reading.
    #[must_use]
    pub fn empty(session: usize, number: usize, cables: usize) -> Self {
        Self {
            session,
            number,
            length_m: vec![None; cables],
            tension_n: vec![None; cables],
            swivel_rad: vec![None; cables],
            arrived: vec![None; cables],
            noise_factor: 1.0,
            ..Self::default()
        }
    }
}

impl Sample {
    /// Whether a tracker has a reading in it.
    #[must_use]
    pub(crate) fn is_tracked(&self, tracker: usize) -> bool {
        let position = self.position_m.get(tracker);
        position.is_some_and(|p| p.iter().any(Option::is_some))
            || matches!(self.turned.get(tracker), Some(Some(_)))
    }
}

impl Set {
    /// Number of cables.
    #[must_use]
    pub fn cable_count(&self) -> usize {
        self.robot.cables.len()
    }

    /// Index of a session by its name.
    #[must_use]
    pub fn session(&self, name: &str) -> Option<usize> {
        self.sessions.iter().position(|session| session == name)
    }

    /// A sample in words, as in "sample 12 of sc_8 (153.0 s)".
    #[must_use]
    pub fn name(&self, k: usize) -> String {
        let Some(sample) = self.samples.get(k) else {
            return format!("sample {}", k + 1);
        };
        let mut out = format!("sample {}", sample.number);
        if self.sessions.len() > 1 {
            out.push_str(&format!(" of {}", self.sessions[sample.session]));
        }
        if let Some(time) = sample.time_s {
            out.push_str(&format!(" ({time:.1} s)"));
        }
        out
    }

    /// The samples of this selection, in their order.
    #[must_use]
    pub fn only(&self, keep: impl Fn(usize, &Sample) -> bool) -> Self {
        let mut out = self.clone();
        let all = std::mem::take(&mut out.samples);
        out.samples = all
            .into_iter()
            .enumerate()
            .filter_map(|(k, sample)| keep(k, &sample).then_some(sample))
            .collect();
        out
    }
}
