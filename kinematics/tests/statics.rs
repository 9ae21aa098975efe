//! Equilibrium, geometrico-static forward problem and linearisation against the energy itself.

use mcdpr_kinematics::*;
use nalgebra::{Matrix3, Rotation3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const TOOL: Vector3<f64> = Vector3::new(EXAMPLE_TOOL_M[0], EXAMPLE_TOOL_M[1], EXAMPLE_TOOL_M[2]);

fn hang_on(
    robot: &Robot<4>,
    tool: &Vector3<f64>,
    at: [f64; 3],
    t4: f64,
) -> Result<Equilibrium, Error> {
    robot.equilibrium_at(
        tool,
        &Vector3::from(at),
        &[None, None, None, Some(t4)],
        EquilibriumGuess::Cold,
        &StaticOptions::default(),
    )
}

fn hang(at: [f64; 3], t4: f64) -> Result<Equilibrium, Error> {
    hang_on(&four_cables(), &Vector3::zeros(), at, t4)
}

fn held_of(eq: &Equilibrium) -> [Held; 4] {
    std::array::from_fn(|i| {
        if eq.tension_held.contains(i) {
            Held::Tension(eq.tensions_n[i])
        } else {
            Held::Length(eq.lengths_m[i])
        }
    })
}

fn solve(held: &[Held; 4], start: Start<'_>) -> Result<Equilibrium, Error> {
    four_cables().geometrico_static(held, start, &StaticOptions::default())
}

/// Positions over the equilibrium-feasible workspace, by tension of cable 4.
fn feasible(t4: f64) -> Vec<Equilibrium> {
    let mut out = Vec::new();
    for i in 0..12 {
        for j in 0..12 {
            for k in 0..6 {
                let at = [
                    0.093 + 0.04 * f64::from(i),
                    -0.3 + 0.055 * f64::from(j),
                    -0.05 - 0.09 * f64::from(k),
                ];
                if let Ok(eq) = hang(at, t4)
                    && eq.stable
                {
                    out.push(eq);
                }
            }
        }
    }
    out
}

/// W z_com + T4 L4, and how far the length-held cables are over their lengths.
fn energy_and_excess(robot: &Robot<4>, held: &[Held; 4], pose: &Pose) -> (f64, f64) {
    let lengths = robot.lengths_m(pose).unwrap();
    let com = pose.transform(&robot.platform().center_of_mass_m);
    let mut energy = robot.weight_n() * com.z;
    let mut excess = f64::NEG_INFINITY;
    for (h, l) in held.iter().zip(lengths) {
        match h {
            Held::Length(limit) => excess = excess.max(l - limit),
            Held::Tension(t) => energy += t * l,
            Held::Elastic { .. } => unreachable!(),
        }
    }
    (energy, excess)
}

#[test]
fn equilibrium_balances_forces_and_moments_from_scratch() {
    let robot = four_cables();
    for at in [[0.33, 0.0, -0.1], [0.2, -0.1, -0.25], [0.45, 0.15, -0.15]] {
        let eq = hang_on(&robot, &TOOL, at, 6.0).unwrap();
        assert!((eq.pose.transform(&TOOL) - Vector3::from(at)).norm() < 1e-15);
        let paths = robot.paths(&eq.pose).unwrap();
        let mut force = Vector3::new(0.0, 0.0, -1.4 * GRAVITY_MPS2);
        let com = eq.pose.transform(&robot.platform().center_of_mass_m);
        let mut moment = com.cross(&force);
        for (path, t) in paths.iter().zip(&eq.tensions_n) {
            let f = -path.direction * *t;
            force += f;
            moment += path.attachment_m.cross(&f);
        }
        assert!(
            force.norm() < 1e-11 && moment.norm() < 1e-11,
            "{force} {moment}"
        );
        assert!(eq.tensions_n.iter().all(|t| *t > 0.0) && eq.tensions_n[3] == 6.0);
        assert!(eq.residual_n < 1e-10 && eq.slack.is_empty());
    }
}

#[test]
fn equilibrium_and_forward_problem_agree_over_the_workspace() {
    // The requirement is 99 % from a cold start; a pose that differs counts against it.
    let (mut tried, mut cold, mut warm) = (0, 0, 0);
    for t4 in [2.0, 5.0, 10.0] {
        for eq in feasible(t4) {
            tried += 1;
            let held = held_of(&eq);
            let distance = |found: &Equilibrium| {
                let turn = (found.pose.rotation.matrix() - eq.pose.rotation.matrix()).norm();
                (found.pose.position_m - eq.pose.position_m).norm() + 0.1 * turn
            };
            if let Ok(found) = solve(&held, Start::Cold) {
                assert!(found.residual_m < 1e-11 && found.stable);
                cold += i32::from(distance(&found) < 1e-10);
            }
            let mut near = eq;
            near.pose = eq.pose.displaced(
                &Vector3::new(0.003, -0.002, 0.001),
                &Vector3::new(0.01, 0.005, -0.01),
            );
            let found = solve(&held, Start::Warm(&near)).unwrap();
            warm += i32::from(distance(&found) < 1e-10);
        }
    }
    println!("cold start: {cold} of {tried}, warm start: {warm}");
    assert!(tried > 600, "{tried}");
    assert!(cold * 100 >= tried * 99, "{cold} of {tried}");
    assert_eq!(warm, tried);
}

#[test]
fn no_feasible_neighbour_has_less_energy() {
    let robot = four_cables();
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let mut compared = 0;
    for eq in feasible(5.0).iter().step_by(17) {
        let held = held_of(eq);
        let (lowest, _) = energy_and_excess(&robot, &held, &eq.pose);
        for _ in 0..4000 {
            let size = 10f64.powf(rng.random_range(-4.0..-1.5));
            let mut random = || Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0)) * size;
            let pose = eq
                .pose
                .displaced(&(random() + Vector3::z() * size * 0.7), &(random() * 5.0));
            if robot.lengths_m(&pose).is_err() {
                continue;
            }
            let (energy, excess) = energy_and_excess(&robot, &held, &pose);
            if excess <= 0.0 {
                compared += 1;
                assert!(energy >= lowest - 1e-12, "{size:e}: {energy} < {lowest}");
            }
        }
    }
    assert!(compared > 2000, "{compared}");
}

