//! The paper's estimator (its Section 4), kept for comparison: differenced start (Eqs. 24-26),
//! A X = Y B (Eqs. 27-39), Levenberg-Marquardt on Eq. 44.
//!
//! Its weights are constants instead of the ratio of variances, so that it is biased towards the
//! nominal anchors even without noise; and it takes a picture as an exact pose.

use super::answer::{Answer, Rank};
use super::check::{Usable, usable};
use super::data::Data;
use super::error::Refusal;
use super::hand_eye;
use super::lengths::singles;
pub use super::lengths::{AnchorTerm, Estimate, Problem, Weights};
use super::pnp::{angle, sightings};
use mcdpr_kinematics::{Error, Pose};
use nalgebra::{DMatrix, DVector, Vector3};

/// Calibrates with the paper's estimator, body 0 being its tag.
///
/// # Errors
/// [`Refusal`] with the reason.
pub fn paper(data: &Data, weights: &Weights) -> Result<Answer, Refusal> {
    let usable = usable(data)?;
    let (problem, poses, mut warnings) = tag_poses(&usable);
    if poses.len() < super::check::POSES_MIN {
        return Err(Refusal::TooFewPoses {
            got: poses.len(),
            total: data.poses.len(),
            needed: super::check::POSES_MIN,
            note: " (the paper's method uses poses with body 0 in the picture)".to_owned(),
        });
    }
    let (fitted, rank) = differenced(&problem, &poses)?;
    warnings.push(format!(
        "the differenced start (Eqs. 24-26) has rank {} for {} unknowns: it only corrects \
         the poses of the pictures",
        rank.rank, rank.unknowns
    ));
    let pairs: Vec<_> = problem
        .camera_from_tag
        .iter()
        .zip(&fitted)
        // B is the inverse of the platform's pose, X that of the tag's (docs/paper-notes.md).
        .map(|(a, pose)| (*a, pose.inverse()))
        .collect();
    let (world_from_tag, camera_from_platform) = match hand_eye::solve(&pairs) {
        Some((x, y)) => (x.inverse(), y),
        None => {
            warnings
                .push("A X = Y B is not determined by these poses: nominal start used".to_owned());
            (data.world_from_body[0], data.camera_from_platform)
        }
    };
    let mut start = Estimate {
        cables: problem.nominal.clone(),
        initial_length_m: Vec::new(),
        world_from_tag,
        camera_from_platform,
    };
    start.initial_length_m = mean_initial(&problem, &start)?;
    let fitted = problem.solve(&start, weights)?;
    let (found, iterations) = (fitted.estimate, fitted.steps);
    warnings.push(
        match weights.term {
            AnchorTerm::Millimetres => format!(
                "Eq. 44 with lambda_1 = {}, lambda_2 = {}, lengths and anchors in mm: biased towards \
                 nominal anchors; no covariance; use the joint method",
                weights.lengths, weights.anchors
            ),
            AnchorTerm::SquaredMetres => format!(
                "Eq. 44 with lambda_1 = {}, lambda_2 = {}, lengths in m, anchors in m^2; no covariance; \
                 use the joint method",
                weights.lengths, weights.anchors
            ),
        },
    );
    answer(data, weights, &problem, &found, iterations, rank, warnings)
}

