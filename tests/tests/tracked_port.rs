//! A robot behind a port that tracks its slow changes: its state is kept in files, and its board gets the friction that
//! was found. In a program of its own: another test's computations would keep a board waiting.

use mcdpr::robot;
use mcdpr_tests::process::{Folder, Simulator, alone, document, refused};
use serde_json::Value;

/// Simulated seconds per second: slow enough for a busy computer to keep a board fed.
const SCALE: &str = "0.6";

#[test]
fn the_state_outlasts_the_program_and_any_earlier_one_can_be_used_again() {
    let _alone = alone();
    let folder = Folder::new("tracked-port");
    let robot = ["--robot", "lab-fast", "--machine", "after-hours"];
    let simulator = Simulator::start_with(SCALE, &robot);
    let on = |words: &[&str]| {
        let port = [
            "--robot",
            "lab-fast",
            "--time-scale",
            SCALE,
            "--on",
            &simulator.port,
        ];
        document(&[words, &port].concat(), folder.path())
    };
    let track = |more: &[&str]| {
        document(
            &[&["track", "--robot", "lab-fast"], more].concat(),
            folder.path(),
        )
    };
    assert!(track(&[])["state"].is_null());
    let first = on(&["run", "fitting", "--track"]);
    assert_eq!(first["rests"].as_array().unwrap().len(), 2);
    let kept = track(&[]);
    assert_eq!(kept["entries"].as_array().unwrap().len(), 1);
    let strain = |track: &Value, cable: usize| {
        track["state"]["cables"][cable]["strain"]["value"]
            .as_f64()
            .unwrap()
    };
    assert!(strain(&kept, 0) > 0.0, "{kept}");
    // A plan by what is tracked says so, and so do the plans that were driven.
    let words = ["plan", "fitting", "--robot", "lab-fast", "--dry-run"];
    let plan = |more: &[&str]| document(&[&words[..], more].concat(), folder.path());
    let tube = |plan: &Value| plan["tube"]["mean_m"].as_f64().unwrap();
    let (tracked, plain) = (plan(&["--tracked"]), plan(&[]));
    assert_eq!(tracked["tube"]["source"], "what is tracked");
    assert!(
        tube(&tracked) < tube(&plain),
        "{} {}",
        tube(&tracked),
        tube(&plain)
    );
    assert!(first["tubes"][0]["inside"].is_null(), "{first}");
    assert!(first["tubes"][0]["mean_m"].as_f64().unwrap() < tube(&plain));
    // No camera has looked: nothing can tell where the camera is on its bracket.
    assert_eq!(kept["state"]["camera_m"][0]["observed"], false);
    // A second program goes on from there: less is new to it than to the first.
    let second = on(&["run", "fitting", "--track"]);
    let doubt = |run: &Value| run["rests"][0]["doubt"].as_f64().unwrap();
    assert!(second["rests"][0]["fits"].as_bool().unwrap(), "{second}");
    assert!(
        doubt(&second) < doubt(&first),
        "{} {}",
        doubt(&second),
        doubt(&first)
    );
    let later = track(&[]);
    assert_eq!(later["entries"].as_array().unwrap().len(), 2);
    assert!(strain(&later, 0) > strain(&kept, 0));
    // Back to the first, which keeps the second.
    let back = track(&["--back-to", "1"]);
    assert_eq!(back["state"]["cables"], kept["state"]["cables"]);
    assert_eq!(back["entries"].as_array().unwrap().len(), 3);
    let words = refused(
        &["track", "--robot", "lab-fast", "--back-to", "9"],
        folder.path(),
    );
    assert!(words.contains("has no entry 9"), "{words}");
    // A state of another robot, and one that is damaged: refused, and kept as they are.
    let file = folder.path().join("lab-fast.tracked.json");
    let text = std::fs::read_to_string(&file).unwrap();
    let port = &simulator.port;
    let run = [
        "run",
        "fitting",
        "--track",
        "--robot",
        "lab-fast",
        "--time-scale",
        SCALE,
        "--on",
        port,
    ];
    for (spoilt, says) in [
        (
            text.replace("lab-fast", "lab-slow"),
            "of robot lab-slow, this is lab-fast",
        ),
        (
            text.replacen("\"mean\":[", "\"mean\":[1e999,", 1),
            "not a tracked state",
        ),
        (
            text.replacen("\"mean\":[", "\"mean\":[1.0,", 1),
            "number of states",
        ),
    ] {
        std::fs::write(&file, &spoilt).unwrap();
        let words = refused(&run, folder.path());
        assert!(words.replace("\n  │ ", " ").contains(says), "{words}");
        assert_eq!(std::fs::read_to_string(&file).unwrap(), spoilt);
    }
    // Begun anew; the history stays.
    let anew = track(&["--forget"]);
    assert!(anew["state"].is_null() && !file.exists());
    assert!(anew["entries"].as_array().unwrap().len() >= 3);
}

#[test]
fn the_board_of_the_next_run_gets_the_friction_that_was_found() {
    let _alone = alone();
    let folder = Folder::new("tracked-port-friction");
    // Cold, the simulated gears rub 1.7 times as much as the file says.
    let cold = (
        "static_friction = 1.3",
        "static_friction = 1.3\ncold_friction = 1.7",
    );
    let path = folder.robot("paper-table5", "cold.toml", &[cold]);
    let gear = robot::load(&path).unwrap().winches[3].gear.unwrap();
    let file_mnm = (gear.rotor_friction_nm + gear.gear_friction_nm) * 1e3;
    let path = path.display().to_string();
    let simulator = Simulator::start_with(SCALE, &["--robot", &path, "--seed", "11"]);
    let run = || {
        let words = [
            "run",
            "paper:table7",
            "--track",
            "--robot",
            "cold.toml",
            "--time-scale",
            SCALE,
            "--on",
        ];
        document(&[&words[..], &[&simulator.port]].concat(), folder.path())
    };
    let configured = |run: &Value| {
        let path = folder.path().join(run["run_folder"].as_str().unwrap());
        let text = std::fs::read_to_string(path.join("robot.json")).unwrap();
        let robot: Value = serde_json::from_str(&text).unwrap();
        let gear = &robot["winches"][3]["gear"];
        let of = |key: &str| gear[key].as_f64().unwrap() * 1e3;
        of("rotor_friction_nm") + of("gear_friction_nm")
    };
    let first = run();
    assert!((configured(&first) / file_mnm - 1.0).abs() < 1e-9);
    let kept = document(&["track", "--robot", "cold.toml"], folder.path());
    let share = kept["frictions"][3]["share"].as_f64().unwrap();
    assert!((1.3..2.0).contains(&share), "{}", kept["frictions"]);
    let second = run();
    let used = configured(&second) / file_mnm;
    // It has grown no less certain in the seconds between the two.
    assert!((used / share - 1.0).abs() < 0.01, "{used} {share}");
}
