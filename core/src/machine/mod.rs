//! The robot description in the terms of the other crates: geometry for the solvers, keyed
//! integers for the board.

mod board;

pub use board::{CableRates, OutOfRange, configuration, expected_n, hash_of, reference};

use crate::robot::Robot;
use mcdpr_kinematics::{AnyRobot, Error};

/// The robot's geometry for the solvers.
///
/// # Errors
/// What the geometry check finds; see [`AnyRobot::new`].
pub fn geometry(robot: &Robot) -> Result<AnyRobot, Error> {
    robot.geometry()
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
