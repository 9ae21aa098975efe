//! The Python package: its wheel, and the tests of it with what others make (MuJoCo, pandas, mypy).

use crate::run;
use crate::tools;
use std::path::{Path, PathBuf};
use std::process::Command;

/// What builds the wheel.
const MATURIN: &[&str] = &["maturin>=1.9,<2"];
/// What the tests of the package need.
const JUDGES: &[&str] = &[
    "numpy>=1.24",
    "pytest>=8",
    "mypy>=1.13",
    "mujoco>=3.1",
    "pandas>=2",
    "mcap>=1.2,<2",
    "foxglove-schemas-protobuf>=0.3",
];

/// Builds the wheel of this machine's kind; gives its file.
pub(crate) fn wheel() -> Result<PathBuf, String> {
    let python = tools::ensure_python()?;
    pip(&python, MATURIN)?;
    let folder = tools::target().join("wheels");
    // An old one would be taken for it.
    if folder.exists() {
        std::fs::remove_dir_all(&folder).map_err(|error| format!("xtask: {error}"))?;
    }
    run(Command::new(&python)
        .args(["-m", "maturin", "build", "--release", "--locked", "-q"])
        .args(["--manifest-path", "python/Cargo.toml", "--interpreter"])
        .arg(&python)
        .arg("--out")
        .arg(&folder))?;
    let files = std::fs::read_dir(&folder).map_err(|error| format!("xtask: {error}"))?;
    let mut wheels = files.flatten().map(|file| file.path());
    let wheel = wheels.find(|path| path.extension().is_some_and(|kind| kind == "whl"));
    wheel.ok_or_else(|| format!("xtask: maturin left no wheel in {}", folder.display()))
}

/// Builds the wheel, installs it below the target folder, and runs its tests against the program.
pub(crate) fn test() -> Result<(), String> {
    let wheel = wheel()?;
    let python = tools::ensure_python()?;
    pip(&python, JUDGES)?;
    run(Command::new(&python)
        .args(["-m", "pip", "install", "--quiet", "--no-deps"])
        .arg("--force-reinstall")
        .arg(&wheel))?;
    let program = tools::target().join("release").join("mcdpr");
    let program = std::path::absolute(program).map_err(|error| error.to_string())?;
    // From their own folder: the package that is tested is the installed one.
    let folder = Path::new("python").join("tests");
    let python = std::path::absolute(python).map_err(|error| error.to_string())?;
    run(Command::new(&python)
        .args(["-m", "mypy", "--strict", "-p", "mcdpr"])
        .current_dir(&folder))?;
    run(Command::new(&python)
        .args([
            "-m",
            "pytest",
            "-q",
            "-p",
            "no:cacheprovider",
            "--durations=5",
        ])
        .env("MCDPR_PROGRAM", program)
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .current_dir(&folder))
}

/// Installs packages that are not there.
fn pip(python: &Path, packages: &[&str]) -> Result<(), String> {
    run(Command::new(python)
        .args([
            "-m",
            "pip",
            "install",
            "--quiet",
            "--disable-pip-version-check",
        ])
        .args(packages))
}
