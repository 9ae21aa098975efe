//! The filter against least squares, and the rows' slopes against differences.

use super::gaussian::{Gaussian, Linear};
use super::tests::exact;
use super::*;
use crate::random::Random;
use crate::robot::Robot;
use nalgebra::Vector3;

#[test]
fn an_update_is_least_squares() {
    let mut random = Random::new(5);
    let size = 6;
    let sigmas: Vec<f64> = (0..size).map(|k| 0.5 + f64::from(k)).collect();
    let mean: Vec<f64> = (0..size).map(|_| random.normal()).collect();
    let mut states = Gaussian::new(mean.clone(), &sigmas);
    let rows: Vec<Vec<f64>> = (0..9)
        .map(|_| (0..size).map(|_| random.normal()).collect())
        .collect();
    let residual: Vec<f64> = (0..9).map(|_| random.normal()).collect();
    let at: Vec<f64> = (0..size).map(|_| random.normal()).collect();
    // Normal equations of the prior and the rows, solved by another library.
    let n = size as usize;
    let h = nalgebra::DMatrix::from_fn(9, n, |i, j| rows[i][j]);
    let prior =
        nalgebra::DMatrix::from_fn(
            n,
            n,
            |i, j| {
                if i == j { 1.0 / sigmas[i].powi(2) } else { 0.0 }
            },
        );
    let information = h.transpose() * &h + &prior;
    let at_vector = nalgebra::DVector::from_vec(at.clone());
    let right = &prior * nalgebra::DVector::from_vec(mean)
        + h.transpose() * (&h * at_vector - nalgebra::DVector::from_vec(residual.clone()));
    let covariance = information.try_inverse().unwrap();
    let want = &covariance * right;
    let mut linear = Linear::new(&at, rows.len());
    for (row, slopes) in rows.iter().enumerate() {
        linear.residual[row] = residual[row];
        for (state, slope) in slopes.iter().enumerate() {
            *linear.slope_mut(row, state) = *slope;
        }
    }
    let lesson = states.learn(&linear).unwrap();
    // The likelihood of the innovations, by their whole covariance.
    let prior_covariance = prior.try_inverse().unwrap();
    let spread = &h * prior_covariance * h.transpose() + nalgebra::DMatrix::identity(9, 9);
    let off = nalgebra::DVector::from_vec(residual)
        + &h * (nalgebra::DVector::from_vec(states.mean.clone()) - nalgebra::DVector::from_vec(at));
    let squares = (off.transpose() * spread.clone().try_inverse().unwrap() * &off)[0];
    assert!((lesson.fit.squares - squares).abs() < 1e-9 * squares);
    assert!((lesson.fit.log_volume - spread.determinant().ln()).abs() < 1e-9);
    states.mistimed = vec![1e-4, 2e-4];
    states = states.taught(lesson);
    // A rest does not tell of retardation times.
    assert_eq!(states.mistimed, [1e-4, 2e-4]);
    for i in 0..n {
        assert!((states.mean[i] - want[i]).abs() < 1e-9);
        for j in 0..n {
            assert!((states.covariance[i * n + j] - covariance[(i, j)]).abs() < 1e-9);
        }
    }
}

/// Every slope of the rows, against differences of the residuals of a rest without errors (elsewhere the standard deviations
/// change, too).
#[test]
fn the_rows_slopes_are_those_of_their_residuals() {
    for name in ["lab-fast", "eight-cable"] {
        let model = Model::new(&Robot::built_in(name).unwrap()).unwrap();
        let robot = model.robot();
        let layout = Layout {
            cables: robot.cables.len(),
        };
        let (measured, _, pose) = exact(&model, [0.04, -0.03, -0.05]);
        let friction = |i: usize| Rubbing {
            side: 1.0 - 0.5 * i as f64,
            unsure: 0.1,
        };
        let rubbing: Vec<Rubbing> = (0..layout.cables).map(friction).collect();
        let prior = RowSigmas::default();
        let rest = Rest {
            robot,
            sigmas: &prior,
            measured: &measured,
            rubbing: &rubbing,
            every_tension: true,
        };
        let hanging = Hanging {
            pose,
            tensions_n: measured.tensions_n.clone(),
        };
        let x = vec![0.0; layout.size()];
        let residuals = |x: &[f64], hanging: &Hanging| -> Vec<f64> {
            let geometry = statics::geometry(robot, layout, x).unwrap();
            let rows = rest.rows(&geometry, x, hanging, false).unwrap();
            rows.lines.iter().map(|row| row[rest.unknowns()]).collect()
        };
        let geometry = statics::geometry(robot, layout, &x).unwrap();
        let rows = rest.rows(&geometry, &x, &hanging, true).unwrap();
        let count = rows.lines.count();
        assert_eq!(count, 2 * layout.cables + 6, "{name}");
        let agree = |said: &[f64], plus: &[f64], minus: &[f64], step: f64, of: &str| {
            let scale = said.iter().fold(1.0, |most: f64, v| most.max(v.abs()));
            for (row, said) in said.iter().enumerate() {
                let seen = (plus[row] - minus[row]) / (2.0 * step);
                assert!(
                    (said - seen).abs() < 1e-5 * scale,
                    "{name}, row {row} by {of}: {said}, differences {seen}"
                );
            }
        };
        for unknown in 0..rest.unknowns() {
            let step = if unknown < 6 { 1e-6 } else { 1e-4 };
            let moved = |step: f64| {
                let mut there = hanging.clone();
                let mut twist = [0.0; 6];
                if unknown < 6 {
                    twist[unknown] = step;
                } else {
                    there.tensions_n[unknown - 6] += step;
                }
                let [x, y, z, rx, ry, rz] = twist;
                there.pose = pose.displaced(&Vector3::new(x, y, z), &Vector3::new(rx, ry, rz));
                there
            };
            let said: Vec<f64> = rows.lines.iter().map(|row| row[unknown]).collect();
            let (plus, minus) = (residuals(&x, &moved(step)), residuals(&x, &moved(-step)));
            agree(&said, &plus, &minus, step, &format!("unknown {unknown}"));
        }
        for state in 0..layout.camera() {
            let mut said = vec![0.0; count];
            for slope in rows.by_state.iter().filter(|slope| slope.state == state) {
                said[slope.row] += slope.value;
            }
            let moved = |step: f64| {
                let mut there = x.clone();
                there[state] = step;
                residuals(&there, &hanging)
            };
            let step = 1e-7;
            agree(
                &said,
                &moved(step),
                &moved(-step),
                step,
                &format!("state {state}"),
            );
        }
    }
}

