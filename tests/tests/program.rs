//! The real program as its user runs it: output, files, exit codes, bad input, two processes.

use mcdpr_tests::mcdpr;
use mcdpr_tests::process::{Folder, Simulator, breathe};
use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

/// At this speed a busy machine has a third of a second before the board misses its host.
const SCALE: &str = "0.3";

fn run(command: &mut Command) -> Output {
    command.stdin(Stdio::null()).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// What a refused command must do: say why on standard error only, and fail.
fn refused(command: &mut Command, code: i32, words: &[&str]) {
    let output = run(command);
    // The message is wrapped for reading; words may stand at a line's end.
    let flat = text(&output.stderr).replace('│', " ");
    let message = flat.split_whitespace().collect::<Vec<_>>().join(" ");
    assert_eq!(output.status.code(), Some(code), "{command:?}: {message}");
    assert_eq!(text(&output.stdout), "", "{command:?}");
    for word in words {
        assert!(
            message.contains(word),
            "{command:?}: no \"{word}\" in: {message}"
        );
    }
    assert!(
        message.contains("help:"),
        "{command:?}: no help in: {message}"
    );
}

#[test]
fn a_terminal_that_is_gone_changes_no_exit_code() {
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    let mut command = mcdpr();
    command.args(["plan", "nowhere.toml"]).stdin(Stdio::null());
    let output = command.stderr(writer).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
}

#[test]
fn without_arguments_it_shows_the_circle_and_writes_its_folder() {
    let folder = Folder::new("demo");
    let output = run(mcdpr().current_dir(folder.path()));
    assert!(output.status.success(), "{}", text(&output.stderr));
    let shown = text(&output.stdout);
    for word in [
        "3.425 / 7.044",
        "1.240 / 1.062 / 4.105",
        "0.291",
        "simulation",
        "hardware",
    ] {
        assert!(shown.contains(word), "no {word} in: {shown}");
    }
    let runs: Vec<_> = std::fs::read_dir(folder.path().join("runs"))
        .unwrap()
        .collect();
    assert_eq!(runs.len(), 1);
    let run = runs[0].as_ref().unwrap().path();
    let samples = std::fs::read_to_string(run.join("samples.csv")).unwrap();
    let mut lines = samples.lines();
    let columns = lines.next().unwrap().split(',').count();
    assert_eq!(columns, 2 + 4 * 4 + 6);
    assert!(lines.clone().count() > 11_000);
    assert!(lines.all(|line| line.split(',').count() == columns));
    let svg = std::fs::read_to_string(run.join("path.svg")).unwrap();
    assert!(
        svg.starts_with("<svg") && svg.matches("<path").count() >= 8,
        "{svg:.200}"
    );
}

#[test]
fn the_demo_gives_one_json_document_with_si_keys() {
    let folder = Folder::new("json");
    let output = run(mcdpr()
        .args(["demo", "--json", "--record"])
        .arg(folder.path()));
    assert!(output.status.success(), "{}", text(&output.stderr));
    let document: Value = serde_json::from_slice(&output.stdout).unwrap();
    let number = |path: &str| document.pointer(path).and_then(Value::as_f64);
    for (path, most) in [
        ("/path_error_m/mean", 1e-3),
        ("/path_error_m/max", 2e-3),
        ("/cable_length_error_m/mean", 1e-3),
        ("/cable_length_error_m/sd", 1e-3),
        ("/cable_length_error_m/max", 2e-3),
        ("/tension_error_n/mean_abs", 0.3),
        ("/tension_error_n/max_abs", 3.0),
        ("/as_described/path_error_m/mean", 1e-3),
    ] {
        let value = number(path).unwrap_or_else(|| panic!("no {path} in {document}"));
        assert!(value > 0.0 && value < most, "{path}: {value}");
    }
    assert!(number("/realtime_factor").unwrap() > 1.0);
    let run_folder = document["run_folder"].as_str().unwrap();
    assert_eq!(Path::new(run_folder), folder.path());
    let summary = std::fs::read_to_string(folder.path().join("summary.json")).unwrap();
    assert_eq!(serde_json::from_str::<Value>(&summary).unwrap(), document);
}

#[test]
fn the_same_seed_gives_the_same_figures() {
    let figures = |seed: &str| {
        let folder = Folder::new(&format!("seed-{seed}"));
        let output = run(mcdpr()
            .args(["demo", "--json", "--seed", seed, "--record"])
            .arg(folder.path()));
        let document: Value = serde_json::from_slice(&output.stdout).unwrap();
        document["path_error_m"].to_string()
    };
    let first = figures("5");
    assert_eq!(first, figures("5"));
    assert_ne!(first, figures("6"));
}

#[test]
fn f1_f2_k2_bad_robot_files_are_refused_with_what_where_and_remedy() {
    let folder = Folder::new("robots");
    let robot = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        path.display().to_string()
    };
    let good = std::fs::read_to_string(
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/paper-table5.toml"),
    )
    .unwrap();
    refused(
        mcdpr().args(["--robot", "no-such-robot"]),
        1,
        &["no-such-robot", "paper-table5"],
    );
    let broken = robot("broken.toml", "name = \"x\nmass");
    refused(mcdpr().args(["--robot", &broken]), 1, &["broken.toml"]);
    let unknown = robot("unknown.toml", &good.replace("mass_kg", "mas_kg"));
    refused(
        mcdpr().args(["--robot", &unknown]),
        1,
        &["mas_kg", "mass_kg", "unknown.toml"],
    );
    let negative = robot(
        "negative.toml",
        &good.replace("mass_kg = 1.4", "mass_kg = -1.4"),
    );
    refused(
        mcdpr().args(["--robot", &negative]),
        1,
        &["mass_kg", "-1.4"],
    );
    let nan = robot(
        "nan.toml",
        &good.replace("setpoint_n = 10", "setpoint_n = nan"),
    );
    refused(mcdpr().args(["--robot", &nan]), 1, &["setpoint_n"]);
}

