//! `mcdpr fingerprint`: a hash of everything that happens in a simulated run.

use super::run::tool_height_m;
use super::{Common, Failed, Outcome, print_json};
use crate::machine::Mismatch;
use crate::motion::{Model, Task};
use mcdpr_twin::fingerprint::fingerprint;
use std::time::Instant;

/// Hash a simulated run: every byte on the line and every true state; the same on every computer
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// Name of a built-in task, or a task file; without one, as `demo`
    task: Option<String>,
    /// Simulate the machine exactly as described
    #[arg(long)]
    ideal: bool,
    /// Height of a built-in task: that of a level platform's origin; the tool is below it
    #[arg(long, value_name = "MM", default_value_t = -100.0, allow_negative_numbers = true)]
    z_mm: f64,
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        common.no_chip("fingerprint")?;
        if common.on != "sim" {
            let reason = "it simulates the robot: leave out --on";
            return Err(Failed::from_error("fingerprint")(reason).into());
        }
        let robot = common.robot()?;
        let model = Model::new(&robot)?;
        let name = match &self.task {
            Some(name) => name.as_str(),
            None => Task::fitting_name(&model),
        };
        let height_m = tool_height_m(&robot, self.z_mm);
        let task = crate::motion::find_task_for(&model, name, height_m)?;
        let mismatch = if self.ideal {
            Mismatch::default()
        } else {
            Mismatch::realistic()
        };
        let began = Instant::now();
        let found = fingerprint(&model, task, &mismatch, common.seed)?;
        let took_s = began.elapsed().as_secs_f64();
        if common.json {
            return print_json(&serde_json::json!({
                "sha256": found.sha256,
                "task": name,
                "robot": robot.name,
                "seed": common.seed,
                "simulated_s": found.simulated_s,
                "took_s": took_s,
                "bytes": found.bytes,
                "states": found.states,
            }));
        }
        say!("{}", found.sha256);
        eprintln!(
            "{name} on {}, seed {}: {} bytes and {} states of {:.1} s, simulated in {took_s:.2} s",
            robot.name, common.seed, found.bytes, found.states, found.simulated_s
        );
        Ok(())
    }
}
