//! The fault line between the boards of one robot: a board that is not well stops the other in 3 ms, and a line that
//! does not work is noticed before the robot arms.

mod two_boards;

use mcdpr_core::control::Handle;
use mcdpr_core::link::{ClientError, LinkError};
use mcdpr_core::robot::{BuiltInModules, Robot};
use mcdpr_core::run::RunError;
use mcdpr_protocol::{BoardState, FaultId};
use mcdpr_simulator::{BoardFailure, FaultLineTap, WireFaults};
use mcdpr_twin::faults::{FaultyLink, Injection, Scenario};
use two_boards::{APART, After, disturbed, disturbed_again, model, robot_line, run, run_over};

/// When the first board has reacted, at the latest, s.
const LINE_S: f64 = 3e-3;

/// The board that the host names as lost.
fn lost(after: &After) -> &str {
    match &after.done {
        Err(RunError::Client(ClientError::Link(LinkError::Boards { what, .. }))) => what,
        other => panic!("{other:?}"),
    }
}

/// The first board stops by the line in time; after how long, s.
fn stops(after: &After, what: &str) {
    let stopped_s = after.first_s(&[BoardState::Stopping]).expect(what);
    println!(
        "{what}: the other board stops after {:.2} ms",
        stopped_s * 1e3
    );
    assert!(stopped_s <= LINE_S, "{what}: {stopped_s} s");
    let (_, last) = after.first.last().unwrap();
    assert_eq!(*last, BoardState::Fault, "{what}");
}

#[test]
fn l19_a_board_without_supply_stops_the_other() {
    let after = disturbed(5, 1_500_000, |simulation| {
        simulation.set_power_of(1, false).unwrap();
    });
    stops(&after, "no supply");
    assert!(lost(&after).contains("board 2 (simulated 02)"));
}

#[test]
fn l19_a_board_that_resets_itself_stops_the_other() {
    for failure in [BoardFailure::Crash, BoardFailure::SupplyLow] {
        let after = disturbed(8, 1_500_000, |simulation| {
            simulation.fail_board_of(1, failure, true).unwrap();
        });
        stops(&after, "reset");
        assert!(lost(&after).contains("board 2 (simulated 02)"));
    }
}

#[test]
fn l19_a_short_reset_stops_the_other_and_the_board_is_named() {
    // The board runs again 5 ms later, without its session.
    let after = disturbed_again(9, 1_500_000, |simulation, since_us| {
        let on = since_us < 5000;
        simulation
            .fail_board_of(1, BoardFailure::Crash, on)
            .unwrap();
    });
    stops(&after, "short reset");
    match &after.done {
        Err(RunError::Fault { record, .. }) => assert_eq!(record.fault, FaultId::P4),
        _ => assert!(lost(&after).contains("board 2 (simulated 02)")),
    }
}

#[test]
fn l19_a_fault_of_one_board_stops_the_other_within_3_ms_of_it_and_the_first_fault_is_told() {
    let after = disturbed(3, 2_500_000, |simulation| {
        simulation.plant_mut().faults_mut().cables[5].drive.silent = true;
    });
    let Err(RunError::Fault { record, .. }) = after.done else {
        panic!("{:?}", after.done);
    };
    assert_eq!((record.fault, record.cable), (FaultId::D3, 6), "{record:?}");
    let of = |states: &[BoardState], board: usize| {
        let found = after
            .both
            .iter()
            .find(|(_, both)| states.contains(&both[board]));
        found.map(|(at_us, _)| *at_us).unwrap()
    };
    let [first_us, second_us] = [0, 1].map(|board| of(&[BoardState::Stopping], board));
    println!(
        "fault: {} us after the second board's",
        first_us - second_us
    );
    assert!(first_us - second_us <= 3000, "{first_us} {second_us}");
    assert_eq!(after.second, BoardState::Fault);
}

#[test]
fn l19_the_lost_line_of_one_board_stops_the_other_when_it_holds() {
    let dead = WireFaults {
        drop: 1.0,
        ..WireFaults::default()
    };
    let after = disturbed(4, 1_500_000, |simulation| {
        simulation.set_faults_of(1, dead, dead)
    });
    assert!(lost(&after).contains("board 2 (simulated 02)"));
    let at_us = |board: usize| {
        let states = [BoardState::Pausing, BoardState::Stopping];
        let found = after
            .both
            .iter()
            .find(|(_, both)| states.contains(&both[board]));
        found.map(|(at_us, _)| *at_us).unwrap()
    };
    let (first_us, second_us) = (at_us(0), at_us(1));
    println!("lost line: {first_us} and {second_us} us");
    // Whichever comes first: the host or the wire.
    assert!(first_us <= second_us + 3000, "{first_us} {second_us}");
    let (_, last) = after.first.last().unwrap();
    assert_eq!(*last, BoardState::Fault);
}