#[test]
fn a_cable_that_is_paid_out_goes_slack() {
    let eq = hang([0.33, 0.0, -0.2], 3.0).unwrap();
    let mut held = held_of(&eq);
    let Held::Length(l) = held[1] else { panic!() };
    // Nine more centimetres than the others need: two cables and the tension carry the platform.
    held[1] = Held::Length(l + 0.25);
    let found = solve(&held, Start::Warm(&eq)).unwrap();
    assert!(
        found.slack.contains(1) && found.slack.len() == 1,
        "{found:?}"
    );
    assert_eq!(found.tensions_n[1], 0.0);
    assert!(found.lengths_m[1] < l + 0.25);
    assert!(found.tensions_n.iter().all(|t| *t >= 0.0));
    let (lowest, excess) = energy_and_excess(&four_cables(), &held, &found.pose);
    assert!(excess < 1e-11);
    let cold = solve(&held, Start::Cold).unwrap();
    let (again, _) = energy_and_excess(&four_cables(), &held, &cold.pose);
    assert!((again - lowest).abs() < 1e-9, "{again} {lowest}");
}

#[test]
fn a_platform_on_one_cable_hangs_below_it() {
    let robot = four_cables();
    let held = [
        Held::Tension(0.0),
        Held::Length(0.4),
        Held::Tension(0.0),
        Held::Tension(0.0),
    ];
    let found = solve(&held, Start::Cold).unwrap();
    assert!((found.tensions_n[1] - robot.weight_n()).abs() < 1e-8);
    let paths = robot.paths(&found.pose).unwrap();
    assert!((paths[1].direction + Vector3::z()).norm() < 1e-6);
    // The centre of mass is below the attachment.
    let com = found.pose.transform(&robot.platform().center_of_mass_m);
    let across = com - paths[1].attachment_m;
    assert!(across.x.hypot(across.y) < 1e-6, "{across}");
}

