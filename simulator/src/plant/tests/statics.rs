//! The plant's resting poses against the least potential energy, found by brute force.

use super::brute::{Energy, pose_of};
use super::*;

fn brute(plant: &Plant, hauled: Option<(usize, f64)>) -> Pose {
    let truth = plant.truth().expect("a path");
    let robot = plant.params();
    let unstretched_m = robot
        .cables
        .iter()
        .zip(truth.unstretched_lengths_m)
        .map(|(c, l)| l + c.routing_length_m)
        .collect();
    let energy = Energy {
        robot,
        unstretched_m,
        hauled,
    };
    pose_of(&energy.least(&truth.pose))
}

/// Largest distance between two poses over origin, tool point and attachments (m).
fn apart(plant: &Plant, a: &Pose, b: &Pose) -> f64 {
    let params = plant.params();
    let points = params.cables.iter().map(|c| c.attachment_m);
    points
        .chain([[0.0; 3], params.platform.tcp_m])
        .map(|p| distance(a.point_in_world(p), b.point_in_world(p)))
        .fold(0.0, f64::max)
}

/// The acceptance tolerance: 0.01 mm.
const CLOSE_M: f64 = 1e-5;

fn damped() -> PlantParams {
    let mut params = PlantParams::paper_optimistic();
    params.platform.linear_damping_ns_per_m = 1.4 * 12.0;
    params.platform.angular_damping_nms = 0.05;
    params
}

#[test]
fn settling_finds_the_least_energy() {
    for (pose, tension_n) in [
        (Pose::level([0.33, 0.0, -0.1]), 8.0),
        (off_centre(), 3.0),
        (Pose::level([0.42, -0.1, -0.3]), 4.0),
        (Pose::level([0.25, -0.04, -0.5]), 4.0),
    ] {
        let plant = at_rest(PlantParams::paper_optimistic(), &pose, tension_n);
        let truth = plant.truth().expect("a path");
        assert!((truth.tensions_platform_n[3] - tension_n).abs() < 1e-6);
        let error = apart(&plant, &truth.pose, &brute(&plant, None));
        println!("settled, against brute force: {:.3e} mm", error * 1e3);
        assert!(error < CLOSE_M, "{pose:?}: {error}");
        // The pose is not level: otherwise a test that ignores the attitude would pass.
        assert!(truth.pose.rpy_rad()[1].abs() > 1e-3 || pose.position_m[1].abs() < 1e-9);
    }
}

#[test]
fn let_go_near_equilibrium_it_settles_there_with_all_drums_locked() {
    let mut plant = at_rest(damped(), &off_centre(), 3.0);
    let rest = plant.truth().expect("a path").pose;
    plant
        .set_load([2.0, 1.0, 0.5], [0.0, 0.05, 0.0], [0.0; 3])
        .expect("finite");
    plant.advance(1.0).expect("swings");
    let away = plant.truth().expect("a path").pose;
    assert!(apart(&plant, &rest, &away) > 1e-3, "the load must move it");
    plant
        .set_load([0.0; 3], [0.0; 3], [0.0; 3])
        .expect("finite");
    plant.advance(20.0).expect("settles");
    let truth = plant.truth().expect("a path");
    let reference = brute(&plant, None);
    let error = apart(&plant, &truth.pose, &reference);
    println!("let go, all locked: {:.3e} mm", error * 1e3);
    assert!(error < CLOSE_M, "{error}");
    assert!(vec3::norm(truth.velocity_mps) < 1e-6);
    // Elasticity matters: the same robot on stiff cables rests at another pose.
    let mut stiff = plant.params().clone();
    for cable in &mut stiff.cables {
        cable.ea_n *= 100.0;
    }
    let energy = Energy {
        robot: &stiff,
        unstretched_m: (0..4)
            .map(|i| truth.unstretched_lengths_m[i] + stiff.cables[i].routing_length_m)
            .collect(),
        hauled: None,
    };
    let stiff_pose = pose_of(&energy.least(&reference));
    assert!(apart(&plant, &stiff_pose, &reference) > 10.0 * CLOSE_M);
}

