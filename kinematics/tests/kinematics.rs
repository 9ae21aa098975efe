//! Geometry, derivatives and forward kinematics against independent computations.

use mcdpr_kinematics::*;
use nalgebra::{Matrix3, Rotation3, Vector3};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// The closed form as the paper's readers write it down: two arc-tangents.
fn textbook_length(cable: &Cable, pose: &Pose) -> f64 {
    let d = pose.transform(&cable.attachment_m) - cable.anchor_m;
    let (a, r) = (cable.swivel_axis, cable.pulley_radius_m);
    let h = d.dot(&a);
    let x = (d - a * h).norm() - r;
    let s = (x * x + h * h - r * r).sqrt();
    let theta = std::f64::consts::PI - s.atan2(r) - h.atan2(x);
    r * theta.rem_euclid(std::f64::consts::TAU) + s
}

fn random_robot(rng: &mut ChaCha8Rng) -> Robot<4> {
    let mut cables = *four_cables().cables();
    for c in &mut cables {
        c.pulley_radius_m = rng.random_range(0.0..0.03);
        c.swivel_axis = unit(rng);
        c.anchor_m += unit(rng) * 0.02;
    }
    Robot::new(cables, *four_cables().platform()).unwrap()
}

fn unit(rng: &mut ChaCha8Rng) -> Vector3<f64> {
    loop {
        let v = Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0));
        if v.norm() > 0.1 && v.norm() < 1.0 {
            return v.normalize();
        }
    }
}

fn random_pose(rng: &mut ChaCha8Rng) -> Pose {
    Pose::from_rpy(
        Vector3::new(
            rng.random_range(0.1..0.55),
            rng.random_range(-0.28..0.28),
            rng.random_range(-0.6..-0.05),
        ),
        [
            rng.random_range(-0.4..0.4),
            rng.random_range(-0.4..0.4),
            rng.random_range(-0.8..0.8),
        ],
    )
}

#[test]
fn lengths_agree_with_the_textbook_form_to_rounding() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut worst: f64 = 0.0;
    for _ in 0..20_000 {
        let robot = random_robot(&mut rng);
        let pose = random_pose(&mut rng);
        let lengths = robot.lengths_m(&pose).unwrap();
        for (cable, length) in robot.cables().iter().zip(lengths) {
            worst = worst.max((length - textbook_length(cable, &pose)).abs());
        }
    }
    assert!(worst < 1e-15, "{worst:e}");
}

#[test]
fn the_closed_form_is_the_taut_path() {
    // A taut string around the pulley's disc: straight from a rim point P(phi) to the attachment,
    // and along the rim from the entry. A stretched string leaves the rim smoothly, so of all P the
    // visible ones with arc + chord smallest is it; the rim is searched densely, then refined.
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for _ in 0..40 {
        let robot = random_robot(&mut rng);
        let pose = random_pose(&mut rng);
        let paths = robot.paths(&pose).unwrap();
        for (cable, path) in robot.cables().iter().zip(&paths) {
            let r = cable.pulley_radius_m;
            let a = cable.swivel_axis;
            let end = pose.transform(&cable.attachment_m);
            let d = end - cable.anchor_m;
            let e = (d - a * d.dot(&a)).normalize();
            let centre = cable.anchor_m + e * r;
            let rim = |phi: f64| centre + (a * phi.sin() - e * phi.cos()) * r;
            // Arc + chord decreases up to the tangent point and grows beyond it only through the
            // disc; among chords that stay outside the disc the smallest total is the taut path.
            let outside = |phi: f64| (end - rim(phi)).dot(&(rim(phi) - centre)) >= -1e-12 * r;
            let total = |phi: f64| r * phi + (end - rim(phi)).norm();
            let n = 10_000;
            let mut best = f64::INFINITY;
            for k in 0..n {
                let phi = std::f64::consts::TAU * f64::from(k) / f64::from(n);
                if outside(phi) {
                    best = best.min(total(phi));
                }
            }
            // The derivative of the total vanishes at the tangent point, so a grid of spacing q
            // errs by about r^2 q^2 / s.
            let error = best - path.length_m;
            assert!(error.abs() < 1e-8 + r * 8e-4, "{error:e}");
            assert!(error > -1e-12, "shorter than taut: {error:e}");
            assert!((path.tangent_point_m - rim(path.wrap_rad)).norm() < 1e-14);
            let straight = end - path.tangent_point_m;
            assert!((straight.normalize() - path.direction).norm() < 1e-12);
            assert!((straight.norm() + r * path.wrap_rad - path.length_m).abs() < 1e-14);
        }
    }
}

