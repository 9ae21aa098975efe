//! Tests of the plant as a whole, and of its geometry against brute force.

mod brute;
mod bus;
mod day;
mod drive;
mod energy;
mod gear;
mod geometry;
mod hook;
mod misuse;
mod sensors;
mod statics;
mod supply;
mod winch;

use super::*;

/// A pose well inside the paper robot's workspace, off its symmetry axes.
fn off_centre() -> Pose {
    Pose::from_rpy([0.30, 0.05, -0.25], [0.0, 0.0, 0.02])
}

/// The paper's robot at rest at `pose` with cable 4 at `tension_n`, brakes closed.
fn at_rest(params: PlantParams, pose: &Pose, tension_n: f64) -> Plant {
    let mut plant = Plant::new(params, 7).expect("good parameters");
    plant
        .settle_with_tension(pose, 3, tension_n)
        .expect("an equilibrium");
    plant
}

/// Winches alone: no gravity, all cables broken, brakes open, so that nothing pulls on a drum.
fn winches_alone(mut params: PlantParams) -> Plant {
    params.gravity_mps2 = [0.0; 3];
    let mut plant = Plant::new(params, 7).expect("good parameters");
    for cable in 0..plant.cable_count() {
        plant.break_cable(cable).expect("cable");
        plant.set_brake(cable, false).expect("cable");
    }
    plant.advance(0.05).expect("nothing moves");
    plant
}

/// Takes one drive through reset and mode choice: 1.01 s.
fn make_ready(plant: &mut Plant, cable: usize, mode: Mode) {
    plant.command(cable, DriveCommand::Reset).expect("cable");
    plant.advance(0.505).expect("at rest");
    plant
        .command(cable, DriveCommand::SelectMode(mode))
        .expect("cable");
    plant.advance(0.505).expect("at rest");
    assert_eq!(plant.drive_state(cable), Ok(DriveState::Ready(mode)));
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    vec3::norm(vec3::sub(a, b))
}
