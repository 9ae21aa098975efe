//! The commands that look at runs and at the robot file, as their user calls them.

use mcdpr_tests::mcdpr;
use mcdpr_tests::process::{Folder, breathe};
use serde_json::Value;
use std::path::Path;
use std::process::Output;

fn call(folder: &Path, arguments: &[&str]) -> Output {
    mcdpr()
        .args(arguments)
        .current_dir(folder)
        .output()
        .unwrap()
}

fn good(folder: &Path, arguments: &[&str]) -> String {
    let output = call(folder, arguments);
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{arguments:?}: {message}");
    String::from_utf8(output.stdout).unwrap()
}

/// Message and exit code of a command that is refused, on one line.
fn refused(folder: &Path, arguments: &[&str]) -> (String, i32) {
    let output = call(folder, arguments);
    assert!(!output.status.success(), "{arguments:?} was not refused");
    let message = String::from_utf8_lossy(&output.stderr).replace('│', " ");
    let message = message.split_whitespace().collect::<Vec<_>>().join(" ");
    (message, output.status.code().unwrap())
}

const TASK: &str = "start_mm = [255, -105, -180]\n[[leg]]\nto_mm = [275, -85, -180]\n";

#[test]
fn a_run_is_reported_compared_and_exported() {
    let folder = Folder::new("seeing-run");
    let at = folder.path();
    std::fs::write(at.join("short.toml"), TASK).unwrap();
    good(at, &["run", "short.toml", "--record", "one"]);
    good(at, &["run", "short.toml", "--ideal", "--record", "two"]);
    let text = good(at, &["report", "one"]);
    assert!(
        !text.contains("FAIL") && text.contains("report.html"),
        "{text}"
    );
    let page = std::fs::read_to_string(at.join("one/report.html")).unwrap();
    for what in [
        "Cable lengths",
        "Cable tensions",
        "Path in space",
        "Verdicts",
        "state Moving",
    ] {
        assert!(page.contains(what), "{what}");
    }
    // It stands alone: nothing is loaded from elsewhere.
    assert!(!page.contains("src=") && !page.contains("href=") && !page.contains("url("));
    assert!(!page.contains("NaN"), "a number is missing");
    let json: Value = serde_json::from_str(&good(at, &["report", "one", "--json"])).unwrap();
    let worse = json["judgement"]["path_error_m"]["mean"].as_f64().unwrap();
    let compared = good(at, &["compare", "one", "two", "--json"]);
    let compared: Value = serde_json::from_str(&compared).unwrap();
    let better = compared["second"]["path_error_m"]["mean"].as_f64().unwrap();
    assert!(better < worse, "as described {better}, realistic {worse}");
    assert!(at.join("one/compare.html").is_file());
    good(at, &["export", "one", "--csv", "--out", "tables"]);
    let cables = std::fs::read_to_string(at.join("tables/cables.csv")).unwrap();
    let head: Vec<_> = cables.lines().next().unwrap().split(',').collect();
    assert_eq!(head.len(), 2 + 5 * 4);
    assert!(
        cables
            .lines()
            .all(|line| line.split(',').count() == head.len())
    );
    assert!(cables.lines().count() > 1000);
    // A corrupt record is reported and used as far as it goes; a cut one, too.
    let record = at.join("one/run.mcap");
    let bytes = std::fs::read(&record).unwrap();
    std::fs::write(&record, &bytes[..bytes.len() / 2]).unwrap();
    let output = call(at, &["report", "one"]);
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(
        output.status.success() && message.contains("cut short"),
        "{message}"
    );
    assert!(String::from_utf8_lossy(&output.stdout).contains("FAIL"));
    std::fs::write(&record, b"not a record").unwrap();
    let (message, code) = refused(at, &["replay", "one"]);
    assert!(
        code == 1 && message.contains("not an MCAP file"),
        "{message}"
    );
    let (message, _) = refused(at, &["report", "nowhere"]);
    assert!(
        message.contains("nowhere") && message.contains("name a run's folder"),
        "{message}"
    );
}

#[test]
fn what_a_run_was_planned_with_and_single_orders_replay_too() {
    let folder = Folder::new("seeing-options");
    let at = folder.path();
    std::fs::write(at.join("short.toml"), TASK).unwrap();
    let proof = |name: &str| -> Value {
        serde_json::from_str(&good(at, &["replay", name, "--json"])).unwrap()
    };
    // Shaper and tension rule are part of what was run.
    let options = ["--shaping", "zv", "--tensioning", "setpoint"];
    let mut shaped = vec!["run", "short.toml", "--record", "shaped"];
    shaped.extend(options);
    good(at, &shaped);
    let shaped = proof("shaped");
    assert!(shaped["host_bytes"].as_u64().unwrap() > 1000, "{shaped}");
    assert!(shaped["core_bytes"].as_u64().unwrap() > 10_000, "{shaped}");
    // A replay of single orders runs the core again, not the program that gave them.
    good(at, &["move", "275", "-85", "-180", "--record", "moved"]);
    let moved = proof("moved");
    assert!(moved["host_bytes"].is_null(), "{moved}");
    assert!(moved["core_bytes"].as_u64().unwrap() > 10_000, "{moved}");
    let text = good(at, &["report", "moved"]);
    assert!(!text.contains("FAIL"), "{text}");
}