/// Fourth-order central difference.
fn difference(f: impl Fn(f64) -> f64, step: f64) -> f64 {
    (8.0 * (f(step) - f(-step)) - (f(2.0 * step) - f(-2.0 * step))) / (12.0 * step)
}

fn close(got: f64, want: f64, what: &str) {
    assert!(
        (got - want).abs() < 1e-8 * want.abs().max(0.1),
        "{what}: {got} against {want}"
    );
}

#[test]
fn jacobians_agree_with_finite_differences() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for _ in 0..60 {
        let robot = random_robot(&mut rng);
        let pose = random_pose(&mut rng);
        let inverse = robot.inverse(&pose).unwrap();
        let twist = robot.twist_jacobian(&pose).unwrap();
        let rpy = pose.rpy();
        let euler = inverse.euler_jacobian(rpy);
        let own = robot.length_derivatives(&pose).unwrap();
        let step = 1e-4;
        for i in 0..4 {
            for k in 0..6 {
                let along = |s: f64| {
                    let mut d = [0.0; 6];
                    d[k] = s;
                    let moved = pose.displaced(
                        &Vector3::new(d[0], d[1], d[2]),
                        &Vector3::new(d[3], d[4], d[5]),
                    );
                    robot.lengths_m(&moved).unwrap()[i]
                };
                close(twist[(i, k)], difference(along, step), "twist");
                let along = |s: f64| {
                    let mut p = pose.position_m;
                    let mut angles = rpy;
                    if k < 3 {
                        p[k] += s;
                    } else {
                        angles[k - 3] += s;
                    }
                    robot.lengths_m(&Pose::from_rpy(p, angles)).unwrap()[i]
                };
                close(euler[(i, k)], difference(along, step), "euler");
            }
            let changed = |change: &dyn Fn(&mut Cable)| {
                let mut cables = *robot.cables();
                change(&mut cables[i]);
                let robot = Robot::new(cables, *robot.platform()).unwrap();
                robot.lengths_m(&pose).unwrap()[i]
            };
            for k in 0..3 {
                let at = |s: f64| changed(&|c| c.anchor_m[k] += s);
                close(own[i].anchor[k], difference(at, step), "anchor");
                let at = |s: f64| changed(&|c| c.attachment_m[k] += s);
                close(own[i].attachment[k], difference(at, step), "attachment");
            }
            if robot.cables()[i].pulley_radius_m > 1e-3 {
                let at = |s: f64| changed(&|c| c.pulley_radius_m += s);
                close(own[i].pulley_radius, difference(at, step), "radius");
            }
            let axis = robot.cables()[i].swivel_axis;
            assert!(own[i].swivel_axis.dot(&axis).abs() < 1e-14);
            let tilt = axis.cross(&unit(&mut rng)).normalize();
            let at =
                |s: f64| changed(&|c| c.swivel_axis = Rotation3::new(axis.cross(&tilt) * s) * axis);
            close(own[i].swivel_axis.dot(&tilt), difference(at, step), "axis");
        }
    }
}

#[test]
fn hessians_agree_with_finite_differences() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    for _ in 0..40 {
        let robot = random_robot(&mut rng);
        let pose = random_pose(&mut rng);
        let inverse = robot.inverse(&pose).unwrap();
        for i in 0..4 {
            let h = inverse.twist_hessian(&robot, i);
            let point = inverse.point_hessian(&robot, i);
            let dir = [unit(&mut rng), unit(&mut rng)];
            let at = |s: f64| {
                let moved = pose.displaced(&(dir[0] * s), &(dir[1] * s));
                robot.lengths_m(&moved).unwrap()[i]
            };
            let q = nalgebra::Vector6::from_iterator(dir.iter().flat_map(|v| v.iter().copied()));
            let want = (h * q).dot(&q);
            let step = 2e-3;
            let second = (-at(2.0 * step) + 16.0 * at(step) - 30.0 * at(0.0) + 16.0 * at(-step)
                - at(-2.0 * step))
                / (12.0 * step * step);
            assert!(
                (second - want).abs() < 2e-6 * want.abs().max(1.0),
                "{second} {want}"
            );
            let moved = |s: f64| {
                let moved = pose.displaced(&(dir[0] * s), &Vector3::zeros());
                robot.inverse(&moved).unwrap().direction(i)
            };
            let dt = (8.0 * (moved(1e-4) - moved(-1e-4)) - (moved(2e-4) - moved(-2e-4))) / 12e-4;
            assert!((dt - point * dir[0]).norm() < 1e-8 * dt.norm().max(1.0));
        }
    }
}

