//! The inputs of a run as this program collects them.

use super::{Doing, Machine, RobotText, Scenario, TaskSource, protocol_version};
use crate::motion::PlanOptions;

/// The source of a task as it is asked for on the command line; `tool_z_m`: height of the tool for a
/// built-in task, world, m.
#[must_use]
pub fn task_source(name: &str, tool_z_m: f64) -> TaskSource {
    let built_in = crate::motion::BUILT_IN
        .iter()
        .any(|(known, _)| *known == name);
    let text = (!built_in)
        .then(|| crate::files::read_text(name).ok())
        .flatten();
    TaskSource {
        name: name.to_owned(),
        text,
        tool_z_m,
    }
}

/// A scenario that starts now.
#[must_use]
pub fn starting_now(robot: &str, task: TaskSource, session: u32, machine: Machine) -> Scenario {
    let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    let started = since.map_or(0, |since| since.as_micros());
    Scenario {
        program: env!("CARGO_PKG_VERSION").to_owned(),
        protocol: protocol_version(),
        started_unix_us: u64::try_from(started).unwrap_or(0),
        arguments: std::env::args().skip(1).collect(),
        robot: robot_files(robot),
        calibration: None,
        task,
        options: PlanOptions::default(),
        doing: Doing::Task,
        at_home: false,
        session,
        machine,
    }
}

/// Texts of a robot file and of the winch modules that it names.
fn robot_files(name: &str) -> Vec<RobotText> {
    crate::robot::sources(name)
        .into_iter()
        .map(|(name, text)| RobotText { name, text })
        .collect()
}