#[test]
#[cfg(unix)]
fn a_killed_run_is_readable_up_to_the_last_second_and_a_size_limit_ends_only_the_record() {
    use std::time::{Duration, Instant};
    let folder = Folder::new("seeing-killed");
    let at = folder.path();
    let mut run = mcdpr()
        .args([
            "run",
            "paper:table7",
            "--time-scale",
            "1",
            "--record",
            "killed",
        ])
        .current_dir(at)
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::null())
        .spawn()
        .unwrap();
    // The record exists once the run has begun, in simulated time that keeps the wall's.
    let file = at.join("killed/run.mcap");
    let give_up = Instant::now() + Duration::from_secs(60);
    let mut began = None;
    let holds = |bytes| std::fs::metadata(&file).is_ok_and(|about| about.len() > bytes);
    while !holds(400_000) {
        assert!(Instant::now() < give_up, "the record does not grow");
        if holds(0) {
            began.get_or_insert_with(Instant::now);
        }
        breathe();
    }
    let began = began.unwrap();
    let ran_s = began.elapsed().as_secs_f64();
    run.kill().unwrap();
    run.wait().unwrap();
    let report: Value = serde_json::from_str(&good(at, &["report", "killed", "--json"])).unwrap();
    let recorded_s = report["judgement"]["duration_s"].as_f64().unwrap();
    // A second may be missing at the end; a slow start of the program, too.
    assert!(
        recorded_s > ran_s - 2.0,
        "{recorded_s} s of {ran_s} s are there"
    );
    good(at, &["replay", "killed"]);
    // A limit on the size of files is met in the middle of the motion, which goes on.
    std::fs::write(at.join("short.toml"), TASK).unwrap();
    let output = std::process::Command::new("sh")
        .args([
            "-c",
            "ulimit -f 300; exec \"$MCDPR\" run short.toml --record limited",
        ])
        .env("MCDPR", mcdpr().get_program())
        .current_dir(at)
        .output()
        .unwrap();
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{message}");
    assert!(message.contains("it ends early"), "{message}");
    assert!(String::from_utf8_lossy(&output.stdout).contains("path error"));
}

#[test]
fn a_robot_file_is_begun_checked_and_shown() {
    let folder = Folder::new("seeing-config");
    let at = folder.path();
    good(at, &["config", "init", "mine.toml"]);
    let checked: Value =
        serde_json::from_str(&good(at, &["config", "check", "mine.toml", "--json"])).unwrap();
    assert_eq!(checked["cables"], 4);
    let text = std::fs::read_to_string(at.join("mine.toml")).unwrap();
    assert!(text.contains('#'), "the file has no comments");
    let (message, code) = refused(at, &["config", "init", "mine.toml"]);
    assert!(code == 1 && message.contains("not touched"), "{message}");
    std::fs::write(at.join("mine.toml"), text + "\n[platfrom]\n").unwrap();
    let (message, _) = refused(at, &["config", "check", "mine.toml"]);
    assert!(
        message.contains("platfrom") && message.contains("platform"),
        "{message}"
    );
    let shown: Value = serde_json::from_str(&good(at, &["config", "show"])).unwrap();
    assert_eq!(shown["cables"].as_array().unwrap().len(), 4);
}

#[test]
fn the_schema_accepts_every_key_of_every_robot_and_no_other() {
    let folder = Folder::new("seeing-schema");
    let schema: Value = serde_json::from_str(&good(folder.path(), &["config", "schema"])).unwrap();
    let keys = |value: &Value| -> Vec<String> {
        value["properties"]
            .as_object()
            .unwrap()
            .keys()
            .cloned()
            .collect()
    };
    assert_eq!(schema["additionalProperties"], false);
    let robots = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots");
    let mut seen = 0;
    for entry in std::fs::read_dir(robots).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|end| end != "toml") {
            continue;
        }
        // Sections and keys, line by line: enough for these files.
        let mut section = String::new();
        for line in std::fs::read_to_string(&path).unwrap().lines() {
            let line = line.split('#').next().unwrap().trim();
            if line.starts_with('[') && line.ends_with(']') && !line.contains('=') {
                section = line.trim_matches(['[', ']']).to_owned();
            } else if let Some((key, _)) = line.split_once(" = ") {
                let mut table = &schema;
                for part in section.split('.').filter(|part| !part.is_empty()) {
                    table = &table["properties"][part];
                    if table["type"] == "array" {
                        table = &table["items"];
                    }
                }
                assert!(
                    keys(table).iter().any(|known| known == key.trim()),
                    "{}: {section}.{key} is not in the schema",
                    path.display()
                );
                seen += 1;
            }
        }
    }
    assert!(seen > 60, "only {seen} keys were found");
}

