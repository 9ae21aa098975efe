//! `mcdpr doctor` and `mcdpr flash`, by the real program: a robot that is well, and one thing wrong at
//! a time, each named with what to do. Faults are injected at the plant, or the machine is built
//! otherwise than its file says.

use mcdpr::doctor::{self, Finding, Verdict};
use mcdpr::experiment::SimulatedRobot;
use mcdpr::link::{Client, SimulatedLink};
use mcdpr::machine::{self, Controller, Mismatch};
use mcdpr::motion::Model;
use mcdpr::robot::Robot;
use mcdpr::run::RunError;
use mcdpr::service::{Asked, Operator, ServiceError, commission, measure_ratio};
use mcdpr_protocol::{FaultId, SessionId};
use mcdpr_simulator::LinkOptions;
use mcdpr_simulator::plant::{EncoderFault, Faults, TensionFault};
use mcdpr_tests::mcdpr;
use mcdpr_tests::process::Folder;
use serde_json::Value;
use std::path::Path;
use std::process::{Output, Stdio};

fn file(folder: &Folder, name: &str, content: &[u8]) -> String {
    let path = folder.path().join(name);
    std::fs::write(&path, content).unwrap();
    path.display().to_string()
}

fn call(arguments: &[&str]) -> Output {
    mcdpr()
        .args(arguments)
        .stdin(Stdio::null())
        .output()
        .unwrap()
}

/// The document of a `doctor` and its exit code.
fn document(arguments: &[&str]) -> (Value, i32) {
    let output = call(&[&["doctor", "--json"], arguments].concat());
    let text = String::from_utf8_lossy(&output.stdout);
    let errors = String::from_utf8_lossy(&output.stderr);
    let value = serde_json::from_str(&text).unwrap_or_else(|_| panic!("{text}{errors}"));
    (value, output.status.code().unwrap())
}

/// What is wrong by the document: part, cable, words.
fn wrong(document: &Value) -> Vec<(String, Option<u64>, String)> {
    let findings = document["findings"].as_array().unwrap().iter();
    findings
        .filter(|finding| finding["verdict"] == "bad")
        .map(|finding| {
            assert!(finding["remedy"].is_string(), "{finding}");
            (
                finding["part"].as_str().unwrap().to_owned(),
                finding["cable"].as_u64(),
                format!("{} -> {}", finding["found"], finding["remedy"]),
            )
        })
        .collect()
}

/// The built-in fast robot with one value of one `[[winch]]` table replaced.
fn built_otherwise(winch: usize, key: &str, value: &str) -> String {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    let text = std::fs::read_to_string(root.join("robots/lab-fast.toml")).unwrap();
    let mut at = 0;
    let mut lines = Vec::new();
    for line in text.lines() {
        let head = line.trim() == "[[winch]]";
        at += usize::from(head);
        let name = line.split('=').next().unwrap_or_default().trim();
        if at != winch || name != key {
            lines.push(line.to_owned());
        }
        if head && at == winch {
            lines.push(format!("{key} = {value}"));
        }
    }
    assert!(at >= winch, "there is no winch {winch}");
    lines.join("\n")
}

#[test]
fn a_robot_that_is_well_is_well_in_every_part_and_when_it_arms() {
    let (document, code) = document(&["--arm"]);
    assert_eq!(code, 0, "{document}");
    assert_eq!(document["healthy"], true);
    let findings = document["findings"].as_array().unwrap();
    let count = |part: &str| findings.iter().filter(|f| f["part"] == part).count();
    for part in [
        "program",
        "port",
        "board",
        "state",
        "configuration",
        "brakes",
        "arming",
    ] {
        assert_eq!(count(part), 1, "{part}: {document}");
    }
    for part in ["drive", "encoder", "tension"] {
        assert_eq!(count(part), 4, "{part}: {document}");
    }
    assert!(
        findings.iter().all(|f| f["verdict"] == "good"),
        "{document}"
    );
    // For people: one line a part, and no advice where there is nothing to do.
    let output = call(&["doctor"]);
    let text = String::from_utf8_lossy(&output.stdout);
    assert_eq!(output.status.code(), Some(0));
    assert!(text.contains("drive 4") && !text.contains("->"), "{text}");
}

