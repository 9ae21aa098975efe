//! One robot on several boards behind a serial device each, driven by the real program.
#![cfg(target_os = "linux")]

use mcdpr_tests::mcdpr;
use mcdpr_tests::process::{Folder, Simulator};
use serde_json::Value;
use std::process::{Output, Stdio};

/// At this speed a busy machine has 0.6 s before a board counts as silent (60 ms), and 1 s before it misses its host.
const SCALE: &str = "0.1";

fn run(words: &[&str]) -> Output {
    let mut command = mcdpr();
    command.args(words).stdin(Stdio::null()).output().unwrap()
}

#[test]
fn a_task_runs_on_two_ports_and_a_wrong_number_of_ports_is_refused() {
    a_task_runs_on_its_ports("eight-two-boards", 2);
}

#[test]
fn a_task_runs_on_three_ports_and_a_wrong_number_of_ports_is_refused() {
    a_task_runs_on_its_ports("eight-three-boards", 3);
}

fn a_task_runs_on_its_ports(robot: &str, boards: usize) {
    let folder = Folder::new(robot);
    let task = folder.path().join("up.toml");
    let text = "start_mm = [0, 0, 700]\n[[leg]]\nto_mm = [40, 0, 720]\n";
    std::fs::write(&task, text).unwrap();
    let task = task.to_str().unwrap();
    let record = folder.path().join("run");
    let record = record.to_str().unwrap();
    let robot = ["--robot", robot];
    let simulator = Simulator::start_with(SCALE, &robot);
    let ports: Vec<&str> = simulator.port.split(',').collect();
    assert_eq!(ports.len(), boards, "{}", simulator.port);
    let on = |port: &str| {
        let words = ["run", task, "--on", port, "--time-scale", SCALE, "--json"];
        let rest = ["--record", record, robot[0], robot[1]];
        run(&[&words[..], &rest[..]].concat())
    };
    // One port too few, and one twice.
    let few = on(&ports[1..].join(","));
    let said = String::from_utf8_lossy(&few.stderr).into_owned();
    let named = said.contains(&format!("{boards} boards"));
    assert!(!few.status.success() && named, "{said}");
    let twice = format!("{},{}", ports[0], ports[..boards - 1].join(","));
    assert!(!on(&twice).status.success());
    let done = on(&simulator.port);
    let said = String::from_utf8_lossy(&done.stderr).into_owned();
    assert!(done.status.success(), "{said}");
    let document: Value = serde_json::from_slice(&done.stdout).unwrap();
    // All eight cables follow the plan, by their boards' own measurements.
    let lengths = document["cable_length_error_m"]["max"].as_f64().unwrap();
    println!("{}: length error {:.3} mm at most", robot[1], lengths * 1e3);
    assert!(lengths < 2e-3, "{lengths}");
}
