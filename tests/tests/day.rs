//! What a robot says and keeps over its days: the tube that a plan states beforehand, the history of its
//! calibration, and the wear of its cables.

use mcdpr::control::Handle;
use mcdpr::estimate::tube::{Belief, Doubts, Tube};
use mcdpr::experiment::{Experiment, SimulatedRobot};
use mcdpr::machine::{Controller, Mismatch};
use mcdpr::motion::{Model, Task};
use mcdpr::robot::Robot;
use mcdpr::study::tube::audit;
use mcdpr_tests::process::{Folder, call, document, refused};
use nalgebra::Vector3;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

#[test]
fn the_tool_stays_inside_the_tube_that_a_plan_states() {
    let model = Model::new(&Robot::built_in("lab-fast").unwrap()).unwrap();
    let belief = Belief::of(model.robot(), &Doubts::within(5e-3));
    let handle = Handle::new();
    let (mut path_s, mut inside_s) = (0.0, 0.0);
    let mut shares = Vec::new();
    for seed in 7001..7013 {
        let machine = Mismatch::as_built();
        let controller = Controller::InProcess;
        let done = audit(&model, &belief, machine, seed, &controller, &handle).unwrap();
        path_s += done.path_s;
        inside_s += done.inside_s;
        shares.push(done.error_mean_m / done.radius_mean_m);
    }
    // Of twelve machines one in twenty may be outside: 95 % less three standard deviations of such a draw.
    let share = inside_s / path_s;
    assert!(share > 0.76, "{share}");
    // And it is no wider than its errors ask for.
    shares.sort_by(f64::total_cmp);
    let median = f64::midpoint(shares[5], shares[6]);
    assert!((0.25..0.8).contains(&median), "{median}");
}

#[test]
fn a_plan_says_how_far_the_tool_may_be_off() {
    let folder = Folder::new("tube");
    let of = |more: &[&str]| {
        let words = ["plan", "paper:table7", "--robot", "lab-fast", "--dry-run"];
        document(&[&words[..], more].concat(), folder.path())["tube"].clone()
    };
    let radius = |tube: &Value| tube["widest"]["radius_m"].as_f64().unwrap();
    let plain = of(&[]);
    assert!(radius(&plain) > 1e-3 && radius(&plain) < 0.03, "{plain}");
    assert!(radius(&of(&["--anchors-within-mm", "0.3"])) < 0.7 * radius(&plain));
    assert!(radius(&of(&["--payload-kg", "1"])) > radius(&plain));
    let words = call(
        &["plan", "paper:table7", "--robot", "lab-fast", "--dry-run"],
        folder.path(),
    );
    let words = String::from_utf8_lossy(&words.stdout).into_owned();
    assert!(
        words.contains("mm of the path with a probability of 95 %"),
        "{words}"
    );
    let robot = ["plan", "paper:table7", "--robot", "lab-fast"];
    let said = refused(
        &[&robot[..], &["--payload-kg", "-1"]].concat(),
        folder.path(),
    );
    assert!(said.contains("--payload-kg"), "{said}");
}

