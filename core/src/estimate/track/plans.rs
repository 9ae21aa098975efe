//! What plans take from the tracked states: they follow in small steps.

use super::pulleys::Rubbing;
use super::rows::{Hanging, Rest, vector};
use super::{Tracker, gaussian};
use crate::estimate::Measurements;
use crate::motion::{Drift, Model, PlanError, StaticState};
use crate::robot::Robot;
use mcdpr_kinematics::Pose;
use nalgebra::{Matrix3, Vector3};

/// Slopes of the tool's three coordinates, and where the platform hangs.
pub(super) type Slopes = ([Vec<f64>; 3], (Hanging, Matrix3<f64>));

impl Tracker {
    /// Lets the planned states follow the tracked ones, the tool's shift within its bound. A payload is
    /// used at once: it is not a drift.
    pub(super) fn follow(&mut self, measured: &Measurements, rubbing: &[Rubbing], near: &Pose) {
        let payload = self.layout.payload();
        for k in payload..payload + 4 {
            self.planned[k] = self.now.mean[k];
        }
        let by: Vec<f64> = self
            .now
            .mean
            .iter()
            .zip(&self.planned)
            .map(|(now, planned)| now - planned)
            .collect();
        let shift_m = self
            .slopes(measured, rubbing, near)
            .map_or(f64::INFINITY, |(slopes, _)| {
                let moved = slopes.map(|slope| gaussian::dot(&slope, &by));
                Vector3::from(moved).norm()
            });
        let share = (self.prior.step_m / shift_m).min(1.0);
        if share.is_finite() {
            for (planned, by) in self.planned.iter_mut().zip(&by) {
                *planned += share * by;
            }
        }
    }

    pub(super) fn slopes(
        &self,
        commanded: &Measurements,
        rubbing: &[Rubbing],
        near: &Pose,
    ) -> Option<Slopes> {
        let rest = Rest {
            robot: &self.robot,
            sigmas: &self.prior.rows,
            measured: commanded,
            rubbing,
            creeping: &self.now.creeping,
            every_tension: false,
        };
        let start = Hanging {
            pose: *near,
            tensions_n: commanded.tensions_n.clone(),
        };
        let none = vec![0.0; self.now.size()];
        let hanging = rest.hang(&self.now.mean, &start, &none)?;
        let (slopes, noise) = rest.tool(&self.now.mean, &hanging)?;
        Some((slopes, (hanging, noise)))
    }

    /// The robot as plans should take it: anchors, stiffness, mass and centre of mass as tracked, with payload.
    #[must_use]
    pub fn robot(&self) -> Robot {
        let (layout, x) = (self.layout, &self.planned);
        let mut robot = self.robot.clone();
        for (i, cable) in robot.cables.iter_mut().enumerate() {
            cable.anchor_in_world_m += vector(x, layout.anchor(i));
            cable.ea_n /= 1.0 + x[layout.compliance(i)];
        }
        let platform = &mut robot.platform;
        let moment = platform.center_of_mass_m * platform.mass_kg
            + vector(x, layout.platform() + 1)
            + vector(x, layout.payload() + 1);
        platform.mass_kg += x[layout.platform()] + x[layout.payload()];
        platform.center_of_mass_m = moment / platform.mass_kg;
        robot
    }

    /// What has changed in each cable and its tension sensor, as plans should take it. The friction of pulleys
    /// is not in it: it stretches the routing by some micrometres.
    #[must_use]
    pub fn drift(&self) -> Vec<Drift> {
        let (layout, x) = (self.layout, &self.planned);
        (0..layout.cables)
            .map(|i| Drift {
                strain: self.now.creeping(i).strain(layout, x, i),
                offset_m: x[layout.offset(i)],
                gain: x[layout.gain(i)],
                zero_n: x[layout.zero(i)],
            })
            .collect()
    }

    /// The model that plans should use now, with the options of `described`.
    ///
    /// # Errors
    /// Those of [`Model::new`], where what was tracked leaves no valid geometry.
    pub fn model(&self, described: &Model) -> Result<Model, PlanError> {
        let model = Model::new(&self.robot())?.with_options(described.options());
        Ok(model.with_drift(&self.drift()))
    }

    /// What the encoders must show for a planned rest, m.
    #[must_use]
    pub fn paid_out_m(&self, rest: &StaticState, rubbing: &[Rubbing]) -> Vec<f64> {
        let (layout, x) = (self.layout, &self.planned);
        let pairs = rest.equilibrium.lengths_m.iter().zip(rest.tensions_n());
        let cables = self.robot.cables.iter().zip(pairs).enumerate();
        cables
            .map(|(i, (cable, (length_m, tension_n)))| {
                let compliance = (1.0 + x[layout.compliance(i)]) / cable.ea_n;
                let side = rubbing.get(i).map_or(0.0, |rubbing| rubbing.side);
                let extra =
                    cable.routing_length_m * x[layout.loss(i)] * side * compliance * tension_n;
                let total = length_m + cable.routing_length_m - extra;
                let creep = self.now.creeping(i).strain(layout, x, i);
                let off_drum = total / ((1.0 + tension_n * compliance) * (1.0 + creep));
                off_drum - cable.routing_length_m - x[layout.offset(i)]
            })
            .collect()
    }

    /// What a tension sensor shows while the platform feels `tension_n`, N.
    #[must_use]
    pub fn reading_n(&self, cable: usize, tension_n: f64, rubbing: Rubbing) -> f64 {
        let (layout, x) = (self.layout, &self.planned);
        let rubbed = 1.0 + x[layout.loss(cable)] * rubbing.side;
        tension_n * rubbed * (1.0 + x[layout.gain(cable)]) + x[layout.zero(cable)]
    }

    /// What the platform feels of a cable while its sensor shows `reading_n`, N: the inverse of [`Self::reading_n`].
    #[must_use]
    pub fn felt_n(&self, cable: usize, reading_n: f64, rubbing: Rubbing) -> f64 {
        let (layout, x) = (self.layout, &self.planned);
        let rubbed = 1.0 + x[layout.loss(cable)] * rubbing.side;
        (reading_n - x[layout.zero(cable)]) / (rubbed * (1.0 + x[layout.gain(cable)]))
    }
}