#[test]
fn l19_a_plug_that_is_pulled_in_motion_stops_its_board() {
    let after = disturbed(10, 1_500_000, |simulation| {
        simulation.set_fault_line_of(0, FaultLineTap::Cut);
    });
    stops(&after, "plug pulled");
    let Err(RunError::Fault { record, .. }) = after.done else {
        panic!("{:?}", after.done);
    };
    assert_eq!(record.fault, FaultId::L19);
}

/// What the host says when it arms with a board's connection damaged.
fn refused(board: usize, tap: FaultLineTap) -> String {
    let model = model();
    let link = robot_line(&model, 11, &APART);
    link.with(|simulation| simulation.set_fault_line_of(board, tap));
    let (done, seen) = run(&link, &model, &Handle::new(), |_, _| {});
    let works = |states: &[BoardState; 2]| states.iter().any(|s| *s != BoardState::Disarmed);
    let armed = seen
        .iter()
        .skip_while(|(_, states)| states.contains(&BoardState::Boot));
    assert!(!armed.clone().any(|(_, states)| works(states)), "{seen:?}");
    let Err(RunError::Client(ClientError::Link(LinkError::Boards { what, .. }))) = done else {
        panic!("{done:?}");
    };
    println!("{tap:?} at {board}: {what}");
    what
}

#[test]
fn a_cut_of_the_line_is_noticed_and_named_before_anything_arms() {
    for (board, name) in [(0, "board 1 (simulated 01)"), (1, "board 2 (simulated 02)")] {
        let what = refused(board, FaultLineTap::Cut);
        assert!(what.contains(&format!("wire to {name} is cut")), "{what}");
        let what = refused(board, FaultLineTap::Deaf);
        assert!(what.contains(&format!("wire to {name} is cut")), "{what}");
        let what = refused(board, FaultLineTap::Mute);
        assert!(what.contains(&format!("{name} does not pull")), "{what}");
    }
}

#[test]
fn a_line_that_another_board_holds_low_forbids_arming_with_its_name() {
    // Nothing is known of who holds it low: a short to ground.
    let model = model();
    let link = robot_line(&model, 12, &APART);
    link.with(|simulation| {
        for board in 0..2 {
            simulation.set_fault_line_of(board, FaultLineTap::Cut);
        }
    });
    let (done, _) = run(&link, &model, &Handle::new(), |_, _| {});
    let said = format!("{done:?}");
    assert!(said.contains("low at every board"), "{said}");
}

#[test]
fn the_line_of_a_robot_file_is_on_every_board_of_several() {
    let text = include_str!("../../robots/eight-cable.toml");
    let alone = text.replacen(
        "[platform]",
        "[[board]]\nchannels = 8\nfault_line = true\n[platform]",
        1,
    );
    let error = Robot::parse(&alone, "robot.toml", &BuiltInModules).unwrap_err();
    let said = format!("{error:?} {error}");
    assert!(
        said.contains("`fault_line` of a robot with one board"),
        "{said}"
    );
}

#[test]
fn a_plug_is_pulled_by_its_word() {
    let model = model();
    let scenario = Scenario::from_words(&["wire:2@start".to_owned()], 8).unwrap();
    scenario.suits(model.robot()).unwrap();
    let other = Robot::built_in("eight-cable").unwrap();
    assert!(scenario.suits(&other).is_err(), "no fault line");
    for wrong in ["wire:0@start", "wire:9@start", "L19@start"] {
        assert!(Injection::parse(wrong, 8).is_err(), "{wrong}");
    }
    let link = robot_line(&model, 13, &APART);
    let faulty = FaultyLink::new(link.clone(), &scenario.injections);
    let done = run_over(faulty, &link, &model, &Handle::new());
    let said = format!("{done:?}");
    assert!(
        said.contains("wire to board 2 (simulated 02) is cut"),
        "{said}"
    );
}

#[test]
fn p7_an_emergency_stop_while_the_line_is_proved_is_not_taken_for_a_cut() {
    let model = model();
    let link = robot_line(&model, 14, &APART);
    let mut pressed = false;
    let (done, seen) = run(&link, &model, &Handle::new(), |simulation, now_us| {
        if !pressed && now_us > 900_000 {
            pressed = true;
            simulation.plant_mut().set_e_stop(true);
        }
    });
    let armed = |(_, states): &(u64, [BoardState; 2])| states.contains(&BoardState::Arming);
    assert!(pressed && !seen.iter().any(armed), "{seen:?}");
    let said = format!("{done:?}");
    let named = said.contains("P7") || said.contains("EStop");
    assert!(named && !said.contains("Boards"), "{said}");
}
