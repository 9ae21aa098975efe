//! What a calibration leaves open where the robot can rest: position and attitude of its platform.
//!
//! A platform of fewer than six cables tilts as statics decide: errors of masses, tensions and attachments move it
//! although its lengths are right. Of this the estimator's own prediction, by lengths, has no part.

use super::result;
use crate::motion::{Model, rests_on_grid};
use crate::robot::Robot;
use mcdpr_core::estimate::tube::{Belief, Doubts};
use nalgebra::Matrix6;
use serde::Serialize;
use serde_json::Value;

/// Places per axis of the robot's space.
const PLACES: u32 = 5;

/// Expected error over the places at which the robot can rest, root mean square.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct AtRest {
    /// Places on a grid of the robot's space.
    pub places: usize,
    /// Of the platform's position, over all of them, m.
    pub position_m: f64,
    /// At the worst of them, m.
    pub worst_position_m: f64,
    /// Of its attitude, over all of them, rad.
    pub attitude_rad: f64,
    /// At the worst of them, rad.
    pub worst_attitude_rad: f64,
}

impl AtRest {
    /// Of a calibrated robot; `None` where it cannot rest, or for which no model can be made.
    #[must_use]
    pub fn of(robot: &Robot) -> Option<Self> {
        let model = Model::new(robot).ok()?;
        // Of a calibrated robot its covariance counts instead.
        let belief = Belief::of(robot, &Doubts::by_tape());
        let rests = rests_on_grid(&model, robot.search_box_in_world_m(), PLACES);
        let known = |rest| belief.platform_at(&model, rest).ok().flatten();
        let squares: Vec<_> = rests
            .iter()
            .filter_map(known)
            .map(|of| traces(&of))
            .collect();
        let all = squares.len().max(1) as f64;
        let mean = |part: usize| squares.iter().map(|of| of[part]).sum::<f64>() / all;
        let worst = |part: usize| squares.iter().map(|of| of[part]).fold(0.0, f64::max);
        (!squares.is_empty()).then(|| Self {
            places: squares.len(),
            position_m: mean(0).sqrt(),
            worst_position_m: worst(0).sqrt(),
            attitude_rad: mean(1).sqrt(),
            worst_attitude_rad: worst(1).sqrt(),
        })
    }

    /// Of the robot by a new calibration (its file's form); `None` also where this cannot be applied.
    #[must_use]
    pub(crate) fn by(robot: &Robot, document: &Value) -> Option<Self> {
        result::applied(robot, document)
            .ok()
            .as_ref()
            .and_then(Self::of)
    }

    /// In a sentence.
    #[must_use]
    pub fn words(&self) -> String {
        format!(
            "expected error of the platform at rest, tilt included, over {} places of its space: {:.2} mm and {:.2} \
             degrees, at the worst place {:.2} mm and {:.2} degrees",
            self.places,
            self.position_m * 1e3,
            self.attitude_rad.to_degrees(),
            self.worst_position_m * 1e3,
            self.worst_attitude_rad.to_degrees()
        )
    }
}

/// Squares of the expected errors of position (m2) and rotation (rad2).
fn traces(covariance: &Matrix6<f64>) -> [f64; 2] {
    let of = |first: usize| (first..first + 3).map(|k| covariance[(k, k)]).sum();
    [of(0), of(3)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robot_known_by_its_file_alone_is_off_by_millimetres_and_says_so() {
        let robot = Robot::built_in("paper-table5").unwrap();
        let found = AtRest::of(&robot).unwrap();
        assert!(found.places > 5, "{found:?}");
        assert!((1e-3..2e-2).contains(&found.position_m), "{found:?}");
        assert!(found.worst_position_m > found.position_m, "{found:?}");
        // 0.1 to 5 degrees.
        assert!((2e-3..9e-2).contains(&found.attitude_rad), "{found:?}");
        assert!(found.worst_attitude_rad > found.attitude_rad, "{found:?}");
        assert!(found.words().contains("tilt included"), "{}", found.words());
    }
}
