//! Tags of the simulated robot through pictures: rendered, then detected like those of a real
//! camera.

use super::camera::views;
use super::{Scene, SightError, TagView};
use mcdpr_simulator::camera::{
    Body, Frame as Place, Lens, Optics, Scene as Surroundings, render_color,
};
use mcdpr_vision::RgbImage;
use nalgebra::Matrix3;

/// The simulated camera on the platform: pictures of a [`Scene`] from the platform's pose. Slower
/// than projected corners ([`super::SimulatedTags`]), but complete: blur, noise, shadows, a tag
/// that is cut by the picture's edge.
#[derive(Debug, Clone)]
pub struct SceneCamera {
    scene: Scene,
    seed: u64,
    taken: u64,
}

/// The floor that tags lie on.
const FLOOR: [f64; 3] = [0.4, 0.38, 0.35];

impl SceneCamera {
    /// The camera of a scene.
    #[must_use]
    pub const fn new(scene: Scene, seed: u64) -> Self {
        Self {
            scene,
            seed,
            taken: 0,
        }
    }

    /// The same camera with pictures of a share of its size: for viewers, who need no more.
    #[must_use]
    pub(crate) fn smaller(mut self, share: f64) -> Self {
        // Distortion is given for directions, not for pixels: it stays as it is.
        let lens = &mut self.scene.lens;
        for values in [&mut lens.focal_px, &mut lens.center_px] {
            *values = values.map(|value| value * share);
        }
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a picture's size"
        )]
        let scaled = |size: usize| (size as f64 * share).round() as usize;
        lens.size_px = lens.size_px.map(scaled);
        self
    }

    /// A picture with the platform at a pose, world_from_platform.
    ///
    /// # Errors
    /// [`SightError::Simulation`].
    pub fn picture(&mut self, world_from_platform: &Place) -> Result<RgbImage, SightError> {
        let camera_from_platform = frame(&self.scene.camera_from_platform);
        let world_from_camera = world_from_platform.then(&camera_from_platform.inverse());
        let seed = self.seed.wrapping_mul(1_000_003).wrapping_add(self.taken);
        self.taken += 1;
        let seen = render_color(
            &self.surroundings(),
            &self.lens(),
            &world_from_camera,
            &Optics::default(),
            seed,
        );
        RgbImage::new(seen.width, seen.height, seen.pixels).map_err(|error| {
            SightError::Simulation {
                what: error.to_string(),
            }
        })
    }

    /// The tags of the scene in a picture of this camera, in the order of their numbers.
    #[must_use]
    pub fn tags(&self, picture: &RgbImage, image_time_us: u64) -> Vec<TagView> {
        let ids: Vec<u32> = self.scene.tags.iter().map(|tag| tag.id).collect();
        views(picture, &self.scene.lens, &ids, image_time_us)
    }

    fn lens(&self) -> Lens {
        let lens = &self.scene.lens;
        Lens {
            size_px: lens.size_px,
            focal_px: lens.focal_px,
            center_px: lens.center_px,
            distortion: lens.distortion,
        }
    }

    /// Tags on sheets of paper that lie on a floor.
    fn surroundings(&self) -> Surroundings {
        let mut bodies = Vec::new();
        let mut lowest_m = f64::INFINITY;
        for place in &self.scene.places {
            let pose = &place.world_from_body;
            let on_body = self.scene.tags.iter().filter(|tag| tag.body == place.body);
            let tags: Vec<_> = on_body
                .map(|tag| {
                    let [a, b, c, d] = tag.corners_in_body_m;
                    let (x, y) = ((b - a).normalize(), (d - a).normalize());
                    let middle = (a + b + c + d) / 4.0;
                    let rotation = Matrix3::from_columns(&[x, y, x.cross(&y)]);
                    let frame = Place {
                        rotation: [0, 1, 2].map(|i| [0, 1, 2].map(|j| rotation[(i, j)])),
                        position_m: middle.into(),
                    };
                    for corner in tag.corners_in_body_m {
                        lowest_m = lowest_m.min(pose.transform(&corner).z);
                    }
                    (tag.id as usize, tag.size_m, frame)
                })
                .collect();
            bodies.push(Body::tags(&tags, frame(pose)));
        }
        let floor = Place::at([0.3, 0.0, lowest_m.min(0.0) - 0.025]);
        bodies.push(Body::fixed_box("floor", [2.0, 2.0, 0.01], floor, FLOOR));
        Surroundings {
            bodies,
            ..Surroundings::default()
        }
    }
}

fn frame(pose: &mcdpr_kinematics::Pose) -> Place {
    let m = pose.rotation.matrix();
    Place {
        rotation: [0, 1, 2].map(|i| [0, 1, 2].map(|j| m[(i, j)])),
        position_m: pose.position_m.into(),
    }
}

#[cfg(test)]
mod tests {
    use super::super::{SimulatedTags, TagSource};
    use super::*;
    use crate::experiment::SimulatedRobot;
    use crate::machine::Mismatch;
    use crate::motion::Model;
    use crate::robot::Robot;
    use nalgebra::Vector3;

    #[test]
    fn pictures_show_the_tags_where_projection_has_them() {
        let robot = Robot::built_in("paper-optimistic").unwrap();
        let model = Model::new(&robot).unwrap();
        let link = SimulatedRobot::new(Mismatch::default(), 1)
            .at_home(&model)
            .unwrap();
        let scene = Scene::on_floor(&robot, 1e-3, 1e-3, 3);
        let mut exact = SimulatedTags::new(link.clone(), scene.clone(), 0.0, 1);
        let truth = link.with(|simulation| simulation.plant().truth()).unwrap();
        let mut camera = SceneCamera::new(scene, 1);
        let picture = camera.picture(&Place::from(truth.pose)).unwrap();
        let (wanted, seen) = (exact.look().unwrap(), camera.tags(&picture, 0));
        assert!(!wanted.is_empty() && wanted.len() == seen.len());
        for (wanted, seen) in wanted.iter().zip(&seen) {
            assert_eq!(wanted.id, seen.id);
            for (a, b) in wanted.corners_px.iter().zip(&seen.corners_px) {
                let off = Vector3::new(a[0] - b[0], a[1] - b[1], 0.0).norm();
                assert!(off < 0.05, "{off} px");
            }
            assert!(seen.sigma_px() < 0.05);
        }
    }
}
