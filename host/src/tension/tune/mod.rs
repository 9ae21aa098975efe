//! Tuning of the tension loop: steps of the set-point, a model fitted to the response, gains with
//! stated margins.
//!
//! The model is the drum on its cable to a swinging platform, with a gain error and a delay of the
//! motor's force. It is simulated in closed loop with the active law, and its parameters are fitted
//! to the measured tension.

mod model;
mod quality;
mod simplex;

use self::model::{Model, TICK_S};
use self::simplex::nelder_mead;
use super::rig::Rig;
use crate::link::Link;
use crate::robot::{Robot, TensionLaw, Winch};
use crate::run::RunError;
use miette::Diagnostic;
use thiserror::Error;

/// One measured response: requested and measured tension, one sample per millisecond, N.
#[derive(Debug, Clone, Default, PartialEq, serde::Serialize)]
pub struct Answer {
    /// Asked, N.
    pub asked_n: Vec<f64>,
    /// Measured, N.
    pub measured_n: Vec<f64>,
}

/// The identified parameters.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub(crate) struct Identified {
    /// Force at the cable over the requested force.
    pub gain: f64,
    /// Time from a demand to its force, bus and drive included, s.
    pub delay_s: f64,
    /// Coulomb friction, N.
    pub friction_n: f64,
    /// Stiffness of the cable, N/m.
    pub stiffness_n_per_m: f64,
    /// Mass of drum and rotor at the cable, kg: the robot file's.
    pub mass_kg: f64,
    /// Effective mass of the platform at the cable's far end, along it, kg.
    pub far_mass_kg: f64,
    /// Frequency of the platform's swing there, Hz.
    pub swing_hz: f64,
    /// Resonance of drum and cable, Hz.
    pub resonance_hz: f64,
    /// Share of the response's variance that the model explains.
    pub explained: f64,
}

/// Distance of gains from instability on the identified model, without friction.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Margins {
    /// Greatest stable factor on all gains, at most 10.
    pub gain: f64,
    /// Greatest stable delay beyond the identified one, s, at most 20 ms.
    pub delay_s: f64,
}

/// Why tuning failed.
#[derive(Debug, Error, Diagnostic)]
pub(crate) enum TuneError {
    /// The response is not credible.
    #[error("the step response is not credible: {what}; nothing was changed")]
    #[diagnostic(
        code(mcdpr::tune::response),
        help(
            "let the platform come to rest, see that the cable runs free and that friction_n, the motor's constants and the sensor's law in the robot file are right, then tune again"
        )
    )]
    Response {
        /// The symptom.
        what: String,
    },
    /// Invalid gains.
    #[error("{name} is {value}: gains are finite and not negative; nothing was changed")]
    #[diagnostic(code(mcdpr::tune::gains))]
    Gains {
        /// Which.
        name: &'static str,
        /// Its value.
        value: f64,
    },
    /// Unstable gains.
    #[error(
        "these gains are unstable on the identified model (resonance {resonance_hz:.0} Hz, delay {delay_ms:.1} ms); nothing was changed"
    )]
    #[diagnostic(
        code(mcdpr::tune::unstable),
        help("lower kp first; `mcdpr tune tension` proposes gains with margins")
    )]
    Unstable {
        /// Resonance, Hz.
        resonance_hz: f64,
        /// Delay, ms.
        delay_ms: f64,
    },
    /// No gains of the search have the margins.
    #[error("no gains have the margins on the identified model ({what}); nothing was changed")]
    #[diagnostic(
        code(mcdpr::tune::none),
        help(
            "the delay is too long for this cable and drum: a faster bus (tension_period_us) or a lighter winch helps"
        )
    )]
    None {
        /// The model.
        what: String,
    },
}

