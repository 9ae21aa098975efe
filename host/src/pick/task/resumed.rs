//! The first moves after a loss of power: deliver what the jaws hold, or come up with empty jaws.

use super::super::report::{Jaws, Outcome, Report, Resumed};
use super::{Picker, WEIGHT_MAX_N, Watcher};
use crate::link::Link;
use crate::pick::PickError;
use nalgebra::Vector3;

/// Weight by tensions and statics that is an object, N: platform mass, sensors and pulleys explain half of
/// it.
const OBJECT_N: f64 = 1.0;

impl<L: Link> Picker<'_, L> {
    /// Picks on after a loss of power; `was_closed` says whether the jaws were closed before it.
    ///
    /// # Errors
    /// As [`Self::run`]; [`PickError::Jaws`] and the first limit that the way of an object in the jaws
    /// breaks, before anything moves.
    pub fn resume(
        &mut self,
        was_closed: bool,
        watcher: &mut dyn Watcher,
    ) -> Result<Report, PickError> {
        let resumed = self.first_moves(was_closed, watcher)?;
        let mut report = self.run(watcher)?;
        report.resumed = Some(resumed);
        Ok(report)
    }

    fn first_moves(
        &mut self,
        was_closed: bool,
        watcher: &mut dyn Watcher,
    ) -> Result<Resumed, PickError> {
        if !self.arm.gripper_closed()? {
            self.come_up()?;
            let jaws = match was_closed {
                true => Jaws::Dropped,
                false => Jaws::Empty,
            };
            return Ok(Resumed {
                jaws,
                weight_n: None,
                outcome: None,
            });
        }
        let weight_n = self.arm.weight_n()?;
        // The jaws get the command that they have, so that the switch has time to say what is in them.
        let met = self.arm.grip(true)?;
        let switch = self.arm.model().robot().gripper.switch;
        if !switch && weight_n < OBJECT_N {
            return Err(PickError::Jaws { weight_n });
        }
        let (jaws, outcome) = if switch && met {
            self.arm.let_go()?;
            self.come_up()?;
            (Jaws::Empty, None)
        } else {
            (Jaws::Holding, Some(self.take_along(weight_n, watcher)?))
        };
        Ok(Resumed {
            jaws,
            weight_n: Some(weight_n),
            outcome,
        })
    }

    /// The place straight above the tool, as far as the task ever lifts.
    fn above_here(&self) -> Vector3<f64> {
        let at = self.arm.tool_m();
        let options = self.options;
        let most = options
            .look_m
            .z
            .max(options.release_m.z + options.above_m)
            .max(at.z);
        Vector3::new(at.x, at.y, (at.z + options.above_m).min(most))
    }

    /// Straight up, out of the tray.
    fn come_up(&mut self) -> Result<(), PickError> {
        let above = self.above_here();
        self.arm.go(&[above])
    }

    /// Carries what is in the jaws to the release position, if the whole way can be gone with it.
    fn take_along(
        &mut self,
        weight_n: f64,
        watcher: &mut dyn Watcher,
    ) -> Result<Outcome, PickError> {
        let weight_n = weight_n.clamp(0.0, WEIGHT_MAX_N);
        self.arm.carry(weight_n / mcdpr_kinematics::GRAVITY_MPS2)?;
        let above = self.above_here();
        let release = self.options.release_m;
        let level = above.z.max(release.z + self.options.above_m);
        let over = Vector3::new(release.x, release.y, level);
        self.arm.judge(&[above, over, release])?;
        self.arm.go(&[above])?;
        watcher.lifted();
        self.deliver(weight_n)
    }
}