#[allow(clippy::too_many_arguments)]
fn answer(
    data: &Data,
    weights: &Weights,
    problem: &Problem,
    found: &Estimate,
    iterations: usize,
    differenced_rank: Rank,
    warnings: Vec<String>,
) -> Result<Answer, Refusal> {
    let mut lengths_only = *weights;
    // The rank of the data: the anchors' term would determine every direction by itself.
    lengths_only.anchors = 0.0;
    let linear = problem
        .linear(found, &lengths_only)
        .ok_or_else(|| Refusal::NotConverged {
            what: "the estimate is outside the robot's domain".to_owned(),
        })?;
    let eigen = linear.matrix().symmetric_eigenvalues();
    let rank = eigen.iter().filter(|v| **v > 1e-9 * eigen.amax()).count();
    let cables = singles(&found.cables).map_err(|error| Refusal::NotConverged {
        what: error.to_string(),
    })?;
    let mut holdout_encoder_m = Vec::new();
    for (i, tag_from_platform) in data.holdout.iter().enumerate() {
        let pose = found.world_from_tag.compose(tag_from_platform);
        let mut readings = Vec::new();
        for (cable, initial) in cables.iter().zip(&found.initial_length_m) {
            let [length] = cable.lengths_m(&pose).map_err(|error| {
                Refusal::field(format!("holdout_H_tag_platform[{i}]"), error.to_string())
            })?;
            readings.push(length - initial);
        }
        holdout_encoder_m.push(readings);
    }
    let rows = problem.encoder_m.iter().flatten().flatten().count();
    // The cost is in mm times lambda_1: the noise in the same unit makes it a chi-square.
    let sigma = data.noise.encoder_m * 1e3 * weights.lengths;
    Ok(Answer {
        method: "paper",
        cables: found.cables.clone(),
        initial_length_m: found.initial_length_m.clone(),
        world_from_body: vec![found.world_from_tag],
        camera_from_platform: found.camera_from_platform,
        further: None,
        holdout_encoder_m,
        holdout_covariance_m2: Vec::new(),
        chi_square: Some(linear.cost / (sigma * sigma)),
        degrees_of_freedom: Some(rows as f64 - rank as f64),
        rank,
        core_unknowns: eigen.len(),
        differenced_rank: Some(differenced_rank),
        unobservable: Vec::new(),
        rejected_stretch: None,
        rejected: Vec::new(),
        tension_scatter_relative: None,
        unexplained: None,
        warnings,
        predicted_error_m: f64::NAN,
        worst_predicted_error_m: f64::NAN,
        iterations,
        covariance: None,
        solved: None,
        map: Vec::new(),
        next: None,
        split: None,
    })
}

/// Poses with body 0 in the picture, and of each picture's two readings the one near the start.
pub(super) fn tag_poses(usable: &Usable) -> (Problem, Vec<Pose>, Vec<String>) {
    let data = &usable.data;
    let mut problem = Problem {
        nominal: data.robot.cables.clone(),
        encoder_m: Vec::new(),
        camera_from_tag: Vec::new(),
    };
    let (mut poses, mut warnings) = (Vec::new(), usable.warnings.clone());
    for (k, (seen, start)) in data.poses.iter().zip(&usable.start).enumerate() {
        let expected = data
            .camera_from_platform
            .compose(&start.inverse())
            .compose(&data.world_from_body[0]);
        let candidates = sightings(data, seen, 0);
        // Of the two mirror images the one near the start: noise may make the wrong one fit better.
        let nearest = candidates.iter().min_by(|a, b| {
            let off =
                |s: &super::pnp::Sighting| angle(&s.camera_from_body.rotation, &expected.rotation);
            off(a).total_cmp(&off(b))
        });
        let Some(sighting) = nearest else {
            warnings.push(format!(
                "pose {}: body 0 is not seen; left out",
                usable.number[k] + 1
            ));
            continue;
        };
        problem.encoder_m.push(seen.encoder_m.clone());
        problem.camera_from_tag.push(sighting.camera_from_body);
        poses.push(
            data.world_from_body[0]
                .compose(&sighting.camera_from_body.inverse())
                .compose(&data.camera_from_platform),
        );
    }
    (problem, poses, warnings)
}

