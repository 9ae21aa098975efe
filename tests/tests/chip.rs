//! The firmware's own file, on an emulated chip, controls the simulated robot: what it tracks, what
//! it costs, and how it reacts to faults at its pins, its bus, its line and its plant.
//!
//! `cargo xtask test` builds the file and says where it is.

use mcdpr::experiment::{Experiment, SimulatedRobot};
use mcdpr::link::SimulatedLink;
use mcdpr::machine::{self, Controller, Mismatch};
use mcdpr::motion::{Model, Task};
use mcdpr::robot::Robot;
use mcdpr::run::RunError;
use mcdpr::scenario::{self, Aftermath, Injection, Scenario};
use mcdpr_emulator::SharedChip;
use mcdpr_firmware::State;
use mcdpr_protocol::{FaultId, SessionId};
use mcdpr_simulator::can::DriveNodes;
use mcdpr_simulator::{LinkOptions, Simulation};
use mcdpr_tests::chip::{LINE, firmware, path};
use mcdpr_tests::mcdpr;
use mcdpr_tests::process::Folder;
use serde_json::Value;
use std::path::Path;

/// Instructions of a tick over a motion, median and most: 2 % over what the firmware takes
/// today. The bound that counts is a quarter of the millisecond, 18,000 cycles.
const ARMED_MEDIAN: u32 = 6700;
const ARMED_MOST: u32 = 10_000;
/// Static RAM and the deepest stack together, bytes; the chip has 20 KiB, 6 of them for the stack.
const RAM_AND_STACK: u64 = 13 * 1024;
/// Top of the stack (memory.x).
const STACK_TOP: u32 = 0x2000_1800;

/// Bytes of RAM that the file takes for good.
fn static_ram() -> u64 {
    use object::{Object, ObjectSection, SectionFlags};
    let bytes = std::fs::read(path()).expect("the firmware's file");
    let file = object::File::parse(&*bytes).expect("an ELF file");
    let in_ram = file.sections().filter(|section| {
        let SectionFlags::Elf { sh_flags } = section.flags() else {
            return false;
        };
        sh_flags & u64::from(object::elf::SHF_ALLOC) != 0 && section.address() >= 0x2000_0000
    });
    in_ram.map(|section| section.size()).sum()
}

fn model() -> Model {
    Model::new(&Robot::built_in("paper-optimistic").unwrap()).unwrap()
}

fn line() -> Task {
    Task::parse(LINE, "line.toml".into()).unwrap()
}

/// The paper's robot at home in front of a chip, and the chip.
fn robot(model: &Model) -> (SimulatedLink, SharedChip) {
    let home = model.rest_at_home().unwrap();
    let params = machine::plant_params(model.robot(), &Mismatch::realistic(), 3);
    let (pose, tensions) = (&home.equilibrium.pose, home.tensions_n());
    let plant = machine::hang(params, pose, tensions, model.holding().by_tension(), 3).unwrap();
    let board = firmware().board().unwrap();
    let chip = board.chip();
    let options = LinkOptions::default();
    let simulation = Simulation::with_board(plant, Box::new(board), &options, 3);
    (SimulatedLink::new(simulation), chip)
}

/// Runs the line with these faults.
fn run(words: &[&str]) -> Aftermath {
    let robot =
        SimulatedRobot::new(Mismatch::realistic(), 3).controller(&Controller::Chip(firmware()));
    let injections = words.iter().map(|word| Injection::parse(word, 4).unwrap());
    let scenario = Scenario {
        name: words.join(" "),
        injections: injections.collect(),
    };
    scenario::run(&model(), line(), &robot, &scenario).unwrap()
}

/// Runs the line with a fault, which must be latched within so many ms (the board reports its state
/// over the line: some ms are the report), and leave the robot braked, without torque.
fn stops(word: &str, fault: FaultId, within_ms: usize) {
    let after = run(&[word]);
    let record = after.record().unwrap_or_else(|| panic!("{word}: no fault"));
    assert_eq!(record.fault, fault, "{word}: {record:?}");
    let detected = after.detected_after_ms().unwrap();
    assert!(
        detected <= within_ms,
        "{word}: reported after {detected} ms"
    );
    let end = after.end();
    assert!(
        matches!(end, Some(State::Fault | State::EStop)),
        "{word}: {end:?}"
    );
    let last = after.after().last().unwrap();
    assert!(!last.torque_on, "{word}");
    assert_eq!(last.truth.brakes_closed[..4], [true; 4], "{word}");
    assert!(after.is_safe(), "{word}");
}

