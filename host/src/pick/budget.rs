//! Error budget of a grasp point, from the known errors.

/// Error budget of a grasp point, one standard deviation of its distance, m.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Budget {
    /// From the depth camera's noise.
    pub depth_m: f64,
    /// From the pose of the camera on the platform.
    pub hand_eye_m: f64,
    /// From the robot's geometry: the platform's pose at the look and at the grasp. 0 if the mat
    /// was seen both times.
    pub geometry_m: f64,
    /// From the mat's pose in the pictures of the look and of the grasp; 0 without it.
    pub mat_m: f64,
    /// Total.
    pub total_m: f64,
}

/// What is known about the errors of a calibrated robot, one standard deviation per axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Uncertainty {
    /// Camera on the platform, m.
    pub hand_eye_m: f64,
    /// Camera on the platform, rad.
    pub hand_eye_rad: f64,
    /// Anchors, m.
    pub anchors_m: f64,
    /// Disparity noise of the depth camera, px.
    pub disparity_px: f64,
    /// Focal length times baseline of the depth camera, px m.
    pub focal_baseline_px_m: f64,
}

/// How a grasp point was measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Measuring {
    /// From the camera to the grasp at the look, m.
    pub distance_m: f64,
    /// From the camera to the tool, m.
    pub to_tool_m: f64,
    /// Cables of the robot.
    pub cables: usize,
    /// Error of the mat at the grasp point in the picture of the look, and in the last one before
    /// the jaws closed, m; `None` if it was not seen in both.
    pub by_mat_m: Option<[f64; 2]>,
}

impl Uncertainty {
    /// The budget of a grasp point.
    ///
    /// Depth: z^2 / (f b) per pixel of disparity, averaged over a patch of four noise cells.
    ///
    /// By lengths: the hand-eye transform takes the point from the camera to the world, shift and
    /// lever. A common shift of the anchors moves camera and tool alike; the difference between the
    /// positions of look and grasp is about the anchors' error over the square root of the number
    /// of cables.
    ///
    /// By the mat: the point and the mat are in one picture, so that the look needs no hand-eye
    /// transform. At the grasp it takes the mat from the camera to the tool, which is near. The
    /// anchors have no effect.
    pub(super) fn budget(&self, how: &Measuring) -> Budget {
        // From a deviation per axis to that of a distance in three axes.
        let axes = 3.0_f64.sqrt();
        let noise = self.disparity_px / self.focal_baseline_px_m;
        // Half of one reading's: the mean of four noise cells.
        let depth_m = 0.5 * how.distance_m * how.distance_m * noise;
        let (arm_m, geometry_m, mat_m) = match how.by_mat_m {
            Some([look_m, grasp_m]) => (how.to_tool_m, 0.0, look_m.hypot(grasp_m)),
            None => {
                // Two poses, of look and grasp, each with the anchors' error over sqrt(n).
                let shared = (2.0 / how.cables.max(1) as f64).sqrt();
                (how.distance_m, axes * self.anchors_m * shared, 0.0)
            }
        };
        // Turns about the two axes across the arm move its end.
        let lever_m = 2.0_f64.sqrt() * self.hand_eye_rad * arm_m;
        let hand_eye_m = (axes * self.hand_eye_m).hypot(lever_m);
        let parts = [depth_m, hand_eye_m, geometry_m, mat_m];
        Budget {
            depth_m,
            hand_eye_m,
            geometry_m,
            mat_m,
            total_m: parts.iter().map(|part| part * part).sum::<f64>().sqrt(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mat_takes_the_place_of_the_geometry() {
        let uncertainty = Uncertainty {
            hand_eye_m: 1e-4,
            hand_eye_rad: 5e-4,
            anchors_m: 2e-4,
            disparity_px: 0.064,
            focal_baseline_px_m: 33.4,
        };
        let by_lengths = Measuring {
            distance_m: 0.4,
            to_tool_m: 0.1,
            cables: 4,
            by_mat_m: None,
        };
        let by_mat = Measuring {
            by_mat_m: Some([3e-5, 4e-5]),
            ..by_lengths
        };
        let (lengths, mat) = (uncertainty.budget(&by_lengths), uncertainty.budget(&by_mat));
        assert_eq!(mat.geometry_m, 0.0);
        assert!((mat.mat_m - 5e-5).abs() < 1e-12 && lengths.mat_m == 0.0);
        assert_eq!(mat.depth_m, lengths.depth_m);
        assert!(mat.hand_eye_m < lengths.hand_eye_m && mat.total_m < lengths.total_m);
    }
}
