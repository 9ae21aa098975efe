//! Recorded runs: what is in them, that they survive crashes and full disks, and that host and core
//! do the same again on their bytes.

use mcdpr::experiment::{Experiment, SimulatedRobot, SimulatedRun};
use mcdpr::machine::{Controller, Mismatch};
use mcdpr::motion::{Model, Task};
use mcdpr::record::events::{Patience, Watcher};
use mcdpr::record::mcap;
use mcdpr::record::{
    EventBus, FILE_NAME, LoadError, Machine, RecordedRun, Recording, RunEvent, Scenario, TaskSource,
};
use mcdpr::replay::{ReplayError, replay};
use mcdpr::robot::Robot;
use mcdpr_protocol::SessionId;
use mcdpr_tests::mcdpr;
use mcdpr_tests::process::Folder;
use std::sync::{Arc, Mutex, OnceLock};

const TASK: &str = "start_mm = [255, -105, -180]\n[[leg]]\nto_mm = [275, -85, -180]\n";

fn model() -> Model {
    Model::new(&Robot::built_in("paper-table5").unwrap()).unwrap()
}

fn scenario() -> Scenario {
    let mismatch = Mismatch::realistic();
    let machine = Machine::Simulated {
        mismatch,
        seed: 3,
        firmware: None,
    };
    let task = TaskSource {
        name: "short.toml".to_owned(),
        text: Some(TASK.to_owned()),
        tool_z_m: -0.18,
    };
    mcdpr::record::starting_now("paper-table5", task, 11, machine)
}

/// Runs the short task, seen by an event bus.
fn run(events: &EventBus) -> SimulatedRun {
    let task = Task::parse(TASK, "short.toml".into()).unwrap();
    Experiment::new(&model(), task)
        .session(SessionId(11))
        .recorded_by(events)
        .simulate(&SimulatedRobot::new(Mismatch::realistic(), 3))
        .unwrap()
}

/// A recorded run's file, recorded once for all tests.
fn recorded() -> &'static [u8] {
    static BYTES: OnceLock<Vec<u8>> = OnceLock::new();
    BYTES.get_or_init(|| {
        let folder = Folder::new("record-once");
        let path = folder.path().join(FILE_NAME);
        let recording = Recording::create(&path, &scenario(), Some(model())).unwrap();
        let summary = recording.summary();
        let mut events = EventBus::default();
        events.add(recording, Patience::Wait).unwrap();
        run(&events);
        events.finish();
        assert!(summary.lock().unwrap().complete);
        std::fs::read(path).unwrap()
    })
}

fn load(name: &str, bytes: &[u8]) -> Result<RecordedRun, LoadError> {
    let folder = Folder::new(name);
    std::fs::write(folder.path().join(FILE_NAME), bytes).unwrap();
    mcdpr::record::load(folder.path())
}

#[test]
fn a_run_replays_bit_by_bit_host_and_core() {
    let run = load("replay", recorded()).unwrap();
    assert!(run.damage.is_none());
    let proof = replay(&run, &Controller::InProcess).unwrap();
    assert!(
        proof.whole && proof.host_bytes.is_some_and(|b| b > 3000),
        "{proof:?}"
    );
    assert!(
        proof.core_bytes.is_some_and(|bytes| bytes > 50_000),
        "{proof:?}"
    );
}

#[test]
fn a_task_in_g_code_replays_by_its_recorded_text() {
    let folder = Folder::new("g-code");
    let task = folder.path().join("part.nc");
    std::fs::write(&task, "G21 G90\nG0 X300 Y0 Z-200\nG1 X320 F600\nG1 Y20\n").unwrap();
    let call = |words: &[&str]| {
        let output = mcdpr().args(words).current_dir(folder.path()).output();
        let output = output.unwrap();
        let message = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{words:?}: {message}");
        String::from_utf8_lossy(&output.stdout).into_owned()
    };
    call(&["run", "part.nc", "--record", "kept", "--json"]);
    // The record has the text: the file is not needed.
    std::fs::remove_file(&task).unwrap();
    let said: serde_json::Value =
        serde_json::from_str(&call(&["replay", "kept", "--json"])).unwrap();
    let bytes = said["host_bytes"].as_u64();
    assert!(bytes.is_some_and(|bytes| bytes > 1000), "{said}");
}

