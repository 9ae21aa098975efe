//! A robot of one's own from a few answers: the file is written, checked, planned for and run, by the
//! real program.

use mcdpr_tests::mcdpr;
use mcdpr_tests::process::Folder;
use serde_json::Value;
use std::path::Path;
use std::process::{Output, Stdio};

fn call(folder: &Path, arguments: &[&str]) -> Output {
    mcdpr()
        .args(arguments)
        .current_dir(folder)
        .stdin(Stdio::null())
        .output()
        .unwrap()
}

fn good(folder: &Path, arguments: &[&str]) -> String {
    let output = call(folder, arguments);
    let message = String::from_utf8_lossy(&output.stderr);
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{arguments:?}: {message}\n{said}");
    said
}

fn document(folder: &Path, arguments: &[&str]) -> Value {
    serde_json::from_str(&good(folder, arguments)).unwrap()
}

/// What is printed where a command fails with code 1, on one line.
fn refused(folder: &Path, arguments: &[&str]) -> String {
    let output = call(folder, arguments);
    assert_eq!(output.status.code(), Some(1), "{arguments:?}");
    let text = [output.stdout, output.stderr].concat();
    let text = String::from_utf8_lossy(&text).replace('│', " ");
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Frames of different size, mass, winches and number of cables.
const FRAMES: [(&str, &[&str], u64); 4] = [
    ("small", &["--frame-mm", "1000", "1000", "1000"], 4),
    (
        "hall",
        &[
            "--frame-mm",
            "2000",
            "3000",
            "2000",
            "--mass-kg",
            "4",
            "--platform-mm",
            "300",
            "300",
            "100",
        ],
        4,
    ),
    (
        "slow",
        &[
            "--frame-mm",
            "800",
            "900",
            "700",
            "--mass-kg",
            "1",
            "--winch",
            "geared-371",
        ],
        4,
    ),
    (
        "eight",
        &[
            "--frame-mm",
            "2000",
            "2000",
            "1500",
            "--cables",
            "8",
            "--mass-kg",
            "3",
            "--platform-mm",
            "400",
            "400",
            "200",
        ],
        8,
    ),
];

#[test]
fn a_file_from_a_few_answers_is_a_robot_that_runs() {
    let folder = Folder::new("own-frame");
    let at = folder.path();
    for (name, answers, cables) in FRAMES {
        let file = format!("{name}.toml");
        let init = [&["config", "init", file.as_str()], answers].concat();
        let said = good(at, &init);
        assert!(
            said.contains("verdict: it can work; next: mcdpr serve"),
            "{name}: {said}"
        );
        let drawing = std::fs::read_to_string(at.join(format!("{name}.svg"))).unwrap();
        assert!(drawing.contains("From above") && drawing.contains(name));
        let text = std::fs::read_to_string(at.join(&file)).unwrap();
        assert!(text.contains(&format!("name = \"{name}\"")), "{text}");
        // Short: what differs from the defaults, and the cables.
        let lines = text.lines().filter(|line| !line.trim().is_empty()).count();
        assert!(lines < 60, "{lines} lines");
        let checked = document(at, &["config", "check", &file, "--json"]);
        assert_eq!(checked["cables"], cables);
        assert!(
            checked["physics"]["share"].as_f64().unwrap() > 0.4,
            "{name}: {checked}"
        );
        let plan = document(at, &["plan", "fitting", "--robot", &file, "--json"]);
        assert!(plan["verdict"]["broken"].is_null(), "{name}: {plan}");
        let run = document(at, &["run", "fitting", "--robot", &file, "--json"]);
        let worst_mm = run["path_error_m"]["max"].as_f64().map(|m| m * 1e3);
        assert!(worst_mm.is_some_and(|mm| mm < 8.0), "{name}: {run}");
    }
}

/// The file that `config init` wrote, with ten times its gain.
fn eager(text: &str) -> String {
    assert!(
        text.contains("kp = 4.0 ") && text.contains("kd = 0.0133 "),
        "{text}"
    );
    text.replace("kp = 4.0 ", "kp = 40 ")
        .replace("kd = 0.0133 ", "kd = 0 ")
}

/// Frames that stopped by faults: a cube of 1 m shook until a cable seemed broken, and in a frame of 5 m the cables
/// that stretch while the platform accelerates seemed to slip.
#[test]
fn frames_that_shook_or_stretched_run_on_machines_that_are_off() {
    let folder = Folder::new("own-gains");
    let at = folder.path();
    let cube = ["--frame-mm", "1000", "1000", "1000"];
    let hall = ["--frame-mm", "5000", "5000", "3000", "--mass-kg", "10"];
    for (file, answers, seeds) in [
        ("cube.toml", &cube[..], ["8", "11", "16"]),
        ("hall.toml", &hall[..], ["2", "5", "6"]),
    ] {
        good(at, &[&["config", "init", file], answers].concat());
        let checked = good(at, &["config", "check", file]);
        assert!(checked.contains("also with 2 times the gains"), "{checked}");
        for seed in seeds {
            let run = ["run", "fitting", "--robot", file, "--seed", seed, "--json"];
            assert!(document(at, &run)["path_error_m"]["max"].is_number());
        }
    }
    // Ten times its gain leaves little: the check warns.
    let text = std::fs::read_to_string(at.join("cube.toml")).unwrap();
    std::fs::write(at.join("eager.toml"), eager(&text)).unwrap();
    let checked = good(at, &["config", "check", "eager.toml"]);
    assert!(checked.contains("little reserve"), "{checked}");
}

/// Twice the gain of `paper-table5` shakes behind its gear: refused, with gain, play and what the tension does.
#[test]
fn gains_that_hunt_are_refused_with_the_numbers() {
    let folder = Folder::new("own-hunts");
    let file = folder.robot("paper-table5", "hunts.toml", &[("kp = 4.0 ", "kp = 8.0 ")]);
    let said = refused(folder.path(), &["config", "check", file.to_str().unwrap()]);
    for part in [
        "the tension shakes by",
        "kp is 8 mm/s per N",
        "1.00 degrees of play",
    ] {
        assert!(said.contains(part), "{part}: {said}");
    }
}

#[test]
fn an_own_frame_is_calibrated_and_picks() {
    let folder = Folder::new("own-pick");
    let at = folder.path();
    for (name, answers, _) in &FRAMES[1..3] {
        let file = format!("{name}.toml");
        let equipped = ["--gripper-mm", "60", "--camera"];
        good(
            at,
            &[&["config", "init", file.as_str()], *answers, &equipped].concat(),
        );
        let calibrate = [
            "calibrate",
            "all",
            "--robot",
            &file,
            "--target",
            "board",
            "--poses",
            "10",
            "--candidates",
            "60",
            "--json",
        ];
        let calibration = document(at, &calibrate);
        let verdict = calibration["verdict"].as_str().unwrap();
        assert!(verdict.starts_with("accepted"), "{name}: {verdict}");
        let scene = document(at, &["pick", "--robot", &file, "--objects", "1", "--json"]);
        assert_eq!(scene["carried_off"], 1, "{name}: {scene}");
        // The budget knows how well this calibration found the camera.
        let off_m = scene["errors_m"][0].as_f64().unwrap();
        let budget = &scene["report"]["attempts"][0]["budget"];
        let expected_m = budget["total_m"].as_f64().unwrap();
        assert!(
            off_m < 3e-3 && off_m < 4.0 * expected_m,
            "{name}: {off_m} {budget}"
        );
    }
    // A place of release in the tray is refused before anything is connected.
    let said = refused(
        at,
        &[
            "pick",
            "--robot",
            "hall.toml",
            "--release-mm",
            "0",
            "50",
            "700",
        ],
    );
    assert!(
        said.contains("is in the tray") && said.contains("--release-mm"),
        "{said}"
    );
}

#[test]
fn a_robot_that_cannot_work_is_named_with_the_reason() {
    let folder = Folder::new("own-unfit");
    let at = folder.path();
    // 60 kg on sensors for 39 N.
    let heavy = [
        "--frame-mm",
        "1000",
        "1000",
        "1000",
        "--mass-kg",
        "60",
        "--winch",
        "geared-371",
    ];
    let said = good(
        at,
        &[&["config", "init", "heavy.toml"], &heavy[..]].concat(),
    );
    assert!(said.contains("verdict: it cannot work yet"), "{said}");
    let said = refused(at, &["config", "check", "heavy.toml"]);
    assert!(said.contains("cannot work as it is described"), "{said}");
    // A tension loop that shakes on stiff cables without damping is found by the simulation.
    good(
        at,
        &[
            "config",
            "init",
            "stiff.toml",
            "--frame-mm",
            "1000",
            "1000",
            "1000",
        ],
    );
    let text = std::fs::read_to_string(at.join("stiff.toml")).unwrap();
    assert!(text.contains("ea_n = 20000"), "{text}");
    // With the gains of `config init` it holds; with ten times the gain it does not.
    let stiff = eager(&text).replace("ea_n = 20000", "ea_n = 50000");
    std::fs::write(at.join("stiff.toml"), stiff).unwrap();
    let said = refused(at, &["config", "check", "stiff.toml"]);
    assert!(said.contains("does not hold at home"), "{said}");
    // Every value is in the hash: a mass that was typed wrong is another robot.
    good(
        at,
        &[
            "config",
            "init",
            "a.toml",
            "--frame-mm",
            "1000",
            "1000",
            "1000",
        ],
    );
    let text = std::fs::read_to_string(at.join("a.toml")).unwrap();
    let hash = |name: &str| document(at, &["config", "check", name, "--json"])["hash"].clone();
    for (from, to) in [
        ("mass_kg = 1.5", "mass_kg = 1.6"),
        ("-500, 1000]", "-501, 1000]"),
    ] {
        assert!(text.contains(from), "{text}");
        std::fs::write(at.join("b.toml"), text.replacen(from, to, 1)).unwrap();
        assert_ne!(hash("a.toml"), hash("b.toml"), "{from}");
    }
}

#[test]
fn bad_answers_write_no_file() {
    let folder = Folder::new("own-bad");
    let at = folder.path();
    for (answers, said) in [
        (&["--frame-mm", "1000", "0", "1000"][..], "over 0"),
        (
            &["--frame-mm", "1000", "1000", "1000", "--cables", "5"],
            "4 or 8 cables",
        ),
        (&["--mass-kg", "2"], "--frame-mm"),
        // Metres instead of millimetres.
        (&["--frame-mm", "2", "3", "2"], "does not fit"),
        (
            &["--frame-mm", "1000", "1000", "1000", "--mass-kg", "-1"],
            "mass",
        ),
        (
            &["--frame-mm", "1000", "1000", "1000", "--gripper-mm", "0"],
            "the gripper's opening must be over 0",
        ),
        (&["--copy", "--mass-kg", "2"], "--copy"),
    ] {
        let message = {
            let words = [&["config", "init", "bad.toml"], answers].concat();
            let output = call(at, &words);
            assert!(!output.status.success(), "{answers:?}");
            String::from_utf8_lossy(&output.stderr).into_owned()
        };
        assert!(message.contains(said), "{answers:?}: {message}");
        assert_eq!(std::fs::read_dir(at).unwrap().count(), 0, "{answers:?}");
    }
    good(
        at,
        &[
            "config",
            "init",
            "a.toml",
            "--frame-mm",
            "1000",
            "1000",
            "1000",
        ],
    );
    let before = std::fs::read_to_string(at.join("a.toml")).unwrap();
    let said = refused(
        at,
        &[
            "config",
            "init",
            "a.toml",
            "--frame-mm",
            "2000",
            "1000",
            "1000",
        ],
    );
    assert!(said.contains("not touched"), "{said}");
    assert_eq!(std::fs::read_to_string(at.join("a.toml")).unwrap(), before);
}

#[test]
fn a_plan_lists_every_limit_and_is_drawn() {
    let folder = Folder::new("own-plan");
    let at = folder.path();
    let said = good(at, &["plan", "paper:table7"]);
    let rows = [
        "limit",
        "tilt of the platform, deg",
        "least tension, cable 1, N",
        "greatest tension, cable 4, N",
        "speed, cable 2, mm/s",
        "motor current, cable 3, A",
        "length off drum, cable 4, mm",
        "distance between cables, mm",
    ];
    for row in rows {
        assert!(said.contains(row), "{row}: {said}");
    }
    assert!(
        said.lines().all(|line| line.chars().count() <= 120),
        "{said}"
    );
    assert!(said.contains("next: mcdpr run paper:table7"), "{said}");
    let folder = said
        .split("drawn in ")
        .nth(1)
        .unwrap()
        .split("/plan.svg")
        .next()
        .unwrap();
    let svg = std::fs::read_to_string(at.join(folder).join("plan.svg")).unwrap();
    assert!(svg.starts_with("<svg"));
    // The tightest limit comes first; each is within.
    let plan = document(at, &["plan", "paper:table7", "--json"]);
    let left: Vec<f64> = plan["verdict"]["margins"]
        .as_array()
        .unwrap()
        .iter()
        .map(|margin| margin["left_percent"].as_f64().unwrap())
        .collect();
    assert!(left.is_sorted() && left[0] > 0.0, "{left:?}");
    // A refused plan and a dry run leave no folder.
    let folders = || std::fs::read_dir(at.join("runs")).unwrap().count();
    let before = folders();
    let error = refused(at, &["plan", "paper:table7", "--z-mm", "-900"]);
    assert!(
        error.contains("cable") || error.contains("limit"),
        "{error}"
    );
    good(at, &["plan", "paper:table7", "--dry-run"]);
    assert_eq!(folders(), before);
}

/// Module files that differ in what commissioning measures.
fn module(at: &Path, name: &str, numbers: &str, zero_v: f64) {
    let kind = include_str!("../../robots/modules/fast-27.toml");
    let kind = kind.replace(
        "tension_zero_v = 0.2355",
        &format!("tension_zero_v = {zero_v}"),
    );
    std::fs::write(at.join("modules").join(name), format!("{numbers}{kind}")).unwrap();
}

const SQUARE: [&str; 6] = ["--frame-mm", "2000", "2000", "1500", "--mass-kg", "3"];

#[test]
fn modules_of_four_cables_keep_their_constants_in_a_robot_of_eight() {
    let folder = Folder::new("compose");
    let at = folder.path();
    std::fs::create_dir(at.join("modules")).unwrap();
    for index in 1..=4_u8 {
        let numbers = format!("id = {index}\nnode = {}\nencoder_sign = -1\n", index + 4);
        module(
            at,
            &format!("w{index}.toml"),
            &numbers,
            0.2 + 0.005 * f64::from(index),
        );
    }
    let compose = |file: &str, more: &[&str]| {
        let words = ["config", "compose", file, "--modules", "modules"];
        good(at, &[&words, &SQUARE[..], more].concat())
    };
    let said = compose("four.toml", &["--camera"]);
    assert!(said.contains("cable 4: w4.toml"), "{said}");
    assert!(said.contains("verdict: it can work"), "{said}");
    assert!(said.contains("mcdpr calibrate frame"), "{said}");
    let shown = |file: &str| document(at, &["config", "show", file, "--json"]);
    let four = shown("four.toml");
    // Four more; these have no numbers yet.
    for index in 5..=8_u8 {
        module(at, &format!("x{index}.toml"), "", 0.23);
    }
    let size = ["--cables", "8", "--platform-mm", "400", "400", "200"];
    compose("eight.toml", &size);
    let eight = shown("eight.toml");
    let winches = |robot: &Value| robot["winches"].as_array().unwrap().clone();
    let (before, after) = (winches(&four), winches(&eight));
    assert_eq!((before.len(), after.len()), (4, 8));
    assert_eq!(before[..], after[..4], "the old modules are what they were");
    for key in ["id", "node"] {
        let mut numbers: Vec<_> = after.iter().map(|winch| winch[key].as_u64()).collect();
        numbers.sort_unstable();
        numbers.dedup();
        assert_eq!(numbers.len(), 8, "{key}");
    }
    // The robot is one as any other: checked, and run.
    let checked = document(at, &["config", "check", "eight.toml", "--json"]);
    assert_eq!(checked["physics"]["problems"], serde_json::json!([]));
    let run = document(at, &["run", "fitting", "--robot", "eight.toml", "--json"]);
    let worst_mm = run["path_error_m"]["max"].as_f64().map(|m| m * 1e3);
    assert!(worst_mm.is_some_and(|mm| mm < 8.0), "{run}");
    // A module that is calibrated anew changes both robots.
    module(
        at,
        "w2.toml",
        "id = 2\nnode = 6\nencoder_sign = -1\n",
        0.225,
    );
    for robot in [shown("four.toml"), shown("eight.toml")] {
        assert_eq!(robot["winches"][1]["tension_zero_v"], 0.225);
    }
}

#[test]
fn modules_that_do_not_fit_are_refused_with_file_and_key() {
    let folder = Folder::new("compose-bad");
    let at = folder.path();
    std::fs::create_dir_all(at.join("modules/sub")).unwrap();
    std::fs::create_dir(at.join("robots")).unwrap();
    for index in 1..=4_u8 {
        module(
            at,
            &format!("w{index}.toml"),
            &format!("id = {index}\n"),
            0.2355,
        );
    }
    let tried = |file: &str, more: &[&str]| {
        let words = ["config", "compose", file, "--modules", "modules"];
        let said = refused(at, &[&words, &SQUARE[..], more].concat());
        assert!(!at.join(file).exists(), "{more:?}");
        said
    };
    let has = |said: String, parts: &[&str]| {
        for part in parts {
            assert!(said.contains(part), "{part}: {said}");
        }
    };
    let named = |names: &[&'static str]| -> Vec<&'static str> {
        names.iter().flat_map(|name| ["--module", name]).collect()
    };
    has(
        tried("r.toml", &["--cables", "8"]),
        &["cable 5 has no module", "8 cables"],
    );
    has(
        tried("r.toml", &named(&["w1", "w2", "w2", "w3"])),
        &["w2", "named twice"],
    );
    has(
        tried("r.toml", &named(&["w1", "w2", "w9", "w3"])),
        &["w9", "no such file", "w4.toml"],
    );
    has(
        tried("r.toml", &named(&["w1", "w2", "w3"])),
        &["cable 4 has no module"],
    );
    has(tried("r.toml", &["--winch", "fast-27"]), &["--winch"]);
    has(tried("robots/r.toml", &[]), &["beside", "folder"]);
    module(at, "w5.toml", "id = 5\n", 0.2355);
    has(
        tried("r.toml", &[]),
        &["w5.toml has no cable", "--module NAME"],
    );
    // Two with the same number of the winch, or of the drive.
    module(at, "w5.toml", "id = 3\n", 0.2355);
    has(
        tried("r.toml", &named(&["w1", "w2", "w3", "w5"])),
        &["w5.toml: `id` 3 is already that of w3.toml"],
    );
    module(at, "w5.toml", "id = 5\nnode = 7\n", 0.2355);
    module(at, "w4.toml", "id = 4\nnode = 7\n", 0.2355);
    has(
        tried("r.toml", &named(&["w1", "w2", "w4", "w5"])),
        &["w5.toml: `node` 7 is already that of w4.toml"],
    );
    for (text, part) in [
        ("", "no key of a winch"),
        ("[[cable]]\nanchor_mm = [0, 0, 0]\n", "unknown key `cable`"),
        ("name = \"a robot\"\n", "unknown key `name`"),
        ("friction_n = \"much\"\n", "friction_n"),
        ("no TOML", "is not a module file"),
    ] {
        std::fs::write(at.join("modules/w4.toml"), text).unwrap();
        has(
            tried("r.toml", &named(&["w1", "w2", "w3", "w4"])),
            &["w4.toml", part],
        );
    }
}

#[test]
fn brakes_that_hold_less_than_the_tensions_allowed_are_told_and_keep_plans_short() {
    let folder = Folder::new("weak-brakes");
    let at = folder.path();
    let copy = ["config", "init", "strong.toml", "--copy"];
    good(at, &[&copy[..], &["--robot", "eight-cable"]].concat());
    let text = std::fs::read_to_string(at.join("strong.toml")).unwrap();
    let weak = text.replace("brake_holding_n = 300", "brake_holding_n = 120");
    assert_ne!(text, weak);
    std::fs::write(at.join("weak.toml"), weak).unwrap();
    let told = "holds 120 N and passes its test up to 71 N";
    let share = |said: &str| {
        let line = said.lines().find(|line| line.starts_with("work space"));
        let digits: String = line.unwrap().chars().filter(char::is_ascii_digit).collect();
        digits.parse::<u32>().unwrap()
    };
    let [strong, weak] =
        ["strong.toml", "weak.toml"].map(|file| good(at, &["config", "check", file]));
    assert!(
        weak.contains(told) && !strong.contains("brakes:"),
        "{weak}\n{strong}"
    );
    assert!(share(&weak) < share(&strong), "{weak}\n{strong}");
}
