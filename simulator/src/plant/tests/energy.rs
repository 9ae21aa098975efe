//! Conservation: quantities that must be constant, and quantities that may only decrease.

use super::*;
use crate::plant::platform::{Body, Motion};

fn undamped() -> PlantParams {
    let mut params = PlantParams::paper_optimistic();
    for cable in &mut params.cables {
        cable.damping_time_s = 0.0;
    }
    params
}

/// Energies every 10 ms over `seconds`, relative to the first.
fn energies(plant: &mut Plant, seconds: u32) -> Vec<f64> {
    let first = plant.truth().expect("a path").energy_j;
    (0..seconds * 100)
        .map(|_| {
            plant.advance(0.01).expect("no failure");
            plant.truth().expect("a path").energy_j - first
        })
        .collect()
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

fn largest(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |m, v| m.max(v.abs()))
}

#[test]
fn at_rest_without_damping_nothing_happens_for_20_s() {
    let mut plant = at_rest(undamped(), &off_centre(), 5.0);
    let start = plant.truth().expect("a path");
    let drift = energies(&mut plant, 20);
    println!("at rest, 20 s: energy within {:.2e} J", largest(&drift));
    assert!(largest(&drift) < 1e-12, "{}", largest(&drift));
    let end = plant.truth().expect("a path");
    assert!(distance(start.tool_position_m, end.tool_position_m) < 1e-7);
    assert_eq!(end.drum_positions_m, [0.0; MAX_CABLES]);
}

#[test]
fn an_undamped_swing_keeps_its_energy_for_20_s() {
    let mut plant = at_rest(undamped(), &off_centre(), 5.0);
    plant
        .set_load([0.3, 0.2, -5.0], [0.0; 3], [0.0; 3])
        .expect("finite");
    plant.advance(0.1).expect("pushed");
    plant
        .set_load([0.0; 3], [0.0; 3], [0.0; 3])
        .expect("finite");
    let rest = at_rest(undamped(), &off_centre(), 5.0)
        .truth()
        .expect("a path")
        .energy_j;
    let swing = plant.truth().expect("a path").energy_j - rest;
    assert!(swing > 1e-4, "{swing} J of swing");
    let drift = energies(&mut plant, 20);
    println!(
        "swing of {swing:.2e} J, 20 s: within {:.2e} J",
        largest(&drift)
    );
    // The step's own error swings with the motion; it must not add up.
    assert!(
        largest(&drift) < 1e-3 * swing,
        "{} of {swing}",
        largest(&drift)
    );
    let growth = mean(&drift[1600..]) - mean(&drift[..400]);
    println!("its mean energy grew by {growth:.2e} J");
    assert!(growth.abs() < 1e-6 * swing, "{growth} of {swing}");
}

#[test]
fn cable_damping_and_pulley_loss_only_take_energy() {
    for loss in [0.0, 0.03] {
        let mut params = PlantParams::paper_optimistic();
        for cable in &mut params.cables {
            cable.pulley_loss = loss;
        }
        let mut plant = at_rest(params, &off_centre(), 5.0);
        plant
            .set_load([1.0, 0.5, 0.0], [0.0; 3], [0.0; 3])
            .expect("finite");
        plant.advance(0.2).expect("pushed");
        plant
            .set_load([0.0; 3], [0.0; 3], [0.0; 3])
            .expect("finite");
        let start = plant.truth().expect("a path").energy_j;
        let course = energies(&mut plant, 20);
        let seconds: Vec<f64> = course.chunks(100).map(mean).collect();
        for pair in seconds.windows(2) {
            assert!(
                pair[1] < pair[0] + 1e-7,
                "loss {loss}: {pair:?} J after {start} J"
            );
        }
        assert!(seconds[19] < 0.0);
    }
}

#[test]
fn free_drums_conserve_energy_with_the_platform() {
    // Brakes open, torque off, no friction: the falling platform drives drums and rotors.
    let mut params = undamped();
    for winch in &mut params.winches {
        winch.friction_n = 0.0;
        winch.gear_ratio = 27.0;
        winch.rotor_inertia_kg_m2 = 1e-6;
    }
    let mut plant = at_rest(params, &off_centre(), 5.0);
    for cable in 0..4 {
        plant.set_brake(cable, false).expect("cable");
    }
    let drift = energies(&mut plant, 1)[..30].to_vec();
    let truth = plant.truth().expect("a path");
    assert!(
        truth.drum_positions_m[..4].iter().all(|x| *x > 0.05),
        "{truth:?}"
    );
    assert!(largest(&drift) < 2e-5, "{}", largest(&drift));
}

