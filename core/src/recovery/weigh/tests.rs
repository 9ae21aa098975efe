use super::*;
use crate::motion::StaticState;
use crate::recovery::journal::{Identity, Kept, KeptCable};
use crate::recovery::looks::RestReadings;
use crate::recovery::verdict::judge;
use crate::robot::Robot;
use mcdpr_protocol::BoardState;
use nalgebra::{Matrix4, Vector4};

/// The state with all four lengths held by brakes: tool and tension of the fourth cable by Newton's
/// method with finite differences.
fn rest_on_brakes(model: &Model, lengths_m: &[f64], start: &StaticState) -> StaticState {
    let tool_m = model.tool_m(start);
    let mut x = Vector4::new(tool_m.x, tool_m.y, tool_m.z, start.tensions_n()[3]);
    let at = |x: &Vector4<f64>| model.rest_with(&x.xyz(), x.w, None).unwrap();
    let error_m = |rest: &StaticState| Vector4::from_fn(|i, _| lengths_m[i] - rest.paid_out_m[i]);
    for _ in 0..40 {
        let rest = at(&x);
        let off_m = error_m(&rest);
        if off_m.norm() < 1e-9 {
            return rest;
        }
        let mut slopes = Matrix4::zeros();
        for (column, step) in [1e-5, 1e-5, 1e-5, 1e-2].into_iter().enumerate() {
            let mut moved = x;
            moved[column] += step;
            slopes.set_column(column, &((off_m - error_m(&at(&moved))) / step));
        }
        x += slopes.lu().solve(&off_m).unwrap();
    }
    panic!("no equilibrium with lengths {lengths_m:?}");
}

/// A robot that hangs at home and counts its drums; the true lengths differ by `slip_m` of one cable.
fn slipped_robot(slip_m: f64) -> (Model, Vec<f64>, RestReadings, Vector3<f64>) {
    let model = Model::new(&Robot::built_in("lab-fast").unwrap()).unwrap();
    let home = model.rest_at_home().unwrap();
    let counted_m = home.paid_out_m.clone();
    let mut true_m = counted_m.clone();
    true_m[1] += slip_m;
    let rest = rest_on_brakes(&model, &true_m, &home);
    let tensions_n = rest.tensions_n().to_vec();
    let readings = RestReadings {
        least_n: tensions_n.clone(),
        tension_errors_n: vec![0.02; 4],
        tensions_n,
        ..RestReadings::default()
    };
    let truth_m = model.tool_m(&rest);
    (model, counted_m, readings, truth_m)
}

fn evidence(lengths_m: Vec<f64>, rest: RestReadings) -> Evidence<'static> {
    Evidence {
        source: Source::Board { lengths_m },
        rest,
        seen: Measurements::default(),
        reference: None,
        untouched: false,
        together: false,
        registers_m: None,
        bound_m: 0.05,
    }
}

#[test]
fn the_bound_covers_a_slip_that_is_not_detected() {
    // The largest slip that the tensions do not show yet.
    let mut found = None;
    for step in 1..100 {
        let slip_m = f64::from(step) * 5e-5;
        let (model, counted_m, rest, truth_m) = slipped_robot(slip_m);
        let evidence = evidence(counted_m, rest);
        let estimates = estimates(&model, &evidence).unwrap().unwrap();
        if !estimates.fits() {
            break;
        }
        found = Some((estimates, truth_m, slip_m));
    }
    let (estimates, truth_m, slip_m) = found.unwrap();
    let error_m = (estimates.best().tool_m - truth_m).norm();
    assert!(slip_m > 1e-3, "{slip_m}");
    // Statistics alone do not cover it: they know no slip.
    assert!(
        error_m > estimates.bound_95_m,
        "{error_m} m, {} m",
        estimates.bound_95_m
    );
    let bound_m = estimates.bound_m();
    assert!(error_m < bound_m, "{error_m} m, {bound_m} m");
    // The bound is that of the slip, some times the statistical one.
    assert!(
        bound_m > 2.0 * estimates.bound_95_m && bound_m >= estimates.integrity_bound_m,
        "{bound_m} m, {} m",
        estimates.bound_95_m
    );
}