/// The identified quantities: gain, delay, friction, stiffness, the far end's mass and swing.
const UNKNOWNS: usize = 6;
/// Prior uncertainty of each, as a logarithm: parameters with little information in the response
/// stay near the robot file. A cable and its length are known well; without that prior, its
/// stiffness absorbed the platform's other modes, and was identified eight times too large.
const SPREAD: [f64; UNKNOWNS] = [0.2, 0.7, 1.0, 0.15, 0.7, 0.7];
/// Correlation time of the model's residual, s.
const CORRELATED_S: f64 = 0.005;
/// Typical frequency of the platform's swing, Hz; the fit starts there.
const SWING_HZ: f64 = 4.0;
/// Least share of a credible response that the model explains.
const LEAST_EXPLAINED: f64 = 0.8;
/// Margins of proposed gains.
pub const LEAST: Margins = Margins {
    gain: 2.0,
    delay_s: 0.002,
};
/// The set-points of the excitation about `around_n`: up and down by `step_n`, N per millisecond.
#[must_use]
pub(crate) fn excitation(around_n: f64, step_n: f64) -> Vec<(f64, f64)> {
    let mut stages = vec![(0.3, around_n)];
    for (up, hold_s) in [
        (1.0, 0.35),
        (0.0, 0.3),
        (-1.0, 0.35),
        (0.5, 0.25),
        (0.0, 0.35),
    ] {
        let level = around_n + up * step_n;
        stages.push((0.005, level));
        stages.push((hold_s, level));
    }
    stages
}

/// Measures the response of one cable's loop to the excitation.
///
/// # Errors
/// As a run.
pub(crate) fn excite<L: Link>(
    rig: &mut Rig<L>,
    cable: usize,
    stages: &[(f64, f64)],
) -> Result<Answer, RunError> {
    let measured_n = rig.step(cable, stages)?;
    let mut asked_n = Vec::new();
    let mut level = stages.first().map_or(0.0, |stage| stage.1);
    for &(duration_s, to) in stages {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "some hundred ticks"
        )]
        let ticks = (duration_s / TICK_S).round() as usize;
        for tick in 0..ticks {
            #[expect(clippy::cast_precision_loss, reason = "some hundred ticks")]
            let share = (tick + 1) as f64 / ticks as f64;
            asked_n.push(level + share * (to - level));
        }
        level = to;
    }
    let length = asked_n.len().min(measured_n.len());
    asked_n.truncate(length);
    Ok(Answer {
        asked_n,
        measured_n: measured_n.into_iter().take(length).collect(),
    })
}

