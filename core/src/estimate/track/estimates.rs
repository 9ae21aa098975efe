//! The tracked states in the words of a robot file.

use super::creep::CREEP_SHARES;
use super::{Prior, Tracker};
use serde::Serialize;

/// A value and its standard deviation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Known {
    /// The value.
    pub value: f64,
    /// Its standard deviation.
    pub sigma: f64,
    /// Whether any rest has told of it: the standard deviation is less than nine tenths of the one at the start.
    pub observed: bool,
}

/// What is known of a cable, relative to its description.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct CableEstimate {
    /// Displacement of the anchor, world, m.
    pub anchor_m: [Known; 3],
    /// Cable off the drum that the encoder does not know of, m.
    pub offset_m: Known,
    /// Creep, strain.
    pub strain: Known,
    /// Relative error of the stiffness: -0.1 is a cable that is 10 % too soft.
    pub stiffness: Known,
    /// Relative error of the tension sensor's gain.
    pub sensor_gain: Known,
    /// What the tension sensor shows without tension, N.
    pub sensor_zero_n: Known,
    /// Share of tension lost over the pulley.
    pub pulley_loss: Known,
}

/// What is known of a robot, relative to its description.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Estimates {
    /// Each cable.
    pub cables: Vec<CableEstimate>,
    /// Error of the platform's mass, kg.
    pub mass_kg: Known,
    /// Displacement of the camera on its bracket, camera frame, m.
    pub camera_m: [Known; 3],
}

/// Less than this share of the first standard deviation counts as observed.
const OBSERVED: f64 = 0.9;

impl Tracker {
    /// What is known now; `prior` is what was assumed at the start.
    #[must_use]
    pub fn estimates(&self, prior: &Prior) -> Estimates {
        let layout = self.layout;
        let known = |state: usize, first_sigma: f64| {
            let sigma = self.now.variance(state).max(0.0).sqrt();
            Known {
                value: self.now.mean[state],
                sigma,
                observed: sigma < OBSERVED * first_sigma,
            }
        };
        let cable = |i: usize| {
            let creeping = self.now.creeping(i);
            let mut both = vec![0.0; layout.size()];
            for (state, slope) in creeping.slopes(layout, &self.now.mean, i) {
                both[state] = slope;
            }
            let variance = self.now.spread(&[both])[0][0];
            let compliance = known(layout.compliance(i), prior.compliance);
            CableEstimate {
                anchor_m: [0, 1, 2].map(|axis| known(layout.anchor(i) + axis, prior.anchor_m)),
                offset_m: known(layout.offset(i), prior.length_m),
                strain: Known {
                    value: creeping.strain(layout, &self.now.mean, i),
                    sigma: variance.max(0.0).sqrt(),
                    // Nothing is known of creep before; its final size is a state that starts with this spread.
                    observed: known(layout.creep_ratio(i, 0), f64::INFINITY).sigma
                        < OBSERVED * self.creep_ratio_sigma(i, prior),
                },
                stiffness: Known {
                    value: 1.0 / (1.0 + compliance.value) - 1.0,
                    ..compliance
                },
                sensor_gain: known(layout.gain(i), prior.gain),
                sensor_zero_n: known(layout.zero(i), prior.zero_n),
                pulley_loss: known(layout.loss(i), prior.loss[1]),
            }
        };
        Estimates {
            cables: (0..layout.cables).map(cable).collect(),
            mass_kg: known(layout.platform(), prior.mass * self.robot.platform.mass_kg),
            camera_m: [0, 1, 2].map(|axis| known(layout.camera() + axis, prior.camera[0])),
        }
    }

    /// Standard deviation at the start of the fast element's final creep over the elastic stretch.
    fn creep_ratio_sigma(&self, cable: usize, prior: &Prior) -> f64 {
        let ea_n = self.robot.cables.get(cable).map_or(0.0, |c| c.ea_n);
        CREEP_SHARES[0] * prior.creep[1] * ea_n / self.robot.tension.setpoint_n
    }

    /// The robot was homed anew, with these paid-out lengths now, m: the encoders' reference contains what the
    /// cables have crept, and, where they are taken at home, what anchors and stiffness change there.
    pub fn homed(&mut self, lengths_m: &[f64]) {
        // Rests before a homing are rests with other lengths.
        self.recent.clear();
        let layout = self.layout;
        for (i, length_m) in lengths_m.iter().enumerate().take(layout.cables) {
            let routing_m = self.robot.cables.get(i).map_or(0.0, |c| c.routing_length_m);
            let creeping = self.now.creeping(i);
            let strain = creeping.strain(layout, &self.now.mean, i);
            // With this offset the creep of now changes no length, however large it is.
            let off_drum_m = length_m + routing_m;
            let mut offset_m = -strain * off_drum_m;
            let state = layout.offset(i);
            self.now.reset(state, offset_m, self.prior.length_m);
            for (from, slope) in creeping.slopes(layout, &self.now.mean, i) {
                self.now.couple(from, state, -slope * off_drum_m);
                self.planned[from] = self.now.mean[from];
            }
            let follows = self.at_home.iter().flatten();
            for (from, _, slope) in follows.filter(|(_, to, _)| *to == state) {
                self.now.couple(*from, state, *slope);
                offset_m += slope * self.now.mean[*from];
            }
            self.now.mean[state] = offset_m;
            self.planned[state] = offset_m;
        }
    }
}
