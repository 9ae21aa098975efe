//! The first day of a bare winch, by the real program: the simulated machine is not what the robot
//! file says, and the commands find out.

use mcdpr::control::Handle;
use mcdpr::experiment::SimulatedRobot;
use mcdpr::machine::Mismatch;
use mcdpr::motion::{Model, Task};
use mcdpr::robot::Robot;
use mcdpr::run::{Homing, NoStore, Recorder, Session};
use mcdpr_protocol::SessionId;
use mcdpr_simulator::LinkOptions;
use mcdpr_tests::mcdpr;
use mcdpr_tests::process::Folder;
use serde_json::Value;
use std::path::Path;
use std::process::{Output, Stdio};

fn robot(name: &str) -> String {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    let path = root.join("robots").join(name);
    std::fs::read_to_string(path).unwrap()
}

fn run(folder: &Folder, arguments: &[&str]) -> Output {
    mcdpr()
        .args(arguments)
        .current_dir(folder.path())
        .stdin(Stdio::null())
        .output()
        .unwrap()
}

fn document(output: &Output) -> Value {
    let text = String::from_utf8_lossy(&output.stdout);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{errors}");
    serde_json::from_str(&text).unwrap_or_else(|_| panic!("{text}{errors}"))
}

/// A robot file whose four drives speak `drive`: once for the program, once for the machine as it
/// was really built.
fn really(drive: &str) -> (String, String) {
    let mut says = robot("lab-fast.toml");
    for winch in 1..=4 {
        says = with(&says, winch, "drive", &format!("\"{drive}\""));
    }
    (says.clone(), says)
}

/// Replaces a key in the `number`th `[[winch]]` table, or adds it.
fn with(text: &str, number: usize, key: &str, value: &str) -> String {
    let mut out = String::new();
    let mut winch = 0;
    for line in text.lines() {
        if line.trim_start().starts_with('[') && winch == number && line.trim() != "[[winch]]" {
            winch = usize::MAX;
        }
        if line.trim() == "[[winch]]" {
            winch = winch.wrapping_add(1);
            out.push_str(line);
            out.push('\n');
            if winch == number {
                out.push_str(&format!("{key} = {value}\n"));
            }
            continue;
        }
        let own = line
            .split('=')
            .next()
            .is_some_and(|name| name.trim() == key);
        if winch == number && own {
            continue;
        }
        out.push_str(line);
        out.push('\n');
    }
    out
}

/// Takes a key out of the `number`th `[[winch]]` table.
fn without(text: &str, number: usize, key: &str) -> String {
    let marked = with(text, number, key, "0");
    marked.replacen(&format!("{key} = 0\n"), "", 1)
}

fn number(text: &str, key: &str) -> f64 {
    let mut lines = text.lines();
    let line = lines.find(|line| line.split('=').next().is_some_and(|k| k.trim() == key));
    let value = line.and_then(|line| line.split('=').nth(1)).unwrap();
    value.split('#').next().unwrap().trim().parse().unwrap()
}

#[test]
fn commissioning_finds_what_the_robot_file_does_not_know() {
    for drive in ["rmds", "cia402"] {
        let folder = Folder::new(&format!("commission-{drive}"));
        let (says, built) = really(drive);
        let counts = number(&says, "motor_counts_per_turn");
        let built = with(&built, 2, "node", "9");
        let built = with(&built, 2, "encoder_sign", "-1");
        let built = with(&built, 2, "motor_counts_per_turn", &format!("{}", -counts));
        let built = with(&built, 2, "tension_zero_v", "0.2");
        std::fs::write(folder.path().join("says.toml"), &says).unwrap();
        std::fs::write(folder.path().join("built.toml"), built).unwrap();
        let arguments = [
            "commission",
            "2",
            "--robot",
            "says.toml",
            "--built",
            "built.toml",
        ];
        let output = run(
            &folder,
            &[&arguments[..], &["--json", "--out", "two.toml"]].concat(),
        );
        let found = document(&output);
        assert_eq!(found["node"], 9, "{found}");
        assert_eq!(found["encoder_sign"], -1, "{found}");
        assert_eq!(
            found["motor_counts_per_turn"].as_f64(),
            Some(-counts),
            "{found}"
        );
        let zero_v = found["tension_zero_v"].as_f64().unwrap();
        assert!((zero_v - 0.2).abs() < 0.003, "{found}");
        assert_eq!(
            found["differs"].as_array().map(Vec::len),
            Some(4),
            "{found}"
        );
        // What was written is a module file that a robot file can name, whole.
        let module = std::fs::read_to_string(folder.path().join("two.toml")).unwrap();
        assert!(module.contains("encoder_sign = -1\n"), "{module}");
        assert!(!folder.path().join("two.toml.part").exists());
        let mut named = says.clone();
        named = with(&named, 2, "module", "\"two.toml\"");
        named = with(&named, 2, "node", "9");
        for key in ["motor_counts_per_turn", "tension_zero_v", "encoder_sign"] {
            named = without(&named, 2, key);
        }
        std::fs::write(folder.path().join("named.toml"), named).unwrap();
        let arguments = [
            "commission",
            "2",
            "--robot",
            "named.toml",
            "--built",
            "built.toml",
        ];
        let output = run(
            &folder,
            &[&arguments[..], &["--json", "--out", "again.toml"]].concat(),
        );
        let again = document(&output);
        assert_eq!(
            again["differs"].as_array().map(Vec::len),
            Some(0),
            "{again}"
        );
    }
}

