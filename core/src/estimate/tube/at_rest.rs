//! The error of a robot at rest, position and attitude.

use super::belief::{Belief, Errors};
use super::drives::Motion;
use super::slopes::Instant;
use crate::motion::{Model, PlanError, StaticState};
use nalgebra::Matrix6;

impl Belief {
    /// Covariance of where the platform is beside `rest`: position of its origin (world, m), then its rotation about the
    /// world's axes (rad). `None` where it does not hang firmly enough for a first-order answer.
    ///
    /// The cables rub at their pulleys in the directions of the last motion, which are not known: as if all had been
    /// hauled in.
    ///
    /// # Errors
    /// A robot that cannot hang at home, if its lengths are taken there.
    pub fn platform_at(
        &self,
        model: &Model,
        rest: &StaticState,
    ) -> Result<Option<Matrix6<f64>>, PlanError> {
        let cables = model.robot().cables.len();
        let home = self.home(model)?;
        let slopes = Instant {
            model,
            errors: Errors { cables },
            rest,
            home: home.as_ref(),
            home_m: self.doubts.home_m,
            tracked: self.tracked,
            rubbed: &vec![1.0; cables],
            motion: &Motion::none(cables),
        }
        .slopes_of_platform();
        Ok(slopes.map(|(slopes, at_home)| {
            let covariance = &slopes * &self.covariance * slopes.transpose() + at_home;
            Matrix6::from_fn(|i, j| covariance[(i, j)])
        }))
    }
}
