//! Tensions of eight cables on six degrees of freedom, beside a general solver of quadratic programmes (Clarabel, P. J.
//! Goulart and Y. Chen 2024) in the same run: `cargo bench -p mcdpr-kinematics --bench redundant --features clarabel`.
//!
//! Poses are random, of the robot of `robots/eight-cable.toml`. Clarabel minimises the squared distance from the wished
//! tensions, as `distribute` does; the planner's `centred_tensions` minimises a barrier.

use clarabel::algebra::CscMatrix;
use clarabel::solver::{
    DefaultSettingsBuilder, DefaultSolver, IPSolver, NonnegativeConeT, SolverStatus, ZeroConeT,
};
use mcdpr_kinematics::{AnyGoal, AnyRobot, Balance, Band, Cable, Platform, Pose, distribute};
use mcdpr_kinematics::{Goal, Robot, TensionLimits};
use nalgebra::{Rotation3, Vector3, Vector6};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::hint::black_box;
use std::time::Instant;

const POSES: usize = 128;
const CABLES: usize = 8;
/// Least, wished and greatest tension, N.
const LEAST_N: f64 = 5.0;
const WISH_N: f64 = 40.0;
const MOST_N: f64 = 176.0;

/// Nanoseconds per call: the best of `runs` over all poses, which a busy machine disturbs least.
fn nanoseconds<T>(runs: usize, mut f: impl FnMut(usize) -> T) -> f64 {
    let mut best = f64::INFINITY;
    for _ in 0..runs {
        let start = Instant::now();
        for i in 0..POSES {
            black_box(f(black_box(i)));
        }
        best = best.min(start.elapsed().as_nanos() as f64 / POSES as f64);
    }
    best
}

fn cables() -> [Cable; CABLES] {
    let corner = |i: usize| {
        let x = if matches!(i % 4, 0 | 3) { 1.0 } else { -1.0 };
        let y = if i % 4 < 2 { 1.0 } else { -1.0 };
        (x, y)
    };
    std::array::from_fn(|i| {
        let ((x, y), up) = (corner(i), i < 4);
        let (far, near, high) = if up {
            (0.2, 0.1, -0.1)
        } else {
            (0.1, 0.2, 0.1)
        };
        Cable {
            anchor_m: Vector3::new(x, y, if up { 1.5 } else { 0.0 }),
            swivel_axis: Vector3::z() * if up { 1.0 } else { -1.0 },
            pulley_radius_m: 0.015,
            attachment_m: Vector3::new(far * x, near * y, high),
        }
    })
}

/// Clarabel's programme of one pose: `rows` are the six equations, `load` their right side.
fn programme(rows: &[[f64; CABLES]; 6], load: &[f64; 6]) -> DefaultSolver<f64> {
    let mut constraints: Vec<[f64; CABLES]> = rows.to_vec();
    let mut right: Vec<f64> = load.to_vec();
    for (sign, limit_n) in [(1.0, MOST_N), (-1.0, -LEAST_N)] {
        for cable in 0..CABLES {
            let mut row = [0.0; CABLES];
            row[cable] = sign;
            constraints.push(row);
            right.push(limit_n);
        }
    }
    let settings = DefaultSettingsBuilder::default().verbose(false).build();
    DefaultSolver::new(
        &CscMatrix::identity(CABLES),
        &[-WISH_N; CABLES],
        &CscMatrix::from(&constraints),
        &right,
        &[ZeroConeT(6), NonnegativeConeT(2 * CABLES)],
        settings.unwrap(),
    )
    .unwrap()
}

fn main() {
    let platform = Platform {
        mass_kg: 3.0,
        center_of_mass_m: Vector3::zeros(),
        inertia_kg_m2: None,
    };
    let robot = Robot::<CABLES>::new(cables(), platform).unwrap();
    let any = AnyRobot::new(&cables(), platform).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(8);
    let mut within = |half: f64| random.random_range(-half..half);
    let poses: Vec<Pose> = (0..POSES)
        .map(|_| {
            let at_m = Vector3::new(within(0.4), within(0.4), 0.75 + within(0.25));
            let turn = Vector3::new(within(0.15), within(0.15), within(0.15));
            Pose::new(at_m, Rotation3::new(turn))
        })
        .collect();
    // A cable pulls against the direction in which its length grows.
    let rows: Vec<[[f64; CABLES]; 6]> = poses
        .iter()
        .map(|pose| {
            let lengths = any.twist_jacobian(pose).unwrap();
            std::array::from_fn(|k| std::array::from_fn(|i| -lengths[i][k]))
        })
        .collect();
    let loads: Vec<[f64; 6]> = poses
        .iter()
        .map(|pose| (-robot.gravity_wrench(pose)).into())
        .collect();
    let limits = TensionLimits::uniform(LEAST_N, MOST_N);
    let goal = Goal::NearestTo([WISH_N; CABLES]);
    // Its lower limit is above the least of the tensions that are nearest to the wish.
    let narrow = TensionLimits::uniform(33.0, MOST_N);
    let all = |n: f64| [n; CABLES];
    let (min_n, max_n, wish_n) = (all(LEAST_N), all(MOST_N), all(WISH_N));
    let band = Band {
        min_n: &min_n,
        max_n: &max_n,
        wish_n: &wish_n,
    };
    let twists: Vec<Vector6<f64>> = (0..6).map(|k| Vector6::ith(k, 1.0)).collect();

    // The same answer first: a fast wrong one is worth nothing.
    let mut worst_n = 0.0_f64;
    for i in 0..POSES {
        let ours = distribute(&rows[i], &loads[i], &limits, &goal).unwrap();
        let mut theirs = programme(&rows[i], &loads[i]);
        theirs.solve();
        assert_eq!(theirs.solution.status, SolverStatus::Solved);
        for (a, b) in ours.tensions_n.iter().zip(&theirs.solution.x) {
            worst_n = worst_n.max((a - b).abs());
        }
    }
    println!("nearest to the wish: ours and Clarabel's differ by {worst_n:.1e} N at most");
    let possible: Vec<usize> = (0..POSES)
        .filter(|&i| distribute(&rows[i], &loads[i], &narrow, &goal).is_ok())
        .collect();
    println!(
        "narrow band: {} of {POSES} poses have tensions; measured there",
        possible.len()
    );

    let nearest = nanoseconds(200, |i| distribute(&rows[i], &loads[i], &limits, &goal));
    let at_limits = nanoseconds(200, |i| {
        let i = possible[i % possible.len()];
        distribute(&rows[i], &loads[i], &narrow, &goal)
    });
    let with_geometry = nanoseconds(200, |i| {
        let goal = AnyGoal::NearestTo(&wish_n);
        let nothing = Vector6::zeros();
        any.distribute(&poses[i], &nothing, Balance::Wrench, &min_n, &max_n, goal)
    });
    let centred = nanoseconds(200, |i| any.centred_tensions(&poses[i], &twists, &band));
    let mut solvers: Vec<_> = (0..POSES).map(|i| programme(&rows[i], &loads[i])).collect();
    // Its set-up is not counted.
    let clarabel = nanoseconds(20, |i| solvers[i].solve());
    for (name, ns) in [
        ("nearest to the wish, from the matrix", nearest),
        ("the same in the narrow band", at_limits),
        ("in the wide band, from the pose", with_geometry),
        ("centred (the planner's), from the pose", centred),
    ] {
        println!("{name:<40} {ns:8.0} ns  Clarabel/ours {:.1}", clarabel / ns);
    }
    println!("{:<40} {clarabel:8.0} ns", "Clarabel, solve alone");
}
