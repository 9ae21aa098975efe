//! Checks that dependencies have the same features for the program alone and for the tests, so that they
//! are built once for both commands of the README.

use std::collections::BTreeSet;
use std::process::Command;

/// Compares the dependencies of the program with those of the whole workspace. `features` are those of the tests.
///
/// # Errors
/// The dependencies that would be built twice.
pub(crate) fn check(cargo: &str, features: &str) -> Result<(), String> {
    let program = tree(cargo, &["-p", "mcdpr", "-e", "normal,build"])?;
    let all = [
        "--workspace",
        "--features",
        features,
        "-e",
        "normal,build,dev",
    ];
    let all = tree(cargo, &all)?;
    let twice: Vec<_> = program.difference(&all).map(String::as_str).collect();
    if twice.is_empty() {
        return Ok(());
    }
    Err(format!(
        "xtask: these have other features in the tests, and would be built twice with all that needs them; add \
         the features to unified/Cargo.toml:\n{}",
        twice.join("\n")
    ))
}

/// Packages and their features, of this machine's target.
fn tree(cargo: &str, of: &[&str]) -> Result<BTreeSet<String>, String> {
    let mut command = Command::new(cargo);
    command.args([
        "tree",
        "--locked",
        "--prefix",
        "none",
        "--no-dedupe",
        "-f",
        "{p} [{f}]",
    ]);
    let output = command.args(of).output();
    let output = output.map_err(|error| format!("xtask: cargo cannot be started: {error}"))?;
    if !output.status.success() {
        return Err(format!(
            "xtask: cargo tree: {}",
            String::from_utf8_lossy(&output.stderr)
        ));
    }
    let text = String::from_utf8_lossy(&output.stdout);
    Ok(text.lines().map(str::to_owned).collect())
}
