//! Cost of recording and viewing: `cargo bench -p mcdpr --bench seeing`. Prints each figure as a
//! ratio of two times of the same run, with its bound, and fails if a bound is exceeded.
//!
//! - recording: processor time of the recording thread over the time that the run lasts, at full
//!   rate;
//! - page: processor time of the whole program over the wall's, while it serves one viewer at 60 Hz,
//!   feed included; and the same with the simulated camera's pictures;
//! - replay: time that the run lasts over processor time of its replay, loading included. It is one
//!   thread, so on an idle machine the wall's time is the same; it is printed, too.

use mcdpr::experiment::{Experiment, SimulatedRobot};
use mcdpr::machine::{Controller, Mismatch};
use mcdpr::motion::{Model, Task};
use mcdpr::record::events::{Patience, Watcher};
use mcdpr::record::{EventBus, FILE_NAME, Machine, Recording, RunEvent, Scenario};
use mcdpr::replay::replay;
use mcdpr::robot::Robot;
use mcdpr::serve::{CameraWatcher, Desk, FeedWatcher, Server};
use std::io::Write as _;
use std::net::TcpStream;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// Repetitions; the best counts, because other programs only ever add.
const TIMES: usize = 3;

struct Keep(Arc<Mutex<Vec<RunEvent>>>);

impl Watcher for Keep {
    fn see(&mut self, event: &RunEvent) {
        if let Ok(mut kept) = self.0.lock() {
            kept.push(event.clone());
        }
    }
}

struct NoOrders;

impl Desk for NoOrders {
    fn order(&self, _: &str, _: &serde_json::Value) -> Result<serde_json::Value, String> {
        Err("a benchmark obeys nobody".to_owned())
    }

    fn orders(&self) -> Vec<&'static str> {
        Vec::new()
    }
}

fn scenario(model: &Model) -> Scenario {
    let mismatch = Mismatch::realistic();
    let machine = Machine::Simulated {
        mismatch,
        seed: 1,
        firmware: None,
    };
    let height_m = -0.1 + model.robot().tool.tcp_in_platform_m.z;
    let task = mcdpr::record::task_source("paper:table7", height_m);
    mcdpr::record::starting_now("paper-optimistic", task, 1, machine)
}

/// The record of the paper's circle, and its duration, s.
fn run_events(model: &Model) -> (Vec<RunEvent>, f64) {
    let scenario = scenario(model);
    let kept = Arc::new(Mutex::new(Vec::new()));
    let mut events = EventBus::default();
    events.add(Keep(Arc::clone(&kept)), Patience::Wait).unwrap();
    let task = Task::built_in("paper:table7", scenario.task.tool_z_m).unwrap();
    Experiment::new(model, task)
        .recorded_by(&events)
        .simulate(&SimulatedRobot::new(Mismatch::realistic(), 1))
        .unwrap();
    events.finish();
    let all = std::mem::take(&mut *kept.lock().unwrap());
    let last = all.iter().rev().find_map(|event| match event {
        RunEvent::Wire { frame, .. } => Some(frame.time_us as f64 * 1e-6),
        _ => None,
    });
    (all, last.unwrap())
}

fn recording(model: &Model, all: &[RunEvent], lasts_s: f64, path: &std::path::Path) -> f64 {
    let mut best = f64::MAX;
    for _ in 0..TIMES {
        // A record is never written over.
        let _ = std::fs::remove_file(path);
        let mut watcher = Recording::create(path, &scenario(model), Some(model.clone())).unwrap();
        let began_s = thread_s();
        for event in all {
            watcher.see(event);
        }
        watcher.end();
        best = best.min(thread_s() - began_s);
    }
    best / lasts_s
}

/// Processor time of this thread, s.
fn thread_s() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    let nanoseconds = text.split_whitespace().next();
    let number: Option<f64> = nanoseconds.and_then(|field| field.parse().ok());
    number.unwrap_or(f64::NAN) * 1e-9
}

/// Processor time of this process, s.
fn processor_s() -> f64 {
    let text = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let after = text.rsplit(')').next().unwrap_or_default();
    let fields: Vec<_> = after.split_whitespace().collect();
    // utime and stime, in hundredths of a second.
    let ticks = |index: usize| fields.get(index).and_then(|f| f.parse::<f64>().ok());
    (ticks(11).unwrap_or(f64::NAN) + ticks(12).unwrap_or(f64::NAN)) * 0.01
}

