//! A robot in a plane: machines as built have their anchors millimetres beside it. Calibrated it moves in the plane of its
//! description all the same, and hangs where statics let it beside that.

use crate::{folder, on_simulator, options, run, with_board};
use mcdpr::calibration::{Options as Estimator, joint, result};
use mcdpr::experiment::{Experiment, SimulatedRobot};
use mcdpr::machine::Mismatch;
use mcdpr::motion::{Model, Task};
use mcdpr::robot::Robot;
use mcdpr_core::estimate::tube::{Belief, Doubts};
use mcdpr_core::estimate::{Measurements, Sigmas, estimate};
use mcdpr_core::holding::Freedom;
use serde_json::Value;

const SEED: u64 = 1;

/// `planar-vertical` by the data of the machine of a seed as built, and its calibration.
fn calibrated(seed: u64) -> (Robot, Value) {
    let robot = with_board("planar-vertical");
    let data = on_simulator(&robot, &options(10, seed), None, |_| Ok(()), |_| {}).unwrap();
    assert_eq!(data.poses.len(), 10);
    let answer = joint(&data, &Estimator::default()).unwrap();
    // By the lengths, in the plane: what they hardly tell of the way across it counted as 50 mm.
    assert!(
        answer.predicted_error_m < 1e-3,
        "{}",
        answer.predicted_error_m
    );
    let document = result::document(&robot, &data, &answer).unwrap();
    (result::applied(&robot, &document).unwrap(), document)
}

#[test]
fn what_a_calibration_cannot_tell_apart_does_not_widen_the_tube() {
    let (robot, mut document) = calibrated(SEED);
    let model = Model::new(&robot).unwrap();
    let home = model.rest_at_home().unwrap();
    let paths = model.geometry().paths(&home.equilibrium.pose).unwrap();
    // A pulley that is larger, and a longer cable: lengths at home are the same. The robots whose data widen the prior of
    // their pulleys' radii have such covariances.
    // In the order of the shared unknowns: anchors, initial lengths, camera, bodies of tags, radii.
    let cables = robot.cables.len();
    let bodies = document["bodies"].as_array().unwrap().len();
    let radius_of = |cable: usize| 4 * cables + 6 + 6 * bodies + cable;
    let wide_m = 1.5e-3;
    let rows = &mut document["covariance_of_shared_unknowns_si"];
    for (cable, path) in paths.iter().enumerate() {
        let (radius, length) = (radius_of(cable), 3 * cables + cable);
        let longer = path.wrap_rad - path.wrap_rad.sin();
        for (i, by) in [(radius, 1.0), (length, longer)] {
            for (j, with) in [(radius, 1.0), (length, longer)] {
                let old = rows[i][j].as_f64().unwrap();
                rows[i][j] = (old + by * with * wide_m * wide_m).into();
            }
        }
    }
    let wide = result::applied(&with_board("planar-vertical"), &document).unwrap();
    let at_home_m = |robot: &Robot| {
        let belief = Belief::of(robot, &Doubts::by_tape());
        let known = belief.platform_at(&model, &home).unwrap().unwrap();
        known.fixed_view::<3, 3>(0, 0).trace().sqrt()
    };
    let (before_m, after_m) = (at_home_m(&robot), at_home_m(&wide));
    assert!((2e-4..6e-4).contains(&before_m), "{before_m}");
    // The lengths alone, as wide, would add millimetres.
    assert!(after_m < 1.1 * before_m, "{before_m} {after_m}");
}

#[test]
fn a_planar_machine_is_calibrated_and_follows_a_path_in_its_plane() {
    let (robot, _) = calibrated(SEED);
    let designed = Robot::built_in("planar-vertical").unwrap();
    let beside = robot.cables.iter().map(|c| c.anchor_in_world_m.y.abs());
    assert!(
        beside.fold(0.0, f64::max) > 5e-4,
        "the machine's anchors are in the plane"
    );
    let model = Model::new(&robot).unwrap();
    let freedom = model.holding().freedom();
    assert!(matches!(freedom, Freedom::Plane { .. }), "{freedom:?}");
    // Where its encoders were zeroed.
    let home_off_m = robot.tool.home_in_world_m - designed.tool.home_in_world_m;
    assert!(home_off_m.norm() < 8e-3, "{home_off_m}");
    let task = Task::fitting(&model).unwrap();
    let machine = SimulatedRobot::new(Mismatch::as_built(), SEED);
    let done = Experiment::new(&model, task).simulate(&machine).unwrap();
    let path = done.run.figures(&model).unwrap().path_error_m.unwrap();
    // As described it is 1.9 / 3.2 mm off.
    assert!(path.mean < 0.6e-3 && path.max < 1.5e-3, "{path:?}");

    // The tool is where statics let it hang: beside the plane, where no length takes it back.
    let rest = model.rest_at_home().unwrap();
    let tool_m = model.tool_m(&rest);
    let asked_m = model.asked(&tool_m);
    assert!((asked_m - tool_m).xz().norm() < 1e-12, "{asked_m} {tool_m}");
    let across_m = (asked_m - tool_m).y.abs();
    assert!((1e-5..5e-3).contains(&across_m), "{across_m}");
    // Its lengths say so, too.
    let again = model.rest_from_lengths(&rest.paid_out_m, rest.tensions_n());
    let apart_m = model.tool_m(&again.unwrap()) - tool_m;
    assert!(apart_m.norm() < 1e-4, "{apart_m}");
    // And so does the estimate, with what statics say across the plane.
    let measured = Measurements {
        lengths_m: rest.paid_out_m.clone(),
        tensions_n: (rest.tensions_n().iter().enumerate())
            .map(|(cable, tension_n)| model.reading_n(cable, *tension_n))
            .collect(),
        ..Measurements::default()
    };
    let designed_m = designed.tool.home_in_world_m;
    let found = estimate(&model, &measured, &Sigmas::default(), &designed_m).unwrap();
    assert!(
        (found.tool_m - tool_m).norm() < 1e-5,
        "{} {tool_m}",
        found.tool_m
    );
    assert!(
        found.off_statics_rad.norm() < 1e-5,
        "{}",
        found.off_statics_rad
    );
    // A place far beside the plane is meant for another robot.
    let beside = "start_mm = [0, 30, 650]\n[[leg]]\nto_mm = [100, 30, 650]\n";
    let task = Task::parse(beside, "beside.toml".into()).unwrap();
    let error = Experiment::new(&model, task).plan().unwrap_err();
    assert!(error.to_string().contains("beside the plane"), "{error}");
}

#[test]
fn radii_that_the_data_hardly_tell_stay_those_of_the_robot_file() {
    // The zeros of this machine's load cells looked like pulleys of 12.8 mm.
    let (robot, _) = calibrated(8);
    for cable in &robot.cables {
        let radius_m = cable.pulley_radius_m;
        assert!((radius_m - 15e-3).abs() < 1e-4, "{radius_m}");
    }
}

#[test]
fn a_load_that_turns_freely_is_refused_with_what_to_do_instead() {
    let folder = folder("turning");
    for robot in ["three-point", "planar-four"] {
        let words = ["calibrate", "collect", "--robot", robot];
        let (code, _, said) = run(&folder, &words);
        assert_eq!(code, Some(1), "{robot}: {said}");
        assert!(said.contains("nothing stops it turning"), "{robot}: {said}");
        assert!(said.contains("tracker"), "{robot}: {said}");
    }
}