/// Fits the model to a response that was measured with the robot file's law.
///
/// # Errors
/// [`TuneError::Response`] if the response is not credible.
pub(crate) fn identify(
    robot: &Robot,
    cable: usize,
    winch: &Winch,
    answer: &Answer,
) -> Result<Identified, TuneError> {
    let refuse = |what: String| Err(TuneError::Response { what });
    // The first step ends after 0.66 s: with less than 0.5 s there is no response to fit.
    if answer.measured_n.len() < 500 {
        return refuse(format!("only {} samples came", answer.measured_n.len()));
    }
    if let Some(bad) = answer.measured_n.iter().find(|n| !n.is_finite()) {
        return refuse(format!("a sample is {bad}"));
    }
    let mean = |values: &[f64]| {
        #[expect(clippy::cast_precision_loss, reason = "some thousand samples")]
        let count = values.len().max(1) as f64;
        values.iter().sum::<f64>() / count
    };
    let (asked_mean, measured_mean) = (mean(&answer.asked_n), mean(&answer.measured_n));
    let pairs = || answer.asked_n.iter().zip(&answer.measured_n);
    let swing: f64 = answer
        .asked_n
        .iter()
        .map(|a| (a - asked_mean).powi(2))
        .sum();
    let moved: f64 = answer
        .measured_n
        .iter()
        .map(|m| (m - measured_mean).powi(2))
        .sum();
    let along: f64 = pairs()
        .map(|(a, m)| (a - asked_mean) * (m - measured_mean))
        .sum();
    // The slope of measured over requested tension: 1 follows, below 0.3 no loop is at work.
    if along <= 0.3 * swing {
        return refuse(format!(
            "the tension follows only {:.0} % of a step",
            100.0 * along / swing.max(1e-9)
        ));
    }
    // EA over the length, which is taken as twice the routing; 0.2 m keeps it finite without.
    let nominal = robot
        .cables
        .get(cable)
        .map_or(4e4, |c| c.ea_n / (2.0 * c.routing_length_m).max(0.2));
    let damping_time_s = robot.cables.get(cable).map_or(0.0, |c| c.damping_time_s);
    // Logarithms: every value stays positive, and 0 is the robot file's own.
    let model = |p: &[f64; UNKNOWNS]| Model {
        gain: p[0].exp(),
        delay_s: 5e-3 * p[1].exp(),
        friction_n: 0.3 * p[2].exp(),
        stiffness: nominal * p[3].exp(),
        mass_kg: winch.effective_mass_kg(),
        damping_time_s,
        far_kg: robot.platform.mass_kg * p[4].exp(),
        far_hz: SWING_HZ * p[5].exp(),
    };
    // Neighbouring samples err alike: of five, one is independent.
    #[expect(clippy::cast_precision_loss, reason = "some thousand samples")]
    let independent = answer.measured_n.len() as f64 * TICK_S / CORRELATED_S;
    let cost = |p: &[f64; UNKNOWNS]| {
        let prior: f64 = SPREAD.iter().zip(p).map(|(s, p)| (p / s).powi(2)).sum();
        let modelled = model(p).run(&robot.tension, winch.friction_n, &answer.asked_n, 0.0);
        let squares: f64 = modelled
            .iter()
            .zip(&answer.measured_n)
            .map(|(a, b)| (a - b).powi(2))
            .sum();
        if squares.is_finite() {
            // The posterior with an unknown error variance: it is the model's, not the sensor's.
            independent * squares.max(1e-9).ln() + prior
        } else {
            f64::MAX
        }
    };
    let best = nelder_mead([0.0; UNKNOWNS], 0.3, 500, cost);
    let fitted = model(&best);
    let modelled = fitted.run(&robot.tension, winch.friction_n, &answer.asked_n, 0.0);
    let left: f64 = modelled
        .iter()
        .zip(&answer.measured_n)
        .map(|(a, b)| (a - b).powi(2))
        .sum();
    let explained = 1.0 - left / moved.max(1e-12);
    if explained.is_nan() || explained < LEAST_EXPLAINED {
        return refuse(format!(
            "a drum on its cable explains only {:.0} % of it",
            100.0 * explained.max(0.0)
        ));
    }
    Ok(Identified {
        gain: fitted.gain,
        delay_s: fitted.delay_s,
        friction_n: fitted.friction_n,
        stiffness_n_per_m: fitted.stiffness,
        mass_kg: fitted.mass_kg,
        far_mass_kg: fitted.far_kg,
        swing_hz: fitted.far_hz,
        resonance_hz: fitted.resonance_hz(),
        explained,
    })
}

/// Refuses gains that are not finite or negative.
///
/// # Errors
/// [`TuneError::Gains`].
pub(crate) fn check_gains(law: &TensionLaw) -> Result<(), TuneError> {
    let gains = [
        ("kp", law.kp),
        ("ki", law.ki),
        ("kd", law.kd),
        ("damping_ns_per_m", law.damping_ns_per_m),
        ("filter_hz", law.filter_hz),
    ];
    let bad = gains
        .into_iter()
        .find(|(_, value)| !(value.is_finite() && *value >= 0.0));
    bad.map_or(Ok(()), |(name, value)| {
        Err(TuneError::Gains { name, value })
    })
}

