//! A robot in a plane whose anchors are not quite in it: one that was calibrated.
//!
//! Its lengths place it in the plane of its description, and turn it there. Across that plane nothing but the tensions
//! brings it back: where it hangs there, and how it leans, follows from statics, and no length changes it. So a place is
//! asked for in the plane, and the tool is where the robot hangs, up to some millimetres beside it.

use super::model::{Model, StaticState};
use super::plan::PlanError;
use crate::holding::Freedom;
use mcdpr_kinematics::{CableVec, Error, GRAVITY_MPS2, Pose, Solver};
use nalgebra::{DMatrix, DVector, Rotation3, UnitQuaternion, Vector3, Vector6};

/// Most steps to where the robot hangs.
const MOST_STEPS: usize = 30;
/// It hangs there when a step is shorter than this, m (and rad).
const THERE_M: f64 = 1e-10;
/// Step of the differences by which forces are linearised, m (and rad).
const DIFFERENCE: f64 = 1e-6;
/// One step moves and leans it by at most this, m (and rad).
const LONGEST_STEP: f64 = 0.02;
/// A place further than this beside the plane is meant for another robot, m: four times what anchors are off.
const BESIDE_M: f64 = 0.02;
/// As [`BESIDE_M`], of a plane that is one.
const IN_PLANE_M: f64 = 1e-6;

/// The vertical plane that a robot is asked to move in.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Plane {
    /// Unit normal, world.
    normal: Vector3<f64>,
    /// Distance of the world's origin from the plane of the anchors, along the normal, m.
    at_m: f64,
    /// Whether the robot's anchors are beside it.
    bent: bool,
}

impl Plane {
    /// That of a robot whose description has anchors in a plane; `anchor_m` is one of them.
    pub(super) fn of(freedom: &Freedom, anchor_m: &Vector3<f64>, bent: bool) -> Option<Self> {
        let normal = freedom.normal()?;
        Some(Self {
            normal,
            at_m: normal.dot(anchor_m),
            bent,
        })
    }
}

impl Model {
    /// Unit normal of the plane in which the robot moves beside which it hangs; `None` if it hangs in it, or has none.
    pub(super) fn beside(&self) -> Option<Vector3<f64>> {
        self.plane().filter(|plane| plane.bent).map(|p| p.normal)
    }

    /// A place of the platform's origin (world, m), brought into the plane in which the robot moves, if it has one.
    #[must_use]
    pub(crate) fn in_plane(&self, at_m: &Vector3<f64>) -> Vector3<f64> {
        self.plane().map_or(*at_m, |plane| {
            at_m - plane.normal * (plane.normal.dot(at_m) - plane.at_m)
        })
    }

    /// The tool's place (world, m) as a place that is asked for: of a robot that hangs beside its plane, in it.
    #[must_use]
    pub fn asked(&self, tool_m: &Vector3<f64>) -> Vector3<f64> {
        if self.beside().is_none() {
            return *tool_m;
        }
        let tool = &self.robot().tool.tcp_in_platform_m;
        self.in_plane(&(tool_m - tool)) + tool
    }

    /// How far a place of the platform's origin is beside the plane, if that is too far, m.
    pub(super) fn off_plane_m(&self, at_m: &Vector3<f64>) -> Option<f64> {
        let plane = self.plane()?;
        let off_m = (at_m - self.in_plane(at_m)).norm();
        let most_m = if plane.bent { BESIDE_M } else { IN_PLANE_M };
        // A place that is no number is in no plane.
        (off_m.is_nan() || off_m > most_m).then_some(off_m)
    }

    /// Where a robot hangs that is asked to a pose in its plane, under the tensions that `pulled` gives it there. Of any
    /// other robot the pose itself.
    ///
    /// # Errors
    /// [`Error::NotConverged`], and those of `pulled`.
    pub(super) fn hung(
        &self,
        asked: &Pose,
        pulled: impl Fn(&Pose) -> Result<CableVec<f64>, Error>,
    ) -> Result<(Pose, CableVec<f64>), Error> {
        let Some(normal) = self.beside() else {
            return Ok((*asked, pulled(asked)?));
        };
        let tool = &self.robot().tool.tcp_in_platform_m;
        let tool_m = asked.transform(tool);
        let turn = about(&asked.rotation, &normal);
        let free = self.across(&normal);
        // Beside the plane by the first, leaning by the others.
        let at = |by: &DVector<f64>| {
            let sum = |part: usize| {
                let pairs = free.iter().zip(by.iter());
                pairs.fold(Vector3::zeros(), |sum: Vector3<f64>, (twist, by)| {
                    sum + twist.fixed_rows::<3>(3 * part) * *by
                })
            };
            let rotation = Rotation3::new(sum(1)) * turn;
            let in_plane_m = self.in_plane(&(tool_m - tool)) + tool;
            Pose::new(in_plane_m + sum(0) - rotation * tool, rotation)
        };
        let mut by = DVector::zeros(free.len());
        for _ in 0..MOST_STEPS {
            let pose = at(&by);
            let tensions_n = pulled(&pose)?;
            let off = self.unbalanced(&pose, &tensions_n, &free)?;
            let mut slopes = DMatrix::zeros(free.len(), free.len());
            for k in 0..free.len() {
                let mut moved = by.clone();
                moved[k] += DIFFERENCE;
                let there = self.unbalanced(&at(&moved), &tensions_n, &free)?;
                slopes.set_column(k, &((there - &off) / DIFFERENCE));
            }
            let Some(step) = slopes.lu().solve(&off) else {
                break;
            };
            let size = step.norm();
            by -= step * (LONGEST_STEP / size.max(LONGEST_STEP));
            if size < THERE_M {
                let pose = at(&by);
                let tensions_n = pulled(&pose)?;
                return Ok((pose, tensions_n));
            }
        }
        Err(Error::NotConverged {
            solver: Solver::Pose,
            iterations: MOST_STEPS,
            residual: by.norm(),
        })
    }

