//! Faults while the robot moves, or before it arms: what is latched, when, and how it ends.

use super::{line, model, run_on, run_with};
use mcdpr::experiment::Experiment;
use mcdpr::motion::Model;
use mcdpr::robot::{DriveKind, Robot};
use mcdpr_firmware::State;
use mcdpr_protocol::{FaultId, SessionId};

/// A row: what is injected, what is latched, its cable (0 for any), reported within so many ms, and
/// how far the tool may drop, m.
type Row = (&'static str, FaultId, u8, usize, f64);

/// Each fault is latched by its name and in its time, and the robot ends braked, without torque.
fn stops(rows: &[Row]) {
    for row in rows {
        stops_on(&model(), row);
    }
}

fn stops_on(model: &Model, &(word, fault, cable, within_ms, most_drop_m): &Row) {
    let after = run_on(model, &[word]);
    let record = after.record().unwrap_or_else(|| panic!("{word}: no fault"));
    assert_eq!(record.fault, fault, "{word}: {record:?}");
    assert!(cable == 0 || record.cable == cable, "{word}: {record:?}");
    let reported = after.detected_after_ms().unwrap();
    println!(
        "{word}: {:?} reported after {reported} ms, drop {:.2} mm",
        record.fault,
        after.drop_m() * 1e3
    );
    assert!(
        reported <= within_ms,
        "{word}: reported after {reported} ms"
    );
    let end = after.end();
    assert!(
        matches!(end, Some(State::Fault | State::EStop)),
        "{word}: {end:?}"
    );
    // A drive that no longer listens cannot be switched off over the bus, and the state reports the torque
    // that drives have: the brakes hold against it.
    let held = after.trace.last().is_some_and(|end| {
        let brakes = end.truth.brakes_closed.iter().take(4);
        let drums = end.truth.drum_speeds_mps.iter().take(4);
        brakes.clone().all(|closed| *closed) && drums.clone().all(|speed| speed.abs() < 1e-6)
    });
    let is_deaf = fault == FaultId::D7;
    assert!(after.is_safe() || (is_deaf && held), "{word}");
    assert!(after.drop_m() < most_drop_m, "{word}: {} m", after.drop_m());
    // What is latched stays, and nothing starts by itself.
    let since = after.trace.iter().skip_while(|point| point.fault.is_none());
    let mut off = false;
    for point in since {
        assert_eq!(point.fault, Some(record), "{word}");
        assert!(!(off && point.torque_on), "{word}: torque came back");
        off = !point.torque_on;
    }
}

#[test]
fn s2_s4_s6_s11_and_d7_stop_the_robot_of_the_chip() {
    stops(&[
        ("S2:1@0.9s", FaultId::S2, 1, 120, 5e-3),
        ("S4:1@0.9s", FaultId::S4, 1, 60, 5e-3),
        // Open inputs are a count that stands: S2.
        ("S6:1@0.9s", FaultId::S2, 1, 120, 5e-3),
        // As many equal readings as this quiet channel gives by chance once in a year: 31 ticks.
        ("S11:2@0.9s", FaultId::S11, 2, 40, 5e-3),
        ("D7:1@0.9s", FaultId::D7, 1, 120, 5e-3),
    ]);
}

#[test]
fn d4_a_motor_of_the_chips_robot_that_gives_all_it_has_stops_it() {
    // The brake drags: 100 ms at the limit, after the time to get there and to report it.
    stops(&[("D4:1@0.9s", FaultId::D4, 1, 180, 5e-3)]);
}

#[test]
fn d1_d5_b1_b2_b3_and_l18_stop_the_robot_of_the_chip() {
    stops(&[
        ("D1@0.9s", FaultId::D1, 0, 30, 0.02),
        ("D5:3@start", FaultId::D5, 3, 4000, 1e-3),
        ("B1:1@start", FaultId::B1, 1, 4000, 1e-3),
        ("B3:2@start", FaultId::B3, 0, 12_000, 2e-3),
        ("L18@0.9s", FaultId::L18, 0, 60, 5e-3),
    ]);
    // A brake that holds nothing lets its cable go slack when it arms: the right cable, as C1.
    told(&[("B2:2@start", FaultId::C1, 2, 0.7, 300)]);
}

/// A row: what is injected; the fault and the cable that are latched; the greatest tension as a share of the limit, and the
/// longest slack under torque, ms.
type Exact = (&'static str, FaultId, u8, f64, usize);

/// The robot ends braked, and what a user is told is this, by latch and by probable cause.
fn told(rows: &[Exact]) {
    for &(word, fault, cable, most_share, most_slack_ms) in rows {
        let after = run_with(&[word]);
        let record = after.record().unwrap_or_else(|| panic!("{word}: no fault"));
        let ((share, over_ms), (slack_ms, _)) = (after.over_tension(), after.slack());
        println!(
            "{word}: {:?}:{} {:?} after {:?} ms, {share:.2} of the limit, {over_ms} ms over, slack {slack_ms} ms",
            record.fault,
            record.cable,
            after.cause(),
            after.detected_after_ms(),
        );
        assert_eq!((record.fault, record.cable), (fault, cable), "{word}");
        let cause = after.cause().map(|why| (why.fault, why.cable));
        assert!(cause.is_none_or(|why| why == (fault, cable)), "{cause:?}");
        assert!(
            share <= most_share && over_ms <= 5,
            "{word}: {share} of the limit"
        );
        assert!(slack_ms <= most_slack_ms, "{word}: {slack_ms} ms slack");
        assert!(after.is_safe(), "{word}");
    }
}

#[test]
fn c1_c2_c3_c5_and_s5_stop_the_robot_of_the_chip() {
    stops(&[
        // The name, at the end of the stop at the latest; the stop comes at once (below).
        ("C3:1@0.9s", FaultId::C3, 1, 320, 0.2),
        ("C5@0.9s", FaultId::C5, 0, 50, 5e-3),
    ]);
    let after = run_with(&["C3:1@0.9s"]);
    let mut points = after.after().iter();
    let stops = points.position(|point| point.state == State::Stopping);
    assert!(stops.unwrap() <= 20, "{stops:?}");
    told(&[
        ("C1:2@0.9s", FaultId::C1, 2, 1.0, 150),
        // The pull loads the cable on the other side.
        ("C2:1@0.9s", FaultId::C2, 3, 1.3, 50),
        // 20 mm that hang slack look like a break until somebody looks.
        ("S5:2@0.9s", FaultId::C3, 2, 1.0, 2200),
    ]);
    for (word, within_ms) in [("C1:2@0.9s", 130), ("C2:1@0.9s", 20), ("S5:2@0.9s", 130)] {
        let after = run_with(&[word]);
        let mut points = after.after().iter();
        let stops = points.position(|point| point.state == State::Stopping);
        assert!(stops.is_some_and(|ms| ms <= within_ms), "{word}: {stops:?}");
    }
}

#[test]
fn l10_l11_l12_l15_silence_stops_the_robot_of_the_chip_on_one_timeline() {
    for word in ["L10@0.9s", "L11@0.9s"] {
        let after = run_with(&[word]);
        let safe_end = after.is_safe();
        assert!(safe_end, "{word}: {:?}", after.end());
        assert!(after.drop_m() < 0.5e-3, "{word}: {}", after.drop_m());
        let closed = after.after().iter().position(|point| {
            let brakes = point.truth.brakes_closed.iter().take(4);
            brakes.clone().all(|closed| *closed)
        });
        // By the plant: 2.1 s after the last heartbeat, a brake's time, and no sooner.
        let closed = closed.unwrap();
        assert!(
            (2080..2160).contains(&closed),
            "{word}: brakes after {closed} ms"
        );
    }
}

#[test]
fn l1_l3_l4_l8_l9_s1_s9_s10_do_not_end_a_motion_of_the_chip() {
    for word in [
        "L1@0.5s",
        "L3@0.5s",
        "L4@0.5s",
        "L9@0.5s",
        "S1:2@0.5s",
        "S9:2@0.5s",
        "S10:2@0.5s",
    ] {
        let after = run_with(&[word]);
        // A tension-held cable with a wrong sensor pulls wrongly; a length-held one only gives a report.
        assert!(after.error.is_none(), "{word}: {:?}", after.error);
        assert_eq!(after.record(), None, "{word}");
        assert_eq!(after.injected_ms.len(), 1, "{word}");
        assert!(after.is_safe(), "{word}");
    }
}

/// The paper's robot with CiA 402 drives: only these report faults and heat.
fn with_cia402() -> Model {
    let mut robot = Robot::built_in("paper-optimistic").unwrap();
    for winch in &mut robot.winches {
        winch.drive = DriveKind::Cia402;
    }
    Model::new(&robot).unwrap()
}

#[test]
fn d2_d6_what_a_drive_reports_stops_the_robot_of_the_chip() {
    let model = with_cia402();
    stops_on(&model, &("D2:2@0.9s", FaultId::D2, 2, 20, 5e-3));
    stops_on(&model, &("D6:3@0.9s", FaultId::D6, 3, 140, 5e-3));
    // An RMDS has no report: a motor without torque is a drive that does not obey, and its brake
    // closes first.
    stops(&[("D2:1@0.9s", FaultId::D7, 1, 200, 8e-3)]);
    // Where no length is held, its current shows it.
    stops(&[("D2:4@0.9s", FaultId::D2, 4, 30, 2e-3)]);
}

/// A chip's counters start at 0, so that cables that are paid out and cables that are hauled in
/// cannot both do without a wrap.
#[test]
fn s3_counters_of_the_chip_wrap_without_a_step() {
    let model = model();
    let (link, seen) = super::robot(&model);
    let run = Experiment::new(&model, line())
        .at_home()
        .session(SessionId(1))
        .run_on(link)
        .unwrap();
    let first = run.samples.first().unwrap();
    let (mut longest, mut shortest) = (0.0_f64, 0.0_f64);
    for pair in run.samples.windows(2) {
        for cable in 0..4 {
            let way_m = pair[1].lengths_m[cable] - first.lengths_m[cable];
            (longest, shortest) = (longest.max(way_m), shortest.min(way_m));
            let step_m = (pair[1].lengths_m[cable] - pair[0].lengths_m[cable]).abs();
            // 46 mm/s, and a count.
            assert!(step_m < 0.2e-3, "a step of {step_m} m");
        }
    }
    assert!(longest > 0.02 && shortest < -0.02, "{longest} {shortest}");
    assert!(seen.was_never_reset());
}
