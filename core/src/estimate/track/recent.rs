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
        hypothesis.free(self.layout, &mut again.now);
        let (mut ratio, mut most) = (0.0, f64::NEG_INFINITY);
        let mut fit = Fit::default();
        for rest in self.recent.iter().skip(onset) {
            let taken = again.taken(&again.now, &rest.look)?;
            let by = taken.fit.log_likelihood() - rest.fit.log_likelihood();
            ratio += by;
            most = by.max(most);
            fit = fit.with(taken.fit);
            again.now = taken.states;
            for event in &rest.since {
                match event {
                    Event::Passed(seconds, tensions_n) => again.pass(*seconds, tensions_n),
                    Event::Lifted => again.lift(),
                    Event::SetDown => again.set_down(),
                }
            }
        }
        let fits = fit.squares < chi2_quantile(fit.rows as f64, super::DOUBT_SIGMAS);
        let by = hypothesis.change(self.layout, &first.before, &again.now);
        fits.then_some(Found {
            named: Named { what, by },
            ratio,
            agreed: ratio - most > AGREED,
            states: again.now,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{all_rub, exact};
    use super::super::{Prior, Report};
    use super::*;
    use crate::motion::Model;
    use crate::random::Random;
    use crate::robot::Robot;
    use nalgebra::Vector3;

    const PLACES: [[f64; 3]; 5] = [
        [0.08, 0.1, -0.1],
        [0.05, -0.12, -0.15],
        [-0.1, 0.08, -0.05],
        [-0.06, -0.1, -0.12],
        [0.0, 0.05, -0.2],
    ];

    /// Without a camera four cables cannot tell whose anchor moved: eight can.
    fn eight_cable() -> Robot {
        Robot::built_in("eight-cable").unwrap()
    }

    /// Rests of a machine at one place after the other, with the noise of means over a second.
    fn rests_of(machine: &Robot, tracker: &mut Tracker, count: usize, seed: u64) -> Vec<Report> {
        let model = Model::new(machine).unwrap();
        let mut random = Random::new(seed);
        let places = PLACES.iter().cycle().take(count);
        let rest = |by: &[f64; 3]| {
            let (mut measured, _, near) = exact(&model, *by);
            for i in 0..measured.lengths_m.len() {
                measured.lengths_m[i] += 1e-5 * random.normal();
                measured.tensions_n[i] += 0.01 * random.normal();
            }
            tracker.pass(20.0, &measured.tensions_n);
            tracker.rest(&measured, &all_rub(&model, 0.0), &near)
        };
        places.map(rest).collect()
    }

    /// A tracker that knows an exact machine well.
    fn settled(robot: &Robot) -> Tracker {
        let prior = Prior {
            creep: [0.0, 1e-6],
            loss: [0.0, 1e-3],
            ..Prior::default()
        };
        let mut tracker = Tracker::new(&Model::new(robot).unwrap(), &prior);
        let before = rests_of(robot, &mut tracker, 60, 1);
        assert!(before.iter().all(|rest| rest.fits && rest.named.is_none()));
        tracker
    }

    fn knocked(robot: &Robot, cable: usize, by_m: [f64; 3]) -> Robot {
        let mut moved = robot.clone();
        moved.cables[cable].anchor_in_world_m += Vector3::from(by_m);
        moved
    }

    #[test]
    fn a_knock_that_no_single_rest_shows_is_named_by_rests_together() {
        let robot = eight_cable();
        let mut tracker = settled(&robot);
        let by_m = [0.0, 0.0, 0.7e-3];
        let moved = knocked(&robot, 0, by_m);
        let rests = rests_of(&moved, &mut tracker, 5, 2);
        let named = rests.iter().find_map(|rest| rest.named);
        let named = named.unwrap_or_else(|| panic!("nothing is named: {rests:?}"));
        assert!(rests.iter().all(|rest| rest.fits), "{rests:?}");
        assert_eq!(named.what, Moved::Anchor(1), "{named:?}");
        assert!(
            (named.by - Vector3::from(by_m)).norm() < 2.5e-4,
            "{named:?}"
        );
        // The states follow: the next rests fit and name nothing.
        let after = rests_of(&moved, &mut tracker, 20, 3);
        assert!(after.iter().all(|rest| rest.fits && rest.named.is_none()));
    }

    #[test]
    fn what_touches_the_platform_in_one_rest_is_not_named() {
        let robot = eight_cable();
        for by_mm in [0.5, 1.0, 2.0, 5.0] {
            let mut tracker = settled(&robot);
            let touched = knocked(&robot, 1, [0.0, 0.6e-3 * by_mm, 0.8e-3 * by_mm]);
            let mut rests = rests_of(&touched, &mut tracker, 1, 4);
            rests.extend(rests_of(&robot, &mut tracker, 30, 5));
            let named = rests.iter().find_map(|rest| rest.named);
            assert!(named.is_none(), "{by_mm} mm: {named:?}");
        }
    }

    #[test]
    fn a_hint_explains_what_a_free_anchor_does() {
        let robot = eight_cable();
        let tracker = settled(&robot);
        let moved = knocked(&robot, 0, [1e-3, 1e-3, 0.0]);
        let (measured, rubbing, near) = exact(&Model::new(&moved).unwrap(), PLACES[0]);
        let look = Pending {
            measured,
            rubbing,
            near,
        };
        let taken = tracker.taken(&tracker.now, &look).unwrap();
        for cable in 0..8 {
            let free = tracker.freed(Hypothesis(Moved::Anchor(cable + 1)));
            let explained = taken.fit.squares - tracker.taken(&free, &look).unwrap().fit.squares;
            let said = taken.hints[cable].explains(ANCHOR_M);
            // Linearised at states that differ by a millimetre.
            assert!(
                (said - explained).abs() < 0.05 * explained.max(1.0),
                "{said} {explained}"
            );
        }
    }
}
