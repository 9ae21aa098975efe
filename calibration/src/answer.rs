//! The result of a calibration, and its file form.

use super::data::matrix_mm;
use super::unknowns::{Layout, State};
use mcdpr_kinematics::{Cable, Pose};
use mcdpr_vision::Camera;
use nalgebra::{DMatrix, Matrix3, Vector3};
use serde_json::{Value, json};

/// Ratio of squared error to expectation above which the lower poses contradict the upper ones.
const RATIO_MAX: f64 = 4.0;

/// The accuracy at the lower poses of a calibration from the upper poses alone.
#[derive(Debug, Clone)]
pub struct Split {
    /// Poses that it was trained on.
    pub upper: usize,
    /// Poses that it was tested on.
    pub lower: usize,
    /// Root mean square position error there, m.
    pub error_m: f64,
    /// Error expected from its covariance, m.
    pub expected_m: f64,
    /// Mean squared error in units of its covariance; 1 for consistent data.
    pub ratio: f64,
    /// The quantity that differs most from its stated value, in words.
    pub suspect: String,
}

impl Split {
    /// The warning, if the lower poses contradict the upper ones.
    #[must_use]
    pub fn warning(&self) -> Option<String> {
        (self.ratio > RATIO_MAX).then(|| {
            format!(
                "a calibration by the {} upper poses, sizes as stated, misses the {} lower ones by {:.2} mm \
                 ({:.2} expected): {}",
                self.upper,
                self.lower,
                self.error_m * 1e3,
                self.expected_m * 1e3,
                self.suspect
            )
        })
    }
}

/// A pose that is worth measuring next.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NextPose {
    /// world_from_platform.
    pub pose: Pose,
    /// The cable (from 0) whose tension is held.
    pub held: usize,
    /// Its tension, N.
    pub tension_n: f64,
    /// Expected root mean square position error without and with it, m.
    pub expected_error_m: [f64; 2],
}

/// Expected error at one position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MapPoint {
    /// Platform's origin, world, m.
    pub at_m: Vector3<f64>,
    /// Root mean square position error of a level platform there, in the tags' frame, m.
    pub rms_m: f64,
}

/// A measurement that is inconsistent with the rest.
#[derive(Debug, Clone, PartialEq)]
pub struct RejectedRow {
    /// Pose, from 1.
    pub pose: usize,
    /// `encoder`, `tension`, `tilt` or `corner`.
    pub kind: &'static str,
    /// Cable, from 1.
    pub cable: Option<usize>,
    /// Id of the tag.
    pub tag: Option<u32>,
    /// Corner of the tag, from 0.
    pub corner: Option<usize>,
    /// Residual, in standard deviations of the measurement.
    pub sigmas: f64,
}

/// Quantities estimated besides the core unknowns.
#[derive(Debug, Clone)]
pub struct Further {
    /// True length per length that the encoder reports.
    pub drum_scale: f64,
    /// The same of each drum.
    pub drum_scales: Vec<f64>,
    /// True size of the tags per stated size.
    pub tag_scale: f64,
    /// The camera.
    pub camera: Camera,
    /// Results from the equations of equilibrium, if they were used.
    pub statics: Option<Statics>,
    /// How the inclinometer is turned on the platform, if there was one: rotation vector of
    /// platform_from_sensor, rad.
    pub mount_rad: Option<Vector3<f64>>,
}

/// What was estimated from the equations of equilibrium.
#[derive(Debug, Clone, PartialEq)]
pub struct Statics {
    /// Mass of the platform, kg.
    pub mass_kg: f64,
    /// Its centre of mass, platform frame, m.
    pub center_of_mass_m: Vector3<f64>,
    /// 1/EA of the cables, 1/N.
    pub compliance_per_n: f64,
    /// The same of each cable, 1/N.
    pub compliances_per_n: Vec<f64>,
    /// What each tension sensor reads without tension, N.
    pub zero_n: Vec<f64>,
    /// Share of the tension that each cable loses at its pulleys.
    pub loss: Vec<f64>,
}

/// Rank of a linear problem.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rank {
    /// Directions that the data determine.
    pub rank: usize,
    /// Unknowns.
    pub unknowns: usize,
}

/// What the equations of equilibrium leave unexplained at a pose, new at every pose: standard deviations, larger by what a region
/// of 95 % needs because they were estimated from few poses (3 F(3, n) over chi-square(3)).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Unexplained {
    /// Force, level and vertical, N.
    pub force_n: [f64; 2],
    /// Moment, about level axes and about the vertical, N m.
    pub moment_nm: [f64; 2],
}

