//! The paper's estimator (its Section 4), kept for comparison: differenced start (Eqs. 24-26),
//! A X = Y B (Eqs. 27-39), Levenberg-Marquardt on Eq. 44.
//!
//! Its weights are constants instead of the ratio of variances, so that it is biased towards the
//! nominal anchors even without noise; and a picture counts as an exact pose.

use super::answer::Answer;
use super::check::{Usable, usable};
use super::data::{Data, compose, inverse};
use super::error::Refusal;
use super::hand_eye;
use super::pnp::sightings;
use mcdpr_kinematics::{Cable, Error, Platform, Pose, Robot};
use nalgebra::{DMatrix, DVector, Vector3};

/// How the anchors' distance from nominal enters Eq. 44.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum AnchorTerm {
    /// Its coordinates in mm, like the lengths: a quadratic cost.
    #[default]
    Millimetres,
    /// Its square in m^2 beside lengths in m, as Eq. 41 is printed: a cost of fourth power, next to
    /// nothing for errors of millimetres.
    SquaredMetres,
}

/// Weights of Eq. 44.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Weights {
    /// lambda_1, on lengths.
    pub lengths: f64,
    /// lambda_2, on anchors.
    pub anchors: f64,
    /// Form and unit of the anchors' term.
    pub term: AnchorTerm,
}

impl Default for Weights {
    fn default() -> Self {
        Self {
            lengths: 5.0,
            anchors: 1.0,
            term: AnchorTerm::default(),
        }
    }
}

/// Lengths and tag poses: what Eq. 44 is made of.
#[derive(Debug, Clone)]
pub struct Problem {
    /// Nominal cables.
    pub nominal: Vec<Cable>,
    /// Encoder readings per pose, m.
    pub encoder_m: Vec<Vec<Option<f64>>>,
    /// camera_from_tag per pose.
    pub camera_from_tag: Vec<Pose>,
}

/// The unknowns of Eq. 44.
#[derive(Debug, Clone)]
pub struct Estimate {
    /// Cables with estimated anchors.
    pub cables: Vec<Cable>,
    /// Initial lengths, m.
    pub initial_length_m: Vec<f64>,
    /// world_from_tag.
    pub world_from_tag: Pose,
    /// camera_from_platform.
    pub camera_from_platform: Pose,
}

struct Linear {
    cost: f64,
    h: DMatrix<f64>,
    g: DVector<f64>,
}

fn singles(cables: &[Cable]) -> Result<Vec<Robot<1>>, Error> {
    let platform = Platform {
        mass_kg: 1.0,
        center_of_mass_m: Vector3::zeros(),
        inertia_kg_m2: None,
    };
    cables
        .iter()
        .map(|cable| Robot::new([*cable], platform))
        .collect()
}

impl Problem {
    fn platform(&self, at: &Estimate, k: usize) -> (Vector3<f64>, Pose) {
        // The camera's place in the platform gives the platform's in the world.
        let world_from_camera = compose(&at.world_from_tag, &inverse(&self.camera_from_tag[k]));
        (
            world_from_camera.position_m,
            compose(&world_from_camera, &at.camera_from_platform),
        )
    }

    /// Normal equations of Eq. 44, lengths in mm. `None` outside the domain.
    fn linear(&self, at: &Estimate, weights: &Weights, slopes: bool) -> Option<Linear> {
        let n = self.nominal.len();
        let size = 4 * n + 12;
        let cables = singles(&at.cables).ok()?;
        let mut out = Linear {
            cost: 0.0,
            h: if slopes {
                DMatrix::zeros(size, size)
            } else {
                DMatrix::zeros(0, 0)
            },
            g: DVector::zeros(size),
        };
        let per_m = 1e3 * weights.lengths;
        for (k, readings) in self.encoder_m.iter().enumerate() {
            let (_, pose) = self.platform(at, k);
            let world_from_camera = pose.rotation * at.camera_from_platform.rotation.inverse();
            let from_tag = pose.position_m - at.world_from_tag.position_m;
            for (i, cable) in cables.iter().enumerate() {
                let Some(reading) = readings[i] else { continue };
                let inv = cable.inverse(&pose).ok()?;
                let residual = (inv.lengths_m[0] - at.initial_length_m[i] - reading) * per_m;
                out.cost += residual * residual;
                if !slopes {
                    continue;
                }
                let t = inv.direction(0) * per_m;
                let arm = inv.arm_m(0);
                // Turning the camera (left, camera axes) turns platform points about the camera.
                let turn_tag = (from_tag + arm).cross(&t);
                let t_camera = world_from_camera.inverse_transform_vector(&t);
                let arm_camera = world_from_camera.inverse_transform_vector(&arm);
                let turn_camera = arm_camera.cross(&t_camera);
                let mut row = [(0usize, 0.0); 16];
                for j in 0..3 {
                    row[j] = (3 * i + j, -t[j]);
                    row[4 + j] = (4 * n + j, t[j]);
                    row[7 + j] = (4 * n + 3 + j, turn_tag[j]);
                    row[10 + j] = (4 * n + 6 + j, t_camera[j]);
                    row[13 + j] = (4 * n + 9 + j, turn_camera[j]);
                }
                row[3] = (3 * n + i, -per_m);
                for (p, &(a, x)) in row.iter().enumerate() {
                    out.g[a] += x * residual;
                    for &(b, y) in &row[..=p] {
                        // Within a row the indices grow.
                        out.h[(a, b)] += x * y;
                    }
                }
            }
        }
        for (i, (now, nominal)) in at.cables.iter().zip(&self.nominal).enumerate() {
            let off = now.anchor_m - nominal.anchor_m;
            match weights.term {
                AnchorTerm::Millimetres => {
                    let w = (1e3 * weights.anchors).powi(2);
                    out.cost += w * off.norm_squared();
                    if slopes {
                        for j in 0..3 {
                            out.h[(3 * i + j, 3 * i + j)] += w;
                            out.g[3 * i + j] += w * off[j];
                        }
                    }
                }
                AnchorTerm::SquaredMetres => {
                    // In m^2, but the other rows are in mm: both times 1000.
                    let w = (1e3 * weights.anchors).powi(2);
                    let residual = off.norm_squared();
                    out.cost += w * residual * residual;
                    if slopes {
                        for j in 0..3 {
                            out.g[3 * i + j] += w * 2.0 * off[j] * residual;
                            for m in 0..=j {
                                out.h[(3 * i + j, 3 * i + m)] += w * 4.0 * off[j] * off[m];
                            }
                        }
                    }
                }
            }
        }
        out.cost.is_finite().then_some(out)
    }

