//! Where the camera saw the tags while the lengths were known.
//!
//! A tag on the floor half a metre away shows the tool through the platform's attitude. A centre of mass 1 mm
//! off turns the platform by 1 to 2 mrad: half a millimetre and more at the tag, and more than all else
//! together. A view taken when the robot was homed shows that centre of mass by the platform's attitude, and the
//! errors of the camera's mounting and of the tag's place as one displacement of the camera. With both the tags
//! show the tool relative to the place of homing.

use crate::estimate::{EstimateError, Measurements};
use crate::motion::{Model, StaticState};
use crate::robot::{Robot, TagPlace};
use mcdpr_kinematics::Pose;
use mcdpr_protocol::frame::crc32;
use nalgebra::{DMatrix, DVector, Matrix3, Rotation3, SVector, Vector3};
use serde::{Deserialize, Serialize};

const UNKNOWNS: usize = 6;
type Unknowns = SVector<f64, UNKNOWNS>;
/// Steps of the numerical derivatives, m, and of the search: the displacement is small.
const CHANGE: f64 = 1e-6;
const CENTER_STEP_M: f64 = 1e-4;
const STEPS: usize = 6;
/// A displacement beyond this is not the error of a calibrated camera: another tag, or one that was moved.
const MOST_M: f64 = 2e-3;
const MOST_CENTER_M: f64 = 6e-3;

/// Standard deviations before a view, m per axis: of the centre of mass, and of the places of homing, tag and camera
/// together.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Priors {
    pub(super) center_m: f64,
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
    /// Displacement of the centre of mass, platform frame, m.
    pub center_m: [f64; 3],
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
    turns: &Matrix3<f64>,
    x: &Unknowns,
) -> Option<DVector<f64>> {
    let robot = model.robot();
    let center_m = x.fixed_rows::<3>(3).into_owned();
    let mounted = displaced(
        robot,
        &x.fixed_rows::<3>(0).into_owned(),
        &(turns * center_m),
    );
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
    rows.extend(center_m.iter().map(|center| center / priors.center_m));
    Some(DVector::from_vec(rows))
}

/// The robot with its centre of mass displaced, m.
fn with_center(robot: &Robot, by_m: &Vector3<f64>) -> Robot {
    let mut robot = robot.clone();
    robot.platform.center_of_mass_m += by_m;
    robot
}

/// How far a centre of mass that is off turns the platform at `rest`: rotation vector in the platform's frame per
/// metre, 3 x 3.
fn turns_per_m(model: &Model, rest: &StaticState) -> Option<Matrix3<f64>> {
    let tool_m = model.tool_m(rest);
    let held = model.holding().first_by_tension().unwrap_or(0);
    let tension_n = rest.tensions_n().get(held).copied()?;
    let mut turns = Matrix3::zeros();
    for axis in 0..3 {
        let mut by_m = Vector3::zeros();
        by_m[axis] = CENTER_STEP_M;
        let other = Model::new(&with_center(model.robot(), &by_m)).ok()?;
        let there = other.rest_with(&tool_m, tension_n, Some(rest)).ok()?;
        let turn = rest.equilibrium.pose.rotation.inverse() * there.equilibrium.pose.rotation;
        turns.set_column(axis, &(turn.scaled_axis() / CENTER_STEP_M));
    }
    Some(turns)
}

