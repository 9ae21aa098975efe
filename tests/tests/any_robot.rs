//! Robots of other shapes than the paper's: planned, judged, run and refused like it.

use mcdpr::experiment::{Experiment, SimulatedRobot};
use mcdpr::machine::Mismatch;
use mcdpr::motion::{Model, Plan, Task};
use mcdpr::report::Figures;
use mcdpr::robot::{Control, Robot};
use mcdpr_kinematics::Pose;
use mcdpr_tests::process::{Folder, call, document};
use nalgebra::{Rotation3, Vector3};
use serde_json::Value;

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
        assert!(model("eight-cable").placed(what).is_ok());
        let error = model("planar-four").placed(what).unwrap_err().to_string();
        assert!(error.starts_with(what), "{error}");
    }
    let beside = "start_mm = [0, 20, 600]\n[[leg]]\nto_mm = [100, 20, 600]\n";
    let task = Task::parse(beside, "beside.toml".into()).unwrap();
    let error = Experiment::new(&model("planar-four"), task)
        .plan()
        .unwrap_err();
    assert!(error.to_string().contains("beside the plane"), "{error}");
}

/// Even numbers in [0, 1) from a counter (splitmix64).
struct Even(u64);

impl Even {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn within(&mut self, half: f64) -> f64 {
        half * (2.0 * self.next() - 1.0)
    }
}

/// The greatest change of a tension between neighbouring milliseconds of a straight path of the tool, as a share of the
/// range of tensions; `None` if the robot cannot rest somewhere on it. The path turns as evenly as it moves, at rest at
/// both ends, with the robot's greatest speed in its middle.
fn greatest_jump(model: &Model, from: &Pose, to: &Pose) -> Option<f64> {
    let limits = &model.robot().limits;
    let step_m = to.position_m - from.position_m;
    let turn = (from.rotation.inverse() * to.rotation).scaled_axis();
    // A minimum-jerk motion peaks at 15/8 of its mean speed.
    let duration_ms = (1.875e3 * step_m.norm() / limits.speed_mps)
        .ceil()
        .max(100.0) as u32;
    let mut before: Option<Vec<f64>> = None;
    let mut most_n = 0.0_f64;
    for ms in 0..=duration_ms {
        let t = f64::from(ms) / f64::from(duration_ms);
        let share = t.powi(3) * (10.0 - 15.0 * t + 6.0 * t * t);
        let pose = Pose::new(
            from.position_m + step_m * share,
            from.rotation * Rotation3::new(turn * share),
        );
        let now = model.rest_at_pose(&pose).ok()?.tensions_n().to_vec();
        for (a, b) in before.iter().flatten().zip(&now) {
            most_n = most_n.max((a - b).abs());
        }
        before = Some(now);
    }
    Some(most_n / (limits.tension_max_n - limits.tension_min_n))
}

#[test]
fn tensions_of_a_thousand_random_paths_do_not_jump() {
    for name in ["eight-cable", "eight-suspended"] {
        let model = model(name);
        let [low, high] = model.robot().limits.box_in_world_m.unwrap();
        let mut random = Even(23);
        let (mut paths, mut drawn, mut worst) = (0, 0, 0.0_f64);
        while paths < 1000 {
            let mut pose = || {
                let at_m = Vector3::from_fn(|k, _| low[k] + (high[k] - low[k]) * random.next());
                let turn = Vector3::from_fn(|_, _| random.within(0.15));
                Pose::new(at_m, Rotation3::new(turn))
            };
            let (from, to) = (pose(), pose());
            drawn += 1;
            assert!(drawn < 20_000, "{name}: {paths} paths only");
            if let Some(jump) = greatest_jump(&model, &from, &to) {
                paths += 1;
                worst = worst.max(jump);
            }
        }
        println!(
            "{name}: {:.3} % of the range at most, {paths} paths of {drawn}",
            100.0 * worst
        );
        assert!(worst < 0.01, "{name}: {worst}");
    }
}

#[test]
fn robots_of_six_degrees_of_freedom_are_rigged_calibrated_homed_and_pick() {
    for robot in ["eight-cable", "eight-suspended"] {
        let folder = Folder::new(&format!("six-freedoms-{robot}"));
        let on = |words: &[&str]| document(&[words, &["--robot", robot]].concat(), folder.path());
        let mm = |value: &Value| value.as_f64().unwrap() * 1e3;
        let rigged = on(&["rig", "tension", "--yes"]);
        let hung_n = rigged["tensions_n"].as_array().unwrap();
        assert!(hung_n.len() == 8 && hung_n.iter().all(|n| n.as_f64().unwrap() > 20.0));
        let held = on(&["experiment", "hold"]);
        assert!(held["simulated"].as_bool().unwrap(), "{held}");
        // An as-built machine, its anchors off by up to 5 mm.
        let how = ["--target", "board", "--poses", "12", "--candidates", "80"];
        let answer = on(&[&["calibrate", "all"], &how[..]].concat());
        let expected_mm = answer["predicted_tcp_error_mm"].as_f64().unwrap();
        assert!(expected_mm < 1.0, "{expected_mm}");
        // That machine, with the calibration that lies beside.
        let run = on(&["run", "fitting"]);
        let path = &run["path_error_m"];
        assert!(
            mm(&path["mean"]) < 0.6 && mm(&path["max"]) < 1.2,
            "{robot}: {path}"
        );
        let home_m = model(robot).robot().tool.home_in_world_m;
        let homed = on(&["home", "--tag"]);
        for (axis, home_m) in homed["tool_m"].as_array().unwrap().iter().zip(&home_m) {
            assert!((mm(axis) - home_m * 1e3).abs() < 1.0, "{robot}: {homed}");
        }
        let estimate = on(&["estimate"]);
        assert!(estimate["slip_cable"].is_null(), "{estimate}");
        assert!(estimate["redundancy"].as_f64().unwrap() < 3.0, "{estimate}");
        let picked = on(&["pick", "--objects", "2"]);
        assert_eq!(picked["carried_off"], 2, "{robot}: {picked}");
    }
}

#[test]
fn a_geared_drum_that_turns_round_at_the_end_of_a_motion_is_not_taken_for_a_dead_drive() {
    // At 3 mm/s as the least commanded speed the third seed ended with D2.
    let folder = Folder::new("turning-round");
    let words = [
        "study",
        "iso9283",
        "--write-task",
        "cube.toml",
        "--cycles",
        "2",
    ];
    let half = ["--speed-percent", "50", "--robot", "eight-cable"];
    let written = call(&[&words[..], &half[..]].concat(), folder.path());
    assert!(written.status.success());
    let run = ["run", "cube.toml", "--robot", "eight-cable", "--seed", "3"];
    let done = document(&run, folder.path());
    assert!(
        done["path_error_m"]["mean"].as_f64().unwrap() < 1e-3,
        "{done}"
    );
}

#[test]
fn a_cable_that_is_stiffer_than_the_others_is_not_taken_for_one_that_slips() {
    // With one stiffness for all cables this session ended with a slip of cable 1 by 1.7 mm.
    let folder = Folder::new("own-stiffness");
    let words = [
        "calibrate",
        "collect",
        "--robot",
        "eight-cable",
        "--seed",
        "5",
    ];
    let how = ["--target", "board", "--poses", "20"];
    let done = document(&[&words[..], &how[..]].concat(), folder.path());
    assert_eq!(done["poses"], 20, "{done}");
}
