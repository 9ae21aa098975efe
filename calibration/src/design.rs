//! Selection of poses: the information of each candidate about the unknowns, and the subset with
//! the least expected position error (I-optimal design; Atkinson, Donev and Tobias, 2007).
//! Candidates are added one after another, each the best addition, then exchanged one by one as
//! long as that helps (Fedorov, 1972), then exchanged for others near them.

use super::check::Usable;
use super::data::{Data, Observation, View};
use super::fit::{Options, model, start};
use super::normal::{Normal, Scaled};
use super::predict::{Prediction, predict};
use super::rows::Model;
use super::tilt::Attitude;
use super::unknowns::{Layout, State};
use mcdpr_kinematics::{Pose, Robot};
use nalgebra::{DMatrix, Vector3};
use std::sync::Arc;

/// A question that is asked many times a second during a choice: whether to break it off. What is
/// chosen after that is worth nothing.
#[derive(Clone)]
pub struct Halt(Arc<dyn Fn() -> bool + Send + Sync>);

impl Halt {
    /// Breaks off once `asked` is true.
    pub fn when(asked: impl Fn() -> bool + Send + Sync + 'static) -> Self {
        Self(Arc::new(asked))
    }

    /// A choice that is not broken off.
    #[must_use]
    pub(crate) fn never() -> Self {
        Self::when(|| false)
    }

    /// Whether to break off.
    #[must_use]
    pub fn wanted(&self) -> bool {
        (self.0)()
    }
}

impl std::fmt::Debug for Halt {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("Halt").field(&self.wanted()).finish()
    }
}

/// A pose that the mechanism can reach, and how it is reached.
#[derive(Debug, Clone)]
pub struct Candidate {
    /// world_from_platform at equilibrium.
    pub pose: Pose,
    /// Tensions there, N.
    pub tensions_n: Vec<f64>,
    /// The cable (from 0) whose tension is held; the others' lengths are.
    pub held: usize,
    /// The tags wholly in view.
    pub views: Vec<View>,
}

/// Effort of the search for better candidates near those taken.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Search {
    /// Rounds, each nearer than the one before.
    pub rounds: usize,
    /// Tried near each taken one in each round.
    pub tried: usize,
    /// Distance of a round per distance of the one before.
    pub nearer: f64,
}

impl Search {
    /// For a robot that waits for the answer.
    pub const QUICK: Self = Self {
        rounds: 6,
        tried: 6,
        nearer: 0.65,
    };
    /// For plans made beforehand; takes some seconds.
    pub(crate) const THOROUGH: Self = Self {
        rounds: 30,
        tried: 10,
        nearer: 0.88,
    };
}

/// The information of every candidate, the sum over those taken, and the working poses.
#[derive(Debug, Clone)]
pub struct Design {
    informations: Vec<DMatrix<f64>>,
    /// Mean over the working poses of the squared position error per covariance of the unknowns.
    loss: DMatrix<f64>,
    sum: DMatrix<f64>,
    taken: Vec<usize>,
    halt: Halt,
}

impl Design {
    /// Prepares a choice among `all` for the robot, camera, tags and noise of `data` (its poses are
    /// not read), to be accurate at `work`. `None` where an information cannot be computed.
    #[must_use]
    pub fn new(data: &Data, all: &[Candidate], work: &[Pose], options: &Options) -> Option<Self> {
        Self::while_wanted(data, all, work, options, Halt::never())
    }

    /// As [`Design::new`], for a choice that may be broken off. `None` also if it was.
    #[must_use]
    pub fn while_wanted(
        data: &Data,
        all: &[Candidate],
        work: &[Pose],
        options: &Options,
        halt: Halt,
    ) -> Option<Self> {
        let (first, others) = all.split_first()?;
        let mut out = Self {
            informations: Vec::with_capacity(all.len()),
            loss: DMatrix::zeros(0, 0),
            sum: DMatrix::zeros(0, 0),
            taken: Vec::new(),
            halt,
        };
        let (layout, state) = out.learn(data, first, options)?;
        // An unknown without a prior is known to metres and radians at worst.
        out.sum = DMatrix::identity(layout.len(), layout.len());
        for p in state.priors(data, &layout, &options.priors) {
            out.sum[(p.index, p.index)] += 1.0 / (p.sigma * p.sigma);
        }
        for candidate in others {
            if out.halt.wanted() {
                return None;
            }
            out.learn(data, candidate, options)?;
        }
        let tag_from_world = data.world_from_body[0].inverse();
        let mut loss = DMatrix::zeros(layout.len(), layout.len());
        let mean = vec![0.0; data.cable_count()];
        let mut tests = 0.0;
        let none = DMatrix::zeros(layout.len(), layout.len());
        for pose in work {
            let at = tag_from_world.compose(pose);
            let found: Prediction = predict(&state, &layout, &none, &mean, &at).ok()?;
            loss += found.position_slopes.tr_mul(&found.position_slopes);
            tests += 1.0;
        }
        out.loss = loss / f64::max(tests, 1.0);
        Some(out)
    }