#[test]
fn a_state_that_follows_others_has_their_covariance_though_they_are_correlated() {
    let mut states = Gaussian::new(vec![0.0; 3], &[1.0, 2.0, 0.5]);
    states.covariance[1] = 1.2;
    states.covariance[3] = 1.2;
    let before = nalgebra::DMatrix::from_row_slice(3, 3, &states.covariance);
    states.couple(0, 2, 0.5);
    states.couple(1, 2, -2.0);
    let follows =
        nalgebra::DMatrix::from_row_slice(3, 3, &[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.5, -2.0, 1.0]);
    let want = &follows * before * follows.transpose();
    for (i, value) in states.covariance.iter().enumerate() {
        assert!(
            (value - want[(i / 3, i % 3)]).abs() < 1e-12,
            "{i}: {value} {want}"
        );
    }
}

/// A wrong retardation time makes of the creep what the derivative of its law says, however time is divided.
#[test]
fn a_wrong_retardation_time_is_followed_as_far_as_it_goes() {
    let model = Model::new(&Robot::built_in("eight-cable").unwrap()).unwrap();
    let prior = Prior {
        creep: [0.003, 0.0],
        ..Prior::default()
    };
    let tension_n = model.robot().tension.setpoint_n;
    for (element, retardation_s) in [300.0_f64, 7200.0].into_iter().enumerate() {
        let last_strain = [0.4, 0.6][element] * 0.003;
        for (time_s, steps) in [(10.0, 10), (300.0, 30), (300.0, 300), (3600.0, 360)] {
            let mut tracker = Tracker::new(&model, &prior);
            for _ in 0..steps {
                tracker.pass(time_s / f64::from(steps), &[tension_n; 8]);
            }
            // Of c (1 - e^(-t / T)) by ln T: c t / T e^(-t / T).
            let share = time_s / retardation_s;
            let off = last_strain * share * libm::exp(-share) * prior.creep_drift;
            let sigma = tracker
                .now
                .variance(tracker.layout.creep(2, element))
                .sqrt();
            assert!(
                (sigma / off - 1.0).abs() < 0.02,
                "element {element} after {time_s} s in {steps} steps: {sigma} {off}"
            );
        }
    }
}

/// What one cable is known to creep says how others of its rope creep, and nothing of another rope.
#[test]
fn cables_of_one_rope_creep_alike() {
    let mut robot = Robot::built_in("eight-cable").unwrap();
    robot.cables[3].ea_n *= 2.0;
    let model = Model::new(&robot).unwrap();
    let prior = Prior::default();
    let tracker = Tracker::new(&model, &prior);
    let size = tracker.layout.size();
    let correlation = |i: [usize; 2], j: [usize; 2]| {
        let [i, j] = [i, j].map(|[cable, element]| tracker.layout.creep_ratio(cable, element));
        let both = tracker.now.covariance[i * size + j];
        both / (tracker.now.variance(i) * tracker.now.variance(j)).sqrt()
    };
    for other in [[0, 1], [1, 0], [7, 1]] {
        let found = correlation([0, 0], other);
        assert!(
            (found - prior.creep_alike).abs() < 1e-12,
            "{other:?}: {found}"
        );
    }
    assert_eq!(correlation([0, 0], [3, 0]), 0.0);
    assert!((correlation([3, 0], [3, 1]) - prior.creep_alike).abs() < 1e-12);
}
