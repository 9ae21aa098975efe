//! How far the tool moves for each error of the machine, at one time of a plan.

use super::balance::{Balance, put};
use super::belief::{AtHome, Errors, PER_CABLE};
use super::drives::Motion;
use crate::estimate::region::tool_per_pose;
use crate::motion::{Model, StaticState};
use crate::robot::TensionOutput;
use mcdpr_kinematics::{CablePath, GRAVITY_MPS2, Pose};
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

/// A smaller gain of a law counts as this, mm/s per N.
const LEAST_GAIN: f64 = 1e-3;
/// Displacement for numerical derivatives of the cables' directions, m.
const STEP_M: f64 = 1e-6;
/// A pulley's radius among the errors of a cable.
const RADIUS: usize = 13;
/// Loss at a pulley, the same.
const LOSS: usize = 14;

/// Change of a cable's length per radius of its pulley: the arc grows by the wrap angle, the straight part gets shorter by
/// its sine.
fn longer_by_radius(path: &CablePath) -> f64 {
    path.wrap_rad - libm::sin(path.wrap_rad)
}

/// The robot at one time of a plan.
pub(super) struct Instant<'a> {
    pub(super) model: &'a Model,
    pub(super) errors: Errors,
    pub(super) rest: &'a StaticState,
    /// Where the lengths were taken.
    pub(super) home: Option<&'a AtHome>,
    pub(super) home_m: f64,
    /// Whether lengths and what else changes slowly are tracked.
    pub(super) tracked: bool,
    /// Dahl's friction of each pulley: 1 hauled in, -1 paid out.
    pub(super) rubbed: &'a [f64],
    pub(super) motion: &'a Motion,
}

