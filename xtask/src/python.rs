//! The Python package: its wheel, and the tests of it with what others make (MuJoCo, pandas, mypy).

use crate::tools;
use crate::{cargo, run};
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
    "pandas-stubs",
    "polars>=1",
    "pyarrow>=15",
    "gymnasium>=1.0",
    "nbclient>=0.10",
    "ipykernel>=6",
    "matplotlib>=3.8",
    "rosbags>=0.10",
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
    judge(&python)
}

/// Puts the package with the workspace's own build of its native half into the environment, and runs its
/// tests. maturin selects packages of its own, gets other features of dependencies and compiles nearly
/// everything anew; this adds what only Python needs to what `cargo test` has built.
pub(crate) fn test_built(features: &str) -> Result<(), String> {
    // With tests, or the features of development dependencies would be missing: all would be built again.
    cargo(&[
        "build",
        "--release",
        "--locked",
        "--workspace",
        "--features",
        features,
        "--lib",
        "--bins",
        "--tests",
    ])?;
    let python = tools::ensure_python()?;
    pip(&python, JUDGES)?;
    let folder = site_packages(&python)?.join("mcdpr");
    let library = tools::target().join("release").join("lib_mcdpr.so");
    install_built(&folder, &library).map_err(|error| {
        let (folder, library) = (folder.display(), library.display());
        format!("xtask: {library} as the package {folder}: {error}")
    })?;
    judge(&python)
}

fn install_built(folder: &Path, library: &Path) -> std::io::Result<()> {
    // What an earlier version had is gone.
    if folder.exists() {
        std::fs::remove_dir_all(folder)?;
    }
    let mut left = vec![(PathBuf::from("python/mcdpr"), folder.to_owned())];
    while let Some((from, to)) = left.pop() {
        std::fs::create_dir_all(&to)?;
        for entry in std::fs::read_dir(from)? {
            let entry = entry?;
            let to = to.join(entry.file_name());
            if entry.file_type()?.is_dir() {
                left.push((entry.path(), to));
            } else {
                std::fs::copy(entry.path(), to)?;
            }
        }
    }
    std::fs::copy(library, folder.join("_mcdpr.abi3.so")).map(|_| ())
}

/// Where the environment has its packages.
fn site_packages(python: &Path) -> Result<PathBuf, String> {
    let words = "import sysconfig; print(sysconfig.get_path('platlib'))";
    let said = Command::new(python).args(["-c", words]).output();
    let said = said.map_err(|error| format!("xtask: {}: {error}", python.display()))?;
    Ok(PathBuf::from(String::from_utf8_lossy(&said.stdout).trim()))
}

/// Types and tests of the package that is installed.
fn judge(python: &Path) -> Result<(), String> {
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
pub(crate) fn pip(python: &Path, packages: &[&str]) -> Result<(), String> {
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
