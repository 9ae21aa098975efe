//! What the system tests share. The tests themselves are in `tests/tests`.

pub mod chip;
pub mod fuzz;
pub mod in_the_loop;
pub mod process;

use std::path::PathBuf;
use std::process::Command;

/// The real `mcdpr` program, from the build that the tests are part of.
///
/// # Panics
/// Where it was not built: a test that cannot start the program must not pass.
#[must_use]
pub fn mcdpr() -> Command {
    let path = program();
    assert!(
        path.is_file(),
        "{} is not there: run `cargo xtask test`, or build the program first with \
         `cargo build --release -p mcdpr`",
        path.display()
    );
    let mut command = Command::new(path);
    // Journals and lengths of simulated boards must not reach the user's, nor another test's.
    let state = std::env::temp_dir().join(format!("mcdpr-state-{}", std::process::id()));
    command.env("XDG_STATE_HOME", state);
    command
}

fn program() -> PathBuf {
    // target/PROFILE/deps/TEST next to target/PROFILE/mcdpr
    let mut path = std::env::current_exe().unwrap_or_default();
    path.pop();
    path.pop();
    path.join(format!("mcdpr{}", std::env::consts::EXE_SUFFIX))
}
