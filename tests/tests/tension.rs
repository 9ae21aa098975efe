//! The tension loop in the simulator: bounds of docs/tension.md on a few seeds, through the real
//! control core, client and link. `mcdpr study tension` measures the whole table.

use mcdpr::link::{Client, SimulatedLink};
use mcdpr::machine::{self, Mismatch};
use mcdpr::motion::{Model, Task};
use mcdpr::robot::{Control, Robot};
use mcdpr::run;
use mcdpr::tension::{Bench, Change, Script, Trace, at_rest, recovery};
use mcdpr_protocol::SessionId;
use mcdpr_simulator::plant::{Plant, Pose};
use mcdpr_simulator::{LinkOptions, Simulation};
use mcdpr_tests::process::Folder;

const SEEDS: u64 = 5;

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// A pull of half a second on the platform, in another direction with every seed.
fn pulled(robot: &Robot, change: &Change, newtons: f64, seed: u64) -> Trace {
    let angle = seed as f64 * 2.399_963;
    let force = [newtons * angle.cos(), newtons * angle.sin(), 0.0];
    let script = Script::platform_pull(force, 0.5, 1.0, 4.0);
    let trace = Bench::start(robot, change, seed)
        .unwrap()
        .run(&script)
        .unwrap();
    assert_eq!(trace.fault, None, "seed {seed}");
    trace
}

#[test]
fn at_rest_and_on_the_circle_the_tension_is_what_was_asked_for() {
    let robot = Robot::built_in("lab-direct").unwrap();
    let (mut rest, mut circle) = (Vec::new(), Vec::new());
    for seed in 1..=SEEDS {
        let mut bench = Bench::start(&robot, &Change::default(), seed).unwrap();
        let trace = bench.run(&Script::rest(2.0)).unwrap();
        rest.push(at_rest(&trace, 0.0, 2.0).mean_error_n.abs());
        let task = Task::built_in("paper:table7", -0.18).unwrap();
        let trace = bench.follow(task).unwrap();
        assert_eq!(trace.fault, None);
        circle.push(at_rest(&trace, 0.0, f64::INFINITY).mean_abs_n);
    }
    let (rest, circle) = (median(rest), median(circle));
    println!("rest {rest:.4} N, circle {circle:.4} N");
    assert!(rest <= 0.02, "{rest} N at rest");
    assert!(circle <= 0.05, "{circle} N on the circle");
}

#[test]
fn a_pull_on_the_platform_is_answered_within_a_tenth_of_a_second() {
    let robot = Robot::built_in("lab-direct").unwrap();
    for (newtons, peak_n) in [(2.0, 1.0), (5.0, 1.5)] {
        let (mut peaks, mut backs) = (Vec::new(), Vec::new());
        for seed in 1..=SEEDS {
            let trace = pulled(&robot, &Change::default(), newtons, seed);
            let back = recovery(&trace, 0.5, 1.0);
            assert!(back.least_n > 0.5, "slack: {back:?}");
            peaks.push(back.peak_n);
            backs.push(back.mean_back_s);
        }
        let (peak, back) = (median(peaks), median(backs));
        println!("{newtons} N: peak {peak:.3} N, back after {back:.3} s");
        assert!(peak <= peak_n, "{newtons} N: peak {peak} N");
        assert!(back <= 0.1, "{newtons} N: {back} s");
    }
}

#[test]
fn other_cables_and_drums_stay_stable_with_the_same_gains() {
    let robot = Robot::built_in("lab-direct").unwrap();
    for stiffness in [0.5, 2.0] {
        let change = Change {
            stiffness,
            ..Change::default()
        };
        let trace = pulled(&robot, &change, 2.0, 1);
        let after = at_rest(&trace, 3.0, 4.0);
        assert!(after.sd_n < 0.5, "stiffness {stiffness}: {after:?}");
    }
    for drum_kg in [0.05, 0.2] {
        let mut robot = robot.clone();
        let winch = robot.winches.last_mut().unwrap();
        winch.rotor_inertia_kg_m2 = 0.0;
        winch.drum_inertia_kg_m2 = drum_kg * winch.drum_radius_m.powi(2);
        let trace = pulled(&robot, &Change::default(), 2.0, 1);
        let after = at_rest(&trace, 3.0, 4.0);
        assert!(after.sd_n < 0.5, "drum {drum_kg} kg: {after:?}");
    }
}

