//! Runs the workspace's test programs, several at a time: many of them wait, for a board in real time
//! or for a browser.

use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::Mutex;
use std::sync::mpsc;

/// Programs that measure reaction times, or whose boards run by the clock: nothing runs beside them. They come last.
const ALONE: [&str; 10] = [
    "two_ports",
    "hil",
    "page",
    "cockpit",
    "program",
    "cockpit_runs",
    "cockpit_charts",
    "cockpit_setup",
    "playground",
    "tracked_port",
];
/// Programs that mostly wait, for a robot that is slower than real time: one at a time beside the others, which leave the
/// processors to them. The longest first.
const WAITING: [&str; 3] = ["camera", "interruption", "power_port"];
/// Programs that take longest, in this order: they begin first, so that none of them is left at the end.
const LONG: [&str; 12] = [
    "docs",
    "picking",
    "calibration",
    "collect",
    "slip",
    "mcdpr_calibration",
    "doctor",
    "own_frame",
    "dry_run",
    "power",
    "any_robot",
    "tracking",
];
/// A program that runs once more: with this variable of the environment, and these of its tests. The chip is then in
/// another process, behind the wires of a board in the loop (docs/hil.md).
const AGAIN: (&str, (&str, &str), [&str; 2]) = (
    "chip_faults",
    ("MCDPR_IN_THE_LOOP", "emulated"),
    ["reactions::d1", "refusals::"],
);
/// Programs at a time: their own threads use all processors already.
const AT_A_TIME: usize = 2;
/// What starts those beside which others wait: they get the processors that nobody else wants.
const LAST: [&str; 3] = ["nice", "-n", "19"];

/// A test program.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Program {
    name: String,
    file: PathBuf,
    /// The folder of its package, in which it runs.
    folder: PathBuf,
}

/// Builds the test programs with these arguments of `cargo test`, and runs them all.
///
/// # Errors
/// Where the build fails; the names of the programs that failed.
pub(crate) fn run(cargo: &str, arguments: &[&str], firmware: &Path) -> Result<(), String> {
    let programs = built(cargo, arguments)?;
    let is_alone = |program: &Program| ALONE.contains(&program.name.as_str());
    let (alone, others): (Vec<_>, Vec<_>) = programs.into_iter().partition(is_alone);
    let again = others.iter().find(|program| program.name == AGAIN.0);
    let again = again.cloned();
    let is_waiting = |program: &Program| WAITING.contains(&program.name.as_str());
    let (waiting, busy): (Vec<_>, Vec<_>) = others.into_iter().partition(is_waiting);
    let waiting = Lane::new(waiting, &WAITING, &[]);
    let busy = Lane::new(busy, &LONG, &LAST);
    let mut lanes = vec![&waiting];
    lanes.extend([&busy; AT_A_TIME]);
    let mut failed = beside(&lanes, firmware);
    if let Some(program) = again {
        let (_, (name, value), tests) = AGAIN;
        let mut command = command(&program, firmware, &[]);
        let output = crate::times::timed("chip_faults in the loop", || {
            command.env(name, value).args(tests).output()
        });
        failed.extend(report(&program, &output));
    }
    for program in alone {
        let output = start(&program, firmware, &[]);
        failed.extend(report(&program, &output));
    }
    if failed.is_empty() {
        return Ok(());
    }
    Err(format!("xtask: tests failed in {}", failed.join(", ")))
}

/// Programs that wait for their turn.
struct Lane {
    /// Taken from the end.
    left: Mutex<Vec<Program>>,
    /// What each is started by.
    by: &'static [&'static str],
}

impl Lane {
    /// Those that `first` names come first, in that order.
    fn new(mut programs: Vec<Program>, first: &[&str], by: &'static [&'static str]) -> Self {
        let place = |program: &Program| first.iter().position(|name| *name == program.name);
        programs.sort_by_key(|program| std::cmp::Reverse(place(program).unwrap_or(first.len())));
        Self {
            left: Mutex::new(programs),
            by,
        }
    }

    fn next(&self) -> Option<Program> {
        self.left.lock().ok()?.pop()
    }
}

/// Runs the programs of these lanes beside each other; the names of those that failed.
fn beside(lanes: &[&Lane], firmware: &Path) -> Vec<String> {
    let (send, receive) = mpsc::channel();
    std::thread::scope(|scope| {
        for lane in lanes {
            let send = send.clone();
            scope.spawn(move || {
                while let Some(program) = lane.next() {
                    let output = start(&program, firmware, lane.by);
                    if send.send((program, output)).is_err() {
                        return;
                    }
                }
            });
        }
        drop(send);
        let done = receive.into_iter();
        done.filter_map(|(program, output)| report(&program, &output))
            .collect()
    })
}

fn start(program: &Program, firmware: &Path, by: &[&str]) -> std::io::Result<Output> {
    let mut command = command(program, firmware, by);
    crate::times::timed(&program.name, || command.output())
}

