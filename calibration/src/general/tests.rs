//! The estimate on data of a known machine, and the verdict on faulty data.

use super::first::{first_pose, pose_of};
use super::fit::{Options, fit};
use super::model::{Group, Model, Row, State, stepped_own};
use super::predict::{predict, score};
use super::simulate::{Case, SimulatedSlip, simulate};
use super::study::{given, study};
use super::unknowns::{Layout, unknowns};
use super::verdict::verdict;
use super::{Priors, Set, solve};
use mcdpr_kinematics::Pose;

fn case(seed: u64) -> Case {
    Case {
        seed,
        ..Case::default()
    }
}

#[test]
fn every_derivative_matches_differences() {
    let (set, truth) = simulate(&Case {
        samples: [3, 3],
        ..case(3)
    })
    .unwrap();
    let layout = Layout {
        cables: 4,
        bodies: None,
        trackers: Vec::new(),
        tapes: Vec::new(),
        sessions: vec![0, 1],
        breaks: vec![super::unknowns::Break {
            cable: 2,
            session: 1,
            from: 4,
        }],
    };
    let model = Model {
        set: &set,
        layout: layout.clone(),
        middle_m: 1.7,
    };
    let known = unknowns(&set, &layout, &Priors::default());
    let mut state = solve::start(&model, &known);
    for (i, value) in state.theta.iter_mut().enumerate() {
        *value += 0.3 * known[i].sigma.min(0.01) * (1.7 * i as f64).sin();
    }
    slopes_match(&model, &state, &truth.poses, |row, reported| {
        // The derivatives leave out the effect of the wrap angle on a pulley's loss.
        let small = if row.group == Group::Tension {
            3.0
        } else {
            0.0
        };
        // The mounting turns about axes that are a little turned by itself.
        let attitude = row.group <= Group::Yaw && row.group >= Group::Tilt;
        let turned = 2e-2 * f64::from(u8::from(attitude));
        Some(small + turned + 2e-2 * reported.abs() + 1e-5 * (1.0 + reported.abs()))
    });
}

/// Compares every derivative with differences; `limit` gives how far a row's may be off, or leaves the row out.
pub(super) fn slopes_match(
    model: &Model<'_>,
    state: &State,
    poses: &[Pose],
    limit: impl Fn(&Row, f64) -> Option<f64>,
) {
    let layout = &model.layout;
    let own = layout.own();
    let tensions = vec![90.0, 60.0, 120.0, 80.0];
    for (k, (sample, pose)) in model.set.samples.iter().zip(poses).enumerate() {
        let rows = model.rows(state, sample, k, pose, &tensions).unwrap();
        for j in 0..own + layout.len() {
            let residuals = |step: f64| {
                let (mut a, mut b) = (vec![0.0; own], vec![0.0; layout.len()]);
                if j < own {
                    a[j] = step;
                } else {
                    b[j - own] = step;
                }
                let (pose, tensions) = stepped_own(pose, &tensions, &a);
                let state = model.stepped(state, &b);
                let rows = model.rows(&state, sample, k, &pose, &tensions).unwrap();
                rows.iter().map(|row| row.residual).collect::<Vec<_>>()
            };
            let (up, down) = (residuals(1e-6), residuals(-1e-6));
            for (i, row) in rows.iter().enumerate() {
                let slope = (up[i] - down[i]) / 2e-6;
                let entries = row.shared.iter();
                let reported = if j < own {
                    row.own[j]
                } else {
                    entries.filter(|e| e.at == j - own).map(|e| e.slope).sum()
                };
                if let Some(limit) = limit(row, reported) {
                    assert!(
                        (slope - reported).abs() < limit,
                        "sample {k}, {:?} {}, unknown {j}: {slope} {reported}",
                        row.group,
                        row.index
                    );
                }
            }
        }
    }
}