#[test]
fn help_completions_and_manual_name_every_command() {
    let folder = Folder::new("seeing-help");
    let help = good(folder.path(), &["--help"]);
    let place = |what: &str| {
        let line = format!("\n  {what} ");
        help.find(&line)
            .unwrap_or_else(|| panic!("{what} is not in --help"))
    };
    let way = [
        "ports",
        "doctor",
        "config",
        "calibrate",
        "run",
        "serve",
        "report",
        "reproduce",
        "ik",
        "sim",
    ];
    for pair in way.windows(2) {
        assert!(
            place(pair[0]) < place(pair[1]),
            "{} comes after {}",
            pair[0],
            pair[1]
        );
    }
    assert!(help.contains("Exit codes"), "{help}");
    let script = good(folder.path(), &["completions", "bash"]);
    let manual = good(folder.path(), &["man"]);
    for what in way {
        assert!(script.contains(what), "{what} is not completed");
        assert!(manual.contains(what), "{what} is not in the manual");
    }
    good(folder.path(), &["man", "--out", "man"]);
    assert!(folder.path().join("man/mcdpr.1").is_file());
    // Without a terminal there are no colours.
    let output = call(folder.path(), &["replay", "nowhere"]);
    assert!(!output.stderr.contains(&0x1b) && !output.stdout.contains(&0x1b));
}

#[test]
fn reproduce_prints_the_papers_numbers_beside_ours() {
    let folder = Folder::new("seeing-reproduce");
    let only = "hardware-calibration,circle,tension-static";
    let text = good(
        folder.path(),
        &[
            "reproduce",
            "--only",
            only,
            "--seeds",
            "1",
            "--record",
            "out",
            "--json",
        ],
    );
    let document: Value = serde_json::from_str(&text).unwrap();
    let experiments = document["experiments"].as_array().unwrap();
    assert_eq!(experiments.len(), 3);
    let circle = experiments.iter().find(|e| e["id"] == "circle").unwrap();
    let row = &circle["rows"][0];
    assert_eq!(row["paper"], "3.425 / 7.044");
    assert_eq!(row["origin"], "Hardware");
    let first = |cell: &Value| -> f64 {
        cell.as_str()
            .unwrap()
            .split(" / ")
            .next()
            .unwrap()
            .parse()
            .unwrap()
    };
    let (ideal, real) = (first(&row["as_described"]), first(&row["realistic"]));
    assert!(ideal < real && real < 1.0, "{row}");
    let hold = experiments
        .iter()
        .find(|e| e["id"] == "tension-static")
        .unwrap();
    assert!(first(&hold["rows"][0]["realistic"]) < 0.2, "{hold}");
    let page = std::fs::read_to_string(folder.path().join("out/report.html")).unwrap();
    assert!(page.contains("Figure 32") && page.contains("What is not reproduced"));
    let (message, _) = refused(folder.path(), &["reproduce", "--only", "table9"]);
    assert!(
        message.contains("table9") && message.contains("circle"),
        "{message}"
    );
}

#[test]
fn a_grasp_cycle_is_where_it_should_be_and_a_knock_is_answered_as_fast_as_the_papers() {
    use mcdpr::reproduce::{Bench, reproduce};
    let bench = Bench {
        seed: 1,
        seeds: 1,
        firmware: None,
    };
    let only = ["grasp-cycle", "tension-disturbed"].map(str::to_owned);
    let outcomes = reproduce(&bench, &only, |_, _, _| {}).unwrap();
    let [cycle, knock] = outcomes.as_slice() else {
        panic!("two experiments");
    };
    let numbers = |cell: &str| -> Vec<f64> {
        cell.split(" / ")
            .filter_map(|n| n.split(' ').next()?.parse().ok())
            .collect()
    };
    // The tool is where the grasp is, and further off without a calibration.
    let calibrated = numbers(&cycle.rows[0].realistic);
    assert!(calibrated.iter().all(|off| *off < 1.5), "{calibrated:?}");
    let assembled = &cycle.rows[1].realistic;
    assert!(
        assembled.starts_with("all of") || numbers(assembled)[0] > calibrated[0],
        "{assembled}"
    );
    assert!(cycle.charts.len() == 5 && cycle.charts.iter().all(|c| !c.is_empty()));
    // Back in the band of 0.5 N within a second, with the geared winch, too.
    for row in [&knock.rows[0], &knock.rows[2]] {
        let back = numbers(&row.realistic);
        assert!(back.len() == 2 && back[1] < 1.0, "{row:?}");
    }
}