/// A calibration.
#[derive(Debug, Clone)]
pub struct Answer {
    /// `joint` or `paper`.
    pub method: &'static str,
    /// The cables: anchors, pulley radii, attachments, m.
    pub cables: Vec<Cable>,
    /// Length of each cable when its encoder reads zero, m.
    pub initial_length_m: Vec<f64>,
    /// world_from_body of every body of tags.
    pub world_from_body: Vec<Pose>,
    /// camera_from_platform.
    pub camera_from_platform: Pose,
    /// Further estimates; `None` if there are none.
    pub further: Option<Further>,
    /// Predicted encoder readings at the held-out poses, m.
    pub holdout_encoder_m: Vec<Vec<f64>>,
    /// Covariance of the platform's position there, world axes, m^2.
    pub holdout_covariance_m2: Vec<Matrix3<f64>>,
    /// Weighted sum of squares of the measurements used.
    pub chi_square: Option<f64>,
    /// Its expected value: number of measurements less the degrees of freedom of the estimate.
    pub degrees_of_freedom: Option<f64>,
    /// Directions of the core unknowns that the data determine.
    pub rank: usize,
    /// Number of core unknowns.
    pub core_unknowns: usize,
    /// Rank of the paper's differenced start (Eqs. 24-26).
    pub differenced_rank: Option<Rank>,
    /// The other directions in words.
    pub unobservable: Vec<String>,
    /// Measurements left out.
    pub rejected: Vec<RejectedRow>,
    /// A cable whose lengths fit on one side of a moment only: it slipped there, in words.
    pub rejected_stretch: Option<String>,
    /// Relative scatter of tensions found beyond the sensor's.
    pub tension_scatter_relative: Option<f64>,
    /// Force (level, vertical, N) and moment (about level axes, about the vertical, N m) that statics leave unexplained at
    /// a pose, standard deviations.
    pub unexplained: Option<Unexplained>,
    /// Warnings for the user.
    pub warnings: Vec<String>,
    /// Predicted root mean square position error over the held-out (or else the measured) poses, m.
    pub predicted_error_m: f64,
    /// The same at the worst pose, m.
    pub worst_predicted_error_m: f64,
    /// Steps taken.
    pub iterations: usize,
    /// Covariance of all shared unknowns, in the order of `Layout`.
    pub covariance: Option<DMatrix<f64>>,
    /// The estimate itself, of the joint method.
    pub solved: Option<Solved>,
    /// Expected error over the work space, if the assay was asked for.
    pub map: Vec<MapPoint>,
    /// The pose that would help most.
    pub next: Option<NextPose>,
    /// The test of the lower poses by the upper ones.
    pub split: Option<Split>,
}

/// An estimate of the joint method.
#[derive(Debug, Clone)]
pub struct Solved {
    /// All values.
    pub state: State,
    /// Their order in the covariance.
    pub layout: Layout,
    /// Number (from 0) in the data of each of its poses.
    pub numbers: Vec<usize>,
    /// Mean measured tension of each cable, N.
    pub mean_tension_n: Vec<f64>,
}

impl Answer {
    /// An answer with the values of a state and all other fields empty.
    #[must_use]
    pub(crate) fn of_state(method: &'static str, state: &State, layout: &Layout) -> Self {
        Self {
            method,
            cables: state.cables.clone(),
            initial_length_m: state.initial_length_m.clone(),
            world_from_body: state.world_from_body.clone(),
            camera_from_platform: state.camera_from_platform,
            further: Some(Further {
                drum_scale: state.drum_scale,
                drum_scales: (0..state.cables.len()).map(|i| state.scale(i)).collect(),
                tag_scale: state.tag_scale,
                camera: state.camera,
                statics: layout.statics.then(|| Statics {
                    mass_kg: state.mass_kg,
                    center_of_mass_m: state.center_of_mass_m,
                    compliance_per_n: state.compliance_per_n,
                    compliances_per_n: (0..state.cables.len())
                        .map(|i| state.compliance(i))
                        .collect(),
                    zero_n: state.zero_n.clone(),
                    loss: state.loss.clone(),
                }),
                mount_rad: layout.tilt.then_some(state.mount_rad),
            }),
            holdout_encoder_m: Vec::new(),
            holdout_covariance_m2: Vec::new(),
            chi_square: None,
            degrees_of_freedom: None,
            rank: 0,
            core_unknowns: 0,
            differenced_rank: None,
            unobservable: Vec::new(),
            rejected: Vec::new(),
            rejected_stretch: None,
            tension_scatter_relative: None,
            unexplained: None,
            warnings: Vec::new(),
            predicted_error_m: f64::NAN,
            worst_predicted_error_m: f64::NAN,
            iterations: 0,
            covariance: None,
            solved: None,
            map: Vec::new(),
            next: None,
            split: None,
        }
    }

