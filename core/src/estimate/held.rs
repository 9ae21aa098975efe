//! The pose of a platform that lengths hold, from lengths and pictures. Measured tensions say how far each cable is
//! stretched. Statics say nothing of a pose that six lengths hold; of a platform in a plane they say where it hangs across
//! that plane, and how it leans, of which lengths say nothing.

use super::fix::{DAMPING, Estimate, EstimateError, LAST_STEP_M, LONGEST_STEP_M, no_fit};
use super::newton;
use super::rows::{self, Measurements, Sigmas};
use crate::motion::{Model, StaticState};
use mcdpr_kinematics::{Attempt, Pose, descend};
use nalgebra::{DMatrix, Rotation3, Vector3, Vector6};

/// The tool's position (m) and the attitude (rad).
const UNKNOWNS: usize = 6;
/// Step of the numerical derivatives, m and rad: 10 um are a thirtieth of a length's assumed error.
const CHANGE: f64 = 1e-5;
/// Rows by statics of a platform in a plane: across it, and two leans.
const BY_STATICS: usize = 3;

struct Problem<'a> {
    model: &'a Model,
    measured: &'a Measurements,
    sigmas: &'a Sigmas,
    /// The length of this cable counts as not measured.
    skip: Option<usize>,
}

#[derive(Clone)]
struct Fit {
    pose: Pose,
    residuals: Vec<f64>,
}

impl Fit {
    fn cost(&self) -> f64 {
        self.residuals.iter().map(|r| r * r).sum()
    }
}

type Linear = newton::Linear<UNKNOWNS>;

impl Problem<'_> {
    /// Rows over their standard deviation.
    fn at(&self, pose: Pose) -> Result<Fit, EstimateError> {
        let mut residuals = Vec::new();
        if !self.measured.lengths_m.is_empty() {
            let rest = self
                .model
                .rest_measured(&pose, &self.measured.tensions_n)
                .map_err(no_fit)?;
            let lengths = self.measured.lengths_m.iter().zip(&rest.paid_out_m);
            residuals.extend(lengths.map(|(seen, said)| (seen - said) / self.sigmas.length_m));
        }
        // Zero instead of removed: the other rows keep their places.
        if let Some(slot) = self.skip.and_then(|cable| residuals.get_mut(cable)) {
            *slot = 0.0;
        }
        rows::corners(self.model, self.measured, &pose, &mut residuals)
            .ok_or(EstimateError::Rank)?;
        if let Some((normal, rest)) = self.hanging(&pose)? {
            let tool = &self.model.robot().tool.tcp_in_platform_m;
            let across_m = normal.dot(&(self.model.tool_m(&rest) - pose.transform(tool)));
            let turned = off_statics(&pose, &rest);
            residuals.push(across_m / self.sigmas.across_m);
            let axes = [normal.cross(&Vector3::z()), Vector3::z()];
            residuals.extend(axes.map(|axis| -axis.dot(&turned) / self.sigmas.attitude_rad));
        }
        Ok(Fit { pose, residuals })
    }

    /// Where a platform in a plane hangs by statics, and the plane's normal; `None` for one that moves in space.
    fn hanging(&self, pose: &Pose) -> Result<Option<(Vector3<f64>, StaticState)>, EstimateError> {
        let found = self.model.hangs_near(pose, &self.measured.tensions_n);
        found.map_err(no_fit)
    }

    /// Moved by the tool's shift and turned about the tool.
    fn moved(&self, pose: &Pose, by: &Vector6<f64>) -> Pose {
        let tool = &self.model.robot().tool.tcp_in_platform_m;
        let shift: Vector3<f64> = by.fixed_rows::<3>(0).into_owned();
        let turn: Vector3<f64> = by.fixed_rows::<3>(3).into_owned();
        let turned = pose.displaced(&Vector3::zeros(), &turn);
        let position_m = pose.transform(tool) + shift - turned.rotation * tool;
        Pose::new(position_m, turned.rotation)
    }

    /// Derivatives of the rows by forward differences.
    fn linear(&self, fit: &Fit) -> Result<Linear, EstimateError> {
        let mut jacobian = DMatrix::zeros(fit.residuals.len(), UNKNOWNS);
        for column in 0..UNKNOWNS {
            let mut by = Vector6::zeros();
            by[column] = CHANGE;
            let near = self.at(self.moved(&fit.pose, &by))?;
            for (row, (new, old)) in near.residuals.iter().zip(&fit.residuals).enumerate() {
                jacobian[(row, column)] = (new - old) / CHANGE;
            }
        }
        Ok(Linear::of(&jacobian, &fit.residuals))
    }

    fn attempt(
        &self,
        fit: &Fit,
        linear: &Linear,
        damping: f64,
    ) -> Result<Attempt<Fit, Linear>, EstimateError> {
        let step = linear.step(damping)?;
        // All unknowns are shortened alike: the step keeps its direction.
        let size = step.norm();
        let step = step * (LONGEST_STEP_M / size.max(LONGEST_STEP_M));
        let next = self.at(self.moved(&fit.pose, &step));
        let better = next.ok().filter(|next| next.cost() <= fit.cost());
        newton::attempt(better, size < LAST_STEP_M, |next| self.linear(next))
    }
}