/// What starts a program, by way of these words.
fn command(program: &Program, firmware: &Path, by: &[&str]) -> Command {
    let mut command = match by.split_first() {
        Some((first, words)) => {
            let mut command = Command::new(first);
            command.args(words).arg(&program.file);
            command
        }
        None => Command::new(&program.file),
    };
    command
        .current_dir(&program.folder)
        .env("CARGO_MANIFEST_DIR", &program.folder)
        .env("MCDPR_FIRMWARE", firmware)
        .stdin(Stdio::null());
    command
}

/// Prints what a program said; its name if it failed.
fn report(program: &Program, output: &std::io::Result<Output>) -> Option<String> {
    let name = &program.name;
    match output {
        Err(error) => {
            eprintln!("xtask: {name} cannot be started: {error}");
            Some(name.clone())
        }
        Ok(output) => {
            println!("xtask: {name} ({})", program.file.display());
            print!("{}", String::from_utf8_lossy(&output.stdout));
            eprint!("{}", String::from_utf8_lossy(&output.stderr));
            (!output.status.success()).then(|| format!("{name} ({})", output.status))
        }
    }
}

fn built(cargo: &str, arguments: &[&str]) -> Result<Vec<Program>, String> {
    let mut command = Command::new(cargo);
    command.args(arguments);
    command.args(["--no-run", "--message-format=json-render-diagnostics"]);
    eprintln!("xtask: cargo {} --no-run", arguments.join(" "));
    command.stderr(Stdio::inherit());
    let output = crate::times::timed("the tests are built", || command.output());
    let output = output.map_err(|error| format!("xtask: cargo cannot be started: {error}"))?;
    if !output.status.success() {
        return Err(format!("xtask: the tests do not build: {}", output.status));
    }
    let messages = String::from_utf8_lossy(&output.stdout);
    let programs: Vec<_> = messages.lines().filter_map(program).collect();
    if programs.is_empty() {
        return Err("xtask: cargo names no test program".to_owned());
    }
    Ok(programs)
}

/// The test program that a message of cargo names.
fn program(message: &str) -> Option<Program> {
    // Of the message's own keys; the first `name` is that of the target.
    let text = |key: &str| {
        let (_, rest) = message.split_once(&format!("\"{key}\":\""))?;
        rest.split('"').next()
    };
    if !message.contains("\"reason\":\"compiler-artifact\"") {
        return None;
    }
    let (_, target) = message.split_once("\"target\":{")?;
    let (_, name) = target.split_once("\"name\":\"")?;
    let profile = message.split_once("\"profile\":{")?.1.split('}').next()?;
    if !profile.contains("\"test\":true") {
        return None;
    }
    Some(Program {
        name: name.split('"').next()?.to_owned(),
        file: text("executable")?.into(),
        folder: Path::new(text("manifest_path")?).parent()?.to_owned(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_longest_programs_come_first_and_give_way() {
        let program = |name: &str| Program {
            name: name.to_owned(),
            file: "/a".into(),
            folder: "/b".into(),
        };
        let all = ["chip", "short", "docs", "brief"].map(program);
        let lane = Lane::new(all.to_vec(), &["docs", "chip"], &LAST);
        let order: Vec<_> = std::iter::from_fn(|| lane.next()).collect();
        assert_eq!(order[..2], ["docs", "chip"].map(program));
        assert_eq!(order.len(), 4);
        let command = command(&order[0], Path::new("/f"), lane.by);
        assert_eq!(command.get_program(), "nice");
        assert_eq!(command.get_args().last(), Some("/a".as_ref()));
    }

    #[test]
    fn lists_name_programs_that_are_there() {
        let tests = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/tests");
        for name in ALONE.iter().chain(&WAITING).chain(&LONG) {
            // Unit tests of a crate.
            let is_crate = *name == "mcdpr_calibration";
            let is_there = tests.join(format!("{name}.rs")).is_file();
            assert!(is_crate || is_there, "{name}");
        }
    }

    #[test]
    fn messages_of_cargo_name_test_programs() {
        let message = |test: bool, executable: &str| {
            format!(
                "{{\"reason\":\"compiler-artifact\",\"package_id\":\"x\",\"manifest_path\":\"/a/tests/Cargo.toml\",\
                 \"target\":{{\"kind\":[\"test\"],\"name\":\"page\",\"doc\":false,\"test\":true}},\
                 \"profile\":{{\"opt_level\":\"3\",\"test\":{test}}},\"executable\":{executable},\"fresh\":true}}"
            )
        };
        let found = program(&message(true, "\"/a/target/page-1\"")).unwrap();
        assert_eq!(
            (found.name.as_str(), found.file),
            ("page", "/a/target/page-1".into())
        );
        assert_eq!(found.folder, Path::new("/a/tests"));
        // The program itself, a library, another message.
        assert_eq!(program(&message(false, "\"/a/target/page-1\"")), None);
        assert_eq!(program(&message(true, "null")), None);
        assert_eq!(
            program("{\"reason\":\"build-finished\",\"success\":true}"),
            None
        );
    }
}
