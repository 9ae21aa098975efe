//! A machine after hours of work: what creeps, warms and drifts in it.

use super::Mismatch;
use mcdpr_core::random::Random;
use mcdpr_core::robot::Robot;
use mcdpr_simulator::plant::{Creep, PlantParams, SensorDrift, SlowParams, Warming};
use serde::{Deserialize, Serialize};

/// The room warms with this time constant, s; assumption.
const WARMING_S: f64 = 7200.0;

/// Slow changes of a machine over eight hours; each is off where it is zero.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct AfterHours {
    /// Final creep of the cables at the tension set-point, strain; each cable within 30 % of it.
    pub creep: f64,
    /// Rise of the temperature of frame and cables, K.
    pub warmer_k: f64,
    /// Thermal expansion of the frame, 1/K.
    pub frame_per_k: f64,
    /// Thermal expansion of the cables along the fibre, 1/K.
    pub cable_per_k: f64,
    /// Drift of the tension sensors' zero, N: half of it steady, half in waves of some hours.
    pub drift_n: f64,
    /// Error of the lengths that the encoders start from, m (standard deviation).
    pub length_m: f64,
    /// Error of the camera's mounting: shift (m) and turn (rad) per axis (standard deviations).
    pub camera: [f64; 2],
}

impl AfterHours {
    /// Polymer cables on an aluminium frame in a room that warms by 5 K.
    ///
    /// Sources: aluminium 23e-6 1/K (EN 1999-1-1); UHMWPE fibre -12e-6 1/K (data sheets of Dyneema);
    /// 0.15 N of zero drift is 0.4 % of a 40 N sensor's range, as load cells of class 0.1 drift with
    /// temperature and amplifier together (assumption, range 0.05 to 0.4 N).
    #[must_use]
    pub const fn polymer() -> Self {
        Self {
            creep: 0.003,
            warmer_k: 5.0,
            frame_per_k: 23e-6,
            cable_per_k: -12e-6,
            drift_n: 0.15,
            length_m: 1e-4,
            camera: [1e-4, 2e-4],
        }
    }

    /// Steel cables: next to no creep, the rest alike.
    #[must_use]
    pub const fn steel() -> Self {
        Self {
            creep: 0.0,
            cable_per_k: 12e-6,
            ..Self::polymer()
        }
    }

    /// Lets the physics of a machine change like this.
    pub(super) fn change(&self, params: &mut PlantParams, robot: &Robot, seed: u64) {
        let mut random = Random::new(seed ^ 0x686F_7572);
        let setpoint_n = robot.tension.setpoint_n;
        let steel = self.creep == 0.0 && self.cable_per_k > 0.0;
        let creep = params
            .cables
            .iter()
            .map(|cable| {
                if steel {
                    return Creep::steel();
                }
                let strain = self.creep * (1.0 + random.within(0.3));
                let mut creep = Creep::polymer(strain, setpoint_n, cable.ea_n);
                for element in &mut creep.elements {
                    // Ropes of one kind differ in their times, too.
                    element.retardation_s *= 1.0 + random.within(0.3);
                }
                creep
            })
            .collect();
        for cable in &mut params.cables {
            // The robot's side takes the nominal travel: pulleys differ.
            cable.pulley_presliding_m *= 1.0 + random.within(0.3);
            cable.pulley_loss *= 1.0 + random.within(0.3);
        }
        let count = params.cables.len() as f64;
        let mut center_m = [0.0; 3];
        for cable in &params.cables {
            for (sum, value) in center_m.iter_mut().zip(cable.anchor_m) {
                *sum += value / count;
            }
        }
        params.slow = SlowParams {
            creep: if self.creep > 0.0 || steel {
                creep
            } else {
                Vec::new()
            },
            frame_expansion_per_k: self.frame_per_k,
            frame_center_m: center_m,
            cable_expansion_per_k: self.cable_per_k,
            warming: Warming {
                rise_k: self.warmer_k,
                time_s: WARMING_S,
            },
        };
        let mut random = Random::new(seed ^ 0x6472_6966);
        for winch in &mut params.winches {
            winch.sensor.drift = SensorDrift {
                steady_n: 0.5 * self.drift_n * random.normal(),
                wave_n: 0.5 * self.drift_n * random.normal(),
                phase_rad: 6.0 * random.unit(),
            };
        }
    }
}

impl Mismatch {
    /// A realistic machine that changes over a day, with polymer cables.
    #[must_use]
    pub const fn after_hours() -> Self {
        Self::changing(AfterHours::polymer())
    }

    /// A realistic machine that changes over a day.
    #[must_use]
    pub const fn changing(hours: AfterHours) -> Self {
        let mut out = Self::realistic();
        out.hours = Some(hours);
        out
    }
}