#[test]
fn a_drive_that_nobody_named_and_several_that_could_be_meant_are_refused() {
    let folder = Folder::new("ambiguous");
    let (says, built) = really("rmds");
    let built = with(&built, 2, "node", "9");
    let built = with(&built, 3, "node", "10");
    std::fs::write(folder.path().join("says.toml"), &says).unwrap();
    std::fs::write(folder.path().join("built.toml"), built).unwrap();
    let common = [
        "--robot",
        "says.toml",
        "--built",
        "built.toml",
        "--out",
        "w.toml",
    ];
    let output = run(&folder, &[&["commission", "2"], &common[..]].concat());
    assert_eq!(output.status.code(), Some(1));
    let words = String::from_utf8_lossy(&output.stderr);
    assert!(words.contains("--node"), "{words}");
    assert!(!folder.path().join("w.toml").exists(), "nothing is written");
    let output = run(
        &folder,
        &[&["commission", "2", "--node", "9", "--json"], &common[..]].concat(),
    );
    assert_eq!(document(&output)["node"], 9);
}

#[test]
fn the_motor_ratio_is_measured_whatever_the_file_says() {
    let folder = Folder::new("ratio");
    let (says, built) = really("rmds");
    let counts = number(&says, "motor_counts_per_turn");
    let per_turn = number(&says, "encoder_counts_per_turn");
    // Another gear than the file says, and an encoder that counts the other way.
    let real = counts * 1.07;
    let built = with(&built, 1, "motor_counts_per_turn", &format!("{real}"));
    let built = with(&built, 1, "encoder_sign", "-1");
    std::fs::write(folder.path().join("says.toml"), &says).unwrap();
    std::fs::write(folder.path().join("built.toml"), built).unwrap();
    let output = run(
        &folder,
        &[
            "calibrate",
            "winch",
            "1",
            "--robot",
            "says.toml",
            "--built",
            "built.toml",
            "--json",
        ],
    );
    let ratio = document(&output);
    let rho = ratio["rho"].as_f64().unwrap();
    // Three turns each way: an encoder count in 12,288.
    assert!((rho / (-real / per_turn) - 1.0).abs() < 2e-4, "{ratio}");
    assert_eq!(ratio["encoder_sign"], -1);
    assert_eq!(ratio["turns"].as_array().map(Vec::len), Some(6));
    // The gear's play, which the machine has within a tenth, to one count of the drum.
    let backlash = ratio["backlash_motor_counts"].as_f64().unwrap();
    let play = number(&says, "play_deg") / 360.0 * real;
    let resolution = ratio["backlash_resolution"].as_f64().unwrap();
    assert!(
        (backlash - play).abs() <= 0.1 * play + resolution,
        "{play} {ratio}"
    );
}