#[test]
fn c1_a_slack_cable_comes_back_without_a_blow() {
    let robot = Robot::built_in("lab-direct").unwrap();
    let mut bench = Bench::start(&robot, &Change::default(), 1).unwrap();
    let cable = bench.watched();
    let trace = bench
        .run(&Script::slip(cable, 0.01, 0.5, 0.7, 4.0))
        .unwrap();
    assert_eq!(trace.fault, None);
    let least = trace
        .tension_n
        .iter()
        .copied()
        .fold(f64::INFINITY, f64::min);
    let greatest = recovery(&trace, 0.7, 4.0).greatest_n;
    assert!(greatest < 20.0, "{greatest} N");
    let end = at_rest(&trace, 3.0, 4.0);
    assert!(
        end.mean_error_n.abs() < 0.1,
        "least {least} N, then {end:?}"
    );
}

#[test]
fn brakes_closed_in_hold_hold_and_open_for_the_motion() {
    let mut robot = Robot::built_in("lab-direct").unwrap();
    robot.tension.hold_braked = true;
    let mut bench = Bench::start(&robot, &Change::default(), 1).unwrap();
    let closed = |bench: &mut Bench| {
        bench
            .plant(|plant| Ok(plant.truth()?.brakes_closed))
            .unwrap()
    };
    assert!(closed(&mut bench)[..4].iter().all(|closed| *closed));
    let before = bench.run(&Script::rest(0.5)).unwrap();
    let held = at_rest(&before, 0.0, 0.5);
    // The brakes closed on what was left of the swing.
    assert!(held.max_abs_n < 0.6, "{held:?}");
    let task = "start_mm = [335, 0, -180]\n[[leg]]\nto_mm = [340, 0, -180]\nduration_s = 2";
    let task = Task::parse(task, "short.toml".into()).unwrap();
    let trace = bench.follow(task).unwrap();
    assert_eq!(trace.fault, None);
    let moved = trace.tool_m.last().unwrap()[0] - trace.tool_m[0][0];
    assert!((moved - 5e-3).abs() < 5e-4, "moved {moved} m");
    bench.run(&Script::rest(0.2)).unwrap();
    assert!(closed(&mut bench)[..4].iter().all(|closed| *closed));
}