/// Turn of a pose from how statics have the platform hang: rotation vector, rad, world.
fn off_statics(pose: &Pose, rest: &StaticState) -> Vector3<f64> {
    let by_statics = &rest.equilibrium.pose.rotation;
    let turned: Rotation3<f64> = pose.rotation * by_statics.inverse();
    turned.scaled_axis()
}

/// The pose that fits best, from a start; `skip`: the length of this cable (from 0) is left out.
pub(super) fn solve(
    model: &Model,
    measured: &Measurements,
    sigmas: &Sigmas,
    start: Pose,
    skip: Option<usize>,
) -> Result<Estimate, EstimateError> {
    let problem = Problem {
        model,
        measured,
        sigmas,
        skip,
    };
    let first = problem.at(start)?;
    if first.residuals.iter().any(|r| !r.is_finite()) {
        return Err(EstimateError::NotFinite);
    }
    let rows = first.residuals.len() - usize::from(skip.is_some());
    if rows < UNKNOWNS {
        // Only the user's own values are reported.
        let by_statics = if model.plane().is_some() {
            BY_STATICS
        } else {
            0
        };
        return Err(EstimateError::Few {
            rows: rows - by_statics,
            needed: UNKNOWNS - by_statics,
        });
    }
    let linear = problem.linear(&first)?;
    // `descend` only reports that an attempt failed: the reason is kept here.
    let mut failure = EstimateError::Rank;
    let found = descend(first, linear, &DAMPING, |fit, linear, damping| {
        problem
            .attempt(fit, linear, damping)
            .map_err(|error| failure = error)
            .ok()
    });
    let Some(found) = found else {
        return Err(failure);
    };
    let covariance = found
        .linear
        .normal
        .try_inverse()
        .ok_or(EstimateError::Rank)?;
    let fit = found.at;
    let hanging = problem.hanging(&fit.pose)?;
    let (off_statics_rad, rest) = match hanging {
        Some((_, rest)) => (off_statics(&fit.pose, &rest), rest),
        None => {
            let rest = model.rest_measured(&fit.pose, &measured.tensions_n);
            (Vector3::zeros(), rest.map_err(no_fit)?)
        }
    };
    Ok(Estimate {
        tool_m: fit.pose.transform(&model.robot().tool.tcp_in_platform_m),
        rest,
        covariance_m2: covariance.fixed_view::<3, 3>(0, 0).into_owned(),
        rotation_covariance_rad2: covariance.fixed_view::<3, 3>(3, 3).into_owned(),
        off_statics_rad,
        chi2: fit.cost(),
        freedoms: rows - UNKNOWNS,
        residuals: fit.residuals,
    })
}

#[cfg(test)]
mod tests {
    use super::super::{estimate, find_slip};
    use super::*;
    use crate::robot::Robot;

    fn resting(model: &Model, pose: &Pose) -> Measurements {
        let rest = model.rest_at_pose(pose).unwrap();
        let tensions = rest.tensions_n().iter().enumerate();
        Measurements {
            lengths_m: rest.paid_out_m.clone(),
            tensions_n: tensions
                .map(|(cable, tension)| model.reading_n(cable, *tension))
                .collect(),
            ..Measurements::default()
        }
    }

