//! A host that goes away, in real processes over a pseudo-terminal: Ctrl-C, a termination, a
//! terminal that hangs up, kill -9, and a laptop that sleeps. After each the robot stands, and
//! nothing moves it by itself.
#![cfg(target_os = "linux")]

use mcdpr_tests::mcdpr;
use mcdpr_tests::process::{Folder, Simulator, alone, breathe, ends_within, signal};
use serde_json::Value;
use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

/// At this speed a busy machine has half a second before the board misses its host.
const SCALE: &str = "0.2";
/// Real time in which a run must have ended: arming, a way, a stop, brakes, the answer.
const SOON: Duration = Duration::from_secs(60);

struct Scene {
    simulator: Simulator,
    folder: Folder,
}

impl Scene {
    fn new(name: &str) -> Self {
        Self {
            simulator: Simulator::start(SCALE),
            folder: Folder::new(name),
        }
    }

    fn words(&self, task: &str) -> Vec<String> {
        let record = self.folder.path().join("run").display().to_string();
        let words = [
            "run",
            task,
            "--on",
            &self.simulator.port,
            "--record",
            &record,
            "--time-scale",
            SCALE,
        ];
        words.map(str::to_owned).to_vec()
    }

    /// A short way from home and back: there is nothing else to it.
    fn short(&self) -> String {
        let path = self.folder.path().join("short.toml");
        let text = "start_mm = [255, -105, -180]\n[[leg]]\nto_mm = [265, -95, -180]\n\
                    [[leg]]\nto_mm = [255, -105, -180]\n";
        std::fs::write(&path, text).unwrap();
        path.display().to_string()
    }

    fn run_short(&self) -> Output {
        mcdpr().args(self.words(&self.short())).output().unwrap()
    }

    fn ask(&self, order: &str) -> Option<Value> {
        let words = [
            order,
            "--on",
            &self.simulator.port,
            "--time-scale",
            SCALE,
            "--json",
        ];
        let output = mcdpr().args(words).output().unwrap();
        let document = serde_json::from_slice(&output.stdout).ok();
        document.filter(|_| output.status.success())
    }

    /// Waits until an observer sees the robot move. `false` where the run ended before: a
    /// machine that is too busy to feed a robot is not what is tested here.
    fn moves(&self, run: &mut Child) -> bool {
        let deadline = Instant::now() + SOON;
        while !self.is_seen_moving() {
            assert!(Instant::now() < deadline, "the robot never moved");
            if run.try_wait().unwrap().is_some() {
                let _ = self.ask("clear");
                return false;
            }
            // Nobody moves it yet, and there is nothing to look at.
            breathe();
        }
        true
    }

    fn is_seen_moving(&self) -> bool {
        let mut command = mcdpr();
        command.args(["monitor", "--on", &self.simulator.port, "--json"]);
        command.stdin(Stdio::null()).stderr(Stdio::null());
        let mut looks_on = command.stdout(Stdio::piped()).spawn().unwrap();
        let lines = BufReader::new(looks_on.stdout.take().unwrap()).lines();
        let moves = |line: String| line.contains("\"Moving\"");
        let seen = lines.map_while(Result::ok).any(moves);
        // It may have ended by itself.
        let _ = looks_on.kill();
        looks_on.wait().unwrap();
        seen
    }

    fn moving(&self) -> Child {
        let mut command = mcdpr();
        command.args(self.words("paper:table7"));
        self.moving_by(&mut command)
    }

    fn moving_by(&self, command: &mut Command) -> Child {
        command.stdin(Stdio::null()).stdout(Stdio::null());
        command.stderr(Stdio::null());
        for _ in 0..3 {
            let mut run = command.spawn().unwrap();
            if self.moves(&mut run) {
                return run;
            }
        }
        panic!("no run is fed: is the machine too busy, or `script` of util-linux not there?");
    }

    /// The board stopped by itself, says why, and moves again only after a clear.
    fn stopped_by_itself(&self) {
        let refused = self.run_short();
        let said = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert_eq!(refused.status.code(), Some(3), "{said}");
        assert!(said.contains("L10"), "{said}");
        assert!(self.ask("clear").is_some());
    }

    /// The host stopped the robot in good order: brakes are closed and nothing is latched.
    fn stopped_in_good_order(&self, what: &str) {
        // Nobody moves it any more: a stop asks the board itself, and changes nothing.
        let reported = self.ask("stop").unwrap_or_default();
        let view = &reported["view"];
        assert_eq!(view["state"], "Disarmed", "{what}: {reported}");
        assert_eq!(view["fault"], Value::Null, "{what}: {reported}");
    }
}

/// What the run that was interrupted so ends with, and that nothing is left to be cleared.
fn ends_in_good_order(name: &str) {
    let _alone = alone();
    let scene = Scene::new(name);
    let mut run = scene.moving();
    signal(name, run.id());
    let status = ends_within(&mut run, SOON, name);
    assert_eq!(status.code(), Some(130), "{name}");
    scene.stopped_in_good_order(name);
}

