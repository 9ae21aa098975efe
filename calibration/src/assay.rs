//! Further checks of an answer: whether a calibration from the upper poses is valid for the lower
//! ones, the expected position error over the work space, and the pose to measure next.

use super::answer::{Answer, MapPoint, NextPose, Split};
use super::check::POSES_MIN;
use super::data::Data;
use super::design::{Candidate, Design};
use super::fit::{Options, fit};
use super::plan::{candidates, work_poses};
use super::predict::{displacement, normal, predict};
use super::rows::singles;
use super::space::Space;
use mcdpr_kinematics::Pose;
use nalgebra::{Matrix3, Vector3};

/// Uncertainty of a measured pose itself, m: the picture's and the encoders' noise.
const FLOOR_M: f64 = 1e-4;

/// Trains on the upper half of the poses, with tags, drums and lens held to their stated values,
/// and tests on the lower half. A scale error is the same at all heights for a random split, but
/// shows here. `None` below 14 poses, or if the half cannot be solved.
#[must_use]
pub fn split(data: &Data, options: &Options, full: &Answer) -> Option<Split> {
    let solved = full.solved.as_ref()?;
    let tag_from_world = solved.state.world_from_body.first()?.inverse();
    let mut order: Vec<(usize, &Pose)> = solved
        .numbers
        .iter()
        .copied()
        .zip(&solved.state.poses)
        .collect();
    order.sort_by(|a, b| b.1.position_m.z.total_cmp(&a.1.position_m.z));
    let (upper, lower) = order.split_at(order.len().div_ceil(2));
    if lower.len() < POSES_MIN {
        return None;
    }
    let mut train = data.clone();
    train.poses = upper
        .iter()
        .filter_map(|(k, _)| data.poses.get(*k).cloned())
        .collect();
    train.holdout = lower
        .iter()
        .map(|(_, pose)| tag_from_world.compose(pose))
        .collect();
    let mut strict = *options;
    let priors = &mut strict.priors;
    for sigma in [
        &mut priors.tag,
        &mut priors.drum,
        &mut priors.focal,
        &mut priors.k1,
    ] {
        *sigma *= 0.1;
    }
    strict.closer_looks = false;
    let trained = fit(&train, &strict).ok()?;
    let cables = singles(&solved.state).ok()?;
    let (mut squares, mut expected, mut ratio, mut count) = (0.0, 0.0, 0.0, 0.0);
    for (i, (k, pose)) in lower.iter().enumerate() {
        let measured = &data.poses.get(*k)?.encoder_m;
        let predicted = trained.holdout_encoder_m.get(i)?;
        let wrong: Option<Vec<f64>> = measured
            .iter()
            .zip(predicted)
            .map(|(m, p)| m.map(|m| p - m))
            .collect();
        // Without all lengths the pose has no position to compare.
        let Some(wrong) = wrong else { continue };
        let (moved, _) = displacement(&cables, pose, &wrong).ok()?;
        let covariance =
            trained.holdout_covariance_m2.get(i)? + Matrix3::identity() * (FLOOR_M * FLOOR_M);
        squares += moved.norm_squared();
        expected += covariance.trace();
        // Three coordinates: the expected quotient is one.
        ratio += moved.dot(&(covariance.try_inverse()? * moved)) / 3.0;
        count += 1.0;
    }
    if count < 1.0 {
        return None;
    }
    Some(Split {
        upper: upper.len(),
        lower: lower.len(),
        error_m: f64::sqrt(squares / count),
        expected_m: f64::sqrt(expected / count),
        ratio: ratio / count,
        suspect: suspect(full, options)?,
    })
}

fn suspect(full: &Answer, options: &Options) -> Option<String> {
    let state = &full.solved.as_ref()?.state;
    let priors = &options.priors;
    let all = [
        (
            (state.tag_scale - 1.0) / priors.tag,
            "tags",
            (state.tag_scale - 1.0) * 100.0,
        ),
        (
            (state.drum_scale - 1.0) / priors.drum,
            "drums",
            (state.drum_scale - 1.0) * 100.0,
        ),
        (
            state.focal_scale / priors.focal,
            "focal length",
            state.focal_scale * 100.0,
        ),
    ];
    let worst = all
        .into_iter()
        .max_by(|a, b| a.0.abs().total_cmp(&b.0.abs()))?;
    Some(format!(
        "the {} come out {:+.2} % off what is stated, measure them again",
        worst.1, worst.2
    ))
}

/// Grid points of the map along x and y, and in height.
const MAP: [usize; 3] = [7, 7, 6];

/// The predicted error over the robot's space, see [`Space::of`].
#[must_use]
pub(crate) fn error_map(data: &Data, answer: &Answer) -> Vec<MapPoint> {
    let (Some(solved), Some(covariance)) = (&answer.solved, &answer.covariance) else {
        return Vec::new();
    };
    let Some(body) = solved.state.world_from_body.first() else {
        return Vec::new();
    };
    let [low, high] = Space::of(data).corners_m();
    let along = |k: usize, i: usize| low[k] + (high[k] - low[k]) * i as f64 / (MAP[k] - 1) as f64;
    let mut out = Vec::new();
    for iz in 0..MAP[2] {
        let z = along(2, MAP[2] - 1 - iz);
        for iy in 0..MAP[1] {
            for ix in 0..MAP[0] {
                let at_m = Vector3::new(along(0, ix), along(1, iy), z);
                let pose = body.inverse().compose(&Pose::level(at_m));
                let mean = &solved.mean_tension_n;
                if let Ok(found) = predict(&solved.state, &solved.layout, covariance, mean, &pose) {
                    let rms_m = found.position_covariance_m2.trace().max(0.0).sqrt();
                    out.push(MapPoint { at_m, rms_m });
                }
            }
        }
    }
    out
}

/// The pose of the robot's space that would help most. For robots that hang on four cables; `None` for
/// others.
#[must_use]
pub(crate) fn next_pose(data: &Data, answer: &Answer, options: &Options) -> Option<NextPose> {
    const CANDIDATES: usize = 150;
    let solved = answer.solved.as_ref()?;
    // A robot in a plane cannot be asked across it.
    if normal(solved.state.cables.iter()).is_some() {
        return None;
    }
    let mut known = data.clone();
    // Planned with the calibrated robot: the nominal one would hang elsewhere.
    known.robot.cables.clone_from(&solved.state.cables);
    known
        .world_from_body
        .clone_from(&solved.state.world_from_body);
    known.camera_from_platform = solved.state.camera_from_platform;
    let done: Vec<Candidate> = solved
        .numbers
        .iter()
        .zip(&solved.state.poses)
        .filter_map(|(k, pose)| {
            let seen = data.poses.get(*k)?;
            Some(Candidate {
                pose: *pose,
                tensions_n: seen.tension_n.clone()?,
                held: 0,
                views: seen.views.clone(),
            })
        })
        .collect();
    let space = Space::of(&known);
    let more = candidates(&known, &space, CANDIDATES, 1)?;
    let work = work_poses(&known, &space, 60, 1)?;
    let all: Vec<Candidate> = done.iter().chain(&more).cloned().collect();
    let mut design = Design::new(&known, &all, &work, options)?;
    for k in 0..done.len() {
        design.take(k);
    }
    let before = design.expected_error_m()?;
    let (k, after) = design.best(|k| k >= done.len())?;
    let best = all.get(k)?;
    Some(NextPose {
        pose: best.pose,
        held: best.held,
        tension_n: *best.tensions_n.get(best.held)?,
        expected_error_m: [before, after],
    })
}
