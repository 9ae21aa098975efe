//! Placing the robot, at rest.

use super::Plant;
use super::bus::Port;
use super::error::PlantError;
use super::params::MAX_CABLES;
use super::platform::{Motion, Pose};
use super::settle::{Hold, settle};
use super::vec3::norm;
use super::winch::Winch;

impl Plant {
    /// Puts the platform at `pose` at rest and cuts every cable so that it carries its entry of
    /// `tensions_n` there. The caller must ensure that the forces balance. Drums, encoder counts
    /// (up to their phase) and time start at 0, brakes are closed, drives without a reset, nothing
    /// broken; faults and external load are kept.
    ///
    /// # Errors
    /// [`PlantError::Length`] or a bad tension or pose; [`PlantError::InsidePulley`].
    pub fn place_at(&mut self, pose: &Pose, tensions_n: &[f64]) -> Result<(), PlantError> {
        let count = self.cables.len();
        if tensions_n.len() != count {
            return Err(PlantError::Length {
                what: "tensions_n",
                given: tensions_n.len(),
                expected: count,
            });
        }
        for (cable, (t, c)) in tensions_n.iter().zip(&self.cables).enumerate() {
            // A tenth of strain is far beyond any cable, and the law is linear.
            if !(0.0..=0.1 * c.ea_n).contains(t) {
                return Err(PlantError::CableParameter {
                    cable,
                    name: "tension_n",
                    value: *t,
                    rule: "at least 0 and at most a tenth of ea_n",
                });
            }
        }
        let motion = Motion::at_rest(&self.body, &pose.checked()?);
        let mut lengths = [0.0; MAX_CABLES];
        for (i, length_m) in lengths.iter_mut().enumerate().take(count) {
            *length_m = self.path(&motion, i)?.length_m;
        }
        for i in 0..count {
            let cable = &mut self.cables[i];
            cable.broken = false;
            cable.winding_gain = 1.0;
            cable.cut_to(lengths[i], tensions_n[i]);
            self.winches[i] = Winch::new(&self.params.winches[i], self.params.step_s);
            self.ports[i] = Port::new(i, count, &self.params.bus);
        }
        self.hook = None;
        self.motion = motion;
        self.steps = 0;
        self.target_s = 0.0;
        self.failed = None;
        Ok(())
    }

    /// Like [`Plant::place_at`], then lets the platform come to rest at its own equilibrium,
    /// elasticity and external load included, with the drums locked except that of `held`, if
    /// given, which keeps its tension. Afterwards all drums are locked and nothing moves.
    ///
    /// # Errors
    /// As [`Plant::place_at`]; [`PlantError::NoSuchCable`]; [`PlantError::NoEquilibrium`].
    pub fn settle_at(
        &mut self,
        pose: &Pose,
        tensions_n: &[f64],
        held: Option<usize>,
    ) -> Result<(), PlantError> {
        self.settle_held(pose, tensions_n, held.as_slice())
    }

    /// [`Plant::settle_at`] with any number of drums that keep their tension.
    ///
    /// # Errors
    /// As [`Plant::settle_at`].
    pub fn settle_held(
        &mut self,
        pose: &Pose,
        tensions_n: &[f64],
        held: &[usize],
    ) -> Result<(), PlantError> {
        for &cable in held {
            self.known(cable)?;
        }
        self.place_at(pose, tensions_n)?;
        let mut holds = [Hold::Locked; MAX_CABLES];
        for &cable in held {
            holds[cable] = Hold::Tension(tensions_n[cable]);
        }
        let motion = settle(
            &self.body,
            &self.cables,
            &holds,
            self.weight_n,
            (&self.load, self.unmodelled.as_ref()),
            self.params.step_s,
            self.motion,
        )?;
        // A held drum has followed the platform: its cable is cut to the length found.
        for &cable in held {
            let length_m = self.path(&motion, cable)?.length_m;
            self.cables[cable].cut_to(length_m, tensions_n[cable]);
        }
        self.motion = motion;
        for i in 0..self.cables.len() {
            let length_m = self.path(&motion, i)?.length_m;
            let cable = &mut self.cables[i];
            // From here on every drum is locked: the tensions follow from the lengths alone.
            let tension = cable.tension(length_m, 0.0, 0.0, 0.0);
            cable.rest_under(tension);
        }
        Ok(())
    }

    /// [`Plant::settle_at`] for an approximate pose: cable `held` at `tension_n`, the others locked
    /// at their lengths for `pose`, stretched by an even share of the weight.
    ///
    /// # Errors
    /// As [`Plant::settle_at`].
    pub fn settle_with_tension(
        &mut self,
        pose: &Pose,
        held: usize,
        tension_n: f64,
    ) -> Result<(), PlantError> {
        self.known(held)?;
        let count = self.cables.len();
        let share = norm(self.weight_n) / count as f64;
        let mut tensions = [share; MAX_CABLES];
        tensions[held] = tension_n;
        self.settle_at(pose, &tensions[..count], Some(held))
    }
}
