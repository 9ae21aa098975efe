//! Choice of poses: out of many that the mechanism can reach, those that leave the least expected
//! position error (I-optimal design; Atkinson, Donev and Tobias, 2007): one after another, each the
//! best addition, then exchanged one by one as long as that helps (Fedorov, 1972).

use super::check::Usable;
use super::data::{Data, Observation, View, compose, inverse};
use super::joint::{Options, model, start};
use super::normal::{Normal, Scaled};
use super::predict::{Prediction, predict};
use super::rows::Model;
use super::simulate::{Dice, random_equilibrium, views_at};
use super::unknowns::{Layout, State};
use mcdpr_kinematics::{Cable, Platform, Pose, Robot};
use nalgebra::DMatrix;

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

/// A choice of poses.
#[derive(Debug, Clone)]
pub struct Plan {
    /// The poses, those first that are worth most.
    pub chosen: Vec<Candidate>,
    /// Expected root mean square position error after each of them, m.
    pub expected_error_m: Vec<f64>,
    /// What would be worth most after them, for poses that turn out not to be reached or to see no
    /// tag.
    pub spare: Vec<Candidate>,
}

/// Reachable poses of the nominal robot with tags in view, at random.
///
/// `None` unless the robot has four cables.
#[must_use]
pub fn candidates(data: &Data, count: usize, seed: u64) -> Option<Vec<Candidate>> {
    let robot = nominal(data)?;
    let mut dice = Dice::new(seed);
    let mut out = Vec::with_capacity(count);
    // Where no tag is ever in view, the search must end.
    for _ in 0..count * 200 {
        if out.len() == count {
            break;
        }
        if let Some((pose, tensions_n, held)) = random_equilibrium(&robot, &mut dice) {
            let views = views_at(
                &data.camera,
                &data.tags,
                &data.world_from_body,
                &data.camera_from_platform,
                &pose,
                1.0,
            );
            if !views.is_empty() {
                out.push(Candidate {
                    pose,
                    tensions_n: tensions_n.to_vec(),
                    held,
                    views,
                });
            }
        }
    }
    Some(out)
}

/// Where the robot will work: reachable poses of the nominal robot at random, tags in view or not.
///
/// `None` unless the robot has four cables.
#[must_use]
pub fn work_poses(data: &Data, count: usize, seed: u64) -> Option<Vec<Pose>> {
    let robot = nominal(data)?;
    let mut dice = Dice::new(seed ^ 0x776F_726B);
    let mut out = Vec::with_capacity(count);
    for _ in 0..count * 200 {
        if out.len() == count {
            break;
        }
        out.extend(random_equilibrium(&robot, &mut dice).map(|(pose, ..)| pose));
    }
    Some(out)
}

fn nominal(data: &Data) -> Option<Robot<4>> {
    let cables = <[Cable; 4]>::try_from(data.robot.cables.clone()).ok()?;
    let platform = Platform {
        mass_kg: data.robot.mass_kg,
        center_of_mass_m: data.robot.center_of_mass_m,
        inertia_kg_m2: None,
    };
    Robot::new(cables, platform).ok()
}

/// The information of every candidate, what has been taken of it, and what it is wanted for.
#[derive(Debug, Clone)]
pub struct Design {
    informations: Vec<DMatrix<f64>>,
    /// Mean over the working poses of the squared position error per covariance of the unknowns.
    loss: DMatrix<f64>,
    sum: DMatrix<f64>,
    taken: Vec<usize>,
}

