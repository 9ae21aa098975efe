//! The bounded, seeded versions of the targets of `fuzz/`: what any input must not do.

use mcdpr::scenario::{How, how};
use mcdpr_protocol::{FaultId, Request};
use mcdpr_tests::fuzz::mutate::{Rng, damage, mistake};
use mcdpr_tests::fuzz::{files, planning, wire};
use std::panic::catch_unwind;

/// Runs a target on the inputs of many seeds; a failing one is named.
fn seeds(name: &str, count: u64, run: impl Fn(&mut Rng) + std::panic::RefUnwindSafe) {
    for seed in 0..count {
        let held = catch_unwind(|| run(&mut Rng(seed)));
        assert!(held.is_ok(), "{name}: seed {seed} breaks a rule");
    }
}

#[test]
fn l1_l6_l7_l8_the_deframer_finds_the_next_frame_after_anything() {
    seeds("deframer", 20_000, |rng| {
        let count = rng.below(700);
        let mut bytes = rng.bytes(count);
        // Random bytes are seldom zero, and zero is what ends a frame.
        if rng.below(2) == 0 {
            bytes.iter_mut().for_each(|byte| *byte &= 0x83);
        }
        wire::deframer(&bytes);
    });
}

#[test]
fn l2_l8_whatever_decodes_is_a_message() {
    seeds("decoder", 200_000, |rng| {
        let count = rng.below(120);
        let mut body = rng.bytes(count);
        if rng.below(2) == 0 {
            body.iter_mut().for_each(|byte| *byte &= 0x07);
        }
        wire::decoder(&body);
    });
}

/// L8: a hundred million bytes.
#[test]
fn l8_no_stream_of_bytes_enables_anything_or_costs_a_tick() {
    const RUNS: u64 = 100;
    const BYTES: usize = 1_000_000;
    let each = 100_000_000_usize.div_ceil(RUNS as usize);
    assert_eq!(each, BYTES);
    seeds("stream", RUNS, |rng| {
        let mut bytes = Vec::with_capacity(BYTES + 8);
        while bytes.len() < BYTES {
            bytes.extend(rng.word().to_le_bytes());
        }
        // Every fourth stream has as many ends of frames as a busy line.
        if rng.below(4) == 0 {
            bytes.iter_mut().step_by(23).for_each(|byte| *byte = 0);
        }
        let ticks = wire::dispatcher_stream(&bytes);
        assert!(ticks as usize >= BYTES / 92);
    });
}

#[test]
fn l2_l8_requests_with_a_valid_checksum_keep_every_rule() {
    let understood = std::sync::atomic::AtomicU32::new(0);
    seeds("requests", 3_000, |rng| {
        let mut bytes = rng.bytes(1);
        for _ in 0..rng.below(60) {
            let body = request(rng);
            bytes.push(body.len().to_le_bytes()[0]);
            bytes.extend(rng.bytes(1));
            bytes.extend(body);
        }
        let count = wire::dispatcher_requests(&bytes);
        understood.fetch_add(count, std::sync::atomic::Ordering::Relaxed);
    });
    let understood = understood.into_inner();
    assert!(understood > 15_000, "{understood} requests were understood");
}

/// Bytes that are a request or nearly so.
fn request(rng: &mut Rng) -> Vec<u8> {
    let count = 1 + rng.below(60);
    let mut bytes = rng.bytes(count);
    if let Some(kind) = bytes.first_mut() {
        *kind %= 23;
    }
    if rng.below(2) == 0 {
        bytes.iter_mut().skip(1).for_each(|byte| *byte &= 0x07);
    }
    let valid: [Request; 8] = [
        Request::Open,
        Request::ClearFault,
        Request::Disarm,
        Request::Start,
        Request::Resume,
        Request::Stop(mcdpr_protocol::StopKind::Hold),
        wire::arm(),
        wire::reference(),
    ];
    match (rng.below(3), valid.get(rng.below(valid.len()))) {
        (0, Some(request)) => wire::body(request),
        (1, Some(request)) => damage(rng, &wire::body(request)),
        _ => bytes,
    }
}

macro_rules! robots {
    ($($name:literal),*) => { [$(include_str!(concat!("../../robots/", $name, ".toml"))),*] };
}

#[test]
fn f1_no_text_is_too_much_for_the_reader_of_robot_files() {
    let robots = robots!["paper-table5", "eight-cable", "planar-four", "lab-fast"];
    taken("robot", 1_500, &robots, files::robot_file);
}

