//! Trackers, tapes and clocks: a frame that is solved for, and bad files.

use super::fit::{Fit, Options, fit};
use super::model::{Group, Model, Row};
use super::predict::{predict, score};
use super::simulate::{Case, Outside, simulate};
use super::study::{given, region};
use super::tests::slopes_match;
use super::unknowns::unknowns;
use super::verdict::{verdict, without_moving};
use super::{Priors, Set, solve};
use crate::verify::best_motion;
use mcdpr_kinematics::Pose;
use nalgebra::Vector3;
use serde_json::json;

fn case(seed: u64, outside: Outside) -> Case {
    Case {
        seed,
        outside,
        ..Case::default()
    }
}

#[test]
fn derivatives_of_trackers_and_tapes_match_differences() {
    let (set, truth) = simulate(&Case {
        samples: [4, 3],
        ..case(3, Outside::Poses)
    })
    .unwrap();
    let mut set = set;
    set.trackers[0].start = Some((truth.frame, truth.target.rotation));
    let layout = super::unknowns::Layout {
        cables: 4,
        bodies: None,
        trackers: vec![0],
        tapes: vec![0],
        sessions: vec![0, 1],
        breaks: Vec::new(),
    };
    let model = Model {
        set: &set,
        layout: layout.clone(),
        middle_m: 1.7,
    };
    let state = solve::start(&model, &unknowns(&set, &layout, &Priors::default()));
    let outside = |group: Group| matches!(group, Group::Position | Group::Turn | Group::Distance);
    // The rotation vector of a small residual turns by a half of it.
    let limit = |row: &Row, _| outside(row.group).then_some(5e-3);
    slopes_match(&model, &state, &truth.poses, limit);
}

/// Root mean square distance between predicted and true places after the best motion of their frames, m.
fn apart_m(found: &Fit, rest: &Set, truth: &[Pose], priors: &Priors) -> f64 {
    let predicted = predict(found, rest, &given(4), priors).into_iter();
    let predicted: Vec<_> = predicted.map(|a| a.unwrap().pose.position_m).collect();
    let truth: Vec<_> = truth.iter().map(|pose| pose.position_m).collect();
    let (turn, shift) = best_motion(&predicted, &truth).unwrap();
    let squares = predicted
        .iter()
        .zip(&truth)
        .map(|(p, t)| (turn * p + shift - t).norm_squared());
    (squares.sum::<f64>() / truth.len() as f64).sqrt()
}

#[test]
fn a_tracker_in_an_unknown_frame_is_solved_for_and_makes_predictions_better() {
    for outside in [Outside::Positions, Outside::Poses] {
        let (mut inside, mut count, mut off_mm) = (0.0, 0.0, [0.0, 0.0]);
        for seed in 11..=14 {
            let (set, truth) = simulate(&Case {
                anchor_m: 1e-2,
                attitude: false,
                ..case(seed, outside)
            })
            .unwrap();
            let seen = set.only(|k, _| k % 3 != 0);
            let rest = set.only(|k, _| k % 3 == 0);
            let places: Vec<Pose> = truth.poses.iter().step_by(3).copied().collect();
            let priors = Priors {
                anchor_m: 1e-2,
                ..Priors::default()
            };
            let options = Options {
                priors,
                ..Options::default()
            };
            for (k, data) in [seen.alone(), seen].into_iter().enumerate() {
                let found = fit(&data, &options).unwrap();
                let theta = &found.solution.state.theta;
                off_mm[k] += apart_m(&found, &rest, &places, &options.priors) * 250.0;
                if k == 0 {
                    continue;
                }
                assert_eq!(verdict(&found).refused, None);
                let frame = found.solution.state.tracker_from_world[0];
                let turned = frame.rotation.angle_to(&truth.frame.rotation);
                assert!(turned < 0.03, "seed {seed}: frame off by {turned} rad");
                let target = found.layout.target(0);
                let at = Vector3::from_row_slice(&theta[target..target + 3]);
                let off = at - truth.target.position_m;
                let stated = found.solution.covariance.fixed_view::<3, 3>(target, target);
                let squared = off.dot(&(stated.into_owned().try_inverse().unwrap() * off));
                // 99.9 % of chi-square with three degrees of freedom.
                assert!(
                    squared < 16.3,
                    "seed {seed}: target off by {off} m, {squared}"
                );
                let answers: Vec<_> = predict(&found, &rest, &given(4), &options.priors)
                    .into_iter()
                    .collect::<Result<_, _>>()
                    .unwrap();
                for group in [Group::Position, Group::Distance] {
                    let score = score(&answers, group, 1e3).unwrap();
                    inside += score.inside * score.readings as f64;
                    count += score.readings as f64;
                    assert!(score.rms < 5.0, "seed {seed}, {group:?}: {score:?}");
                }
            }
        }
        assert!(
            (0.88..=1.0).contains(&(inside / count)),
            "{}",
            inside / count
        );
        // Most of the rest is the scatter of the three lengths and the tension that are given.
        assert!(off_mm[1] < 0.9 * off_mm[0], "{outside:?}: {off_mm:?} mm");
    }
}