#[test]
fn stiff_elastic_cables_approach_inextensible_ones() {
    let eq = hang([0.3, 0.05, -0.2], 6.0).unwrap();
    let rigid = held_of(&eq);
    let mut last = f64::INFINITY;
    for ea in [5e4, 5e6, 5e8] {
        let held = rigid.map(|h| match h {
            Held::Length(l) => Held::Elastic {
                unstretched_m: l,
                ea_n: ea,
                routing_m: 0.5,
            },
            other => other,
        });
        for start in [Start::Cold, Start::Warm(&eq)] {
            let found = solve(&held, start).unwrap();
            let moved = (found.pose.position_m - eq.pose.position_m).norm();
            assert!(moved < 150.0 / ea, "{ea:e} {moved:e}");
            for (i, h) in rigid.iter().enumerate().take(3) {
                let Held::Length(l) = *h else { panic!() };
                let spring = ea * (found.lengths_m[i] - l) / (l + 0.5);
                assert!((spring - found.tensions_n[i]).abs() < 1e-6 * ea.max(1e6) / 1e6);
            }
            if matches!(start, Start::Warm(_)) {
                assert!(moved < 0.02 * last);
                last = moved;
            }
        }
    }
}

#[test]
fn redundant_rigid_lengths_have_a_resting_pose() {
    // Eight inextensible cables cut to fit one pose exactly.
    let robot = eight_cables();
    let pose = Pose::from_rpy(Vector3::new(0.1, -0.05, 0.7), [0.05, -0.03, 0.1]);
    let lengths = robot.lengths_m(&pose).unwrap();
    let held = lengths.map(Held::Length);
    let near = Pose::level(pose.position_m + Vector3::new(0.01, 0.0, -0.01));
    let found = robot
        .geometrico_static(&held, Start::Pose(&near), &StaticOptions::default())
        .unwrap();
    assert!(
        (found.pose.position_m - pose.position_m).norm() < 1e-9,
        "{found:?} {pose:?}"
    );
    assert!(found.tensions_n.iter().all(|t| *t >= 0.0));
}

#[test]
fn mirrored_robots_have_mirrored_equilibria() {
    let mut cables = *four_cables().cables();
    for (i, (x, y)) in [(0.03, -0.38), (0.03, 0.38), (0.64, 0.38), (0.64, -0.38)]
        .into_iter()
        .enumerate()
    {
        cables[i].anchor_m = Vector3::new(x, y, 0.024);
    }
    let robot = Robot::new(cables, *four_cables().platform()).unwrap();
    let options = StaticOptions::default();
    let at = |y: f64, tensions: [Option<f64>; 4]| {
        robot
            .equilibrium_at(
                &TOOL,
                &Vector3::new(0.3, y, -0.25),
                &tensions,
                EquilibriumGuess::Cold,
                &options,
            )
            .unwrap()
    };
    // Mirroring y exchanges cables 3 and 4, so the held one moves, too.
    let a = at(0.07, [None, None, None, Some(7.0)]);
    let b = at(-0.07, [None, None, Some(7.0), None]);
    for (i, j) in [(0, 1), (1, 0), (2, 3), (3, 2)] {
        assert!((a.tensions_n[i] - b.tensions_n[j]).abs() < 1e-9);
        assert!((a.lengths_m[i] - b.lengths_m[j]).abs() < 1e-11);
    }
    let mirror = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, 1.0));
    let image = mirror * a.pose.rotation.matrix() * mirror;
    assert!((image - b.pose.rotation.matrix()).norm() < 1e-10);
}

#[test]
fn only_the_ratio_of_tension_to_weight_matters() {
    let light = four_cables();
    let mut platform = *light.platform();
    platform.mass_kg *= 2.0;
    let heavy = Robot::new(*light.cables(), platform).unwrap();
    let a = hang_on(&light, &TOOL, [0.3, 0.1, -0.3], 5.0).unwrap();
    let b = hang_on(&heavy, &TOOL, [0.3, 0.1, -0.3], 10.0).unwrap();
    assert!((a.pose.rotation.matrix() - b.pose.rotation.matrix()).norm() < 1e-11);
    for i in 0..4 {
        assert!((2.0 * a.tensions_n[i] - b.tensions_n[i]).abs() < 1e-9);
    }
}