impl Design {
    /// Prepares a choice among `all` for the robot, camera, tags and noise of `data` (its poses are
    /// not read), to be accurate at `work`. `None` where an information can not be computed.
    #[must_use]
    pub fn new(data: &Data, all: &[Candidate], work: &[Pose], options: &Options) -> Option<Self> {
        let mut single = data.clone();
        single.at_rest = true;
        let mut informations = Vec::with_capacity(all.len());
        let mut prior: Option<DMatrix<f64>> = None;
        let mut frame: Option<(Layout, State)> = None;
        for candidate in all {
            single.poses = vec![Observation {
                encoder_m: vec![Some(0.0); data.cable_count()],
                tension_n: Some(candidate.tensions_n.clone()),
                views: candidate.views.clone(),
                noise_factor: 1.0,
            }];
            let usable = Usable {
                data: single.clone(),
                number: vec![0],
                start: vec![candidate.pose],
                warnings: Vec::new(),
            };
            let model: Model<'_> = model(&usable, options);
            let state = start(&usable, &model.layout);
            let normal = Normal::at(&model, &options.priors, &state, &Vec::new())?;
            let mut information = normal.reduced(0.0)?.information;
            let priors = state.priors(&usable.data, &model.layout, &options.priors);
            prior.get_or_insert_with(|| {
                let mut matrix = DMatrix::zeros(model.layout.len(), model.layout.len());
                for p in &priors {
                    matrix[(p.index, p.index)] = 1.0 / (p.sigma * p.sigma);
                }
                // What has no prior is known to metres and radians at worst.
                for j in 0..matrix.nrows() {
                    matrix[(j, j)] += 1.0;
                }
                matrix
            });
            for p in &priors {
                information[(p.index, p.index)] -= 1.0 / (p.sigma * p.sigma);
            }
            informations.push(information);
            frame.get_or_insert((model.layout, state));
        }
        let (layout, state) = frame?;
        let tag_from_world = inverse(&data.world_from_body[0]);
        let mut loss = DMatrix::zeros(layout.len(), layout.len());
        let mean = vec![0.0; data.cable_count()];
        let mut tests = 0.0;
        let none = DMatrix::zeros(layout.len(), layout.len());
        for pose in work {
            let at = compose(&tag_from_world, pose);
            let found: Prediction = predict(&state, &layout, &none, &mean, &at).ok()?;
            loss += found.position_slopes.tr_mul(&found.position_slopes);
            tests += 1.0;
        }
        loss /= f64::max(tests, 1.0);
        Some(Self {
            informations,
            loss,
            sum: prior?,
            taken: Vec::new(),
        })
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

    /// Takes a candidate: its measurement is or will be there.
    pub fn take(&mut self, k: usize) {
        self.sum += &self.informations[k];
        self.taken.push(k);
    }

    /// Forgets all that was taken but the first `keep`.
    pub fn release(&mut self, keep: usize) {
        for k in self.taken.split_off(keep.min(self.taken.len())) {
            self.sum -= &self.informations[k];
        }
    }

    /// The best addition for which `allowed` holds, with the expected error after it, m.
    #[must_use]
    pub fn best(&self, allowed: impl Fn(usize) -> bool) -> Option<(usize, f64)> {
        let covariance = Scaled::new(&self.sum)?.inverse();
        let before = covariance.component_mul(&self.loss).sum();
        let slope = &covariance * &self.loss * &covariance;
        // What an addition gains is at most its first-order gain, so that most need no closer look.
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

    /// Replaces taken candidates one by one where another is worth more, but for the first `keep`.
    pub fn exchange(&mut self, keep: usize) {
        const ROUNDS: usize = 6;
        for _ in 0..ROUNDS {
            let mut changed = false;
            for place in keep..self.taken.len() {
                let old = self.taken[place];
                self.sum -= &self.informations[old];
                // The slot is free for any, the old one included.
                self.taken[place] = usize::MAX;
                let next = self.best(|_| true).map_or(old, |(k, _)| k);
                self.sum += &self.informations[next];
                self.taken[place] = next;
                changed |= next != old;
            }
            if !changed {
                break;
            }
        }
    }
}

/// Chooses `count` of the candidates for the robot, camera, tags and noise of `data` (its poses are
/// not read), to be accurate at `work`. `None` where the candidates are too few or the information
/// can not be computed.
#[must_use]
pub fn choose(
    data: &Data,
    all: &[Candidate],
    work: &[Pose],
    count: usize,
    options: &Options,
) -> Option<Plan> {
    if all.len() < count || count == 0 {
        return None;
    }
    let mut design = Design::new(data, all, work, options)?;
    let empty = design.sum.clone();
    for _ in 0..count {
        let (k, _) = design.best(|_| true)?;
        design.take(k);
    }
    design.exchange(0);
    // In the order of their worth.
    let chosen = std::mem::take(&mut design.taken);
    design.sum = empty;
    let mut out = Plan {
        chosen: Vec::new(),
        expected_error_m: Vec::new(),
        spare: Vec::new(),
    };
    for _ in 0..count {
        let (k, expected) = design.best(|k| chosen.contains(&k))?;
        design.take(k);
        out.chosen.push(all[k].clone());
        out.expected_error_m.push(expected);
    }
    for _ in 0..count.div_ceil(2) {
        let Some((k, _)) = design.best(|k| !chosen.contains(&k)) else {
            break;
        };
        design.take(k);
        out.spare.push(all[k].clone());
    }
    Some(out)
}
