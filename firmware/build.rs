//! Provides the linker's memory map and the git hash, for the board only.

use std::env;
use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo:rerun-if-changed=build.rs");
    let on_chip = env::var("CARGO_CFG_TARGET_OS").is_ok_and(|os| os == "none");
    if !on_chip || env::var_os("CARGO_FEATURE_BOARD").is_none() {
        return Ok(());
    }
    let root = PathBuf::from(env::var("CARGO_MANIFEST_DIR")?).join("..");
    let out = PathBuf::from(env::var("OUT_DIR")?);
    let map = root.join("memory.x");
    println!("cargo:rerun-if-changed={}", map.display());
    fs::copy(&map, out.join("memory.x")).map_err(|error| {
        format!(
            "{}: {error}; the board's memory map is missing",
            map.display()
        )
    })?;
    println!("cargo:rustc-link-search={}", out.display());

    println!("cargo:rerun-if-env-changed=MCDPR_GIT_HASH");
    let hash = env::var("MCDPR_GIT_HASH").ok().or_else(|| git_hash(&root));
    println!(
        "cargo:rustc-env=MCDPR_GIT_HASH={}",
        hash.unwrap_or_default()
    );
    Ok(())
}

/// The commit that is checked out; `None` outside of git, as in an unpacked archive.
fn git_hash(root: &Path) -> Option<String> {
    let git = |arguments: &[&str]| {
        let output = Command::new("git")
            .current_dir(root)
            .args(arguments)
            .output();
        let output = output.ok().filter(|output| output.status.success())?;
        Some(String::from_utf8(output.stdout).ok()?.trim().to_owned())
    };
    // The log of HEAD grows with every commit and every switch of branch.
    let log = git(&["rev-parse", "--git-path", "logs/HEAD"])?;
    let log = root.join(log);
    if log.exists() {
        println!("cargo:rerun-if-changed={}", log.display());
    }
    git(&["rev-parse", "--short=8", "HEAD"])
}
