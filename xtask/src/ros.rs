//! The ROS side of `mcdpr ros`: a crate of its own outside of the workspace, and its tests with a foreign DDS.

use crate::{cargo, cargo_program, python, run, tools};
use std::path::{Path, PathBuf};
use std::process::Command;

/// Where the crate is.
const MANIFEST: &str = "ros/Cargo.toml";
/// What its tests need. The wheel of Cyclone DDS brings its native library.
const JUDGES: &[&str] = &["cyclonedds>=11,<12", "pytest>=8"];

/// Builds the program and its ROS side, and puts the latter beside the program.
pub(crate) fn build(features: &str) -> Result<(), String> {
    // As the tests do, so that nothing is built again.
    cargo(&[
        "build",
        "--release",
        "--locked",
        "--workspace",
        "--features",
        features,
    ])?;
    let folder = folder();
    run(crate_command("build")
        .args(["--release", "--target-dir"])
        .arg(&folder))?;
    let name = format!("mcdpr-ros{}", std::env::consts::EXE_SUFFIX);
    let (from, to) = (
        folder.join("release").join(&name),
        tools::target().join("release").join(&name),
    );
    std::fs::copy(&from, &to).map(|_| ()).map_err(|error| {
        let (from, to) = (from.display(), to.display());
        format!("xtask: {from} to {to}: {error}")
    })
}

/// Builds both, and runs the tests of both.
pub(crate) fn test(features: &str) -> Result<(), String> {
    build(features)?;
    run(crate_command("clippy")
        .args(["--release", "--all-targets", "--target-dir"])
        .arg(folder())
        .args(["--", "-D", "warnings"]))?;
    run(crate_command("test")
        .args(["--release", "--target-dir"])
        .arg(folder()))?;
    let python = tools::ensure_python()?;
    python::pip(&python, JUDGES)?;
    let absolute = |path: &Path| std::path::absolute(path).map_err(|error| error.to_string());
    let program = absolute(&tools::target().join("release").join("mcdpr"))?;
    run(Command::new(absolute(&python)?)
        .args([
            "-m",
            "pytest",
            "-q",
            "-x",
            "-s",
            "-p",
            "no:cacheprovider",
            "--durations=5",
        ])
        .env("MCDPR_PROGRAM", program)
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .current_dir("ros/tests"))
}

/// Checks the formatting of the crate, which the workspace does not know.
pub(crate) fn check_format() -> Result<(), String> {
    cargo(&["fmt", "--check", "--manifest-path", MANIFEST])
}

fn crate_command(name: &str) -> Command {
    let mut command = Command::new(cargo_program());
    command.args([name, "--locked", "--manifest-path", MANIFEST]);
    command
}

fn folder() -> PathBuf {
    tools::target().join("ros")
}