#[test]
fn the_frame_mirrored_gives_mirrored_lengths() {
    // Mirror y: cables 1 and 2, 3 and 4 exchange places on a symmetric frame.
    let mut cables = *four_cables().cables();
    for (i, (x, y)) in [(0.03, -0.38), (0.03, 0.38), (0.64, 0.38), (0.64, -0.38)]
        .into_iter()
        .enumerate()
    {
        cables[i].anchor_m = Vector3::new(x, y, 0.024);
    }
    let robot = Robot::new(cables, *four_cables().platform()).unwrap();
    let mirror = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, 1.0));
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for _ in 0..100 {
        let pose = random_pose(&mut rng);
        let image = Pose::new(
            mirror * pose.position_m,
            Rotation3::from_matrix_unchecked(mirror * pose.rotation.matrix() * mirror),
        );
        let (a, b) = (
            robot.lengths_m(&pose).unwrap(),
            robot.lengths_m(&image).unwrap(),
        );
        for (i, j) in [(0, 1), (2, 3)] {
            assert!((a[i] - b[j]).abs() < 1e-15 && (a[j] - b[i]).abs() < 1e-15);
        }
    }
}

#[test]
fn poses_outside_the_domain_name_the_cable() {
    let robot = four_cables();
    let below = |i: usize, offset: Vector3<f64>| {
        let c = &robot.cables()[i];
        Pose::level(c.anchor_m - c.attachment_m + offset)
    };
    assert!(matches!(
        robot.inverse(&below(2, Vector3::new(0.005, 0.0, -0.001))),
        Err(Error::InsidePulley { cable: 3, .. })
    ));
    assert!(matches!(
        robot.inverse(&below(1, Vector3::new(0.0, 0.0, -0.2))),
        Err(Error::OnSwivelAxis { cable: 2 })
    ));
    assert!(
        robot
            .lengths_m(&below(1, Vector3::new(0.0, 0.0, 0.2)))
            .is_err()
    );
    for bad in [f64::NAN, f64::INFINITY] {
        let pose = Pose::level(Vector3::new(0.3, bad, -0.1));
        assert!(matches!(
            robot.inverse(&pose),
            Err(Error::InvalidInput { .. })
        ));
        assert!(robot.paths(&pose).is_err());
    }
    assert!(
        robot
            .inverse(&Pose::level(Vector3::new(1e200, 0.0, 0.0)))
            .is_err()
    );
    let message = robot
        .inverse(&below(2, Vector3::new(0.005, 0.0, -0.001)))
        .unwrap_err()
        .to_string();
    assert!(
        message.starts_with("cable 3: its attachment is 5.099 mm"),
        "{message}"
    );
}

#[test]
fn above_the_pulleys_the_path_is_still_taut() {
    let robot = four_cables();
    let pose = Pose::level(Vector3::new(0.33, 0.0, 0.3));
    let lengths = robot.lengths_m(&pose).unwrap();
    for (cable, length) in robot.cables().iter().zip(lengths) {
        assert!((length - textbook_length(cable, &pose)).abs() < 1e-15);
        assert!(length > (pose.transform(&cable.attachment_m) - cable.anchor_m).norm());
    }
}

#[test]
fn position_round_trips_cold_and_warm() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let options = ForwardOptions::default();
    for _ in 0..3000 {
        let robot = four_cables();
        let pose = random_pose(&mut rng);
        let lengths = robot.lengths_m(&pose).unwrap();
        let cold = robot
            .position(&lengths, &pose.rotation, None, &options)
            .unwrap();
        assert!(
            (cold.pose.position_m - pose.position_m).norm() < 1e-10,
            "{pose:?}"
        );
        let near = pose.position_m + unit(&mut rng) * 5e-3;
        let warm = robot
            .position(&lengths, &pose.rotation, Some(&near), &options)
            .unwrap();
        assert!((warm.pose.position_m - pose.position_m).norm() < 1e-10);
        assert!(warm.iterations <= 4 && warm.residual_m < 1e-12);
    }
}

