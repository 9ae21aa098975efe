//! Files that people write: any text gives an answer or an error that says where, never a panic.

use mcdpr::calibration::Data;
use mcdpr::calibration::simulate::{Setup, Target, simulate};
use mcdpr::motion::{Model, Task};
use mcdpr::scenario::{Injection, Scenario};
use std::path::{Path, PathBuf};

/// A robot file. One that is taken can be worked with; the message of a refusal can be shown.
pub fn robot_file(text: &str) -> bool {
    match mcdpr::robot::parse(text, Path::new("no-such-folder/robot.toml")) {
        Ok(robot) => {
            let _ = robot.content_hash();
            assert!(robot.platform.mass_kg.is_finite() && robot.platform.mass_kg > 0.0);
            for cable in &robot.cables {
                assert!(cable.anchor_in_world_m.iter().all(|m| m.is_finite()));
            }
            let _ = Model::new(&robot);
            true
        }
        Err(error) => {
            assert!(!error.to_string().is_empty());
            let report = miette::Report::new(error);
            assert!(!format!("{report:?}").is_empty());
            false
        }
    }
}

/// A task file.
pub fn task_file(text: &str) -> bool {
    task(Task::parse(text, PathBuf::from("any.toml")))
}

/// A G-code file.
pub fn gcode(text: &str) -> bool {
    task(Task::parse_gcode(text, PathBuf::from("any.gcode")))
}

fn task(task: Result<Task, mcdpr::motion::TaskError>) -> bool {
    match task {
        Ok(task) => {
            // What is taken starts somewhere that is a place.
            assert!(
                task.start_m()
                    .is_none_or(|m| m.iter().all(|v| v.is_finite()))
            );
            true
        }
        Err(error) => {
            assert!(!error.to_string().is_empty());
            false
        }
    }
}

/// Calibration data. What is taken can be written and is taken again.
pub fn data_set(text: &str) -> bool {
    match Data::from_json(text) {
        Ok(data) => {
            let written = data.to_json().to_string();
            let again = Data::from_json(&written);
            assert!(again.is_ok(), "{again:?}");
            true
        }
        Err(error) => {
            assert!(!error.to_string().is_empty());
            false
        }
    }
}

/// A scenario file, and each of its lines as a fault of the command line.
pub fn scenario(text: &str) -> bool {
    for line in text.lines().take(50) {
        let _ = Injection::parse(line, 4);
    }
    match Scenario::parse(text, "any.toml", 4) {
        Ok(scenario) => {
            for injection in &scenario.injections {
                assert!(injection.cable < 4 && injection.strength.is_finite());
            }
            true
        }
        Err(error) => {
            assert!(!error.to_string().is_empty());
            false
        }
    }
}

/// A small data set, as the simulator collects it.
#[must_use]
pub fn example_data() -> String {
    let setup = Setup {
        target: Target::Tag,
        poses: 7,
        ..Setup::default()
    };
    simulate(&setup).map_or_else(String::new, |(data, _)| data.to_json().to_string())
}