fn document(arguments: &[&str]) -> Value {
    let folder = Folder::new("chip-document");
    let output = mcdpr()
        .args(arguments)
        .arg("--json")
        .arg("--record")
        .arg(folder.path())
        .env("MCDPR_FIRMWARE", path())
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{arguments:?}: {said}");
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn the_demo_on_the_chip_tracks_as_the_core_in_this_process() {
    // The largest tension error of a run is one sample among thousands, its sensor's noise for the
    // most part: only over some runs is it the same.
    let runs: Vec<[Value; 2]> = ["1", "2", "3", "4"]
        .map(|seed| {
            [&["demo"][..], &["demo", "--on", "chip"]].map(|words| {
                let robot = ["--seed", seed, "--robot", "paper-optimistic"];
                let document = document(&[words, &robot].concat());
                assert_eq!(document["simulated"], true);
                document
            })
        })
        .into();
    for (group, names) in [
        ("path_error_m", &["mean", "max"][..]),
        ("cable_length_error_m", &["mean", "max"]),
        ("tension_error_n", &["mean_abs", "p999_abs", "max_abs"]),
    ] {
        for name in names {
            let mean = |of: usize| {
                let values = runs
                    .iter()
                    .map(|run| run[of][group][name].as_f64().unwrap());
                values.sum::<f64>() / 4.0
            };
            let (core, chip) = (mean(0), mean(1));
            println!("{group}.{name}: {core:.3e} in this process, {chip:.3e} on the chip");
            assert!(core > 0.0 && chip > 0.0, "{group}.{name}");
            let most = if *name == "max_abs" { 0.1 } else { 0.05 };
            assert!((chip - core).abs() < most * core, "{group}.{name}");
        }
    }
}

#[test]
fn a_motion_costs_no_more_than_it_may() {
    let model = model();
    let (link, chip) = robot(&model);
    let profile = std::env::var_os("MCDPR_PROFILE");
    if profile.is_some() {
        chip.with(mcdpr_emulator::Chip::profile_ticks);
    }
    let run = Experiment::new(&model, line())
        .at_home()
        .session(SessionId(1))
        .run_on(link)
        .unwrap();
    if let Some(file) = profile {
        let rows = chip.with(|chip| chip.tick_profile());
        let rows = rows
            .iter()
            .map(|row| format!("{:#x} {} {}\n", row.address, row.all, row.longest));
        std::fs::write(file, rows.collect::<String>()).unwrap();
    }
    assert!(!run.samples.is_empty());
    let (stats, stack, errors, resets) = chip.with(|chip| {
        let stack = STACK_TOP - chip.stack_low_water();
        let stats = chip.tick_stats();
        (stats, stack, chip.can_errors(), chip.resets().len())
    });
    println!(
        "armed and moving: tick median {} instructions, most {}; latest start {} cycles; stack \
         {stack} bytes",
        stats.median, stats.max, stats.latency_max
    );
    assert_eq!((stats.lost, resets), (0, 0));
    assert!(stats.median <= ARMED_MEDIAN, "median {}", stats.median);
    assert!(stats.max <= ARMED_MOST, "most {}", stats.max);
    let ram = static_ram();
    println!(
        "{ram} bytes of static RAM, {} with the stack",
        ram + u64::from(stack)
    );
    assert!(ram > 4096 && ram + u64::from(stack) <= RAM_AND_STACK);
    assert_eq!((errors.transmit, errors.receive), (0, 0));
    // 2 us at 72 MHz, entry included, under full link, CAN and log load.
    assert!(stats.latency_max <= 144, "{} cycles", stats.latency_max);
}

#[test]
fn two_runs_on_the_chip_are_equal() {
    let model = model();
    let one = || {
        let (link, chip) = robot(&model);
        let run = Experiment::new(&model, line())
            .at_home()
            .session(SessionId(1))
            .run_on(link)
            .unwrap();
        (run.samples, chip.with(|chip| chip.instructions()))
    };
    assert_eq!(one(), one());
}

#[test]
fn s7_s8_d3_p7_stop_the_robot_of_the_chip() {
    for (word, fault, within_ms) in [
        // An input that opens rises through its filter and its pull-up: within the first ticks that
        // is a tension that rises into the rail.
        ("S7:2@0.5s", FaultId::C2, 12),
        ("S8:2@0.5s", FaultId::S8, 12),
        ("D3:2@0.5s", FaultId::D3, 20),
        ("P7@0.5s", FaultId::P7, 8),
    ] {
        stops(word, fault, within_ms);
    }
}

/// Tries to arm the paper's robot with these drives after something was done to their electronics;
/// the fault that the chip names, with its cable. Nothing may have moved, and no brake opened.
fn arming_fails(protocol: &str, spoil: impl FnOnce(&mut DriveNodes)) -> (FaultId, u8) {
    let file = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../robots/paper-optimistic.toml"
    );
    let text = std::fs::read_to_string(file).unwrap();
    let text = text.replace("drive = \"rmds\"", &format!("drive = \"{protocol}\""));
    let model = Model::new(&mcdpr::robot::parse(&text, Path::new(file)).unwrap()).unwrap();
    let (link, chip) = robot(&model);
    link.with(|simulation| spoil(simulation.drives_mut().nodes_mut()));
    let run = Experiment::new(&model, line())
        .at_home()
        .session(SessionId(1))
        .run_on(link);
    let Err(RunError::Fault { record, .. }) = run else {
        panic!("{protocol}: {:?}", run.map(|run| run.samples.len()));
    };
    assert!(!chip.with(|chip| chip.brakes_ever_opened()), "{protocol}");
    (record.fault, record.cable)
}

#[test]
fn d5_p2_drives_that_are_silent_have_another_number_or_another_mode_are_named_and_do_not_arm() {
    for protocol in ["rmds", "cia402"] {
        // All of them: their supply or their bus. One alone: that drive.
        let silent = |nodes: &mut DriveNodes| {
            for drive in 0..4 {
                nodes.fault_mut(drive).expect("a drive").silent = true;
            }
        };
        assert_eq!(
            arming_fails(protocol, silent),
            (FaultId::P2, 0),
            "{protocol}"
        );
        let one = |nodes: &mut DriveNodes| {
            nodes.fault_mut(2).expect("a drive").silent = true;
        };
        assert_eq!(arming_fails(protocol, one), (FaultId::D5, 3), "{protocol}");
        let elsewhere = |nodes: &mut DriveNodes| {
            nodes.fault_mut(1).expect("a drive").node = Some(14);
        };
        assert_eq!(
            arming_fails(protocol, elsewhere),
            (FaultId::D5, 2),
            "{protocol}"
        );
    }
    // Profile position, where cyclic synchronous position was asked for; an RMDS reports no mode.
    let wrong_mode = |nodes: &mut DriveNodes| {
        nodes.fault_mut(2).expect("a drive").mode = Some(1);
    };
    assert_eq!(arming_fails("cia402", wrong_mode), (FaultId::D5, 3));
}
