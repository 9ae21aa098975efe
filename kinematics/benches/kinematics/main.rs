//! Speed against a plain transcription, in the same process. Each line of the first part is one
//! measurement of both, interleaved: `cargo bench -p mcdpr-kinematics`.

mod plain;

use std::hint::black_box;
use std::time::{Duration, Instant};

use criterion::Criterion;
use mcdpr_kinematics::*;
use nalgebra::{Rotation3, SVector, Vector3};
use plain::Plain;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const POSES: usize = 256;

/// Nanoseconds per call: the best of many short runs over all inputs, which a busy machine disturbs
/// least.
fn nanoseconds<T>(inputs: usize, mut f: impl FnMut(usize) -> T) -> f64 {
    let mut best = f64::INFINITY;
    for _ in 0..400 {
        let start = Instant::now();
        for i in 0..inputs {
            black_box(f(black_box(i)));
        }
        best = best.min(start.elapsed().as_nanos() as f64 / inputs as f64);
    }
    best
}

/// `slowness` is the ratio of this machine's time to that of the machine where the targets were
/// set.
fn line(name: &str, plain_ns: Option<f64>, ours_ns: f64, target_ns: f64, slowness: f64) {
    let ratio = plain_ns.map_or(String::new(), |p| {
        format!("  plain {p:8.1} ns  ratio plain/ours = {:.2}", p / ours_ns)
    });
    let target = if target_ns.is_finite() {
        let scaled = ours_ns / slowness;
        let reached = if scaled <= target_ns {
            "reached"
        } else {
            "MISSED"
        };
        format!("  scaled {scaled:7.1} ns, target {target_ns:6.1} ns {reached}")
    } else {
        String::new()
    };
    println!("{name:<42} ours {ours_ns:8.1} ns{target}{ratio}");
}

struct Inputs {
    robot: Robot<4>,
    plain: Plain,
    poses: Vec<Pose>,
    near: Vec<Pose>,
    lengths: Vec<[f64; 4]>,
    hanging: Vec<Equilibrium>,
    held: Vec<[Held; 4]>,
    warm: Vec<Equilibrium>,
}

fn inputs() -> Inputs {
    let robot = four_cables();
    let mut rng = ChaCha8Rng::seed_from_u64(42);
    let mut unit = || Vector3::from_fn(|_, _| rng.random_range(-1.0_f64..1.0)).normalize();
    let steps: Vec<Vector3<f64>> = (0..POSES).map(|_| unit()).collect();
    let mut rng = ChaCha8Rng::seed_from_u64(43);
    let poses: Vec<Pose> = (0..POSES)
        .map(|_| {
            Pose::from_rpy(
                Vector3::new(
                    rng.random_range(0.15..0.5),
                    rng.random_range(-0.2..0.2),
                    rng.random_range(-0.5..-0.1),
                ),
                std::array::from_fn(|_| rng.random_range(-0.1..0.1)),
            )
        })
        .collect();
    let near = (0..POSES)
        .map(|i| Pose::new(poses[i].position_m + steps[i] * 5e-3, poses[i].rotation))
        .collect();
    let lengths = poses.iter().map(|p| robot.lengths_m(p).unwrap()).collect();
    let mut hanging = Vec::new();
    let mut warm = Vec::new();
    let mut held = Vec::new();
    // Neighbours along a path: the tool moves 1 mm per planning step.
    let mut k = 0;
    while hanging.len() < POSES {
        let at = poses[k % POSES].position_m + Vector3::x() * 1e-4 * (k / POSES) as f64;
        let solve = |at: Vector3<f64>| {
            robot
                .equilibrium_at(
                    &Vector3::zeros(),
                    &at,
                    &[None, None, None, Some(4.0)],
                    EquilibriumGuess::Cold,
                    &StaticOptions::default(),
                )
                .ok()
                .filter(|eq| eq.stable)
        };
        if let (Some(a), Some(b)) = (solve(at), solve(at + steps[k % POSES] * 1e-3)) {
            held.push(std::array::from_fn(|i| {
                if i == 3 {
                    Held::Tension(4.0)
                } else {
                    Held::Length(a.lengths_m[i])
                }
            }));
            hanging.push(a);
            warm.push(b);
        }
        k += 1;
    }
    Inputs {
        plain: Plain {
            cables: *robot.cables(),
            weight_n: robot.weight_n(),
        },
        robot,
        poses,
        near,
        lengths,
        hanging,
        held,
        warm,
    }
}