/// The eight-cable robot with two of its cables held by tension: the planner has no equilibrium
/// for it, so core and simulator are taken as they are.
#[test]
fn two_cables_of_eight_are_held_by_tension_at_once() {
    let mut robot = Robot::built_in("eight-cable").unwrap();
    // The made-up tensions below leave one cable at 4.7 N.
    robot.limits.tension_min_n = 1.0;
    for (index, cable) in robot.cables.iter_mut().enumerate() {
        cable.control = if index >= 6 {
            Control::Tension
        } else {
            Control::Position
        };
    }
    let params = machine::plant_params(&robot, &Mismatch::default(), 1);
    let mut plant = Plant::new(params, 1).unwrap();
    let home = robot.tool.home_in_world_m - robot.tool.tcp_in_platform_m;
    plant
        .settle_at(&Pose::level(home.into()), &[12.0; 8], None)
        .unwrap();
    let truth = plant.truth().unwrap();
    let tensions: Vec<f64> = truth.tensions_winch_n.to_vec();
    let lengths: Vec<f64> = truth.unstretched_lengths_m.to_vec();
    let link = SimulatedLink::new(Simulation::new(plant, &LinkOptions::default(), 1).unwrap());
    let mut client = Client::connect(link.clone(), SessionId(1)).unwrap();
    let hash = run::configure(&mut client, &robot).unwrap();
    client
        .request(machine::reference(&lengths, &tensions))
        .unwrap();
    run::arm(&mut client, hash).unwrap();
    let mut pump = |seconds: f64| {
        let until = client.now_us() + (seconds * 1e6) as u64;
        client.pump(until).unwrap();
    };
    pump(1.0);
    link.with(|s| s.plant_mut().set_load([1.0, 0.5, 0.0], [0.0; 3], [0.0; 3]))
        .unwrap();
    pump(0.5);
    link.with(|s| s.plant_mut().set_load([0.0; 3], [0.0; 3], [0.0; 3]))
        .unwrap();
    pump(1.5);
    // Seconds one after another: one of them, with what is left of the pull, may be off by more.
    let mut errors = [const { Vec::new() }; 2];
    for _ in 0..9 {
        link.with(Simulation::record_truth);
        pump(1.0);
        let trace = link.with(Simulation::take_trace);
        for (errors, cable) in errors.iter_mut().zip([6, 7]) {
            let sum: f64 = trace.iter().map(|p| p.truth.tensions_winch_n[cable]).sum();
            errors.push((sum / trace.len() as f64 - tensions[cable]).abs());
        }
    }
    assert_eq!(run::status(&mut client).unwrap().fault, None);
    for (errors, cable) in errors.iter_mut().zip([7, 8]) {
        errors.sort_by(f64::total_cmp);
        println!("cable {cable}: {errors:?}");
        assert!(errors[4] < 0.1, "cable {cable}: {errors:?} N");
        assert!(errors[8] < 0.2, "cable {cable}: {errors:?} N");
    }
}

#[test]
fn a_robot_is_rigged_from_slack_and_let_down_again() {
    let folder = Folder::new("rig");
    let rig = |words: &[&str]| {
        let mut command = mcdpr_tests::mcdpr();
        command.args(words).current_dir(folder.path());
        let output = command.output().unwrap();
        assert!(
            output.status.success(),
            "{words:?}: {}",
            String::from_utf8_lossy(&output.stderr)
        );
        let document: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        document["tensions_n"]
            .as_array()
            .unwrap()
            .iter()
            .map(|n| n.as_f64().unwrap())
            .collect::<Vec<_>>()
    };
    let up = rig(&["rig", "tension", "--yes", "--json", "--robot", "lab-fast"]);
    // What statics say for the platform at home, all cables together.
    let model = Model::new(&Robot::built_in("lab-fast").unwrap()).unwrap();
    let home = model.rest_at_home().unwrap();
    for (up, home) in up.iter().zip(home.tensions_n()) {
        assert!((up - home).abs() < 0.5, "{up} N, not {home} N");
    }
    let down = rig(&["rig", "lower", "--yes", "--json", "--robot", "lab-fast"]);
    assert!(down.iter().all(|&n| n < 0.6), "{down:?}");
    rig(&["rig", "spool", "2", "-30", "--yes", "--json"]);
    let on = rig(&["rig", "attach", "3", "--yes", "--json"]);
    assert!(on[2] > 0.7 && on[2] < 2.0, "{on:?}");
    assert!([0, 1, 3].iter().all(|&other| on[other] < 0.3), "{on:?}");
}

#[test]
fn a_rig_step_that_is_not_confirmed_is_not_done() {
    let folder = Folder::new("rig-unconfirmed");
    let output = mcdpr_tests::mcdpr()
        .args(["rig", "tension"])
        .current_dir(folder.path())
        .stdin(std::process::Stdio::null())
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(1));
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(message.contains("nothing moves"), "{message}");
}

fn json(words: &[&str], folder: &std::path::Path) -> serde_json::Value {
    let output = mcdpr_tests::mcdpr()
        .args(words)
        .args(["--json", "--record"])
        .arg(folder)
        .output()
        .unwrap();
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{words:?}: {message}");
    serde_json::from_slice(&output.stdout).unwrap()
}