#[test]
fn a_noisy_position_is_the_least_squares_one() {
    let robot = four_cables();
    let pose = Pose::level(Vector3::new(0.3, 0.05, -0.3));
    let mut lengths = robot.lengths_m(&pose).unwrap();
    lengths[1] += 4e-4;
    let options = ForwardOptions::default();
    let found = robot
        .position(&lengths, &pose.rotation, None, &options)
        .unwrap();
    let cost = |p: Vector3<f64>| -> f64 {
        let l = robot.lengths_m(&Pose::level(p)).unwrap();
        l.iter().zip(lengths).map(|(a, b)| (a - b) * (a - b)).sum()
    };
    let best = cost(found.pose.position_m);
    assert!((found.residual_m - (best / 4.0).sqrt()).abs() < 1e-9);
    for k in 0..3 {
        let slope = difference(|s| cost(found.pose.position_m + Vector3::ith(k, s)), 1e-4);
        assert!(slope.abs() < 1e-12, "{slope:e}");
    }
    lengths[1] += 0.05;
    assert!(matches!(
        robot.position(&lengths, &pose.rotation, None, &options),
        Err(Error::ResidualTooLarge { .. })
    ));
}

#[test]
fn position_and_yaw_round_trips() {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let options = ForwardOptions::default();
    for _ in 0..500 {
        let robot = four_cables();
        let pose = random_pose(&mut rng);
        let [rx, ry, rz] = pose.rpy();
        let lengths = robot.lengths_m(&pose).unwrap();
        let start = Pose::from_rpy(pose.position_m + unit(&mut rng) * 0.02, [rx, ry, rz + 0.1]);
        let found = robot
            .position_and_yaw(&lengths, &start, true, &options)
            .unwrap();
        assert!((found.pose.position_m - pose.position_m).norm() < 1e-10);
        let [gx, gy, gz] = found.pose.rpy();
        assert!((gx - rx).abs() < 1e-13 && (gy - ry).abs() < 1e-13 && (gz - rz).abs() < 1e-9);
    }
}

#[test]
fn position_and_yaw_needs_no_position_and_never_crosses_the_cables() {
    let mut rng = ChaCha8Rng::seed_from_u64(17);
    let options = ForwardOptions::default();
    let robot = four_cables();
    let mut twins = 0;
    for case in 0..5000 {
        let pose = random_pose(&mut rng);
        let [rx, ry, rz] = pose.rpy();
        let lengths = robot.lengths_m(&pose).unwrap();
        // Lengths fit a second pose, turned by half a turn, exactly: only the start distinguishes
        // them.
        let start = Pose::from_rpy(Vector3::zeros(), [rx, ry, 0.0]);
        let found = robot
            .position_and_yaw(&lengths, &start, false, &options)
            .unwrap();
        let gap = (found.pose.position_m - pose.position_m).norm();
        // With crossed cables the platform has turned by more than a right angle.
        let yaw = found.pose.rpy()[2];
        assert!(yaw.abs() < 1.5, "case {case}, yaw {rz}: {yaw}, {gap:e}");
        twins += u32::from(gap > 1e-9);
    }
    // Near the turning point of the yaw two uncrossed poses with these lengths lie side by side.
    assert!(twins < 50, "{twins} of 5000 found the neighbour");
}

#[test]
fn six_degrees_round_trip_on_eight_cables() {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let robot = eight_cables();
    let options = ForwardOptions::default();
    for _ in 0..500 {
        let pose = Pose::from_rpy(
            Vector3::from_fn(|_, _| rng.random_range(-0.4..0.4)) + Vector3::z() * 0.75,
            std::array::from_fn(|_| rng.random_range(-0.25..0.25)),
        );
        let lengths = robot.lengths_m(&pose).unwrap();
        let start = Pose::level(Vector3::new(0.0, 0.0, 0.75));
        let found = robot.pose(&lengths, &start, true, &options).unwrap();
        assert!((found.pose.position_m - pose.position_m).norm() < 1e-10);
        let turn = (found.pose.rotation.matrix() - pose.rotation.matrix()).norm();
        assert!(turn < 1e-10, "{turn:e}");
    }
}

#[test]
fn forward_solvers_refuse_what_they_cannot_answer() {
    let robot = four_cables();
    let options = ForwardOptions::default();
    let level = Pose::level(Vector3::new(0.3, 0.0, -0.2));
    let lengths = robot.lengths_m(&level).unwrap();
    assert!(matches!(
        robot.pose(&lengths, &level, true, &options),
        Err(Error::TooFewCables {
            needed: 6,
            got: 4,
            ..
        })
    ));
    let mut bad = lengths;
    bad[2] = f64::NAN;
    assert!(matches!(
        robot.position(&bad, &level.rotation, None, &options),
        Err(Error::InvalidInput { cable: Some(3), .. })
    ));
    // Two cables side by side and a third in their plane fix no position.
    let mut cables = [robot.cables()[0]; 3];
    for (i, c) in cables.iter_mut().enumerate() {
        c.anchor_m = Vector3::new(0.2 * i as f64, 0.0, 0.0);
        c.attachment_m = Vector3::zeros();
        c.pulley_radius_m = 0.0;
    }
    let planar = Robot::new(cables, *robot.platform()).unwrap();
    let pose = Pose::level(Vector3::new(0.15, 0.0, -0.3));
    let lengths = planar.lengths_m(&pose).unwrap();
    assert!(
        planar
            .position(&lengths, &pose.rotation, None, &options)
            .is_err()
    );
}

