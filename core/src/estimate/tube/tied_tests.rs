//! Errors that come together, or that lengths taken at home contain.

use super::drives::Motion;
use super::slopes::Instant;
use super::*;
use crate::estimate::track::{Prior, Tracker};
use crate::motion::{Model, StaticState};
use crate::robot::{Calibrated, Robot};

const STILL: f64 = 0.0;

fn eight_cable() -> (Model, StaticState, Errors) {
    let model = Model::new(&Robot::built_in("eight-cable").unwrap()).unwrap();
    let rest = model.rest_at_home().unwrap();
    let errors = Errors { cables: 8 };
    (model, rest, errors)
}

/// Slopes of the tool at a rest, with lengths taken at home or not.
fn slopes(
    model: &Model,
    rest: &StaticState,
    rubbed: f64,
    home: Option<&belief::AtHome>,
    tracked: bool,
) -> DMatrix<f64> {
    let instant = Instant {
        model,
        errors: Errors { cables: 8 },
        rest,
        home,
        home_m: 0.0,
        tracked,
        rubbed: &[rubbed; 8],
        motion: &Motion::none(8),
    };
    instant.slopes().unwrap().0
}

#[test]
fn drives_of_one_kind_are_late_together_and_pulleys_of_one_build_lose_alike() {
    let (model, _, errors) = eight_cable();
    let belief = Belief::of(model.robot(), &Doubts::by_tape());
    let correlation = |a: usize, b: usize| {
        let of = |i: usize, j: usize| belief.covariance[(i, j)];
        of(a, b) / (of(a, a) * of(b, b)).sqrt()
    };
    let losses = correlation(errors.loss(0), errors.loss(5));
    assert!((losses - 0.9).abs() < 1e-9, "{losses}");
    // Bandwidths within 20 % of each other, and 35 % that all share.
    let (own, all) = (0.04 / 3.0, 0.35_f64.powi(2));
    let drives = correlation(errors.late(0), errors.late(5));
    assert!((drives - all / (own + all)).abs() < 1e-9, "{drives}");
    let sigma_s = belief.covariance[(errors.late(0), errors.late(0))].sqrt();
    let lag_s = 1.0 / model.robot().winch_of(0).unwrap().drive_bandwidth_rad_s;
    assert!((sigma_s / lag_s - (own + all).sqrt()).abs() < 1e-9);
    assert_eq!(correlation(errors.loss(0), errors.late(0)), 0.0);
}

/// Friction that pulls before the pulley stretches the cable there: as a length of that much more.
#[test]
fn friction_at_a_pulley_stretches_the_cable_before_it() {
    let (model, rest, errors) = eight_cable();
    let hauled = slopes(&model, &rest, 1.0, None, false);
    let still = slopes(&model, &rest, STILL, None, false);
    for i in 0..6 {
        let cable = &model.robot().cables[i];
        let stretch_m = cable.routing_length_m * rest.tensions_n()[i] / cable.ea_n;
        let said = hauled.column(errors.loss(i)).into_owned();
        let longer = hauled.column(errors.length(i)) * stretch_m;
        assert!(
            (&said - &longer).norm() < 1e-9 * longer.norm() && longer.norm() > 0.0,
            "cable {i}: {said} {longer}"
        );
        assert_eq!(still.column(errors.loss(i)).norm(), 0.0);
    }
}

/// Where lengths were taken at home and are tracked since, they contain what attachments and pulleys do there, and the
/// tracked lengths what the tracked errors do.
#[test]
fn tracked_lengths_contain_what_attachments_do_at_home() {
    let (model, rest, errors) = eight_cable();
    let paths = model.geometry().paths(&rest.equilibrium.pose).unwrap();
    let home = (paths, rest.clone());
    let free = slopes(&model, &rest, STILL, None, true);
    let tied = slopes(&model, &rest, STILL, Some(&home), true);
    let part = |slopes: &DMatrix<f64>, kinds: &[usize]| {
        let columns = (0..6).flat_map(|i| kinds.iter().map(move |kind| i * PER_CABLE + kind));
        columns
            .map(|k| slopes.column(k).norm_squared())
            .sum::<f64>()
            .sqrt()
    };
    let (attachments, anchors) = ([3, 4, 5, 13], [0, 1, 2]);
    assert!(part(&tied, &attachments) < 0.1 * part(&free, &attachments));
    assert_eq!(part(&tied, &anchors), part(&free, &anchors));
    // Not by a robot that is known by its calibration: its lengths are nobody's home.
    let robot = model.robot();
    let nothing = DMatrix::zeros(errors.count(), errors.count());
    for homed in [true, false] {
        let belief = Belief::of(robot, &Doubts::by_tape());
        let belief = belief.with_tracked(&nothing, homed, "a test");
        assert_eq!(belief.home(&model).unwrap().is_some(), homed);
        assert!(belief.tracked);
        let prior = Prior {
            homed,
            ..Prior::default()
        };
        let tracker = Tracker::new(&model, &prior);
        let belief = tracker.belief(0.0, rest.tensions_n(), &Doubts::by_tape());
        assert_eq!(belief.homed, homed);
    }
}

/// Errors that a calibration does not estimate are as tied as without one.
#[test]
fn what_a_calibration_leaves_open_keeps_its_correlations() {
    let (model, _, errors) = eight_cable();
    let mut robot = model.robot().clone();
    let mut known = DMatrix::zeros(errors.count(), errors.count());
    known[(errors.mass(), errors.mass())] = 1e-6;
    robot.calibrated = Some(Box::new(Calibrated {
        designed: robot.clone(),
        places: Vec::new(),
        simulated_seed: None,
        simulated_machine: None,
        date: String::new(),
        predicted_error_m: None,
        home_lengths_m: vec![0.0; 8],
        drum_scales: vec![1.0; 8],
        covariance: None,
        errors: Some(known),
        file: std::path::PathBuf::new(),
    }));
    let of_file = Belief::of(model.robot(), &Doubts::by_tape()).covariance;
    let calibrated = Belief::of(&robot, &Doubts::by_tape()).covariance;
    for (a, b) in [
        (errors.loss(0), errors.loss(5)),
        (errors.late(0), errors.late(5)),
    ] {
        assert!(calibrated[(a, b)] > 0.0);
        assert_eq!(calibrated[(a, b)], of_file[(a, b)]);
    }
    assert_eq!(calibrated[(errors.mass(), errors.mass())], 1e-6);
}