#[test]
fn the_papers_geared_winch_is_brought_up_whatever_the_machine_is_off_by() {
    // Each seed is another machine: its drives faster or slower, its sensors off.
    let folder = Folder::new("geared");
    for seed in ["1", "2", "7", "17"] {
        let output = run(&folder, &["commission", "1", "--seed", seed, "--json"]);
        document(&output);
        let turn = [
            "calibrate",
            "winch",
            "1",
            "--turns",
            "2",
            "--seed",
            seed,
            "--json",
        ];
        let ratio = document(&run(&folder, &turn));
        let rho = ratio["rho"].as_f64().unwrap();
        // Two turns: less than an encoder count in 4096.
        assert!(
            (rho.abs() / 371.13 - 1.0).abs() < 1.0 / 4096.0,
            "seed {seed}: {ratio}"
        );
    }
}

#[test]
fn a_winch_that_is_not_there_is_named() {
    let folder = Folder::new("no-winch");
    for arguments in [&["commission", "5"][..], &["calibrate", "winch", "0"]] {
        let output = run(&folder, arguments);
        assert_eq!(output.status.code(), Some(1));
        let words = String::from_utf8_lossy(&output.stderr);
        assert!(words.contains("no winch"), "{words}");
    }
}

/// Arms a robot whose brakes have play, and disarms it again; `stated_m` is what the board knows of it.
fn armed_and_disarmed(play_m: f64, stated_m: f64) -> Result<(), String> {
    let mut built = Robot::built_in("paper-table5").unwrap();
    let mut says = built.clone();
    for (winch, reported) in built.winches.iter_mut().zip(&mut says.winches) {
        winch.brake_play_m = play_m;
        reported.brake_play_m = stated_m;
    }
    let (built, says) = (Model::new(&built).unwrap(), Model::new(&says).unwrap());
    let line = LinkOptions::default();
    let link = SimulatedRobot::new(Mismatch::realistic(), 3)
        .line(line)
        .at_home(&built)
        .unwrap();
    let handle = Handle::new();
    let homing = Homing::Place(says.robot().tool.home_in_world_m);
    let link = Box::new(link);
    let mut session = Session::open(&says, link, SessionId(6), &handle, homing, &NoStore).unwrap();
    session.arm().map_err(|error| format!("arming: {error}"))?;
    // A drum that reels in drags its brake's disc along: let go, it falls by the play.
    let circle = Task::built_in("paper:table7", -0.18).unwrap();
    let plan = session.plan(circle, None).unwrap();
    let followed = session.follow(&plan, &mut Recorder::default(), |_| {});
    followed.map_err(|error| format!("moving: {error}"))?;
    let disarmed = session.disarm();
    disarmed.map_err(|error| format!("disarming: {error}"))?;
    Ok(())
}

#[test]
fn a_brake_with_play_is_taken_for_a_slipping_one_only_where_the_board_does_not_know_of_it() {
    // 1 degree on a drum of 20 mm.
    let play_m = 0.35e-3;
    assert_eq!(armed_and_disarmed(play_m, play_m), Ok(()));
    let refused = armed_and_disarmed(play_m, 0.0).unwrap_err();
    assert!(refused.contains("B2"), "{refused}");
}

#[test]
fn commissioning_measures_the_play_of_the_brake() {
    let folder = Folder::new("commission-brake-play");
    let (says, built) = really("rmds");
    let built = with(&built, 2, "brake_play_deg", "0.8");
    std::fs::write(folder.path().join("says.toml"), &says).unwrap();
    std::fs::write(folder.path().join("built.toml"), built).unwrap();
    let arguments = ["commission", "2", "--robot", "says.toml"];
    let more = ["--built", "built.toml", "--json", "--out", "two.toml"];
    let found = document(&run(&folder, &[&arguments[..], &more].concat()));
    let play_deg = found["brake_play_deg"].as_f64().unwrap();
    let counts = number(&says, "encoder_counts_per_turn");
    // The drum hits its stop and takes the disc along by a few counts: more than the play, not less.
    let count_deg = 360.0 / counts;
    let range = 0.8 - count_deg..=0.8 + 4.0 * count_deg;
    assert!(range.contains(&play_deg), "{found}");
    let differs = found["differs"].to_string();
    assert!(differs.contains("brake_play_deg"), "{differs}");
    let module = std::fs::read_to_string(folder.path().join("two.toml")).unwrap();
    assert!(
        (number(&module, "brake_play_deg") - play_deg).abs() < 1e-3,
        "{module}"
    );
}
