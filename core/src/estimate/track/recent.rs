//! Knocks that no single rest shows: the last rests are judged together.
//!
//! Each rest leaves a hint of how far each anchor may have moved: the score of its rows and its information. Where the hints
//! of the last rests together would be rare without a knock, the filter is run again from before each of these rests, with one cause
//! set free, and the likelihood of all that was measured since is compared with that of the filter as it ran (Willsky and Jones,
//! 1976, with the ratio of marginal likelihoods in place of the generalised one). Without a knock that ratio exceeds e^s with a
//! probability of e^-s at most, whatever the rows (Markov's inequality: its mean is 1), if the model is true.

use super::Tracker;
use super::gaussian::{Fit, Gaussian};
use super::hint::Hint;
use super::knock::{ANCHOR_M, CLEARER, Hypothesis, Moved, Named, Pending};
use crate::estimate::region::chi2_quantile;
use std::collections::VecDeque;

/// Rests that are judged together.
const WINDOW: usize = 6;
/// What hints explain together is looked into beyond this, chi-squared of three: 1.1 of 1,000 rests and anchors without a knock.
const WORTH: f64 = 16.0;
/// Logarithm of the ratio of likelihoods that names a cause. No rest of 320 undisturbed hours of two robots was worth a look
/// (docs/results/day.md).
const SURE: f64 = 12.0;
/// The same without the rest that says most: something may have touched the platform in one rest.
const AGREED: f64 = 3.0;

/// What happened to the states between two rests.
#[derive(Debug, Clone)]
pub(super) enum Event {
    Passed(f64, Vec<f64>),
    Lifted,
    SetDown,
}

/// A rest, with the states before it and what happened after it.
#[derive(Debug, Clone)]
pub(super) struct Recent {
    before: Gaussian,
    loaded: bool,
    look: Pending,
    fit: Fit,
    hints: Vec<Hint>,
    since: Vec<Event>,
}

/// A cause, what it makes likely, and the states with it.
struct Found {
    named: Named,
    ratio: f64,
    agreed: bool,
    states: Gaussian,
}

impl Tracker {
    /// Takes note of what happens between two rests.
    pub(super) fn happened(&mut self, event: impl FnOnce() -> Event) {
        if let Some(last) = self.recent.back_mut() {
            last.since.push(event());
        }
    }

    /// Takes note of a rest with the states `before` it.
    pub(super) fn remember(&mut self, before: Gaussian, look: Pending, fit: Fit, hints: Vec<Hint>) {
        if self.recent.len() == WINDOW {
            self.recent.pop_front();
        }
        self.recent.push_back(Recent {
            before,
            loaded: self.loaded,
            look,
            fit,
            hints,
            since: Vec::new(),
        });
    }

    /// The one cause of what the last rests measured, if they leave no doubt, and the states with it.
    pub(super) fn seen_together(&self) -> Option<(Named, Gaussian)> {
        if !self.is_worth_a_look() {
            return None;
        }
        let anchors = (1..=self.layout.cables).map(Moved::Anchor);
        let looks = (self.recent.iter()).any(|rest| !rest.look.measured.views.is_empty());
        let camera = looks.then_some(Moved::Camera);
        let load = self.loaded.then_some(Moved::Payload);
        let mut found: Vec<Found> = anchors
            .chain(camera)
            .chain(load)
            .filter_map(|what| self.since_when(what))
            .collect();
        found.sort_by(|a, b| b.ratio.total_cmp(&a.ratio));
        let second = found.get(1).map_or(f64::NEG_INFINITY, |found| found.ratio);
        let best = found.into_iter().next()?;
        let clear = best.agreed && best.ratio > SURE && best.ratio - second > CLEARER;
        clear.then_some((best.named, best.states))
    }

    /// Whether the hints of at least two rests together are rare without a knock.
    fn is_worth_a_look(&self) -> bool {
        let mut sums = vec![Hint::none(); self.layout.cables];
        for (count, rest) in (1..).zip(self.recent.iter().rev()) {
            for (sum, hint) in sums.iter_mut().zip(&rest.hints) {
                *sum = sum.with(hint);
            }
            if count > 1 && sums.iter().any(|sum| sum.explains(ANCHOR_M) > WORTH) {
                return true;
            }
        }
        false
    }

    /// A cause set free before each of the last rests but one: the most likely.
    fn since_when(&self, what: Moved) -> Option<Found> {
        let onsets = 0..self.recent.len().saturating_sub(1);
        let all = onsets.filter_map(|onset| self.moved_before(what, onset));
        all.max_by(|a, b| a.ratio.total_cmp(&b.ratio))
    }

    fn moved_before(&self, what: Moved, onset: usize) -> Option<Found> {
        let first = self.recent.get(onset)?;
        let hypothesis = Hypothesis(what);
        let (fits, states) = self.again(onset, |now| hypothesis.free(self.layout, now))?;
        let (mut ratio, mut most) = (0.0, f64::NEG_INFINITY);
        let mut whole = Fit::default();
        for (fit, rest) in fits.into_iter().zip(self.recent.iter().skip(onset)) {
            let by = fit.log_likelihood() - rest.fit.log_likelihood();
            ratio += by;
            most = by.max(most);
            whole = whole.with(fit);
        }
        let fits = whole.squares < chi2_quantile(whole.rows as f64, super::DOUBT_SIGMAS);
        let by = hypothesis.change(self.layout, &first.before, &states);
        fits.then_some(Found {
            named: Named { what, by },
            ratio,
            agreed: ratio - most > AGREED,
            states,
        })
    }

    /// The filter run again from before the rest `onset`, with the states of then as `change` leaves them: how each rest since
    /// fits, and the states in the end. Every rest is used, also one that did not fit.
    fn again(
        &self,
        onset: usize,
        change: impl FnOnce(&mut Gaussian),
    ) -> Option<(Vec<Fit>, Gaussian)> {
        let first = self.recent.get(onset)?;
        let mut again = Self {
            robot: self.robot.clone(),
            now: first.before.clone(),
            planned: self.planned.clone(),
            at_home: None,
            pending: Vec::new(),
            recent: VecDeque::new(),
            ..*self
        };
        again.loaded = first.loaded;
        change(&mut again.now);
        let mut fits = Vec::new();
        for rest in self.recent.iter().skip(onset) {
            let taken = again.taken(&again.now, &rest.look)?;
            fits.push(taken.fit);
            again.now = taken.states;
            for event in &rest.since {
                match event {
                    Event::Passed(seconds, tensions_n) => again.pass(*seconds, tensions_n),
                    Event::Lifted => again.lift(),
                    Event::SetDown => again.set_down(),
                }
            }
        }
        Some((fits, again.now))
    }
}

#[cfg(test)]
mod tests;