    /// Adds a candidate to choose from. `None` where its information cannot be computed.
    pub fn learn(
        &mut self,
        data: &Data,
        candidate: &Candidate,
        options: &Options,
    ) -> Option<(Layout, State)> {
        // Readings of encoders whose zero is at zero length: a drum's scale then affects the whole
        // length, as in the prediction.
        let cables = super::lengths::singles(&data.robot.cables).ok()?;
        let length_m = |cable: &Robot<1>| cable.lengths_m(&candidate.pose).ok().map(|[m]| Some(m));
        let encoder_m = cables.iter().map(length_m).collect::<Option<_>>()?;
        let single = Data {
            id: String::new(),
            robot: data.robot.clone(),
            tags: data.tags.clone(),
            world_from_body: data.world_from_body.clone(),
            poses: vec![Observation {
                encoder_m,
                tension_n: Some(candidate.tensions_n.clone()),
                views: candidate.views.clone(),
                tilt_rad: data.noise.tilt_rad.and_then(|_| {
                    let seen = Attitude::of(&candidate.pose, Vector3::zeros())?;
                    Some([seen.rpy_rad[0], seen.rpy_rad[1]])
                }),
                noise_factor: 1.0,
            }],
            at_rest: true,
            holdout: Vec::new(),
            origin: None,
            ..*data
        };
        let usable = Usable {
            data: single,
            number: vec![0],
            start: vec![candidate.pose],
            warnings: Vec::new(),
        };
        let model: Model<'_> = model(&usable, options);
        let state = start(&usable, &model.layout);
        let normal = Normal::at(&model, &options.priors, &state, &Vec::new())?;
        let mut information = normal.reduced(0.0)?.information;
        for p in state.priors(&usable.data, &model.layout, &options.priors) {
            // The priors count once, in the sum, and not again with every candidate.
            information[(p.index, p.index)] -= 1.0 / (p.sigma * p.sigma);
        }
        self.informations.push(information);
        Some((model.layout, state))
    }

    /// The candidates taken so far, in order.
    #[must_use]
    pub fn taken(&self) -> &[usize] {
        &self.taken
    }

    /// Expected root mean square position error with what is taken, m.
    #[must_use]
    pub fn expected_error_m(&self) -> Option<f64> {
        let covariance = Scaled::new(&self.sum)?.inverse();
        Some(covariance.component_mul(&self.loss).sum().max(0.0).sqrt())
    }

    /// Takes a candidate: it is or will be measured.
    pub fn take(&mut self, k: usize) {
        self.sum += &self.informations[k];
        self.taken.push(k);
    }

    /// Drops all that were taken but the first `keep`.
    pub fn release(&mut self, keep: usize) {
        for k in self.taken.split_off(keep.min(self.taken.len())) {
            self.sum -= &self.informations[k];
        }
    }

    /// The best addition for which `allowed` holds, with the expected error after it, m. `None` also if the
    /// choice is broken off.
    #[must_use]
    pub fn best(&self, allowed: impl Fn(usize) -> bool) -> Option<(usize, f64)> {
        if self.halt.wanted() {
            return None;
        }
        let covariance = Scaled::new(&self.sum)?.inverse();
        let before = covariance.component_mul(&self.loss).sum();
        let slope = &covariance * &self.loss * &covariance;
        // The gain of an addition is at most its first-order gain, so most need no exact
        // evaluation.
        let mut bounds: Vec<(usize, f64)> = (0..self.informations.len())
            .filter(|k| allowed(*k) && !self.taken.contains(k))
            .map(|k| (k, self.informations[k].component_mul(&slope).sum()))
            .collect();
        bounds.sort_by(|a, b| b.1.total_cmp(&a.1));
        let mut best: Option<(usize, f64)> = None;
        for (k, most) in bounds {
            if best.is_some_and(|(_, least)| before - most > least) {
                break;
            }
            let Some(after) = Scaled::new(&(&self.sum + &self.informations[k])) else {
                continue;
            };
            let expected = after.inverse().component_mul(&self.loss).sum();
            if best.is_none_or(|(_, least)| expected < least) {
                best = Some((k, expected));
            }
        }
        best.map(|(k, expected)| (k, expected.max(0.0).sqrt()))
    }

    /// Replaces taken candidates one by one if another is worth more, except for the first `keep`.
    pub fn exchange(&mut self, keep: usize) {
        self.exchange_with(keep, 0, 6);
    }

    /// As [`Design::exchange`], with candidates from `first` on only.
    fn exchange_with(&mut self, keep: usize, first: usize, rounds: usize) {
        for _ in 0..rounds {
            let mut changed = false;
            for place in keep..self.taken.len() {
                let old = self.taken[place];
                self.sum -= &self.informations[old];
                // Any candidate may fill the slot, including the old one.
                self.taken[place] = usize::MAX;
                let next = self
                    .best(|k| k >= first || k == old)
                    .map_or(old, |(k, _)| k);
                self.sum += &self.informations[next];
                self.taken[place] = next;
                changed |= next != old;
            }
            if !changed {
                break;
            }
        }
    }

    /// Replaces taken candidates, except for the first `keep`, by others near them if those are
    /// worth more: a few hundred random candidates are far apart from each other. `near` gives a
    /// candidate near another; the candidates tried are added to `all`, which are the candidates of
    /// this design.
    pub fn refine(
        &mut self,
        data: &Data,
        all: &mut Vec<Candidate>,
        options: &Options,
        keep: usize,
        search: Search,
        mut near: impl FnMut(&Candidate, f64) -> Option<Candidate>,
    ) {
        // Start at half of a distance that makes a difference.
        let mut size = 0.5;
        for _ in 0..search.rounds {
            let first = all.len();
            let taken = self.taken.clone();
            for &k in &taken[keep..] {
                for _ in 0..search.tried {
                    if self.halt.wanted() {
                        return;
                    }
                    let found = near(&all[k], size);
                    let Some(found) = found else { continue };
                    if self.learn(data, &found, options).is_some() {
                        all.push(found);
                    }
                }
            }
            self.exchange_with(keep, first, 2);
            size *= search.nearer;
        }
    }
}
