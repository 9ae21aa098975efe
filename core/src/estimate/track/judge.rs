//! Whether a rest is used, waits for an explanation, or names what moved.

use super::knock::{self, Pending};
use super::pulleys::Rubbing;
use super::report::Report;
use super::{DOUBT_SIGMAS, Taken, Tracker};
use crate::estimate::Measurements;
use crate::estimate::region::chi2_quantile;
use mcdpr_kinematics::Pose;

impl Tracker {
    /// Takes a rest into account. `rubbing`: the friction of each pulley. `near`: about how the platform hangs.
    pub fn rest(&mut self, measured: &Measurements, rubbing: &[Rubbing], near: &Pose) -> Report {
        let look = Pending {
            measured: measured.clone(),
            rubbing: rubbing.to_vec(),
            near: *near,
        };
        let mut report = self.judged(&look);
        if report.named.is_none()
            && let Some((named, next)) = self.seen_together()
        {
            report.named = Some(named);
            self.now = next;
            self.follow(measured, rubbing, near);
            self.pending.clear();
        }
        if report.named.is_some() {
            self.recent.clear();
        }
        report
    }

    /// A rest is used if it fits.
    fn judged(&mut self, look: &Pending) -> Report {
        let Some(Taken { states, fit, hints }) = self.taken(&self.now, look) else {
            return self.doubted(look.clone(), f64::INFINITY);
        };
        let doubt = fit.squares / chi2_quantile(fit.rows as f64, DOUBT_SIGMAS);
        if doubt > 1.0 || !doubt.is_finite() {
            self.remember(self.now.clone(), look.clone(), fit, hints);
            return self.doubted(look.clone(), doubt);
        }
        // A rest without a picture says nothing of the camera: looks that did not fit wait for the next one.
        let blind = look.measured.views.is_empty();
        self.pending
            .retain(|waiting| blind && !waiting.measured.views.is_empty());
        let before = std::mem::replace(&mut self.now, states);
        self.remember(before, look.clone(), fit, hints);
        self.follow(&look.measured, &look.rubbing, &look.near);
        Report {
            fits: true,
            doubt,
            named: None,
        }
    }

    /// A rest that does not fit: it waits until one cause explains it.
    fn doubted(&mut self, look: Pending, doubt: f64) -> Report {
        self.pending.push(look);
        let (named, next) = knock::explain(self);
        if let Some(next) = next {
            if let Some(last) = self.pending.last().cloned() {
                self.now = next;
                self.follow(&last.measured, &last.rubbing, &last.near);
            }
            self.pending.clear();
        }
        // Older rests tell no more: what they do not explain together stays open.
        if self.pending.len() >= knock::MOST {
            self.pending.remove(0);
        }
        Report {
            fits: false,
            doubt,
            named,
        }
    }
}
