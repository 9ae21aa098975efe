//! Knocks by rests together, and the filter run again.

use super::super::tests::{all_rub, exact, loaded};
use super::super::{Prior, Report};
use super::*;
use crate::motion::Model;
use crate::random::Random;
use crate::robot::Robot;
use nalgebra::Vector3;

const PLACES: [[f64; 3]; 5] = [
    [0.08, 0.1, -0.1],
    [0.05, -0.12, -0.15],
    [-0.1, 0.08, -0.05],
    [-0.06, -0.1, -0.12],
    [0.0, 0.05, -0.2],
];

/// Without a camera four cables cannot tell whose anchor moved: eight can.
fn eight_cable() -> Robot {
    Robot::built_in("eight-cable").unwrap()
}

/// Rests of a machine at one place after the other, with the noise of means over a second.
fn rests_of(machine: &Robot, tracker: &mut Tracker, count: usize, seed: u64) -> Vec<Report> {
    let model = Model::new(machine).unwrap();
    let mut random = Random::new(seed);
    let places = PLACES.iter().cycle().take(count);
    let rest = |by: &[f64; 3]| {
        let (mut measured, _, near) = exact(&model, *by);
        for i in 0..measured.lengths_m.len() {
            measured.lengths_m[i] += 1e-5 * random.normal();
            measured.tensions_n[i] += 0.01 * random.normal();
        }
        tracker.pass(20.0, &measured.tensions_n);
        tracker.rest(&measured, &all_rub(&model, 0.0), &near)
    };
    places.map(rest).collect()
}

/// A tracker that knows an exact machine well.
fn settled(robot: &Robot) -> Tracker {
    let prior = Prior {
        creep: [0.0, 1e-6],
        loss: [0.0, 1e-3],
        ..Prior::default()
    };
    let mut tracker = Tracker::new(&Model::new(robot).unwrap(), &prior);
    let before = rests_of(robot, &mut tracker, 60, 1);
    assert!(before.iter().all(|rest| rest.fits && rest.named.is_none()));
    tracker
}

fn knocked(robot: &Robot, cable: usize, by_m: [f64; 3]) -> Robot {
    let mut moved = robot.clone();
    moved.cables[cable].anchor_in_world_m += Vector3::from(by_m);
    moved
}

#[test]
fn a_knock_that_no_single_rest_shows_is_named_by_rests_together() {
    let robot = eight_cable();
    let mut tracker = settled(&robot);
    let by_m = [0.0, 0.0, 0.5e-3];
    let moved = knocked(&robot, 0, by_m);
    let rests = rests_of(&moved, &mut tracker, 5, 2);
    let named = rests.iter().find_map(|rest| rest.named);
    let named = named.unwrap_or_else(|| panic!("nothing is named: {rests:?}"));
    assert!(rests.iter().all(|rest| rest.fits), "{rests:?}");
    assert_eq!(named.what, Moved::Anchor(1), "{named:?}");
    assert!(
        (named.by - Vector3::from(by_m)).norm() < 2.5e-4,
        "{named:?}"
    );
    // The states follow: the next rests fit and name nothing.
    let after = rests_of(&moved, &mut tracker, 20, 3);
    assert!(after.iter().all(|rest| rest.fits && rest.named.is_none()));
}

#[test]
fn what_touches_the_platform_in_one_rest_is_not_named() {
    let robot = eight_cable();
    for by_mm in [0.5, 1.0, 2.0, 5.0] {
        let mut tracker = settled(&robot);
        let touched = knocked(&robot, 1, [0.0, 0.6e-3 * by_mm, 0.8e-3 * by_mm]);
        let mut rests = rests_of(&touched, &mut tracker, 1, 4);
        rests.extend(rests_of(&robot, &mut tracker, 30, 5));
        let named = rests.iter().find_map(|rest| rest.named);
        assert!(named.is_none(), "{by_mm} mm: {named:?}");
    }
}

#[test]
fn a_hint_explains_what_a_free_anchor_does() {
    let robot = eight_cable();
    let tracker = settled(&robot);
    let moved = knocked(&robot, 0, [1e-3, 1e-3, 0.0]);
    let (measured, rubbing, near) = exact(&Model::new(&moved).unwrap(), PLACES[0]);
    let reading = Reading {
        measured,
        rubbing,
        near,
    };
    let taken = tracker.taken(&tracker.now, &reading).unwrap();
    for cable in 0..8 {
        let mut free = tracker.now.clone();
        Hypothesis(Moved::Anchor(cable + 1)).free(tracker.layout, &mut free);
        let explained = taken.fit.squares - tracker.taken(&free, &reading).unwrap().fit.squares;
        let said = taken.hints[cable].explains(ANCHOR_M);
        // Linearised at states that differ by a millimetre.
        assert!(
            (said - explained).abs() < 0.05 * explained.max(1.0),
            "{said} {explained}"
        );
    }
}