/// The journal of a robot that held at home with open brakes; its program continued.
fn journal(lengths_m: &[f64], tensions_n: &[f64]) -> Journal {
    let cables = lengths_m.iter().zip(tensions_n);
    let cables = cables.map(|(length_m, tension_n)| KeptCable {
        length_m: *length_m,
        setpoint_m: *length_m,
        speed_mps: 0.0,
        tension_n: *tension_n,
    });
    Journal {
        identity: Identity {
            board: "00".to_owned(),
            session: 1,
            robot: "lab-fast".to_owned(),
            scale: 1,
            task: "t".to_owned(),
            task_hash: 1,
            wall_ms: 0,
        },
        plan: None,
        last: Some(Kept {
            brakes_open: 15,
            referenced: true,
            cables: cables.collect(),
            ..Kept::default()
        }),
        still: None,
        path_ms: 0,
        ended: true,
        number: 1,
        torn_bytes: 0,
    }
}

/// A journal and these tensions of a robot that nobody has touched; no camera.
fn untouched(journal: &Journal, tensions_n: Vec<f64>) -> Evidence<'_> {
    Evidence {
        source: Source::Journal(journal),
        rest: RestReadings {
            least_n: tensions_n.clone(),
            tension_errors_n: vec![0.02; 4],
            tensions_n,
            ..RestReadings::default()
        },
        seen: Measurements::default(),
        reference: None,
        untouched: true,
        together: true,
        registers_m: None,
        bound_m: 0.05,
    }
}

#[test]
fn without_a_tag_the_bound_reaches_both_causes_of_a_cut() {
    // Drums that nothing holds until their brakes close: otherwise both causes are one.
    let mut robot = Robot::built_in("lab-fast").unwrap();
    for winch in &mut robot.winches {
        winch.drive_hold_up_s = 0.0;
    }
    let model = Model::new(&robot).unwrap();
    let home = model.rest_at_home().unwrap();
    let journal = journal(&home.paid_out_m, home.tensions_n());
    for torque_gone in [0.0, 1.0] {
        let cut = Cut {
            unseen_s: 0.0,
            unseen_sd_s: 0.0,
            torque_gone,
        };
        let last = journal.last.as_ref().unwrap();
        let lengths = lengths_after(&model, &home, last, &cut);
        let true_m: Vec<f64> = lengths.mean_m.iter().copied().collect();
        let rest = rest_on_brakes(&model, &true_m, &home);
        let evidence = untouched(&journal, rest.tensions_n().to_vec());
        let estimates = estimates(&model, &evidence).unwrap().unwrap();
        let error_m = (estimates.best().tool_m - model.tool_m(&rest)).norm();
        let bound_m = estimates.bound_95_m;
        assert!(error_m > 5e-4, "the estimate is in between: {error_m} m");
        assert!(error_m < bound_m, "{error_m} m, {bound_m} m");
    }
}

#[test]
fn a_large_slip_is_refused_and_its_drum_named() {
    let (model, counted_m, rest, _) = slipped_robot(0.002);
    let verdict = judge(&model, &evidence(counted_m, rest)).unwrap();
    assert!(!verdict.accepted, "{}", verdict.sentence);
    assert!(verdict.sentence.contains("drum 2"), "{}", verdict.sentence);
}

#[test]
fn a_slack_cable_is_refused_with_its_name_whatever_else_agrees() {
    let (model, counted_m, mut rest, _) = slipped_robot(0.0);
    let good = judge(&model, &evidence(counted_m.clone(), rest.clone())).unwrap();
    assert!(good.accepted, "{}", good.sentence);
    (rest.tensions_n[2], rest.least_n[2]) = (0.1, 0.0);
    let verdict = judge(&model, &evidence(counted_m, rest)).unwrap();
    assert!(!verdict.accepted);
    assert!(
        verdict.sentence.contains("cable 3 is slack"),
        "{}",
        verdict.sentence
    );
    assert!(
        verdict.next.contains("mcdpr rig tension"),
        "{}",
        verdict.next
    );
}

#[test]
fn a_platform_that_sinks_is_refused_until_it_rests() {
    let (model, counted_m, mut rest, _) = slipped_robot(0.0);
    rest.drift_n = vec![0.0, -0.6, 0.0, 0.0];
    let verdict = judge(&model, &evidence(counted_m, rest)).unwrap();
    assert!(
        !verdict.accepted && verdict.sentence.contains("tension 2"),
        "{}",
        verdict.sentence
    );
    assert!(verdict.next.contains("recover again"), "{}", verdict.next);
}

#[test]
fn a_swing_widens_the_bound() {
    let (model, counted_m, mut rest, _) = slipped_robot(0.0);
    let still = judge(&model, &evidence(counted_m.clone(), rest.clone())).unwrap();
    rest.tension_errors_n = vec![2.0; 4];
    let swinging = judge(&model, &evidence(counted_m, rest)).unwrap();
    let bounds = still.bound_mm.zip(swinging.bound_mm).unwrap();
    assert!(bounds.1 > 1.2 * bounds.0, "{bounds:?}");
}

