//! Where the camera saw the tags while the lengths were known.
//!
//! A tag on the floor half a metre away shows the tool through the platform's attitude. A centre of mass 1 mm
//! off turns the platform by 1 to 2 mrad: half a millimetre and more at the tag, and more than all else
//! together. The error is nearly the same wherever the robot hangs, like those of the camera's mounting and of
//! the tag's place. A view taken when the robot was homed shows all three as one small displacement of the
//! camera. With it the tags show the tool relative to the place of homing.

use crate::estimate::{EstimateError, Measurements};
use crate::motion::{Model, StaticState};
use crate::robot::{Robot, TagPlace};
use mcdpr_kinematics::Pose;
use mcdpr_protocol::frame::crc32;
use nalgebra::{DMatrix, DVector, Rotation3, SVector, Vector3};
use serde::{Deserialize, Serialize};

const UNKNOWNS: usize = 6;
type Unknowns = SVector<f64, UNKNOWNS>;
/// Steps of the numerical derivatives, m and rad, and of the search: the displacement is small.
const CHANGE: f64 = 1e-6;
const STEPS: usize = 6;
/// A displacement beyond this is not the error of a calibrated camera: another tag, or one that was moved.
const MOST_M: f64 = 2e-3;
const MOST_RAD: f64 = 0.015;

/// Standard deviations before a view: of the platform's attitude, rad, and of the places of homing, tag and
/// camera together, m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Priors {
    pub(super) attitude_rad: f64,
    pub(super) place_m: f64,
}

/// How the robot was homed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Homed {
    /// At a taught place.
    Taught,
    /// By the tags themselves: no better than they show the tool.
    ByTag,
}

/// Displacement of the camera by a view of tags when the robot was homed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TagReference {
    /// Checksum of geometry and scale: the lengths' meaning.
    pub scale: u32,
    /// Checksum of camera, tags and their places.
    pub scene: u32,
    /// Standard deviation of the place of homing, m per axis.
    pub homed_m: f64,
    /// Translation of the platform as the camera shows it, platform frame, m.
    pub shift_m: [f64; 3],
    /// Its rotation about the tool, rotation vector, platform frame, rad.
    pub turn_rad: [f64; 3],
}

/// The checksum of camera, tags and their places.
fn scene_of(robot: &Robot, places: &[TagPlace]) -> u32 {
    let camera = &robot.camera;
    let text = format!(
        "{:?} {:?} {:?} {places:?}",
        camera.lens, camera.camera_from_platform, robot.tags
    );
    crc32(text.as_bytes())
}

/// Corners, measured minus predicted, over their standard deviations, and the displacement over its priors.
/// `None` where a tag would be behind the camera.
fn rows(
    model: &Model,
    rest: &StaticState,
    seen: &Measurements,
    priors: Priors,
    x: &Unknowns,
) -> Option<DVector<f64>> {
    let robot = model.robot();
    let mounted = displaced(robot, x);
    let camera_from_world = mounted.compose(&rest.equilibrium.pose.inverse());
    let mut rows = Vec::new();
    for view in &seen.views {
        let tag = robot.tags.iter().find(|tag| tag.id == view.id)?;
        let place = seen.places.iter().find(|place| place.body == tag.body)?;
        let camera_from_body = camera_from_world.compose(&place.world_from_body);
        let corners = tag.corners_in_body_m.iter().zip(&view.corners_px);
        for ((corner, seen), covariance) in corners.zip(&view.covariance_px2) {
            let at = camera_from_body.transform(corner);
            let said = robot.camera.lens.projection(&at.into())?;
            rows.push((seen[0] - said.pixel.x) / covariance[0][0].max(1e-6).sqrt());
            rows.push((seen[1] - said.pixel.y) / covariance[1][1].max(1e-6).sqrt());
        }
    }
    rows.extend(x.rows(0, 3).iter().map(|shift| shift / priors.place_m));
    rows.extend(x.rows(3, 3).iter().map(|turn| turn / priors.attitude_rad));
    Some(DVector::from_vec(rows))
}

/// camera_from_platform of a platform that is displaced by `x` from where statics have it.
fn displaced(robot: &Robot, x: &Unknowns) -> Pose {
    let tool_m = robot.tool.tcp_in_platform_m;
    let rotation = Rotation3::new(x.fixed_rows::<3>(3).into_owned());
    let shift_m = x.fixed_rows::<3>(0).into_owned();
    let displacement = Pose::new(tool_m + shift_m - rotation * tool_m, rotation);
    let mounted = &robot.camera.camera_from_platform;
    mounted.compose(&displacement.inverse())
}

impl TagReference {
    /// By views of tags with the robot at `rest`, whose lengths are known. `None` where no tag is in view, or
    /// where the displacement is too large for a calibrated camera.
    pub(super) fn measure(
        model: &Model,
        rest: &StaticState,
        seen: &Measurements,
        priors: Priors,
        homed_m: f64,
        scale: u32,
    ) -> Option<Self> {
        if seen.views.is_empty() {
            return None;
        }
        let mut x = Unknowns::zeros();
        for _ in 0..STEPS {
            let here = rows(model, rest, seen, priors, &x)?;
            let mut slopes = DMatrix::zeros(here.len(), UNKNOWNS);
            for column in 0..UNKNOWNS {
                let mut moved = x;
                moved[column] += CHANGE;
                let there = rows(model, rest, seen, priors, &moved)?;
                slopes.set_column(column, &((there - &here) / CHANGE));
            }
            let normal = (slopes.transpose() * &slopes).cholesky()?;
            x -= Unknowns::from_iterator(normal.solve(&(slopes.transpose() * here)).iter().copied());
        }
        let shift_m: Vector3<f64> = x.fixed_rows::<3>(0).into_owned();
        let turn_rad: Vector3<f64> = x.fixed_rows::<3>(3).into_owned();
        (shift_m.norm() <= MOST_M && turn_rad.norm() <= MOST_RAD).then(|| Self {
            scale,
            scene: scene_of(model.robot(), &seen.places),
            homed_m,
            shift_m: shift_m.into(),
            turn_rad: turn_rad.into(),
        })
    }

    /// Whether it is of this robot, with this camera and these places of tags.
    #[must_use]
    pub fn belongs_to(&self, robot: &Robot, places: &[TagPlace], scale: u32) -> bool {
        self.scale == scale && self.scene == scene_of(robot, places)
    }

    /// The robot whose camera is displaced so that it shows the tags as it did.
    ///
    /// # Errors
    /// [`EstimateError::NoFit`] where the robot cannot be modelled.
    pub(super) fn seen_by(&self, model: &Model) -> Result<Model, EstimateError> {
        let mut x = Unknowns::zeros();
        x.fixed_rows_mut::<3>(0).copy_from(&Vector3::from(self.shift_m));
        x.fixed_rows_mut::<3>(3).copy_from(&Vector3::from(self.turn_rad));
        let mut robot = model.robot().clone();
        robot.camera.camera_from_platform = displaced(model.robot(), &x);
        let eye = Model::new(&robot).map_err(|source| EstimateError::NoFit {
            source: Box::new(source),
        })?;
        Ok(eye.with_options(model.options()))
    }
}
