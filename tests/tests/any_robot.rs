//! Robots of other shapes than the paper's: planned, judged, run and refused like it.

use mcdpr::experiment::{Experiment, SimulatedRobot};
use mcdpr::machine::Mismatch;
use mcdpr::motion::{Model, Plan, Task};
use mcdpr::report::Figures;
use mcdpr::robot::{Control, Robot};
use nalgebra::Vector3;

/// Robots that are held otherwise than the paper's.
const OTHERS: [&str; 6] = [
    "eight-cable",
    "eight-suspended",
    "six-cable",
    "three-point",
    "planar-four",
    "planar-vertical",
];

fn model(name: &str) -> Model {
    Model::new(&Robot::built_in(name).unwrap()).unwrap()
}

fn planned(model: &Model, task: Task) -> Plan {
    Experiment::new(model, task).plan().unwrap()
}

fn run(name: &str, mismatch: Mismatch) -> Figures {
    let model = model(name);
    let task = Task::fitting(&model).unwrap();
    let done = Experiment::new(&model, task).simulate(&SimulatedRobot::new(mismatch, 1));
    let done = done.unwrap_or_else(|error| panic!("{name}: {error}"));
    done.run.figures(&model).unwrap()
}

#[test]
fn every_kind_of_robot_follows_a_path_that_fits_it() {
    for name in OTHERS {
        let exact = run(name, Mismatch::default());
        let path = exact.path_error_m.unwrap();
        assert!(path.mean < 0.3e-3 && path.max < 0.8e-3, "{name}: {path:?}");
        let real = run(name, Mismatch::realistic());
        let path = real.path_error_m.unwrap();
        assert!(path.mean < 1.0e-3 && path.max < 2.0e-3, "{name}: {path:?}");
        let turns = model(name).holding().freedom().turns();
        assert_eq!(real.attitude_error_rad.is_some(), turns, "{name}");
        if let Some(turned) = real.attitude_error_rad {
            assert!(turned.mean < 0.02, "{name}: {turned:?}");
        }
    }
}

#[test]
fn tensions_do_not_jump_and_are_the_same_on_the_way_back() {
    for name in [
        "eight-cable",
        "eight-suspended",
        "planar-four",
        "planar-vertical",
    ] {
        let model = model(name);
        let robot = model.robot();
        let range_n = robot.limits.tension_max_n - robot.limits.tension_min_n;
        let plan = planned(&model, Task::fitting(&model).unwrap());
        let mut before: Option<Vec<f64>> = None;
        for (time_s, state) in plan.states(1e-3) {
            let tensions = state.tensions_n().to_vec();
            for (cable, tension) in tensions.iter().enumerate() {
                let limits = robot.limits.tension_min_n..=robot.limits.tension_max_n;
                assert!(limits.contains(tension), "{name}, {time_s} s: {tension} N");
                if let Some(old) = &before {
                    let jump = (tension - old[cable]).abs();
                    assert!(jump < 0.01 * range_n, "{name}, {time_s} s: {jump} N");
                }
            }
            before = Some(tensions);
        }
    }
    let model = model("eight-cable");
    let (a, b) = (
        Vector3::new(-300.0, 100.0, 600.0),
        Vector3::new(250.0, -200.0, 800.0),
    );
    let along = |from: Vector3<f64>, to: Vector3<f64>| {
        let text = format!(
            "start_mm = [{}, {}, {}]\n[[leg]]\nto_mm = [{}, {}, {}]\nduration_s = 4\n",
            from.x, from.y, from.z, to.x, to.y, to.z
        );
        let task = Task::parse(&text, "line.toml".into()).unwrap();
        let start = task.start_m().unwrap();
        Plan::new(&model, &start, &task.steps).unwrap()
    };
    let (there, back) = (along(a, b), along(b, a));
    let end_s = there.timed.duration_s();
    for step in 0..=400 {
        let time_s = end_s * f64::from(step) / 400.0;
        let (one, other) = (
            there.state(time_s).unwrap(),
            back.state(end_s - time_s).unwrap(),
        );
        for (x, y) in one.tensions_n().iter().zip(other.tensions_n()) {
            assert!((x - y).abs() < 1e-3, "{time_s} s: {x} N, {y} N");
        }
    }
}

#[test]
fn an_attitude_is_followed_where_there_is_one_and_refused_where_not() {
    let text =
        |at: &str| format!("start_mm = {at}\n[[leg]]\nto_mm = {at}\nattitude_deg = [0, 8, 0]\n");
    let tilted = planned(
        &model("eight-cable"),
        Task::parse(&text("[0, 0, 700]"), "tilt.toml".into()).unwrap(),
    );
    let end = tilted.state(tilted.timed.duration_s()).unwrap();
    let tilt = end.equilibrium.pose.tilt_rad().to_degrees();
    assert!((tilt - 8.0).abs() < 1e-6, "{tilt}");
    for (name, at, why) in [
        ("paper-table5", "[335, 0, -180]", "gravity decides"),
        ("three-point", "[0, 0, 700]", "meet in one point"),
    ] {
        let task = Task::parse(&text(at), "tilt.toml".into()).unwrap();
        let error = Experiment::new(&model(name), task).plan().unwrap_err();
        assert!(error.to_string().contains(why), "{name}: {error}");
    }
    let yawed = "start_mm = [0, 0, 650]\n[[leg]]\nto_mm = [0, 0, 650]\nattitude_deg = [0, 0, 8]\n";
    let task = Task::parse(yawed, "yaw.toml".into()).unwrap();
    let error = Experiment::new(&model("planar-vertical"), task)
        .plan()
        .unwrap_err();
    assert!(error.to_string().contains("in the plane"), "{error}");
}

#[test]
fn cables_that_do_not_hold_the_robot_are_refused_with_the_reason() {
    let mut robot = Robot::built_in("eight-cable").unwrap();
    for cable in &mut robot.cables {
        cable.control = Control::Position;
    }
    let error = Model::new(&robot).unwrap_err().to_string();
    assert!(
        error.contains("8 cables are held by length") && error.contains("six"),
        "{error}"
    );
    // The upper four and two of the lower ones hold it; a seventh would work against them.
    let mut held = Robot::built_in("eight-cable").unwrap();
    assert!(Model::new(&held).is_ok());
    held.platform.mass_kg = 500.0;
    let heavy = Model::new(&held).unwrap().rest_at_home().unwrap_err();
    assert!(
        heavy.to_string().contains("cannot hold its tool"),
        "{heavy}"
    );
    for what in ["picking", "collecting"] {
        let error = model("eight-cable").hanging(what).unwrap_err().to_string();
        assert!(error.starts_with(what), "{error}");
    }
    let beside = "start_mm = [0, 20, 600]\n[[leg]]\nto_mm = [100, 20, 600]\n";
    let task = Task::parse(beside, "beside.toml".into()).unwrap();
    let error = Experiment::new(&model("planar-four"), task)
        .plan()
        .unwrap_err();
    assert!(error.to_string().contains("beside the plane"), "{error}");
}