#[test]
fn the_dynamic_robot_gives_the_same_numbers() {
    let fixed = four_cables();
    let any = AnyRobot::new(fixed.cables(), *fixed.platform()).unwrap();
    assert_eq!(any.cable_count(), 4);
    let pose = Pose::from_rpy(Vector3::new(0.3, 0.1, -0.2), [0.1, -0.05, 0.2]);
    assert_eq!(
        &any.lengths_m(&pose).unwrap()[..],
        &fixed.lengths_m(&pose).unwrap()[..]
    );
    assert_eq!(
        &any.paths(&pose).unwrap()[..],
        &fixed.paths(&pose).unwrap()[..]
    );
    let euler = fixed.inverse(&pose).unwrap().euler_jacobian(pose.rpy());
    for (i, row) in any.euler_jacobian(&pose).unwrap().iter().enumerate() {
        for (k, x) in row.iter().enumerate() {
            assert!((x - euler[(i, k)]).abs() < 1e-15);
        }
    }
    assert!(matches!(
        any.position(&[0.4; 3], &pose.rotation, None, &ForwardOptions::default()),
        Err(Error::CableCount {
            expected: 4,
            got: 3
        })
    ));
    let cable = fixed.cables()[0];
    for n in 1..=16 {
        let robot = AnyRobot::new(&vec![cable; n], *fixed.platform()).unwrap();
        assert_eq!(robot.lengths_m(&pose).unwrap().len(), n);
    }
    assert!(AnyRobot::new(&[cable; 17], *fixed.platform()).is_err());
    assert!(AnyRobot::new(&[], *fixed.platform()).is_err());
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 2000,
        failure_persistence: None,
        rng_seed: proptest::test_runner::RngSeed::Fixed(7),
        ..ProptestConfig::default()
    })]
    #[test]
    fn no_pose_gives_nan(x in -2.0..2.0_f64, y in -2.0..2.0_f64, z in -2.0..2.0_f64,
                         angles in prop::array::uniform3(-4.0..4.0_f64)) {
        let pose = Pose::from_rpy(Vector3::new(x, y, z), angles);
        if let Ok(inverse) = four_cables().inverse(&pose) {
            for i in 0..4 {
                prop_assert!(inverse.lengths_m[i].is_finite() && inverse.lengths_m[i] > 0.0);
                prop_assert!((0.0..std::f64::consts::TAU).contains(&inverse.wraps_rad[i]));
                prop_assert!((inverse.direction(i).norm() - 1.0).abs() < 1e-12);
            }
        }
    }
}

#[test]
fn lengths_of_many_places_are_those_of_each_and_refusals_are_named() {
    let mut rng = ChaCha8Rng::seed_from_u64(12);
    let robot = random_robot(&mut rng);
    let rotation = random_pose(&mut rng).rotation;
    let mut places: Vec<_> = (0..500).map(|_| random_pose(&mut rng).position_m).collect();
    // Two places with an attachment at its anchor.
    let cable = &robot.cables()[2];
    for index in [40, 300] {
        places[index] = cable.anchor_m - rotation * cable.attachment_m;
    }
    let mut lengths = vec![0.0; 4 * places.len()];
    let refused = robot.lengths_of_places(&rotation, places.iter().copied(), &mut lengths);
    for (index, (place, row)) in places.iter().zip(lengths.chunks(4)).enumerate() {
        match robot.lengths_m(&Pose::new(*place, rotation)) {
            Ok(wanted) => assert_eq!(row, wanted, "place {index}"),
            Err(_) => assert!(row.iter().all(|n| n.is_nan()), "place {index}"),
        }
    }
    let wanted = robot.lengths_m(&Pose::new(places[40], rotation));
    assert_eq!(refused, Some((40, wanted.unwrap_err())));
    // The same with an attitude for each.
    let poses: Vec<_> = places
        .iter()
        .map(|place| Pose::new(*place, rotation))
        .collect();
    let mut again = vec![0.0; lengths.len()];
    assert_eq!(robot.lengths_of_poses(poses, &mut again), refused);
    let bits = |lengths: &[f64]| lengths.iter().map(|n| n.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(&again), bits(&lengths));
}