#[test]
fn a_port_that_is_not_there_is_reported_with_what_to_do() {
    let (document, code) = document(&["--on", "/dev/mcdpr-not-there"]);
    assert_eq!(code, 1);
    assert_eq!(document["healthy"], false);
    let wrong = wrong(&document);
    assert_eq!(wrong.len(), 1, "{document}");
    assert_eq!(wrong[0].0, "port");
}

#[test]
fn a_drive_of_another_number_is_named_with_the_number_that_nobody_expects() {
    let folder = Folder::new("doctor-node");
    let built = file(
        &folder,
        "built.toml",
        built_otherwise(2, "node", "9").as_bytes(),
    );
    let (document, code) = document(&["--robot", "lab-fast", "--built", &built, "--arm"]);
    assert_eq!(code, 1);
    let wrong = wrong(&document);
    assert_eq!(wrong.len(), 1, "{document}");
    let (part, cable, words) = &wrong[0];
    assert_eq!((part.as_str(), *cable), ("drive", Some(2)), "{document}");
    assert!(
        words.contains("commission 2") && words.contains('9'),
        "{words}"
    );
    let findings = document["findings"].as_array().unwrap();
    let arming = findings.iter().find(|f| f["part"] == "arming").unwrap();
    assert_eq!(
        arming["verdict"], "unseen",
        "nothing is tried on a broken robot"
    );
    let text = document.to_string();
    assert!(text.contains("no winch of the robot file has: 9"), "{text}");
}

#[test]
fn an_encoder_that_counts_the_other_way_shows_when_it_arms() {
    let folder = Folder::new("doctor-sign");
    let text = built_otherwise(3, "encoder_sign", "-1");
    let built = file(&folder, "built.toml", text.as_bytes());
    let machine = ["--robot", "lab-fast", "--built", &built];
    let (passive, code) = document(&machine);
    assert_eq!(code, 0, "at rest nobody can know: {passive}");
    let (armed, code) = document(&[&machine[..], &["--arm"]].concat());
    assert_eq!(code, 1, "{armed}");
    let wrong = wrong(&armed);
    assert_eq!(wrong.len(), 1, "{armed}");
    let (part, cable, words) = &wrong[0];
    assert_eq!((part.as_str(), *cable), ("arming", Some(3)), "{words}");
    assert!(words.contains("S4"), "{words}");
}

/// The simulated paper's robot with these faults, examined.
fn examined(break_it: impl FnOnce(&mut Faults)) -> Vec<Finding> {
    let robot = Robot::built_in("paper-table5").unwrap();
    let model = Model::new(&robot).unwrap();
    let link: SimulatedLink = SimulatedRobot::new(Mismatch::realistic(), 5)
        .at_home(&model)
        .unwrap();
    link.with(|simulation| break_it(simulation.plant_mut().faults_mut()));
    let mut client = Client::connect(link, SessionId(7)).unwrap();
    doctor::examine(&mut client, &robot).unwrap()
}

fn bad(findings: &[Finding]) -> Vec<(&'static str, Option<usize>)> {
    let bad = findings.iter().filter(|f| f.verdict == Verdict::Bad);
    bad.map(|f| (f.part, f.cable)).collect()
}

