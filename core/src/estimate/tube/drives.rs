//! What drives that follow late leave of a plan's motion, as the board corrects it.
//!
//! A board learns how late each drive follows, and leads it by that; and it learns how far the motor's counts and the drum's
//! are apart, and trims by that. Both take time: what is left of an error is what has changed since.

use crate::motion::{Plan, PlanError};

/// Half of the time over which speed and acceleration are taken, s.
const HALF_S: f64 = 0.02;
/// Time in which a drive's lag is learnt, s (`LAG_TIME_MS` of the firmware's `axis`).
const LAG_S: f64 = 0.064;
/// Time in which motor and drum are trimmed, s (`TRIM_TIME_MS` of the firmware's `axis`).
const TRIM_S: f64 = 0.512;

/// How the cables of a plan move at a time.
pub(super) struct Motion {
    /// Speed of each cable that its lead has not learnt yet, m/s.
    pub(super) unled_mps: Vec<f64>,
    /// Speed of each cable that its trim has not learnt yet, m/s.
    pub(super) untrimmed_mps: Vec<f64>,
    /// Acceleration of each cable, m/s².
    pub(super) length_mps2: Vec<f64>,
}

impl Motion {
    /// At rest.
    pub(super) fn none(cables: usize) -> Self {
        Self {
            unled_mps: vec![0.0; cables],
            untrimmed_mps: vec![0.0; cables],
            length_mps2: vec![0.0; cables],
        }
    }
}

/// What the boards have learnt, along a plan.
pub(super) struct Drives {
    led_mps: Vec<f64>,
    trimmed_mps: Vec<f64>,
    last_s: f64,
}

impl Drives {
    /// At the start of a plan, after a rest.
    pub(super) fn new(cables: usize) -> Self {
        Self {
            led_mps: vec![0.0; cables],
            trimmed_mps: vec![0.0; cables],
            last_s: 0.0,
        }
    }

    /// Goes on to a time of the plan, s.
    ///
    /// # Errors
    /// None within a plan that was made.
    pub(super) fn at(&mut self, plan: &Plan, time_s: f64) -> Result<Motion, PlanError> {
        let end_s = plan.timed.duration_s();
        let lengths_m = |at_s: f64| plan.timed.lengths_m(at_s.clamp(0.0, end_s));
        let [before, now, after] = [
            lengths_m(time_s - HALF_S)?,
            lengths_m(time_s)?,
            lengths_m(time_s + HALF_S)?,
        ];
        let mut motion = Motion::none(self.led_mps.len());
        let step_s = (time_s - self.last_s).max(0.0);
        self.last_s = time_s;
        let learnt = |known: &mut f64, speed_mps: f64, within_s: f64| {
            *known += (speed_mps - *known) * -libm::expm1(-step_s / within_s);
            speed_mps - *known
        };
        let lengths = before.iter().zip(now.iter()).zip(after.iter()).enumerate();
        for (i, ((before, now), after)) in lengths {
            // The platform stands before a plan and after it: its ends count as such.
            let speed_mps = (after - before) / (2.0 * HALF_S);
            motion.length_mps2[i] = (after - 2.0 * now + before) / (HALF_S * HALF_S);
            motion.unled_mps[i] = learnt(&mut self.led_mps[i], speed_mps, LAG_S);
            motion.untrimmed_mps[i] = learnt(&mut self.trimmed_mps[i], speed_mps, TRIM_S);
        }
        Ok(motion)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::{Model, Step, path::Path};
    use crate::robot::Robot;
    use nalgebra::Vector3;

    #[test]
    fn what_has_lasted_is_learnt_and_what_turns_round_is_not() {
        let model = Model::new(&Robot::built_in("eight-cable").unwrap()).unwrap();
        let home_m = model.robot().tool.home_in_world_m;
        let to_m = home_m + Vector3::new(0.25, 0.0, 0.0);
        let step = |from: &Vector3<f64>, to: &Vector3<f64>| Step::Move {
            path: Path::through(&[*from, *to]).unwrap(),
            duration_s: None,
            speed_mps: Some(0.1),
        };
        let steps = [step(&home_m, &to_m), step(&to_m, &home_m)];
        let plan = Plan::new(&model, &home_m, &steps).unwrap();
        let end_s = plan.timed.duration_s();
        let mut drives = Drives::new(model.robot().cables.len());
        let (mut unled, mut untrimmed, mut accelerates) = (Vec::new(), Vec::new(), Vec::new());
        let times_s: Vec<f64> = (0..)
            .map(|k| f64::from(k) * 0.01)
            .take_while(|s| *s < end_s)
            .collect();
        for time_s in &times_s {
            let motion = drives.at(&plan, *time_s).unwrap();
            unled.push(motion.unled_mps[0]);
            untrimmed.push(motion.untrimmed_mps[0]);
            accelerates.push(motion.length_mps2[0]);
        }
        let at = |time_s: f64| times_s.iter().position(|s| *s >= time_s).unwrap();
        let speed_mps = |time_s: f64| {
            let lengths = |s: f64| plan.timed.lengths_m(s).unwrap()[0];
            (lengths(time_s + 0.01) - lengths(time_s - 0.01)) / 0.02
        };
        // Before it turns round it has moved for more than two seconds.
        let before_s = end_s / 2.0 - 0.4;
        let speed = speed_mps(before_s).abs();
        assert!(speed > 0.02, "{speed}");
        assert!(unled[at(before_s)].abs() < 0.05 * speed);
        assert!(untrimmed[at(before_s)].abs() < 0.15 * speed);
        assert!(accelerates[at(before_s)].abs() < 0.05);
        // Turned round, it is off by nearly twice its speed by the trim, and not by the lead.
        let after = at(end_s / 2.0)..at(end_s / 2.0 + 0.4);
        let most = |of: &[f64]| {
            of[after.clone()]
                .iter()
                .map(|v| v.abs())
                .fold(0.0, f64::max)
        };
        assert!(most(&untrimmed) > 1.2 * speed, "{}", most(&untrimmed));
        assert!(most(&unled) < 0.9 * speed, "{}", most(&unled));
    }
}
