//! What the gripper holds.

use super::Tracker;
use super::recent::Event;
use super::report::Load;
use super::rows::vector;
use nalgebra::Vector3;

/// A payload heavier than this many times the platform is not looked for.
const HEAVIEST: f64 = 1.0;
/// A payload lighter than this is none.
const LIGHTEST_KG: f64 = 1e-3;

impl Tracker {
    /// The gripper took something: from the next rest on its mass and centre are estimated.
    pub fn lift(&mut self) {
        self.happened(|| Event::Lifted);
        let first = self.layout.payload();
        let heavy = HEAVIEST * self.robot.platform.mass_kg;
        // What a gripper holds hangs below its fingers.
        let [below_m, below_sigma_m] = self.prior.below_m;
        let tool = self.robot.tool.tcp_in_platform_m - Vector3::new(0.0, 0.0, below_m);
        let guess_kg = 0.25 * self.robot.platform.mass_kg;
        self.now.reset(first, guess_kg, heavy);
        for axis in 0..3 {
            let moment = guess_kg * tool[axis];
            let sigma_m = if axis == 2 {
                below_sigma_m
            } else {
                self.prior.grasp_m
            };
            // Half of the heaviest at the edge of where it may be held.
            self.now
                .reset(first + 1 + axis, moment, 0.5 * heavy * sigma_m);
            // The load hangs near the tool: its moment follows its mass.
            self.now.couple(first, first + 1 + axis, tool[axis]);
        }
        self.loaded = true;
    }

    /// The gripper let go.
    pub fn set_down(&mut self) {
        self.happened(|| Event::SetDown);
        let first = self.layout.payload();
        for state in first..first + 4 {
            self.now.reset(state, 0.0, 0.0);
            self.planned[state] = 0.0;
        }
        self.loaded = false;
    }

    /// The payload, if there is one.
    #[must_use]
    pub fn load(&self) -> Option<Load> {
        let first = self.layout.payload();
        let mass_kg = self.now.mean[first];
        if !self.loaded || mass_kg <= LIGHTEST_KG {
            return None;
        }
        let center_m = vector(&self.now.mean, first + 1) / mass_kg;
        let sigma = |axis: usize| {
            let mut row = vec![0.0; self.layout.size()];
            row[first + 1 + axis] = 1.0 / mass_kg;
            row[first] = -center_m[axis] / mass_kg;
            self.now.spread(&[row])[0][0].max(0.0).sqrt()
        };
        Some(Load {
            mass_kg,
            mass_sigma_kg: self.now.variance(first).max(0.0).sqrt(),
            center_m,
            center_sigma_m: Vector3::new(sigma(0), sigma(1), sigma(2)),
        })
    }
}