#[test]
fn intervals_hold_for_readings_that_were_not_seen() {
    let (mut inside, mut all) = ([0.0; 3], [0.0; 3]);
    for seed in 1..=6 {
        let (set, _) = simulate(&case(seed)).unwrap();
        let found = study(&set, "first", &Options::default()).unwrap();
        assert_eq!(found.verdict.refused, None);
        for errors in [found.held_out, found.other_sessions.unwrap()] {
            assert!(errors.length_mm.unwrap() < 4.0 && errors.tilt_deg.unwrap() < 0.8);
            let n = errors.samples as f64;
            let shares = [
                errors.inside.length_mm,
                errors.inside.tilt_deg,
                errors.inside.tension_n,
            ];
            for (k, share) in shares.into_iter().enumerate() {
                inside[k] += share.unwrap() * n;
                all[k] += n;
            }
        }
    }
    for k in 0..3 {
        let share = inside[k] / all[k];
        assert!(
            (0.90..=1.0).contains(&share),
            "sensor {k}: {share:.3} within 95 %"
        );
    }
}

#[test]
fn a_drum_that_is_larger_is_found_within_its_interval() {
    let mut within = 0;
    for seed in 1..=6 {
        let (set, truth) = simulate(&Case {
            drum: 0.01,
            ..case(seed)
        })
        .unwrap();
        let found = fit(&set, &Options::default()).unwrap();
        let at = found.layout.drum(0);
        let sigma = found.solution.covariance[(at, at)].sqrt();
        assert!(sigma < 0.006);
        let off = found.solution.state.theta[at] - truth.drums[0];
        within += usize::from(off.abs() < 2.0 * sigma);
    }
    assert!(within >= 5, "{within} of 6");
}

#[test]
fn a_slip_is_named_with_its_cable_and_its_sample() {
    let mut named = 0;
    for seed in 1..=6 {
        let (cable, from) = ((seed as usize) % 4, 8 + seed as usize);
        let (set, _) = simulate(&Case {
            slip: Some(SimulatedSlip {
                cable,
                from,
                size_m: 0.01,
            }),
            ..case(seed)
        })
        .unwrap();
        let found = fit(&set, &Options::default()).unwrap();
        let words = verdict(&found).slips;
        assert!(
            !words.is_empty(),
            "seed {seed}: a slip of 10 mm goes unseen"
        );
        let right = found
            .layout
            .breaks
            .iter()
            .any(|slip| slip.cable == cable && slip.from == from);
        named += usize::from(right);
    }
    assert!(named >= 5, "{named} of 6 are named");
    let mut alarms = 0;
    for seed in 1..=6 {
        let (set, _) = simulate(&case(seed)).unwrap();
        let found = fit(&set, &Options::default()).unwrap();
        alarms += usize::from(!found.layout.breaks.is_empty());
    }
    assert_eq!(alarms, 0);
}

#[test]
fn the_first_pose_comes_from_changes_alone() {
    for seed in 1..=4 {
        let (set, truth) = simulate(&case(seed)).unwrap();
        let mut first = set.only(|_, sample| sample.session == 0);
        // The encoders report only changes.
        for sample in &mut first.samples {
            for (i, length) in sample.length_m.iter_mut().enumerate() {
                *length = length.map(|l| l - 0.2 * i as f64 - 0.1);
            }
        }
        let found = first_pose(&first).unwrap();
        let off = found.pose.position_m - truth.poses[0].position_m;
        let stated = found.covariance.fixed_view::<3, 3>(0, 0).trace().sqrt();
        assert!(
            off.norm() < 0.012,
            "seed {seed}: {:.1} mm",
            off.norm() * 1e3
        );
        assert!(off.norm() < 3.0 * stated);
    }
}

#[test]
fn common_gain_and_mass_are_said_to_be_one_and_anchors_to_stay_open() {
    let (set, _) = simulate(&case(2)).unwrap();
    let priors = Priors {
        gain: 1.0,
        zero_n: 0.01,
        zero_session_n: 0.01,
        mass: 0.2,
        ..Priors::default()
    };
    let options = Options {
        priors,
        ..Options::default()
    };
    let said = verdict(&fit(&set, &options).unwrap());
    let one = said
        .together
        .iter()
        .any(|line| line.contains("common gain and the mass"));
    assert!(one, "{:?}", said.together);
    let open = said
        .open
        .iter()
        .filter(|line| line.contains("anchor"))
        .count();
    assert!(open > 6, "{:?}", said.open);
}