#[test]
fn the_platform_swings_after_a_motion_as_much_as_its_tube_says() {
    let model = Model::new(&Robot::built_in("lab-fast").unwrap()).unwrap();
    // Slowly to a place low in the frame, where the platform is held loosely, then 40 mm as fast as it goes.
    let task = "start_mm = [335, 0, -300]\n\
        [[leg]]\nto_mm = [470.6, 7.8, -506.6]\nspeed_mm_s = 17\n[[leg]]\ndwell_s = 4\n\
        [[leg]]\nto_mm = [494.6, 85.9, -474.6]\nspeed_mm_s = 380\n[[leg]]\ndwell_s = 4\n";
    let task = Task::parse(task, "swing.toml".into()).unwrap();
    let machine = SimulatedRobot::new(Mismatch::default(), 1);
    let run = Experiment::new(&model, task)
        .simulate(&machine)
        .unwrap()
        .run;
    // The machine is as described: swing is all that is left.
    let exact = Doubts {
        anchor_m: 0.0,
        attachment_m: 0.0,
        length_m: 0.0,
        compliance: 0.0,
        gain: 0.0,
        zero_n: 0.0,
        loss: 0.0,
        mass: 0.0,
        center_m: 0.0,
        bandwidth: 0.0,
        late_s: 0.0,
        ..Doubts::within(0.0)
    };
    let belief = Belief::of(model.robot(), &exact);
    let tube = Tube::along(&run.plan, &belief).unwrap().unwrap();
    let path = run.true_path.as_deref().unwrap();
    let end_s = run.plan.timed.duration_s();
    for second in [3.5, 2.5, 1.5] {
        let from_s = end_s - second;
        let points = path
            .iter()
            .filter(|point| (from_s..from_s + 1.0).contains(&point.path_s));
        let places: Vec<Vector3<f64>> = points.map(|point| point.tool_m.into()).collect();
        assert!(places.len() > 900, "{}", places.len());
        let mean: Vector3<f64> = places.iter().sum::<Vector3<f64>>() / places.len() as f64;
        let squares: f64 = places.iter().map(|at| (at - mean).norm_squared()).sum();
        let rms_mm = (squares / places.len() as f64).sqrt() * 1e3;
        // A sine within the radius.
        let said_mm = tube.radius_m(from_s + 0.5) * 1e3 * std::f64::consts::FRAC_1_SQRT_2;
        eprintln!("{second} s before the end: {rms_mm:.3} mm, said {said_mm:.3} mm");
        assert!(
            rms_mm > 0.2 && (0.6..1.5).contains(&(rms_mm / said_mm)),
            "{rms_mm} {said_mm}"
        );
    }
}

#[test]
fn the_tube_of_a_tracked_robot_holds_plan_after_plan() {
    let folder = Folder::new("tracked-tube");
    let words = [
        "study",
        "tube",
        "--tracked",
        "--look",
        "--robot",
        "lab-fast",
    ];
    let more = ["--plans", "40", "--each", "5", "--seed", "9001"];
    let found = document(&[&words[..], &more].concat(), folder.path());
    // 96 % of 936 plans (docs/results/day.md); these are eight machines.
    let inside = found["inside"].as_f64().unwrap();
    assert!(inside > 0.85, "{inside}");
    let each = found["each"].as_array().unwrap();
    let mean = |key: &str, of: &dyn Fn(usize) -> bool| {
        let (mut sum, mut count, mut seed, mut plan) = (0.0, 0.0, 0, 0);
        for audit in each {
            let own = audit["seed"].as_u64().unwrap();
            plan = if own == seed { plan + 1 } else { 0 };
            seed = own;
            if of(plan) {
                sum += audit[key].as_f64().unwrap();
                count += 1.0;
            }
        }
        sum / count
    };
    // Far narrower than that of a machine built by a tape measure: 2.6 mm.
    let first_m = mean("radius_mean_m", &|plan| plan == 0);
    assert!((3e-4..2e-3).contains(&first_m), "{first_m}");
    // A platform that still swings: the error grows from plan to plan, and the tube with it.
    let later = |plan: usize| plan >= 3;
    assert!(mean("radius_mean_m", &later) > 1.3 * first_m);
    let errors_m = [mean("error_mean_m", &later), mean("radius_mean_m", &later)];
    assert!(
        (0.2..0.8).contains(&(errors_m[0] / errors_m[1])),
        "{errors_m:?}"
    );
    let said = refused(
        &[
            "study",
            "tube",
            "--tracked",
            "--look",
            "--robot",
            "six-cable",
        ],
        folder.path(),
    );
    assert!(said.contains("no tags"), "{said}");
}