#[test]
fn no_text_is_too_much_for_the_readers_of_tasks() {
    let tasks = [
        "name = \"a\"\nstart_mm = [255, -105, -180]\nspeed_mm_s = 40\n[[leg]]\nto_mm = [335, -65, \
         -180]\nduration_s = 3.5\n[[leg]]\ncircle_center_mm = [300, -65, -180]\nsweep_deg = -90\n\
         [[leg]]\ndwell_s = 1.5\n[[leg]]\ngripper = \"close\"\n",
        "start_mm = [0, 0, -100]\n[[leg]]\npoints_mm = [[1, 2, -100], [5, 9, -100], [20, 3, \
         -110]]\n[[leg]]\nthrough_mm = [30, 3, -110]\nto_mm = [40, 10, -110]\n",
    ];
    taken("task", 6_000, &tasks, files::task_file);
    let programs = [
        "%\nG21 G90 G17\nG0 X255 Y-105 Z-180\nF1200 G1 X300 (there)\nG2 X320 Y-85 I20 J0\nM3 ; \
         close\nG4 P0.5\nG91\nG1 X-5 Y2 Z-1\nG3 X10 Y0 I5 J0\nM5\nM2\n",
    ];
    taken("G-code", 20_000, &programs, files::gcode);
}

#[test]
fn f7_no_text_is_too_much_for_the_reader_of_calibration_data() {
    let data = files::example_data();
    taken("data set", 1_500, &[&data], files::data_set);
}

#[test]
fn no_text_is_too_much_for_the_reader_of_scenarios() {
    let mut text = String::from("name = \"all\"\n");
    let injected = FaultId::ALL
        .iter()
        .filter(|id| !matches!(how(**id), How::Not(_)));
    for fault in injected.take(20) {
        let name = fault.name();
        text += &format!("[[fault]]\nid = \"{name}\"\ncable = 2\nat_s = 1.5\nlasts_s = 0.25\n");
    }
    let words = "S2@3.0s\nC3:2@1.5s\nB1@start\nL12@1.6s\n";
    taken("scenario", 5_000, &[&text, words], files::scenario);
}

/// Each text as it is, with mistakes, and beside pure rubbish; some of those with mistakes must
/// still be accepted, else the mistakes prove nothing.
fn taken(name: &str, count: u64, texts: &[&str], read: fn(&str) -> bool) {
    let good = texts.iter().filter(|text| read(text)).count();
    assert!(good > 0, "{name}: no example is taken");
    let still = std::sync::atomic::AtomicU32::new(0);
    seeds(name, count, |rng| {
        let text = texts.get(rng.below(texts.len())).copied().unwrap_or("");
        let text = mistake(rng, text);
        still.fetch_add(read(&text).into(), std::sync::atomic::Ordering::Relaxed);
        let count = rng.below(300);
        read(&String::from_utf8_lossy(&rng.bytes(count)));
    });
    let still = still.into_inner();
    assert!(
        still > 0 && u64::from(still) < count,
        "{name}: {still} of {count} taken"
    );
}

/// The short part of `cargo xtask study planning`. A bound on time is a bound on work here:
/// the study measures the processor time of each input.
#[test]
fn any_robot_with_any_task_is_planned_or_refused() {
    let counts: [std::sync::atomic::AtomicU32; planning::Came::ALL.len()] = Default::default();
    seeds("planning", 1_500, |rng| {
        let input = planning::draw(rng);
        let came = planning::plan(&input);
        let at = planning::Came::ALL.iter().position(|one| *one == came);
        counts[at.unwrap()].fetch_add(1, std::sync::atomic::Ordering::Relaxed);
    });
    // Inputs that are all refused at the door would not test what is behind it.
    for (came, count) in planning::Came::ALL.iter().zip(counts) {
        assert!(count.into_inner() >= 5, "{came:?} is hardly ever reached");
    }
}

/// A robot with only two cables held by length, and one with more cables than a board drives.
#[test]
fn robots_that_cannot_be_driven_are_refused_with_the_key() {
    use mcdpr::motion::Model;
    use mcdpr::robot::Robot;
    let robot = Robot::built_in("paper-table5").unwrap();
    let mut three = robot.clone();
    three.cables.truncate(3);
    three.winches.truncate(3);
    assert!(Model::new(&three).is_ok(), "three lengths are enough");
    three.cables[2].control = mcdpr::robot::Control::Tension;
    let error = Model::new(&three).unwrap_err();
    let help = miette::Diagnostic::help(&error).unwrap().to_string();
    assert!(help.contains("control = \"auto\""), "{error}: {help}");
    let mut many = robot.clone();
    let held = many.cables.last().unwrap().clone();
    many.cables.resize(9, held);
    let error = Model::new(&many).unwrap_err().to_string();
    assert!(error.contains("9 cables"), "{error}");
}
