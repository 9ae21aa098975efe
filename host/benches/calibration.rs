//! Speed of the calibration: the joint method, and the paper's with tag poses given beside the same
//! minimum found with a dense Jacobian by finite differences.

use criterion::{Criterion, criterion_group, criterion_main};
use mcdpr::calibration::data::{Data, compose, inverse};
use mcdpr::calibration::paper::{Estimate, Problem, Weights};
use mcdpr::calibration::simulate::{Setup, Target, Truth, simulate};
use mcdpr::calibration::{Options, joint};
use mcdpr_kinematics::{Pose, Robot};
use nalgebra::{DMatrix, DVector, Vector3};
use std::hint::black_box;

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
            .push(compose(&truth.camera_from_platform, &inverse(from_tag)));
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

fn residuals(problem: &Problem, at: &Estimate) -> DVector<f64> {
    let platform = mcdpr_kinematics::Platform {
        mass_kg: 1.0,
        center_of_mass_m: Vector3::zeros(),
        inertia_kg_m2: None,
    };
    let robot = <[_; 4]>::try_from(at.cables.clone())
        .ok()
        .and_then(|cables| Robot::new(cables, platform).ok());
    let mut out = Vec::with_capacity(92);
    for (tag, readings) in problem.camera_from_tag.iter().zip(&problem.encoder_m) {
        let camera: Pose = compose(&at.world_from_tag, &inverse(tag));
        let pose = compose(&camera, &at.camera_from_platform);
        let lengths = robot.as_ref().and_then(|r| r.lengths_m(&pose).ok());
        for (i, length) in lengths.unwrap_or([f64::NAN; 4]).iter().enumerate() {
            let reading = readings[i].unwrap_or(0.0);
            out.push(5e3 * (length - at.initial_length_m[i] - reading));
        }
    }
    for (now, nominal) in at.cables.iter().zip(&problem.nominal) {
        out.extend((now.anchor_m - nominal.anchor_m).iter().map(|x| x * 1e3));
    }
    DVector::from_vec(out)
}

/// What a plain implementation does: numeric Jacobian, dense normal equations.
fn plain(problem: &Problem, start: &Estimate) -> (Estimate, f64) {
    let (mut at, mut damping) = (start.clone(), 1e-6);
    let mut r = residuals(problem, &at);
    for _ in 0..100 {
        let mut jacobian = DMatrix::zeros(r.len(), 28);
        for j in 0..28 {
            let mut step = DVector::zeros(28);
            step[j] = 1e-7;
            let column = (residuals(problem, &stepped(&at, &step)) - &r) / 1e-7;
            jacobian.set_column(j, &column);
        }
        let mut h = jacobian.tr_mul(&jacobian);
        for j in 0..28 {
            h[(j, j)] *= 1.0 + damping;
        }
        let Some(cholesky) = h.cholesky() else { break };
        let step = cholesky.solve(&-jacobian.tr_mul(&r));
        let trial = stepped(&at, &step);
        let next = residuals(problem, &trial);
        if next.norm_squared() <= r.norm_squared() {
            let done = r.norm_squared() - next.norm_squared() < 1e-9 * r.norm_squared() + 1e-12;
            (at, r) = (trial, next);
            damping *= 0.1;
            if done {
                break;
            }
        } else {
            damping *= 10.0;
        }
    }
    let cost = r.norm_squared();
    (at, cost)
}

fn calibration(c: &mut Criterion) {
    let (problem, start) = given_tags();
    let solved = problem.solve(&start, &Weights::default());
    let analytic = solved.map_or(f64::NAN, |(_, cost, _)| cost);
    let (_, numeric) = plain(&problem, &start);
    assert!(
        (analytic - numeric).abs() < 1e-3 * numeric + 1e-6,
        "both must end at one minimum: {analytic} {numeric}"
    );
    c.bench_function("tag poses given, 20 poses, 28 unknowns", |b| {
        b.iter(|| black_box(problem.solve(&start, &Weights::default())));
    });
    c.bench_function("the same, dense numeric Jacobian", |b| {
        b.iter(|| black_box(plain(&problem, &start)));
    });
    let without = Options {
        without_statics: true,
        ..Options::default()
    };
    let cases = [
        (
            "joint, one tag, 60 poses, no statics",
            Target::Tag,
            60,
            without,
        ),
        (
            "joint, board, 60 poses, statics",
            Target::Board,
            60,
            Options::default(),
        ),
        (
            "joint, board, 20 poses, statics",
            Target::Board,
            20,
            Options::default(),
        ),
    ];
    for (name, target, poses, options) in cases {
        let (mut data, _) = case(target, poses);
        data.holdout.clear();
        c.bench_function(name, |b| b.iter(|| black_box(joint(&data, &options))));
    }
}

criterion_group!(benches, calibration);
criterion_main!(benches);