/// camera_from_platform of a platform that is displaced by `shift_m` and turned by `turn_rad` about the tool, both
/// in its own frame, from where statics have it.
fn displaced(robot: &Robot, shift_m: &Vector3<f64>, turn_rad: &Vector3<f64>) -> Pose {
    let tool_m = robot.tool.tcp_in_platform_m;
    let rotation = Rotation3::new(*turn_rad);
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
        let turns = turns_per_m(model, rest)?;
        let mut x = Unknowns::zeros();
        for _ in 0..STEPS {
            let here = rows(model, rest, seen, priors, &turns, &x)?;
            let mut slopes = DMatrix::zeros(here.len(), UNKNOWNS);
            for column in 0..UNKNOWNS {
                let mut moved = x;
                moved[column] += CHANGE;
                let there = rows(model, rest, seen, priors, &turns, &moved)?;
                slopes.set_column(column, &((there - &here) / CHANGE));
            }
            let normal = (slopes.transpose() * &slopes).cholesky()?;
            x -=
                Unknowns::from_iterator(normal.solve(&(slopes.transpose() * here)).iter().copied());
        }
        let shift_m: Vector3<f64> = x.fixed_rows::<3>(0).into_owned();
        let center_m: Vector3<f64> = x.fixed_rows::<3>(3).into_owned();
        (shift_m.norm() <= MOST_M && center_m.norm() <= MOST_CENTER_M).then(|| Self {
            scale,
            scene: scene_of(model.robot(), &seen.places),
            homed_m,
            shift_m: shift_m.into(),
            center_m: center_m.into(),
        })
    }

    /// Whether it is of this robot, with this camera and these places of tags.
    #[must_use]
    pub fn belongs_to(&self, robot: &Robot, places: &[TagPlace], scale: u32) -> bool {
        self.scale == scale && self.scene == scene_of(robot, places)
    }

    /// The robot with centre of mass and camera so that it shows the tags as it did.
    ///
    /// # Errors
    /// [`EstimateError::NoFit`] where the robot cannot be modelled.
    pub(super) fn seen_by(&self, model: &Model) -> Result<Model, EstimateError> {
        let mut robot = with_center(model.robot(), &self.center_m.into());
        let shift_m = self.shift_m.into();
        robot.camera.camera_from_platform = displaced(model.robot(), &shift_m, &Vector3::zeros());
        let eye = Model::new(&robot).map_err(|source| EstimateError::NoFit {
            source: Box::new(source),
        })?;
        Ok(eye.with_options(model.options()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sight::TagView;

    /// Corners that the camera of `model` sees with the tool at `tool_m`.
    fn view(model: &Model, tool_m: &Vector3<f64>, places: &[TagPlace]) -> TagView {
        let robot = model.robot();
        let rest = model.rest(tool_m, None).unwrap();
        let mounted = &robot.camera.camera_from_platform;
        let camera_from_world = mounted.compose(&rest.equilibrium.pose.inverse());
        let camera_from_body = camera_from_world.compose(&places[0].world_from_body);
        let tag = &robot.tags[0];
        let corners_px = tag.corners_in_body_m.map(|corner| {
            let at = camera_from_body.transform(&corner);
            robot
                .camera
                .lens
                .projection(&at.into())
                .unwrap()
                .pixel
                .into()
        });
        TagView {
            id: tag.id,
            corners_px,
            covariance_px2: [[[0.07 * 0.07, 0.0], [0.0, 0.07 * 0.07]]; 4],
            image_time_us: 0,
        }
    }

    fn most_px(a: &TagView, b: &TagView) -> f64 {
        let pairs = a
            .corners_px
            .iter()
            .flatten()
            .zip(b.corners_px.iter().flatten());
        pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    }

    #[test]
    fn a_view_at_homing_shows_what_the_camera_sees_elsewhere() {
        let robot = Robot::built_in("lab-fast").unwrap();
        let model = Model::new(&robot).unwrap();
        let home_m = robot.tool.home_in_world_m;
        let place = TagPlace {
            body: robot.tags[0].body,
            world_from_body: Pose::new(
                Vector3::new(home_m.x, home_m.y, -0.725),
                Rotation3::from_euler_angles(std::f64::consts::PI, 0.0, 0.4),
            ),
        };
        let mut really = with_center(&robot, &Vector3::new(0.8e-3, -0.6e-3, 0.0));
        let shift_m = Vector3::new(1e-4, 2e-4, -1e-4);
        really.camera.camera_from_platform = displaced(&really, &shift_m, &Vector3::zeros());
        let truth = Model::new(&really).unwrap();
        let seen = Measurements {
            views: vec![view(&truth, &home_m, &[place])],
            places: vec![place],
            ..Measurements::default()
        };
        let priors = Priors {
            center_m: 1e-3,
            place_m: 2.6e-4,
        };
        let rest = model.rest(&home_m, None).unwrap();
        let found = TagReference::measure(&model, &rest, &seen, priors, 1e-4, 7).unwrap();
        assert!(found.belongs_to(&robot, &[place], 7) && !found.belongs_to(&robot, &[place], 8));
        let mut moved = place;
        moved.world_from_body.position_m.x += 1e-3;
        assert!(!found.belongs_to(&robot, &[moved], 7));
        let elsewhere_m = home_m + Vector3::new(0.08, -0.06, 0.04);
        let sees = view(&truth, &elsewhere_m, &[place]);
        let file_px = most_px(&view(&model, &elsewhere_m, &[place]), &sees);
        let eye = found.seen_by(&model).unwrap();
        let eye_px = most_px(&view(&eye, &elsewhere_m, &[place]), &sees);
        assert!(file_px > 1.0, "{file_px} px");
        assert!(eye_px < 0.25 * file_px, "{eye_px} of {file_px} px");
        // A tag that was carried away is not the error of a calibrated camera.
        let mut far = seen.clone();
        far.places[0].world_from_body.position_m.z += 0.03;
        assert!(TagReference::measure(&model, &rest, &far, priors, 1e-4, 7).is_none());
        let none = Measurements::default();
        assert!(TagReference::measure(&model, &rest, &none, priors, 1e-4, 7).is_none());
    }
}
