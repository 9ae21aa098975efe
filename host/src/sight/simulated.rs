//! Tags of the simulated robot at corner level: the plant's true pose, projected, with noise.

use super::{Scene, SightError, TagSource, TagView};
use crate::link::{Link, SimulatedLink};
use mcdpr_core::random::Random;
use mcdpr_kinematics::Pose;
use nalgebra::{Matrix3, Rotation3, Vector3};

/// Observes the simulated robot through its true camera. Detection is represented by noise of the
/// corners; pictures are rendered by another source.
pub struct SimulatedTags {
    link: SimulatedLink,
    scene: Scene,
    sigma_px: f64,
    random: Random,
}

impl SimulatedTags {
    /// A view of the robot behind `link`, with normal noise of `sigma_px` on each coordinate.
    #[must_use]
    pub fn new(link: SimulatedLink, scene: Scene, sigma_px: f64, seed: u64) -> Self {
        Self {
            link,
            scene,
            sigma_px,
            random: Random::new(seed ^ 0x7461_6773),
        }
    }

    /// The true scene.
    #[must_use]
    pub const fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The true scene, to move a tag.
    #[cfg(test)]
    pub(crate) const fn scene_mut(&mut self) -> &mut Scene {
        &mut self.scene
    }
}

impl TagSource for SimulatedTags {
    fn look(&mut self) -> Result<Vec<TagView>, SightError> {
        let truth = self.link.with(|simulation| simulation.plant().truth());
        let truth = truth.map_err(|error| SightError::Simulation {
            what: error.to_string(),
        })?;
        let rows = truth.pose.matrix();
        let rotation = Matrix3::from_fn(|i, j| rows[i][j]);
        let world_from_platform = Pose::new(
            truth.pose.position_m.into(),
            Rotation3::from_matrix_unchecked(rotation),
        );
        let camera_from_world = self
            .scene
            .camera_from_platform
            .compose(&world_from_platform.inverse());
        let variance = self.sigma_px * self.sigma_px;
        let image_time_us = self.link.now_us();
        let mut views = Vec::new();
        for tag in &self.scene.tags {
            let Some(world_from_body) = self.scene.body(tag.body) else {
                continue;
            };
            let camera_from_body = camera_from_world.compose(world_from_body);
            let points = tag
                .corners_in_body_m
                .map(|corner| camera_from_body.transform(&corner));
            if !faces_camera(&points) {
                continue;
            }
            let mut corners_px = [[0.0; 2]; 4];
            let mut whole = true;
            for (slot, point) in corners_px.iter_mut().zip(&points) {
                let seen = self.scene.lens.projection(&(*point).into());
                let inside = seen.filter(|p| {
                    let [width, height] = self.scene.lens.size_px.map(|size| size as f64);
                    (0.0..width).contains(&p.pixel.x) && (0.0..height).contains(&p.pixel.y)
                });
                match inside {
                    Some(p) => *slot = p.pixel.into(),
                    None => whole = false,
                }
            }
            // A detector needs all four edges of a tag.
            if !whole {
                continue;
            }
            for value in corners_px.iter_mut().flatten() {
                *value += self.sigma_px * self.random.normal();
            }
            views.push(TagView {
                id: tag.id,
                corners_px,
                covariance_px2: [[[variance, 0.0], [0.0, variance]]; 4],
                image_time_us,
            });
        }
        views.sort_by_key(|view| view.id);
        Ok(views)
    }
}

/// Whether the printed side is towards the camera: corners run clockwise as seen from it.
fn faces_camera(points: &[Vector3<f64>; 4]) -> bool {
    let [a, b, c, _] = points;
    (b - a).cross(&(c - b)).dot(a) > 0.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::SimulatedRobot;
    use crate::machine::Mismatch;
    use crate::motion::Model;
    use crate::robot::Robot;
    use mcdpr_calibration::pnp;

    fn robot_at_home(seed: u64) -> (SimulatedLink, SimulatedTags) {
        let robot = Robot::built_in("paper-optimistic").unwrap();
        let model = Model::new(&robot).unwrap();
        let link = SimulatedRobot::new(Mismatch::realistic(), seed)
            .at_home(&model)
            .unwrap();
        let scene = Scene::on_floor(&robot, 5e-3, 0.02, seed);
        let tags = SimulatedTags::new(link.clone(), scene, 0.1, seed);
        (link, tags)
    }

    #[test]
    fn the_middle_of_many_looks_is_the_projection() {
        let (_, mut tags) = robot_at_home(3);
        let mut exact = SimulatedTags::new(tags.link.clone(), tags.scene.clone(), 0.0, 0);
        let exact = exact.look().unwrap();
        assert_eq!(exact.len(), 1);
        let (n, mut sum, mut square) = (400, [[0.0; 2]; 4], 0.0);
        for _ in 0..n {
            let view = tags.look().unwrap()[0];
            assert!((view.sigma_px() - 0.1).abs() < 1e-12);
            let seen = view.corners_px.iter().flatten();
            let exact = exact[0].corners_px.iter().flatten();
            for (slot, (seen, exact)) in sum.iter_mut().flatten().zip(seen.zip(exact)) {
                *slot += seen - exact;
                square += (seen - exact).powi(2);
            }
        }
        let sigma = (square / f64::from(n * 8)).sqrt();
        assert!((sigma - 0.1).abs() < 0.01, "{sigma}");
        for value in sum.iter().flatten() {
            assert!((value / f64::from(n)).abs() < 4.0 * 0.1 / 20.0);
        }
    }

    #[test]
    fn the_pose_in_the_picture_is_the_plants() {
        let (link, tags) = robot_at_home(4);
        let mut exact = SimulatedTags::new(link.clone(), tags.scene.clone(), 0.0, 0);
        let view = exact.look().unwrap()[0];
        let scene = tags.scene();
        let square = pnp::Square {
            corners_in_body_m: scene.tags[0].corners_in_body_m,
            corners_px: view.corners_px,
        };
        let found = pnp::sightings_of(&scene.lens, &[square]);
        let body = scene.body(0).unwrap();
        let camera = body.compose(&found[0].camera_from_body.inverse());
        let platform = camera.compose(&scene.camera_from_platform);
        let truth = link.with(|simulation| simulation.plant().truth().unwrap());
        let off = platform.position_m - Vector3::from(truth.pose.position_m);
        assert!(off.norm() < 1e-6, "{off}");
    }

    #[test]
    fn a_tag_that_is_turned_over_or_cut_off_is_not_seen() {
        let (_, mut tags) = robot_at_home(5);
        assert_eq!(tags.look().unwrap().len(), 1);
        let upright = tags.scene.places[0].world_from_body;
        let over = Vector3::new(std::f64::consts::PI, 0.0, 0.0);
        tags.scene_mut().places[0].world_from_body = upright.displaced(&Vector3::zeros(), &over);
        assert!(tags.look().unwrap().is_empty());
        tags.scene_mut().places[0].world_from_body =
            upright.displaced(&Vector3::new(2.0, 0.0, 0.0), &Vector3::zeros());
        assert!(tags.look().unwrap().is_empty());
    }
}
