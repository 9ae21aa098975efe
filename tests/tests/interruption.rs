//! A host that goes away, in real processes over a pseudo-terminal: kill -9, and a laptop that
//! sleeps. After each the robot stands, and nothing moves it by itself.
#![cfg(target_os = "linux")]

use mcdpr_tests::mcdpr;
use mcdpr_tests::process::{Folder, Simulator, breathe, ends_within, signal};
use serde_json::Value;
use std::process::{Child, Output, Stdio};
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

    /// Waits until the robot is on its way: only then a run can be paused.
    fn until_it_moves(&self) {
        let deadline = Instant::now() + SOON;
        while self.ask("pause").is_none() {
            assert!(Instant::now() < deadline, "the robot never moved");
            breathe();
        }
        // It can go on when it has come to rest.
        while self.ask("resume").is_none() {
            assert!(Instant::now() < deadline, "the robot does not go on");
            breathe();
        }
    }

    fn moving(&self) -> Child {
        let mut command = mcdpr();
        command.args(self.words("paper:table7"));
        command.stdin(Stdio::null()).stdout(Stdio::null());
        let child = command.stderr(Stdio::null()).spawn().unwrap();
        self.until_it_moves();
        child
    }

    /// The board stopped by itself, says why, and moves again only after a clear.
    fn stopped_by_itself(&self) {
        let refused = self.run_short();
        let said = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert_eq!(refused.status.code(), Some(3), "{said}");
        assert!(said.contains("L10"), "{said}");
        assert!(self.ask("clear").is_some());
    }
}

#[test]
fn l12_l15_a_killed_host_and_a_sleeping_laptop_are_survived_and_nothing_goes_on_by_itself() {
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