fn ratios(x: &Inputs) {
    let (robot, plain) = (&x.robot, &x.plain);
    // The reference must compute the same values.
    for pose in &x.poses {
        let (a, b) = (robot.inverse(pose).unwrap(), plain.inverse(pose).unwrap());
        for i in 0..4 {
            assert!((a.lengths_m[i] - b.lengths[i]).abs() < 1e-14);
            assert!((a.direction(i) - b.directions[i]).norm() < 1e-13);
        }
    }
    let ours = nanoseconds(POSES, |i| robot.lengths_m(&x.poses[i]));
    let theirs = nanoseconds(POSES, |i| plain.lengths(&x.poses[i]));
    let slowness = theirs / 94.0;
    println!(
        "the targets were set where the plain lengths took 94 ns; here they take {theirs:.0} ns: \
         scaled times are divided by {slowness:.2}"
    );
    line(
        "inverse, 4 pulley cables (lengths)",
        Some(theirs),
        ours,
        37.0,
        slowness,
    );
    let ours = nanoseconds(POSES, |i| robot.inverse(&x.poses[i]));
    let theirs = nanoseconds(POSES, |i| plain.inverse(&x.poses[i]));
    line(
        "inverse with directions and wraps",
        Some(theirs),
        ours,
        37.0,
        slowness,
    );

    let options = ForwardOptions::default();
    let ours = nanoseconds(POSES, |i| {
        let near = &x.near[i].position_m;
        robot.position(&x.lengths[i], &x.poses[i].rotation, Some(near), &options)
    });
    let theirs = nanoseconds(POSES, |i| {
        plain.position(&SVector::from(x.lengths[i]), &x.near[i])
    });
    line(
        "position forward from 5 mm away",
        Some(theirs),
        ours,
        221.0,
        slowness,
    );
    let ours = nanoseconds(POSES, |i| {
        robot.position(&x.lengths[i], &x.poses[i].rotation, None, &options)
    });
    line("position forward, cold", None, ours, 579.0, slowness);

    let settings = StaticOptions::default();
    let ours = nanoseconds(POSES, |i| {
        robot.geometrico_static(&x.held[i], Start::Warm(&x.warm[i]), &settings)
    });
    line(
        "geometrico-static, warm (1 mm away)",
        None,
        ours,
        2200.0,
        slowness,
    );
    let steps: usize = (0..POSES)
        .map(|i| {
            robot
                .geometrico_static(&x.held[i], Start::Warm(&x.warm[i]), &settings)
                .unwrap()
                .iterations
        })
        .sum();
    println!(
        "{:<42} {:.2} steps on average",
        "",
        steps as f64 / POSES as f64
    );
    let ours = nanoseconds(POSES, |i| {
        robot.geometrico_static(&x.held[i], Start::Cold, &settings)
    });
    line(
        "geometrico-static, cold",
        None,
        ours,
        f64::INFINITY,
        slowness,
    );
    let ours = nanoseconds(POSES, |i| {
        robot.equilibrium_at(
            &Vector3::zeros(),
            &x.hanging[i].pose.position_m,
            &[None, None, None, Some(4.0)],
            EquilibriumGuess::Attitude(x.warm[i].pose.rotation),
            &settings,
        )
    });
    line(
        "equilibrium at a position, warm",
        None,
        ours,
        f64::INFINITY,
        slowness,
    );

    let limits = TensionLimits::uniform(1.0, 39.0);
    let matrices: Vec<_> = x
        .poses
        .iter()
        .map(|p| {
            robot
                .inverse(p)
                .unwrap()
                .directions
                .map(|row| row.map(|t| -t))
        })
        .collect();
    let directions: Vec<_> = x
        .poses
        .iter()
        .map(|p| plain.inverse(p).unwrap().directions)
        .collect();
    let load = [0.0, 0.0, robot.weight_n()];
    let ours = nanoseconds(POSES, |i| {
        distribute(&matrices[i], &load, &limits, &Goal::Middle)
    });
    let theirs = nanoseconds(POSES, |i| plain.distribute(&directions[i], 1.0, 39.0));
    line(
        "tension distribution, one redundancy",
        Some(theirs),
        ours,
        18.0,
        slowness,
    );

    let grid = Grid {
        min_m: Vector3::new(0.05, -0.35, -0.5),
        max_m: Vector3::new(0.62, 0.35, -0.05),
        counts: [64, 64, 8],
    };
    let test = WorkspaceTest::Forces {
        rotation: Rotation3::identity(),
        limits,
    };
    let mut cells = vec![Verdict::default(); grid.len()];
    let ours =
        nanoseconds(1, |_| robot.assess_range(&grid, &test, 0, &mut cells)) / grid.len() as f64;
    let theirs = nanoseconds(1, |_| {
        let mut feasible = 0;
        for k in 0..grid.len() {
            let inverse = plain.inverse(&Pose::level(grid.point_m(k)));
            let t = inverse.and_then(|v| plain.distribute(&v.directions, 1.0, 39.0));
            feasible += usize::from(t.is_some());
        }
        feasible
    }) / grid.len() as f64;
    line(
        "workspace, per level pose",
        Some(theirs),
        ours,
        1e3 / 22.0,
        slowness,
    );
    println!("{:<42} {:.1} M poses/s on one core", "", 1e3 / ours);
}

fn main() {
    let x = inputs();
    ratios(&x);
    let mut criterion = Criterion::default()
        .warm_up_time(Duration::from_millis(200))
        .measurement_time(Duration::from_millis(500))
        .configure_from_args();
    let mut i = 0;
    let mut next = move || {
        i = (i + 1) % POSES;
        i
    };
    let options = ForwardOptions::default();
    let settings = StaticOptions::default();
    criterion.bench_function("inverse", |b| {
        b.iter(|| x.robot.inverse(black_box(&x.poses[next()])));
    });
    criterion.bench_function("plain inverse", |b| {
        b.iter(|| x.plain.inverse(black_box(&x.poses[next()])));
    });
    criterion.bench_function("position forward, near", |b| {
        b.iter(|| {
            let i = next();
            let near = &x.near[i].position_m;
            x.robot
                .position(&x.lengths[i], &x.poses[i].rotation, Some(near), &options)
        });
    });
    criterion.bench_function("plain position forward, near", |b| {
        b.iter(|| {
            let i = next();
            x.plain.position(&SVector::from(x.lengths[i]), &x.near[i])
        });
    });
    criterion.bench_function("geometrico-static, warm", |b| {
        b.iter(|| {
            let i = next();
            x.robot
                .geometrico_static(&x.held[i], Start::Warm(&x.warm[i]), &settings)
        });
    });
    criterion.final_summary();
}