#[test]
fn ctrl_c_stops_the_robot_in_good_order() {
    ends_in_good_order("INT");
}

#[test]
fn a_termination_stops_the_robot_in_good_order() {
    ends_in_good_order("TERM");
}

#[test]
fn a_terminal_that_hangs_up_stops_the_robot_in_good_order() {
    let _alone = alone();
    let scene = Scene::new("hang-up");
    let program = mcdpr().get_program().to_string_lossy().into_owned();
    let words = scene.words("paper:table7");
    let words: Vec<_> = words.iter().map(|word| format!("'{word}'")).collect();
    let pid = scene.folder.path().join("pid");
    // `script` gives the run a terminal of its own; without it the terminal is gone.
    let line = format!(
        "echo $$ > '{}'; exec '{program}' {}",
        pid.display(),
        words.join(" ")
    );
    let mut command = Command::new("script");
    command.args(["-q", "-c", &line, "/dev/null"]);
    let mut terminal = scene.moving_by(&mut command);
    let run = std::fs::read_to_string(&pid).unwrap();
    let run = std::path::PathBuf::from(format!("/proc/{}", run.trim()));
    assert!(run.exists(), "it moves");
    terminal.kill().unwrap();
    terminal.wait().unwrap();
    let deadline = Instant::now() + SOON;
    while run.exists() {
        assert!(Instant::now() < deadline, "the run outlives its terminal");
        breathe();
    }
    scene.stopped_in_good_order("a hang-up");
}

#[test]
fn l12_l15_a_killed_host_and_a_sleeping_laptop_are_survived_and_nothing_goes_on_by_itself() {
    let _alone = alone();
    let scene = Scene::new("sleep");
    let mut run = scene.moving();
    signal("KILL", run.id());
    run.wait().unwrap();
    scene.stopped_by_itself();

    // Asleep for longer than the board waits for its host: 2.1 s, at a fifth of the speed.
    let mut run = scene.moving();
    signal("STOP", run.id());
    let wakes = Instant::now() + Duration::from_secs(13);
    while Instant::now() < wakes {
        assert!(
            run.try_wait().unwrap().is_none(),
            "the run ended in its sleep"
        );
        breathe();
    }
    signal("CONT", run.id());
    let status = ends_within(&mut run, SOON, "a run that woke up");
    assert_eq!(status.code(), Some(3));
    scene.stopped_by_itself();
}

/// Whether a process has its own way to take Ctrl-C.
fn takes_interrupts(process: u32) -> bool {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap_or_default();
    let caught = status.lines().find_map(|line| line.strip_prefix("SigCgt:"));
    let caught = caught.and_then(|bits| u64::from_str_radix(bits.trim(), 16).ok());
    caught.is_some_and(|bits| bits & 0b10 != 0)
}

/// Interrupts a command once it is where it should be; returns how long it went on.
fn interrupted(mut command: Command, there: impl Fn(u32) -> bool) -> Duration {
    command.stdin(Stdio::null()).stdout(Stdio::null());
    let mut run = command.stderr(Stdio::null()).spawn().unwrap();
    let give_up = Instant::now() + SOON;
    while !there(run.id()) {
        assert!(Instant::now() < give_up, "{command:?} does not begin");
        assert!(run.try_wait().unwrap().is_none(), "{command:?} has ended");
        breathe();
    }
    let began = Instant::now();
    signal("INT", run.id());
    let status = ends_within(&mut run, SOON, "a command after Ctrl-C");
    assert_eq!(status.code(), Some(130), "{command:?}");
    began.elapsed()
}

/// Ctrl-C while poses are chosen and while places are judged: within half a second, with what was measured kept.
#[test]
fn ctrl_c_is_obeyed_within_half_a_second_while_the_program_computes() {
    let _alone = alone();
    let folder = Folder::new("interrupted");
    let data = folder.path().join("data.json");
    let mut command = mcdpr();
    command.current_dir(folder.path());
    // Choosing among so many takes minutes.
    command.args([
        "calibrate",
        "collect",
        "--target",
        "board",
        "--candidates",
        "50000",
    ]);
    command.args(["--out", "data.json"]);
    // The first pose is measured before the others are chosen.
    let took = interrupted(command, |_| data.exists());
    println!("choosing poses: {took:?}");
    assert!(took < Duration::from_millis(500), "{took:?}");
    let kept: Value = serde_json::from_str(&std::fs::read_to_string(&data).unwrap()).unwrap();
    assert_eq!(kept["poses"].as_array().map(Vec::len), Some(1));
    for words in [["workspace", "--step", "5"], ["study", "motion", "--seeds"]] {
        let mut command = mcdpr();
        command.current_dir(folder.path()).args(words);
        if words[0] == "study" {
            command.arg("500");
        }
        let took = interrupted(command, takes_interrupts);
        println!("{words:?}: {took:?}");
        assert!(took < Duration::from_millis(500), "{words:?}: {took:?}");
    }
}
