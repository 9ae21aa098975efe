//! Collecting calibration data on the simulated robot, and what the calibration is worth there.

use mcdpr::calibration::collect::{Options, Step, collect};
use mcdpr::calibration::{Options as Estimator, joint};
use mcdpr::experiment;
use mcdpr::machine::Mismatch;
use mcdpr::motion::Model;
use mcdpr::robot::Robot;
use mcdpr::sight::{Scene, SimulatedTags};
use mcdpr_protocol::SessionId;
use mcdpr_simulator::LinkOptions;

#[test]
fn data_are_collected_and_solved() {
    let robot = Robot::find("paper-table5").unwrap();
    let model = Model::new(&robot).unwrap();
    let seed = 7;
    let link =
        experiment::simulated_robot(&model, &Mismatch::as_built(), seed, &LinkOptions::default())
            .unwrap();
    let scene = Scene::of(&robot, seed);
    let mut tags = SimulatedTags::new(link.clone(), scene, 0.1, seed);
    let options = Options {
        poses: 12,
        candidates: 120,
        seed,
        ..Options::default()
    };
    let mut steps = Vec::new();
    let data = collect(
        &model,
        link.clone(),
        Some(SessionId(1)),
        &mut tags,
        &options,
        None,
        |_| Ok(()),
        |step: Step| steps.push(step),
    )
    .unwrap();
    assert_eq!(data.poses.len(), 12);
    let measured = |step: &&Step| matches!(step, Step::Measured { .. });
    assert_eq!(steps.iter().filter(measured).count(), 11);
    let answer = joint(&data, &Estimator::default()).unwrap();
    assert!(
        answer.predicted_error_m < 2e-3,
        "{}",
        answer.predicted_error_m
    );
    assert!(answer.rejected.len() < 4, "{:?}", answer.rejected);
}