#[test]
fn a_wrong_radius_is_named_with_the_radius_that_the_data_want() {
    let (mut set, _) = simulate(&case(4)).unwrap();
    for cable in &mut set.robot.cables {
        cable.pulley_radius_m = 0.015;
    }
    let said = verdict(&fit(&set, &Options::default()).unwrap());
    let named = said
        .contradicted
        .iter()
        .any(|line| line.contains("pulley radius"));
    assert!(named || said.refused.is_some(), "{said:?}");
}

#[test]
fn version_2_is_read_back_and_a_reading_that_is_no_number_is_named() {
    let (set, _) = simulate(&case(5)).unwrap();
    let text = serde_json::to_string(&set.to_json()).unwrap();
    let back = Set::from_json(&text).unwrap();
    assert_eq!(back.samples.len(), set.samples.len());
    let near = |a: &[Option<f64>], b: &[Option<f64>]| {
        a.iter()
            .zip(b)
            .all(|(a, b)| (a.unwrap() - b.unwrap()).abs() < 1e-12)
    };
    assert!(near(&back.samples[7].length_m, &set.samples[7].length_m));
    let mut value = set.to_json();
    value["samples"][2]["tension_N"][1] = serde_json::json!("here");
    let text = serde_json::to_string(&value)
        .unwrap()
        .replace("\"here\"", "NaN");
    let back = Set::from_json(&text).unwrap();
    assert_eq!(back.samples[2].tension_n[1], None);
    assert_eq!(
        back.notes,
        ["sample 3: cable 2's tension is not a finite number: left out"]
    );
    assert!(fit(&back, &Options::default()).is_ok());
}

#[test]
fn the_layout_of_other_laboratories_is_read() {
    let text = r#"{"robot": {"name": "r", "platform": {"mass_kg": 3, "center_of_mass_m": [0, 0, 0.1]},
        "pulley_radius_m": 0.02, "anchors_m": [[1, 0, 2], [-1, 1, 2], [-1, -1, 2]],
        "swivel_axes": [[1, 0, 0], [-1, 0, 0], [-1, 0, 0]],
        "attachments_m": [[0.1, 0, 0], [-0.1, 0.1, 0], [-0.1, -0.1, 0]]},
        "samples": [{"log": "a", "t_s": 1, "lengths_m": [1, 1.5, null], "speed_mps": [0, -0.2, 0]},
                    {"log": "b", "ahrs_rad": [0.1, 0.2, 0.3]}]}"#;
    let set = Set::from_json(text).unwrap();
    assert_eq!(set.sessions, ["a", "b"]);
    assert!(set.robot.absolute);
    assert_eq!(set.samples[0].length_m, [Some(1.0), Some(1.5), None]);
    assert_eq!(set.samples[0].speed_mps, Some(0.2));
    assert_eq!(set.samples[1].rpy_rad, [Some(0.1), Some(0.2), Some(0.3)]);
    let still = super::verdict::without_moving(&set);
    assert_eq!(still.samples.len(), 1);
    assert_eq!(
        still.notes,
        ["sample 1 of a (1.0 s): a cable moved at 200 mm/s: left out"]
    );
    let error = study(&set, "c", &Options::default()).unwrap_err();
    assert_eq!(error, "there is no session c in the data; there are a, b");
}

#[test]
fn without_swivels_and_inclinometer_lengths_and_tensions_still_calibrate() {
    let (set, _) = simulate(&Case {
        attitude: false,
        samples: [40, 12],
        ..case(6)
    })
    .unwrap();
    let seen = set.only(|_, sample| sample.session == 0);
    let held = set.only(|_, sample| sample.session == 1);
    let found = fit(&seen, &Options::default()).unwrap();
    let answers: Vec<_> = predict(&found, &held, &given(4), &Priors::default())
        .into_iter()
        .collect::<Result<_, _>>()
        .unwrap();
    assert!(score(&answers, Group::Length, 1e3).unwrap().inside > 0.8);
    assert!(pose_of(&found, 0).is_some());
}
