//! Calibration data: the measurements at the poses, and the prior knowledge. SI units; the file
//! form (mm, N, px) is read by [`Data::from_json`] and written by [`Data::to_json`].

use mcdpr_kinematics::{Cable, Pose};
use mcdpr_vision::Camera;
use nalgebra::Vector3;
use serde_json::{Value, json};

/// Name of the file format.
pub const SCHEMA: &str = "mcdpr-calibration-data-1";

/// All input of a calibration.
#[derive(Debug, Clone, PartialEq)]
pub struct Data {
    /// Name of the data set.
    pub id: String,
    /// The robot as designed.
    pub robot: NominalRobot,
    /// The camera on the platform.
    pub camera: Camera,
    /// The tags, in the order of their ids in the file.
    pub tags: Vec<Tag>,
    /// Noise of the sensors.
    pub noise: Noise,
    /// Start value per rigid body of tags, world_from_body.
    pub world_from_body: Vec<Pose>,
    /// Start value of the camera's pose: camera_from_platform.
    pub camera_from_platform: Pose,
    /// The measurements.
    pub poses: Vec<Observation>,
    /// Whether the platform hung at rest, so that the equations of equilibrium hold.
    pub at_rest: bool,
    /// Poses body0_from_platform for which predicted lengths are wanted.
    pub holdout: Vec<Pose>,
    /// The robot that they were collected on; `None` for data from elsewhere.
    pub origin: Option<Origin>,
}

/// Where collected data come from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Origin {
    /// Name of the robot.
    pub robot: String,
    /// Hash of its description without calibration ([`mcdpr_core::robot::Robot::content_hash`]).
    pub robot_hash: u32,
    /// Seed of the simulated machine; `None` for data of a real one.
    pub simulated_seed: Option<u64>,
    /// Kind of that machine, as `--machine` names it; `None`: as built.
    pub simulated_machine: Option<String>,
    /// When, UTC, as in 2026-03-01T12:00:00Z.
    pub date: String,
}

/// The nominal robot and how far it can be from the truth.
#[derive(Debug, Clone, PartialEq)]
pub struct NominalRobot {
    /// Nominal cables, m.
    pub cables: Vec<Cable>,
    /// The anchors lie within +- this of nominal per coordinate, uniformly, m.
    pub anchor_half_tolerance_m: f64,
    /// Platform mass, kg.
    pub mass_kg: f64,
    /// Centre of mass, platform frame, m.
    pub center_of_mass_m: Vector3<f64>,
    /// Index of the pose at which the encoders were zeroed.
    pub home: usize,
    /// Cable between each drum and its anchor, which stretches as well, m; zeros where not known.
    pub routing_m: Vec<f64>,
    /// 1/EA of the cables as specified, 1/N; 0 where not known.
    pub compliance_per_n: f64,
    /// Its limits, where they are known.
    pub limits: Option<Limits>,
}

/// A robot's limits as calibration data carry them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Least and greatest corner of the box of the platform's origin, world, m.
    pub box_in_world_m: [Vector3<f64>; 2],
    /// Least and greatest tension of any cable, N.
    pub tension_n: [f64; 2],
    /// Least and greatest tension at which a cable is held, N.
    pub held_n: [f64; 2],
    /// Greatest angle between the platform's z axis and the world's, rad.
    pub tilt_max_rad: f64,
}

/// One tag on a rigid body.
#[derive(Debug, Clone, PartialEq)]
pub struct Tag {
    /// Its number.
    pub id: u32,
    /// Edge length, m.
    pub size_m: f64,
    /// Index of the rigid body that it belongs to.
    pub body: usize,
    /// Its corners in the body's frame, m.
    pub corners_in_body_m: [Vector3<f64>; 4],
}