/// Share of a core while one viewer looks on for some seconds, and pictures a second.
fn page(model: &Model, all: &[RunEvent], with_camera: bool) -> (f64, f64) {
    let feed = mcdpr::serve::feed();
    let server = Server::start(0, None, model.robot(), feed.clone(), Arc::new(NoOrders)).unwrap();
    let stream = TcpStream::connect(("127.0.0.1", server.port())).unwrap();
    let address = format!("ws://127.0.0.1:{}/ws", server.port());
    let (mut socket, _) = tungstenite::client(address.as_str(), stream).unwrap();
    let viewer = std::thread::spawn(move || {
        let mut count = 0_u32;
        while let Ok(message) = socket.read() {
            count += u32::from(message.is_text());
        }
        count
    });
    let mut watcher = FeedWatcher::new(feed.clone(), model.clone());
    let mut camera = CameraWatcher::new(feed, model.robot(), 1);
    let (before, began) = (processor_s(), Instant::now());
    let lasts = Duration::from_secs(8);
    for event in all {
        let time_us = match event {
            RunEvent::Wire { frame, .. } => frame.time_us,
            RunEvent::Plan { time_us, .. }
            | RunEvent::Truth { time_us, .. }
            | RunEvent::Order { time_us, .. }
            | RunEvent::Picture { time_us, .. }
            | RunEvent::Remark { time_us, .. } => *time_us,
        };
        let due = Duration::from_micros(time_us);
        if due > lasts {
            break;
        }
        if let Some(ahead) = due.checked_sub(began.elapsed())
            && ahead > Duration::from_millis(1)
        {
            std::thread::sleep(ahead);
        }
        watcher.see(event);
        if with_camera {
            camera.see(event);
        }
    }
    let took_s = began.elapsed().as_secs_f64();
    let share = (processor_s() - before) / took_s;
    drop(server);
    let pictures = f64::from(viewer.join().unwrap_or(0)) / took_s;
    (share, pictures)
}

fn main() -> std::process::ExitCode {
    let model = Model::new(&Robot::built_in("paper-optimistic").unwrap()).unwrap();
    let folder = std::env::temp_dir().join(format!("mcdpr-bench-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join(FILE_NAME);
    let (all, lasts_s) = run_events(&model);
    let record = recording(&model, &all, lasts_s, &path) * 100.0;
    let (mut factor, mut by_wall): (f64, f64) = (0.0, 0.0);
    for _ in 0..TIMES {
        let (began, began_s) = (Instant::now(), thread_s());
        let run = mcdpr::record::load(&folder).unwrap();
        let proof = replay(&run, &Controller::InProcess).unwrap();
        assert!(proof.whole && proof.core_bytes.is_some());
        factor = factor.max(lasts_s / (thread_s() - began_s));
        by_wall = by_wall.max(lasts_s / began.elapsed().as_secs_f64());
    }
    let (share, pictures) = page(&model, &all, false);
    let (with_camera, _) = page(&model, &all, true);
    let (share, with_camera) = (share * 100.0, with_camera * 100.0);
    let _ = std::fs::remove_dir_all(&folder);
    let mut out = std::io::stdout();
    let mut good = true;
    let mut print_row = |what: &str, value: f64, unit: &str, bound: &str, holds: bool| {
        good &= holds;
        let word = if holds { "holds" } else { "BROKEN" };
        let _ = writeln!(
            out,
            "{what:<42}{value:>8.2} {unit:<18} bound {bound:<8} {word}"
        );
    };
    print_row(
        "recording a run at full rate",
        record,
        "% of a core",
        "2 %",
        record < 2.0,
    );
    print_row(
        "page: one viewer, feed included",
        share,
        "% of a core",
        "10 %",
        share < 10.0,
    );
    print_row(
        "the same with the simulated camera",
        with_camera,
        "% of a core",
        "none",
        true,
    );
    print_row(
        "page: messages to the viewer",
        pictures,
        "a second",
        "50",
        pictures > 50.0,
    );
    print_row(
        "replay, host, core and plant",
        factor,
        "times real time",
        "50",
        factor > 50.0,
    );
    print_row(
        "the same by the wall's time",
        by_wall,
        "times real time",
        "none",
        true,
    );
    if good {
        std::process::ExitCode::SUCCESS
    } else {
        std::process::ExitCode::FAILURE
    }
}