#[test]
fn a_journal_that_ends_in_motion_with_its_computer_needs_a_confirmation() {
    let (model, counted_m, rest, _) = slipped_robot(0.0);
    let mut journal = journal(&counted_m, &rest.tensions_n);
    let mut judged = |ended: bool, state: BoardState, together: bool| {
        journal.ended = ended;
        journal.last.as_mut().unwrap().state = state;
        let evidence = Evidence {
            source: Source::Journal(&journal),
            rest: rest.clone(),
            seen: Measurements::default(),
            reference: None,
            untouched: true,
            together,
            registers_m: None,
            bound_m: 0.05,
        };
        judge(&model, &evidence).unwrap()
    };
    let verdict = judged(false, BoardState::Moving, false);
    assert!(!verdict.accepted);
    assert!(verdict.next.contains("--together"), "{}", verdict.next);
    // With the confirmation, with a program that lived on, and at rest nothing is unknown.
    for (ended, state, together) in [
        (false, BoardState::Moving, true),
        (true, BoardState::Moving, false),
        (false, BoardState::Holding, false),
    ] {
        let verdict = judged(ended, state, together);
        assert!(verdict.accepted, "{}", verdict.sentence);
    }
}

#[test]
fn a_battery_shows_where_the_board_stopped_though_its_computer_failed_long_before() {
    let (model, counted_m, rest, _) = slipped_robot(0.0);
    let mut old = journal(&counted_m, &rest.tensions_n);
    old.ended = false;
    // The last record is of another place, in motion: the board moved on by 8 mm of each cable.
    let last = old.last.as_mut().unwrap();
    last.state = BoardState::Moving;
    for cable in &mut last.cables {
        cable.length_m -= 8e-3;
    }
    let judged = |registers_m: Option<Vec<f64>>| {
        let evidence = Evidence {
            source: Source::Journal(&old),
            rest: rest.clone(),
            seen: Measurements::default(),
            reference: None,
            untouched: true,
            together: false,
            registers_m,
            bound_m: 0.05,
        };
        judge(&model, &evidence).unwrap()
    };
    assert!(!judged(None).accepted);
    let verdict = judged(Some(counted_m.clone()));
    assert!(verdict.accepted, "{}", verdict.sentence);
    let home = model
        .rest_from_lengths(&counted_m, &rest.tensions_n)
        .unwrap();
    let tool_mm = nalgebra::Vector3::from(verdict.tool_mm.unwrap());
    assert!(
        (tool_mm - model.tool_m(&home) * 1e3).norm() < 1.5,
        "{tool_mm}"
    );
}

#[test]
fn a_board_that_counted_through_its_reset_knows_its_lengths_as_well_as_it_was_slow() {
    let lengths_m = [1.0; 4];
    let still = Lengths::counted_on(&lengths_m, &[[0.0, 0.0]; 4]);
    let fast = Lengths::counted_on(&lengths_m, &[[0.4, 0.0]; 4]);
    let unknown = Lengths::counted_on(&lengths_m, &[[0.0, 0.4]; 4]);
    assert_eq!(still, Lengths::counted(&lengths_m));
    // Uniform within a tick and the start of the counters, 1.05 ms: mean 0.21 mm, standard deviation 0.12 mm.
    assert!((fast.mean_m[0] - 1.0 - 0.21e-3).abs() < 1e-9);
    let own = |of: &Lengths| (of.sigma_m(0).powi(2) - still.sigma_m(0).powi(2)).sqrt();
    assert!((own(&fast) - 0.42e-3 / 12_f64.sqrt()).abs() < 1e-9);
    assert!((own(&unknown) - 0.42e-3 / 3_f64.sqrt()).abs() < 1e-9);
}

#[test]
fn two_causes_with_the_same_lengths_have_the_bound_of_one() {
    // Behind a rail that outlasts the contactor it makes no difference whether the drives lost their supply.
    let model = Model::new(&Robot::built_in("lab-fast").unwrap()).unwrap();
    let home = model.rest_at_home().unwrap();
    let journal = journal(&home.paid_out_m, home.tensions_n());
    let evidence = untouched(&journal, home.tensions_n().to_vec());
    let estimates = estimates(&model, &evidence).unwrap().unwrap();
    let sigma_m = estimates.covariance_m2.diagonal().max().sqrt();
    // 95 % of one axis alone are within 1.96 standard deviations.
    assert!(
        estimates.bound_95_m > 1.9 * sigma_m,
        "{} m, {sigma_m} m",
        estimates.bound_95_m
    );
}
