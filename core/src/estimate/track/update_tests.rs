//! The filter against least squares, and the rows' slopes against differences.

use super::creep::Creeping;
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
    let mut crept = Creeping::default();
    crept.pass(100.0, 1e-4);
    states.creeping = vec![crept];
    states = states.taught(lesson);
    // The tensions so far are what they were.
    assert_eq!(states.creeping, [crept]);
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
        let mut crept = Creeping::default();
        crept.pass(1500.0, 1e-4);
        let creeping = vec![crept; layout.cables];
        let rest = Rest {
            robot,
            sigmas: &prior,
            measured: &measured,
            rubbing: &rubbing,
            creeping: &creeping,
            every_tension: true,
        };
        let hanging = Hanging {
            pose,
            tensions_n: measured.tensions_n.clone(),
        };
        let mut x = vec![0.0; layout.size()];
        // A retardation time counts as far as there is creep.
        x[layout.creep_ratio(1, 0)] = 4.0;
        x[layout.creep_ratio(2, 1)] = 3.0;
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
                there[state] += step;
                residuals(&there, &hanging)
            };
            // Rows are linear in each state of creep by itself, and their slopes are small.
            let creeps = (0..layout.cables).any(|i| {
                let states = crept.slopes(layout, &x, i);
                states.iter().any(|(creep, _)| *creep == state)
            });
            let step = if creeps { 1e-2 } else { 1e-7 };
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

/// Final size and retardation time are known as badly as at first until a rest tells of them; the creep is not.
#[test]
fn time_alone_teaches_nothing_of_creep_but_lets_it_grow() {
    let model = Model::new(&Robot::built_in("eight-cable").unwrap()).unwrap();
    let prior = Prior {
        creep: [0.003, 0.0],
        ..Prior::default()
    };
    let tension_n = model.robot().tension.setpoint_n;
    let mut tracker = Tracker::new(&model, &prior);
    let first = tracker.now.clone();
    for (time_s, law, by_time) in [
        (300.0_f64, [0.63212, 0.04081], [0.36788, 0.03997]),
        (6900.0, [1.0, 0.63212], [0.0, 0.36788]),
    ] {
        for _ in 0..300 {
            tracker.pass(time_s / 300.0, &[tension_n; 8]);
        }
        for element in 0..2 {
            for state in [
                tracker.layout.creep_ratio(2, element),
                tracker.layout.creep_time(2, element),
            ] {
                assert_eq!(tracker.now.mean[state], first.mean[state]);
                assert_eq!(tracker.now.variance(state), first.variance(state));
            }
        }
        // Of c (1 - e^(-t / T)), and of its derivative by ln T.
        let strain = tracker.estimates(&prior).cables[2].strain;
        let want = 0.003 * (0.4 * law[0] + 0.6 * law[1]);
        assert!((strain.value - want).abs() < 1e-7, "{strain:?} {want}");
        let parts = [0.4_f64, 0.6].into_iter().zip(by_time);
        let squares: f64 = parts.map(|(share, slope)| (share * slope).powi(2)).sum();
        let sigma = 0.003 * prior.creep_time * squares.sqrt();
        assert!((strain.sigma - sigma).abs() < 1e-7, "{strain:?} {sigma}");
    }
}

#[test]
fn what_the_platform_feels_is_what_a_sensor_shows_the_other_way_round() {
    let model = Model::new(&Robot::built_in("lab-fast").unwrap()).unwrap();
    let mut tracker = Tracker::new(&model, &Prior::default());
    let rubbing = Rubbing {
        side: -0.7,
        unsure: 0.1,
    };
    for (state, value) in [
        (tracker.layout.zero(2), 0.3),
        (tracker.layout.gain(2), 0.02),
        (tracker.layout.loss(2), 0.03),
    ] {
        tracker.planned[state] = value;
        let shown_n = tracker.reading_n(2, 12.0, rubbing);
        assert!((shown_n - 12.0).abs() > 0.05);
        assert!((tracker.felt_n(2, shown_n, rubbing) - 12.0).abs() < 1e-12);
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
