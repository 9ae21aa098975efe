//! Taking up a load of unknown weight: little by little, and not at all if it is too heavy.

use super::{Picker, TRIAL_READINGS};
use crate::link::Link;
use crate::pick::PickError;
use nalgebra::Vector3;

/// What the jaws hold is taken up in steps from this to that length, m, of about so much weight, N. Stiff cables take 2
/// to 4 N more with each of the short ones; a platform that tilts gives way ten times as far.
const TAKE_UP_M: f64 = 1e-4;
const TAKE_UP_LONG_M: f64 = 5e-4;
const TAKE_UP_N: f64 = 1.5;
/// Most of these steps.
const TAKE_UP_STEPS: usize = 40;
/// A long step that adds less weight than this adds none, N; two of them end it.
const TAKEN_UP_N: f64 = 0.2;

impl<L: Link> Picker<'_, L> {
    /// Takes up what the jaws hold, little by little, until its whole weight hangs on the cables; plans expect it
    /// then. `Err` is the weight, N, at which it is clear that the robot cannot carry it to the release position:
    /// it still lies where it lay. `bare_n` are the tensions without it, `above` is where it is lifted to first.
    pub(super) fn take_up(
        &mut self,
        bare_n: &[f64],
        above: Vector3<f64>,
    ) -> Result<Result<(), f64>, PickError> {
        let (mut hangs_n, mut step_m, mut still) = (0.0, 0.0, 0);
        for _ in 0..TAKE_UP_STEPS {
            let now_n = self.arm.tensions_over(TRIAL_READINGS)?;
            let load_n = self.arm.lift_n(bare_n, &now_n)?.max(0.0);
            let [over, release] = self.way_out(above.z);
            if !self.arm.could_carry(load_n, &[above, over, release])? {
                return Ok(Err(load_n));
            }
            // The board compares the tensions with the plan's: a load that no plan expects looks like a contact.
            self.arm
                .expect_load(load_n / mcdpr_kinematics::GRAVITY_MPS2)?;
            let more_n = load_n - hangs_n;
            still = if step_m >= TAKE_UP_LONG_M && more_n < TAKEN_UP_N {
                still + 1
            } else {
                0
            };
            if still == 2 {
                return Ok(Ok(()));
            }
            // Longer steps where the cables give way: no step may look like a contact.
            let by_slope_m = step_m * TAKE_UP_N / more_n.max(1e-3);
            step_m = by_slope_m
                .min(2.0 * step_m)
                .clamp(TAKE_UP_M, TAKE_UP_LONG_M);
            hangs_n = load_n;
            let up_m = self.arm.tool_m() + Vector3::new(0.0, 0.0, step_m);
            self.arm.go(&[up_m])?;
        }
        Ok(Ok(()))
    }

    /// The way to the release position: across at `height_m` at least, then down.
    pub(super) fn way_out(&self, height_m: f64) -> [Vector3<f64>; 2] {
        let release = self.options.release_m;
        let above = release + Vector3::new(0.0, 0.0, self.options.above_m);
        // Across at the greater of both heights: nothing in the tray is touched.
        [
            Vector3::new(release.x, release.y, height_m.max(above.z)),
            release,
        ]
    }
}