#[test]
fn a_released_platform_falls_freely() {
    let mut plant = at_rest(
        PlantParams::paper_optimistic(),
        &Pose::level([0.33, 0.0, -0.1]),
        5.0,
    );
    let start = plant.truth().expect("a path").pose;
    for cable in 0..4 {
        plant.break_cable(cable).expect("cable");
    }
    plant.advance(0.3).expect("falls");
    let truth = plant.truth().expect("a path");
    let fallen = start.position_m[2] - truth.pose.position_m[2];
    assert!((fallen - 0.5 * 9.81 * 0.09).abs() < 1e-9, "{fallen}");
    assert!((truth.velocity_mps[2] + 9.81 * 0.3).abs() < 1e-9);
    let turned = start
        .rotation_wxyz
        .iter()
        .zip(truth.pose.rotation_wxyz)
        .map(|(a, b)| a * b)
        .sum::<f64>();
    assert!((turned - 1.0).abs() < 1e-12);
}

#[test]
fn a_tumbling_body_keeps_momentum_and_energy() {
    let mut params = PlantParams::paper_optimistic().platform;
    params.inertia_kg_m2 = [
        [0.004, 0.0005, 0.0],
        [0.0005, 0.002, 0.0003],
        [0.0, 0.0003, 0.0055],
    ];
    let body = Body::new(&params);
    let pose = Pose::from_rpy([0.1, 0.2, 0.3], [0.3, -0.2, 1.0]);
    let mut motion = Motion::at_rest(&body, &pose);
    // Twenty radians per second about no principal axis.
    motion.momentum = [0.02, 0.05, 0.03];
    let world = |m: &Motion| mul(&q_matrix(m.attitude), m.momentum);
    let (momentum, energy) = (world(&motion), motion.kinetic_energy(&body));
    for _ in 0..200_000 {
        motion.drift(&body, 1e-4);
    }
    assert!(distance(world(&motion), momentum) < 1e-11);
    assert!((motion.kinetic_energy(&body) / energy - 1.0).abs() < 1e-6);
    assert!(
        distance(
            motion.pose(&body).point_in_world([0.0, 0.0, -0.03]),
            pose.point_in_world([0.0, 0.0, -0.03])
        ) < 1e-12
    );
}

#[test]
fn an_impulse_off_centre_moves_and_turns_as_newton_and_euler_say() {
    let mut params = PlantParams::paper_optimistic();
    params.gravity_mps2 = [0.0; 3];
    let mut plant = Plant::new(params, 1).expect("good parameters");
    for cable in 0..4 {
        plant.break_cable(cable).expect("cable");
    }
    // 2 N along y at 50 mm in x from the centre of mass, for 10 ms.
    plant
        .set_load([0.0, 2.0, 0.0], [0.05, 0.0, -0.03], [0.0; 3])
        .expect("finite");
    plant.advance(0.01).expect("pushed");
    let truth = plant.truth().expect("a path");
    let spin = 2.0 * 0.05 * 0.01 / (1.4 * (0.13_f64.powi(2) + 0.18_f64.powi(2)) / 12.0);
    assert!(
        (truth.angular_velocity_rad_s[2] - spin).abs() < 1e-5 * spin,
        "{truth:?}"
    );
    // The origin lies on the axis through the centre of mass: it moves at p / m.
    assert!((truth.velocity_mps[1] - 0.02 / 1.4).abs() < 1e-9);
}

#[test]
fn the_step_is_short_enough_for_the_stiffest_motion() {
    // A platform that bounces on 50 kN cables, at the default step and at a tenth of it.
    let bounce = |step_s: f64| {
        let mut params = PlantParams::paper_optimistic();
        params.step_s = step_s;
        let mut plant = at_rest(params, &off_centre(), 5.0);
        plant
            .set_load([0.0, 0.0, -20.0], [0.0; 3], [0.0; 3])
            .expect("finite");
        plant.advance(0.2).expect("bounces");
        let truth = plant.truth().expect("a path");
        (truth.pose.position_m, truth.tensions_platform_n)
    };
    let ((p, t), (fine_p, fine_t)) = (bounce(1e-4), bounce(1e-5));
    println!(
        "step error after 0.2 s of bouncing: {:.2e} m",
        distance(p, fine_p)
    );
    assert!(distance(p, fine_p) < 2e-6, "{p:?} {fine_p:?}");
    assert!(
        t.iter().zip(fine_t).all(|(a, b)| (a - b).abs() < 0.05),
        "{t:?} {fine_t:?}"
    );
}
