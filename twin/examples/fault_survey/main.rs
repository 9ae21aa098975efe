//! `cargo xtask study faults`: seeded runs with faults, measured from the injection, with their tables.
//!
//! `--robot NAME` chooses the robot, `--runs N` and `--seed S` the seeds. `--undisturbed` runs the same
//! work without faults. `--gears` gives every seed other gears, over the range that geared winches have; the board is told
//! their type, and each winch's own friction and play differ by a tenth, its stiffness by 30 %. `--list` lists every run.

mod tables;

use mcdpr_core::motion::Model;
use mcdpr_core::robot::Robot;
use mcdpr_twin::faults::survey::{self, Outcome, word};
use mcdpr_twin::gears;
use std::process::ExitCode;
use std::sync::atomic::{AtomicU64, Ordering};

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
    let robot = value("--robot").map_or("paper-optimistic", String::as_str);
    let asked = Asked {
        disturbed: !has("--undisturbed"),
        gears: has("--gears"),
        list: has("--list"),
    };
    match survey(robot, first, number("--runs", 1000), &asked) {
        Ok(0) => ExitCode::SUCCESS,
        Ok(_) => ExitCode::FAILURE,
        Err(message) => {
            eprintln!("{message}");
            ExitCode::from(2)
        }
    }
}

/// What is asked for beside robot and seeds.
struct Asked {
    /// Faults are injected.
    disturbed: bool,
    /// Every seed has other gears.
    gears: bool,
    /// Every run is listed.
    list: bool,
}

/// Runs the survey of one robot and prints its tables; returns how many runs broke an invariant.
fn survey(name: &str, first: u64, runs: u64, asked: &Asked) -> Result<usize, String> {
    let robot = Robot::built_in(name).map_err(|error| error.to_string())?;
    let model = Model::new(&robot).map_err(|error| error.to_string())?;
    if asked.gears && robot.winches.iter().any(|winch| winch.gear.is_none()) {
        return Err(format!("--gears: {name} has winches without a gear"));
    }
    let end = first.saturating_add(runs);
    let all = on_all_processors(first..end, |seed| {
        let other = asked.gears.then(|| gears::drawn(&robot, seed).0);
        let other = other.map(|robot| Model::new(&robot).map_err(|error| error.to_string()));
        let model = match &other {
            None => &model,
            Some(Ok(model)) => model,
            Some(Err(error)) => {
                eprintln!("seed {seed}: {error}");
                return None;
            }
        };
        let outcome = if asked.disturbed {
            survey::run(model, seed)
        } else {
            survey::undisturbed(model, seed)
        };
        if let Some(outcome) = outcome.as_ref().filter(|o| !o.violations.is_empty()) {
            let words: Vec<_> = outcome.drawn.injections.iter().map(word).collect();
            let moment = outcome.drawn.moment.name();
            let wrong = outcome.violations.join("; ");
            eprintln!("seed {seed} ({moment}): {}: {wrong}", words.join(" "));
        }
        outcome
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
    if asked.disturbed {
        tables::print(&all);
    }
    if asked.list {
        tables::list(&all);
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

/// The results of these seeds, in their order.
fn on_all_processors(
    seeds: std::ops::Range<u64>,
    run: impl Fn(u64) -> Option<Outcome> + Sync,
) -> Vec<Option<Outcome>> {
    let next = AtomicU64::new(seeds.start);
    let work = || {
        let mut done = Vec::new();
        loop {
            let seed = next.fetch_add(1, Ordering::Relaxed);
            if seed >= seeds.end {
                return done;
            }
            done.push((seed, run(seed)));
        }
    };
    let threads = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let mut all: Vec<_> = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..threads).map(|_| scope.spawn(work)).collect();
        let join = |worker: std::thread::ScopedJoinHandle<'_, _>| match worker.join() {
            Ok(done) => done,
            Err(panic) => std::panic::resume_unwind(panic),
        };
        workers.into_iter().flat_map(join).collect()
    });
    all.sort_unstable_by_key(|(seed, _)| *seed);
    all.into_iter().map(|(_, outcome)| outcome).collect()
}