#[test]
fn without_a_cause_the_filter_ends_where_it_did() {
    let robot = Robot::built_in("lab-fast").unwrap();
    let model = Model::new(&robot).unwrap();
    let mut tracker = Tracker::new(&model, &Prior::default());
    for (count, by) in (0..).zip(PLACES) {
        let (measured, _, mut near) = exact(&model, by);
        if count == 1 {
            tracker.lift();
        } else if count == 3 {
            tracker.set_down();
        }
        near.position_m.x += 1e-4;
        tracker.pass(200.0, &measured.tensions_n);
        let report = tracker.rest(&measured, &all_rub(&model, 0.5), &near);
        assert!(report.fits && report.named.is_none(), "{report:?}");
    }
    tracker.pass(500.0, &[12.0; 4]);
    for onset in 0..tracker.recent.len() {
        let (fits, states) = tracker.again(onset, |_| ()).unwrap();
        let recorded = tracker.recent.iter().skip(onset).map(|rest| rest.fit);
        for (fit, was) in fits.iter().zip(recorded) {
            assert_eq!(fit.squares.to_bits(), was.squares.to_bits());
            assert_eq!(fit.log_volume.to_bits(), was.log_volume.to_bits());
        }
        assert_eq!(states.mean, tracker.now.mean, "from rest {onset}");
        assert_eq!(states.covariance, tracker.now.covariance);
    }
}

#[test]
fn a_rest_that_does_not_fit_counts_among_the_last_and_a_homing_ends_them() {
    let robot = eight_cable();
    let mut tracker = settled(&robot);
    assert_eq!(tracker.recent.len(), WINDOW);
    let last = |tracker: &Tracker| tracker.recent.back().unwrap().fit.squares;
    let model = Model::new(&robot).unwrap();
    let (mut measured, _, near) = exact(&model, PLACES[0]);
    measured.lengths_m[2] += 3e-3;
    measured.tensions_n[5] += 2.0;
    let report = tracker.rest(&measured, &all_rub(&model, 0.0), &near);
    assert!(!report.fits && report.named.is_none(), "{report:?}");
    let limit = chi2_quantile(tracker.recent.back().unwrap().fit.rows as f64, 6.0);
    assert!(last(&tracker) > limit, "{} {limit}", last(&tracker));
    tracker.homed(&measured.lengths_m);
    assert!(tracker.recent.is_empty());
}

/// A camera shows in looks alone, and minutes of work lie between two.
#[test]
fn the_last_looks_stay_while_other_rests_come_and_go() {
    let model = Model::new(&Robot::built_in("lab-fast").unwrap()).unwrap();
    let mut tracker = Tracker::new(&model, &Prior::default());
    let (measured, rubbing, near) = exact(&model, PLACES[0]);
    let mut take = |looks: bool, times: usize| {
        for _ in 0..times {
            let mut measured = measured.clone();
            if looks {
                measured.views.push(crate::sight::TagView {
                    id: 1,
                    corners_px: [[0.0; 2]; 4],
                    covariance_px2: [[[1.0, 0.0], [0.0, 1.0]]; 4],
                    image_time_us: 0,
                });
            }
            let reading = Reading {
                measured,
                rubbing: rubbing.clone(),
                near,
            };
            tracker.remember(tracker.now.clone(), reading, Fit::default(), Vec::new());
            tracker.pass(10.0, &[12.0; 4]);
        }
        let looks = tracker
            .recent
            .iter()
            .map(Recent::looked)
            .collect::<Vec<_>>();
        let events: usize = tracker.recent.iter().map(|rest| rest.since.len()).sum();
        (looks, events)
    };
    let blind = [false; WINDOW];
    assert_eq!(take(false, 30), (blind.to_vec(), WINDOW));
    let mut one = blind;
    one[0] = true;
    take(true, 1);
    // All that has happened since the look is still known.
    assert_eq!(take(false, 40), (one.to_vec(), 41));
    let mut two = one;
    two[1] = true;
    take(true, 1);
    assert_eq!(take(false, 40), (two.to_vec(), 82));
    // A third look takes the place of the first.
    take(true, 1);
    assert_eq!(take(false, 40).0, two.to_vec());
    // Looks of long ago go.
    let (looks, events) = take(false, 1000);
    assert_eq!(looks, blind.to_vec());
    assert_eq!(events, WINDOW);
}

#[test]
fn a_load_that_falls_or_loses_a_part_is_named_and_no_anchor_is_blamed() {
    for name in ["lab-fast", "eight-cable"] {
        let robot = Robot::built_in(name).unwrap();
        let load_kg = 0.3 * robot.platform.mass_kg;
        for left in [0.0, 0.6] {
            let mut tracker = settled(&robot);
            tracker.lift();
            let carried = rests_of(&loaded(&robot, load_kg).0, &mut tracker, 4, 6);
            assert!(carried.iter().all(|rest| rest.fits && rest.named.is_none()));
            let (after, _) = loaded(&robot, left * load_kg);
            let rests = rests_of(&after, &mut tracker, 4, 7);
            let named = rests.iter().find_map(|rest| rest.named);
            let named = named.unwrap_or_else(|| panic!("{name}: nothing is named: {rests:?}"));
            assert_eq!(named.what, Moved::Payload, "{name}: {named:?}");
            let lost_kg = (1.0 - left) * load_kg;
            assert!(
                (named.by.x / lost_kg + 1.0).abs() < 0.1,
                "{name}: {named:?} of {lost_kg} kg"
            );
        }
    }
}
