//! Tension distributions and workspaces against exhaustive computations.

#![allow(clippy::needless_range_loop)] // Index loops over parallel arrays.

use mcdpr_kinematics::*;
use nalgebra::{Rotation3, SMatrix, Vector3, Vector6};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn random_matrix<const K: usize, const N: usize>(rng: &mut ChaCha8Rng) -> [[f64; N]; K] {
    std::array::from_fn(|_| std::array::from_fn(|_| rng.random_range(-1.0..1.0)))
}

fn times<const K: usize, const N: usize>(a: &[[f64; N]; K], t: &[f64; N]) -> [f64; K] {
    std::array::from_fn(|k| (0..N).map(|i| a[k][i] * t[i]).sum())
}

/// The optimum by trying every set of cables at their limits (3^N equality-constrained problems).
fn exhaustive<const K: usize, const N: usize>(
    a: &[[f64; N]; K],
    load: &[f64; K],
    limits: &TensionLimits<N>,
    target: &[f64; N],
) -> Option<([f64; N], f64)> {
    let mut best: Option<([f64; N], f64)> = None;
    for code in 0..3_usize.pow(N as u32) {
        let state: [usize; N] = std::array::from_fn(|i| code / 3_usize.pow(i as u32) % 3);
        let mut t: [f64; N] = std::array::from_fn(|i| match state[i] {
            0 => target[i],
            1 => limits.min_n[i],
            _ => limits.max_n[i],
        });
        let m = SMatrix::<f64, K, N>::from_fn(|k, i| if state[i] == 0 { a[k][i] } else { 0.0 });
        let rest = nalgebra::SVector::<f64, K>::from_fn(|k, _| load[k] - times(a, &t)[k]);
        let gram = m * m.transpose();
        let Some(inverse) = gram.try_inverse() else {
            continue;
        };
        let change = m.transpose() * (inverse * rest);
        for i in 0..N {
            t[i] += change[i];
        }
        let inside =
            (0..N).all(|i| t[i] >= limits.min_n[i] - 1e-9 && t[i] <= limits.max_n[i] + 1e-9);
        let balanced = (0..K).all(|k| (times(a, &t)[k] - load[k]).abs() < 1e-7);
        if inside && balanced {
            let cost = (0..N).map(|i| (t[i] - target[i]).powi(2)).sum::<f64>();
            if best.is_none_or(|(_, c)| cost < c) {
                best = Some((t, cost));
            }
        }
    }
    best
}

fn compare<const K: usize, const N: usize>(seed: u64, rounds: usize) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (mut solved, mut refused) = (0, 0);
    for round in 0..rounds {
        let a = random_matrix::<K, N>(&mut rng);
        let limits = TensionLimits::<N>::uniform(1.0, 10.0);
        let inner: [f64; N] = std::array::from_fn(|_| {
            // Every other load has a distribution within the limits.
            let reach = if round % 2 == 0 { 4.4 } else { 7.0 };
            5.5 + rng.random_range(-reach..reach)
        });
        let load = times(&a, &inner);
        let goals = [
            (Goal::Middle, [5.5; N]),
            (Goal::MinimumNorm, [0.0; N]),
            (Goal::NearestTo([3.0; N]), [3.0; N]),
        ];
        for (goal, target) in goals {
            let got = distribute(&a, &load, &limits, &goal);
            match (got, exhaustive(&a, &load, &limits, &target)) {
                (Ok(found), Some((want, _))) => {
                    solved += 1;
                    for i in 0..N {
                        let d = (found.tensions_n[i] - want[i]).abs();
                        assert!(d < 1e-6, "{K}x{N} cable {i}: {d:e}");
                        assert!((1.0..=10.0).contains(&found.tensions_n[i]));
                        let at = (want[i] - 1.0).abs() < 1e-12 || (want[i] - 10.0).abs() < 1e-12;
                        assert!(!at || found.at_limit.contains(i));
                    }
                    for (x, y) in times(&a, &found.tensions_n).iter().zip(load) {
                        assert!((x - y).abs() < 1e-8, "{:e}", x - y);
                    }
                }
                (Err(Error::OutsideTensionLimits { violation_n, .. }), None) => {
                    refused += 1;
                    assert!(violation_n > 0.0);
                }
                (got, want) => panic!("{K}x{N}: {got:?} against {want:?}"),
            }
        }
    }
    assert!(
        solved > 0 && (refused > 0 || rounds <= 10),
        "{solved} {refused}"
    );
}

