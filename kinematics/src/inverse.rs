//! Inverse kinematics with swivel pulleys (paper, Eqs. 2-11).
//!
//! For an attachment at d = A - B, a unit swivel axis a and a pulley radius r:
//! h = d.a, rho = |d - h a|, e = (d - h a)/rho, s^2 = |d|^2 - 2 r rho (the free length), and with
//! x = rho - r, D^2 = x^2 + h^2 the wrap angle theta has
//! sin theta = (s x + r h)/D^2 and cos theta = (s h - r x)/D^2.
//! This merges the two arc-tangents of the textbook form (Pott, 2012) into one, and gives the
//! direction t = sin(theta) e + cos(theta) a without any trigonometric function.

use nalgebra::{Matrix3, Rotation3, Vector3};

use crate::error::Error;
use crate::math::{angle_of, sqrt};
use crate::pose::Pose;
use crate::robot::{Lanes, Robot};

/// One cable at one pose.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CablePath {
    /// Length from the anchor to the attachment, arc included, m.
    pub length_m: f64,
    /// Angle wrapped on the pulley, rad, in [0, 2 pi).
    pub wrap_rad: f64,
    /// Where the cable leaves the pulley, world frame, m (the anchor itself for radius 0).
    pub tangent_point_m: Vector3<f64>,
    /// Unit vector from the tangent point to the attachment, world frame. The force of a tension
    /// T on the platform is `-T * direction`.
    pub direction: Vector3<f64>,
    /// Attachment, world frame, m.
    pub attachment_m: Vector3<f64>,
}

/// The geometry of all cables at one pose, component by component over the cables.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inverse<const N: usize> {
    /// Length of each cable from its anchor to its attachment, arc included, m.
    pub lengths_m: [f64; N],
    /// Wrap angle of each cable, rad, in [0, 2 pi).
    pub wraps_rad: [f64; N],
    /// x, y, z components (world) of the unit vectors from tangent point to attachment.
    pub directions: [[f64; N]; 3],
    /// x, y, z components (world) of the arms from the platform's origin to the attachments, m.
    pub arms_m: [[f64; N]; 3],
    /// x, y, z components (world) of the unit vectors from the swivel axis towards the attachment.
    pub swivel_directions: [[f64; N]; 3],
    /// Sine of the wrap angles.
    pub wrap_sin: [f64; N],
    /// Cosine of the wrap angles.
    pub wrap_cos: [f64; N],
    /// Length of the straight part of each cable, m.
    pub free_lengths_m: [f64; N],
    /// Distance of each attachment from the swivel axis, m.
    pub axis_distances_m: [f64; N],
}

#[inline(always)]
fn lane_vector<const N: usize>(lanes: &[[f64; N]; 3], cable: usize) -> Vector3<f64> {
    Vector3::new(lanes[0][cable], lanes[1][cable], lanes[2][cable])
}

impl<const N: usize> Inverse<N> {
    /// Unit vector (world) of one cable, zero-based, from tangent point to attachment.
    ///
    /// # Panics
    /// If `cable >= N`.
    #[inline(always)]
    pub fn direction(&self, cable: usize) -> Vector3<f64> {
        lane_vector(&self.directions, cable)
    }

    /// Arm (world, m) from the platform's origin to the attachment of one cable, zero-based.
    ///
    /// # Panics
    /// If `cable >= N`.
    #[inline(always)]
    pub fn arm_m(&self, cable: usize) -> Vector3<f64> {
        lane_vector(&self.arms_m, cable)
    }

    /// Unit vector (world) from the swivel axis towards the attachment of one cable, zero-based.
    ///
    /// # Panics
    /// If `cable >= N`.
    #[inline(always)]
    pub fn swivel_direction(&self, cable: usize) -> Vector3<f64> {
        lane_vector(&self.swivel_directions, cable)
    }
}

/// The closed form over all lanes; lanes outside the domain hold NaN or infinity.
#[inline(always)]
pub(crate) fn evaluate<const N: usize>(
    lanes: &Lanes<N>,
    position: &Vector3<f64>,
    rotation: &Matrix3<f64>,
) -> Inverse<N> {
    let att = &lanes.attachment;
    let mut arm = [[0.0; N]; 3];
    for k in 0..3 {
        let (r0, r1, r2) = (rotation[(k, 0)], rotation[(k, 1)], rotation[(k, 2)]);
        for i in 0..N {
            arm[k][i] = r0 * att[0][i] + r1 * att[1][i] + r2 * att[2][i];
        }
    }
    evaluate_arms(lanes, position, &arm)
}