impl Identified {
    fn model(&self, damping_time_s: f64) -> Model {
        Model {
            gain: self.gain,
            delay_s: self.delay_s,
            friction_n: self.friction_n,
            stiffness: self.stiffness_n_per_m,
            mass_kg: self.mass_kg,
            damping_time_s,
            far_kg: self.far_mass_kg,
            far_hz: self.swing_hz,
        }
    }

    /// Margins of gains on this model.
    ///
    /// # Errors
    /// [`TuneError::Gains`] if a gain is not finite or negative, [`TuneError::Unstable`].
    pub(crate) fn margins(
        &self,
        law: &TensionLaw,
        damping_time_s: f64,
    ) -> Result<Margins, TuneError> {
        check_gains(law)?;
        let model = self.model(damping_time_s);
        if !model.is_stable(law) {
            return Err(TuneError::Unstable {
                resonance_hz: self.resonance_hz,
                delay_ms: self.delay_s * 1e3,
            });
        }
        let scaled = |factor: f64| TensionLaw {
            kp: law.kp * factor,
            ki: law.ki * factor,
            kd: law.kd * factor,
            damping_ns_per_m: law.damping_ns_per_m * factor,
            ..*law
        };
        let gain = bisect(1.0, 10.0, |factor| model.is_stable(&scaled(factor)));
        let delay_s = bisect(0.0, 0.02, |more| {
            let late = Model {
                delay_s: model.delay_s + more,
                ..model
            };
            late.is_stable(law)
        });
        Ok(Margins { gain, delay_s })
    }

    /// Gains for this model: of those with at least these margins, the ones that a push of 0.5 N on
    /// the drum disturbs least.
    ///
    /// # Errors
    /// [`TuneError::None`].
    pub(crate) fn propose(
        &self,
        law: &TensionLaw,
        damping_time_s: f64,
        least: &Margins,
    ) -> Result<(TensionLaw, Margins), TuneError> {
        // Without friction, which would hold a drum that otherwise swings.
        let model = Model {
            friction_n: 0.0,
            ..self.model(damping_time_s)
        };
        // Damping that stops the drum within the time constant of its loop.
        let unit = self.mass_kg / (10.0 * self.delay_s).max(1e-3);
        let mut candidates: Vec<[f64; 3]> = Vec::new();
        let mut all = |kps: &[f64], kis: &[f64], dampings: [f64; 3]| {
            for &kp in kps {
                for &ki in kis {
                    candidates.extend(dampings.map(|damping| [kp, ki, damping]));
                }
            }
        };
        all(
            &[0.0, 0.1, 0.2, 0.3, 0.5, 0.8, 1.2, 2.0, 3.0],
            &[1.0, 2.0, 5.0, 10.0, 20.0, 40.0],
            [unit, 3.0 * unit, 6.0 * unit],
        );
        let around = |value: f64| [0.5 * value, value, 2.0 * value];
        all(
            &around(law.kp),
            &around(law.ki),
            around(law.damping_ns_per_m),
        );
        let mut found: Vec<(f64, TensionLaw)> = Vec::new();
        for [kp, ki, damping_ns_per_m] in candidates {
            let gains = TensionLaw {
                kp,
                ki,
                kd: 0.0,
                damping_ns_per_m,
                ..*law
            };
            // A platform has more modes than the dominant one.
            let swings = [0.5, 1.0, 1.7].map(|factor| Model {
                far_hz: model.far_hz * factor,
                ..model
            });
            if swings.iter().all(|model| model.is_stable(&gains)) {
                let answer = model.run(&gains, 0.0, &[0.0; 1500], 0.5);
                found.push((answer.iter().map(|n| n * n).sum(), gains));
            }
        }
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        found
            .into_iter()
            .find_map(|(_, gains)| {
                let margins = self.margins(&gains, damping_time_s).ok()?;
                let enough = margins.gain >= least.gain && margins.delay_s >= least.delay_s;
                enough.then_some((gains, margins))
            })
            .ok_or_else(|| TuneError::None {
                what: format!(
                    "drum {:.2} kg, cable {:.0} N/m, {:.1} ms late, platform {:.1} kg swinging at \
                     {:.1} Hz",
                    self.mass_kg,
                    self.stiffness_n_per_m,
                    self.delay_s * 1e3,
                    self.far_mass_kg,
                    self.swing_hz
                ),
            })
    }
}