#[test]
fn one_degree_of_redundancy_is_exact() {
    compare::<3, 4>(1, 300);
    compare::<6, 7>(2, 8);
    compare::<1, 2>(3, 500);
}

#[test]
fn more_degrees_of_redundancy_are_exact() {
    compare::<3, 5>(4, 150);
    compare::<3, 6>(5, 40);
    compare::<6, 8>(6, 2);
    compare::<1, 5>(7, 100);
}

#[test]
fn infeasible_loads_name_the_cable() {
    // One cable up, one down, and a load that the upper one cannot carry.
    let a = [[1.0, -1.0]];
    let limits = TensionLimits::uniform(1.0, 10.0);
    // 41 N are missing and the two share them.
    match distribute(&a, &[50.0], &limits, &Goal::Middle) {
        Err(Error::OutsideTensionLimits { violation_n, .. }) => {
            assert!((violation_n - 20.5).abs() < 1e-12);
        }
        other => panic!("{other:?}"),
    }
    // The same with cable 1 twice as effective: it takes the larger part.
    let got = distribute(&[[1.0, -0.5]], &[50.0], &limits, &Goal::Middle);
    assert!(matches!(
        got,
        Err(Error::OutsideTensionLimits {
            cable: 1,
            bound: mcdpr_kinematics::Bound::Maximum,
            ..
        })
    ));
}

#[test]
fn too_few_cables_balance_only_their_own_wrenches() {
    let robot = four_cables();
    let limits = TensionLimits::uniform(0.5, 40.0);
    let zero = Vector6::zeros();
    // Level and off the middle: forces can be balanced, moments cannot.
    let level = Pose::level(Vector3::new(0.25, 0.1, -0.25));
    assert!(matches!(
        robot.distribute(&level, &zero, &limits, &Goal::Middle),
        Err(Error::WrenchNotBalanced { .. })
    ));
    assert!(
        robot
            .distribute_forces(&level, &Vector3::zeros(), &limits, &Goal::Middle)
            .is_ok()
    );
    // At an equilibrium the tensions are its own.
    let eq = robot
        .equilibrium_at(
            &Vector3::zeros(),
            &level.position_m,
            &[None, None, None, Some(6.0)],
            EquilibriumGuess::Cold,
            &StaticOptions::default(),
        )
        .unwrap();
    let found = robot
        .distribute(&eq.pose, &zero, &limits, &Goal::Middle)
        .unwrap();
    for i in 0..4 {
        assert!((found.tensions_n[i] - eq.tensions_n[i]).abs() < 1e-9);
    }
}

#[test]
fn the_eight_cable_robot_carries_itself_and_a_push() {
    let robot = eight_cables();
    let limits = TensionLimits::uniform(5.0, 150.0);
    let pose = Pose::from_rpy(Vector3::new(0.1, -0.1, 0.7), [0.05, 0.0, 0.1]);
    let push = Vector6::new(5.0, -3.0, 2.0, 0.2, 0.1, -0.3);
    let found = robot
        .distribute(&pose, &push, &limits, &Goal::MinimumNorm)
        .unwrap();
    let structure = robot.inverse(&pose).unwrap().structure_matrix();
    let t = nalgebra::SVector::<f64, 8>::from(found.tensions_n);
    let left = structure * t + robot.gravity_wrench(&pose) + push;
    assert!(left.norm() < 1e-9, "{left}");
    let any = AnyRobot::new(robot.cables(), *robot.platform()).unwrap();
    let same = any
        .distribute(
            &pose,
            &push,
            Balance::Wrench,
            &[5.0; 8],
            &[150.0; 8],
            AnyGoal::MinimumNorm,
        )
        .unwrap();
    assert_eq!(&same[..], &found.tensions_n[..]);
    let heavy = Vector6::new(0.0, 0.0, -2000.0, 0.0, 0.0, 0.0);
    let error = robot
        .distribute(&pose, &heavy, &limits, &Goal::Middle)
        .unwrap_err();
    // An upper cable is overloaded.
    assert!(
        matches!(
            error,
            Error::OutsideTensionLimits {
                cable: 1..=4,
                bound: mcdpr_kinematics::Bound::Maximum,
                ..
            }
        ),
        "{error}"
    );
}