#[test]
fn trackers_and_tapes_are_read_back() {
    for outside in [Outside::Positions, Outside::Poses] {
        let (set, _) = simulate(&case(5, outside)).unwrap();
        let text = serde_json::to_string(&set.to_json()).unwrap();
        let back = Set::from_json(&text).unwrap();
        assert_eq!(back.trackers, set.trackers);
        assert_eq!(back.tapes, set.tapes);
        for (a, b) in set.samples.iter().zip(&back.samples) {
            let numbers = a
                .position_m
                .iter()
                .flatten()
                .zip(b.position_m.iter().flatten());
            for (a, b) in numbers.chain(a.distance_m.iter().zip(&b.distance_m)) {
                assert!((a.unwrap() - b.unwrap()).abs() < 1e-9);
            }
            assert_eq!(a.turned[0].is_some(), b.turned[0].is_some());
        }
    }
}

#[test]
fn what_is_wrong_with_a_tracker_or_a_tape_is_said() {
    let (set, _) = simulate(&case(6, Outside::Positions)).unwrap();
    let good = set.to_json();
    let refused = |value: &serde_json::Value| {
        let read = Set::from_json(&value.to_string());
        read.unwrap_err().to_string()
    };
    let mut bad = good.clone();
    bad["tapes"][0].as_object_mut().unwrap().remove("from_mm");
    let words = refused(&bad);
    assert!(
        words.contains("tapes[0]") && words.contains("from_mm"),
        "{words}"
    );
    let mut bad = good.clone();
    bad["samples"][3]["position_mm"] = json!({"lazer": [1, 2, 3]});
    let words = refused(&bad);
    assert!(
        words.contains("samples[3].position_mm") && words.contains("laser"),
        "{words}"
    );
    let mut bad = good.clone();
    bad["samples"][3]["position_mm"] = json!({"laser": [1, 2]});
    assert!(
        refused(&bad).contains("samples[3].position_mm.laser"),
        "{}",
        refused(&bad)
    );
    // Positions on a line, and too few of them.
    let mut line = set.clone();
    for (k, sample) in line.samples.iter_mut().enumerate() {
        sample.position_m[0] = [Some(0.05 * k as f64), Some(0.0), Some(0.0)];
    }
    let words = fit(&line, &Options::default()).unwrap_err();
    assert!(
        words.contains("tracker laser") && words.contains("one line"),
        "{words}"
    );
    let mut few = set;
    for sample in few.samples.iter_mut().skip(2) {
        sample.position_m[0] = [None; 3];
    }
    let words = fit(&few, &Options::default()).unwrap_err();
    assert!(words.contains("2 whole positions"), "{words}");
    // In mm instead of m: no robot fits.
    let (mut scaled, _) = simulate(&case(7, Outside::Positions)).unwrap();
    for sample in &mut scaled.samples {
        sample.position_m[0] = sample.position_m[0].map(|axis| axis.map(|m| m * 1e3));
    }
    let said = verdict(&fit(&scaled, &Options::default()).unwrap());
    assert!(said.refused.unwrap().contains("tracker position"));
}

#[test]
fn times_that_cannot_be_right_are_not_used_and_a_stated_rest_in_motion_is_named() {
    let (set, _) = simulate(&case(8, Outside::None)).unwrap();
    let good = set.to_json();
    assert!(Set::from_json(&good.to_string()).unwrap().notes.is_empty());
    let mut back = good.clone();
    back["samples"][4]["time_s"] = json!(61.0);
    let read = Set::from_json(&back.to_string()).unwrap();
    assert!(
        read.notes[0].contains("not after that of the sample before"),
        "{:?}",
        read.notes
    );
    assert!(
        read.samples
            .iter()
            .filter(|s| s.session == 0)
            .all(|s| s.time_s.is_none())
    );
    assert!(
        read.samples
            .iter()
            .filter(|s| s.session == 1)
            .all(|s| s.time_s.is_some())
    );
    let mut fast = good.clone();
    for k in 0..27 {
        fast["samples"][k]["time_s"] = json!(1e-3 * (k as f64 + 1.0));
    }
    let read = Set::from_json(&fast.to_string()).unwrap();
    assert!(
        read.notes[0].contains("must be in seconds"),
        "{:?}",
        read.notes
    );
    let mut moving = good;
    let before = moving["samples"][6]["time_s"].as_f64().unwrap();
    moving["samples"][7]["time_s"] = json!(before + 0.5);
    let read = Set::from_json(&moving.to_string()).unwrap();
    assert!(
        read.notes[0].contains("counts as moving"),
        "{:?}",
        read.notes
    );
    let still = without_moving(&read);
    assert_eq!(still.samples.len(), set.samples.len() - 1);
}

#[test]
fn a_place_in_another_session_lies_within_the_stated_region() {
    for (attitude, outside) in [
        (false, Outside::None),
        (true, Outside::None),
        (true, Outside::Poses),
    ] {
        let (mut inside, mut ratio) = (0.0, 0.0);
        for seed in 31..=36 {
            let case = Case {
                samples: [20, 20],
                attitude,
                ..case(seed, outside)
            };
            let found = region(&case).unwrap();
            inside += found.inside / 6.0;
            ratio += found.rms_m / found.stated_m / 6.0;
        }
        assert!(inside > 0.9, "{outside:?}: {inside}");
        // Nor is it a region that holds everything.
        assert!(ratio > 0.4, "{outside:?}: {ratio}");
    }
}
