//! Knocks that no single rest shows: the last rests are judged together.
//!
//! Each rest leaves a hint of how far each anchor and the camera may have moved: the score of its rows and its information.
//! Where the hints of the last rests together would be rare without a knock, the filter is run again from before each of these
//! rests, with one cause set free, and the likelihood of all that was measured since is compared with that of the filter as it
//! ran (Willsky and Jones, 1976, with the ratio of marginal likelihoods in place of the generalised one). Without a knock that
//! ratio exceeds e^s with a probability of e^-s at most, whatever the rows (Markov's inequality: its mean is 1), if the model is
//! true.

use super::Tracker;
use super::gaussian::{Fit, Gaussian};
use super::hint::Hint;
use super::judge::Reading;
use super::knock::{ANCHOR_M, Hypothesis, Moved, Named};
use crate::estimate::region::chi2_quantile;
use std::collections::VecDeque;

/// Rests that are judged together.
const WINDOW: usize = 12;
/// The last of them that saw something stay among them while others come and go: a camera shows in looks alone.
const LOOKS: usize = 2;
/// Unless more than this has happened since.
const EVENTS: usize = 300;
/// What hints explain together is looked into beyond this, chi-squared of three: 1.1 of 1,000 rests and anchors without a knock.
const WORTH: f64 = 16.0;
/// Logarithm of the ratio of likelihoods that names a cause. Nothing was named in 640 undisturbed hours of two robots
/// (docs/results/day.md).
const SURE: f64 = 12.0;
/// The best cause is named if no other is more likely than a hundredth of it: ln(100).
const CLEARER: f64 = 4.6;
/// The logarithm without the rest that says most: something may have touched the platform in one rest.
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
    reading: Reading,
    fit: Fit,
    hints: Vec<Hint>,
    since: Vec<Event>,
}

impl Recent {
    fn looked(&self) -> bool {
        !self.reading.measured.views.is_empty()
    }
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
    pub(super) fn remember(
        &mut self,
        before: Gaussian,
        reading: Reading,
        fit: Fit,
        hints: Vec<Hint>,
    ) {
        self.recent.push_back(Recent {
            before,
            loaded: self.loaded,
            reading,
            fit,
            hints,
            since: Vec::new(),
        });
        while self.recent.len() > WINDOW {
            self.forget_one();
        }
    }

    /// Forgets the oldest rest; or, where that is one of the last looks, the oldest rest without one. What happened after it
    /// stays. A filter that is run again then knows less than it did; the mean of its ratio without a knock is still 1.
    fn forget_one(&mut self) {
        let looks = self.recent.iter().skip(1).filter(|rest| rest.looked());
        let keeps = looks.count() < LOOKS;
        let blind = self.recent.iter().position(|rest| !rest.looked());
        let at = blind.unwrap_or(0);
        let before = at.checked_sub(1).and_then(|k| self.recent.get(k));
        if keeps && before.is_some_and(|rest| rest.since.len() < EVENTS) {
            let after = self.recent.remove(at).map(|rest| rest.since);
            if let Some(before) = self.recent.get_mut(at - 1) {
                before.since.extend(after.into_iter().flatten());
            }
        } else {
            self.recent.pop_front();
        }
    }

    /// The one cause of what the last rests measured, if they leave no doubt, and the states with it.
    pub(super) fn seen_together(&self) -> Option<(Named, Gaussian)> {
        let anchors = (1..=self.layout.cables).map(Moved::Anchor);
        let suspects: Vec<(Moved, Vec<usize>)> = (anchors.chain([Moved::Camera]).enumerate())
            .map(|(hint, what)| (what, self.suspects(hint)))
            .collect();
        let mut found: Vec<Found> = (suspects.iter())
            .filter_map(|(what, onsets)| self.since_when(*what, onsets))
            .collect();
        // A load leaves no hint of its own: it is asked where another cause is likely, or no suspect explains the rests.
        let unexplained = found.is_empty() && suspects.iter().any(|(_, onsets)| !onsets.is_empty());
        if self.loaded && (unexplained || found.iter().any(|found| found.ratio > SURE)) {
            let onsets: Vec<usize> = (0..self.recent.len().saturating_sub(1)).collect();
            found.extend(self.since_when(Moved::Payload, &onsets));
        }
        found.sort_by(|a, b| b.ratio.total_cmp(&a.ratio));
        let second = found.get(1).map_or(f64::NEG_INFINITY, |found| found.ratio);
        let best = found.into_iter().next()?;
        let clear = best.agreed && best.ratio > SURE && best.ratio - second > CLEARER;
        clear.then_some((best.named, best.states))
    }

    /// Rests but the last since which the hints of one cause together are rare without it.
    fn suspects(&self, hint: usize) -> Vec<usize> {
        let mut sum = Hint::none();
        let mut onsets = Vec::new();
        for (onset, rest) in self.recent.iter().enumerate().rev() {
            let Some(more) = rest.hints.get(hint) else {
                continue;
            };
            sum = sum.with(more);
            if onset + 1 < self.recent.len() && sum.explains(ANCHOR_M) > WORTH {
                onsets.push(onset);
            }
        }
        onsets
    }

    /// A cause set free before each of these rests: the most likely.
    fn since_when(&self, what: Moved, onsets: &[usize]) -> Option<Found> {
        let all = onsets
            .iter()
            .filter_map(|onset| self.moved_before(what, *onset));
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
            recent: VecDeque::new(),
            ..*self
        };
        again.loaded = first.loaded;
        change(&mut again.now);
        let mut fits = Vec::new();
        for rest in self.recent.iter().skip(onset) {
            let taken = again.taken(&again.now, &rest.reading)?;
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
