//! The robot where lengths hold its whole pose: the planner chooses the attitude, and the tensions are
//! distributed.

use super::allowance;
use super::model::{Model, StaticState, TAUT_N};
use super::plan::PlanError;
use crate::holding::Freedom;
use crate::robot::Control;
use mcdpr_kinematics::{Band, CableSet, CableVec, Equilibrium, Error, Pose, Solver};
use nalgebra::{DMatrix, DVector, Rotation3, Vector3};

/// A wished tension keeps this share of the range from both limits.
/// 0.7 N of a range of 35 N.
const WISH_SHARE: f64 = 0.02;
/// Most steps from home to the pose that fits measured lengths.
const MOST_STEPS: usize = 60;
/// One step moves the platform by at most this, m (and rad).
const LONGEST_STEP: f64 = 0.1;
/// Measured lengths fit a pose if they are off by no more than this, root mean square, m.
const FITS_M: f64 = 5e-3;
/// Passes between where lengths place a robot in its plane and where it hangs beside it.
const MOST_PASSES: usize = 20;
/// They end when a pass moves it by less than this, m.
const SETTLED_M: f64 = 1e-9;

impl Model {
    /// Whether the robot can be asked for an attitude (world_from_platform).
    ///
    /// # Errors
    /// Why not, in words.
    pub(super) fn takes_attitude(&self, attitude: &Rotation3<f64>) -> Result<(), &'static str> {
        match self.holding().freedom() {
            Freedom::Pose => Ok(()),
            // Only a turn about the plane's normal leaves the normal where it is.
            Freedom::Plane { normal } if (attitude * normal - normal).norm() < 1e-9 => Ok(()),
            Freedom::Plane { .. } => Err("this robot turns in the plane of its cables only"),
            Freedom::Hanging => Err("gravity decides the attitude of this robot"),
            Freedom::Point | Freedom::PlanePoint { .. } => {
                Err("this robot has none: its cables meet in one point")
            }
        }
    }

    /// The robot at rest with its tool at `tool_m` (world, m) and an attitude (world_from_platform). The
    /// tensions are those of [`mcdpr_kinematics::AnyRobot::centred_tensions`] about the set-point.
    ///
    /// # Errors
    /// [`PlanError::NoEquilibrium`] where no tensions within the limits hold it there,
    /// [`PlanError::OffPlane`].
    pub(super) fn rest_turned(
        &self,
        tool_m: &Vector3<f64>,
        attitude: &Rotation3<f64>,
    ) -> Result<StaticState, PlanError> {
        let pose = self.pose_of(tool_m, attitude);
        let (x_mm, y_mm, z_mm) = (tool_m.x * 1e3, tool_m.y * 1e3, tool_m.z * 1e3);
        if let Some(off_m) = self.off_plane_m(&pose.position_m) {
            return Err(PlanError::OffPlane {
                x_mm,
                y_mm,
                z_mm,
                off_mm: off_m * 1e3,
            });
        }
        let nowhere = |source| PlanError::NoEquilibrium {
            x_mm,
            y_mm,
            z_mm,
            source,
        };
        let hung = self.hung(&pose, |at| self.distributed(at));
        let (pose, tensions_n) = hung.map_err(nowhere)?;
        self.posed(&pose, tensions_n).map_err(nowhere)
    }

    /// The robot at rest at a pose (world_from_platform), tensions as where a plan asks for it. For a robot whose
    /// lengths hold its attitude.
    ///
    /// # Errors
    /// [`PlanError::NoEquilibrium`] where no tensions within the limits hold it there,
    /// [`PlanError::OffPlane`].
    pub fn rest_at_pose(&self, pose: &Pose) -> Result<StaticState, PlanError> {
        let tool_m = pose.transform(&self.robot().tool.tcp_in_platform_m);
        self.rest_turned(&tool_m, &pose.rotation)
    }

    /// The robot at rest at a pose under measured tensions (at the winches, N); those of a plan, where a cable's is
    /// missing or says that it is slack.
    ///
    /// # Errors
    /// As [`Model::rest_at_pose`].
    pub(crate) fn rest_measured(
        &self,
        pose: &Pose,
        readings_n: &[f64],
    ) -> Result<StaticState, PlanError> {
        let tensions_n = match self.pulling_n(readings_n) {
            Some(tensions_n) => tensions_n,
            // A pose beside a robot's plane cannot be asked for: those of where it hangs near it.
            None => match self.hangs_near(pose, &[])? {
                Some((_, rest)) => rest.equilibrium.tensions_n,
                None => return self.rest_at_pose(pose),
            },
        };
        let tool_m = pose.transform(&self.robot().tool.tcp_in_platform_m);
        self.posed(pose, tensions_n)
            .map_err(|source| PlanError::NoEquilibrium {
                x_mm: tool_m.x * 1e3,
                y_mm: tool_m.y * 1e3,
                z_mm: tool_m.z * 1e3,
                source,
            })
    }

    /// Tensions at the platform by readings at the winches, N; `None` where one is missing or says that its cable is slack.
    pub(super) fn pulling_n(&self, readings_n: &[f64]) -> Option<CableVec<f64>> {
        let count = self.robot().cables.len();
        let taut = readings_n.iter().all(|reading| *reading > TAUT_N);
        (readings_n.len() == count && taut).then(|| {
            CableVec::from_fn(count, |index| {
                let reading = readings_n.get(index).copied().unwrap_or(0.0);
                self.tension_n(index, reading)
            })
        })
    }

    /// Tensions that hold a pose.
    fn distributed(&self, pose: &Pose) -> Result<CableVec<f64>, Error> {
        let robot = self.robot();
        let count = robot.cables.len();
        let (mut min, mut max, mut wish) = (vec![0.0; count], vec![0.0; count], vec![0.0; count]);
        let slots = min.iter_mut().zip(&mut max).zip(&mut wish);
        for (index, (((low, high), wish), cable)) in slots.zip(&robot.cables).enumerate() {
            // Those of the board: the barrier itself keeps away from them.
            [*low, *high] = allowance::limits_n(robot, index);
            if cable.control == Control::Tension {
                *low = low.max(robot.tension.floor_n);
                *high = high.min(robot.tension.ceiling_n);
            }
            // A set-point at a limit is moved inside: the barrier needs room on both sides.
            let edge_n = WISH_SHARE * (*high - *low);
            *wish = robot
                .tension
                .setpoint_n
                .max(*low + edge_n)
                .min(*high - edge_n);
        }
        let band = Band {
            min_n: &min,
            max_n: &max,
            wish_n: &wish,
        };
        let twists = self.holding().freedom().twists();
        self.geometry().centred_tensions(pose, &twists, &band)
    }

    /// The state of a pose under tensions.
    pub(super) fn posed(
        &self,
        pose: &Pose,
        tensions_n: CableVec<f64>,
    ) -> Result<StaticState, Error> {
        let (robot, holding) = (self.robot(), self.holding());
        let lengths_m = self.geometry().lengths_m(pose)?;
        let mut tension_held = CableSet::default();
        for &cable in holding.by_tension() {
            tension_held.insert(cable);
        }
        // A winch that holds a tension gives way: its cable has no stiffness here.
        let axial = |index: usize| {
            let cable = robot.cables.get(index)?;
            let length_m = lengths_m.get(index)? + cable.routing_length_m;
            (cable.control == Control::Position).then_some(cable.ea_n / length_m)
        };
        let mut equilibrium = Equilibrium {
            pose: *pose,
            tensions_n,
            lengths_m,
            slack: CableSet::default(),
            tension_held,
            axial_stiffness_n_per_m: CableVec::from_fn(robot.cables.len(), |index| {
                axial(index).unwrap_or(0.0)
            }),
            residual_n: 0.0,
            residual_m: 0.0,
            iterations: 0,
            stable: false,
        };
        equilibrium.stable = self.keeps(&equilibrium)?;
        Ok(self.with_lengths(equilibrium))
    }

    /// Whether the platform stays: the lengths hold it, and the tensions bring it back to their plane.
    fn keeps(&self, equilibrium: &Equilibrium) -> Result<bool, Error> {
        if !self.holding().holds_at(self.geometry(), &equilibrium.pose) {
            return Ok(false);
        }
        let (Freedom::Plane { normal } | Freedom::PlanePoint { normal }) = self.holding().freedom()
        else {
            return Ok(true);
        };
        let stiffness = self.geometry().stability(equilibrium)?.stiffness;
        let across = stiffness.fixed_view::<3, 3>(0, 0) * normal;
        Ok(normal.dot(&across) > 0.0)
    }

    /// The robot at rest with these lengths paid out under these tensions: the pose that fits all of them
    /// best, from home on.
    ///
    /// # Errors
    /// [`PlanError::Lengths`] where none fits.
    pub(super) fn rest_fitting(
        &self,
        paid_out_m: &[f64],
        tensions_n: &[f64],
    ) -> Result<StaticState, PlanError> {
        let robot = self.robot();
        let taut_m: Vec<f64> = paid_out_m
            .iter()
            .zip(tensions_n)
            .enumerate()
            .map(|(index, (&paid_out, &reading))| {
                let tension = self.tension_n(index, reading).max(0.0);
                self.taut_m(index, paid_out, tension)
            })
            .collect();
        let lost = |source| PlanError::Lengths { source };
        let count = taut_m.len();
        // Where the tensions of a plan are impossible the measured ones stand.
        let pulled = |pose: &Pose| {
            Ok(self.distributed(pose).unwrap_or_else(|_| {
                CableVec::from_fn(count, |i| tensions_n.get(i).copied().unwrap_or(0.0))
            }))
        };
        let mut pose = self.pose_of(&robot.tool.home_in_world_m, &Rotation3::identity());
        for _ in 0..MOST_PASSES {
            let placed = self.placed_by(&taut_m, &pose).map_err(lost)?;
            let (hung, tensions) = self.hung(&placed, pulled).map_err(lost)?;
            let moved_m = (hung.position_m - pose.position_m).norm();
            pose = hung;
            // Lengths alone place a robot that does not hang beside its plane.
            if self.beside().is_none() || moved_m < SETTLED_M {
                return self.posed(&pose, tensions).map_err(lost);
            }
        }
        Err(lost(Error::NotConverged {
            solver: Solver::Pose,
            iterations: MOST_PASSES,
            residual: SETTLED_M,
        }))
    }

    /// The pose that fits taut lengths best, moved from another along the freedoms that lengths hold.
    fn placed_by(&self, taut_m: &[f64], from: &Pose) -> Result<Pose, Error> {
        let mut pose = *from;
        let twists = self.holding().freedom().twists();
        let count = taut_m.len();
        let (mut off_m, mut iterations) = (f64::INFINITY, 0);
        while iterations < MOST_STEPS {
            iterations += 1;
            let lengths_m = self.geometry().lengths_m(&pose)?;
            let rows = self.geometry().twist_jacobian(&pose)?;
            let wrong = DVector::from_iterator(
                count,
                taut_m
                    .iter()
                    .zip(&lengths_m)
                    .map(|(taut, here)| taut - here),
            );
            off_m = wrong.norm() / (count.max(1) as f64).sqrt();
            let slopes = DMatrix::from_fn(count, twists.len(), |cable, freedom| {
                let row = rows.get(cable).zip(twists.get(freedom));
                row.map_or(0.0, |(row, twist)| {
                    row.iter().zip(twist.iter()).map(|(a, b)| a * b).sum()
                })
            });
            let normal = slopes.transpose() * &slopes;
            let Some(step) = normal
                .cholesky()
                .map(|c| c.solve(&(slopes.transpose() * wrong)))
            else {
                break;
            };
            // Far from home the lengths are not linear: the whole step is shortened, its direction
            // kept.
            let share = (LONGEST_STEP / step.norm().max(1e-12)).min(1.0);
            let mut by = nalgebra::Vector6::zeros();
            for (weight, twist) in step.iter().zip(&twists) {
                by += twist * (*weight * share);
            }
            let shift = by.fixed_rows::<3>(0).into_owned();
            let turn = by.fixed_rows::<3>(3).into_owned();
            pose = pose.displaced(&shift, &turn);
            if step.norm() < 1e-10 {
                break;
            }
        }
        // Lengths that are not numbers fit nothing.
        if off_m.is_nan() || off_m > FITS_M {
            return Err(Error::NotConverged {
                solver: Solver::Pose,
                iterations,
                residual: off_m,
            });
        }
        Ok(pose)
    }
}