    #[test]
    fn lengths_give_place_and_attitude_of_a_platform_of_six_degrees_of_freedom() {
        for (name, freedoms) in [("eight-cable", 2), ("eight-suspended", 2), ("six-cable", 0)] {
            let robot = Robot::built_in(name).unwrap();
            let model = Model::new(&robot).unwrap();
            let home_m = robot.tool.home_in_world_m;
            let attitude = Rotation3::from_euler_angles(0.06, -0.05, 0.08);
            let pose = Pose::new(home_m + Vector3::new(0.06, -0.04, 0.2), attitude);
            let measured = resting(&model, &pose);
            let found = estimate(&model, &measured, &Sigmas::default(), &home_m).unwrap();
            let off_m = found.tool_m - pose.transform(&robot.tool.tcp_in_platform_m);
            assert!(off_m.norm() < 1e-7, "{name}: {off_m}");
            let rotation = found.rest.equilibrium.pose.rotation;
            let turned = (rotation.matrix() - attitude.matrix()).norm();
            assert!(turned < 1e-7, "{name}: {turned}");
            assert_eq!(found.freedoms, freedoms, "{name}");
            // Of the order of the scatter of the lengths, 0.3 mm.
            let sigma_m = found.covariance_m2.diagonal().map(f64::sqrt);
            assert!(
                sigma_m.iter().all(|s| (5e-5..1e-3).contains(s)),
                "{name}: {sigma_m}"
            );
        }
    }

    #[test]
    fn lengths_place_a_platform_in_its_plane_and_statics_across_it() {
        let robot = Robot::built_in("planar-vertical").unwrap();
        let model = Model::new(&robot).unwrap();
        let home_m = robot.tool.home_in_world_m;
        let attitude = Rotation3::new(Vector3::y() * 0.05);
        let pose = Pose::new(home_m + Vector3::new(0.12, 0.0, 0.1), attitude);
        let all = resting(&model, &pose);
        for tensions_n in [all.tensions_n.clone(), Vec::new()] {
            let measured = Measurements {
                tensions_n,
                ..all.clone()
            };
            let sigmas = Sigmas::default();
            let found = estimate(&model, &measured, &sigmas, &home_m).unwrap();
            let off_m = found.tool_m - pose.transform(&robot.tool.tcp_in_platform_m);
            assert!(off_m.norm() < 1e-6, "{off_m}");
            assert!(found.off_statics_rad.norm() < 1e-6);
            let rotation = found.rest.equilibrium.pose.rotation;
            let turned = (rotation.matrix() - attitude.matrix()).norm();
            assert!(turned < 1e-6, "{turned}");
            // Four lengths and three rows of statics for six unknowns.
            assert_eq!(found.freedoms, 1);
            // Across the plane nothing but statics: their assumed error, and of lengths 0.3 mm.
            let sigma_m = found.covariance_m2.diagonal().map(f64::sqrt);
            assert!(
                (sigma_m.y / sigmas.across_m - 1.0).abs() < 0.02,
                "{sigma_m}"
            );
            assert!(sigma_m.x < 5e-4 && sigma_m.z < 5e-4, "{sigma_m}");
        }
        // The same lengths, one of them wrong: they contradict each other.
        let mut slipped = all.clone();
        slipped.lengths_m[0] += 3e-3;
        let found = estimate(&model, &slipped, &Sigmas::default(), &home_m).unwrap();
        assert!(found.redundancy().unwrap() > 3.0);
        let few = Measurements {
            lengths_m: all.lengths_m[..2].to_vec(),
            ..Measurements::default()
        };
        let error = estimate(&model, &few, &Sigmas::default(), &home_m).unwrap_err();
        assert!(error.to_string().contains("2 measured values"), "{error}");
        assert!(error.to_string().contains("3 are needed"), "{error}");
    }

    #[test]
    fn a_slip_of_a_robot_with_cables_to_spare_is_seen_and_too_few_lengths_are_refused() {
        let robot = Robot::built_in("eight-cable").unwrap();
        let model = Model::new(&robot).unwrap();
        let home_m = robot.tool.home_in_world_m;
        let pose = Pose::level(home_m - robot.tool.tcp_in_platform_m);
        let sigmas = Sigmas::default();
        let mut measured = resting(&model, &pose);
        measured.lengths_m[2] -= 0.01;
        let found = estimate(&model, &measured, &sigmas, &home_m).unwrap();
        assert!(found.redundancy().unwrap() > 3.0);
        let slip = find_slip(&model, &measured, &sigmas, &found).unwrap();
        let slip = slip.unwrap();
        // Eight cables leave two lengths over: at one pose another cable explains the slip nearly as well.
        assert_eq!((slip.cable, slip.clear), (3, false));
        assert!((slip.slip_m - 0.01).abs() < 1e-6, "{slip:?}");
        let few = Measurements {
            lengths_m: measured.lengths_m[..5].to_vec(),
            ..Measurements::default()
        };
        let error = estimate(&model, &few, &sigmas, &home_m).unwrap_err();
        assert!(error.to_string().contains("6 are needed"), "{error}");
    }
}