#[test]
fn broken_sensors_and_a_silent_bus_are_each_named() {
    for fault in [
        TensionFault::Open,
        TensionFault::Short,
        TensionFault::Frozen,
    ] {
        let findings = examined(|faults| faults.cables[1].tension = fault);
        assert_eq!(
            bad(&findings),
            [("tension", Some(2))],
            "{fault:?} {findings:?}"
        );
    }
    let findings = examined(|faults| faults.cables[2].tension_offset_n = -30.0);
    assert_eq!(bad(&findings), [("tension", Some(3))], "{findings:?}");
    let findings = examined(|faults| faults.cables[0].tension_noise_factor = 20.0);
    assert_eq!(bad(&findings), [], "{findings:?}");
    let noted = findings.iter().filter(|f| f.verdict == Verdict::Note);
    let noted: Vec<_> = noted.map(|f| (f.part, f.cable)).collect();
    assert_eq!(
        noted,
        [("tension", Some(1))],
        "noise must not stop the doctor"
    );
    let findings = examined(|faults| faults.bus_off = true);
    let all: Vec<_> = (1..=4).map(|cable| ("drive", Some(cable))).collect();
    assert_eq!(bad(&findings), all, "{findings:?}");
    let findings = examined(|faults| faults.cables[3].drive.silent = true);
    assert_eq!(bad(&findings), [("drive", Some(4))], "{findings:?}");
}

/// Nobody watches the drum.
struct Nobody;

impl Operator for Nobody {
    fn paid_out(&mut self) -> Option<bool> {
        None
    }
}

/// A bare machine with these faults, and its robot file.
fn bare(break_it: impl FnOnce(&mut Faults)) -> (Client<SimulatedLink>, Robot) {
    let robot = Robot::built_in("lab-fast").unwrap();
    let options = LinkOptions::default();
    let simulation = machine::simulate_unloaded(
        &robot,
        &Mismatch::realistic(),
        &options,
        5,
        &Controller::InProcess,
    )
    .unwrap();
    let link = SimulatedLink::new(simulation);
    link.with(|simulation| break_it(simulation.plant_mut().faults_mut()));
    (Client::connect(link, SessionId(7)).unwrap(), robot)
}

#[test]
fn work_on_a_bare_winch_ends_at_a_silent_bus_a_dead_encoder_and_a_drive_that_stays_off() {
    let (mut client, robot) = bare(|faults| faults.bus_off = true);
    let error = commission(&mut client, &robot, 1, &Asked::default(), &mut Nobody).unwrap_err();
    assert!(matches!(error, ServiceError::NoDrive { .. }), "{error}");
    let (mut client, robot) = bare(|faults| faults.cables[0].encoder = EncoderFault::Stuck);
    let error = measure_ratio(&mut client, &robot, 1, 1).unwrap_err();
    let named = match &error {
        ServiceError::EncoderStuck { winch, .. } => *winch == 1,
        // The board itself may have seen it first.
        ServiceError::Run(RunError::Fault { record, .. }) => {
            record.fault == FaultId::S2 && record.cable == 1
        }
        _ => false,
    };
    assert!(named, "{error}");
    // It answers, and never takes its mode.
    let (mut client, robot) = bare(|faults| faults.cables[0].drive.late_s = f64::INFINITY);
    let error = measure_ratio(&mut client, &robot, 1, 1).unwrap_err();
    let ServiceError::Run(RunError::Fault { record, .. }) = &error else {
        panic!("{error}");
    };
    assert_eq!((record.fault, record.cable), (FaultId::D5, 1), "{error}");
}

/// A 32-bit ELF file for `machine` with one part: these bytes at this address.
fn elf(machine: u16, address: u32, content: &[u8]) -> Vec<u8> {
    let mut file = b"\x7FELF\x01\x01\x01".to_vec();
    file.resize(16, 0);
    let half = |file: &mut Vec<u8>, value: u16| file.extend(value.to_le_bytes());
    let word = |file: &mut Vec<u8>, value: u32| file.extend(value.to_le_bytes());
    half(&mut file, 2);
    half(&mut file, machine);
    word(&mut file, 1);
    word(&mut file, address | 1);
    // Program headers follow; there are no sections.
    for value in [52, 0, 0] {
        word(&mut file, value);
    }
    for value in [52, 32, 1, 0, 0, 0] {
        half(&mut file, value);
    }
    let size = u32::try_from(content.len()).unwrap();
    for value in [1, 84, address, address, size, size, 5, 4] {
        word(&mut file, value);
    }
    file.extend(content);
    file
}

