//! Pictures of the simulated robot's camera, for viewers.

use super::Feed;
use crate::record::RunEvent;
use crate::record::events::Watcher;
use crate::robot::Robot;
use crate::sight::{Scene, SceneCamera, Shown, TagMark};
use mcdpr_simulator::plant::Pose;
use std::sync::Arc;

/// Time between two pictures, µs. Rendering is expensive: four per second would take 14 % of a
/// core.
const EVERY_US: u64 = 1_000_000;
/// Factor by which pictures are smaller than the camera's own.
const SHARE: f64 = 0.25;

/// Renders the pictures of a simulated robot's camera while there are viewers, and finds the tags
/// in them. It has its own thread and uses only the true states that it receives.
pub struct CameraWatcher {
    feed: Feed,
    camera: SceneCamera,
    due_us: u64,
    every_us: u64,
}

impl CameraWatcher {
    /// The camera of this robot, mounted and aimed according to `seed`.
    #[must_use]
    pub fn new(feed: Feed, robot: &Robot, seed: u64) -> Self {
        let camera = SceneCamera::new(Scene::of(robot, seed), seed).smaller(SHARE);
        Self {
            feed,
            camera,
            due_us: 0,
            every_us: EVERY_US,
        }
    }

    /// For a robot with so many simulated seconds per second: not more pictures than in real time.
    #[must_use]
    pub(crate) fn at_pace(self, scale: f64) -> Self {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "some seconds"
        )]
        let every_us = (EVERY_US as f64 * scale.max(1.0)) as u64;
        Self { every_us, ..self }
    }
}

impl Watcher for CameraWatcher {
    fn see(&mut self, event: &RunEvent) {
        let RunEvent::Truth { time_us, truth } = event else {
            return;
        };
        // The clock of another session may begin anew.
        let waiting = self.due_us.saturating_sub(*time_us);
        if (1..=self.every_us).contains(&waiting) || !self.feed.is_watched() {
            return;
        }
        self.due_us = time_us + self.every_us;
        let [x, y, z, w] = truth.rotation_xyzw;
        let pose = Pose {
            position_m: truth.position_m,
            rotation_wxyz: [w, x, y, z],
        };
        // A picture that cannot be rendered is not shown; the robot continues.
        let Ok(picture) = self.camera.picture(&pose.into()) else {
            return;
        };
        let tags = self.camera.tags(&picture, *time_us);
        let marks = tags.iter().map(|tag| TagMark {
            id: tag.id,
            corners_px: tag.corners_px,
        });
        self.feed.show(&Shown {
            source: "simulated camera on the platform",
            tags: marks.collect(),
            grasp: None,
            picture: Arc::new(picture),
        });
    }
}