    /// The file form: mm, kg, N, px.
    #[must_use]
    pub fn to_json(&self) -> Value {
        let mm = |v: &Vector3<f64>| [v.x * 1e3, v.y * 1e3, v.z * 1e3];
        // JSON has no NaN.
        let number = |x: f64| if x.is_finite() { json!(x) } else { Value::Null };
        let covariance: Vec<_> = self
            .holdout_covariance_m2
            .iter()
            .map(|c| {
                let c = c * 1e6;
                [0, 1, 2].map(|i| [c[(i, 0)], c[(i, 1)], c[(i, 2)]])
            })
            .collect();
        let lengths: Vec<Vec<f64>> = self
            .holdout_encoder_m
            .iter()
            .map(|list| list.iter().map(|l| l * 1e3).collect())
            .collect();
        let rejected: Vec<_> = self
            .rejected
            .iter()
            .map(|row| {
                json!({"pose": row.pose, "kind": row.kind, "cable": row.cable, "tag": row.tag,
                       "corner": row.corner, "sigmas": row.sigmas})
            })
            .collect();
        let mut out = json!({
            "schema": "mcdpr-calibration-answer-1",
            "method": self.method,
            "anchors_mm": self.cables.iter().map(|c| mm(&c.anchor_m)).collect::<Vec<_>>(),
            "initial_lengths_mm": self.initial_length_m.iter().map(|l| l * 1e3).collect::<Vec<_>>(),
            "H_world_tag": self.world_from_body.first().map(matrix_mm),
            "H_world_tag_bodies": self.world_from_body.iter().map(matrix_mm).collect::<Vec<_>>(),
            "H_camera_platform": matrix_mm(&self.camera_from_platform),
            "holdout_dl_mm": lengths,
            "holdout_position_cov_mm2": covariance,
            "chi_square": self.chi_square,
            "degrees_of_freedom": self.degrees_of_freedom,
            "rank": self.rank,
            "unknowns": self.core_unknowns,
            "unobservable": self.unobservable,
            "rejected_rows": rejected,
            "warnings": self.warnings,
            "verdict": if self.warnings.is_empty() { "accepted" } else { "accepted with warnings" },
            "predicted_tcp_error_mm": number(self.predicted_error_m * 1e3),
            "predicted_tcp_error_worst_mm": number(self.worst_predicted_error_m * 1e3),
            "iterations": self.iterations,
        });
        let mut set = |key: &str, value: Value| out[key] = value;
        if let Some(Rank { rank, unknowns }) = self.differenced_rank {
            set(
                "differenced_start",
                json!({"rank": rank, "unknowns": unknowns}),
            );
        }
        if let Some(split) = &self.split {
            set(
                "upper_lower_split",
                json!({"upper": split.upper, "lower": split.lower, "error_mm": split.error_m * 1e3,
                       "expected_mm": split.expected_m * 1e3, "ratio": split.ratio}),
            );
        }
        if let Some(next) = &self.next {
            let [without, with] = next.expected_error_m;
            set(
                "next_pose",
                json!({"position_mm": mm(&next.pose.position_m), "tension_cable": next.held + 1,
                       "tension_N": next.tension_n, "expected_error_mm": without * 1e3,
                       "expected_error_then_mm": with * 1e3}),
            );
        }
        if !self.map.is_empty() {
            let points = self
                .map
                .iter()
                .map(|p| json!({"at_mm": mm(&p.at_m), "rms_mm": p.rms_m * 1e3}));
            set("error_map", points.collect());
        }
        if let Some(further) = &self.further {
            let radii: Vec<_> = self
                .cables
                .iter()
                .map(|c| c.pulley_radius_m * 1e3)
                .collect();
            let attachments: Vec<_> = self.cables.iter().map(|c| mm(&c.attachment_m)).collect();
            set("pulley_radius_mm", json!(radii));
            set("attachments_mm", json!(attachments));
            set("drum_scale", json!(further.drum_scale));
            set("drum_scales", json!(further.drum_scales));
            set("tag_scale", json!(further.tag_scale));
            let camera = &further.camera;
            set(
                "camera",
                json!({"fx": camera.focal_px[0], "fy": camera.focal_px[1],
                       "cx": camera.center_px[0], "cy": camera.center_px[1],
                       "distortion": camera.distortion}),
            );
            if let Some(mount) = &further.mount_rad {
                let degrees = <[f64; 3]>::from(*mount).map(f64::to_degrees);
                set("inclinometer_mount_deg", json!(degrees));
            }
            if let Some(statics) = &further.statics {
                set("platform_mass_kg", json!(statics.mass_kg));
                set("platform_com_mm", json!(mm(&statics.center_of_mass_m)));
                set("cable_compliance_per_N", json!(statics.compliance_per_n));
                set("cable_compliances_per_N", json!(statics.compliances_per_n));
                set("tension_zero_N", json!(statics.zero_n));
                set("pulley_loss", json!(statics.loss));
                set(
                    "tension_scatter_relative",
                    json!(self.tension_scatter_relative),
                );
                if let Some(unexplained) = &self.unexplained {
                    set("unexplained_force_N", json!(unexplained.force_n));
                    set("unexplained_moment_Nm", json!(unexplained.moment_nm));
                }
            }
        }
        out
    }
}
