//! What the jaws hold: weighed by tensions, expected by plans, tracked, and let go.

use super::{Arm, lengths, plan, tensions, with_spare};
use crate::link::Link;
use crate::motion::PlanError;
use crate::pick::PickError;
use crate::recovery::load;
use crate::run;
use crate::run::tracking::{AtRest, Tracking};
use mcdpr_core::estimate::track::{Load, Prior};
use nalgebra::Vector3;

/// Tensions are averaged over this time, s.
const WEIGH_S: f64 = 0.6;
/// Readings in that time.
const WEIGH_READINGS: u32 = 12;
/// A load heavier than this share of the platform with it is let go without a watch for contact: a tenth, where a
/// fifth is a contact.
const UNWATCHED_SHARE: f64 = 0.1;
/// Length of the motion that ends the watch, m.
const UNWATCHED_M: f64 = 1e-4;

impl<L: Link> Arm<L> {
    /// Tracks the robot's slow changes and its loads from now on, whenever tensions are averaged.
    pub(crate) fn track(&mut self, prior: &Prior) {
        self.tracking = Some(Tracking::new(&self.model, prior));
    }

    /// What the jaws hold is in the air: its mass and centre are estimated from the next averaged tensions on.
    pub(crate) fn lifted(&mut self) {
        if let Some(tracking) = &mut self.tracking {
            tracking.lift();
            self.load_known = false;
        }
    }

    /// What the jaws hold, as tracked; `None` also where the rest after the lift did not fit: then the tracked load
    /// is a guess.
    #[must_use]
    pub(crate) fn load(&self) -> Option<Load> {
        let tracking = self.tracking.as_ref().filter(|_| self.load_known)?;
        tracking.load()
    }

    /// Whether the robot could move along these points with a load of `load_n` at its tool, with every tension
    /// within its limits and a margin: judged, not executed.
    ///
    /// # Errors
    /// The line's.
    pub(crate) fn could_carry(
        &mut self,
        load_n: f64,
        points_m: &[Vector3<f64>],
    ) -> Result<bool, PickError> {
        let (at_m, carried_kg) = (self.tool_m, self.carried_kg);
        self.meanwhile(|model| {
            let more_kg = load_n / mcdpr_kinematics::GRAVITY_MPS2 - carried_kg;
            let Ok(model) = load::loaded(&with_spare(model), more_kg) else {
                return false;
            };
            plan(&model, at_m, points_m).is_ok()
        })
    }

    /// Opens the jaws over the release position. The cables lose the load at once: where that is so much that the
    /// board would take it for a contact (C5), it does not watch for one meanwhile.
    ///
    /// # Errors
    /// The line's.
    pub(crate) fn let_go(&mut self) -> Result<(), PickError> {
        let carried_kg = self.load().map_or(self.carried_kg, |load| load.mass_kg);
        if carried_kg > UNWATCHED_SHARE * self.model.robot().platform.mass_kg {
            // What a hold watches for comes from the last motion's end.
            let (model, at_m) = (self.model.clone().without_contact(), self.tool_m);
            let up_m = at_m + Vector3::new(0.0, 0.0, UNWATCHED_M);
            let there = self.meanwhile(|_| plan(&model, at_m, &[up_m]))??;
            self.follow(there, &[up_m])?;
        }
        self.grip(false)?;
        Ok(())
    }

    /// Weight at the tool by tensions at rest, over the platform's by statics, N. Pulley friction and the
    /// error of the platform's mass are in it.
    ///
    /// # Errors
    /// The line's; if the robot cannot hang there.
    pub(crate) fn weight_n(&mut self) -> Result<f64, PickError> {
        let now_n = self.mean_tensions_n()?;
        let tool_m = self.tool_m;
        let rest = self.meanwhile(|model| model.rest(&tool_m, None))??;
        let more_n = self.lift_n(rest.tensions_n(), &now_n)?;
        Ok(more_n + self.carried_kg * mcdpr_kinematics::GRAVITY_MPS2)
    }

    /// Tensions averaged while the robot is at rest, N.
    ///
    /// # Errors
    /// The line's.
    pub(crate) fn mean_tensions_n(&mut self) -> Result<Vec<f64>, PickError> {
        self.tensions_over(WEIGH_READINGS)
    }

