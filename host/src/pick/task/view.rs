//! One picture of the tray: the camera's pose, and the grasps in it.

use super::Picker;
use crate::link::Link;
use crate::pick::choose::{Choices, choose};
use crate::pick::mat::MatSight;
use crate::pick::task::{CALM_S, Watcher};
use crate::pick::{Phase, PickError};
use crate::sight::{GraspMark, Shown};
use mcdpr_vision::grasp::{Area, Closing, HeightMap, NoGrasp, Wanted};
use mcdpr_vision::{Aligned, align};
use nalgebra::{Isometry3, Vector2, Vector3};
use std::sync::Arc;

/// Distances that differ by this share from the mat's indicate another unit or another camera.
const SCALE_MAX: f64 = 0.1;

/// Content of a picture of the tray.
pub(super) enum Viewed {
    /// Grasps: their number, and the executable ones.
    Grasps { count: usize, choices: Choices },
    /// None, for this reason.
    Nothing(NoGrasp),
}

impl<L: Link> Picker<'_, L> {
    /// Takes one picture: number of grasps in it, and the executable ones.
    pub(super) fn view(
        &mut self,
        probe: &mut Option<[f64; 3]>,
        watcher: &mut dyn Watcher,
    ) -> Result<Viewed, PickError> {
        self.arm.wait(CALM_S)?;
        let by_lengths = self.arm.world_from_platform()?;
        let eye = &mut *self.eye;
        let frame = self.arm.until(|| eye.poll_frame())??;
        watcher.pictured();
        self.views += 1;
        let by_mat = self.platform_by_mat(&frame.color, &by_lengths)?;
        self.sights.push(by_mat.map(|by_mat| by_mat.sight));
        let world_from_platform = by_mat.map_or(by_lengths, |by_mat| by_mat.world_from_platform);
        self.begins(Phase::Choosing);
        let picture = self.arm.meanwhile(|_| align(&frame))?;
        let robot = self.arm.model().robot();
        let platform_from_camera = Isometry3::from(robot.camera.camera_from_platform).inverse();
        let world_from_camera = world_from_platform * platform_from_camera;
        let options = self.options;
        if let (None, Some(pixel)) = (&probe, options.probe_px) {
            *probe = seen_at(&picture, &world_from_camera, pixel);
        }
        let tray = Isometry3::translation(options.tray_m.x, options.tray_m.y, options.tray_m.z);
        let closing = if options.turns {
            Closing::Any
        } else {
            // Jaws that do not turn close along the platform's y.
            let jaw = world_from_platform.rotation * Vector3::y();
            Closing::Along(world_from_camera.rotation.inverse() * jaw)
        };
        let wanted = Wanted {
            hand: options.hand,
            closing,
            area: Some(Area {
                camera_from_area: world_from_camera.inverse() * tray,
                half_m: options.tray_half_m,
            }),
        };
        let map = match self.arm.meanwhile(|_| HeightMap::new(&picture))? {
            Ok(map) => map,
            Err(reason) => return Ok(Viewed::Nothing(reason)),
        };
        if let Some(by_mat) = &by_mat {
            agree(&map.camera_from_map, &by_mat.sight)?;
        }
        let detector = &mut *self.detector;
        let grasps = match self.arm.meanwhile(|_| detector.detect(&picture, &wanted))? {
            Ok(grasps) => grasps,
            Err(reason) => return Ok(Viewed::Nothing(reason)),
        };
        let mut choices = self.arm.meanwhile(|model| {
            let (hand, turns) = (&options.hand, options.turns);
            choose(model, &map, &grasps, &world_from_camera, hand, turns)
        })?;
        for choice in &mut choices.good {
            choice.view = self.views - 1;
        }
        let best = choices.good.iter();
        let best = best.max_by(|a, b| a.rank().total_cmp(&b.rank()));
        let shown = Shown {
            picture: Arc::new(frame.color.clone()),
            source: "what the tool's camera sees",
            tags: Vec::new(),
            grasp: best.and_then(|choice| {
                let grasp = &choice.grasp;
                let (middle, at) = (grasp.pixel.into(), &grasp.point_m);
                let color = &frame.cameras.color;
                GraspMark::new(color, middle, at, &grasp.closing, grasp.width_m)
            }),
        };
        self.arm.show(&shown);
        if shown.grasp.is_some() {
            watcher.looked(&shown);
        }
        Ok(Viewed::Grasps {
            count: grasps.len(),
            choices,
        })
    }
}

/// Checks that the depth camera's ground agrees with the colour camera's mat that lies on it.
fn agree(camera_from_map: &Isometry3<f64>, mat: &MatSight) -> Result<(), PickError> {
    // The map's origin lies on the camera's axis.
    let (depth_m, mat_m) = (camera_from_map.translation.z, mat.ahead_m());
    if (depth_m / mat_m - 1.0).abs() < SCALE_MAX {
        return Ok(());
    }
    Err(PickError::Distances { depth_m, mat_m })
}

/// Position of a pixel in the world (Eqs. 45 and 48): its direction times its distance, through the
/// camera's pose. `None` if it has no distance.
fn seen_at(
    picture: &Aligned,
    world_from_camera: &Isometry3<f64>,
    pixel: [f64; 2],
) -> Option<[f64; 3]> {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a pixel of the picture"
    )]
    let depth_m = picture
        .depth
        .depth_m(pixel[0] as usize, pixel[1] as usize)?;
    let along = picture.camera.direction(&Vector2::from(pixel));
    let point = nalgebra::Point3::new(along.x * depth_m, along.y * depth_m, depth_m);
    Some((world_from_camera * point).coords.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_in_another_unit_are_reported() {
        let mat = MatSight::sure(Isometry3::new(
            Vector3::new(0.1, 0.02, -0.4),
            Vector3::new(0.0, 0.05, 0.0),
        ));
        let ground = |z_m: f64| Isometry3::translation(0.0, 0.0, z_m);
        let at_m = mat.ahead_m();
        assert!(agree(&ground(at_m * 1.02), &mat).is_ok());
        // Millimetres instead of tenths of them, and inches.
        for wrong in [10.0, 0.1, 1.27] {
            let error = agree(&ground(at_m * wrong), &mat).unwrap_err();
            assert!(error.to_string().contains("unit"), "{error}");
        }
    }
}
