//! Bad input, alone and in batches, and what a batch promises to the program that feeds it.

use super::{answer, refusal, run, text};
use mcdpr_tests::mcdpr;
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Write};
use std::process::Stdio;
use std::time::Duration;

#[test]
fn bad_input_is_refused_with_what_and_where() {
    let cases: &[(&[&str], &str)] = &[
        (&["ik", "nan", "0", "0"], "`nan` is not a length"),
        (&["ik", "1", "2", "3deg"], "`deg` is not a unit of a length"),
        (&["ik", "300", "0", "-200", "5"], "3 angles needed"),
        // The attachment of cable 1 in the middle of its pulley: see the robot file.
        (&["ik", "80", "-305", "24"], "cable 1"),
        (&["fk", "400", "400", "400"], "4 needed"),
        (
            &["fk", "400", "400", "400", "-400"],
            "cable 4: the length must be positive",
        ),
        (&["fk", "400", "400", "400", "900"], "misses the lengths"),
        (
            &["fk", "400", "400", "400", "400", "--free", "all"],
            "six are needed",
        ),
        (&["fk", "400", "400", "400", "--static"], "4"),
        (
            &[
                "fk",
                "400",
                "400",
                "400",
                "400",
                "--static",
                "--tension",
                "4=10",
            ],
            "cable 4: both",
        ),
        (
            &["fk", "400", "_", "400", "400", "--static"],
            "cable 2: neither",
        ),
        (
            &["fk", "400", "400", "400", "--static", "--tension", "9=10"],
            "cables 1 to 4",
        ),
        (
            &[
                "fk",
                "400",
                "400",
                "--static",
                "--tension",
                "4=1",
                "--tension",
                "4=2",
            ],
            "twice",
        ),
        (&["statics", "0", "0", "100"], "cannot push"),
        (
            &["statics", "300", "0", "-200", "--tension", "4:10"],
            "CABLE=FORCE",
        ),
        (
            &[
                "statics",
                "300",
                "0",
                "-200",
                "--tension",
                "3=5",
                "--tension",
                "4=5",
            ],
            "exactly three",
        ),
        (
            &["statics", "300", "0", "-200", "--attitude", "0", "0", "0"],
            "leave it out",
        ),
        (&["workspace", "--step", "0"], "--step"),
        (&["workspace", "--slice", "w=3"], "--slice w=3"),
        (&["workspace", "--clearance", "-1"], "must not be negative"),
        (
            &["ik", "1", "2", "3", "--robot", "no-such-robot"],
            "no-such-robot",
        ),
    ];
    for (words, part) in cases {
        let message = refusal(words);
        assert!(message.contains(part), "{words:?}: {message}");
    }
}

#[test]
fn a_planar_robot_says_what_it_can_not_do() {
    let robot = ["--robot", "planar-four"];
    let lengths = answer(&[&robot[..], &["ik", "100", "0", "600"]].concat());
    // Radius 10 mm at (-1000, 0, 1200): a point anchor there is within pi times the radius.
    let straight = f64::hypot(1.1, 0.6);
    assert!((lengths["lengths_m"][0].as_f64().unwrap() - straight).abs() < 0.0315);
    for words in [
        &["statics", "0", "0", "600"][..],
        &["fk", "1253", "1082", "1082", "1253"],
        &["fk", "1253", "1082", "1082", "1253", "--static"],
        &["workspace"],
    ] {
        let message = refusal(&[&robot[..], words].concat());
        assert!(
            message.contains("planar") && message.contains("mcdpr ik"),
            "{message}"
        );
    }
}

#[test]
fn a_batch_goes_on_after_bad_lines() {
    let good = r#"{"position_m":[0.33,0,-0.2],"attitude_rad":[0,0,0]}"#;
    let lines = [
        good,
        "{not json",
        r#"{"position_m":[0.33,0,-0.2],"attitude_deg":[0,0,0]}"#,
        r#"{"attitude_rad":[0,0,0]}"#,
        r#"{"position_m":[0.33,0]}"#,
        r#"{"position_m":[NaN,0,0]}"#,
        r#"{"position_m":[1e999,0,0]}"#,
        r#"{"position_m":[1e300,0,0]}"#,
        "",
        "[[0.33,0,-0.2],[0,0,0]]",
        good,
    ];
    let output = run(&["ik", "--batch"], &(lines.join("\n") + "\n"));
    assert_eq!(output.status.code(), Some(1));
    let results: Vec<Value> = text(&output.stdout)
        .lines()
        .map(|l| serde_json::from_str(l).unwrap())
        .collect();
    assert_eq!(results.len(), lines.len());
    for (index, result) in results.iter().enumerate() {
        if lines[index] == good {
            assert_eq!(result, &results[0]);
            assert_eq!(result["lengths_m"].as_array().unwrap().len(), 4);
        } else {
            assert_eq!(result["line"], json!(index + 1), "{result}");
            assert!(result["error"].is_string() && result.as_object().unwrap().len() == 2);
        }
    }
    assert!(
        results[2]["error"]
            .as_str()
            .unwrap()
            .contains("`attitude_deg`")
    );
    assert!(
        results[3]["error"]
            .as_str()
            .unwrap()
            .contains("`position_m`")
    );
    assert!(
        text(&output.stderr).contains("9 of 11 lines failed"),
        "{}",
        text(&output.stderr)
    );

    let lines = concat!(
        "{\"lengths_m\":[0.4,0.41,0.42],\"tensions_n\":{\"4\":10}}\n",
        "{\"lengths_m\":[0.4,0.41,0.42],\"tensions_n\":{\"7\":10}}\n",
        "{\"lengths_m\":[0.4,0.41,0.42],\"tensions_n\":{\"x\":10}}\n",
        "{\"lengths_m\":[0.4,0.41,0.42],\"tensions_n\":{\"4\":-10}}\n",
        "{\"lengths_m\":[0.4,0.41]}",
    );
    let output = run(&["fk", "--static", "--batch"], lines);
    let results: Vec<Value> = text(&output.stdout)
        .lines()
        .map(|l| serde_json::from_str(l).unwrap())
        .collect();
    let words = ["", "cable 7", "`x`", "cable 4", "2 given"];
    assert_eq!(results.len(), words.len());
    assert!(results[0].get("error").is_none());
    for (result, word) in results.iter().zip(words).skip(1) {
        assert!(result["error"].as_str().unwrap().contains(word), "{result}");
    }
}

#[test]
fn each_line_is_answered_before_the_next_is_asked() {
    let mut child = mcdpr()
        .args(["ik", "--batch"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut stdin = child.stdin.take().unwrap();
    let stdout = child.stdout.take().unwrap();
    let (sender, receiver) = std::sync::mpsc::channel();
    std::thread::spawn(move || {
        for line in BufReader::new(stdout).lines() {
            if sender.send(line.unwrap()).is_err() {
                return;
            }
        }
    });
    for _ in 0..3 {
        stdin
            .write_all(b"{\"position_m\":[0.33,0,-0.2]}\n")
            .unwrap();
        let line = receiver.recv_timeout(Duration::from_secs(30)).unwrap();
        assert!(line.starts_with("{\"lengths_m\":["), "{line}");
    }
    drop(stdin);
    assert!(child.wait().unwrap().success());
}
