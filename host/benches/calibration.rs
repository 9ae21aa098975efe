//! Speed of the calibration: with tag poses given, from pixels, and with a board and statics, each
//! beside the same minimum found with a dense Jacobian by finite differences.

use criterion::{Criterion, criterion_group, criterion_main};
use mcdpr::calibration::data::Data;
use mcdpr::calibration::paper::{Estimate, Problem, Weights};
use mcdpr::calibration::simulate::{Setup, Target, Truth, simulate};
use mcdpr::calibration::{Options, dense, joint};
use mcdpr_kinematics::{Pose, Robot};
use nalgebra::{DVector, Vector3};
use std::hint::black_box;
use std::time::{Duration, Instant};

fn case(target: Target, poses: usize) -> (Data, Truth) {
    let setup = Setup {
        target,
        poses,
        ..Setup::default()
    };
    simulate(&setup).unwrap_or_else(|| panic!("the built-in robot is valid"))
}

/// Tag poses as exact as pictures could give them, and the nominal start.
fn given_tags() -> (Problem, Estimate) {
    let (data, truth) = case(Target::Board, 20);
    let mut problem = Problem {
        nominal: data.robot.cables.clone(),
        encoder_m: Vec::new(),
        camera_from_tag: Vec::new(),
    };
    let tag_from_platform = data.holdout.iter().zip(&truth.holdout).take(20);
    for (from_tag, pose) in tag_from_platform {
        let lengths = truth.robot.lengths_m(pose).unwrap_or([0.0; 4]);
        problem.encoder_m.push(
            (0..4)
                .map(|i| Some(lengths[i] - truth.initial_length_m[i]))
                .collect(),
        );
        problem
            .camera_from_tag
            .push(truth.camera_from_platform.compose(&from_tag.inverse()));
    }
    let start = Estimate {
        cables: data.robot.cables.clone(),
        initial_length_m: truth.initial_length_m.to_vec(),
        world_from_tag: data.world_from_body[0],
        camera_from_platform: data.camera_from_platform,
    };
    (problem, start)
}

fn stepped(at: &Estimate, v: &DVector<f64>) -> Estimate {
    let three = |j: usize| Vector3::new(v[j], v[j + 1], v[j + 2]);
    let mut out = at.clone();
    for i in 0..4 {
        out.cables[i].anchor_m += three(3 * i);
        out.initial_length_m[i] += v[12 + i];
    }
    out.world_from_tag = at.world_from_tag.displaced(&three(16), &three(19));
    out.camera_from_platform = at.camera_from_platform.displaced(&three(22), &three(25));
    out
}

/// Weights of the joint estimate: each row by its standard deviation, 0.05 mm and 5 mm/sqrt(3).
fn weights() -> Weights {
    Weights {
        lengths: 1.0 / 0.05,
        anchors: 3f64.sqrt() / 5.0,
        ..Weights::default()
    }
}

fn residuals(problem: &Problem, at: &Estimate) -> Option<DVector<f64>> {
    let platform = mcdpr_kinematics::Platform {
        mass_kg: 1.0,
        center_of_mass_m: Vector3::zeros(),
        inertia_kg_m2: None,
    };
    let cables = <[_; 4]>::try_from(at.cables.clone()).ok()?;
    let robot = Robot::new(cables, platform).ok()?;
    let weights = weights();
    let mut out = Vec::with_capacity(92);
    for (tag, readings) in problem.camera_from_tag.iter().zip(&problem.encoder_m) {
        let camera: Pose = at.world_from_tag.compose(&tag.inverse());
        let pose = camera.compose(&at.camera_from_platform);
        let lengths = robot.lengths_m(&pose).ok()?;
        for (i, length) in lengths.iter().enumerate() {
            let off = length - at.initial_length_m[i] - readings[i]?;
            out.push(1e3 * weights.lengths * off);
        }
    }
    for (now, nominal) in at.cables.iter().zip(&problem.nominal) {
        let off = (now.anchor_m - nominal.anchor_m) * 1e3 * weights.anchors;
        out.extend(off.iter());
    }
    Some(DVector::from_vec(out))
}

fn plain(problem: &Problem, start: &Estimate) -> Option<(Estimate, f64)> {
    let of = |at: &Estimate| residuals(problem, at);
    dense::minimise(start, 28, 1e-12, of, stepped)
}

/// Times both in turn and prints medians and their ratio: other load on the machine then slows
/// both.
fn compare(name: &str, aim: Duration, rounds: usize, fast: &dyn Fn(), plain: &dyn Fn()) {
    let time = |f: &dyn Fn()| {
        let start = Instant::now();
        f();
        start.elapsed()
    };
    let (mut times, mut plain_times) = (Vec::new(), Vec::new());
    for _ in 0..rounds {
        plain_times.push(time(plain));
        times.extend((0..5).map(|_| time(fast)));
    }
    times.sort();
    plain_times.sort();
    let (t, p) = (times[times.len() / 2], plain_times[rounds / 2]);
    println!(
        "{name}: {t:.2?} (aim {aim:?}), dense with numeric Jacobian {p:.2?}, {:.0} times as long",
        p.as_secs_f64() / t.as_secs_f64()
    );
}

fn calibration(c: &mut Criterion) {
    let (problem, start) = given_tags();
    let solved = problem.solve(&start, &weights());
    let analytic = solved.map_or(f64::NAN, |fitted| fitted.cost_mm2);
    let numeric = plain(&problem, &start).map_or(f64::NAN, |(_, cost)| cost);
    assert!(
        (analytic - numeric).abs() < 1e-3 * numeric + 1e-6,
        "both must end at one minimum: {analytic} {numeric}"
    );
    let solve = || drop(black_box(problem.solve(&start, &weights())));
    let name = "tag poses given, 20 poses, 28 unknowns";
    let aim = Duration::from_micros(80);
    compare(name, aim, 500, &solve, &|| {
        drop(black_box(plain(&problem, &start)));
    });
    c.bench_function(name, |b| b.iter(solve));

    let without = Options {
        without_statics: true,
        ..Options::default()
    };
    let (tag, board) = (Target::Tag, Target::Board);
    let all = Options::default();
    // With a target time: next to the plain implementation, which takes seconds.
    let cases = [
        ("pixels, one tag, 60 poses", tag, 60, without, Some(3)),
        ("board, 60 poses, statics", board, 60, all, Some(5)),
        ("board, 20 poses, statics", board, 20, all, None),
    ];
    for (name, target, poses, options, aim_ms) in cases {
        let (mut data, _) = case(target, poses);
        data.holdout.clear();
        let solve = || drop(black_box(joint(&data, &options)));
        if let Some(aim_ms) = aim_ms {
            let aim = Duration::from_millis(aim_ms);
            compare(name, aim, 3, &solve, &|| {
                drop(black_box(dense::joint_dense(&data, &options)));
            });
        }
        c.bench_function(name, |b| b.iter(solve));
    }
}

criterion_group!(benches, calibration);
criterion_main!(benches);
