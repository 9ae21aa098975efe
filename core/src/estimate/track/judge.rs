//! Whether a rest is used, or is doubted, and whether the last rests name what moved.

use super::pulleys::Rubbing;
use super::report::Report;
use super::{DOUBT_SIGMAS, Taken, Tracker};
use crate::estimate::Measurements;
use crate::estimate::region::chi2_quantile;
use mcdpr_kinematics::Pose;

/// What a rest is judged by.
#[derive(Debug, Clone)]
pub(super) struct Reading {
    pub(super) measured: Measurements,
    pub(super) rubbing: Vec<Rubbing>,
    pub(super) near: Pose,
}

impl Tracker {
    /// Takes a rest into account. `rubbing`: the friction of each pulley. `near`: about how the platform hangs.
    pub fn rest(&mut self, measured: &Measurements, rubbing: &[Rubbing], near: &Pose) -> Report {
        let reading = Reading {
            measured: measured.clone(),
            rubbing: rubbing.to_vec(),
            near: *near,
        };
        let mut report = self.judged(reading);
        if let Some((named, next)) = self.seen_together() {
            report.named = Some(named);
            self.now = next;
            self.follow(measured, rubbing, near);
            self.recent.clear();
        }
        report
    }

    /// A rest is used if it fits. One that does not waits among the last ones until one cause explains them.
    fn judged(&mut self, reading: Reading) -> Report {
        let Some(Taken { states, fit, hints }) = self.taken(&self.now, &reading) else {
            return Report::of(f64::INFINITY);
        };
        let report = Report::of(fit.squares / chi2_quantile(fit.rows as f64, DOUBT_SIGMAS));
        if report.fits {
            let before = std::mem::replace(&mut self.now, states);
            self.follow(&reading.measured, &reading.rubbing, &reading.near);
            self.remember(before, reading, fit, hints);
        } else {
            self.remember(self.now.clone(), reading, fit, hints);
        }
        report
    }
}
