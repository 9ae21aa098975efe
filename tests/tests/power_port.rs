//! A loss of power in real processes over a pseudo-terminal: the interrupted run, what `doctor` says,
//! the recovery by the journal on the disk, and the rest of the task.
#![cfg(target_os = "linux")]

use mcdpr_tests::mcdpr;
use mcdpr_tests::process::{Folder, Simulator, alone};
use serde_json::Value;
use std::process::Output;

/// A busy machine has 200 ms before the board misses its host.
const SCALE: &str = "0.5";

struct Scene {
    simulator: Simulator,
    folder: Folder,
}

impl Scene {
    fn mcdpr(&self, words: &[&str]) -> Output {
        let state = self.folder.path().join("state");
        let mut command = mcdpr();
        command.env("XDG_STATE_HOME", state).args(words);
        command.args(["--on", &self.simulator.port, "--time-scale", SCALE]);
        command.current_dir(self.folder.path()).output().unwrap()
    }

    fn task(&self, name: &str, to_mm: [f64; 3]) -> String {
        let path = self.folder.path().join(name);
        let [x, y, z] = to_mm;
        let text = format!(
            "start_mm = [255, -105, -180]\n[[leg]]\nto_mm = [{x}, {y}, {z}]\nspeed_mm_s = 20\n"
        );
        std::fs::write(&path, text).unwrap();
        path.display().to_string()
    }

    fn finding(&self, part: &str) -> Option<Value> {
        let output = self.mcdpr(&["doctor", "--json"]);
        let document: Value = serde_json::from_slice(&output.stdout).unwrap();
        let findings = document["findings"].as_array().unwrap();
        findings
            .iter()
            .find(|finding| finding["part"] == part)
            .cloned()
    }
}

fn words(output: &Output) -> String {
    let out = String::from_utf8_lossy(&output.stdout);
    let errors = String::from_utf8_lossy(&output.stderr);
    // Messages are wrapped to the terminal's width.
    let both = format!("{out} {errors}");
    both.replace(['\u{2502}', '\n'], " ")
        .split_whitespace()
        .collect::<Vec<_>>()
        .join(" ")
}

#[test]
fn p1_a_board_that_lost_power_is_recovered_by_the_journal_and_the_task_continues() {
    let _alone = alone();
    let scene = Scene {
        simulator: Simulator::start_with(SCALE, &["--fault", "power:board@1.5s/1s"]),
        folder: Folder::new("power-port"),
    };
    let task = scene.task("way.toml", [305.0, -75.0, -190.0]);
    // Before anything was interrupted there is nothing to continue.
    let early = scene.mcdpr(&["run", &task, "--resume"]);
    assert_eq!(early.status.code(), Some(1), "{}", words(&early));
    assert!(
        words(&early).contains("no journal was kept"),
        "{}",
        words(&early)
    );

    let cut = scene.mcdpr(&["run", &task]);
    assert!(!cut.status.success(), "{}", words(&cut));
    let power = scene
        .finding("power")
        .expect("a board without lengths, and a journal");
    let found = power["found"].as_str().unwrap();
    assert!(found.contains("the board lost its lengths"), "{found}");
    assert!(found.contains("at path time 1."), "{found}");
    assert!(power["remedy"].as_str().unwrap().contains("mcdpr recover"));

    let unconfirmed = scene.mcdpr(&["recover"]);
    assert_eq!(
        unconfirmed.status.code(),
        Some(1),
        "{}",
        words(&unconfirmed)
    );
    assert!(
        words(&unconfirmed).contains("--untouched"),
        "{}",
        words(&unconfirmed)
    );
    let recovered = scene.mcdpr(&["recover", "--untouched", "--json"]);
    assert!(recovered.status.success(), "{}", words(&recovered));
    let verdict: Value = serde_json::from_slice(&recovered.stdout).unwrap();
    assert!(verdict["bound_mm"].as_f64().unwrap() < 5.0, "{verdict}");
    assert!(scene.finding("power").is_none());

    let other = scene.task("other.toml", [265.0, -75.0, -190.0]);
    let other = scene.mcdpr(&["run", &other, "--resume"]);
    assert_eq!(other.status.code(), Some(1), "{}", words(&other));
    assert!(
        words(&other).contains("another version of"),
        "{}",
        words(&other)
    );

    let rest = scene.mcdpr(&["run", &task, "--resume", "--json"]);
    assert!(rest.status.success(), "{}", words(&rest));
    let document: Value = serde_json::from_slice(&rest.stdout).unwrap();
    // The whole task takes 3.6 s.
    let rest_s = document["duration_s"].as_f64().unwrap();
    assert!((0.5..3.2).contains(&rest_s), "{document}");
    let again = scene.mcdpr(&["run", &task, "--resume"]);
    assert_eq!(again.status.code(), Some(1), "{}", words(&again));
    assert!(
        words(&again).contains("reached its end"),
        "{}",
        words(&again)
    );
}

#[test]
fn p1_a_computers_supply_is_not_simulated_behind_a_pseudo_terminal() {
    let out = mcdpr()
        .args(["sim", "--pty", "--fault", "power:all@1s/1s"])
        .output()
        .unwrap();
    assert_eq!(out.status.code(), Some(1));
    assert!(words(&out).contains("power:board"), "{}", words(&out));
}