#[test]
fn a_changed_byte_in_either_direction_is_found() {
    use mcdpr::link::Direction;
    let whole = load("changed", recorded()).unwrap();
    let middle = whole.frames.len() / 2;
    // What the host sent differs.
    let mut run = whole.clone();
    let sent = run.frames.iter_mut().skip(middle);
    let sent = sent.filter(|f| f.direction == Direction::ToBoard);
    sent.take(1).for_each(|frame| frame.bytes[2] ^= 1);
    let error = replay(&run, &Controller::InProcess).unwrap_err();
    assert!(
        matches!(error, ReplayError::Differs { who: "host", .. }),
        "{error}"
    );
    // What the core sent differs, in a telemetry byte on which the host's doings do not depend.
    let mut run = whole.clone();
    let answers = run.frames.iter_mut().rev().skip(50);
    let answers = answers.filter(|f| f.direction == Direction::ToHost && !f.bytes.is_empty());
    answers.take(1).for_each(|frame| frame.bytes[0] ^= 1);
    let changed = replay(&run, &Controller::InProcess);
    assert!(
        matches!(changed, Err(ReplayError::Differs { .. })),
        "{:?}",
        changed.err()
    );
    // Another machine than the recorded one.
    let mut run = whole;
    run.scenario.machine = Machine::Simulated {
        mismatch: Mismatch::default(),
        seed: 3,
        firmware: None,
    };
    let error = replay(&run, &Controller::InProcess).unwrap_err();
    assert!(
        matches!(error, ReplayError::Differs { who: "core", .. }),
        "{error}"
    );
}

#[test]
fn the_record_holds_what_the_host_measured_and_what_was_true() {
    let live = run(&EventBus::default());
    let run = load("contents", recorded()).unwrap();
    let measured: Vec<_> = run
        .ticks()
        .into_iter()
        .filter(|t| t.path_s.is_some())
        .collect();
    let wanted: Vec<_> = live
        .run
        .samples
        .iter()
        .filter(|s| s.path_s.is_some())
        .collect();
    // The record goes on after the motion's last sample that the host kept.
    assert!(measured.len() >= wanted.len() && wanted.len() > 900);
    for (tick, sample) in measured.iter().zip(wanted) {
        assert_eq!(tick.lengths_m, sample.lengths_m);
        assert_eq!(tick.tensions_n, sample.tensions_n);
        // The set-points on the wire are the plan, but for the join to where the board holds.
        let state = live.run.plan.state(tick.path_s.unwrap()).unwrap();
        for (planned, wanted) in tick.planned.iter().zip(&state.paid_out_m) {
            assert!(
                (planned.length_m - wanted).abs() < 1.1e-3,
                "{planned:?} {wanted}"
            );
        }
    }
    let plan = run.plan.as_ref().unwrap();
    assert!((plan.duration_s - live.run.plan.timed.duration_s()).abs() < 1e-9);
    assert!(run.truth.len() > 100);
    let last = run.truth.last().unwrap();
    assert!((last.tool_m[0] - 0.275).abs() < 5e-3, "{last:?}");
    let states: Vec<_> = run
        .changes()
        .into_iter()
        .map(|change| change.text)
        .collect();
    for state in ["Disarmed", "Arming", "Holding", "Moving"] {
        assert!(states.iter().any(|s| s == state), "{state} in {states:?}");
    }
    assert!(
        run.log.iter().any(|line| line.text == "state Moving"),
        "{:?}",
        run.log
    );
}

#[test]
fn a_record_without_its_end_is_read_and_replayed_as_far_as_it_goes() {
    let bytes = recorded();
    let run = load("cut", &bytes[..bytes.len() * 2 / 3]).unwrap();
    assert!(matches!(run.damage, Some(mcap::Damage::Truncated { .. })));
    assert!(run.frames.len() > 100 && run.gaps == 0);
    let proof = replay(&run, &Controller::InProcess).unwrap();
    assert!(!proof.whole);
    // In front of the first chunk there is the scenario already; without it, the reason is reported.
    let error = load("tiny", &bytes[..100]).unwrap_err();
    assert!(matches!(error, LoadError::Other { .. }), "{error}");
    let error = load("other", b"PNG").unwrap_err();
    assert!(matches!(error, LoadError::Unreadable { .. }), "{error}");
}

#[test]
fn a_corrupt_chunk_is_left_out_and_the_hole_is_noticed() {
    let mut bytes = recorded().to_vec();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 0xFF;
    let run = load("corrupt", &bytes).unwrap();
    assert!(matches!(run.damage, Some(mcap::Damage::Corrupt { .. })));
    assert!(
        matches!(replay(&run, &Controller::InProcess), Err(ReplayError::Gaps { missing }) if missing > 0)
    );
}

