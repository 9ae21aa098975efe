//! `cargo xtask study own-frame`: frames of one's own, each from a few answers to a calibrated robot that picks, by
//! the real program, over seeds. Each seed is another machine with the errors of a real one. What it prints
//! is its result.

use mcdpr_tests::mcdpr;
use mcdpr_tests::process::Folder;
use serde_json::Value;
use std::path::Path;
use std::process::{ExitCode, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

/// Name of the frame, and what `mcdpr config init` is told about it.
const FRAMES: [(&str, &str); 3] = [
    ("small", "--frame-mm 1000 1000 1000"),
    (
        "slow",
        "--frame-mm 800 900 700 --mass-kg 1 --winch geared-371",
    ),
    (
        "hall",
        "--frame-mm 2000 3000 2000 --mass-kg 4 --platform-mm 300 300 100",
    ),
];
/// Of all three: what calibrating and picking need.
const EQUIPPED: &str = "--gripper-mm 60 --camera";

/// One machine.
struct Case {
    frame: usize,
    seed: u64,
    /// Mean error of the task `fitting` before and after the calibration, mm.
    path_mm: [Option<f64>; 2],
    accepted: bool,
    delivered: bool,
    /// Error of the first grasp, mm.
    grasp_mm: Option<f64>,
    /// Time on the clock of all commands, s.
    took_s: f64,
    /// What was refused, in the program's words.
    said: Vec<String>,
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let option = |name: &str, default: u64| {
        let at = arguments.iter().position(|argument| argument == name);
        let value = at.and_then(|at| arguments.get(at + 1));
        value
            .and_then(|value| value.parse().ok())
            .unwrap_or(default)
    };
    let (first, runs) = (option("--seed", 1), option("--runs", 20));
    let seeds = first..first.saturating_add(runs);
    let wanted: Vec<(usize, u64)> = (0..FRAMES.len())
        .flat_map(|frame| seeds.clone().map(move |seed| (frame, seed)))
        .collect();
    let folder = Folder::new("own-frame-study");
    let next = AtomicUsize::new(0);
    let workers = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let mut cases: Vec<Case> = std::thread::scope(|scope| {
        let work = || {
            let mut done = Vec::new();
            while let Some((frame, seed)) = wanted.get(next.fetch_add(1, Ordering::Relaxed)) {
                let at = folder.path().join(format!("{frame}-{seed}"));
                done.push(machine(&at, *frame, *seed));
                eprintln!("{}, seed {seed}", FRAMES[*frame].0);
            }
            done
        };
        let workers: Vec<_> = (0..workers).map(|_| scope.spawn(work)).collect();
        let done = workers.into_iter().map(std::thread::ScopedJoinHandle::join);
        done.filter_map(Result::ok).flatten().collect()
    });
    cases.sort_by_key(|case| (case.frame, case.seed));
    println!(
        "| frame | machines | calibrations accepted | objects delivered | mean path error before, mm | after, mm | \
         error of the grasp, mm | all commands, s |\n|---|---|---|---|---|---|---|---|"
    );
    for (number, (name, _)) in FRAMES.iter().enumerate() {
        let of: Vec<&Case> = cases.iter().filter(|case| case.frame == number).collect();
        let count = |kept: fn(&Case) -> bool| of.iter().filter(|case| kept(case)).count();
        println!(
            "| `{name}` | {} | {} | {} | {} | {} | {} | {} |",
            of.len(),
            count(|case| case.accepted),
            count(|case| case.delivered),
            range(of.iter().filter_map(|case| case.path_mm[0])),
            range(of.iter().filter_map(|case| case.path_mm[1])),
            range(of.iter().filter_map(|case| case.grasp_mm)),
            range(of.iter().map(|case| case.took_s)),
        );
    }
    for case in &cases {
        for said in &case.said {
            println!("{}, seed {}: {said}", FRAMES[case.frame].0, case.seed);
        }
    }
    match cases.len() == wanted.len() {
        true => ExitCode::SUCCESS,
        false => ExitCode::FAILURE,
    }
}

/// Median, and the range in brackets.
fn range(values: impl Iterator<Item = f64>) -> String {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    let (Some(least), Some(most)) = (values.first(), values.last()) else {
        return "-".to_owned();
    };
    let half = values.len() / 2;
    let median = match values.len() % 2 {
        0 => 0.5 * (values[half - 1] + values[half]),
        _ => values[half],
    };
    format!("{median:.2} ({least:.2} to {most:.2})")
}

/// From the answers to the first object in its place, with the commands of a user.
fn machine(folder: &Path, frame: usize, seed: u64) -> Case {
    let (name, answers) = FRAMES[frame];
    let (file, began) = (format!("{name}.toml"), Instant::now());
    let mut case = Case {
        frame,
        seed,
        path_mm: [None; 2],
        accepted: false,
        delivered: false,
        grasp_mm: None,
        took_s: 0.0,
        said: Vec::new(),
    };
    if let Err(error) = std::fs::create_dir_all(folder) {
        case.said.push(error.to_string());
        return case;
    }
    let seeded = format!("--robot {file} --seed {seed} --json");
    let mut call = |words: String| {
        let answer = document(folder, &words);
        if let Err(message) = &answer {
            case.said.push(message.clone());
        }
        answer.unwrap_or_default()
    };
    call(format!("config init {file} {answers} {EQUIPPED} --json"));
    let path_mm = |run: &Value| run["path_error_m"]["mean"].as_f64().map(|m| m * 1e3);
    let before = path_mm(&call(format!("run fitting {seeded}")));
    let calibration = call(format!(
        "calibrate all --target board --poses 10 --candidates 60 {seeded}"
    ));
    let verdict = calibration["verdict"].as_str().unwrap_or_default();
    let accepted = verdict.starts_with("accepted");
    let (after, scene) = match accepted {
        true => (
            path_mm(&call(format!("run fitting {seeded}"))),
            call(format!("pick --objects 1 {seeded}")),
        ),
        false => (None, Value::Null),
    };
    case.path_mm = [before, after];
    case.accepted = accepted;
    if !accepted && !verdict.is_empty() {
        case.said.push(verdict.to_owned());
    }
    case.delivered = scene["carried_off"] == 1;
    case.grasp_mm = scene["errors_m"][0].as_f64().map(|m| m * 1e3);
    case.took_s = began.elapsed().as_secs_f64();
    case
}

/// What a command prints as JSON, or its message on one line.
fn document(folder: &Path, words: &str) -> Result<Value, String> {
    let mut command = mcdpr();
    command.args(words.split_whitespace()).current_dir(folder);
    // Each machine has a state of its own: the simulator keeps where its drums are.
    command.env("XDG_STATE_HOME", folder.join("state"));
    let output = command.stdin(Stdio::null()).output();
    let output = output.map_err(|error| error.to_string())?;
    let message = || {
        let said = String::from_utf8_lossy(&output.stderr);
        let lines: Vec<&str> = said.lines().rev().take(4).collect();
        let lines: Vec<&str> = lines.into_iter().rev().collect();
        format!("`mcdpr {words}`: {}", lines.join(" "))
    };
    let document = serde_json::from_slice(&output.stdout);
    match output.status.success() {
        true => document.map_err(|_| message()),
        false => Err(message()),
    }
}
