//! A data set: a robot as designed, and samples of any combination of sensors.

use crate::data::{Tag, View};
use mcdpr_kinematics::{Cable, Pose};
use mcdpr_vision::Camera;
use nalgebra::Vector3;

/// Samples of one robot, taken in one or several sessions.
#[derive(Debug, Clone)]
pub struct Set {
    /// Name of the data set.
    pub id: String,
    /// The robot as designed.
    pub robot: Machine,
    /// The camera on the platform and the tags it looks at; `None` without a camera.
    pub eye: Option<Eye>,
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

/// Stated standard deviations; `None` if not stated.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Stated {
    /// Lengths, m.
    pub length_m: Option<f64>,
    /// Tensions, N.
    pub tension_n: Option<f64>,
    /// Corners, px.
    pub corner_px: Option<f64>,
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