#[test]
fn the_linear_response_agrees_with_solved_neighbours() {
    let robot = four_cables();
    let eq = hang([0.25, 0.08, -0.22], 6.0).unwrap();
    let linear = robot.linearise(&eq).unwrap();
    let held = held_of(&eq);
    let output = |e: &Equilibrium| -> [f64; 4] {
        std::array::from_fn(|i| {
            if i == 3 {
                e.lengths_m[3]
            } else {
                e.tensions_n[i]
            }
        })
    };
    for input in 0..4 {
        let step = if input == 3 { 1e-3 } else { 1e-5 };
        let at = |s: f64| {
            let mut held = held;
            match &mut held[input] {
                Held::Length(x) | Held::Tension(x) => *x += s,
                Held::Elastic { .. } => unreachable!(),
            }
            solve(&held, Start::Warm(&eq)).unwrap()
        };
        let (plus, minus) = (at(step), at(-step));
        for k in 0..4 {
            let want = (output(&plus)[k] - output(&minus)[k]) / (2.0 * step);
            let got = linear.response[(k, input)];
            assert!(
                (got - want).abs() < 1e-5 * want.abs().max(0.01),
                "{k} {input}: {got} {want}"
            );
        }
        let moved = (plus.pose.position_m - minus.pose.position_m) / (2.0 * step);
        for k in 0..3 {
            let got = linear.pose[input][k];
            assert!((got - moved[k]).abs() < 1e-5 * moved.norm().max(1e-3));
        }
    }
    // Reciprocity (Maxwell-Betti): dl4/dl_i = -dT_i/dT4.
    for i in 0..3 {
        let (a, b) = (linear.response[(3, i)], linear.response[(i, 3)]);
        assert!((a + b).abs() < 1e-9);
    }
}

#[test]
fn the_tool_sensitivity_agrees_with_solved_neighbours() {
    let robot = four_cables();
    let at = [0.25, 0.08, -0.3];
    let eq = hang_on(&robot, &TOOL, at, 6.0).unwrap();
    let s = robot.tool_sensitivity(&eq, &TOOL).unwrap();
    let compare = |plus: &Equilibrium,
                   minus: &Equilibrium,
                   step: f64,
                   column: &dyn Fn(usize) -> [f64; 2],
                   turn: Vector3<f64>| {
        for i in 0..4 {
            let [length, tension] = column(i);
            let want = (plus.lengths_m[i] - minus.lengths_m[i]) / (2.0 * step);
            assert!(
                (length - want).abs() < 1e-6 * want.abs().max(0.1),
                "{length} {want}"
            );
            let want = (plus.tensions_n[i] - minus.tensions_n[i]) / (2.0 * step);
            assert!(
                (tension - want).abs() < 1e-6 * want.abs().max(1.0),
                "{tension} {want}"
            );
        }
        let change = plus.pose.rotation * minus.pose.rotation.inverse();
        let want = change.scaled_axis() / (2.0 * step);
        assert!((want - turn).norm() < 1e-6 * want.norm().max(0.1));
    };
    for k in 0..3 {
        let step = 1e-5;
        let moved = |d: f64| {
            let mut at = at;
            at[k] += d;
            hang_on(&robot, &TOOL, at, 6.0).unwrap()
        };
        compare(
            &moved(step),
            &moved(-step),
            step,
            &|i| [s.lengths_per_position[i][k], s.tensions_per_position[i][k]],
            s.rotation_per_position.column(k).into(),
        );
    }
    let step = 1e-3;
    compare(
        &hang_on(&robot, &TOOL, at, 6.0 + step).unwrap(),
        &hang_on(&robot, &TOOL, at, 6.0 - step).unwrap(),
        step,
        &|i| {
            [
                s.lengths_per_tension[(i, 3)],
                s.tensions_per_tension[(i, 3)],
            ]
        },
        Vector3::from(s.rotation_per_tension[3]),
    );
}