/// Standard deviations of the sensors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Noise {
    /// Encoder lengths, m.
    pub encoder_m: f64,
    /// Each coordinate of a corner, px.
    pub corner_px: f64,
    /// Tensions, N; `None` without sensors.
    pub tension_n: Option<f64>,
    /// Roll and pitch of an inclinometer, rad; `None` without one.
    pub tilt_rad: Option<f64>,
}

/// The measurements at one pose.
#[derive(Debug, Clone, PartialEq)]
pub struct Observation {
    /// Change of each cable's length since the encoders were zeroed, m; `None` where missing.
    pub encoder_m: Vec<Option<f64>>,
    /// Tension of each cable at its winch, N.
    pub tension_n: Option<Vec<f64>>,
    /// The tags seen.
    pub views: Vec<View>,
    /// Roll and pitch by an inclinometer on the platform, R = Rz Ry Rx, rad.
    pub tilt_rad: Option<[f64; 2]>,
    /// Factor on the standard deviations of tensions, corners, tilt and equilibrium: above 1 where
    /// the platform still swung.
    pub noise_factor: f64,
}

/// One tag in one picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// Index into [`Data::tags`].
    pub tag: usize,
    /// The corners in the order of the tag's, px.
    pub corners_px: [[f64; 2]; 4],
}

impl Data {
    /// Number of cables.
    #[must_use]
    pub fn cable_count(&self) -> usize {
        self.robot.cables.len()
    }

    /// Whether the equations of equilibrium can be used: the platform hung at rest and at least one
    /// pose has tensions of a sensor with a known scatter.
    #[must_use]
    pub(crate) fn has_statics(&self) -> bool {
        self.at_rest
            && self.noise.tension_n.is_some()
            && self.poses.iter().any(|pose| pose.tension_n.is_some())
    }

    /// Whether an inclinometer on the platform was read, with known noise.
    #[must_use]
    pub(crate) fn has_tilt(&self) -> bool {
        self.noise.tilt_rad.is_some() && self.poses.iter().any(|pose| pose.tilt_rad.is_some())
    }

    /// Takes a calibrated robot's frame as known to half a millimetre.
    pub fn keep_frame_of(&mut self, robot: &mcdpr_core::robot::Robot) {
        for (cable, known) in self.robot.cables.iter_mut().zip(&robot.cables) {
            cable.anchor_m = known.anchor_in_world_m;
            cable.attachment_m = known.attachment_in_platform_m;
            cable.pulley_radius_m = known.pulley_radius_m;
        }
        self.robot.anchor_half_tolerance_m = 5e-4;
        self.robot.mass_kg = robot.platform.mass_kg;
        self.robot.center_of_mass_m = robot.platform.center_of_mass_m;
    }