/// A vector table and a loop for ever.
fn idle(stack: u32, entry: u32) -> Vec<u8> {
    let mut content = Vec::new();
    content.extend(stack.to_le_bytes());
    content.extend((entry | 1).to_le_bytes());
    // b .
    content.extend([0xFE, 0xE7, 0xFE, 0xE7]);
    content
}

#[test]
fn what_is_no_firmware_of_this_board_is_refused_before_a_probe_is_looked_for() {
    const FLASH: u32 = 0x0800_0000;
    let folder = Folder::new("flash-wrong");
    let good = elf(40, FLASH, &idle(0x2000_1800, FLASH + 8));
    let cases: [(&str, Vec<u8>, &str); 7] = [
        ("text.elf", b"not a program".to_vec(), "not an ELF file"),
        (
            "host.elf",
            b"\x7FELF\x02\x01\x01\0\0\0\0\0\0\0\0\0".to_vec(),
            "little-endian executable",
        ),
        (
            "riscv.elf",
            elf(243, FLASH, &idle(0x2000_1800, FLASH + 8)),
            "machine 243",
        ),
        (
            "other.elf",
            elf(40, 0x1000_0000, &idle(0x2000_1800, 0x1000_0008)),
            "another chip",
        ),
        // The same family with more memory: its stack lies beyond this chip's RAM.
        (
            "f407.elf",
            elf(40, FLASH, &idle(0x2002_0000, FLASH + 8)),
            "another chip",
        ),
        ("cut.elf", good[..good.len() - 6].to_vec(), "ends at byte"),
        // It fits this chip, and is not this board's.
        ("blink.elf", good, "no hello"),
    ];
    for (name, bytes, word) in cases {
        let path = file(&folder, name, &bytes);
        let output = call(&["flash", &path]);
        assert_eq!(output.status.code(), Some(1), "{name}");
        let words = String::from_utf8_lossy(&output.stderr).replace('│', " ");
        let words = words.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(words.contains(word), "{name}: {words}");
        assert!(
            words.contains("cargo fw"),
            "{name} says what to do: {words}"
        );
        assert!(
            !words.contains("probe"),
            "{name}: no probe was looked for: {words}"
        );
    }
    let output = call(&["flash", "nowhere.elf"]);
    let words = String::from_utf8_lossy(&output.stderr);
    assert!(words.contains("cannot be read"), "{words}");
}

#[test]
fn the_real_firmware_is_examined_by_doctor_and_accepted_by_flash() {
    let built = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../target/thumbv7m-none-eabi/firmware/mcdpr-firmware"
    );
    let path = std::env::var("MCDPR_FIRMWARE").unwrap_or_else(|_| built.to_owned());
    let output = call(&["flash", &path, "--dry-run", "--json"]);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!(
        output.status.code(),
        Some(0),
        "build it with `cargo fw`: {errors}"
    );
    let accepted: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(accepted["written"], false);
    assert!(
        accepted["flash_bytes"].as_u64().unwrap() > 20_000,
        "{accepted}"
    );
    // Without a probe, or in a program that cannot use one, it reports that, and that the file is good.
    let output = call(&["flash", &path]);
    let words = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{words}");
    assert!(words.contains("the file is good"), "{words}");
    // The same checks as on the simulator, through the chip's own serial port.
    let (document, code) = document(&["--on", "chip", "--firmware", &path, "--arm"]);
    assert_eq!(code, 0, "{document}");
    let findings = document["findings"].as_array().unwrap();
    let of = |part: &str| {
        findings
            .iter()
            .filter(|f| f["part"] == part)
            .collect::<Vec<_>>()
    };
    assert!(
        of("tension").len() == 4 && of("encoder").len() == 4,
        "{document}"
    );
    assert_eq!(of("arming")[0]["verdict"], "good", "{document}");
    assert_eq!(of("drive").len(), 4, "{document}");
    // The same file works on one winch.
    let folder = Folder::new("doctor-winch");
    let out = folder.path().join("w.toml").display().to_string();
    let output = call(&[
        "commission",
        "1",
        "--on",
        "chip",
        "--firmware",
        &path,
        "--out",
        &out,
    ]);
    let words = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{words}");
}
