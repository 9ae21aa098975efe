//! How cables and tension sensors have changed since they were described, as far as plans follow it.

use super::model::Model;

/// How a cable differs now from its description, as far as plans follow it. The default does not differ.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Drift {
    /// How much longer it is without load: creep and warmth, strain.
    pub strain: f64,
    /// Cable off the drum that the encoder does not know of, m.
    pub offset_m: f64,
    /// Relative error of its tension sensor's gain.
    pub gain: f64,
    /// What its tension sensor shows without tension, N.
    pub zero_n: f64,
}

impl Model {
    /// The same robot with cables and tension sensors that have changed: one entry per cable, or none.
    #[must_use]
    pub fn with_drift(mut self, drift: &[Drift]) -> Self {
        self.drift = drift.to_vec();
        self
    }

    /// What has changed, one entry per cable; empty if nothing has.
    #[must_use]
    pub fn drift(&self) -> &[Drift] {
        &self.drift
    }

    fn drift_of(&self, cable: usize) -> Drift {
        self.drift.get(cable).copied().unwrap_or_default()
    }

    /// Length of cable `cable` (from 0) that its drum has paid out, by its encoder, when the geometric
    /// length from pulley to platform is `length_m` and the tension is `tension_n`, m: the unstretched
    /// length of cable and routing, less the routing.
    #[must_use]
    pub fn paid_out_m(&self, cable: usize, length_m: f64, tension_n: f64) -> f64 {
        let Some(of_file) = self.robot().cables.get(cable) else {
            return length_m;
        };
        let drift = self.drift_of(cable);
        let total = length_m + of_file.routing_length_m;
        let off_drum = total / ((1.0 + tension_n / of_file.ea_n) * (1.0 + drift.strain));
        off_drum - of_file.routing_length_m - drift.offset_m
    }

    /// Geometric length from pulley to platform when the encoder shows `paid_out_m` under `tension_n`, m:
    /// the inverse of [`Self::paid_out_m`].
    #[must_use]
    pub fn taut_m(&self, cable: usize, paid_out_m: f64, tension_n: f64) -> f64 {
        let Some(of_file) = self.robot().cables.get(cable) else {
            return paid_out_m;
        };
        let drift = self.drift_of(cable);
        let off_drum = paid_out_m + of_file.routing_length_m + drift.offset_m;
        off_drum * (1.0 + tension_n / of_file.ea_n) * (1.0 + drift.strain)
            - of_file.routing_length_m
    }

    /// What the tension sensor of a cable (from 0) shows under `tension_n`, N.
    #[must_use]
    pub fn reading_n(&self, cable: usize, tension_n: f64) -> f64 {
        let drift = self.drift_of(cable);
        tension_n * (1.0 + drift.gain) + drift.zero_n
    }

    /// The tension of a cable (from 0) whose sensor shows `reading_n`, N: the inverse of
    /// [`Self::reading_n`].
    #[must_use]
    pub fn tension_n(&self, cable: usize, reading_n: f64) -> f64 {
        let drift = self.drift_of(cable);
        (reading_n - drift.zero_n) / (1.0 + drift.gain)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Robot;

    #[test]
    fn lengths_and_readings_are_inverse_and_change_as_described() {
        let model = Model::new(&Robot::built_in("lab-fast").unwrap()).unwrap();
        let cable = &model.robot().cables[1];
        let plain_m = model.paid_out_m(1, 0.6, 12.0);
        // 12 N stretch 1.3 m of 50 kN by 0.312 mm.
        assert!((0.6 - plain_m - 12.0 / cable.ea_n * 1.3).abs() < 1e-7);
        let mut drift = [Drift::default(); 4];
        drift[1] = Drift {
            strain: 1e-3,
            offset_m: 2e-4,
            gain: 0.01,
            zero_n: -0.3,
        };
        let model = model.with_drift(&drift);
        // A cable that is longer by a thousandth, and 0.2 mm that the encoder does not know of: less is paid out.
        let less_m = plain_m - model.paid_out_m(1, 0.6, 12.0);
        assert!((less_m - (1.3e-3 + 2e-4)).abs() < 3e-6, "{less_m}");
        let back_m = model.taut_m(1, model.paid_out_m(1, 0.6, 12.0), 12.0);
        assert!((back_m - 0.6).abs() < 1e-12, "{back_m}");
        assert!((model.reading_n(1, 12.0) - 11.82).abs() < 1e-12);
        assert!((model.tension_n(1, 11.82) - 12.0).abs() < 1e-12);
        // The others are as described.
        assert_eq!(model.reading_n(0, 12.0), 12.0);
    }

    #[test]
    fn plans_and_positions_follow_a_drift() {
        let described = Model::new(&Robot::built_in("lab-fast").unwrap()).unwrap();
        let drift = [Drift {
            strain: 1e-3,
            ..Drift::default()
        }; 4];
        let model = described.clone().with_drift(&drift);
        let home = model.rest_at_home().unwrap();
        // The drifted machine's lengths lead a model that knows of the drift back to the same place.
        let back = model
            .rest_from_lengths(&home.paid_out_m, home.tensions_n())
            .unwrap();
        assert!((model.tool_m(&back) - model.tool_m(&home)).norm() < 1e-6);
        let naive = described
            .rest_from_lengths(&home.paid_out_m, home.tensions_n())
            .unwrap();
        assert!((described.tool_m(&naive) - model.tool_m(&home)).norm() > 5e-4);
    }
}
