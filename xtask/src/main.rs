//! Chores of the project: `cargo xtask test`, `cargo xtask lint`, `cargo xtask firmware`.

mod features;
mod firmware;
mod functions;
mod mutants;
mod playground;
mod programs;
mod public;
mod python;
mod ros;
mod schematic;
mod seams;
mod source;
mod times;
mod tools;

use std::process::{Command, ExitCode};
use std::time::Instant;

const USAGE: &str = "usage: cargo xtask COMMAND

test        every test: host crates, system tests with the real program, the firmware's contracts, the
            Python package
wheel       build the Python package mcdpr (target/wheels)
python      the same, and its tests on the installed wheel (mypy, pytest; several minutes of build);
            --built: on what the tests have built, as `test` does
ros         build mcdpr and its ROS side (ros/, outside of the workspace: minutes), and test them with Eclipse
            Cyclone DDS; --build: build only
playground  build the page with a simulated robot in it, without a server (target/playground)
firmware    build the firmware and check its size and that it needs no floating point
study faults  faults in every phase of work, measured from the injection (--robot R, --runs N, --seed N, --undisturbed, --gears, --list)
study invariants  ten thousand runs with random faults on random robots (--runs N, --seed N)
study boards  how far apart the boards of a robot are over an hour of motion (--robot R, --minutes N, --seeds N, --seed N)
study planning  a million odd robots and tasks through planning (--runs N, --seed N)
study own-frame  three frames from a few answers to a calibrated robot that picks (--runs N, --seed N)
study mutants  small changes of the control core or the protocol that its tests must notice, with cargo-mutants, which
            it installs (--package firmware|protocol, --sample N, --seed N; some 10 s per mutant)
