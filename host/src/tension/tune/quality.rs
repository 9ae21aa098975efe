//! How well a response follows its steps, and how much it rings.

use super::Answer;

/// The set-point must have been constant for this long, in samples of 1 ms: the step itself is not ringing.
const SETTLED: usize = 100;
/// Half of the window whose mean is taken off, in samples: it keeps what is faster than some 15 Hz.
const HALF_WINDOW: usize = 30;

impl Answer {
    /// Root mean square of measured minus requested tension, N.
    #[must_use]
    pub(crate) fn rms_n(&self) -> f64 {
        let errors = self.asked_n.iter().zip(&self.measured_n);
        let squares: f64 = errors.map(|(a, m)| (a - m).powi(2)).sum();
        #[expect(clippy::cast_precision_loss, reason = "some thousand samples")]
        let count = self.asked_n.len().max(1) as f64;
        (squares / count).sqrt()
    }

    /// Root mean square of what oscillates about its own mean over 61 ms while the set-point rests, N: ringing, and
    /// the sensor's noise. 0 without such samples.
    #[must_use]
    pub(crate) fn ringing_n(&self) -> f64 {
        let (mut squares, mut count) = (0.0, 0.0_f64);
        let last = self.asked_n.len().min(self.measured_n.len());
        for at in SETTLED..last.saturating_sub(HALF_WINDOW) {
            let asked = &self.asked_n[at - SETTLED..=at + HALF_WINDOW];
            if asked.iter().any(|n| *n != asked[0]) {
                continue;
            }
            let window = &self.measured_n[at - HALF_WINDOW..=at + HALF_WINDOW];
            #[expect(clippy::cast_precision_loss, reason = "61 samples")]
            let mean = window.iter().sum::<f64>() / window.len() as f64;
            squares += (self.measured_n[at] - mean).powi(2);
            count += 1.0;
        }
        (squares / count.max(1.0)).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn answer(measured: impl Fn(f64) -> f64) -> Answer {
        let asked_n: Vec<f64> = (0..1500)
            .map(|k| if k < 400 { 10.0 } else { 12.0 })
            .collect();
        let measured_n = (0..1500).map(|k| measured(f64::from(k) * 1e-3)).collect();
        Answer {
            asked_n,
            measured_n,
        }
    }

    #[test]
    fn an_oscillation_rings_and_a_slow_approach_or_the_step_does_not() {
        let ringing = answer(|t| 11.0 + 0.1 * (std::f64::consts::TAU * 95.0 * t).sin());
        // The amplitude over the square root of two; the window takes off a hundredth.
        assert!(
            (ringing.ringing_n() - 0.0707).abs() < 0.003,
            "{}",
            ringing.ringing_n()
        );
        let slow = answer(|t| 12.0 - 2.0 * (-t / 0.3).exp());
        assert!(slow.ringing_n() < 5e-3, "{}", slow.ringing_n());
        let step = answer(|t| if t < 0.4 { 10.0 } else { 12.0 });
        assert!(step.ringing_n() < 1e-12 && step.rms_n() < 1e-12);
        assert!((answer(|_| 11.0).rms_n() - 1.0).abs() < 1e-12);
        assert_eq!(Answer::default().ringing_n(), 0.0);
    }
}