#[test]
fn k1_bad_ports_and_tasks_are_refused_before_anything_moves() {
    let folder = Folder::new("tasks");
    let task = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        path.display().to_string()
    };
    let missing = ["run", "paper:table7", "--on", "/dev/no-such-port"];
    refused(
        mcdpr().args(missing),
        1,
        &["/dev/no-such-port", "mcdpr ports"],
    );
    let file = folder.path().join("file");
    std::fs::write(&file, "not a port").unwrap();
    refused(
        mcdpr().args(["run", "paper:table7", "--on"]).arg(&file),
        1,
        &["serial port"],
    );
    refused(
        mcdpr().args(["run", "paper:table9"]),
        1,
        &["paper:table9", "paper:table7"],
    );
    // The paper's own height needs more tension than its sensors can measure.
    refused(
        mcdpr().args(["run", "paper:table7", "--z-mm", "24"]),
        1,
        &["cannot hold its tool"],
    );
    let outside = task(
        "outside.toml",
        "start_mm = [255, -105, -180]\n[[leg]]\nto_mm = [900, 0, -180]\n",
    );
    refused(mcdpr().args(["run", &outside]), 1, &["(", "mm"]);
    let nowhere = task(
        "nowhere.toml",
        "start_mm = [255, -105, -180]\n[[leg]]\nto_mm = [255, -105, -180]\n",
    );
    refused(mcdpr().args(["run", &nowhere]), 1, &["leg 1"]);
    let fast = task(
        "fast.toml",
        "start_mm = [255, -105, -180]\n[[leg]]\nto_mm = [300, 0, -180]\nduration_s = 0.5\n",
    );
    refused(mcdpr().args(["run", &fast]), 1, &["speed"]);
    let typo = task(
        "typo.toml",
        "start_mm = [255, -105, -180]\n[[leg]]\nto = [300, 0, -180]\n",
    );
    refused(
        mcdpr().args(["run", &typo]),
        1,
        &["typo.toml", "`to`", "line 3"],
    );
    let nan = task(
        "nan.toml",
        "start_mm = [255, -105, -180]\n[[leg]]\nto_mm = [300, nan, -180]\n",
    );
    refused(mcdpr().args(["run", &nan]), 1, &["leg 1"]);
}