    /// Levenberg-Marquardt on Eq. 44. Returns the estimate, its cost (mm^2, weighted) and the steps.
    ///
    /// # Errors
    /// [`Refusal::NotConverged`].
    pub fn solve(
        &self,
        start: &Estimate,
        weights: &Weights,
    ) -> Result<(Estimate, f64, usize), Refusal> {
        let outside = || Refusal::NotConverged {
            what: "the start is outside the robot's domain".to_owned(),
        };
        let n = self.nominal.len();
        let mut at = start.clone();
        let mut now = self.linear(&at, weights, true).ok_or_else(outside)?;
        let mut damping = 1e-6;
        let mut steps = 0;
        while steps < 200 {
            steps += 1;
            let mut h = now.h.clone();
            for j in 0..h.nrows() {
                h[(j, j)] *= 1.0 + damping;
                // The literal fourth-power term has no curvature at nominal.
                h[(j, j)] += 1e-12;
            }
            let trial = nalgebra::Cholesky::new(h).and_then(|c| {
                let step = c.solve(&-&now.g);
                let three = |j: usize| Vector3::new(step[j], step[j + 1], step[j + 2]);
                let mut trial = at.clone();
                for i in 0..n {
                    trial.cables[i].anchor_m += three(3 * i);
                    trial.initial_length_m[i] += step[3 * n + i];
                }
                trial.world_from_tag = at
                    .world_from_tag
                    .displaced(&three(4 * n), &three(4 * n + 3));
                trial.camera_from_platform = at
                    .camera_from_platform
                    .displaced(&three(4 * n + 6), &three(4 * n + 9));
                let next = self.linear(&trial, weights, true)?;
                Some((trial, next))
            });
            match trial {
                Some((trial, next)) if next.cost <= now.cost => {
                    let done = now.cost - next.cost < 1e-9 * now.cost + 1e-12;
                    (at, now) = (trial, next);
                    damping = (damping * 0.1).max(1e-14);
                    if done {
                        break;
                    }
                }
                _ => {
                    damping *= 10.0;
                    if damping > 1e8 {
                        break;
                    }
                }
            }
        }
        Ok((at, now.cost, steps))
    }

    /// Largest difference of the gradient of Eq. 44 from finite differences, relative to its size:
    /// for tests.
    #[cfg(test)]
    fn slope_error(&self, at: &Estimate, weights: &Weights) -> f64 {
        let n = self.nominal.len();
        let g = self.linear(at, weights, true).unwrap().g;
        let mut worst = 0.0_f64;
        for j in 0..g.len() {
            let moved = |step: f64| {
                let mut v = DVector::<f64>::zeros(g.len());
                v[j] = step;
                let three = |j: usize| Vector3::new(v[j], v[j + 1], v[j + 2]);
                let mut out = at.clone();
                for i in 0..n {
                    out.cables[i].anchor_m += three(3 * i);
                    out.initial_length_m[i] += v[3 * n + i];
                }
                out.world_from_tag = at
                    .world_from_tag
                    .displaced(&three(4 * n), &three(4 * n + 3));
                out.camera_from_platform = at
                    .camera_from_platform
                    .displaced(&three(4 * n + 6), &three(4 * n + 9));
                self.linear(&out, weights, false).unwrap().cost
            };
            let slope = (moved(1e-6) - moved(-1e-6)) / 4e-6;
            worst = worst.max((slope - g[j]).abs() / (1.0 + g.amax()));
        }
        worst
    }
}

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
    let (fitted, rank, unknowns) = differenced(&problem, &poses)?;
    warnings.push(format!(
        "the differenced start (Eqs. 24-26) has rank {rank} for {unknowns} unknowns: it only corrects \
         the poses of the pictures"
    ));
    let pairs: Vec<_> = problem
        .camera_from_tag
        .iter()
        .zip(&fitted)
        .map(|(a, pose)| (*a, inverse(pose)))
        .collect();
    let (world_from_tag, camera_from_platform) = match hand_eye::solve(&pairs) {
        Some((x, y)) => (inverse(&x), y),
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
    let (found, _, iterations) = problem.solve(&start, weights)?;
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
    answer(
        data,
        weights,
        &problem,
        &found,
        iterations,
        (rank, unknowns),
        warnings,
    )
}

