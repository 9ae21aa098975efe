//! A weight on the cable of a winch that holds no robot yet.

/// Speed of the drum's surface below which the pulley's friction keeps its share of the direction (m/s).
const CREEPS_MPS: f64 = 1e-5;

/// A weight that a bare winch raises and lowers. Its own mass is neglected beside that of a geared rotor, 34 kg at the
/// paper's cable, and it does not swing.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Lift {
    /// Weight (N).
    pub weight_n: f64,
    /// Share of it that the pulley takes or adds.
    pub loss: f64,
}

impl Lift {
    /// Tension at the drum (N), at the drum's speed (m/s, paying out positive): more while it is raised, less while it
    /// is lowered.
    pub(crate) fn pull_n(&self, drum_rate: f64) -> f64 {
        let lowered = (drum_rate / CREEPS_MPS).clamp(-1.0, 1.0);
        self.weight_n * (1.0 - self.loss * lowered)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pulley_takes_from_a_weight_that_sinks_and_adds_to_one_that_rises() {
        let lift = Lift {
            weight_n: 10.0,
            loss: 0.02,
        };
        let pulls = [-0.01, 0.0, 0.01].map(|rate| lift.pull_n(rate));
        assert_eq!(pulls, [10.2, 10.0, 9.8]);
    }
}
