//! The fault line between the boards of one robot: a board that is not well stops the others in 3 ms, and a line that
//! does not work is noticed before the robot arms.

mod several_boards;

use mcdpr_core::control::Handle;
use mcdpr_core::faults::describe_fault;
use mcdpr_core::link::{ClientError, LinkError};
use mcdpr_core::robot::{BuiltInModules, Robot};
use mcdpr_core::run::RunError;
use mcdpr_protocol::{BoardState, FaultId};
use mcdpr_simulator::{BoardFailure, FaultLineTap, WireFaults};
use mcdpr_twin::faults::{FaultyLink, Injection, Scenario};
use several_boards::{
    APART, After, THREE, TWO, disturbed, disturbed_again, model_of, name, robot_line, run, run_over,
};

/// When the other boards have reacted, at the latest, s.
const LINE_S: f64 = 3e-3;
/// The same by the host alone, s.
const HOST_S: f64 = 0.15;
/// Time after the host's end in which the brakes close on a platform that swings because a board closed its own at once,
/// µs.
const PARKED_US: u64 = 6_000_000;

/// The board that the host names as lost.
fn lost(after: &After) -> &str {
    match &after.done {
        Err(RunError::Client(ClientError::Link(LinkError::Boards { what, .. }))) => what,
        other => panic!("{other:?}"),
    }
}

/// Robots, and each of their boards.
const EVERY: [(&str, usize); 5] = [(TWO, 0), (TWO, 1), (THREE, 0), (THREE, 1), (THREE, 2)];
/// A board of each robot that is not the first, and the middle one of three.
const SOME: [(&str, usize); 3] = [(TWO, 1), (THREE, 1), (THREE, 2)];

/// These boards stop by the line in time.
fn stop(after: &After, boards: impl IntoIterator<Item = usize>, what: &str) {
    for board in boards {
        let stopped_s = after.first_s(board, &[BoardState::Stopping]).expect(what);
        println!(
            "{what}: board {} stops after {:.2} ms",
            board + 1,
            stopped_s * 1e3
        );
        assert!(stopped_s <= LINE_S, "{what}: {stopped_s} s");
        let parked_s = after.first_s(board, &[BoardState::Fault]);
        println!(
            "{what}: board {} has closed its brakes after {parked_s:.2?} s",
            board + 1
        );
        assert_eq!(after.last[board], BoardState::Fault, "{what}");
    }
}

#[test]
fn l19_a_board_without_supply_stops_the_others() {
    for (robot, board) in EVERY {
        let after = disturbed(robot, 5, PARKED_US, |simulation| {
            simulation.set_power_of(board, false).unwrap();
        });
        stop(
            &after,
            after.others(board),
            &format!("{robot}: {} has no supply", board + 1),
        );
        assert!(lost(&after).contains(&name(board)), "{}", lost(&after));
    }
}

#[test]
fn l19_a_board_that_resets_itself_stops_the_others() {
    for failure in [BoardFailure::Crash, BoardFailure::SupplyLow] {
        for (robot, board) in SOME {
            let after = disturbed(robot, 8, PARKED_US, |simulation| {
                simulation.fail_board_of(board, failure, true).unwrap();
            });
            stop(
                &after,
                after.others(board),
                &format!("{robot}: {} resets", board + 1),
            );
            assert!(lost(&after).contains(&name(board)), "{}", lost(&after));
        }
    }
}

#[test]
fn l19_a_short_reset_stops_the_others_and_the_board_is_named() {
    // The board runs again 5 ms later, without its session.
    for (robot, board) in SOME {
        let after = disturbed_again(robot, 9, PARKED_US, |simulation, since_us| {
            let on = since_us < 5000;
            simulation
                .fail_board_of(board, BoardFailure::Crash, on)
                .unwrap();
        });
        stop(
            &after,
            after.others(board),
            &format!("{robot}: short reset of {}", board + 1),
        );
        match &after.done {
            Err(RunError::Fault { record, .. }) => {
                assert_eq!(record.fault, FaultId::P4);
                let said = describe_fault(record);
                assert!(said.contains(&format!("board {}", board + 1)), "{said}");
            }
            _ => assert!(lost(&after).contains(&name(board)), "{}", lost(&after)),
        }
    }
}

#[test]
fn l19_a_fault_of_one_board_stops_the_others_within_3_ms_of_it_and_the_first_fault_is_told() {
    for (robot, board, cable) in [(TWO, 1, 6), (THREE, 1, 6), (THREE, 2, 8), (THREE, 0, 2)] {
        let after = disturbed(robot, 3, 2_500_000, |simulation| {
            let faults = simulation.plant_mut().faults_mut();
            faults.cables[usize::from(cable) - 1].drive.silent = true;
        });
        let Err(RunError::Fault { record, .. }) = &after.done else {
            panic!("{robot}: {:?}", after.done);
        };
        assert_eq!(
            (record.fault, record.cable),
            (FaultId::D3, cable),
            "{robot}: {record:?}"
        );
        let own_s = after.first_s(board, &[BoardState::Stopping]).unwrap();
        for other in after.others(board) {
            let other_s = after.first_s(other, &[BoardState::Stopping]).unwrap();
            let later_s = other_s - own_s;
            println!(
                "{robot}: board {} {:.2} ms after the fault",
                other + 1,
                later_s * 1e3
            );
            assert!(later_s > 0.0 && later_s <= LINE_S, "{robot}: {later_s}");
        }
        assert_eq!(after.last[board], BoardState::Fault);
    }
}