#[test]
fn a_tracked_run_states_its_tube_by_what_is_tracked() {
    let folder = Folder::new("stated");
    let words = [
        "run",
        "paper:table7",
        "--robot",
        "lab-fast",
        "--machine",
        "after-hours",
    ];
    let run = folder.path().join("laps");
    let more = [
        "--laps",
        "2",
        "--track",
        "--look",
        "--record",
        run.to_str().unwrap(),
    ];
    let done = document(&[&words[..], &more].concat(), folder.path());
    let tubes = done["tubes"].as_array().unwrap();
    assert_eq!(tubes.len(), 2, "{done}");
    for tube in tubes {
        let mean_m = tube["mean_m"].as_f64().unwrap();
        assert!((2e-4..2e-3).contains(&mean_m), "{tube}");
        assert!(tube["inside"].as_f64().unwrap() > 0.9, "{tube}");
    }
    let kept = std::fs::read_to_string(run.join("tube.json")).unwrap();
    assert!(kept.contains("by what is tracked"), "{kept}");
    // Without --track the file's own tube is kept, and nothing of this is printed.
    let plain = document(&words[..4], folder.path());
    assert!(plain["tubes"].is_null(), "{plain}");
    let words = ["plan", "paper:table7", "--robot", "lab-fast", "--tracked"];
    let said = refused(&words, folder.path());
    assert!(said.contains("nothing is tracked"), "{said}");
}

/// A robot file of its own in a folder, and a calibration of it that moves an anchor.
fn own_robot(folder: &Folder) -> (PathBuf, impl Fn(f64) -> String) {
    let path = folder.path().join("own.toml");
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    let text = std::fs::read_to_string(root.join("robots/lab-fast.toml")).unwrap();
    std::fs::write(&path, text).unwrap();
    let robot = mcdpr::robot::load(&path).unwrap();
    let calibration = move |moved_mm: f64| {
        let model = Model::new(&robot).unwrap();
        let home = model.rest_at_home().unwrap();
        let mut anchors: Vec<[f64; 3]> = robot
            .cables
            .iter()
            .map(|cable| (cable.anchor_in_world_m * 1e3).into())
            .collect();
        anchors[1][0] += moved_mm;
        let lengths: Vec<f64> = home.paid_out_m.iter().map(|m| m * 1e3).collect();
        let camera = robot.camera.camera_from_platform.position_m * 1e3;
        let place = |at: [f64; 3]| {
            json!([
                [1, 0, 0, at[0]],
                [0, 1, 0, at[1]],
                [0, 0, 1, at[2]],
                [0, 0, 0, 1]
            ])
        };
        json!({
            "schema": "mcdpr-calibration-1",
            "robot": robot.name,
            "robot_hash": format!("{:08x}", robot.content_hash()),
            "date": "20260301-120000",
            "bodies": [],
            "tags": [],
            "answer": {
                "anchors_mm": anchors,
                "initial_lengths_mm": lengths,
                "predicted_tcp_error_mm": 0.5,
                "H_camera_platform": place(camera.into()),
                "H_world_tag_bodies": [],
            },
        })
        .to_string()
    };
    (path, calibration)
}

#[test]
fn a_calibration_has_a_history_and_any_of_it_can_be_used_again() {
    let folder = Folder::new("history");
    let (robot, calibration) = own_robot(&folder);
    let file = folder.path().join("own.calibration.json");
    let name = robot.display().to_string();
    let history = |more: &[&str]| {
        let words = ["calibrate", "history", "--robot", &name];
        document(&[&words[..], more].concat(), folder.path())
    };
    assert_eq!(history(&[])["entries"], json!([]));
    let (first, second) = (calibration(0.0), calibration(3.0));
    std::fs::write(&file, &first).unwrap();
    assert_eq!(history(&[])["entries"].as_array().unwrap().len(), 1);
    std::fs::write(&file, &second).unwrap();
    let known = history(&[]);
    let moved = known["entries"][1]["moved_mm"].as_f64().unwrap();
    assert!((moved - 3.0).abs() < 1e-6, "{known}");
    assert_eq!(known["entries"][1]["moved_cable"], 2);
    assert_eq!(known["entries"][1]["in_use"], true);
    // A dry run changes nothing.
    history(&["--back-to", "1", "--dry-run"]);
    assert_eq!(std::fs::read_to_string(&file).unwrap(), second);
    let back = history(&["--back-to", "1"]);
    assert_eq!(std::fs::read_to_string(&file).unwrap(), first);
    let before = folder.path().join("own.calibration.json.before");
    assert_eq!(std::fs::read_to_string(before).unwrap(), second);
    assert_eq!(back["entries"][2]["cause"], "went back to 1");
    // What is not there is refused, and what is in use stays.
    let words = ["calibrate", "history", "--robot", &name, "--back-to", "9"];
    assert!(refused(&words, folder.path()).contains("no entry 9"));
    assert_eq!(std::fs::read_to_string(&file).unwrap(), first);
    // A line that a cut of power left torn takes no other with it.
    let log = folder.path().join("own.calibration.history.jsonl");
    let mut text = std::fs::read_to_string(&log).unwrap();
    text.push_str("{\"schema\":\"mcdpr-cal");
    std::fs::write(&log, &text).unwrap();
    let forward = history(&["--back-to", "2"]);
    assert_eq!(forward["torn_lines"], json!([4]));
    assert_eq!(forward["entries"].as_array().unwrap().len(), 4);
    assert_eq!(std::fs::read_to_string(&file).unwrap(), second);
}