#[test]
fn a_record_of_another_version_is_refused_with_both_versions() {
    let mut bytes = recorded().to_vec();
    let now = mcdpr::record::protocol_version();
    let place = bytes.windows(8).position(|w| w == b"protocol").unwrap() + 8 + 4;
    assert_eq!(&bytes[place..place + now.len()], now.as_bytes());
    bytes[place] = b'9';
    let text = load("version", &bytes).unwrap_err().to_string();
    assert!(
        text.contains("protocol 9.") && text.contains(&now),
        "{text}"
    );
}

/// A disk that is full after some bytes.
struct Disk {
    left: usize,
}

impl std::io::Write for Disk {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        if self.left < bytes.len() {
            return Err(std::io::Error::from(std::io::ErrorKind::StorageFull));
        }
        self.left -= bytes.len();
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

#[test]
fn f8_a_full_disk_ends_the_record_and_not_the_motion() {
    let disk = Disk { left: 300_000 };
    let recording = Recording::start(disk, &scenario(), None, |_| Ok(())).unwrap();
    let summary = recording.summary();
    let mut events = EventBus::default();
    events.add(recording, Patience::Wait).unwrap();
    let with = run(&events);
    events.finish();
    let summary = summary.lock().unwrap();
    assert!(
        summary.stopped.is_some() && !summary.complete,
        "{summary:?}"
    );
    assert_eq!(with.run.samples, run(&EventBus::default()).run.samples);
}

#[test]
fn a_watcher_that_does_not_keep_up_loses_entries_and_nothing_else() {
    struct Stuck {
        gate: Arc<Mutex<()>>,
        seen: Arc<Mutex<usize>>,
    }
    impl Watcher for Stuck {
        fn see(&mut self, _: &RunEvent) {
            drop(self.gate.lock());
            *self.seen.lock().unwrap() += 1;
        }
    }
    let gate = Arc::new(Mutex::new(()));
    let seen = Arc::new(Mutex::new(0));
    let mut events = EventBus::default();
    let stuck = Stuck {
        gate: Arc::clone(&gate),
        seen: Arc::clone(&seen),
    };
    let lost = events.add(stuck, Patience::Drop).unwrap();
    let closed = gate.lock().unwrap();
    let with = run(&events);
    assert!(lost.load(std::sync::atomic::Ordering::Relaxed) > 0);
    drop(closed);
    events.finish();
    assert!(*seen.lock().unwrap() > 1000);
    assert_eq!(with.run.samples, run(&EventBus::default()).run.samples);
}

/// Reads a record as another program would and prints what it found.
const READER: &str = r#"
import json, sys
from mcap.reader import make_reader, NonSeekingReader
whole, cut = sys.argv[1:3]
found = {"topics": {}, "schemas": [], "bad": 0}
with open(whole, "rb") as file:
    reader = make_reader(file)
    summary = reader.get_summary()
    found["profile"] = reader.get_header().profile
    found["counted"] = summary.statistics.message_count
    found["chunks"] = len(summary.chunk_indexes)
    found["attachments"] = [a.name for a in reader.iter_attachments()]
    found["metadata"] = {m.name: m.metadata for m in reader.iter_metadata()}
    for schema, channel, message in reader.iter_messages():
        found["topics"][channel.topic] = found["topics"].get(channel.topic, 0) + 1
        if channel.message_encoding == "json":
            body = json.loads(message.data)
            wanted = json.loads(schema.data)["properties"]
            found["bad"] += set(body) != set(wanted)
            found["schemas"].append(schema.name)
found["schemas"] = sorted(set(found["schemas"]))
found["before_the_cut"] = 0
try:
    with open(cut, "rb") as file:
        for _ in NonSeekingReader(file).iter_messages(log_time_order=False):
            found["before_the_cut"] += 1
except Exception as error:
    found["cut"] = type(error).__name__
print(json.dumps(found))
"#;

#[test]
fn the_reference_reader_for_python_reads_it_whole_and_cut() {
    let folder = Folder::new("record-python");
    let bytes = recorded();
    let (whole, cut) = (
        folder.path().join("whole.mcap"),
        folder.path().join("cut.mcap"),
    );
    std::fs::write(&whole, bytes).unwrap();
    std::fs::write(&cut, &bytes[..bytes.len() * 3 / 4]).unwrap();
    // target/PROFILE/deps/TEST
    let target = std::env::current_exe().unwrap();
    let python = target.ancestors().nth(3).unwrap().join("python/bin/python");
    assert!(
        python.is_file(),
        "{} is not there: `cargo xtask test` installs Python's mcap there",
        python.display()
    );
    let output = std::process::Command::new(python)
        .args(["-c", READER])
        .args([&whole, &cut])
        .output()
        .unwrap();
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{message}");
    let found: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let ours = mcap::read(bytes).unwrap();
    assert_eq!(found["counted"], ours.messages.len(), "{found}");
    assert_eq!(
        found["bad"], 0,
        "messages that do not fit their schema: {found}"
    );
    assert_eq!(found["profile"], "mcdpr");
    for topic in ours.topics.values() {
        let count = ours
            .messages
            .iter()
            .filter(|m| ours.topic(m.channel) == Some(topic))
            .count();
        assert_eq!(
            found["topics"][topic].as_u64().unwrap_or(0),
            count as u64,
            "{topic}"
        );
    }
    for topic in [
        "/cables",
        "/status",
        "/pose/true",
        "/pose/estimated",
        "/pose/planned",
        "/log",
    ] {
        assert!(
            found["topics"][topic]
                .as_u64()
                .is_some_and(|count| count > 3),
            "{topic}: {found}"
        );
    }
    for schema in [
        "foxglove.PoseInFrame",
        "foxglove.Log",
        "foxglove.FrameTransform",
    ] {
        assert!(
            found["schemas"]
                .as_array()
                .unwrap()
                .contains(&schema.into()),
            "{found}"
        );
    }
    assert!(
        found["attachments"]
            .as_array()
            .unwrap()
            .contains(&"scenario.json".into())
    );
    assert_eq!(found["metadata"]["mcdpr"]["task"], "short.toml");
    assert!(found["chunks"].as_u64().unwrap() > 1, "{found}");
    assert!(found["before_the_cut"].as_u64().unwrap() > 100, "{found}");
}

/// Work outside of a task is on record as well: with a machine that can be simulated again, the core
/// does the same on its bytes; where hands were a part of it, the record says so.
#[test]
fn every_command_that_moves_a_drum_leaves_a_record() {
    const ORDERS: bool = true;
    const HANDS: bool = false;
    let few: &[&str] = &["--poses", "3", "--candidates", "30"];
    let collect = [&["calibrate", "collect", "--target", "board"], few].concat();
    let commands = [
        (&collect[..], "run.mcap", ORDERS, 1000),
        (
            &["tune", "tension", "--robot", "lab-direct"],
            "before",
            ORDERS,
            1000,
        ),
        (&["experiment", "cable"], "run.mcap", HANDS, 100),
        (&["rig", "attach", "2", "--yes"], "run.mcap", HANDS, 100),
        (&["calibrate", "tension", "4"], "run.mcap", HANDS, 0),
        (&["commission", "1"], "run.mcap", HANDS, 0),
        (&["calibrate", "winch", "1"], "run.mcap", HANDS, 0),
    ];
    let folder = Folder::new("record-work");
    for (words, what, doing, ticks) in commands {
        let kept = folder.path().join(words.join("-"));
        let mut command = mcdpr_tests::mcdpr();
        command.args(words).arg("--record").arg(&kept);
        let output = command.current_dir(folder.path()).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{words:?}: {said}");
        let run = mcdpr::record::load(&kept.join(what)).unwrap();
        assert!(run.damage.is_none(), "{words:?}");
        assert_eq!(run.gaps, 0, "{words:?}");
        assert!(run.frames.len() > 100, "{words:?}");
        match replay(&run, &Controller::InProcess) {
            Ok(proof) if doing == ORDERS => {
                assert!(proof.core_bytes.is_some_and(|bytes| bytes > 10_000));
                assert!(proof.whole && proof.host_bytes.is_none());
            }
            Err(ReplayError::Nothing { reason }) if doing == HANDS => {
                assert!(reason.contains("people"), "{reason}");
            }
            other => panic!("{words:?}: {other:?}"),
        }
        // What was known of it can be read as tables; a bare winch has no tensions and lengths to show.
        let mut export = mcdpr_tests::mcdpr();
        export.arg("export").arg(kept.join(what)).arg("--csv");
        let tables = folder.path().join("tables");
        let done = export.arg("--out").arg(&tables).output().unwrap();
        assert!(done.status.success(), "{words:?}");
        let lines = std::fs::read_to_string(tables.join("cables.csv")).unwrap();
        assert!(lines.lines().count() > ticks, "{words:?}");
    }
}
