//! `cargo xtask study boards`: an hour of motion of a robot on several boards, and how far apart they are along its path.
//!
//! `--robot NAME` chooses the robot, `--seeds N` and `--seed S` the seeds, `--minutes M` the length of the motion (an hour
//! at most). The crystals of the first two boards are 120 parts per million apart, those of further boards anywhere
//! between, and each changes with its temperature. The machine is as described: what the winches do does not enter.

use mcdpr_core::control::Handle;
use mcdpr_core::motion::{Model, Plan, Step, Task};
use mcdpr_core::random::Random;
use mcdpr_core::robot::Robot;
use mcdpr_core::run::{Homing, NoStore, Recorder, RunError, Session};
use mcdpr_protocol::SessionId;
use mcdpr_simulator::{BoardTime, LinkOptions, Simulation};
use mcdpr_twin::SimulatedLink;
use mcdpr_twin::line::in_process;
use mcdpr_twin::plant::{Mismatch, at_rest};
use mcdpr_twin::together::{Together, Window};
use std::process::ExitCode;
use std::sync::atomic::{AtomicU64, Ordering};

/// How far a crystal is off at most, parts in a million: the slowest and the fastest are twice as far apart.
const CRYSTAL_PPM: f64 = 60.0;
/// Temperature changes a crystal by this much at most, parts in a million, ...
const SWING_PPM: f64 = 10.0;
/// ... within periods from and to, s.
const SWING_S: [f64; 2] = [600.0, 2400.0];
/// An hour at the robot's own speed is a longer path than one plan may have: its timed steps take so many times longer,
/// ...
const SLOWER: f64 = 2.0;
/// ... and the others have this speed, m/s.
const SPEED_MPS: f64 = 0.15;
/// Path time between two looks at the boards, s.
const LOOK_S: f64 = 5.0;
/// Path time between two lines of progress, s.
const TOLD_S: f64 = 300.0;
/// Longest motion, minutes.
const LONGEST_MIN: u64 = 60;
/// Salt of the clocks in a seed.
const CLOCKS: u64 = 0x686F_7572;

/// What one seed came to. Skews are the time between the earliest and the latest board, over a second of the path each.
#[derive(Debug)]
struct Hour {
    /// Its seed.
    seed: u64,
    /// Time along the path, s.
    path_s: f64,
    /// Skew in the first second in which all boards move cables, µs.
    start_us: f64,
    /// Greatest skew, µs.
    worst_us: f64,
    /// Path time at which it was that, s.
    worst_at_s: f64,
    /// Skew that half of the seconds are below, µs.
    median_us: f64,
    /// Skew in the last second in which all boards move cables, µs.
    end_us: f64,
    /// Seconds that were judged.
    seconds: usize,
    /// Crystals: how much slower than true they are on average, parts in a million.
    slow_ppm: Vec<f64>,
}

/// The clocks of a seed.
fn times(boards: usize, random: &mut Random) -> Vec<BoardTime> {
    let flip = if random.within(1.0) < 0.0 { -1.0 } else { 1.0 };
    let each = (0..boards).map(|board| {
        let slow_ppm = match board {
            0 => flip * CRYSTAL_PPM,
            1 => -flip * CRYSTAL_PPM,
            _ => random.within(CRYSTAL_PPM),
        };
        let [low_s, high_s] = SWING_S;
        BoardTime {
            slow_ppm,
            // Anywhere in the first millisecond.
            begins_us: 500.0 + random.within(499.0),
            swing_ppm: random.within(SWING_PPM),
            swing_s: f64::midpoint(low_s, high_s) + random.within(0.5 * (high_s - low_s)),
        }
    });
    each.collect()
}

/// The robot's own path again and again, from its start back to it, in about this time, s.
fn rounds(model: &Model, path_s: f64) -> Result<Task, RunError> {
    let robot = model.robot();
    let mut task = Task::fitting(model)?;
    for step in &mut task.steps {
        if let Step::Move {
            duration_s,
            speed_mps,
            ..
        } = step
        {
            *duration_s = duration_s.map(|fast_s| fast_s * SLOWER);
            *speed_mps = Some(SPEED_MPS);
        }
    }
    let home_m = robot.tool.home_in_world_m;
    let first = task.clone().approached_from(&home_m, None)?;
    let once = Plan::new(model, &home_m, &first.steps)?;
    let once_s = once.timed.duration_s();
    let end_m = once.timed.tool_m(once_s)?;
    let again = task.clone().approached_from(&end_m, None)?;
    let round = Plan::new(model, &end_m, &again.steps)?;
    let left = ((path_s - once_s) / round.timed.duration_s())
        .floor()
        .max(0.0);
    let mut whole = task;
    for _ in 0..left as usize {
        whole.steps.extend(again.steps.iter().cloned());
    }
    Ok(whole)
}

