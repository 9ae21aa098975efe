//! A robot in a plane: machines as built have their anchors millimetres beside it. Calibrated it moves in the plane of its
//! description all the same, and hangs where statics let it beside that.

use crate::{folder, on_simulator, options, run, with_board};
use mcdpr::calibration::{Options as Estimator, joint, result};
use mcdpr::experiment::{Experiment, SimulatedRobot};
use mcdpr::machine::Mismatch;
use mcdpr::motion::{Model, Task};
use mcdpr::robot::Robot;
use mcdpr_core::holding::Freedom;

const SEED: u64 = 1;

/// `planar-vertical` by the data of a machine as built.
fn calibrated() -> Robot {
    let robot = with_board("planar-vertical");
    let data = on_simulator(&robot, &options(10, SEED), None, |_| Ok(()), |_| {}).unwrap();
    assert_eq!(data.poses.len(), 10);
    let answer = joint(&data, &Estimator::default()).unwrap();
    // By the lengths, in the plane: what they hardly tell of the way across it counted as 50 mm.
    assert!(
        answer.predicted_error_m < 1e-3,
        "{}",
        answer.predicted_error_m
    );
    let document = result::document(&robot, &data, &answer).unwrap();
    result::applied(&robot, &document).unwrap()
}

#[test]
fn a_planar_machine_is_calibrated_and_follows_a_path_in_its_plane() {
    let robot = calibrated();
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
    // A place far beside the plane is meant for another robot.
    let beside = "start_mm = [0, 30, 650]\n[[leg]]\nto_mm = [100, 30, 650]\n";
    let task = Task::parse(beside, "beside.toml".into()).unwrap();
    let error = Experiment::new(&model, task).plan().unwrap_err();
    assert!(error.to_string().contains("beside the plane"), "{error}");
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