/// What is refused says why, and leaves nothing behind.
#[test]
fn refused_commands_leave_no_run_folder() {
    let folder = Folder::new("refused");
    for (words, code, said) in [
        ("move 0.3m -0.05m -5m", 1, "reaches"),
        ("move 10 20 furlong", 2, "not a length"),
        ("jog 0 0 0", 1, "over 0 mm/s"),
        ("commission 9", 1, "no winch 9"),
        ("calibrate winch 9", 1, "no winch 9"),
        ("calibrate collect --poses 0", 2, "must be 1 to 1000"),
        ("calibrate collect --candidates 5", 1, "5 candidates"),
        ("pick --objects 100000", 2, "must be 0 to 40"),
        ("tune tension --step-n 1000", 1, "out of range"),
    ] {
        let mut command = mcdpr();
        command.current_dir(folder.path()).args(words.split(' '));
        let output = run(&mut command);
        let flat = text(&output.stderr).replace('│', " ");
        let message = flat.split_whitespace().collect::<Vec<_>>().join(" ");
        assert_eq!(output.status.code(), Some(code), "{words}: {message}");
        assert!(message.contains(said), "{words}: {message}");
        let left = std::fs::read_dir(folder.path()).unwrap();
        let left: Vec<_> = left
            .flatten()
            .map(|entry| entry.file_name())
            .filter(|name| {
                // An empty folder of all runs is not a run.
                let runs = folder.path().join(name);
                std::fs::read_dir(runs).is_ok_and(|mut runs| runs.next().is_some())
            })
            .collect();
        assert!(left.is_empty(), "{words}: {left:?}");
    }
}

#[test]
fn wrong_usage_has_its_own_exit_code() {
    for arguments in [
        &["--no-such-flag"][..],
        &["nonsense"],
        &["run"],
        &["sim"],
        &["--seed", "x"],
    ] {
        let output = run(mcdpr().args(arguments));
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
    }
}