/// The loop is identified as what the robot files say it is, light drum or geared.
#[test]
fn tuning_finds_delay_resonance_and_swing_and_says_which_gains_to_keep() {
    let folder = Folder::new("tune");
    for (robot, resonance_hz) in [
        ("lab-direct", 100.0..180.0),
        ("paper-optimistic", 15.0..40.0),
    ] {
        let found = json(
            &["tune", "tension", "--robot", robot],
            &folder.path().join(robot),
        );
        let number = |key: &str| found["identified"][key].as_f64().unwrap();
        assert!(number("explained") > 0.8, "{found}");
        assert!(resonance_hz.contains(&number("resonance_hz")), "{found}");
        assert!((1.0..8.0).contains(&number("swing_hz")), "{found}");
        assert!(number("delay_s") < 0.01, "{found}");
        never_rings_more(&found);
    }
}

/// What is recommended follows its steps better, and rings no more than the file's gains.
fn never_rings_more(found: &serde_json::Value) {
    let number = |key: &str| found[key].as_f64().unwrap();
    let (before, after) = (number("before_rms_n"), number("after_rms_n"));
    if found["keep"].as_bool().unwrap() {
        assert_eq!(found["proposed"], found["before"], "{found}");
        assert_eq!(before, after, "{found}");
    } else {
        assert!(after < 0.95 * before, "{found}");
        let (before, after) = (number("before_ringing_n"), number("after_ringing_n"));
        assert!(after <= before, "{found}");
    }
}

/// Every robot with a tension-held cable can be tuned, those with a geared winch, and those held on all sides, too.
#[test]
fn every_robot_with_a_tension_loop_is_tuned_and_nothing_that_rings_is_recommended() {
    let folder = Folder::new("tune-all");
    // Those without a model are searched on the robot: a law with a speed as its output, and a platform that is held
    // on all sides.
    for (robot, modelled) in [
        ("paper-optimistic", true),
        ("paper-table5", false),
        ("paper-table3", false),
        ("lab-fast", false),
        ("planar-vertical", false),
    ] {
        let at = folder.path().join(robot);
        let found = json(&["tune", "tension", "--robot", robot], &at);
        never_rings_more(&found);
        assert_eq!(!found["identified"].is_null(), modelled, "{found}");
    }
    let refused = mcdpr_tests::mcdpr()
        .args(["tune", "tension", "--robot", "three-point"])
        .current_dir(folder.path())
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(
        !refused.status.success() && said.contains("no tension loop to tune"),
        "{said}"
    );
    let words = [
        "tune",
        "tension",
        "--robot",
        "paper-table5",
        "--gains",
        "4,-1,0",
    ];
    let refused = mcdpr_tests::mcdpr()
        .args(words)
        .current_dir(folder.path())
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(
        !refused.status.success() && said.contains("ki is -1"),
        "{said}"
    );
    // Before anything is connected or written.
    assert!(!folder.path().join("runs").exists());
}

/// The firmware's own file, on the emulated chip, meets the bounds of the core in this process.
#[test]
fn on_the_chip_the_experiments_keep_the_same_bounds() {
    let folder = Folder::new("tension");
    let experiment = |name: &str| {
        let words = ["experiment", name, "--robot", "lab-direct", "--on", "chip"];
        let found = json(&words, &folder.path().join(name));
        assert!(found["fault"].is_null(), "{found}");
        found
    };
    let hold = experiment("hold");
    assert!(
        hold["steady"]["mean_error_n"].as_f64().unwrap().abs() < 0.02,
        "{hold}"
    );
    assert!(hold["steady"]["sd_n"].as_f64().unwrap() < 0.1, "{hold}");
    let pulled = experiment("platform");
    let number = |key: &str| pulled["recovery"][key].as_f64().unwrap();
    // One seed; the bound of 1.0 N is the median's.
    assert!(number("peak_n") < 1.2, "{pulled}");
    assert!(number("mean_back_s") <= 0.1, "{pulled}");
    assert!(number("least_n") > 0.5, "slack: {pulled}");
    let slack = experiment("slack");
    assert!(
        slack["recovery"]["greatest_n"].as_f64().unwrap() < 20.0,
        "{slack}"
    );
}
