//! The real program in processes of its own, over a pseudo-terminal.

use crate::mcdpr;
use serde_json::Value;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Output, Stdio};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// A folder of a test, gone with it.
#[derive(Debug)]
pub struct Folder(PathBuf);

impl Folder {
    /// A new, empty one.
    ///
    /// # Panics
    /// Where the system refuses one.
    #[must_use]
    pub fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("mcdpr-{name}-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        let made = std::fs::create_dir_all(&path);
        assert!(made.is_ok(), "{}: {made:?}", path.display());
        Self(path)
    }

    /// Where it is.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.0
    }

    /// Puts a copy of a shipped robot file here, in which these texts stand for others.
    ///
    /// # Panics
    /// Where a text is not in the file.
    #[must_use]
    pub fn robot(&self, shipped: &str, name: &str, changes: &[(&str, &str)]) -> PathBuf {
        let source = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("../robots")
            .join(format!("{shipped}.toml"));
        let mut text =
            std::fs::read_to_string(source).unwrap_or_else(|error| panic!("{shipped}: {error}"));
        for (from, to) in changes {
            assert!(text.contains(from), "{shipped} has no {from}");
            text = text.replace(from, to);
        }
        let path = self.0.join(name);
        std::fs::write(&path, text).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        path
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// What a command says, in a folder that also keeps its state.
///
/// # Panics
/// Where it cannot be started.
#[must_use]
pub fn call(arguments: &[&str], state: &Path) -> Output {
    mcdpr()
        .args(arguments)
        .env("XDG_STATE_HOME", state)
        .current_dir(state)
        .stdin(Stdio::null())
        .output()
        .unwrap_or_else(|error| panic!("{arguments:?}: {error}"))
}

/// The document of a command that must succeed, in such a folder.
///
/// # Panics
/// Where it fails or prints no document.
pub fn document(arguments: &[&str], state: &Path) -> Value {
    let output = call(&[arguments, &["--json"]].concat(), state);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{arguments:?}: {errors}");
    serde_json::from_slice(&output.stdout).unwrap_or_else(|error| panic!("{error}: {errors}"))
}

/// The words of a command that must be refused, in such a folder.
///
/// # Panics
/// Where it succeeds.
#[must_use]
pub fn refused(arguments: &[&str], state: &Path) -> String {
    let output = call(arguments, state);
    assert!(!output.status.success(), "{arguments:?}");
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// `mcdpr sim --pty` in its own process; ended with the test.
#[derive(Debug)]
pub struct Simulator {
    child: Child,
    /// The serial device that it answers on.
    pub port: String,
    /// That of its inclinometer, if it has one.
    pub imu: Option<String>,
}

impl Simulator {
    /// Starts one, so much faster than real time.
    ///
    /// # Panics
    /// Where it does not start.
    #[must_use]
    pub fn start(scale: &str) -> Self {
        Self::start_with(scale, &[])
    }

    /// The same, with more words.
    ///
    /// # Panics
    /// Where it does not start.
    #[must_use]
    pub fn start_with(scale: &str, words: &[&str]) -> Self {
        let mut command = mcdpr();
        command.args(["sim", "--pty", "--json", "--time-scale", scale]);
        command.args(words);
        command.stderr(Stdio::null());
        let (child, line) = first_line(command);
        let document: Value = serde_json::from_str(&line).unwrap_or_default();
        let named = |key: &str| document[key].as_str().map(str::to_owned);
        match named("port") {
            Some(port) => Self {
                child,
                port,
                imu: named("imu"),
            },
            None => panic!("the simulator said: {line}"),
        }
    }
}

/// Starts a program, and waits for the first line that it prints.
///
/// # Panics
/// Where it does not start.
#[must_use]
pub(crate) fn first_line(mut command: Command) -> (Child, String) {
    command.stdin(Stdio::null()).stdout(Stdio::piped());
    let mut child = match command.spawn() {
        Ok(child) => child,
        Err(error) => panic!("{command:?}: {error}"),
    };
    let mut line = String::new();
    if let Some(output) = child.stdout.take() {
        let _ = BufReader::new(output).read_line(&mut line);
    }
    (child, line)
}

impl Drop for Simulator {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Sends a signal, by name, to a process of this test.
///
/// # Panics
/// Where there is no such process.
pub fn signal(name: &str, process: u32) {
    let line = format!("kill -{name} {process}");
    let status = Command::new("sh").args(["-c", &line]).status();
    assert!(status.is_ok_and(|status| status.success()), "{line}");
}

/// Held by a test that drives a robot in real time: two robots on two processors starve each other.
pub fn alone() -> MutexGuard<'static, ()> {
    static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());
    ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Leaves the processor to others for a moment, between two looks at what one waits for.
pub fn breathe() {
    std::thread::park_timeout(Duration::from_millis(50));
}

/// Waits for a process to end.
///
/// # Panics
/// Where it does not within that time.
pub fn ends_within(child: &mut Child, most: Duration, what: &str) -> ExitStatus {
    let deadline = Instant::now() + most;
    loop {
        if let Ok(Some(status)) = child.try_wait() {
            return status;
        }
        assert!(Instant::now() < deadline, "{what} does not end");
        breathe();
    }
}