schematic   writes docs/board.kicad_sch from docs/board.net; --erc: KiCad (kicad-cli) checks its electrical rules
screenshots draws docs/images/*.png: the page on the simulator, in a real browser
seams       no ring of modules, no public item unused outside its crate; no dependency is built twice for the
            program and the tests; the crates without a system compile for wasm32; prints the ten longest functions
lint        formatting, seams, lints and documentation, warnings denied";

fn main() -> ExitCode {
    let began = Instant::now();
    let outcome = match std::env::args().nth(1).as_deref() {
        Some("test") => test(),
        Some("python") if std::env::args().nth(2).as_deref() == Some("--built") => {
            python::test_built(FEATURES)
        }
        Some("python") => python::test(),
        Some("wheel") => python::wheel().map(|file| println!("{}", file.display())),
        Some("ros") if std::env::args().nth(2).as_deref() == Some("--build") => {
            ros::build(FEATURES)
        }
        Some("ros") => ros::test(FEATURES),
        Some("playground") => playground::build(&cargo_program()),
        Some("firmware") => firmware::build_and_check(),
        Some("seams") => seams().and_then(|()| functions::print_longest()),
        Some("schematic") if std::env::args().nth(2).as_deref() == Some("--erc") => {
            schematic::check()
        }
        Some("schematic") => schematic::write(),
        Some("screenshots") => screenshots(),
        Some("lint") => lint(),
        Some("study") => study(),
        Some("help" | "--help" | "-h") => {
            println!("{USAGE}");
            Ok(())
        }
        _ => Err(USAGE.to_owned()),
    };
    if matches!(
        std::env::args().nth(1).as_deref(),
        Some("test" | "lint" | "python" | "ros")
    ) {
        eprintln!("{}", times::summary(began));
    }
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("{message}");
            ExitCode::FAILURE
        }
    }
}

/// Long studies; what they print is their result.
fn study() -> Result<(), String> {
    let arguments: Vec<String> = std::env::args().skip(2).collect();
    let chosen = arguments.split_first();
    let (package, example, options) = match chosen.map(|(a, b)| (a.as_str(), b)) {
        Some(("faults", options)) => ("mcdpr-twin", "fault_survey", options),
        Some(("boards", options)) => ("mcdpr-twin", "boards_hour", options),
        Some(("invariants", options)) => ("mcdpr", "fault_study", options),
        Some(("planning", options)) => ("mcdpr-tests", "planning_study", options),
        Some(("mutants", options)) => return mutants::study(options),
        // It starts the program.
        Some(("own-frame", options)) => return built_with_program("own_frame_study", options),
        _ => return Err(USAGE.to_owned()),
    };
    let mut command = vec!["run", "--release", "--locked", "-q", "-p", package];
    command.extend(["--example", example, "--"]);
    command.extend(options.iter().map(String::as_str));
    cargo(&command)
}

/// Draws the pictures of the documents.
fn screenshots() -> Result<(), String> {
    tools::ensure_browser()?;
    built_with_program("screenshots", &["docs/images".to_owned()])
}

/// An example of the tests that starts the program. With the features of the tests, so that nothing is built again.
fn built_with_program(example: &str, options: &[String]) -> Result<(), String> {
    let built = [
        "--release",
        "--locked",
        "--workspace",
        "--features",
        FEATURES,
    ];
    for target in [["--bin", "mcdpr"], ["--example", example]] {
        cargo(&[&["build"], &built[..], &target[..]].concat())?;
    }
    let program = tools::target().join("release/examples").join(example);
    run(Command::new(program).args(options))
}

fn test() -> Result<(), String> {
    // The emulated chip executes the firmware's own file: it must be there before the tests run. The
    // program, which the system tests start, is built with them.
    firmware::build_and_check()?;
    firmware::kinematics_without_std()?;
    schematic::check_if_installed()?;
    check_for_page()?;
    playground::build(&cargo_program())?;
    tools::ensure_browser()?;
    tools::ensure_readers()?;
    let arguments = [
        "test",
        "--release",
        "--locked",
        "--workspace",
        "--features",
        FEATURES,
    ];
    // What is off by default has dependencies of its own, and is not built into everything else.
    cargo(&[
        "test",
        "--release",
        "--locked",
        "-p",
        "mcdpr-vision",
        "--features",
        "onnx,v4l2,realsense",
        "--lib",
        "--test",
        "network",
        "--test",
        "realsense",
    ])?;
    let file = std::path::absolute(firmware::elf_path());
    let file = file.map_err(|error| error.to_string())?;
    programs::run(&cargo_program(), &arguments, &file)?;
    let mut documentation = arguments.to_vec();
    documentation.insert(1, "--doc");
    run(Command::new(cargo_program())
        .args(documentation)
        .env("MCDPR_FIRMWARE", &file))?;
    python::test_built(FEATURES)
}

/// Features that are off by default and tested all the same.
const FEATURES: &str = "mcdpr-kinematics/rayon";
/// Features that are checked too: of writing a chip, which needs a probe, only that it compiles is
/// known.
const LINTED: &str = "mcdpr-kinematics/rayon,mcdpr-kinematics/clarabel,mcdpr/flash,mcdpr/onnx,mcdpr/v4l2,mcdpr/realsense";

/// What keeps the crates apart: no ring of modules, nothing public that only its own crate names, no
/// operating system below the host; and nothing built twice.
fn seams() -> Result<(), String> {
    let found = [
        seams::check(),
        public::check(),
        features::check(&cargo_program(), FEATURES),
    ];
    let wrong: Vec<String> = found.into_iter().filter_map(Result::err).collect();
    if !wrong.is_empty() {
        return Err(wrong.join("\n"));
    }
    check_for_page()
}

/// Checks that what shall run in a page compiles for it.
fn check_for_page() -> Result<(), String> {
    firmware::ensure_target(playground::TARGET)?;
    let mut arguments = vec!["check", "--locked", "--target", playground::TARGET];
    for name in WITHOUT_SYSTEM {
        arguments.extend(["-p", name]);
    }
    cargo(&arguments)
}

/// Crates that need no operating system.
const WITHOUT_SYSTEM: [&str; 2] = ["mcdpr-core", "mcdpr-calibration"];

fn lint() -> Result<(), String> {
    cargo(&["fmt", "--all", "--check"])?;
    seams()?;
    cargo(&[
        "clippy",
        "--locked",
        "--workspace",
        "--all-targets",
        "--features",
        LINTED,
        "--",
        "-D",
        "warnings",
    ])?;
    firmware::lint()?;
    ros::check_format()?;
    // The features of clippy, so that dependencies are checked once.
    run(Command::new(cargo_program())
        .args([
            "doc",
            "--locked",
            "--workspace",
            "--no-deps",
            "--features",
            LINTED,
        ])
        .env("RUSTDOCFLAGS", "-D warnings"))
}

/// Runs cargo with these arguments in the workspace.
fn cargo(arguments: &[&str]) -> Result<(), String> {
    run(Command::new(cargo_program()).args(arguments))
}

fn cargo_program() -> String {
    std::env::var("CARGO").unwrap_or_else(|_| "cargo".to_owned())
}

fn run(command: &mut Command) -> Result<(), String> {
    let words: Vec<_> = command
        .get_args()
        .map(|word| word.to_string_lossy())
        .collect();
    let program = command.get_program().to_string_lossy();
    let line = format!("{program} {}", words.join(" "));
    eprintln!("xtask: {line}");
    let name = program.rsplit('/').next().unwrap_or_default();
    let step = format!("{name} {}", words.join(" "));
    match times::timed(&step, || command.status()) {
        Ok(status) if status.success() => Ok(()),
        Ok(status) => Err(format!("xtask: `{line}` failed: {status}")),
        Err(error) => Err(format!("xtask: `{line}` cannot be started: {error}")),
    }
}
