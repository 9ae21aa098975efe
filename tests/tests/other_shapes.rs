//! The program with robots of other shapes than the paper's: what docs/robot-file.md says works, works,
//! and what it says is refused is refused before anything is written.

use mcdpr_tests::mcdpr;
use mcdpr_tests::process::Folder;
use serde_json::Value;
use std::path::Path;
use std::process::Output;

fn run(robot: &str, words: &[&str], folder: &Path) -> Output {
    mcdpr()
        .args(words)
        .args(["--robot", robot])
        .current_dir(folder)
        .output()
        .unwrap()
}

fn words(output: &Output) -> String {
    let text = [&output.stdout[..], &output.stderr[..]].concat();
    String::from_utf8_lossy(&text).into_owned()
}

#[test]
fn what_such_a_robot_cannot_do_is_refused_by_name_and_leaves_no_files() {
    let folder = Folder::new("other-shapes-refused");
    let hanging = ["recover", "study power", "study demo"];
    let turning = [
        "calibrate collect",
        "home --tag",
        "estimate",
        "study iso9283",
    ];
    let of_six = ["eight-cable", "eight-suspended"].map(|robot| (robot, "hanging", &hanging[..]));
    let in_plane =
        ["planar-vertical"].map(|robot| (robot, "in_plane", &["pick", "pick --scenes 1"][..]));
    // A load on one point turns freely; a platform in a plane does not.
    let turning = ["planar-four", "three-point"].map(|robot| (robot, "turning", &turning[..]));
    for (robot, code, lines) in of_six.into_iter().chain(in_plane).chain(turning) {
        for line in lines {
            let line: Vec<&str> = line.split(' ').collect();
            let done = run(robot, &line, folder.path());
            let said = words(&done);
            assert_eq!(done.status.code(), Some(1), "{robot} {line:?}: {said}");
            let code = format!("mcdpr::plan::{code}");
            assert!(said.contains(&code), "{robot} {line:?}: {said}");
            let guide = if code.ends_with("turning") {
                "docs/calibration.md"
            } else {
                "docs/robot-file.md"
            };
            assert!(said.contains(guide), "{robot} {line:?}: {said}");
            let left = std::fs::read_dir(folder.path()).unwrap().count();
            assert_eq!(left, 0, "{robot} {line:?} left a file");
        }
    }
}

#[test]
fn every_shape_is_rigged() {
    let folder = Folder::new("other-shapes-rigged");
    for robot in [
        "planar-four",
        "three-point",
        "planar-vertical",
        "six-cable",
        "eight-cable",
        "eight-suspended",
        "point-anchor",
        // Its tension-held drum has no gear; while it is rigged the geared ones are held by tension, too.
        "lab-direct",
    ] {
        for way in ["tension", "lower"] {
            let done = run(robot, &["rig", way, "--yes"], folder.path());
            assert!(done.status.success(), "{robot} {way}: {}", words(&done));
        }
    }
    for robot in ["eight-two-boards", "eight-three-boards"] {
        let several = run(robot, &["rig", "lower", "--yes"], folder.path());
        assert_eq!(several.status.code(), Some(1));
        assert!(words(&several).contains("one board at a time"));
    }
}

#[test]
fn they_move_jog_and_are_homed_at_a_place() {
    let folder = Folder::new("other-shapes-moves");
    for (robot, lines) in [
        (
            "eight-cable",
            [
                "move 50 -30 720",
                "jog 10 0 5 --for 1",
                "home --at 20 0 700",
            ],
        ),
        (
            "planar-vertical",
            ["move 30 0 670", "jog 10 0 5 --for 1", "home --at 20 0 650"],
        ),
    ] {
        for line in lines {
            let line: Vec<&str> = line.split(' ').collect();
            let done = run(robot, &line, folder.path());
            assert!(done.status.success(), "{robot} {line:?}: {}", words(&done));
        }
    }
    // A place outside of the work space is refused, with the limit.
    let done = run("eight-cable", &["move", "0", "0", "20"], folder.path());
    let said = words(&done);
    assert_eq!(done.status.code(), Some(1), "{said}");
    assert!(said.contains("limits.box_mm"), "{said}");
}

#[test]
fn the_record_of_such_a_run_replays_and_is_reported() {
    let folder = Folder::new("other-shapes-record");
    let done = run("three-point", &["demo", "--record", "here"], folder.path());
    assert!(done.status.success(), "{}", words(&done));
    let done = run("three-point", &["replay", "here"], folder.path());
    let said = words(&done);
    assert!(done.status.success(), "{said}");
    assert!(said.contains("answered the same"), "{said}");
    let done = run("three-point", &["report", "here"], folder.path());
    assert!(done.status.success(), "{}", words(&done));
    assert!(folder.path().join("here/report.html").is_file());
}

#[test]
fn a_platform_in_a_plane_is_homed_by_tags_estimated_checked_and_tested() {
    let folder = Folder::new("other-shapes-plane");
    let on = |line: &str| {
        let line: Vec<&str> = line.split(' ').collect();
        let done = run(
            "planar-vertical",
            &[&line[..], &["--json"]].concat(),
            folder.path(),
        );
        assert!(done.status.success(), "{line:?}: {}", words(&done));
        serde_json::from_slice::<Value>(&done.stdout).unwrap()
    };
    // A machine as built; its calibration lies beside the robot afterwards.
    on("calibrate all --target board --poses 12 --candidates 80 --seed 3");
    let numbers = |value: &Value| -> Vec<f64> { serde_json::from_value(value.clone()).unwrap() };
    // The simulated tags are where the program has them: the machine hangs at the home of its description.
    let seen_m = numbers(&on("home --tag")["tool_m"]);
    assert!(
        seen_m[0].abs() < 1e-3 && (seen_m[2] - 0.65).abs() < 1e-3,
        "{seen_m:?}"
    );
    // The lengths are those of the calibration, in its own frame.
    let file = on("estimate");
    assert!(file["slip_cable"].is_null(), "{file}");
    assert!(file["redundancy"].as_f64().unwrap() < 3.0, "{file}");
    let said_m = numbers(&file["tool_m"]);
    assert!(
        said_m[0].abs() < 8e-3 && (said_m[2] - 0.65).abs() < 8e-3,
        "{said_m:?}"
    );
    // Across the plane it knows less, and says so.
    let sigma_m = numbers(&file["sigma_m"]);
    assert!(sigma_m[1] > 3.0 * sigma_m[0].max(sigma_m[2]), "{sigma_m:?}");
    let checked = on("calibrate check --places 4");
    assert_eq!(checked["holds"], true, "{checked}");
    assert_eq!(checked["places"].as_array().unwrap().len(), 4, "{checked}");
    let tested = on("study iso9283 --seeds 1 --cycles 2");
    assert_eq!(tested["square_in_plane"], true, "{tested}");
    let accuracy_mm = tested["figures"]["pose_accuracy_mm"]["median"]
        .as_f64()
        .unwrap();
    assert!((0.01..5.0).contains(&accuracy_mm), "{tested}");
    // The firmware's own file, through the same link.
    let firmware = mcdpr_tests::chip::path();
    let on_chip = on(&format!(
        "estimate --on chip --firmware {}",
        firmware.display()
    ));
    let there_m = numbers(&on_chip["tool_m"]);
    for axis in [0, 2] {
        assert!(
            (there_m[axis] - said_m[axis]).abs() < 1e-3,
            "{there_m:?} {said_m:?}"
        );
    }
}
