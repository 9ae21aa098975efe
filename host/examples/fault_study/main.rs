//! `cargo xtask study faults`: seeded runs with faults, measured from the injection, with their tables.
//!
//! `--robot NAME` chooses the robot, `--runs N` and `--seed S` the seeds. `--undisturbed` runs the same
//! work without faults. `--invariants` is the study of random robots of the paper's kind.

mod invariants;
mod tables;

use mcdpr::motion::Model;
use mcdpr::scenario::survey::{self, word};
use std::process::ExitCode;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let value = |name: &str| {
        let at = arguments.iter().position(|argument| argument == name);
        at.and_then(|at| arguments.get(at + 1))
    };
    let number = |name: &str, default: u64| {
        let given = value(name).and_then(|value| value.parse().ok());
        given.unwrap_or(default)
    };
    let has = |name: &str| arguments.iter().any(|argument| argument == name);
    let first = number("--seed", 1);
    let failed = if has("--invariants") {
        invariants::study(first, number("--runs", 10_000))
    } else {
        let robot = value("--robot").map_or("paper-table5", String::as_str);
        match survey(robot, first, number("--runs", 1000), !has("--undisturbed")) {
            Ok(failed) => failed,
            Err(message) => {
                eprintln!("{message}");
                return ExitCode::from(2);
            }
        }
    };
    if failed == 0 {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    }
}

/// Runs the survey of one robot and prints its tables; returns how many runs broke an invariant.
fn survey(name: &str, first: u64, runs: u64, disturbed: bool) -> Result<usize, String> {
    let robot = mcdpr::robot::find(name).map_err(|error| error.to_string())?;
    let model = Model::new(&robot).map_err(|error| error.to_string())?;
    let end = first.saturating_add(runs);
    let all = survey::run_all(&model, first..end, disturbed, |outcome| {
        if !outcome.violations.is_empty() {
            let words: Vec<_> = outcome.drawn.injections.iter().map(word).collect();
            eprintln!(
                "seed {} ({}): {}: {}",
                outcome.drawn.seed,
                outcome.drawn.moment.name(),
                words.join(" "),
                outcome.violations.join("; "),
            );
        }
    });
    let without = all.iter().filter(|outcome| outcome.is_none()).count();
    let all: Vec<_> = all.into_iter().flatten().collect();
    let failed = all.iter().filter(|o| !o.violations.is_empty()).count();
    let hours: f64 = all.iter().map(|o| o.simulated_s / 3600.0).sum();
    println!(
        "{name}: {} runs, seeds {first} to {}, {without} without a motion, {hours:.2} h simulated; {failed} broke an \
         invariant; hash {:016x}\n",
        all.len(),
        end.saturating_sub(1),
        hash(all.iter().map(|outcome| format!("{outcome:?}")))
    );
    if disturbed {
        tables::print(&all);
    }
    Ok(failed)
}

/// FNV-1a (Fowler, Noll, Vo) over all results: shows whether two studies are identical.
fn hash(results: impl Iterator<Item = String>) -> u64 {
    let bytes = results.flat_map(String::into_bytes);
    bytes.fold(0xCBF2_9CE4_8422_2325, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01B3)
    })
}