#[allow(clippy::too_many_arguments)]
fn answer(
    data: &Data,
    weights: &Weights,
    problem: &Problem,
    found: &Estimate,
    iterations: usize,
    differenced_rank: (usize, usize),
    warnings: Vec<String>,
) -> Result<Answer, Refusal> {
    let mut lengths_only = *weights;
    lengths_only.anchors = 0.0;
    let linear =
        problem
            .linear(found, &lengths_only, true)
            .ok_or_else(|| Refusal::NotConverged {
                what: "the estimate is outside the robot's domain".to_owned(),
            })?;
    let h = linear.h.clone() + linear.h.transpose() - DMatrix::from_diagonal(&linear.h.diagonal());
    let eigen = h.symmetric_eigenvalues();
    let rank = eigen.iter().filter(|v| **v > 1e-9 * eigen.amax()).count();
    let cables = singles(&found.cables).map_err(|error| Refusal::NotConverged {
        what: error.to_string(),
    })?;
    let mut holdout_encoder_m = Vec::new();
    for (i, tag_from_platform) in data.holdout.iter().enumerate() {
        let pose = compose(&found.world_from_tag, tag_from_platform);
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
        rejected: Vec::new(),
        tension_scatter_relative: None,
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
fn tag_poses(usable: &Usable) -> (Problem, Vec<Pose>, Vec<String>) {
    let data = &usable.data;
    let mut problem = Problem {
        nominal: data.robot.cables.clone(),
        encoder_m: Vec::new(),
        camera_from_tag: Vec::new(),
    };
    let (mut poses, mut warnings) = (Vec::new(), usable.warnings.clone());
    for (k, (seen, start)) in data.poses.iter().zip(&usable.start).enumerate() {
        let expected = compose(
            &compose(&data.camera_from_platform, &inverse(start)),
            &data.world_from_body[0],
        );
        let candidates = sightings(data, seen, 0);
        let nearest = candidates.iter().min_by(|a, b| {
            let off =
                |s: &super::pnp::Sighting| s.camera_from_body.rotation.angle_to(&expected.rotation);
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
        poses.push(compose(
            &compose(
                &data.world_from_body[0],
                &inverse(&sighting.camera_from_body),
            ),
            &data.camera_from_platform,
        ));
    }
    (problem, poses, warnings)
}

/// Eqs. 24-26: poses whose length differences fit the encoders', nominal anchors held. All pairwise
/// differences of one cable are equivalent to the deviations from their mean, which are used here.
/// Rank-deficient by itself (at most one equation less than poses per cable, six unknowns per pose),
/// so that the smallest correction of the given poses is taken. Returns poses, rank, unknowns.
fn differenced(problem: &Problem, start: &[Pose]) -> Result<(Vec<Pose>, usize, usize), Refusal> {
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
    Ok((poses, rank, 6 * count))
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
                let [length] = cable
                    .lengths_m(&problem.platform(at, k).1)
                    .map_err(outside)?;
                sum += length - reading;
                count += 1.0;
            }
        }
        out.push(sum / count.max(1.0));
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::super::simulate::{Setup, simulate};
    use super::*;

    fn case() -> (Problem, Estimate) {
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
    fn gradient_matches_differences() {
        let (problem, mut estimate) = case();
        estimate.cables[2].anchor_m.x += 3e-3;
        for term in [AnchorTerm::Millimetres, AnchorTerm::SquaredMetres] {
            let weights = Weights {
                term,
                ..Weights::default()
            };
            let error = problem.slope_error(&estimate, &weights);
            assert!(error < 1e-6, "{term:?}: {error:e}");
        }
    }

    #[test]
    fn the_differenced_start_is_rank_deficient() {
        let (problem, estimate) = case();
        let poses: Vec<_> = (0..problem.encoder_m.len())
            .map(|k| problem.platform(&estimate, k).1)
            .collect();
        let (_, rank, unknowns) = differenced(&problem, &poses).unwrap();
        assert_eq!(unknowns, 48);
        assert!(rank <= 4 * 7, "{rank}");
    }
}