#[test]
fn a_dry_run_judges_and_moves_nothing() {
    let folder = Folder::new("dry");
    let output = run(mcdpr().current_dir(folder.path()).args([
        "run",
        "paper:table8",
        "--dry-run",
        "--json",
    ]));
    assert!(output.status.success(), "{}", text(&output.stderr));
    let document: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(document["duration_s"].as_f64().unwrap() > 500.0 / 45.0);
    assert!(document["tension_min_n"].as_f64().unwrap() >= 1.0);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn every_state_and_event_is_in_the_printed_table() {
    let output = run(mcdpr().args(["states", "--json"]));
    let document: Value = serde_json::from_slice(&output.stdout).unwrap();
    for state in mcdpr_firmware::supervisor::STATES {
        let row = &document[format!("{state:?}")];
        assert!(
            row["EStopPressed"].is_string() || row["EStopPressed"] == "stay",
            "{state:?}"
        );
    }
    assert_eq!(document["Holding"]["Start"], "Moving");
    assert_eq!(document["Disarmed"]["Start"], Value::Null);
    let shown = text(&run(mcdpr().arg("states")).stdout);
    for event in mcdpr_firmware::supervisor::Event::ALL {
        assert!(shown.contains(&format!("{event:?}")), "{event:?}");
    }
}

/// A short task, so that a run in real time is short, too.
fn short_task(folder: &Folder) -> String {
    let path = folder.path().join("short.toml");
    let text = "start_mm = [255, -105, -180]\n[[leg]]\nto_mm = [285, -75, -180]\n\
                [[leg]]\nto_mm = [255, -105, -180]\n";
    std::fs::write(&path, text).unwrap();
    path.display().to_string()
}

/// Whether a process has a file open; asking it this way does not get in its way.
fn has_open(process: u32, file: &str) -> bool {
    let descriptors = std::fs::read_dir(format!("/proc/{process}/fd"));
    descriptors.is_ok_and(|mut entries| {
        entries.any(|entry| {
            let link = entry.and_then(|entry| std::fs::read_link(entry.path()));
            link.is_ok_and(|target| target == Path::new(file))
        })
    })
}

/// One test, since each step needs the state that the one before leaves.
#[test]
#[cfg(target_os = "linux")]
fn l12_l14_two_processes_share_a_serial_device_and_a_killed_host_is_survived() {
    let folder = Folder::new("pty");
    let task = short_task(&folder);
    let simulator = Simulator::start(SCALE);
    let port = simulator.port.as_str();
    let record = folder.path().join("run");
    let output = run(mcdpr()
        .args([
            "run",
            &task,
            "--on",
            port,
            "--time-scale",
            SCALE,
            "--json",
            "--record",
        ])
        .arg(&record));
    assert!(output.status.success(), "{}", text(&output.stderr));
    let document: Value = serde_json::from_slice(&output.stdout).unwrap();
    // Nobody but the simulator knows where the tool truly was; the host must not pretend to.
    assert_eq!(document["path_error_m"], Value::Null);
    assert!(document["cable_length_error_m"]["max"].as_f64().unwrap() < 2e-3);
    assert!(document["tension_error_n"]["mean_abs"].as_f64().unwrap() < 0.5);

    // While one program has the port, another is refused; then the first is killed.
    let mut first = mcdpr()
        .args([
            "run",
            &task,
            "--on",
            port,
            "--time-scale",
            SCALE,
            "--record",
        ])
        .arg(&record)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let deadline = Instant::now() + Duration::from_secs(10);
    while !has_open(first.id(), port) {
        assert!(Instant::now() < deadline, "the port was never opened");
        assert!(first.try_wait().unwrap().is_none(), "the run was refused");
        breathe();
    }
    refused(
        mcdpr().args(["clear", "--on", port, "--time-scale", SCALE]),
        1,
        &["taken by another program"],
    );
    // Arming takes two seconds (at a third of the speed); the motion is under way when the host dies.
    let moving = Instant::now() + Duration::from_millis(8000);
    while Instant::now() < moving {
        assert!(
            first.try_wait().unwrap().is_none(),
            "the run ended too early"
        );
        breathe();
    }
    first.kill().unwrap();
    first.wait().unwrap();

    // The board stopped by itself and says why; it moves again only after a clear.
    let refused_run = || run(mcdpr().args(["run", &task, "--on", port, "--time-scale", SCALE]));
    let output = refused_run();
    assert_eq!(output.status.code(), Some(3), "{}", text(&output.stderr));
    assert!(
        text(&output.stderr).contains("L10"),
        "{}",
        text(&output.stderr)
    );
    let output = run(mcdpr().args(["clear", "--on", port, "--time-scale", SCALE]));
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert!(text(&output.stdout).contains("L10"));
    let output = run(mcdpr()
        .args([
            "run",
            &task,
            "--on",
            port,
            "--time-scale",
            SCALE,
            "--record",
        ])
        .arg(&record));
    assert!(output.status.success(), "{}", text(&output.stderr));
}

/// What `mcdpr ORDER --on PORT` says, as soon as there is somebody to say it to.
#[cfg(target_os = "linux")]
fn order(order: &str, port: &str) -> Value {
    let deadline = Instant::now() + Duration::from_secs(60);
    loop {
        let output = run(mcdpr().args([order, "--on", port, "--time-scale", SCALE, "--json"]));
        if output.status.success() {
            return serde_json::from_slice(&output.stdout).unwrap();
        }
        let why = text(&output.stderr);
        assert!(Instant::now() < deadline, "{order}: {why}");
        breathe();
    }
}

/// From a second terminal: pause, resume and stop reach a run on a serial device.
#[test]
#[cfg(target_os = "linux")]
fn another_terminal_pauses_resumes_and_stops_a_run() {
    let folder = Folder::new("orders");
    let simulator = Simulator::start(SCALE);
    let port = simulator.port.as_str();
    let mut first = mcdpr()
        .args([
            "run",
            "paper:table7",
            "--on",
            port,
            "--time-scale",
            SCALE,
            "--record",
        ])
        .arg(folder.path().join("run"))
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // Refused until the robot moves; then it holds on its path.
    let paused = order("pause", port);
    assert_eq!(paused["view"]["paused"], true, "{paused}");
    assert_eq!(paused["view"]["task"], "paper:table7");
    let resumed = order("resume", port);
    assert_eq!(resumed["view"]["paused"], false, "{resumed}");
    order("stop", port);
    let deadline = Instant::now() + Duration::from_secs(20);
    let status = loop {
        if let Some(status) = first.try_wait().unwrap() {
            break status;
        }
        assert!(Instant::now() < deadline, "the run goes on after a stop");
        breathe();
    };
    assert_eq!(status.code(), Some(130));
    // Nobody moves the robot now.
    refused(
        mcdpr().args(["pause", "--on", port, "--time-scale", SCALE]),
        1,
        &["no running mcdpr moves"],
    );
    // A stop still reaches the board itself.
    assert_eq!(order("stop", port)["view"]["state"], "Disarmed");
}
