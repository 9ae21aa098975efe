//! The robot description in the terms of the other crates: geometry for the solvers, keyed
//! integers for the board.

mod board;

pub use board::{CableRates, OutOfRange, configuration, hash_of, reference};

use crate::robot::Robot;
use mcdpr_kinematics::{AnyRobot, Cable, Error, Platform};

/// The robot's geometry for the solvers.
///
/// # Errors
/// What the geometry check finds; see [`AnyRobot::new`].
pub fn geometry(robot: &Robot) -> Result<AnyRobot, Error> {
    let cables: Vec<_> = robot
        .cables
        .iter()
        .map(|cable| Cable {
            anchor_m: cable.anchor_in_world_m,
            swivel_axis: cable.swivel_axis_in_world,
            pulley_radius_m: cable.pulley_radius_m,
            attachment_m: cable.attachment_in_platform_m,
        })
        .collect();
    let platform = Platform {
        mass_kg: robot.platform.mass_kg,
        center_of_mass_m: robot.platform.center_of_mass_m,
        inertia_kg_m2: Some(robot.platform.inertia_kg_m2),
    };
    AnyRobot::new(&cables, platform)
}

/// Length of cable `index` (from 0) that a drum has paid out when the geometric length from pulley
/// to platform is `length_m` and the tension is `tension_n`, m: the unstretched length of cable
/// and routing, less the routing.
#[must_use]
pub fn paid_out_m(robot: &Robot, index: usize, length_m: f64, tension_n: f64) -> f64 {
    let Some(cable) = robot.cables.get(index) else {
        return length_m;
    };
    let total = length_m + cable.routing_length_m;
    total / (1.0 + tension_n / cable.ea_n) - cable.routing_length_m
}
