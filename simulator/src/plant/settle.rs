//! Finds the resting pose of the plant by simulating a heavily damped copy of it.

use super::cable::Cable;
use super::error::PlantError;
use super::params::MAX_CABLES;
use super::platform::{Body, Motion};
use super::unmodelled::Unmodelled;
use super::vec3::{V3, add, axpy, cross, dot, mul, mul_t, norm, q_matrix, scale};

/// Drag over mass and over inertia of the damped copy (1/s): near critical for the slow modes of
/// 1-2 Hz, while the cables' fast modes still die within a few seconds.
const DRAG_PER_S: f64 = 12.0;
/// Forces (N) and moments over 0.1 m (N) below this count as balanced.
const BALANCED_N: f64 = 1e-8;
/// Speed (m/s) below which the copy is at rest.
const AT_REST_MPS: f64 = 1e-9;
/// What is left of the forces (N) and of the speed (m/s) where the search gives up, yet the platform hangs.
const NEARLY_N: f64 = 1e-3;
const NEARLY_MPS: f64 = 1e-3;
/// The search gives up after this much simulated time (s).
const GIVE_UP_S: f64 = 120.0;
/// A load on one point need not come to rest about the vertical; after this time its other motions count alone (s).
const TURNS_S: f64 = 20.0;
/// What may be left of its moment about the vertical, over 0.1 m (N): of attachments that are not quite in one point.
const TURNED_N: f64 = 0.02;
/// Attachments no farther apart than this are one point (m): an eyelet, with its tolerance.
const ONE_POINT_M: f64 = 0.005;

/// How a cable acts on the platform during the search.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Hold {
    /// Drum locked.
    Locked,
    /// Constant tension (N).
    Tension(f64),
}

/// Constant external load: force (world), torque about the centre of mass (world), and a point
/// of application in principal axes for the force.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Load {
    pub force_n: V3,
    pub torque_nm: V3,
    pub point: V3,
}

/// Swings the platform out from `motion`. All drums are at displacement 0.
pub(crate) fn settle(
    body: &Body,
    cables: &[Cable],
    holds: &[Hold; MAX_CABLES],
    weight_n: V3,
    (load, unmodelled): (&Load, Option<&Unmodelled>),
    step_s: f64,
    mut motion: Motion,
) -> Result<Motion, PlantError> {
    let h = step_s.min(1e-4);
    let keep = 1.0 / (1.0 + DRAG_PER_S * h);
    let turns = hangs_on_one_point(cables);
    let mut time_s = 0.0;
    loop {
        motion.drift(body, 0.5 * h);
        let rotation = q_matrix(motion.attitude);
        let spin = motion.spin(body);
        let mut force = add(weight_n, load.force_n);
        let load_in_body = mul_t(&rotation, load.force_n);
        let mut torque = add(
            cross(load.point, load_in_body),
            mul_t(&rotation, load.torque_nm),
        );
        if let Some(unmodelled) = unmodelled {
            let (push, turn) = unmodelled.at(motion.center_m);
            force = add(force, push);
            torque = add(torque, mul_t(&rotation, turn));
        }
        for (i, cable) in cables.iter().enumerate() {
            let arm = mul(&rotation, cable.attachment);
            let path = cable.path(add(motion.center_m, arm), i)?;
            let tension_n = match holds[i] {
                _ if cable.broken => 0.0,
                Hold::Tension(t) => t,
                Hold::Locked => {
                    let velocity = add(
                        motion.velocity,
                        mul(&rotation, cross(spin, cable.attachment)),
                    );
                    let rate = dot(path.direction, velocity);
                    cable.tension(path.length_m, rate, 0.0, 0.0).platform_n
                }
            };
            force = axpy(force, -tension_n, path.direction);
            let pull = scale(mul_t(&rotation, path.direction), -tension_n);
            torque = add(torque, cross(cable.attachment, pull));
        }
        motion.kick(body, force, torque, h);
        // Drag of this copy alone: the resting pose does not depend on it.
        motion.velocity = scale(motion.velocity, keep);
        motion.momentum = scale(motion.momentum, keep);
        motion.drift(body, 0.5 * h);
        time_s += h;

        let residual_n = norm(force).max(norm(torque) / 0.1);
        let speed = norm(motion.velocity).max(0.1 * norm(spin));
        let balanced = residual_n < BALANCED_N && speed < AT_REST_MPS;
        // Almost nothing turns such a load back about the vertical.
        let level = |vector: V3| {
            let up = mul_t(&rotation, [0.0, 0.0, 1.0]);
            axpy(vector, -dot(vector, up), up)
        };
        let nearly = turns
            && time_s > TURNS_S
            && norm(force).max(norm(level(torque)) / 0.1) < NEARLY_N
            && norm(torque) / 0.1 < TURNED_N
            && norm(motion.velocity).max(0.1 * norm(level(spin))) < NEARLY_MPS;
        if balanced || nearly {
            motion.velocity = [0.0; 3];
            motion.momentum = [0.0; 3];
            return Ok(motion);
        }
        let lost = !residual_n.is_finite() || norm(motion.center_m) > 100.0;
        if lost || time_s > GIVE_UP_S {
            return Err(PlantError::NoEquilibrium {
                simulated_s: time_s,
                residual_n,
            });
        }
    }
}

/// Whether all cables hold the platform at one point, so that it turns freely about it.
fn hangs_on_one_point(cables: &[Cable]) -> bool {
    let Some(first) = cables.first() else {
        return false;
    };
    let mut others = cables.iter();
    others.all(|cable| norm(axpy(cable.attachment, -1.0, first.attachment)) < ONE_POINT_M)
}