#[test]
fn the_history_of_another_robot_is_refused_and_nothing_changes() {
    let folder = Folder::new("other-history");
    let (robot, calibration) = own_robot(&folder);
    let file = folder.path().join("own.calibration.json");
    let name = robot.display().to_string();
    std::fs::write(&file, calibration(0.0)).unwrap();
    document(&["calibrate", "history", "--robot", &name], folder.path());
    let log = folder.path().join("own.calibration.history.jsonl");
    let foreign = std::fs::read_to_string(&log)
        .unwrap()
        .replace("\"robot\":\"lab-fast\"", "\"robot\":\"another\"");
    std::fs::write(&log, &foreign).unwrap();
    let second = calibration(1.0);
    std::fs::write(&file, &second).unwrap();
    for more in [&[][..], &["--back-to", "1"]] {
        let words = ["calibrate", "history", "--robot", &name];
        let said = refused(&[&words[..], more].concat(), folder.path());
        assert!(said.contains("another"), "{said}");
    }
    assert_eq!(std::fs::read_to_string(&log).unwrap(), foreign);
    assert_eq!(std::fs::read_to_string(&file).unwrap(), second);
}

#[test]
fn runs_wear_cables_and_none_counts_twice() {
    let folder = Folder::new("care");
    let state = folder.path();
    let run = state.join("one");
    let run = run.to_str().unwrap();
    let robot = ["--robot", "lab-fast"];
    document(
        &[&["run", "paper:table7", "--record", run], &robot[..]].concat(),
        state,
    );
    let care = |more: &[&str]| document(&[&["care"], &robot[..], more].concat(), state);
    let none = care(&[]);
    assert_eq!(
        (&none["runs"], &none["cables"][0]["bendings_worst"]),
        (&json!(0), &json!(0.0))
    );
    let one = care(&["--add", run]);
    assert_eq!(one["runs"], 1);
    let bent = |of: &Value| of["cables"][0]["bendings_worst"].as_f64().unwrap();
    // The circle is run once: out and back over the pulley, and the way to its start.
    assert!((1.0..=8.0).contains(&bent(&one)), "{one}");
    assert!(one["cables"][0]["life_used"].is_null(), "{one}");
    assert_eq!(care(&["--add", run])["cables"], one["cables"]);
    let words = ["care", "--robot", "eight-cable", "--add", run];
    assert!(refused(&words, state).contains("lab-fast"));
    // What its maker tested gives later runs a life; a new cable begins at zero.
    let words = ["run", "paper:table7", "--seed", "2", "--record"];
    let two = state.join("two");
    let two = two.to_str().unwrap();
    document(&[&words[..], &[two], &robot[..]].concat(), state);
    let used = care(&["--tested", "1000", "30", "--add", two])["cables"][0]["life_used"].clone();
    assert!((1e-3..=8e-3).contains(&used.as_f64().unwrap()), "{used}");
    let found = document(&[&["doctor"], &robot[..]].concat(), state);
    let parts = found["findings"].as_array().unwrap();
    let care_found = parts.iter().find(|part| part["part"] == "care").unwrap();
    assert!(
        care_found["found"].as_str().unwrap().contains("2 runs"),
        "{care_found}"
    );
    let renewed = care(&["--renewed", "1"]);
    assert_eq!(bent(&renewed), 0.0);
    assert!(
        renewed["cables"][1]["bendings_worst"].as_f64().unwrap() > 0.0,
        "{renewed}"
    );
}