#[test]
fn modes_of_a_plumb_pendulum_are_the_textbook_ones() {
    // A point-anchored cable held at the centre of mass: spherical pendulum, f = sqrt(g/l)/(2 pi),
    // and a platform that turns freely about its centre of mass.
    let mut platform = example_platform();
    platform.center_of_mass_m = Vector3::zeros();
    let cable = Cable {
        anchor_m: Vector3::zeros(),
        swivel_axis: Vector3::z(),
        pulley_radius_m: 0.0,
        attachment_m: Vector3::zeros(),
    };
    let robot = Robot::new([cable], platform).unwrap();
    // On the axis itself the swivel is undefined: a micrometre aside changes nothing that matters.
    let pose = Pose::level(Vector3::new(1e-9, 0.0, -0.5));
    let eq = Equilibrium {
        pose,
        tensions_n: CableVec::from_slice(&[robot.weight_n()]).unwrap(),
        lengths_m: CableVec::from_slice(&[0.5]).unwrap(),
        slack: CableSet::default(),
        tension_held: CableSet::default(),
        axial_stiffness_n_per_m: CableVec::filled(1),
        residual_n: 0.0,
        residual_m: 0.0,
        iterations: 0,
        stable: true,
    };
    let s = robot.stability(&eq).unwrap();
    assert_eq!((s.freedoms, s.modes_hz.len()), (5, 5));
    let want = (GRAVITY_MPS2 / 0.5).sqrt() / std::f64::consts::TAU;
    assert!(
        s.modes_hz[..3].iter().all(|f| f.abs() < 1e-6),
        "{:?}",
        s.modes_hz
    );
    assert!(
        s.modes_hz[3..].iter().all(|f| (f - want).abs() < 1e-9),
        "{:?}",
        s.modes_hz
    );
}

#[test]
fn the_four_cable_robot_swings_at_a_few_hertz() {
    let robot = four_cables();
    let eq = hang([0.3, 0.02, -0.2], 5.0).unwrap();
    let s = robot.stability(&eq).unwrap();
    assert!(s.stable && s.freedoms == 3 && s.modes_hz.len() == 3);
    assert!(
        s.modes_hz.iter().all(|f| (0.5..10.0).contains(f)),
        "{:?}",
        s.modes_hz
    );
    // Rayleigh: along a solved displacement that keeps the three lengths, the energy rises by
    // half the stiffness times its square.
    let held = held_of(&eq);
    let linear = robot.linearise(&eq).unwrap();
    let d = linear.pose[3];
    let (lowest, _) = energy_and_excess(&robot, &held, &eq.pose);
    let mut pulled = held;
    pulled[3] = Held::Tension(5.0 + 0.02);
    let moved = solve(&pulled, Start::Warm(&eq)).unwrap();
    let (energy, _) = energy_and_excess(&robot, &held, &moved.pose);
    let q = nalgebra::Vector6::from(d) * 0.02;
    let want = 0.5 * q.dot(&(s.stiffness * q));
    assert!(
        (energy - lowest - want).abs() < 0.02 * want,
        "{} {want}",
        energy - lowest
    );
    let elastic = {
        let mut eq = eq;
        eq.axial_stiffness_n_per_m = CableVec::from_fn(4, |i| if i < 3 { 1e5 } else { 0.0 });
        robot.stability(&eq).unwrap()
    };
    assert_eq!(elastic.modes_hz.len(), 6);
    for (a, b) in elastic.modes_hz.iter().zip(&s.modes_hz) {
        assert!(a <= b && a > &(0.98 * b), "{a} {b}");
    }
}