    /// Tensions averaged over so many readings of 50 ms, N.
    ///
    /// # Errors
    /// The line's.
    pub(crate) fn tensions_over(&mut self, readings: u32) -> Result<Vec<f64>, PickError> {
        let mut sum = vec![0.0; self.model.robot().cables.len()];
        let mut lengths_m = sum.clone();
        let share = 1.0 / f64::from(readings.max(1));
        for _ in 0..readings {
            self.wait(WEIGH_S / f64::from(WEIGH_READINGS))?;
            let status = run::status(&mut self.client)?;
            for (sum, tension) in sum.iter_mut().zip(tensions(&status)) {
                *sum += tension * share;
            }
            for (sum, length) in lengths_m.iter_mut().zip(lengths(&status)) {
                *sum += length * share;
            }
        }
        // Swing must have died away: a short mean teaches nothing.
        if readings >= WEIGH_READINGS {
            self.teach(lengths_m, sum.clone())?;
        }
        Ok(sum)
    }

    /// Gives a rest to what is tracked, and plans by it from then on.
    fn teach(&mut self, lengths_m: Vec<f64>, tensions_n: Vec<f64>) -> Result<(), PickError> {
        let Some(mut tracking) = self.tracking.take() else {
            return Ok(());
        };
        let now_us = self.client.now_us();
        let (tracking, lesson) = self.meanwhile(move |_| -> Result<_, PlanError> {
            let model = tracking.model();
            let near = model.rest_from_lengths(&lengths_m, &tensions_n)?;
            let rest = AtRest {
                now_us,
                lengths_m,
                tensions_n,
                ..AtRest::default()
            };
            let lesson = tracking.rest(rest, &near.equilibrium.pose)?;
            Ok((tracking, lesson))
        })??;
        self.tracking = Some(tracking);
        self.load_known = lesson.fits;
        if let Some(named) = &lesson.named {
            eprintln!("{named}");
        }
        self.follow_tracking()
    }

    /// Plans by what is tracked from now on.
    fn follow_tracking(&mut self) -> Result<(), PickError> {
        let Some(tracking) = &self.tracking else {
            return Ok(());
        };
        self.model = tracking.model().clone();
        self.carried_kg = 0.0;
        self.load_changed()
    }

    /// The vertical force of a change of tensions at the tool's present position, N: the additional
    /// load. Pulleys' radius is neglected.
    ///
    /// # Errors
    /// If the robot cannot hang there.
    pub(crate) fn lift_n(&mut self, before_n: &[f64], now_n: &[f64]) -> Result<f64, PickError> {
        let tool_m = self.tool_m;
        let rest = self.meanwhile(|model| model.rest(&tool_m, None))??;
        Ok(load::lift_n(&self.model, &rest, before_n, now_n))
    }

    /// Plans from now on with this mass at the tool, kg.
    ///
    /// # Errors
    /// If the robot cannot hang with it at its present position.
    pub fn carry(&mut self, mass_kg: f64) -> Result<(), PickError> {
        if mass_kg > 0.0 && self.load().is_some() {
            // Its mass and centre are in the model since it was weighed.
            return Ok(());
        }
        if let Some(tracking) = &mut self.tracking {
            tracking.set_down()?;
            self.follow_tracking()?;
        }
        self.expect_load(mass_kg)
    }

    /// Plans from now on with this mass at the tool, kg, in place of the one before.
    ///
    /// # Errors
    /// If the robot cannot hang with it at its present position.
    pub(crate) fn expect_load(&mut self, mass_kg: f64) -> Result<(), PickError> {
        // A weight below zero is an error of the sensors.
        let mass_kg = mass_kg.max(0.0);
        self.model = load::loaded(&self.model, mass_kg - self.carried_kg)?;
        self.carried_kg = mass_kg;
        self.load_changed()
    }

    /// Finds the tool with the present model at the lengths that the board holds. The next plan's start may differ
    /// from them.
    fn load_changed(&mut self) -> Result<(), PickError> {
        self.load_changed = true;
        let status = run::status(&mut self.client)?;
        let held: Vec<f64> = status.setpoints_m().collect();
        let rest = self.meanwhile(|model| model.rest_from_lengths(&held, &tensions(&status)))??;
        self.tool_m = self.model.tool_m(&rest);
        Ok(())
    }
}
