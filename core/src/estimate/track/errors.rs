//! What the tracked states leave open, as the errors of a plan's tube.

use super::Tracker;
use super::gaussian::dot;
use crate::estimate::tube::{Belief, Doubts, Errors};
use nalgebra::DMatrix;

impl Tracker {
    /// What is known of the machine that a plan of [`Self::model`] will move, `seconds` from now under `tensions_n` (at the
    /// platform, N): for the plan's tube. Errors that are not tracked keep those of the calibration or of `doubts`.
    ///
    /// Plans follow the states in small steps and know nothing of later creep or of pulleys' friction, so the tube counts what
    /// they lack beside what is uncertain: the covariance is about the planned states, not about the mean.
    #[must_use]
    pub fn belief(&self, seconds: f64, tensions_n: &[f64], doubts: &Doubts) -> Belief {
        let planned = self.robot();
        let errors = Errors {
            cables: self.layout.cables,
        };
        let later = self.later(seconds, tensions_n);
        let mean = &later.now.mean;
        let lacks: Vec<f64> = (mean.iter().zip(&self.planned))
            .enumerate()
            .map(|(state, (mean, planned))| {
                if (0..errors.cables).any(|i| state == self.layout.loss(i)) {
                    *mean
                } else {
                    mean - planned
                }
            })
            .collect();
        // A plan takes the creep of now.
        let crept = |i: usize| {
            let now = self.now.creeping(i);
            let by_then = later.now.creeping(i).strain(self.layout, mean, i);
            by_then - now.strain(self.layout, &self.planned, i)
        };
        let rows = later.rows_of(
            errors,
            planned.platform.mass_kg,
            &planned.platform.center_of_mass_m,
        );
        let mut covariance = DMatrix::zeros(errors.count(), errors.count());
        let mut product = vec![0.0; self.layout.size()];
        let mut lacking: Vec<f64> = rows.iter().map(|(_, row)| dot(row, &lacks)).collect();
        for (lacking, (error, _)) in lacking.iter_mut().zip(&rows) {
            if let Some(i) = (0..errors.cables).find(|i| errors.strain(*i) == *error) {
                *lacking = crept(i);
            }
        }
        for ((error, row), lack) in rows.iter().zip(&lacking) {
            later.now.times(row, &mut product);
            for ((other, other_row), other_lack) in rows.iter().zip(&lacking) {
                covariance[(*error, *other)] = dot(other_row, &product) + lack * other_lack;
            }
        }
        let sigmas = &self.prior.rows;
        for cable in 0..errors.cables {
            let tension_n = tensions_n.get(cable).copied().unwrap_or(0.0);
            let length = errors.length(cable);
            covariance[(length, length)] += sigmas.length_m.powi(2);
            let zero = errors.zero(cable);
            let share_n = sigmas.tension_share * tension_n;
            covariance[(zero, zero)] += sigmas.tension_n.powi(2) + share_n * share_n;
        }
        Belief::of(&planned, doubts).with_tracked(&covariance, self.prior.homed, "what is tracked")
    }

    /// Errors of the tube as linear functions of the states, of a platform of this mass (kg) and centre of mass (platform's
    /// frame, m).
    pub(super) fn rows_of(
        &self,
        errors: Errors,
        mass_kg: f64,
        center_m: &nalgebra::Vector3<f64>,
    ) -> Vec<(usize, Vec<f64>)> {
        let layout = self.layout;
        let row = |states: &[(usize, f64)]| {
            let mut row = vec![0.0; layout.size()];
            for (state, factor) in states {
                row[*state] += factor;
            }
            row
        };
        let mut rows = Vec::new();
        for i in 0..layout.cables {
            for axis in 0..3 {
                let anchor = row(&[(layout.anchor(i) + axis, 1.0)]);
                rows.push((errors.anchor(i) + axis, anchor));
            }
            let strain = self.now.creeping(i).slopes(layout, &self.now.mean, i);
            rows.push((errors.length(i), row(&[(layout.offset(i), 1.0)])));
            rows.push((errors.strain(i), row(&strain)));
            rows.push((errors.compliance(i), row(&[(layout.compliance(i), 1.0)])));
            rows.push((errors.gain(i), row(&[(layout.gain(i), 1.0)])));
            rows.push((errors.zero(i), row(&[(layout.zero(i), 1.0)])));
            rows.push((errors.loss(i), row(&[(layout.loss(i), 1.0)])));
        }
        let masses = [layout.platform(), layout.payload()];
        rows.push((errors.mass(), row(&masses.map(|state| (state, 1.0)))));
        for axis in 0..3 {
            // Centre = moment over mass.
            let moved = masses.map(|state| {
                [
                    (state + 1 + axis, 1.0 / mass_kg),
                    (state, -center_m[axis] / mass_kg),
                ]
            });
            rows.push((errors.center() + axis, row(moved.as_flattened())));
        }
        rows
    }
}

#[cfg(test)]
mod tests {
    use super::super::Prior;
    use super::*;
    use crate::motion::Model;
    use crate::robot::Robot;

    /// Plans know nothing of pulleys' friction: all of a loss is an error of theirs, however well it is known.
    #[test]
    fn a_known_loss_at_a_pulley_is_an_error_of_the_plan() {
        let model = Model::new(&Robot::built_in("lab-fast").unwrap()).unwrap();
        let prior = Prior {
            loss: [0.03, 1e-6],
            ..Prior::default()
        };
        let tracker = Tracker::new(&model, &prior);
        let belief = tracker.belief(0.0, &[10.0; 4], &Doubts::by_tape());
        for i in 0..4 {
            let loss = Errors { cables: 4 }.loss(i);
            let sigma = belief.variance(loss).sqrt();
            assert!((sigma - 0.03).abs() < 1e-6, "{sigma}");
        }
    }
}
