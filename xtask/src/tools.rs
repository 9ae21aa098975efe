//! Programs of others that tests need: a browser, and foreign readers of the program's files.

use crate::run;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Foreign readers of the program's files: of records, and of plots.
const READERS: [(&str, &str); 2] = [("mcap", "mcap>=1.2,<2"), ("pypdf", "pypdf>=5,<7")];

/// The version of cargo-mutants: another one makes other mutants, and a seed would draw others.
const MUTANTS: &str = "27.1.0";

/// Makes sure that this version of cargo-mutants is there, below the target folder; gives its program.
pub(crate) fn ensure_mutants() -> Result<PathBuf, String> {
    let folder = target().join("tools");
    let program = folder.join("bin").join("cargo-mutants");
    let found = || {
        let output = Command::new(&program)
            .args(["mutants", "--version"])
            .output();
        output.is_ok_and(|output| String::from_utf8_lossy(&output.stdout).contains(MUTANTS))
    };
    if found() {
        return Ok(program);
    }
    run(Command::new(crate::cargo_program())
        .args(["install", "cargo-mutants", "--locked", "--version", MUTANTS])
        .args(["--root".as_ref(), folder.as_os_str()]))?;
    if found() {
        return Ok(program);
    }
    Err(format!(
        "xtask: cargo-mutants {MUTANTS} does not start after its installation"
    ))
}

/// Makes sure that there is a Chromium for the tests of the live page.
pub(crate) fn ensure_browser() -> Result<(), String> {
    let found = || {
        ["chromium", "chromium-browser", "google-chrome"]
            .iter()
            .any(|name| starts(name, "--version"))
    };
    if found() {
        return Ok(());
    }
    install(&["chromium"]);
    if found() {
        return Ok(());
    }
    Err(
        "xtask: Chromium is not there and apt-get did not bring it; install it, the tests of the \
         live page need it"
            .to_owned(),
    )
}

/// Makes sure that Python's readers are there, below the target folder.
pub(crate) fn ensure_readers() -> Result<(), String> {
    let python = target().join("python").join("bin").join("python");
    for (module, package) in READERS {
        let check = || works(&python, &format!("import {module}"));
        if check() {
            continue;
        }
        ensure_python()?;
        run(Command::new(&python).args(["-m", "pip", "install", "--quiet", package]))?;
        if !check() {
            return Err(format!(
                "xtask: Python's {module} cannot be imported after its installation"
            ));
        }
    }
    Ok(())
}

/// Makes sure that there is a virtual environment below the target folder; gives its Python.
pub(crate) fn ensure_python() -> Result<PathBuf, String> {
    let folder = target().join("python");
    let python = folder.join("bin").join("python");
    if works(&python, "import pip") {
        return Ok(python);
    }
    if make_venv(&folder).is_err() {
        install(&["python3-venv"]);
        make_venv(&folder)?;
    }
    Ok(python)
}

fn works(python: &Path, words: &str) -> bool {
    Command::new(python)
        .args(["-c", words])
        .stderr(Stdio::null())
        .status()
        .is_ok_and(|status| status.success())
}

fn make_venv(folder: &Path) -> Result<(), String> {
    run(Command::new("python3").args(["-m", "venv"]).arg(folder))
}

fn install(packages: &[&str]) {
    // What failed shows when the program is looked for again.
    let _ = run(Command::new("apt-get").args(["update", "-qq"]));
    let mut command = Command::new("apt-get");
    command.args(["install", "-y", "-qq", "--no-install-recommends"]);
    let _ = run(command
        .args(packages)
        .env("DEBIAN_FRONTEND", "noninteractive"));
}

fn starts(program: &str, argument: &str) -> bool {
    Command::new(program)
        .arg(argument)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .is_ok_and(|status| status.success())
}

pub(crate) fn target() -> PathBuf {
    std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| "target".into(), PathBuf::from)
}