#[test]
fn it_settles_with_cable_4_held_by_its_motor() {
    let mut params = damped();
    params.winches[3].friction_n = 0.0;
    params.winches[3].viscous_friction_ns_per_m = 20.0;
    let mut plant = at_rest(params, &off_centre(), 3.0);
    make_ready(&mut plant, 3, Mode::Current);
    let milliamps = -24;
    plant
        .command(3, DriveCommand::Current { milliamps })
        .expect("cable");
    plant.advance(0.05).expect("held by the brake");
    plant.set_brake(3, false).expect("cable");
    let before = plant.truth().expect("a path").pose;
    plant.advance(25.0).expect("settles");
    let truth = plant.truth().expect("a path");
    let force_n = 0.024 * plant.params().winches[3].force_per_ampere_n();
    assert!(
        apart(&plant, &before, &truth.pose) > 1e-3,
        "4.45 N instead of 3 N moves it"
    );
    assert!((truth.tensions_winch_n[3] - force_n).abs() < 1e-3);
    let error = apart(&plant, &truth.pose, &brute(&plant, Some((3, force_n))));
    println!("let go, cable 4 held: {:.3e} mm", error * 1e3);
    assert!(error < CLOSE_M, "{error}");
}

#[test]
fn it_hangs_right_with_one_cable_slack() {
    let mut plant = at_rest(damped(), &off_centre(), 3.0);
    plant.slip_cable(3, 0.15).expect("cable");
    plant.advance(30.0).expect("settles");
    let truth = plant.truth().expect("a path");
    assert_eq!(truth.tensions_platform_n[3], 0.0);
    assert!(truth.tensions_platform_n[..3].iter().all(|t| *t > 0.5));
    let error = apart(&plant, &truth.pose, &brute(&plant, None));
    assert!(error < CLOSE_M, "{error}");
}

#[test]
fn forces_and_moments_balance_at_rest() {
    let plant = at_rest(PlantParams::paper_optimistic(), &off_centre(), 5.0);
    let truth = plant.truth().expect("a path");
    // With vertical swivel axes the pull's vertical part needs no geometry but the direction; the
    // sum over cables must carry the weight. Directions by differences of brute-force lengths.
    let mut force = [0.0, 0.0, -1.4 * 9.81];
    for (cable, tension) in plant.params().cables.iter().zip(truth.tensions_platform_n) {
        let a = truth.pose.point_in_world(cable.attachment_m);
        for axis in 0..3 {
            let length = |by: f64| {
                let mut p = a;
                p[axis] += by;
                super::brute::hull_length_m(cable.anchor_m, cable.swivel_axis, 0.01, p, 20_000)
            };
            force[axis] -= tension * (length(1e-4) - length(-1e-4)) / 2e-4;
        }
    }
    assert!(vec3::norm(force) < 1e-3, "{force:?}");
}

#[test]
fn eight_cables_and_one_cable_settle_too() {
    let mut params = PlantParams::paper_optimistic();
    params.cables.truncate(1);
    params.winches.truncate(1);
    params.cables[0].pulley_radius_m = 0.0;
    params.cables[0].attachment_m = [0.0; 3];
    let mut single = Plant::new(params, 1).expect("good parameters");
    single
        .settle_at(&Pose::level([0.1, -0.37, -0.5]), &[13.734], None)
        .expect("a pendulum");
    let truth = single.truth().expect("a path");
    let [x, y, _] = single.params().cables[0].anchor_m;
    assert!(distance(truth.pose.position_m, [x, y, truth.pose.position_m[2]]) < 1e-6);
    assert!((truth.tensions_platform_n[0] - 1.4 * 9.81).abs() < 1e-6);

    let mut params = PlantParams::paper_optimistic();
    for i in 0..4 {
        let mut lower = params.cables[i].clone();
        lower.anchor_m[2] = -0.8;
        lower.swivel_axis = [0.0, 0.0, -1.0];
        params.cables.push(lower);
        params.winches.push(params.winches[i].clone());
    }
    let mut eight = Plant::new(params, 1).expect("good parameters");
    let tensions = [20.0, 20.0, 20.0, 20.0, 8.0, 8.0, 8.0, 8.0];
    eight
        .settle_at(&Pose::level([0.33, 0.0, -0.35]), &tensions, None)
        .expect("held");
    let truth = eight.truth().expect("a path");
    let error = apart(&eight, &truth.pose, &brute(&eight, None));
    assert!(error < CLOSE_M, "{error}");
}