#[test]
fn what_cannot_hang_is_refused_by_name() {
    assert!(matches!(
        hang([0.05, -0.3, -0.4], 20.0),
        Err(Error::NegativeTension { .. })
    ));
    assert!(matches!(
        hang([0.3, 0.0, f64::NAN], 5.0),
        Err(Error::InvalidInput { .. })
    ));
    let robot = four_cables();
    let options = StaticOptions::default();
    let at = Vector3::new(0.3, 0.0, -0.2);
    for (tensions, needed) in [
        ([None, None, Some(3.0), Some(3.0)], Some(2)),
        ([None; 4], None),
        ([None, None, None, Some(-1.0)], None),
    ] {
        let got = robot.equilibrium_at(&TOOL, &at, &tensions, EquilibriumGuess::Cold, &options);
        match (got, needed) {
            (Err(Error::TooFewCables { got, .. }), Some(n)) => assert_eq!(got, n),
            (Err(Error::InvalidInput { .. }), None) => {}
            other => panic!("{other:?}"),
        }
    }
    let held = [
        Held::Length(0.4),
        Held::Length(0.4),
        Held::Length(f64::NAN),
        Held::Tension(1.0),
    ];
    assert!(matches!(
        solve(&held, Start::Cold),
        Err(Error::InvalidInput { cable: Some(3), .. })
    ));
    // Only weak tensions: the platform falls. The message must say so.
    assert!(solve(&[Held::Tension(0.1); 4], Start::Cold).is_err());
}

#[test]
fn lengths_too_short_for_the_frame_do_not_give_a_pose() {
    let held = [
        Held::Length(0.1),
        Held::Length(0.1),
        Held::Length(0.1),
        Held::Tension(1.0),
    ];
    assert!(solve(&held, Start::Cold).is_err());
}

#[test]
fn continuation_from_a_bad_attitude_still_ends_at_the_equilibrium() {
    let robot = four_cables();
    let at = Vector3::new(0.2, -0.15, -0.4);
    let tensions = [None, None, None, Some(2.0)];
    let options = StaticOptions::default();
    let reference = robot
        .equilibrium_at(&TOOL, &at, &tensions, EquilibriumGuess::Cold, &options)
        .unwrap();
    let guess = EquilibriumGuess::Attitude(Rotation3::from_euler_angles(0.3, -0.3, 0.4));
    let found = robot
        .equilibrium_at(&TOOL, &at, &tensions, guess, &options)
        .unwrap();
    assert!((found.pose.position_m - reference.pose.position_m).norm() < 1e-10);
}

#[test]
fn level_inverse_kinematics_misses_the_grasp_point_by_38_mm() {
    // A figure found elsewhere for this robot at 2 kg (in a simulator with other geometry code): with
    // the lengths of a level platform at (252, -39, -517) mm and 10 N in cable 4 it comes to rest
    // 38 mm away, with cable 3 slack.
    let mut platform = example_platform();
    platform.mass_kg = 2.0;
    let robot = Robot::new(*four_cables().cables(), platform).unwrap();
    let grasp = Vector3::new(0.252, -0.039, -0.517);
    let mut held = robot
        .lengths_m(&Pose::level(grasp))
        .unwrap()
        .map(Held::Length);
    held[3] = Held::Tension(10.0);
    let found = robot
        .geometrico_static(&held, Start::Cold, &StaticOptions::default())
        .unwrap();
    let miss = (found.pose.position_m - grasp).norm();
    assert!((miss - 0.038).abs() < 5e-4, "{miss}");
    assert!(found.slack.contains(2) && found.slack.len() == 1);
}

#[test]
fn any_mix_of_held_lengths_and_tensions_is_solved_from_cold() {
    let mut rng = ChaCha8Rng::seed_from_u64(12);
    let robot = four_cables();
    for tension_held in 0..3 {
        for _ in 0..400 {
            let pose = Pose::level(Vector3::new(
                rng.random_range(0.1..0.55),
                rng.random_range(-0.28..0.28),
                rng.random_range(-0.6..-0.05),
            ));
            let lengths = robot.lengths_m(&pose).unwrap();
            let first: usize = rng.random_range(0..4);
            let mut held = lengths.map(|l| Held::Length(l * rng.random_range(1.0..1.05)));
            for k in 0..tension_held {
                held[(first + k) % 4] = Held::Tension(rng.random_range(0.5..8.0));
            }
            let found = solve(&held, Start::Cold).unwrap();
            assert!(found.stable && found.pose.tilt_rad() < 1.2);
            assert!(found.residual_n < 1e-8 && found.residual_m < 1e-11);
            assert!(found.tensions_n.iter().all(|t| *t >= 0.0));
        }
    }
}
