//! What rests teach.

use super::*;
use crate::estimate::region::tool_per_pose;
use crate::estimate::tube::{Doubts, Errors};
use crate::robot::{Robot, TagPlace};
use crate::sight::TagView;
use nalgebra::Vector3;

fn model() -> Model {
    Model::new(&Robot::built_in("lab-fast").unwrap()).unwrap()
}

/// A rest as a robot without any error would measure it, with its tool moved from home.
pub(super) fn exact(model: &Model, by_m: [f64; 3]) -> (Measurements, Vec<Rubbing>, Pose) {
    let tool = model.robot().tool.home_in_world_m + Vector3::from(by_m);
    let rest = model.rest(&tool, None).unwrap();
    let measured = Measurements {
        lengths_m: rest.paid_out_m.clone(),
        tensions_n: rest.tensions_n().to_vec(),
        ..Measurements::default()
    };
    (measured, all_rub(model, 0.0), rest.equilibrium.pose)
}

/// Friction of all pulleys alike, about as sure as after a turn.
pub(super) fn all_rub(model: &Model, side: f64) -> Vec<Rubbing> {
    let friction = Rubbing { side, unsure: 0.26 };
    vec![friction; model.robot().cables.len()]
}

/// A robot with a load below its gripper, as its own statics have it, and where the load is, platform's frame, m.
pub(super) fn loaded(robot: &Robot, load_kg: f64) -> (Robot, Vector3<f64>) {
    let mut heavy = robot.clone();
    let at = heavy.tool.tcp_in_platform_m + Vector3::new(0.008, -0.006, -0.03);
    let platform = &mut heavy.platform;
    let whole_kg = platform.mass_kg + load_kg;
    platform.center_of_mass_m =
        (platform.center_of_mass_m * platform.mass_kg + at * load_kg) / whole_kg;
    platform.mass_kg = whole_kg;
    (heavy, at)
}

/// A tag, at a place in the world, as the robot's camera sees it from a pose with its bracket bent along the picture.
fn seen(
    robot: &Robot,
    tag: &crate::robot::Tag,
    world_from_body: Pose,
    platform: &Pose,
    bent_m: f64,
) -> (Vec<TagView>, Vec<TagPlace>) {
    let camera_from_body = robot
        .camera
        .camera_from_platform
        .compose(&platform.inverse())
        .compose(&world_from_body);
    let corners_px = tag.corners_in_body_m.map(|corner| {
        let mut seen = camera_from_body.transform(&corner);
        seen.x += bent_m;
        let pixel = robot.camera.lens.projection(&seen.into()).unwrap().pixel;
        [pixel.x, pixel.y]
    });
    let view = TagView {
        id: tag.id,
        corners_px,
        covariance_px2: [[[0.01, 0.0], [0.0, 0.01]]; 4],
        image_time_us: 0,
    };
    let place = TagPlace {
        body: tag.body,
        world_from_body,
    };
    (vec![view], vec![place])
}

#[test]
fn a_rest_without_errors_teaches_no_change_and_less_uncertainty() {
    let model = model();
    let prior = Prior {
        creep: [0.0, 1e-3],
        loss: [0.0, 0.01],
        ..Prior::default()
    };
    let mut tracker = Tracker::new(&model, &prior);
    let before = tracker.now.clone();
    for by in [[0.0; 3], [0.05, 0.0, -0.1], [0.1, 0.1, -0.05]] {
        let (measured, rubbing, near) = exact(&model, by);
        let report = tracker.rest(&measured, &rubbing, &near);
        assert!(report.fits && report.doubt < 1e-3, "{report:?}");
    }
    let layout = tracker.layout;
    for state in 0..layout.size() {
        assert!(tracker.now.variance(state) <= before.variance(state) * (1.0 + 1e-9));
    }
    let mass = layout.platform();
    assert!(tracker.now.mean[mass].abs() < 1e-5);
    assert!(tracker.now.variance(mass) < 0.5 * before.variance(mass));
}

#[test]
fn what_nothing_observes_stays_as_uncertain_as_it_is() {
    let model = model();
    let mut tracker = Tracker::new(&model, &Prior::default());
    let layout = tracker.layout;
    // All anchors together: the frame has moved, and without a camera nothing shows it.
    let mut row = vec![0.0; layout.size()];
    for cable in 0..4 {
        row[layout.anchor(cable)] = 0.25;
    }
    let before = tracker.now.spread(&[row.clone()])[0][0];
    for k in 0..20 {
        let (measured, rubbing, near) = exact(&model, [0.01 * f64::from(k), 0.0, -0.1]);
        tracker.rest(&measured, &rubbing, &near);
    }
    let after = tracker.now.spread(&[row])[0][0];
    assert!(after > 0.99 * before, "{after} of {before}");
    // And the camera's mounting, which it never used.
    let camera = layout.camera();
    assert!((tracker.now.variance(camera) / 1e-8 - 1.0).abs() < 1e-9);
}

