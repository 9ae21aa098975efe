//! Moving the tool to a position by the mat and the lengths.

use super::Picker;
use crate::link::Link;
use crate::pick::PickError;
use crate::pick::arm::isometry;
use crate::pick::mat::MatSight;
use mcdpr_vision::RgbImage;
use nalgebra::{Isometry3, Vector3};

/// A smaller distance counts as reached, m.
const REACHED_M: f64 = 2e-4;
/// A larger deviation is not corrected, m.
const CORRECTED_MAX_M: f64 = 0.025;

/// Pose of the platform when a picture was taken, by the mat in it.
#[derive(Debug, Clone, Copy)]
pub(super) struct ByMat {
    pub world_from_platform: Isometry3<f64>,
    pub sight: MatSight,
}

impl<L: Link> Picker<'_, L> {
    /// The platform's pose when a picture was taken, by the mat in it. The first picture also
    /// determines the mat's pose: the error of `by_lengths` is then the same everywhere, and
    /// harmless.
    pub(super) fn platform_by_mat(
        &mut self,
        picture: &RgbImage,
        by_lengths: &Isometry3<f64>,
    ) -> Result<Option<ByMat>, PickError> {
        let Some(mat) = self.options.mat.as_ref() else {
            return Ok(None);
        };
        let camera = self.eye.cameras().color;
        let Some(sight) = self.arm.meanwhile(|_| mat.in_picture(&camera, picture))? else {
            return Ok(None);
        };
        let camera = &self.arm.model().robot().camera;
        let platform_from_mat =
            Isometry3::from(camera.camera_from_platform).inverse() * sight.camera_from_mat;
        let world_from_mat = *self
            .world_from_mat
            .get_or_insert(by_lengths * platform_from_mat);
        Ok(Some(ByMat {
            world_from_platform: world_from_mat * platform_from_mat.inverse(),
            sight,
        }))
    }

    /// Tool position: by the mat, or by lengths and tensions with the last correction from the mat.
    fn tool_m(&mut self) -> Result<Vector3<f64>, PickError> {
        let rest = self.arm.state()?;
        let by_lengths = self.arm.model().tool_m(&rest);
        if self.options.mat.is_some() {
            let eye = &mut *self.eye;
            let picture = self.arm.until(|| eye.poll_color())??;
            let tool = self.arm.model().robot().tool.tcp_in_platform_m;
            let by_mat = self.platform_by_mat(&picture, &isometry(&rest))?;
            self.last_sight = by_mat.map(|by_mat| by_mat.sight);
            if let Some(by_mat) = by_mat {
                let seen = (by_mat.world_from_platform * nalgebra::Point3::from(tool)).coords;
                self.seen_off_m = seen - by_lengths;
            }
        }
        Ok(by_lengths + self.seen_off_m)
    }

    /// Moves the tool to a position and corrects it by its observed or measured position, until it
    /// is within a tolerance or `tries` corrections are made. Learnt corrections apply to later
    /// positions, up to the next attempt. Returns the remaining distance, m.
    pub(super) fn reach(&mut self, place_m: &Vector3<f64>, tries: usize) -> Result<f64, PickError> {
        self.arm.go(&[place_m + self.bias_m])?;
        let mut left_m = f64::INFINITY;
        for _ in 0..tries {
            let off = place_m - self.tool_m()?;
            left_m = off.norm();
            // Such a large deviation is not friction: something else is wrong, and is not
            // compensated.
            if !(REACHED_M..CORRECTED_MAX_M).contains(&left_m) {
                break;
            }
            self.bias_m += off;
            self.arm.go(&[place_m + self.bias_m])?;
        }
        Ok(left_m)
    }
}