/// As [`evaluate`], with the arms R A given.
#[inline(always)]
pub(crate) fn evaluate_arms<const N: usize>(
    lanes: &Lanes<N>,
    position: &Vector3<f64>,
    arms: &[[f64; N]; 3],
) -> Inverse<N> {
    let mut out = Inverse {
        lengths_m: [0.0; N],
        wraps_rad: [0.0; N],
        directions: [[0.0; N]; 3],
        arms_m: *arms,
        swivel_directions: [[0.0; N]; 3],
        wrap_sin: [0.0; N],
        wrap_cos: [0.0; N],
        free_lengths_m: [0.0; N],
        axis_distances_m: [0.0; N],
    };
    for i in 0..N {
        let [ax, ay, az] = [lanes.axis[0][i], lanes.axis[1][i], lanes.axis[2][i]];
        let dx = position.x + arms[0][i] - lanes.anchor[0][i];
        let dy = position.y + arms[1][i] - lanes.anchor[1][i];
        let dz = position.z + arms[2][i] - lanes.anchor[2][i];
        let h = dx * ax + dy * ay + dz * az;
        let (ex, ey, ez) = (dx - h * ax, dy - h * ay, dz - h * az);
        let rho2 = ex * ex + ey * ey + ez * ez;
        let rho = sqrt(rho2);
        let radius = lanes.radius[i];
        let x = rho - radius;
        // The tangent's square is negative inside the pulley: the NaN marks the lane as invalid.
        let s = sqrt(rho * (rho - 2.0 * radius) + h * h);
        let d2 = x * x + h * h;
        let sin = s * x + radius * h;
        let cos = s * h - radius * x;
        // s^2 + r^2 = D^2, so this unnormalised vector has the norm D^2 and needs no second root.
        let wrap = angle_of(sin, cos, d2);
        // One division serves both quotients: it is the slowest operation of this loop.
        let inv = 1.0 / (rho * d2);
        let (inv_d2, inv_rho) = (inv * rho, inv * d2);
        let (sin, cos) = (sin * inv_d2, cos * inv_d2);
        let (ex, ey, ez) = (ex * inv_rho, ey * inv_rho, ez * inv_rho);
        out.lengths_m[i] = radius * wrap + s;
        out.wraps_rad[i] = wrap;
        out.directions[0][i] = sin * ex + cos * ax;
        out.directions[1][i] = sin * ey + cos * ay;
        out.directions[2][i] = sin * ez + cos * az;
        out.swivel_directions[0][i] = ex;
        out.swivel_directions[1][i] = ey;
        out.swivel_directions[2][i] = ez;
        out.wrap_sin[i] = sin;
        out.wrap_cos[i] = cos;
        out.free_lengths_m[i] = s;
        out.axis_distances_m[i] = rho;
    }
    out
}

impl<const N: usize> Robot<N> {
    /// Lengths, wrap angles, directions and arms of all cables at a pose.
    ///
    /// Frame: world. Units: m, rad. Source: paper, Eqs. 2-11, in the form of the module's text.
    ///
    /// # Errors
    /// [`Error::InsidePulley`], [`Error::OnSwivelAxis`] or [`Error::InvalidInput`] (a pose that is
    /// not finite), each naming the cable.
    ///
    /// ```
    /// use mcdpr_kinematics::{Cable, Platform, Pose, Robot};
    /// use nalgebra::Vector3;
    /// // A point anchor at the origin and an attachment at (3, 0, -4): length 5.
    /// let cable = Cable {
    ///     anchor_m: Vector3::zeros(),
    ///     swivel_axis: Vector3::z(),
    ///     pulley_radius_m: 0.0,
    ///     attachment_m: Vector3::zeros(),
    /// };
    /// let platform = Platform {
    ///     mass_kg: 1.0,
    ///     center_of_mass_m: Vector3::zeros(),
    ///     inertia_kg_m2: None,
    /// };
    /// let robot = Robot::new([cable], platform)?;
    /// let inverse = robot.inverse(&Pose::level(Vector3::new(3.0, 0.0, -4.0)))?;
    /// assert!((inverse.lengths_m[0] - 5.0).abs() < 1e-15);
    /// # Ok::<(), mcdpr_kinematics::Error>(())
    /// ```
    #[inline]
    pub fn inverse(&self, pose: &Pose) -> Result<Inverse<N>, Error> {
        let out = evaluate(&self.lanes, &pose.position_m, pose.rotation.matrix());
        if lanes_valid(&out) {
            Ok(out)
        } else {
            Err(self.domain_error(pose))
        }
    }

    /// Lengths only (m), in cable order. See [`Robot::inverse`] for the errors.
    #[inline]
    pub fn lengths_m(&self, pose: &Pose) -> Result<[f64; N], Error> {
        let out = evaluate(&self.lanes, &pose.position_m, pose.rotation.matrix());
        if lanes_valid(&out) {
            Ok(out.lengths_m)
        } else {
            Err(self.domain_error(pose))
        }
    }