/// One motion of about this time, s, on the machine and clocks of a seed.
///
/// # Errors
/// Where no path fits the robot, or the run fails.
fn hour(model: &Model, seed: u64, path_s: f64) -> Result<Hour, RunError> {
    let robot = model.robot();
    let task = rounds(model, path_s)?;
    let times = times(robot.boards.len(), &mut Random::new(seed ^ CLOCKS));
    let plant = at_rest(model, robot, &Mismatch::default(), seed, None)?;
    let line = LinkOptions::default();
    let link = SimulatedLink::timed(robot, plant, &line, seed, &in_process, &times)
        .map_err(|error| RunError::Client(error.into()))?;
    let handle = Handle::new();
    let home = Homing::Place(robot.tool.home_in_world_m);
    let mut session = Session::open(model, link.clone(), SessionId(1), &handle, home, &NoStore)?;
    let plan = session.plan(task, None)?;
    session.arm()?;
    let mut together = Together::new(robot, &plan.knots);
    link.with(Simulation::record_boards);
    let (mut next_s, mut told_s) = (LOOK_S, TOLD_S);
    session.follow(&plan, &mut Recorder::without_samples(), |progress| {
        if progress.path_s >= next_s {
            next_s = progress.path_s + LOOK_S;
            together.take(link.with(Simulation::take_boards));
        }
        if progress.path_s >= told_s {
            told_s += TOLD_S;
            let minutes = progress.path_s / 60.0;
            let (worst_us, _) = worst(&together);
            eprintln!("seed {seed}: {minutes:.0} min, {worst_us:.1} us at most so far");
        }
    })?;
    together.take(link.with(Simulation::take_boards));
    session.disarm()?;
    let windows = together.windows();
    let us = |window: Option<&Window>| window.map_or(f64::NAN, |window| window.skew_s() * 1e6);
    let (worst_us, worst_at_s) = worst(&together);
    let mut all: Vec<f64> = windows.iter().map(|window| window.skew_s() * 1e6).collect();
    all.sort_by(f64::total_cmp);
    Ok(Hour {
        seed,
        path_s: plan.timed.duration_s(),
        start_us: us(windows.first()),
        worst_us,
        worst_at_s,
        median_us: all.get(all.len() / 2).copied().unwrap_or(f64::NAN),
        end_us: us(windows.last()),
        seconds: windows.len(),
        slow_ppm: times.iter().map(|time| time.slow_ppm).collect(),
    })
}

/// Greatest skew so far, µs, and at which path time, s.
fn worst(together: &Together) -> (f64, f64) {
    let windows = together.windows();
    let skews = windows.iter().map(|w| (w.skew_s() * 1e6, w.path_s));
    skews.fold(
        (0.0, 0.0),
        |most, one| if one.0 > most.0 { one } else { most },
    )
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match study(&arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("{message}");
            ExitCode::FAILURE
        }
    }
}

/// A whole number after this word; a word that is no number is refused.
fn number(arguments: &[String], name: &str, default: u64) -> Result<u64, String> {
    let Some(at) = arguments.iter().position(|argument| argument == name) else {
        return Ok(default);
    };
    let word = arguments.get(at + 1).map_or("", String::as_str);
    word.parse()
        .map_err(|_| format!("{name} {word}: give a whole number"))
}

/// Runs the seeds on all processors and prints a line for each.
fn study(arguments: &[String]) -> Result<(), String> {
    let robot_at = arguments.iter().position(|argument| argument == "--robot");
    let name = robot_at.and_then(|at| arguments.get(at + 1));
    let name = name.map_or("eight-two-boards", String::as_str);
    let first = number(arguments, "--seed", 1)?;
    let end = first.saturating_add(number(arguments, "--seeds", 3)?);
    let minutes = number(arguments, "--minutes", LONGEST_MIN)?;
    if minutes > LONGEST_MIN {
        return Err(format!("--minutes {minutes}: give {LONGEST_MIN} at most"));
    }
    let robot = Robot::built_in(name).map_err(|error| error.to_string())?;
    if robot.boards.len() < 2 {
        return Err(format!("{name} has one board"));
    }
    let model = Model::new(&robot).map_err(|error| error.to_string())?;
    let next = AtomicU64::new(first);
    let work = || {
        let mut failed = 0;
        loop {
            let seed = next.fetch_add(1, Ordering::Relaxed);
            if seed >= end {
                return failed;
            }
            match hour(&model, seed, minutes as f64 * 60.0) {
                Ok(hour) => println!("{name}: {}", words(&hour)),
                Err(error) => {
                    failed += 1;
                    println!("{name}: seed {seed}: {error}");
                }
            }
        }
    };
    let threads = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let failed: usize = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..threads).map(|_| scope.spawn(work)).collect();
        workers
            .into_iter()
            .map(|worker| worker.join().unwrap_or(1))
            .sum()
    });
    if failed > 0 {
        return Err(format!("{failed} seeds failed"));
    }
    Ok(())
}

fn words(hour: &Hour) -> String {
    format!(
        "seed {}, {:.1} min, crystals {:.0?} ppm slow: {:.1} us at the start, {:.1} us at most (after {:.1} min), {:.1} us \
         in the median, {:.1} us at the end; {} seconds judged",
        hour.seed,
        hour.path_s / 60.0,
        hour.slow_ppm,
        hour.start_us,
        hour.worst_us,
        hour.worst_at_s / 60.0,
        hour.median_us,
        hour.end_us,
        hour.seconds
    )
}
