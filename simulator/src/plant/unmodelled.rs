//! What pulls at a platform beside its cables and its weight: hoses, the camera's cable, draughts.
//!
//! On a real robot the equations of equilibrium do not close. On the logs of a four-cable robot
//! (IRMA4U, University of Bologna; repository fzoffoli/UACDPR_SelfCalibration, March 2025) a force of
//! 0.42 % of the weight and a moment of 0.78 mm times the weight are left over, new at every pose. Here both
//! are a smooth random function of the place: waves of random direction and phase.

use super::params::UnmodelledParams;
use super::sensors::Noise;
use super::vec3::{V3, dot, norm};

/// Waves per component: with three the value at a place is close to normal.
const WAVES: usize = 3;

/// One wave of one component.
#[derive(Debug, Clone, Copy, Default)]
struct Wave {
    /// Radians per metre.
    per_m: V3,
    phase_rad: f64,
}

/// Force and moment over the place of the centre of mass.
#[derive(Debug, Clone)]
pub(crate) struct Unmodelled {
    /// Three components of force, three of the moment.
    waves: [[Wave; WAVES]; 6],
    force_n: f64,
    moment_nm: f64,
}

impl Unmodelled {
    /// `None` without force and moment.
    pub(crate) fn new(p: &UnmodelledParams) -> Option<Self> {
        if p.force_n == 0.0 && p.moment_nm == 0.0 {
            return None;
        }
        let mut random = Noise::new(p.seed);
        let mut waves = [[Wave::default(); WAVES]; 6];
        for wave in waves.iter_mut().flatten() {
            let way = [(); 3].map(|()| random.normal());
            // From the given distance to twice as much.
            let length_m = p.distance_m * (1.0 + random.uniform());
            let scale = std::f64::consts::TAU / length_m / norm(way).max(1e-9);
            wave.per_m = way.map(|v| v * scale);
            wave.phase_rad = std::f64::consts::TAU * random.uniform();
        }
        // The mean square of a cosine is a half.
        let share = (2.0 / WAVES as f64).sqrt();
        Some(Self {
            waves,
            force_n: p.force_n * share,
            moment_nm: p.moment_nm * share,
        })
    }

    /// Force (N) and moment about the centre of mass (N m) with the centre of mass here; world axes.
    pub(crate) fn at(&self, center_m: V3) -> (V3, V3) {
        let value = |component: usize| {
            let waves = self.waves[component].iter();
            waves
                .map(|wave| libm::cos(dot(wave.per_m, center_m) + wave.phase_rad))
                .sum::<f64>()
        };
        (
            [0, 1, 2].map(|i| self.force_n * value(i)),
            [3, 4, 5].map(|i| self.moment_nm * value(i)),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn force_and_moment_have_the_stated_scatter_over_the_work_space_and_change_little_within_a_millimetre()
     {
        let params = |seed| UnmodelledParams {
            force_n: 0.05,
            moment_nm: 0.01,
            distance_m: 0.1,
            seed,
        };
        let (mut forces, mut moments, mut count, mut step) = (0.0, 0.0, 0.0, 0.0_f64);
        for seed in 0..40 {
            let field = Unmodelled::new(&params(seed)).unwrap();
            for k in 0..125_u32 {
                let at = [k % 5, k / 5 % 5, k / 25].map(|i| f64::from(i) * 0.08);
                let (force, moment) = field.at(at);
                forces += dot(force, force) / 3.0;
                moments += dot(moment, moment) / 3.0;
                count += 1.0;
                let (near, _) = field.at([at[0] + 1e-3, at[1], at[2]]);
                step = step.max(norm(super::super::vec3::sub(near, force)));
            }
        }
        let rms = |sum: f64| (sum / count).sqrt();
        assert!((rms(forces) / 0.05 - 1.0).abs() < 0.05, "{}", rms(forces));
        assert!((rms(moments) / 0.01 - 1.0).abs() < 0.05, "{}", rms(moments));
        assert!(step < 0.02, "{step}");
        let none = UnmodelledParams::default();
        assert!(Unmodelled::new(&none).is_none());
    }
}