    /// Lengths (m) at many places (world, m) of one attitude, N numbers per place into `out`, as many as both
    /// have. They equal those of [`Robot::lengths_m`] to the last bit, and take less time: the arms are turned
    /// once. The row of a place that is refused is NaN. Returns the first such place, from 0, and why.
    pub fn lengths_of_places(
        &self,
        rotation: &Rotation3<f64>,
        places_m: impl IntoIterator<Item = Vector3<f64>>,
        out: &mut [f64],
    ) -> Option<(usize, Error)> {
        let mut refused = None;
        let arms_m = evaluate(&self.lanes, &Vector3::zeros(), rotation.matrix()).arms_m;
        let (rows, _) = out.as_chunks_mut::<N>();
        for (index, (place, row)) in places_m.into_iter().zip(rows).enumerate() {
            let found = evaluate_arms(&self.lanes, &place, &arms_m);
            *row = found.lengths_m;
            if !lanes_valid(&found) {
                self.refuse(row, &mut refused, index, || Pose::new(place, *rotation));
            }
        }
        refused
    }

    /// As [`Robot::lengths_of_places`], at poses of different attitudes.
    pub fn lengths_of_poses(
        &self,
        poses: impl IntoIterator<Item = Pose>,
        out: &mut [f64],
    ) -> Option<(usize, Error)> {
        let mut refused = None;
        let (rows, _) = out.as_chunks_mut::<N>();
        for (index, (pose, row)) in poses.into_iter().zip(rows).enumerate() {
            let found = evaluate(&self.lanes, &pose.position_m, pose.rotation.matrix());
            *row = found.lengths_m;
            if !lanes_valid(&found) {
                self.refuse(row, &mut refused, index, || pose);
            }
        }
        refused
    }

    #[cold]
    fn refuse(
        &self,
        row: &mut [f64; N],
        refused: &mut Option<(usize, Error)>,
        index: usize,
        pose: impl FnOnce() -> Pose,
    ) {
        *row = [f64::NAN; N];
        if refused.is_none() {
            *refused = Some((index, self.domain_error(&pose())));
        }
    }

    /// Everything about each cable's path, one record per cable.
    ///
    /// # Errors
    /// As [`Robot::inverse`].
    pub fn paths(&self, pose: &Pose) -> Result<[CablePath; N], Error> {
        let inverse = self.inverse(pose)?;
        Ok(core::array::from_fn(|i| self.path_of(pose, &inverse, i)))
    }

    /// The path of cable `i`, zero-based, by the inverse at this pose.
    pub(crate) fn path_of(&self, pose: &Pose, inverse: &Inverse<N>, i: usize) -> CablePath {
        let cable = &self.cables()[i];
        let (e, a) = (inverse.swivel_direction(i), cable.swivel_axis);
        CablePath {
            length_m: inverse.lengths_m[i],
            wrap_rad: inverse.wraps_rad[i],
            tangent_point_m: cable.anchor_m
                + (e * (1.0 - inverse.wrap_cos[i]) + a * inverse.wrap_sin[i])
                    * cable.pulley_radius_m,
            direction: inverse.direction(i),
            attachment_m: pose.position_m + inverse.arm_m(i),
        }
    }

    /// The first cable outside the domain, as an error.
    #[cold]
    pub(crate) fn domain_error(&self, pose: &Pose) -> Error {
        if let Err(error) = pose.check() {
            return error;
        }
        // The fast path only knows that some lane is invalid: the cause is found here.
        for (i, cable) in self.cables().iter().enumerate() {
            let d = pose.transform(&cable.attachment_m) - cable.anchor_m;
            let h = d.dot(&cable.swivel_axis);
            let rho = (d - cable.swivel_axis * h).norm();
            let radius = cable.pulley_radius_m;
            let distance = sqrt((rho - radius) * (rho - radius) + h * h);
            let out = evaluate(&self.lanes, &pose.position_m, pose.rotation.matrix());
            if valid_lane(&out, i) {
                continue;
            }
            if distance < radius {
                return Error::InsidePulley {
                    cable: i + 1,
                    distance_m: distance,
                    radius_m: radius,
                };
            }
            // Lengths from 1e100 m on are refused, see `valid_lane`.
            if d.norm() < 1e99 {
                return Error::OnSwivelAxis { cable: i + 1 };
            }
            return Error::InvalidInput {
                what: "the pose is too far away to be computed",
                cable: Some(i + 1),
                value: d.norm(),
            };
        }
        Error::InvalidInput {
            what: "the pose is outside the domain",
            cable: None,
            value: f64::NAN,
        }
    }
}

/// Shortest distance from the swivel axis that still gives a direction to full precision, m.
const AXIS_DISTANCE_MIN_M: f64 = 1e-12;

#[inline(always)]
fn valid_lane<const N: usize>(out: &Inverse<N>, i: usize) -> bool {
    // NaN fails both comparisons: the free length is NaN inside the pulley.
    (out.axis_distances_m[i] > AXIS_DISTANCE_MIN_M) & (out.lengths_m[i] < 1e100)
}

#[inline(always)]
pub(crate) fn lanes_valid<const N: usize>(out: &Inverse<N>) -> bool {
    let mut valid = true;
    for i in 0..N {
        valid &= valid_lane(out, i);
    }
    valid
}