    /// The file form.
    #[must_use]
    pub fn to_json(&self) -> Value {
        let mm = |v: &Vector3<f64>| [v.x * 1e3, v.y * 1e3, v.z * 1e3];
        let cables = &self.robot.cables;
        let tags: Vec<Value> = self
            .tags
            .iter()
            .map(|tag| {
                json!({"id": tag.id, "size_mm": tag.size_m * 1e3, "body": tag.body,
                       "corners_in_body_mm": tag.corners_in_body_m.each_ref().map(mm)})
            })
            .collect();
        let poses: Vec<Value> = self
            .poses
            .iter()
            .map(|pose| {
                let corners: serde_json::Map<_, _> = pose
                    .views
                    .iter()
                    .filter_map(|view| {
                        let tag = self.tags.get(view.tag)?;
                        Some((tag.id.to_string(), json!(view.corners_px)))
                    })
                    .collect();
                let lengths: Vec<_> = pose.encoder_m.iter().map(|l| l.map(|l| l * 1e3)).collect();
                let mut out = json!({"encoder_dl_mm": lengths, "tension_N": pose.tension_n, "corners_px": corners});
                if let Some(tilt) = pose.tilt_rad {
                    out["roll_pitch_deg"] = json!(tilt.map(f64::to_degrees));
                }
                if pose.noise_factor > 1.0 {
                    out["noise_factor"] = json!(pose.noise_factor);
                }
                out
            })
            .collect();
        let mut out = json!({
            "schema": SCHEMA, "id": self.id,
            "units": "mm, N, px; H_a_b maps coordinates of frame b into frame a",
            "robot": {
                "anchors_nominal_mm": cables.iter().map(|c| mm(&c.anchor_m)).collect::<Vec<_>>(),
                "anchor_half_tolerance_mm": self.robot.anchor_half_tolerance_m * 1e3,
                "pulley_axis": cables.iter().map(|c| <[f64; 3]>::from(c.swivel_axis)).collect::<Vec<_>>(),
                "pulley_radius_mm": cables.iter().map(|c| c.pulley_radius_m * 1e3).collect::<Vec<_>>(),
                "attachments_mm": cables.iter().map(|c| mm(&c.attachment_m)).collect::<Vec<_>>(),
                "platform_mass_kg": self.robot.mass_kg,
                "platform_com_mm": mm(&self.robot.center_of_mass_m),
                "home_pose_index": self.robot.home,
            },
            "camera": {
                "fx": self.camera.focal_px[0], "fy": self.camera.focal_px[1],
                "cx": self.camera.center_px[0], "cy": self.camera.center_px[1],
                "width": self.camera.size_px[0] as f64, "height": self.camera.size_px[1] as f64,
                "distortion": self.camera.distortion,
            },
            "tags": tags,
            "noise_1sigma": {
                "encoder_mm": self.noise.encoder_m * 1e3, "corner_px": self.noise.corner_px,
                "tension_N": self.noise.tension_n,
            },
            "nominal": {
                "H_world_tag_bodies": self.world_from_body.iter().map(matrix_mm).collect::<Vec<_>>(),
                "H_camera_platform": matrix_mm(&self.camera_from_platform),
            },
            "poses": poses,
            "poses_at_rest": self.at_rest,
            "holdout_H_tag_platform": self.holdout.iter().map(matrix_mm).collect::<Vec<_>>(),
        });
        if let Some(sigma) = self.noise.tilt_rad {
            out["noise_1sigma"]["tilt_deg"] = json!(sigma.to_degrees());
        }
        if self.robot.routing_m.iter().any(|l| *l > 0.0) {
            let routing: Vec<_> = self.robot.routing_m.iter().map(|l| l * 1e3).collect();
            out["robot"]["routing_lengths_mm"] = json!(routing);
        }
        if self.robot.compliance_per_n > 0.0 {
            out["robot"]["cable_ea_N"] = json!(1.0 / self.robot.compliance_per_n);
        }
        if let Some(limits) = &self.robot.limits {
            out["robot"]["limits"] = json!({
                "box_mm": limits.box_in_world_m.each_ref().map(mm),
                "tension_N": limits.tension_n, "held_tension_N": limits.held_n,
                "tilt_deg": limits.tilt_max_rad.to_degrees(),
            });
        }
        if let Some(origin) = &self.origin {
            out["origin"] = json!({
                "robot": origin.robot, "robot_hash": format!("{:08x}", origin.robot_hash),
                "simulated_seed": origin.simulated_seed, "date": origin.date,
            });
            if let Some(machine) = &origin.simulated_machine {
                out["origin"]["simulated_machine"] = json!(machine);
            }
        }
        out
    }
}

/// A pose as a row-major 4x4 matrix in mm.
#[must_use]
pub(crate) fn matrix_mm(pose: &Pose) -> [[f64; 4]; 4] {
    let r = pose.rotation.matrix();
    let mut out = [[0.0, 0.0, 0.0, 1.0]; 4];
    for (i, row) in out.iter_mut().take(3).enumerate() {
        *row = [r[(i, 0)], r[(i, 1)], r[(i, 2)], pose.position_m[i] * 1e3];
    }
    out
}
