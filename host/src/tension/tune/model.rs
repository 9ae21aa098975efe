//! The model that is fitted to a response: a drum, its cable, and the platform at its far end.

use crate::robot::TensionLaw;

/// Steps of the model per millisecond.
const SUBSTEPS: usize = 10;
/// A tick of the board, s.
pub(super) const TICK_S: f64 = 1e-3;
/// Damping of the platform's swing: very low (share of critical damping).
const FAR_DAMPING: f64 = 0.005;
/// Damping of the swing used for judging stability, so that the swing itself does not count as
/// instability.
const FAR_DAMPING_JUDGED: f64 = 0.25;

/// A drum on its cable to a platform that is held by the others, with the law, in `f64`.
///
/// `m x'' = T - F - friction`, `T = k (y - x)`, `M y'' = -T - M w^2 y`: `x` is the drum's pay-out,
/// `y` the displacement of the far end, m; all as deviations from rest.
#[derive(Debug, Clone, Copy)]
pub(super) struct Model {
    /// Force at the cable over the requested force.
    pub gain: f64,
    /// From a demand to its force, s.
    pub delay_s: f64,
    /// Coulomb friction at the drum, N.
    pub friction_n: f64,
    /// Stiffness of the cable, N/m.
    pub stiffness: f64,
    /// Mass of drum and rotor, at the cable, kg.
    pub mass_kg: f64,
    /// Damping time of the cable's material, s.
    pub damping_time_s: f64,
    /// Swinging mass at the far end, along the cable, kg.
    pub far_kg: f64,
    /// Frequency of its swing with the drum free, Hz.
    pub far_hz: f64,
}

impl Model {
    /// The tension while the set-point follows `asked_n`, from rest at its first value, N per
    /// millisecond; `push_n` acts on the drum, paying out.
    pub fn run(
        &self,
        law: &TensionLaw,
        declared_friction_n: f64,
        asked_n: &[f64],
        push_n: f64,
    ) -> Vec<f64> {
        self.run_damped(law, declared_friction_n, asked_n, push_n, FAR_DAMPING)
    }

    fn run_damped(
        &self,
        law: &TensionLaw,
        declared_friction_n: f64,
        asked_n: &[f64],
        push_n: f64,
        far_damping: f64,
    ) -> Vec<f64> {
        let start_n = asked_n.first().copied().unwrap_or(0.0);
        // The board's filter, by backward Euler: alpha = w dt / (1 + w dt).
        let w_dt = std::f64::consts::TAU * law.filter_hz * TICK_S;
        let alpha = w_dt / (1.0 + w_dt);
        let far_w = std::f64::consts::TAU * self.far_hz;
        let (mut x, mut v, mut y, mut u) = (0.0_f64, 0.0_f64, 0.0_f64, 0.0_f64);
        let (mut filtered, mut integral) = (0.0_f64, 0.0_f64);
        // Half of the delay is dead time, half the drive's lag.
        let dead = 0.5 * self.delay_s / TICK_S * substeps();
        let share = 1.0 - (-TICK_S / substeps() / (0.5 * self.delay_s).max(1e-5)).exp();
        let h = TICK_S / substeps();
        let mut demands: Vec<f64> = Vec::with_capacity(asked_n.len() * SUBSTEPS);
        let mut force = 0.0_f64;
        let mut out = Vec::with_capacity(asked_n.len());
        for &asked in asked_n {
            let tension = self.stiffness * (y - x + self.damping_time_s * (u - v));
            out.push(start_n + tension);
            let before = filtered;
            filtered += alpha * (tension - filtered);
            let error = (asked - start_n) - filtered;
            // The law compensates 80 % of the declared friction above 4 mm/s (docs/tension.md).
            let moves = (v / 4e-3).clamp(-1.0, 1.0);
            let demand = (asked - start_n) + law.kp * error - law.kd * (filtered - before) / TICK_S
                + integral
                + law.damping_ns_per_m * v
                - 0.8 * declared_friction_n * moves;
            integral += law.ki * error * TICK_S;
            for _ in 0..SUBSTEPS {
                demands.push(demand);
                #[expect(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    reason = "some hundred steps"
                )]
                let late = demands.len().checked_sub(1 + dead.round() as usize);
                let due = late.and_then(|i| demands.get(i)).copied().unwrap_or(0.0);
                force += share * (due - force);
                let tension = self.stiffness * (y - x + self.damping_time_s * (u - v));
                let free = v + h / self.mass_kg * (tension - self.gain * force + push_n);
                let stopped = h / self.mass_kg * self.friction_n;
                // Dry friction is an impulse that can stop the drum and no more.
                v = if free.abs() <= stopped {
                    0.0
                } else {
                    free - stopped.copysign(free)
                };
                x += h * v;
                u -= h * (tension / self.far_kg + far_w * (far_w * y + 2.0 * far_damping * u));
                y += h * u;
            }
        }
        out
    }

    /// Whether the loop without friction comes to rest after a push, and does not excite the
    /// platform's swing. The swing itself decays slowly with any loop: so the first is judged with
    /// additional damping.
    pub(crate) fn is_stable(&self, law: &TensionLaw) -> bool {
        let smooth = Self {
            friction_n: 0.0,
            ..*self
        };
        let peaks = |far_damping: f64, early: std::ops::Range<usize>| {
            let answer = smooth.run_damped(law, 0.0, &[0.0; 3000], 0.5, far_damping);
            let peak = |range| {
                let part: &[f64] = answer.get(range).unwrap_or_default();
                let (low, high) = part
                    .iter()
                    .fold((f64::MAX, f64::MIN), |(a, b), &n| (a.min(n), b.max(n)));
                high - low
            };
            (peak(early), peak(2500..3000))
        };
        let (early, late) = peaks(FAR_DAMPING_JUDGED, 0..500);
        // It rests if the last half second swings by less than a twentieth of the first.
        let rests = late.is_finite() && late < 0.05 * early.max(1e-6);
        let (early, late) = peaks(FAR_DAMPING, 500..1000);
        rests && late.is_finite() && late < early.max(0.05)
    }

    /// Resonance of drum and cable: the drum against a far end of the same mass, Hz.
    pub fn resonance_hz(&self) -> f64 {
        let reduced_kg = self.mass_kg * self.far_kg / (self.mass_kg + self.far_kg);
        (self.stiffness / reduced_kg).sqrt() / std::f64::consts::TAU
    }
}

#[expect(clippy::cast_precision_loss, reason = "ten")]
const fn substeps() -> f64 {
    SUBSTEPS as f64
}