impl Instant<'_> {
    /// Slopes of the tool (3 x errors), and its covariance by an inexact home, m2.
    pub(super) fn slopes(&self) -> Option<(DMatrix<f64>, Matrix3<f64>)> {
        let robot = self.model.robot();
        let arm = self.rest.equilibrium.pose.rotation * robot.tool.tcp_in_platform_m;
        let tool = DMatrix::from_fn(6, 3, |row, axis| tool_per_pose(&arm)[(axis, row)]);
        let (slopes, at_home) = self.slopes_of(&tool)?;
        Some((slopes, Matrix3::from_fn(|i, j| at_home[(i, j)])))
    }

    /// Slopes of the platform's origin (m) and of its rotation (rad, about the world's axes), 6 x errors, and the
    /// covariance by an inexact home.
    pub(super) fn slopes_of_platform(&self) -> Option<(DMatrix<f64>, DMatrix<f64>)> {
        self.slopes_of(&DMatrix::identity(6, 6))
    }

    /// Slopes (k x errors) of k values, given by their change per shift and turn of the platform (6 x k).
    fn slopes_of(&self, per_pose: &DMatrix<f64>) -> Option<(DMatrix<f64>, DMatrix<f64>)> {
        let robot = self.model.robot();
        let geometry = self.model.geometry();
        let count = self.errors.cables;
        let pose = &self.rest.equilibrium.pose;
        let paths = geometry.paths(pose).ok()?;
        let mut turning = vec![Matrix3::zeros(); count];
        for axis in 0..3 {
            let mut by = Vector3::zeros();
            by[axis] = STEP_M;
            let moved = geometry
                .paths(&pose.displaced(&by, &Vector3::zeros()))
                .ok()?;
            for (turn, (to, from)) in turning.iter_mut().zip(moved.iter().zip(paths.iter())) {
                turn.set_column(axis, &((to.direction - from.direction) / STEP_M));
            }
        }
        let balance = Balance {
            robot,
            pose,
            tensions_n: self.rest.tensions_n(),
            paths: &paths,
            turning: &turning,
        };
        let rows = count + 6;
        let by_length = self.model.holding().by_length();
        let mut matrix = DMatrix::zeros(rows, rows);
        for k in 0..6 {
            let mut twist = [Vector3::zeros(); 2];
            twist[k / 3][k % 3] = 1.0;
            let mut column = vec![0.0; rows];
            for &i in by_length {
                let path = paths.get(i)?;
                let arm = path.attachment_m - pose.position_m;
                column[i] = path.direction.dot(&(twist[0] + twist[1].cross(&arm)));
            }
            balance.moved(&twist[0], &twist[1], column.get_mut(count..)?);
            matrix.set_column(k, &DVector::from_vec(column));
        }
        for i in 0..count {
            let mut column = vec![0.0; rows];
            let cable = robot.cables.get(i)?;
            column[i] = if by_length.contains(&i) {
                -(self.rest.paid_out_m.get(i)? + cable.routing_length_m) / cable.ea_n
            } else {
                1.0
            };
            balance.pulled(i, 1.0, column.get_mut(count..)?);
            matrix.set_column(6 + i, &DVector::from_vec(column));
        }
        // Per pose, and through the transposed system per residual.
        let values = per_pose.ncols();
        let mut wanted = DMatrix::zeros(rows, values);
        wanted.view_mut((0, 0), (6, values)).copy_from(per_pose);
        let adjoint = matrix.transpose().lu().solve(&wanted)?;
        if adjoint.iter().any(|value| !value.is_finite()) {
            return None;
        }
        let mut slopes = DMatrix::zeros(values, self.errors.count());
        for k in 0..self.errors.count() {
            let residual = DVector::from_vec(self.residual(k, &balance, by_length)?);
            slopes.set_column(k, &-(adjoint.transpose() * residual));
        }
        let mut at_home = DMatrix::zeros(values, values);
        // Tracked lengths contain what the place at home was off.
        if let Some((home, _)) = self.home.filter(|_| !self.tracked) {
            for axis in 0..3 {
                let mut residual = DVector::zeros(rows);
                for &i in by_length {
                    residual[i] = -home.get(i)?.direction[axis] * self.home_m;
                }
                let by = adjoint.transpose() * residual;
                at_home += &by * by.transpose();
            }
        }
        Some((slopes, at_home))
    }

    /// What one error of size 1 leaves in the equations: lengths or tensions of the cables, then forces
    /// and moments.
    fn residual(
        &self,
        error: usize,
        balance: &Balance<'_>,
        by_length: &[usize],
    ) -> Option<Vec<f64>> {
        let errors = self.errors;
        let robot = balance.robot;
        let mut out = vec![0.0; errors.cables + 6];
        let (cables, forces) = out.split_at_mut(errors.cables);
        if error < errors.shared() {
            let i = error / PER_CABLE;
            self.cable_residual(
                i,
                error % PER_CABLE,
                balance,
                by_length.contains(&i),
                cables,
            )?;
            let kind = error % PER_CABLE;
            if kind < 3 {
                balance.reanchored(i, &geometric(balance.pose, kind), forces);
            } else if kind < 6 {
                balance.reattached(i, &geometric(balance.pose, kind), forces);
            } else if kind == RADIUS {
                balance.turned(i, &self.turned_by_radius(i, balance.paths.get(i)?)?, forces);
            }
            return Some(out);
        }
        let pose = balance.pose;
        let center = pose.rotation * robot.platform.center_of_mass_m;
        let unit = |axis: usize| Vector3::from_fn(|k, _| if k == axis { 1.0 } else { 0.0 });
        let down = Vector3::new(0.0, 0.0, -GRAVITY_MPS2);
        let mass_kg = robot.platform.mass_kg;
        match error - errors.shared() {
            0 => put(forces, &down, &center.cross(&down)),
            axis @ 1..=3 => {
                let shift = pose.rotation * unit(axis - 1);
                put(forces, &Vector3::zeros(), &shift.cross(&(down * mass_kg)));
            }
            4 => {
                let tool = pose.rotation * robot.tool.tcp_in_platform_m;
                put(forces, &down, &tool.cross(&down));
            }
            axis @ 5..=7 => put(forces, &unit(axis - 5), &center.cross(&unit(axis - 5))),
            axis @ 8..=10 => put(forces, &Vector3::zeros(), &unit(axis - 8)),
            _ => {
                for i in 0..errors.cables {
                    *cables.get_mut(i)? = if by_length.contains(&i) {
                        *self.motion.untrimmed_mps.get(i)?
                    } else {
                        self.late_pull_n(i)?
                    };
                }
            }
        }
        Some(out)
    }

    /// The part of a cable's own error in its length or tension.
    fn cable_residual(
        &self,
        i: usize,
        kind: usize,
        balance: &Balance<'_>,
        by_length: bool,
        cables: &mut [f64],
    ) -> Option<()> {
        let cable = balance.robot.cables.get(i)?;
        let tension_n = *balance.tensions_n.get(i)?;
        if !by_length {
            *cables.get_mut(i)? = match kind {
                9 => tension_n,
                10 => 1.0,
                11 => self.late_pull_n(i)?,
                // The sensor sits before the pulley: hauling in, the platform feels less.
                LOSS => tension_n * self.rubbed.get(i).copied().unwrap_or(0.0),
                _ => 0.0,
            };
            return Some(());
        }
        let paid_out_m = *self.rest.paid_out_m.get(i)?;
        let path = balance.paths.get(i)?;
        let home = self.home;
        let home = home.filter(|_| !(self.tracked && self.errors.is_tracked(kind)));
        let at_home = home.and_then(|(paths, rest)| {
            let tension = *rest.tensions_n().get(i)?;
            Some((paths.get(i)?, rest, tension, *rest.paid_out_m.get(i)?))
        });
        let at_rest = tension_n / cable.ea_n;
        let value = match kind {
            0..=5 => {
                let sign = if kind < 3 { -1.0 } else { 1.0 };
                let here = path.direction.dot(&geometric(balance.pose, kind)) * sign;
                // Lengths taken at home contain the error that the geometry has there.
                let there = at_home.map_or(0.0, |(home, rest, ..)| {
                    let shift = geometric(&rest.equilibrium.pose, kind);
                    home.direction.dot(&shift) * sign
                });
                here - there
            }
            6 => -1.0,
            7 => -(paid_out_m - at_home.map_or(self.zeroed_m(i), |(.., home_m)| home_m)),
            8 => {
                let here = -(paid_out_m + cable.routing_length_m) * at_rest;
                let there = at_home.map_or(0.0, |(_, _, tension, home_m)| {
                    -(home_m + cable.routing_length_m) * tension / cable.ea_n
                });
                here - there
            }
            11 => *self.motion.unled_mps.get(i)?,
            12 => -(paid_out_m + cable.routing_length_m),
            // Before the pulley the cable is pulled more by what rubs there, and stretched more, while it is hauled in.
            LOSS => {
                let rubbed = self.rubbed.get(i).copied().unwrap_or(0.0);
                -cable.routing_length_m * at_rest * rubbed
            }
            RADIUS => {
                let there = at_home.map_or(0.0, |(home, ..)| longer_by_radius(home));
                longer_by_radius(path) - there
            }
            _ => 0.0,
        };
        *cables.get_mut(i)? = value;
        Some(())
    }

    /// By how much a tension-held cable pulls less than it should for each second that its drum is late, N/s: a law that
    /// commands a speed gives way to an error of tension in proportion.
    fn late_pull_n(&self, cable: usize) -> Option<f64> {
        let law = &self.model.robot().tension;
        let acceleration_mps2 = *self.motion.length_mps2.get(cable)?;
        Some(match law.output {
            // Gains in mm/s per N.
            TensionOutput::Velocity => -acceleration_mps2 * 1e3 / law.kp.max(LEAST_GAIN),
            // The inertia of a drum whose current is commanded is fed forward.
            TensionOutput::Current => 0.0,
        })
    }

    /// Change of a cable's direction per radius of its pulley, 1/m, its attachment in place.
    ///
    /// With the swivel axis a, the direction t and the wrap angle w, the normal of the straight part in the pulley's plane is
    /// n = (t cos w - a) / sin w. The attachment stays, so that t turns by n (1 - cos w) / (free length).
    fn turned_by_radius(&self, cable: usize, path: &CablePath) -> Option<Vector3<f64>> {
        let axis = self.model.geometry().cables().get(cable)?.swivel_axis;
        let (sin, cos) = libm::sincos(path.wrap_rad);
        let free_m = (path.attachment_m - path.tangent_point_m).norm();
        if sin.abs() < 1e-9 || free_m <= 0.0 {
            // Along the axis: without a wrap the radius turns nothing.
            return Some(Vector3::zeros());
        }
        Some((path.direction * cos - axis) * ((1.0 - cos) / sin / free_m))
    }

    /// Paid-out length where the encoder was zeroed, m.
    fn zeroed_m(&self, cable: usize) -> f64 {
        let calibrated = self.model.robot().calibrated.as_deref();
        let home = calibrated.and_then(|known| known.home_lengths_m.get(cable).copied());
        home.unwrap_or(0.0)
    }
}

/// A unit error of an anchor (kinds 0 to 2, world) or an attachment (3 to 5, platform's frame), world.
fn geometric(pose: &Pose, kind: usize) -> Vector3<f64> {
    let mut unit = Vector3::zeros();
    unit[kind % 3] = 1.0;
    if kind < 3 { unit } else { pose.rotation * unit }
}
