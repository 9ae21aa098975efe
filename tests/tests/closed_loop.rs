//! The whole chain in the simulator: planner, client, wire, control core, plant. Tolerances are
//! requirements; the figures are those of a simulator.

use mcdpr::experiment::{Experiment, SimulatedRobot, SimulatedRun};
use mcdpr::machine::Mismatch;
use mcdpr::motion::{Model, Task};
use mcdpr::report::Figures;
use mcdpr::robot::Robot;

fn circle(robot: &str, mismatch: &Mismatch, seed: u64) -> (SimulatedRun, Figures) {
    let robot = mcdpr::robot::find(robot).unwrap();
    let model = Model::new(&robot).unwrap();
    let task = Task::built_in("paper:table7", -0.18).unwrap();
    let run = Experiment::new(&model, task)
        .simulate(&SimulatedRobot::new(*mismatch, seed))
        .unwrap();
    let figures = run.run.figures(&model).unwrap();
    (run, figures)
}

#[test]
fn the_paper_robot_follows_its_circle_as_described() {
    let (run, figures) = circle("paper-optimistic", &Mismatch::default(), 1);
    let path = figures.path_error_m.unwrap();
    assert!(path.mean < 0.10e-3 && path.max < 0.60e-3, "{path:?}");
    let lengths = figures.cable_length_error_m;
    assert!(
        lengths.mean < 0.05e-3 && lengths.max < 0.5e-3,
        "{lengths:?}"
    );
    assert!(figures.tension_error_n.mean_abs < 0.1, "{figures:?}");
    // The circle takes ten seconds, the approach as long as the drives need.
    let duration = run.run.plan.timed.duration_s();
    assert!((11.0..13.0).contains(&duration), "{duration}");
    // Every tick of the motion was measured, and every one is in the record.
    let ticks = run
        .run
        .samples
        .iter()
        .filter(|s| s.path_s.is_some())
        .count();
    assert!(
        ticks as f64 > duration * 1000.0 - 20.0,
        "{ticks} of {duration} s"
    );
}

#[test]
fn a_realistic_machine_stays_under_a_millimetre_for_every_seed() {
    for seed in 1..=6 {
        let (_, figures) = circle("paper-optimistic", &Mismatch::realistic(), seed);
        let path = figures.path_error_m.unwrap();
        assert!(
            path.mean < 0.6e-3 && path.max < 1.0e-3,
            "seed {seed}: {path:?}"
        );
        let tension = figures.tension_error_n;
        assert!(
            tension.mean_abs < 0.15 && tension.max_abs < 1.5,
            "seed {seed}: {tension:?}"
        );
    }
}

#[test]
fn the_fast_robot_follows_the_same_circle() {
    let (_, figures) = circle("lab-fast", &Mismatch::realistic(), 1);
    let path = figures.path_error_m.unwrap();
    assert!(path.mean < 0.6e-3 && path.max < 1.0e-3, "{path:?}");
}

#[test]
fn a_run_repeats_bit_by_bit_for_a_seed_and_differs_for_another() {
    let path = |seed| {
        circle("paper-optimistic", &Mismatch::realistic(), seed)
            .0
            .run
    };
    let (a, b, c) = (path(3), path(3), path(4));
    assert_eq!(a.samples, b.samples);
    assert_eq!(a.true_path, b.true_path);
    assert_ne!(a.samples, c.samples);
}

#[test]
fn the_measured_lengths_are_the_true_ones_to_an_encoder_count() {
    // Path error and length error must not agree by both being wrong: the plant's own geometry
    // says where the tool was, the encoders what was paid out.
    let robot = Robot::built_in("paper-optimistic").unwrap();
    let model = Model::new(&robot).unwrap();
    let (run, _) = circle("paper-optimistic", &Mismatch::default(), 2);
    let truth = run.run.true_path.as_ref().unwrap();
    let mut compared = 0;
    for sample in run.run.samples.iter().step_by(97) {
        let Some(time_s) = sample.path_s else {
            continue;
        };
        let near = |point: &&mcdpr::report::PathPoint| (point.path_s - time_s).abs() < 4e-4;
        let Some(point) = truth.iter().find(near) else {
            continue;
        };
        // What the lengths should be where the tool truly was, had it hung there at rest.
        let rest = model.rest(&point.tool_m.into(), None).unwrap();
        for cable in 0..3 {
            let gap = sample.lengths_m[cable] - rest.paid_out_m[cable];
            // A count is 31 um; the platform swings by some tenths of a millimetre about rest.
            assert!(
                gap.abs() < 0.5e-3,
                "cable {} at {time_s} s: {gap}",
                cable + 1
            );
        }
        compared += 1;
    }
    assert!(compared > 100, "{compared}");
}

#[test]
fn arming_and_disarming_leave_the_platform_where_it_hangs() {
    let robot = Robot::built_in("paper-optimistic").unwrap();
    let model = Model::new(&robot).unwrap();
    let link = SimulatedRobot::new(Mismatch::default(), 1)
        .line(mcdpr_simulator::LinkOptions::default())
        .at_home(&model)
        .unwrap();
    let before = link.with(|simulation| simulation.plant().truth().unwrap());
    let line = "start_mm = [255, -105, -180]\n[[leg]]\nto_mm = [255, -104, -180]";
    let task = Task::parse(line, "short.toml".into()).unwrap();
    link.with(mcdpr_simulator::Simulation::record_truth);
    Experiment::new(&model, task).run_on(link.clone()).unwrap();
    let trace = link.with(mcdpr_simulator::Simulation::take_trace);
    let height = |z: f64| (z - before.tool_position_m[2]) * 1e3;
    let drop = trace
        .iter()
        .map(|point| -height(point.truth.tool_position_m[2]));
    let drop = drop.fold(0.0, f64::max);
    assert!(drop < 0.5, "dropped by {drop} mm");
    let end = trace.last().unwrap();
    assert!(end.truth.brakes_closed[..4].iter().all(|closed| *closed));
    assert_eq!(end.state, mcdpr_firmware::State::Disarmed);
}