#[test]
fn a_payload_is_weighed_by_one_rest_and_forgotten_when_it_is_set_down() {
    let model = model();
    let mut tracker = Tracker::new(&model, &Prior::default());
    for by in [
        [0.0; 3],
        [0.05, 0.0, -0.1],
        [0.1, 0.1, -0.05],
        [0.0, 0.1, -0.1],
    ] {
        let (measured, rubbing, near) = exact(&model, by);
        tracker.rest(&measured, &rubbing, &near);
    }
    assert_eq!(tracker.load(), None);
    let (heavy, at) = loaded(model.robot(), 0.6);
    let mass = model.robot().platform.mass_kg;
    let (measured, rubbing, near) = exact(&Model::new(&heavy).unwrap(), [0.05, 0.0, -0.1]);
    tracker.lift();
    assert!(tracker.rest(&measured, &rubbing, &near).fits);
    let load = tracker.load().unwrap();
    // Readings are exact; the prior of sensors and losses leaves this much.
    assert!((load.mass_kg / 0.6 - 1.0).abs() < 0.01, "{load:?}");
    assert!((load.center_m - at).xy().norm() < 2e-3, "{load:?} {at}");
    let planned = tracker.robot().platform.mass_kg;
    assert!((planned - mass - 0.6).abs() < 0.03, "plans use it at once");
    tracker.set_down();
    assert_eq!(tracker.load(), None);
    assert!((tracker.robot().platform.mass_kg - mass).abs() < 0.03);
}

#[test]
fn plans_follow_in_bounded_steps_and_a_wild_rest_is_not_followed() {
    let model = model();
    let mut tracker = Tracker::new(&model, &Prior::default());
    let (measured, rubbing, near) = exact(&model, [0.0; 3]);
    tracker.rest(&measured, &rubbing, &near);
    let robot = tracker.robot();
    // Two cables 20 mm off at once: no single cause explains it.
    let mut wild = measured.clone();
    wild.lengths_m[0] += 0.02;
    wild.lengths_m[2] -= 0.03;
    wild.tensions_n[1] += 3.0;
    let report = tracker.rest(&wild, &rubbing, &near);
    assert!(!report.fits && report.named.is_none(), "{report:?}");
    assert_eq!(tracker.robot(), robot);
    // Nor a reading that is no number.
    wild.tensions_n[1] = f64::NAN;
    assert!(!tracker.rest(&wild, &rubbing, &near).fits);
    assert_eq!(tracker.robot(), robot);
}

#[test]
fn a_bent_camera_is_named_by_two_looks_though_rests_between_them_fit() {
    let model = model();
    let mut tracker = Tracker::new(&model, &Prior::default());
    let robot = model.robot();
    let tag = robot.tags[0].clone();
    let floor = Vector3::new(0.33, 0.0, -0.72);
    // What a camera sees whose bracket is bent by a shift along the picture.
    let look = |by_m: [f64; 3], bent_m: f64| {
        let (mut measured, rubbing, near) = exact(&model, by_m);
        (measured.views, measured.places) = seen(robot, &tag, Pose::level(floor), &near, bent_m);
        (measured, rubbing, near)
    };
    let places = [[0.08, 0.1, -0.1], [0.05, 0.12, -0.15], [0.1, 0.08, -0.05]];
    for by in places {
        let (measured, rubbing, near) = look(by, 0.0);
        assert!(tracker.rest(&measured, &rubbing, &near).fits);
    }
    let before = tracker.robot();
    let (measured, rubbing, near) = look(places[0], 3e-3);
    let first = tracker.rest(&measured, &rubbing, &near);
    assert!(!first.fits && first.named.is_none(), "{first:?}");
    // Noticed, and not followed.
    assert_eq!(tracker.robot(), before);
    for by in places {
        let (measured, rubbing, near) = exact(&model, by);
        assert!(tracker.rest(&measured, &rubbing, &near).fits);
    }
    let (measured, rubbing, near) = look(places[1], 3e-3);
    let named = tracker.rest(&measured, &rubbing, &near).named.unwrap();
    assert_eq!(named.what, Moved::Camera, "{named:?}");
    assert!((named.by.norm() - 3e-3).abs() < 1e-3, "{named:?}");
}