/// The greatest value up to which `holds`, which holds at `low`.
fn bisect(low: f64, high: f64, holds: impl Fn(f64) -> bool) -> f64 {
    if holds(high) {
        return high;
    }
    let (mut low, mut high) = (low, high);
    // Seven halvings: a factor of 1 to 10 to 0.07, a delay of 20 ms to 0.16 ms.
    for _ in 0..7 {
        let middle = 0.5 * (low + high);
        if holds(middle) {
            low = middle;
        } else {
            high = middle;
        }
    }
    low
}
#[cfg(test)]
mod tests {
    use super::*;

    fn truth() -> Model {
        Model {
            gain: 0.9,
            delay_s: 6e-3,
            friction_n: 0.4,
            stiffness: 42_000.0,
            mass_kg: 0.1,
            damping_time_s: 2e-4,
            far_kg: 1.2,
            far_hz: 4.5,
        }
    }

    fn answer(robot: &Robot, model: &Model) -> Answer {
        let mut asked_n = Vec::new();
        for (duration_s, level) in excitation(10.0, 2.0) {
            asked_n.extend(std::iter::repeat_n(level, (duration_s / TICK_S) as usize));
        }
        let measured_n = model.run(&robot.tension, 0.5, &asked_n, 0.0);
        Answer {
            asked_n,
            measured_n,
        }
    }

    #[test]
    fn gain_delay_and_friction_of_a_known_loop_are_found() {
        let robot = Robot::built_in("lab-direct").unwrap();
        let found = identify(&robot, 3, &robot.winches[3], &answer(&robot, &truth())).unwrap();
        assert!((found.gain - 0.9).abs() < 0.1, "{found:?}");
        assert!((found.delay_s - 6e-3).abs() < 3e-3, "{found:?}");
        assert!((found.resonance_hz - 107.0).abs() < 40.0, "{found:?}");
        assert!((found.swing_hz - 4.5).abs() < 1.5, "{found:?}");
        assert!(found.explained > 0.95, "{found:?}");
        let (gains, margins) = found.propose(&robot.tension, 2e-4, &LEAST).unwrap();
        assert!(
            margins.gain >= 2.0 && margins.delay_s >= 0.002,
            "{margins:?}"
        );
        assert!(truth().is_stable(&gains), "{gains:?}");
    }

    #[test]
    fn dead_and_wild_answers_and_gains_are_refused() {
        let robot = Robot::built_in("lab-direct").unwrap();
        let winch = &robot.winches[3];
        let good = answer(&robot, &truth());
        let refused = |measured_n: Vec<f64>| {
            let answer = Answer {
                measured_n,
                ..good.clone()
            };
            let error = identify(&robot, 3, winch, &answer).unwrap_err();
            assert!(matches!(error, TuneError::Response { .. }), "{error}");
        };
        refused(vec![10.0; good.asked_n.len()]);
        refused(good.measured_n.iter().map(|n| 20.0 - n).collect());
        refused(vec![10.0; 100]);
        let mut spoilt = good.measured_n.clone();
        spoilt[700] = f64::NAN;
        refused(spoilt);
        let found = identify(&robot, 3, winch, &good).unwrap();
        let law = |kp: f64| TensionLaw {
            kp,
            ..robot.tension
        };
        assert!(matches!(
            found.margins(&law(f64::NAN), 2e-4),
            Err(TuneError::Gains { .. })
        ));
        assert!(matches!(
            found.margins(&law(20.0), 2e-4),
            Err(TuneError::Unstable { .. })
        ));
    }
}
