//! Choice of poses: out of many that the mechanism can reach, those that leave the least expected
//! position error (I-optimal design; Atkinson, Donev and Tobias, 2007), one after another.

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
    pub tensions_n: [f64; 4],
    /// The cable (from 0) whose tension is held; the others' lengths are.
    pub held: usize,
    /// The tags wholly in view.
    pub views: Vec<View>,
}

/// A choice of poses.
#[derive(Debug, Clone)]
pub struct Plan {
    /// The poses in the order in which they were chosen: the first ones are worth most.
    pub chosen: Vec<Candidate>,
    /// Expected root mean square position error after each of them, m.
    pub expected_error_m: Vec<f64>,
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
                    tensions_n,
                    held,
                    views,
                });
            }
        }
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

/// Chooses `count` of the candidates for the robot, camera, tags and noise of `data` (its poses are
/// not read). `None` where the candidates are too few or the information can not be computed.
#[must_use]
pub fn choose(data: &Data, all: &[Candidate], count: usize, options: &Options) -> Option<Plan> {
    if all.len() < count || count == 0 {
        return None;
    }
    let mut single = data.clone();
    single.at_rest = true;
    let mut informations = Vec::with_capacity(all.len());
    let mut prior: Option<DMatrix<f64>> = None;
    let mut frame: Option<(Layout, State)> = None;
    for candidate in all {
        single.poses = vec![Observation {
            encoder_m: vec![Some(0.0); 4],
            tension_n: Some(candidate.tensions_n.to_vec()),
            views: candidate.views.clone(),
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
    // Where the robot will work: a sample of what it can reach.
    let tag_from_world = inverse(&data.world_from_body[0]);
    let mut loss = DMatrix::zeros(layout.len(), layout.len());
    let step = all.len().div_ceil(40);
    let mean = vec![0.0; 4];
    let mut tests = 0.0;
    for candidate in all.iter().step_by(step) {
        let at = compose(&tag_from_world, &candidate.pose);
        let none = DMatrix::zeros(layout.len(), layout.len());
        let found: Prediction = predict(&state, &layout, &none, &mean, &at).ok()?;
        loss += found.position_slopes.tr_mul(&found.position_slopes);
        tests += 1.0;
    }
    loss /= tests;
    let mut sum = prior?;
    let mut free: Vec<usize> = (0..all.len()).collect();
    let mut out = Plan {
        chosen: Vec::new(),
        expected_error_m: Vec::new(),
    };
    for _ in 0..count {
        let mut best: Option<(usize, f64)> = None;
        for (place, &k) in free.iter().enumerate() {
            let covariance = Scaled::new(&(&sum + &informations[k]));
            let Some(covariance) = covariance else {
                continue;
            };
            let expected = covariance.inverse().component_mul(&loss).sum();
            if best.is_none_or(|(_, least)| expected < least) {
                best = Some((place, expected));
            }
        }
        let (place, expected) = best?;
        let k = free.swap_remove(place);
        sum += &informations[k];
        out.chosen.push(all[k].clone());
        out.expected_error_m.push(expected.max(0.0).sqrt());
    }
    Some(out)
}