#[test]
fn the_tube_of_tracked_states_is_as_wide_as_their_region() {
    let model = model();
    let mut tracker = Tracker::new(
        &model,
        &Prior {
            step_m: 1.0,
            // The region lets the mean loss move the tool, plans do not know of it.
            loss: [0.0, 0.01],
            ..Prior::default()
        },
    );
    let doubts = Doubts {
        attachment_m: 0.0,
        ..Doubts::within(5e-3)
    };
    let mut widths_m = Vec::new();
    for by in [
        [0.0; 3],
        [0.05, 0.0, -0.1],
        [0.1, 0.1, -0.05],
        [0.0, 0.1, -0.1],
    ] {
        let (measured, rubbing, near) = exact(&model, by);
        let planner = tracker.model(&model).unwrap();
        let rest = planner
            .rest_from_lengths(&measured.lengths_m, &measured.tensions_n)
            .unwrap();
        let tensions_n = rest.tensions_n().to_vec();
        let belief = tracker.belief(0.0, &tensions_n, &doubts);
        let platform = belief.platform_at(&planner, &rest).unwrap().unwrap();
        let said = tracker
            .region(&measured, &all_rub(&model, 1.0), &near)
            .unwrap();
        let arm = rest.equilibrium.pose.rotation * model.robot().tool.tcp_in_platform_m;
        let by_pose = tool_per_pose(&arm);
        let tool = by_pose * platform * by_pose.transpose();
        let ratio = (tool.trace() / said.covariance_m2.trace()).sqrt();
        widths_m.push((
            ratio,
            tool.trace().sqrt(),
            said.covariance_m2.trace().sqrt(),
        ));
        tracker.rest(&measured, &rubbing, &near);
    }
    // Before the first rest a region is narrower: it uses the length of the tension-held cable, too, of which a plan knows
    // nothing.
    for (ratio, ..) in &widths_m[1..] {
        assert!((0.95..1.1).contains(ratio), "{widths_m:?}");
    }
}

#[test]
fn a_tube_counts_what_plans_lag_behind_and_the_creep_to_come() {
    let model = model();
    let doubts = Doubts::within(5e-3);
    let spread = |tracker: &Tracker, seconds: f64| {
        let rest = tracker.model(&model).unwrap().rest_at_home().unwrap();
        let belief = tracker.belief(seconds, rest.tensions_n(), &doubts);
        let platform = belief.platform_at(&model, &rest).unwrap().unwrap();
        platform.fixed_view::<3, 3>(0, 0).trace().sqrt()
    };
    // All cables are half a millimetre longer than their encoders say; plans follow at once, or hardly.
    let after = |step_m: f64| {
        let prior = Prior {
            step_m,
            length_m: 1e-3,
            ..Prior::default()
        };
        let mut tracker = Tracker::new(&model, &prior);
        let (mut measured, rubbing, near) = exact(&model, [0.0; 3]);
        measured.lengths_m.iter_mut().for_each(|m| *m -= 5e-4);
        assert!(tracker.rest(&measured, &rubbing, &near).fits);
        tracker
    };
    let (quick, slow) = (after(1.0), after(1e-6));
    let lacks = slow.now.mean.iter().zip(&slow.planned);
    assert!(
        lacks
            .into_iter()
            .any(|(now, planned)| (now - planned).abs() > 5e-5)
    );
    assert!(
        spread(&slow, 0.0) > 1.03 * spread(&quick, 0.0),
        "{} {}",
        spread(&slow, 0.0),
        spread(&quick, 0.0)
    );
    // A minute of fast creep under 10 N is some tenths of a millimetre of cable.
    assert!(
        spread(&quick, 60.0) > 1.05 * spread(&quick, 0.0),
        "{} {}",
        spread(&quick, 60.0),
        spread(&quick, 0.0)
    );
}

#[test]
fn the_tubes_errors_of_mass_and_centre_are_those_of_the_planned_robot() {
    let model = model();
    let mut tracker = Tracker::new(&model, &Prior::default());
    let layout = tracker.layout;
    let (before, errors) = (tracker.robot().platform, Errors { cables: 4 });
    let rows = tracker.rows_of(errors, before.mass_kg, &before.center_of_mass_m);
    let said = |error: usize, x: &[f64]| {
        let (_, row) = rows.iter().find(|(of, _)| *of == error).unwrap();
        gaussian::dot(row, x)
    };
    for first in [layout.platform(), layout.payload()] {
        let mut x = vec![0.0; layout.size()];
        x[first..first + 4].copy_from_slice(&[1e-4, 2e-6, -3e-6, 5e-6]);
        tracker.planned = x.clone();
        let after = tracker.robot().platform;
        assert!((after.mass_kg - before.mass_kg - said(errors.mass(), &x)).abs() < 1e-12);
        for axis in 0..3 {
            let moved_m = after.center_of_mass_m[axis] - before.center_of_mass_m[axis];
            let off_m = moved_m - said(errors.center() + axis, &x);
            assert!(off_m.abs() < 1e-3 * moved_m.abs(), "{moved_m} {off_m}");
        }
    }
}