#[test]
fn bad_input_is_an_error() {
    let limits = TensionLimits::<4>::uniform(1.0, 10.0);
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let a = random_matrix::<3, 4>(&mut rng);
    assert!(distribute(&a, &[f64::NAN, 0.0, 1.0], &limits, &Goal::Middle).is_err());
    let mut nan = a;
    nan[1][2] = f64::NAN;
    assert!(distribute(&nan, &[0.0, 0.0, 1.0], &limits, &Goal::Middle).is_err());
    for bad in [
        TensionLimits::uniform(5.0, 1.0),
        TensionLimits::uniform(-1.0, 1.0),
        TensionLimits::uniform(f64::NAN, 1.0),
        TensionLimits::uniform(1.0, f64::INFINITY),
    ] {
        assert!(matches!(
            distribute(&a, &[0.0, 0.0, 1.0], &bad, &Goal::Middle),
            Err(Error::InvalidInput { cable: Some(1), .. })
        ));
    }
    let flat = [
        [1.0, 0.5, 0.2, 0.1],
        [2.0, 1.0, 0.4, 0.2],
        [0.0, 0.0, 0.0, 1.0],
    ];
    assert_eq!(
        distribute(&flat, &[1.0, 2.0, 3.0], &limits, &Goal::Middle),
        Err(Error::Singular {
            solver: Solver::TensionDistribution
        })
    );
}

#[test]
fn the_vectorised_workspace_is_the_one_of_single_poses() {
    let robot = four_cables();
    let grid = Grid {
        min_m: Vector3::new(-0.05, -0.5, -0.6),
        max_m: Vector3::new(0.7, 0.5, 0.1),
        counts: [29, 31, 13],
    };
    let rotation = Rotation3::from_euler_angles(0.02, -0.05, 0.1);
    let limits = TensionLimits::uniform(3.0, 39.0);
    let test = WorkspaceTest::Forces { rotation, limits };
    let all = robot.workspace(&grid, &test).unwrap();
    let mut kinds = [0; 3];
    for (k, verdict) in all.iter().enumerate() {
        let single = robot.assess(&grid.point_m(k), &test).unwrap();
        assert_eq!(*verdict, single, "point {k} {:?}", grid.point_m(k));
        let direct = robot.distribute_forces(
            &Pose::new(grid.point_m(k), rotation),
            &Vector3::zeros(),
            &limits,
            &Goal::Middle,
        );
        assert_eq!(verdict.is_feasible(), direct.is_ok());
        kinds[match verdict {
            Verdict::Feasible => 0,
            Verdict::Limited { .. } => 1,
            _ => 2,
        }] += 1;
    }
    assert!(kinds[0] > 1000 && kinds[1] > 1000, "{kinds:?}");
    // Parts of the grid, odd offsets included, are the same cells.
    let mut part = vec![Verdict::default(); 101];
    robot.assess_range(&grid, &test, 1234, &mut part).unwrap();
    assert_eq!(part[..], all[1234..1335]);
}

