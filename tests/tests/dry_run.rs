//! `--dry-run` holds: every command of the program judges only, or refuses before anything
//! is connected. A new command fails this test until it does one of the two.
#![cfg(unix)]

use mcdpr::cli::{DRY_RUNS, DryRun, commands};
use mcdpr_tests::mcdpr;
use mcdpr_tests::process::Folder;
use std::process::{Output, Stdio};

/// A port that does not exist: a command that connects reports it.
const PORT: &str = "/nowhere/port";

/// What a command needs besides its own words.
const WORDS: &[(&str, &[&str])] = &[
    ("calibrate all", &["--data", "data.json"]),
    ("calibrate camera", &["--data", "data.json"]),
    ("calibrate frame", &["--data", "data.json"]),
    ("calibrate plan", &["--data", "data.json"]),
    ("calibrate study", &["--seeds", "1", "--poses", "8"]),
    ("calibrate tension", &["1", "--data", "readings.csv"]),
    ("calibrate verify", &["--poses", "poses.csv"]),
    ("calibrate winch", &["1"]),
    ("commission", &["1"]),
    ("compare", &["a-run", "b-run"]),
    ("completions", &["bash"]),
    ("config compose", &["new.toml", "--modules", "."]),
    ("config init", &["new.toml"]),
    ("emulate", &["--pty", "no-such-file"]),
    ("experiment", &["hold"]),
    ("export", &["--csv", "a-run"]),
    ("fk", &["320", "320", "320", "320"]),
    ("flash", &["no-such-file"]),
    ("gripper", &["close"]),
    ("ik", &["320", "0", "-200"]),
    ("jog", &["5", "0", "0"]),
    ("move", &["335", "0", "-160"]),
    ("plan", &["paper:table8"]),
    ("predict", &["--data", "data.json", "--train", "1"]),
    ("replay", &["a-run"]),
    ("report", &["a-run"]),
    ("model export", &["--to", "urdf", "--out", "robot.urdf"]),
    ("rig attach", &["1"]),
    ("rig spool", &["1", "10"]),
    ("run", &["paper:table8"]),
    ("sim", &["--pty"]),
    ("statics", &["320", "0", "-200"]),
    ("study real", &["data.json", "--train", "1"]),
    ("workspace", &["--step", "400"]),
];

/// Readings of a tension sensor: 10 N/V from 0.3 V on.
const READINGS: &str = "0,0.3\n1,1.28\n2,2.261\n";

fn dry(words: &str, port: &str, folder: &Folder) -> Output {
    let more = WORDS.iter().find(|(known, _)| *known == words);
    mcdpr()
        .current_dir(folder.path())
        .env("XDG_STATE_HOME", folder.path())
        .args(words.split(' '))
        .args(more.map_or(&[][..], |(_, more)| *more))
        .args(["--dry-run", "--on", port])
        .stdin(Stdio::null())
        .output()
        .unwrap()
}

#[test]
fn every_command_judges_only_or_refuses_before_it_connects() {
    for words in commands() {
        let rule = DRY_RUNS.iter().find(|(known, _)| *known == words);
        let Some((_, rule)) = rule else {
            panic!("{words}: neither honours --dry-run nor refuses it");
        };
        for port in [PORT, "sim"] {
            let folder = Folder::new(&format!("dry-{}", words.replace(' ', "-")));
            std::fs::write(folder.path().join("readings.csv"), READINGS).unwrap();
            let output = dry(&words, port, &folder);
            let said = String::from_utf8_lossy(&output.stderr).into_owned();
            assert_ne!(output.status.code(), Some(2), "{words}: {said}");
            let refused = said.contains("--dry-run: `mcdpr");
            match rule {
                DryRun::Refuses => {
                    assert!(
                        refused && output.status.code() == Some(1),
                        "{words}: {said}"
                    );
                }
                // They say that they only look, and cannot look at a port that is not there.
                DryRun::Looks => assert!(!refused, "{words}: {said}"),
                DryRun::Judges | DryRun::Computes => {
                    assert!(!refused, "{words}: {said}");
                    assert!(
                        !said.contains("there is no serial port"),
                        "{words} connects: {said}"
                    );
                }
            }
            if *rule != DryRun::Computes {
                let left: Vec<_> = std::fs::read_dir(folder.path())
                    .unwrap()
                    .map(|entry| entry.unwrap().file_name())
                    .filter(|name| name != "readings.csv")
                    .collect();
                assert!(left.is_empty(), "{words} on {port} writes {left:?}");
            }
        }
    }
}

/// Commands that judge do judge: a good thing passes, and what drives without data is refused.
#[test]
fn what_can_be_judged_is_judged_and_what_would_drive_is_refused() {
    let folder = Folder::new("dry-judged");
    std::fs::write(folder.path().join("readings.csv"), READINGS).unwrap();
    for words in [
        "calibrate tension",
        "experiment",
        "home",
        "jog",
        "move",
        "park",
        "run",
        "serve",
    ] {
        let output = dry(words, PORT, &folder);
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(0), "{words}: {said}");
    }
    for arguments in [
        &["doctor", "--arm"][..],
        &["calibrate", "all"],
        &["calibrate", "frame"],
        &["calibrate", "tension", "1"],
        &["pick", "--scenes", "2"],
    ] {
        let output = mcdpr()
            .current_dir(folder.path())
            .args(arguments)
            .args(["--dry-run", "--on", PORT])
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{arguments:?}: {said}");
        assert!(said.contains("cannot be judged"), "{arguments:?}: {said}");
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
}