#[test]
fn l19_the_lost_line_of_one_board_stops_the_others_when_it_holds() {
    let dead = WireFaults {
        drop: 1.0,
        ..WireFaults::default()
    };
    for (robot, board) in SOME {
        let after = disturbed(robot, 4, PARKED_US, |simulation| {
            simulation.set_faults_of(board, dead, dead)
        });
        assert!(lost(&after).contains(&name(board)), "{}", lost(&after));
        let reacts_s = |board: usize| {
            let states = [BoardState::Pausing, BoardState::Stopping];
            after.first_s(board, &states).unwrap()
        };
        let own_s = reacts_s(board);
        for other in after.others(board) {
            let other_s = reacts_s(other);
            println!(
                "{robot}: lost line: {:.2} and {:.2} ms",
                other_s * 1e3,
                own_s * 1e3
            );
            // Whichever comes first: the host or the wire.
            assert!(other_s <= own_s + LINE_S, "{other_s} {own_s}");
            assert_eq!(after.last[other], BoardState::Fault);
        }
    }
}

#[test]
fn l19_a_plug_that_is_pulled_in_motion_stops_every_board() {
    for (robot, board) in EVERY {
        let after = disturbed(robot, 10, PARKED_US, |simulation| {
            simulation.set_fault_line_of(board, FaultLineTap::Cut);
        });
        // Its board sees a low line at once, the others are told by the host: their own wires are whole.
        stop(
            &after,
            [board],
            &format!("{robot}: plug of {} pulled", board + 1),
        );
        for other in after.others(board) {
            let other_s = after.first_s(other, &[BoardState::Stopping]).unwrap();
            println!("{robot}: board {} after {:.1} ms", other + 1, other_s * 1e3);
            assert!(other_s < HOST_S, "{robot}: {other_s} s");
        }
        let Err(RunError::Fault { record, .. }) = after.done else {
            panic!("{:?}", after.done);
        };
        assert_eq!(record.fault, FaultId::L19);
        let said = describe_fault(&record);
        assert!(said.contains(&format!("board {}", board + 1)), "{said}");
    }
}

/// What the host says when it arms with a board's connection damaged.
fn refused(robot: &str, board: usize, tap: FaultLineTap) -> String {
    let model = model_of(robot);
    let link = robot_line(&model, 11, &APART);
    link.with(|simulation| simulation.set_fault_line_of(board, tap));
    let (done, seen) = run(&link, &model, &Handle::new(), |_, _| {});
    let works = |states: &[BoardState]| states.iter().any(|s| *s != BoardState::Disarmed);
    let armed = seen
        .iter()
        .skip_while(|(_, states)| states.contains(&BoardState::Boot));
    assert!(!armed.clone().any(|(_, states)| works(states)), "{seen:?}");
    let Err(RunError::Client(ClientError::Link(LinkError::Boards { what, .. }))) = done else {
        panic!("{done:?}");
    };
    println!("{robot}: {tap:?} at {board}: {what}");
    what
}

#[test]
fn a_cut_of_the_line_is_noticed_and_named_before_anything_arms() {
    for (robot, board) in EVERY {
        let name = name(board);
        let what = refused(robot, board, FaultLineTap::Cut);
        assert!(what.contains(&format!("wire to {name} is cut")), "{what}");
        let what = refused(robot, board, FaultLineTap::Deaf);
        assert!(what.contains(&format!("wire to {name} is cut")), "{what}");
        let what = refused(robot, board, FaultLineTap::Mute);
        assert!(what.contains(&format!("{name} does not pull")), "{what}");
    }
}

#[test]
fn a_line_that_another_board_holds_low_forbids_arming_with_its_name() {
    // Nothing is known of who holds it low: a short to ground.
    for robot in [TWO, THREE] {
        let model = model_of(robot);
        let link = robot_line(&model, 12, &APART);
        link.with(|simulation| {
            for board in 0..simulation.boards() {
                simulation.set_fault_line_of(board, FaultLineTap::Cut);
            }
        });
        let (done, _) = run(&link, &model, &Handle::new(), |_, _| {});
        let said = format!("{done:?}");
        assert!(said.contains("low at every board"), "{said}");
    }
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
    let model = model_of(TWO);
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
    let model = model_of(TWO);
    let link = robot_line(&model, 14, &APART);
    let mut pressed = false;
    let (done, seen) = run(&link, &model, &Handle::new(), |simulation, now_us| {
        if !pressed && now_us > 900_000 {
            pressed = true;
            simulation.plant_mut().set_e_stop(true);
        }
    });
    let armed = |(_, states): &(u64, Vec<BoardState>)| states.contains(&BoardState::Arming);
    assert!(pressed && !seen.iter().any(armed), "{seen:?}");
    let said = format!("{done:?}");
    let named = said.contains("P7") || said.contains("EStop");
    assert!(named && !said.contains("Boards"), "{said}");
}