#[test]
fn the_equilibrium_workspace_names_what_limits_it() {
    let robot = four_cables();
    let grid = Grid::slice([0.1, -0.3], [0.6, 0.3], -0.2, [11, 13]);
    let test = WorkspaceTest::Equilibrium {
        tool_in_platform_m: Vector3::from(EXAMPLE_TOOL_M),
        tensions_n: [None, None, None, Some(5.0)],
        limits: TensionLimits::uniform(1.0, 20.0),
        tilt_max_rad: 12_f64.to_radians(),
    };
    let cells = robot.workspace(&grid, &test).unwrap();
    let count = |f: &dyn Fn(&Verdict) -> bool| cells.iter().filter(|v| f(v)).count();
    assert!(count(&|v| v.is_feasible()) > 10);
    assert!(count(&|v| matches!(v, Verdict::Limited { .. })) > 10);
    assert!(count(&|v| *v == Verdict::Tilted) > 0, "{cells:?}");
    for (k, v) in cells.iter().enumerate() {
        let got = robot.equilibrium_at(
            &Vector3::from(EXAMPLE_TOOL_M),
            &grid.point_m(k),
            &[None, None, None, Some(5.0)],
            EquilibriumGuess::Cold,
            &StaticOptions::default(),
        );
        if v.is_feasible() {
            let eq = got.unwrap();
            assert!(eq.stable && eq.tensions_n.iter().all(|t| (1.0..=20.0).contains(t)));
        } else if let (Some(cable), Ok(eq)) = (v.limiting_cable(), got) {
            assert!(!(1.0..=20.0).contains(&eq.tensions_n[cable - 1]));
        }
    }
}

#[test]
fn the_eight_cable_workspace_is_bounded_by_its_frame() {
    let robot = eight_cables();
    let test = WorkspaceTest::Wrench {
        rotation: Rotation3::identity(),
        limits: TensionLimits::uniform(5.0, 200.0),
    };
    assert!(
        robot
            .assess(&Vector3::new(0.0, 0.0, 0.75), &test)
            .unwrap()
            .is_feasible()
    );
    assert!(
        !robot
            .assess(&Vector3::new(1.5, 0.0, 0.75), &test)
            .unwrap()
            .is_feasible()
    );
    assert!(
        robot
            .assess(&Vector3::new(f64::NAN, 0.0, 0.75), &test)
            .is_err()
    );
}

#[test]
fn interference_distances_are_those_of_the_segments() {
    let robot = four_cables();
    let pose = Pose::level(Vector3::new(0.3, 0.0, -0.2));
    let pair = robot.closest_cables(&pose).unwrap().unwrap();
    let paths = robot.paths(&pose).unwrap();
    let mut smallest = f64::INFINITY;
    for i in 0..4 {
        for j in i + 1..4 {
            for s in 0..=60 {
                for t in 0..=60 {
                    let p = |k: usize, x: i32| {
                        let (a, b) = (paths[k].tangent_point_m, paths[k].attachment_m);
                        a + (b - a) * (f64::from(x) / 60.0)
                    };
                    smallest = smallest.min((p(i, s) - p(j, t)).norm());
                }
            }
        }
    }
    // The attachments 90 mm apart are the closest points.
    assert!((pair.distance_m - 0.09).abs() < 1e-12 && (smallest - 0.09).abs() < 1e-12);
    let body = PlatformBox {
        center_m: Vector3::new(0.0, 0.0, -0.025),
        half_size_m: Vector3::new(0.045, 0.065, 0.02),
    };
    let clear = robot.closest_to_platform(&pose, &body, 0.02).unwrap();
    assert!(
        clear.distance_m > 0.005 && clear.distance_m < 0.03,
        "{clear:?}"
    );
    // From below, the cables of a platform above the frame cut through a body on top of it.
    let above = Pose::level(Vector3::new(0.3, 0.0, 0.3));
    let deep = PlatformBox {
        center_m: Vector3::zeros(),
        half_size_m: Vector3::new(0.1, 0.1, 0.1),
    };
    assert_eq!(
        robot
            .closest_to_platform(&above, &deep, 0.02)
            .unwrap()
            .distance_m,
        0.0
    );
}