    /// Where a robot in a plane hangs that its lengths place in it as `pose` (world_from_platform) has it, under measured
    /// tensions (at the winches, N; those of a plan, where one is missing or says that its cable is slack), beside the unit
    /// normal of its plane (world). `None` for a robot that moves in space.
    ///
    /// # Errors
    /// [`PlanError::NoEquilibrium`] where it hangs nowhere near.
    pub(crate) fn hangs_near(
        &self,
        pose: &Pose,
        readings_n: &[f64],
    ) -> Result<Option<(Vector3<f64>, StaticState)>, PlanError> {
        let Some(normal) = self.plane().map(|plane| plane.normal) else {
            return Ok(None);
        };
        let tool = &self.robot().tool.tcp_in_platform_m;
        let tool_m = self.in_plane(&(pose.transform(tool) - tool)) + tool;
        let asked = self.pose_of(&tool_m, &about(&pose.rotation, &normal));
        let Some(tensions_n) = self.pulling_n(readings_n) else {
            return Ok(Some((normal, self.rest_at_pose(&asked)?)));
        };
        let hung = self.hung(&asked, |_| Ok(tensions_n));
        let rest = hung.and_then(|(pose, tensions_n)| self.posed(&pose, tensions_n));
        let rest = rest.map_err(|source| PlanError::NoEquilibrium {
            x_mm: tool_m.x * 1e3,
            y_mm: tool_m.y * 1e3,
            z_mm: tool_m.z * 1e3,
            source,
        })?;
        Ok(Some((normal, rest)))
    }

    /// The twists that no length holds: across the plane, then the leanings. A load on one point hangs level.
    fn across(&self, normal: &Vector3<f64>) -> Vec<Vector6<f64>> {
        let mut free = vec![Vector6::new(normal.x, normal.y, normal.z, 0.0, 0.0, 0.0)];
        if self.holding().freedom().turns() {
            for axis in [normal.cross(&Vector3::z()), Vector3::z()] {
                free.push(Vector6::new(0.0, 0.0, 0.0, axis.x, axis.y, axis.z));
            }
        }
        free
    }

    /// Forces (N) and moments (N m, about the platform's origin) along twists that weight and tensions leave.
    fn unbalanced(
        &self,
        pose: &Pose,
        tensions_n: &CableVec<f64>,
        free: &[Vector6<f64>],
    ) -> Result<DVector<f64>, Error> {
        let rows = self.geometry().twist_jacobian(pose)?;
        let platform = self.geometry().platform();
        let weight = Vector3::z() * (-GRAVITY_MPS2 * platform.mass_kg);
        let moment = (pose.rotation * platform.center_of_mass_m).cross(&weight);
        let mut wrench = Vector6::new(weight.x, weight.y, weight.z, moment.x, moment.y, moment.z);
        for (row, tension_n) in rows.iter().zip(tensions_n.iter()) {
            // A row is the direction in which its cable gets longer; it pulls the other way.
            for (slot, part) in wrench.iter_mut().zip(row.iter()) {
                *slot -= part * tension_n;
            }
        }
        Ok(DVector::from_iterator(
            free.len(),
            free.iter().map(|twist| twist.dot(&wrench)),
        ))
    }
}

/// The part of a rotation about an axis: what is left leans the axis only.
fn about(rotation: &Rotation3<f64>, axis: &Vector3<f64>) -> Rotation3<f64> {
    let whole = UnitQuaternion::from_rotation_matrix(rotation);
    let angle = 2.0 * libm::atan2(whole.imag().dot(axis), whole.scalar());
    Rotation3::new(axis * angle)
}
