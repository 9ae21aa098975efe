//! Choice of the next pose: the nearest of the planned ones, or the one with the most information
//! now.

use super::super::Options as Estimator;
use super::super::data::Data;
use super::super::plan::{Candidate, Design, Halt, Search};
use super::{CollectError, Options, Reach, Sketch};
use crate::motion::StaticState;
use mcdpr_core::random::Random;

/// Working poses, where accuracy is wanted.
const WORK: usize = 100;
/// After this many failed poses the search for better neighbours stops, so that it ends.
const GIVEN_UP_MAX: usize = 5;
/// No search this close to a failed pose, m.
const LIKE_IT_M: f64 = 0.04;

/// State of the choice.
pub(super) struct Choice<'a> {
    reach: Reach<'a>,
    /// Input of the choice when it began: tags found since do not change the information of
    /// candidates.
    known: Data,
    all: Vec<Candidate>,
    design: Design,
    /// Candidates that were measured before.
    done: usize,
    /// Planned candidates, and how the robot hangs there.
    route: Vec<(usize, StaticState)>,
    given_up: Vec<usize>,
    random: Random,
}

impl<'a> Choice<'a> {
    /// Prepares a choice of `missing` poses more than the sketch has, until `halt` is wanted.
    ///
    /// # Errors
    /// [`CollectError::Impossible`] if there are too few candidates, or if the choice was broken off.
    pub(super) fn new(
        reach: &Reach<'a>,
        sketch: &Sketch,
        missing: usize,
        options: &Options,
        halt: &Halt,
    ) -> Result<Self, CollectError> {
        let known = sketch.data.clone();
        let found = reach.candidates(&known, options.candidates, options.seed, halt);
        if found.len() < missing {
            return Err(CollectError::impossible(
                format!(
                    "only {} reachable poses have a tag wholly in view, {missing} are wanted",
                    found.len()
                ),
                "lay the target nearer to the middle of the work space, or use smaller tags",
            ));
        }
        let work = reach.work(WORK, options.seed, halt);
        let mut all = sketch.candidates(reach.held().unwrap_or(0));
        let done = all.len();
        all.extend(found);
        let design = Design::while_wanted(&known, &all, &work, &Estimator::default(), halt.clone());
        let mut design = design.ok_or_else(|| {
            CollectError::impossible(
                "the worth of poses cannot be computed",
                "check the robot file's camera and anchors",
            )
        })?;
        for k in 0..done {
            design.take(k);
        }
        Ok(Self {
            reach: reach.clone(),
            known,
            all,
            design,
            done,
            route: Vec::new(),
            given_up: Vec::new(),
            random: Random::new(options.seed ^ 0x6E65_6172),
        })
    }

    /// Plans this many poses ahead.
    pub(super) fn plan(&mut self, count: usize) {
        for _ in 0..count {
            let Some((k, _)) = self.design.best(|_| true) else {
                break;
            };
            self.design.take(k);
        }
        self.design.exchange(self.done);
        self.refine(self.done);
        let chosen = self.design.taken()[self.done..].to_vec();
        self.design.release(self.done);
        self.route = chosen.into_iter().filter_map(|k| self.hang(k)).collect();
    }

    /// Replaces the candidates taken after the first `keep` by better ones near them.
    fn refine(&mut self, keep: usize) {
        let (reach, known, random) = (&self.reach, &self.known, &mut self.random);
        self.design.refine(
            known,
            &mut self.all,
            &Estimator::default(),
            keep,
            Search::QUICK,
            |candidate, size| reach.near(known, candidate, size, random),
        );
    }

    fn hang(&self, k: usize) -> Option<(usize, StaticState)> {
        Some((k, self.reach.at(self.all.get(k)?)?))
    }

    /// The nearest of the planned poses; without a plan, or past its end, the one with the most
    /// information now.
    pub(super) fn next(&mut self, here: &StaticState) -> Option<(usize, StaticState)> {
        if let Some(at) = nearest(here, &self.route) {
            return Some(self.route.swap_remove(at));
        }
        let at = |k: usize| self.all.get(k).map(|candidate| candidate.pose.position_m);
        let like = |k, other| {
            at(k)
                .zip(at(other))
                .is_none_or(|(a, b)| (a - b).norm() < LIKE_IT_M)
        };
        let free = |k| k >= self.done && !self.given_up.iter().any(|&other| like(k, other));
        let (k, _) = self.design.best(free)?;
        if self.given_up.len() > GIVEN_UP_MAX {
            return self.hang(k);
        }
        let taken = self.design.taken().len();
        self.design.take(k);
        self.refine(taken);
        let k = self.design.taken().last().copied();
        self.design.release(taken);
        self.hang(k?)
    }

    /// A pose has been measured.
    pub(super) fn measured(&mut self, k: usize) {
        self.design.take(k);
    }

    /// A pose failed.
    pub(super) fn give_up(&mut self, k: usize) {
        self.given_up.push(k);
    }

    /// Expected root mean square position error with the measurements so far, m.
    pub(super) fn expected_error_m(&self) -> f64 {
        self.design.expected_error_m().unwrap_or(f64::NAN)
    }
}

/// The pose of the route that is reached first.
fn nearest(here: &StaticState, route: &[(usize, StaticState)]) -> Option<usize> {
    let far = |rest: &StaticState| {
        let pairs = rest.paid_out_m.iter().zip(&here.paid_out_m);
        // All drums move at once: the longest way of a cable decides.
        pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    };
    let distances = route.iter().map(|(_, rest)| far(rest)).enumerate();
    let least = distances.min_by(|a, b| a.1.total_cmp(&b.1));
    least.map(|(at, _)| at)
}