/// Eqs. 24-26: poses whose length differences fit the encoders', nominal anchors held. All pairwise
/// differences of one cable are equivalent to the deviations from their mean, which are used here.
/// Rank-deficient by itself (at most one equation less than poses per cable, six unknowns per pose),
/// so that the smallest correction of the given poses is taken. Returns the poses and the rank.
fn differenced(problem: &Problem, start: &[Pose]) -> Result<(Vec<Pose>, Rank), Refusal> {
    let cables = singles(&problem.nominal).map_err(|error| Refusal::NotConverged {
        what: error.to_string(),
    })?;
    let unsolved = |what: String| Refusal::NotConverged { what };
    // 0.1 m makes angles and lengths comparable.
    let lever = 0.1;
    let (n, count) = (cables.len(), start.len());
    let mut poses = start.to_vec();
    let mut rank = 0;
    for _ in 0..4 {
        let mut jacobian = DMatrix::zeros(n * count, 6 * count);
        let mut residual = DVector::zeros(n * count);
        for (i, cable) in cables.iter().enumerate() {
            let (mut sum, mut present) = (0.0, Vec::new());
            for (k, pose) in poses.iter().enumerate() {
                let Some(reading) = problem.encoder_m[k][i] else {
                    continue;
                };
                let inv = cable.inverse(pose).map_err(|error| {
                    unsolved(format!("pose {}, cable {}: {error}", k + 1, i + 1))
                })?;
                let row = inv.twist_row(0);
                let at = i * count + k;
                residual[at] = inv.lengths_m[0] - reading;
                for j in 0..6 {
                    jacobian[(at, 6 * k + j)] = if j < 3 { row[j] } else { row[j] / lever };
                }
                sum += residual[at];
                present.push(at);
            }
            let m = present.len().max(1) as f64;
            let mean_row = present
                .iter()
                .fold(nalgebra::RowDVector::zeros(6 * count), |a, &at| {
                    a + jacobian.row(at)
                })
                / m;
            for &at in &present {
                residual[at] -= sum / m;
                let centred = jacobian.row(at) - &mean_row;
                jacobian.set_row(at, &centred);
            }
        }
        let svd = jacobian.svd(true, true);
        let limit = 1e-9 * svd.singular_values.amax();
        rank = svd.singular_values.iter().filter(|s| **s > limit).count();
        let step = svd
            // Weak directions are cut off: there the pictures know the poses better than the
            // differences.
            .solve(&-&residual, 1e-4 * svd.singular_values.amax())
            .map_err(|what| unsolved(what.to_owned()))?;
        for (k, pose) in poses.iter_mut().enumerate() {
            let at = |j: usize| step[6 * k + j];
            *pose = pose.displaced(
                &Vector3::new(at(0), at(1), at(2)),
                &(Vector3::new(at(3), at(4), at(5)) / lever),
            );
        }
        if step.amax() < 1e-7 {
            break;
        }
    }
    let unknowns = 6 * count;
    Ok((poses, Rank { rank, unknowns }))
}

fn mean_initial(problem: &Problem, at: &Estimate) -> Result<Vec<f64>, Refusal> {
    let outside = |error: Error| Refusal::NotConverged {
        what: error.to_string(),
    };
    let cables = singles(&at.cables).map_err(outside)?;
    let mut out = Vec::new();
    for (i, cable) in cables.iter().enumerate() {
        let (mut sum, mut count) = (0.0, 0.0_f64);
        for (k, readings) in problem.encoder_m.iter().enumerate() {
            if let Some(reading) = readings[i] {
                let [length] = cable.lengths_m(&problem.platform(at, k)).map_err(outside)?;
                sum += length - reading;
                count += 1.0;
            }
        }
        out.push(sum / count.max(1.0));
    }
    Ok(out)
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::simulate::{Setup, Target, simulate};
    use super::super::study::errors;
    use super::*;

    /// Eight poses and the truth, except for nominal anchors.
    pub(in super::super) fn case() -> (Problem, Estimate) {
        let setup = Setup {
            poses: 8,
            ..Setup::default()
        };
        let (data, truth) = simulate(&setup).unwrap();
        let usable = usable(&data).unwrap();
        let (problem, ..) = tag_poses(&usable);
        let estimate = Estimate {
            cables: problem.nominal.clone(),
            initial_length_m: truth.initial_length_m.to_vec(),
            world_from_tag: truth.world_from_body[0],
            camera_from_platform: truth.camera_from_platform,
        };
        (problem, estimate)
    }

    #[test]
    fn pictures_that_fit_the_start_exactly_are_read_as_they_are() {
        // One of these has two readings; the right one differs only by rounding.
        let setup = Setup {
            target: Target::Tag,
            corner_px: 0.001,
            seed: 9,
            ..Setup::default()
        };
        let (data, truth) = simulate(&setup).unwrap();
        let answer = paper(&data, &Weights::default()).unwrap();
        let errors = errors(&truth, &answer.holdout_encoder_m, None).unwrap();
        assert!(errors.rms_m < 2e-3, "{}", errors.rms_m);
    }

    #[test]
    fn the_differenced_start_is_rank_deficient() {
        let (problem, estimate) = case();
        let poses: Vec<_> = (0..problem.encoder_m.len())
            .map(|k| problem.platform(&estimate, k))
            .collect();
        let (_, Rank { rank, unknowns }) = differenced(&problem, &poses).unwrap();
        assert_eq!(unknowns, 48);
        assert!(rank <= 4 * 7, "{rank}");
    }
}
