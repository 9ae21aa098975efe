//! One robot on two emulated chips, each of which executes the firmware's file: what the fault line between them does.
//!
//! The firmware takes four cables, and a robot has eight at most. So of three boards the first alone is a chip; the other
//! two are the control core in this process, as another program of the same commit.

#[path = "../../twin/tests/several_boards/mod.rs"]
mod several_boards;

use mcdpr_core::control::Handle;
use mcdpr_core::link::{Client, ClientError, LinkError};
use mcdpr_core::motion::Model;
use mcdpr_core::run::RunError;
use mcdpr_emulator::{Drive, SharedChip};
use mcdpr_protocol::{BoardState, FaultId, PROTOCOL_MAJOR, PROTOCOL_MINOR, SessionId};
use mcdpr_simulator::{FaultLineTap, LinkOptions, Simulation, WireVersion};
use mcdpr_tests::chip::firmware;
use mcdpr_twin::SimulatedLink;
use mcdpr_twin::plant::{Mismatch, at_rest};
use several_boards::{APART, THREE, TWO, model_of, run};
use std::cell::RefCell;

/// Within this time of the loss the other board must have reacted, µs.
const LINE_US: u64 = 3000;
/// Time in motion before something happens, µs.
const MOVING_US: u64 = 500_000;

fn two_chips(model: &Model) -> (SimulatedLink, Vec<SharedChip>) {
    let robot = model.robot();
    let plant = at_rest(model, robot, &Mismatch::default(), 1, None).unwrap();
    let chips = RefCell::new(Vec::new());
    let make = |cables: &[usize], number: u8| {
        let board = firmware().board().unwrap().wired(cables, number).unwrap();
        chips.borrow_mut().push(board.chip());
        Ok(Some(Box::new(board) as _))
    };
    let line = LinkOptions::default();
    let link = SimulatedLink::timed(robot, plant, &line, 1, &make, &APART).unwrap();
    (link, chips.into_inner())
}

/// What the chip says of its firmware.
fn hash_of_the_chip() -> [u8; 8] {
    let of_four = model_of("lab-fast");
    let plant = at_rest(&of_four, of_four.robot(), &Mismatch::default(), 1, None).unwrap();
    let alone = firmware().board().unwrap();
    let alone = Simulation::with_board(plant, Box::new(alone), &LinkOptions::default(), 1);
    let client = Client::connect(SimulatedLink::new(alone), SessionId(1)).unwrap();
    client.hello().git_hash
}

/// Three boards, of which the first is a chip, and the others say this of their firmware.
fn chip_and_two(model: &Model, git_hash: [u8; 8]) -> (SimulatedLink, SharedChip) {
    let robot = model.robot();
    let plant = at_rest(model, robot, &Mismatch::default(), 1, None).unwrap();
    let chips = RefCell::new(Vec::new());
    let make = |cables: &[usize], number: u8| {
        if number > 0 {
            return Ok(None);
        }
        let board = firmware().board().unwrap().wired(cables, number).unwrap();
        chips.borrow_mut().push(board.chip());
        Ok(Some(Box::new(board) as _))
    };
    let version = WireVersion {
        major: PROTOCOL_MAJOR,
        minor: PROTOCOL_MINOR,
        git_hash,
    };
    let line = LinkOptions {
        version: Some(version),
        ..LinkOptions::default()
    };
    let link = SimulatedLink::timed(robot, plant, &line, 1, &make, &APART).unwrap();
    (link, chips.into_inner().remove(0))
}

/// The first chip's moments, simulated µs.
#[derive(Debug, Default, Clone, Copy)]
struct Moments {
    moves: Option<u64>,
    lost: Option<u64>,
    reacts: Option<u64>,
    /// Its brakes were still open then: it stops along the path.
    open: bool,
}

impl Moments {
    fn look(
        &mut self,
        simulation: &mut Simulation,
        first: &SharedChip,
        lose: impl FnOnce(&mut Simulation),
        now_us: u64,
    ) {
        if simulation.look_at(0).0 == BoardState::Moving {
            self.moves.get_or_insert(now_us);
        }
        let due = self.moves.is_some_and(|began| now_us >= began + MOVING_US);
        if due && self.lost.is_none() {
            lose(simulation);
            self.lost = Some(now_us);
        }
        // It tells its own fault by the pin in the tick in which it stops.
        let pins = first.with(|chip| chip.pins());
        if self.lost.is_some() && self.reacts.is_none() && pins.well != Drive::Low {
            self.reacts = Some(now_us);
            self.open = pins.brakes == [Drive::High; 4];
        }
    }
}

/// Loses the second board in motion: the first one stops along its path, by the line.
fn loses(what: &str, lose: impl Fn(&SharedChip, &mut Simulation)) {
    let model = model_of(TWO);
    let (link, chips) = two_chips(&model);
    let mut moments = Moments::default();
    let (done, _) = run(&link, &model, &Handle::new(), |simulation, now_us| {
        let lose = |simulation: &mut Simulation| lose(&chips[1], simulation);
        moments.look(simulation, &chips[0], lose, now_us);
    });
    let said = format!("{done:?}");
    let (Some(lost), Some(reacts)) = (moments.lost, moments.reacts) else {
        panic!("{what}: {moments:?} {said}");
    };
    println!("{what}: the other chip stops after {} us", reacts - lost);
    assert!(reacts - lost <= LINE_US, "{what}");
    assert!(moments.open, "{what}: it stops along its path");
    assert!(said.contains("board 2 (simulated 02)"), "{what}: {said}");
    link.with(|simulation| {
        let until_us = simulation.now_us() + 4_000_000;
        while simulation.now_us() < until_us {
            let mut unread = [Vec::new(), Vec::new()];
            simulation.advance_all(until_us, &mut unread).unwrap();
        }
        assert_eq!(simulation.look_at(0).0, BoardState::Fault, "{what}");
        let fault = simulation.fault().map(|record| record.fault);
        assert_eq!(fault, Some(FaultId::L19), "{what}");
    });
    let brakes = chips[0].with(|chip| chip.pins().brakes);
    assert_eq!(brakes, [Drive::Low; 4], "{what}");
}

#[test]
fn l19_a_chip_without_supply_stops_the_other() {
    loses("no supply", |_, simulation| {
        simulation.set_power_of(1, false).unwrap();
    });
}

#[test]
fn l19_a_chip_that_resets_stops_the_other() {
    loses("reset", |chip, _| {
        chip.with(|chip| chip.inject_hard_fault());
    });
}

#[test]
fn a_cut_of_the_line_between_two_chips_is_named_before_they_arm() {
    let model = model_of(TWO);
    for (tap, said) in [
        (FaultLineTap::Cut, "wire to board 2 (simulated 02) is cut"),
        (FaultLineTap::Mute, "board 2 (simulated 02) does not pull"),
    ] {
        let (link, chips) = two_chips(&model);
        link.with(|simulation| simulation.set_fault_line_of(1, tap));
        let (done, _) = run(&link, &model, &Handle::new(), |_, _| {});
        let Err(RunError::Client(ClientError::Link(LinkError::Boards { what, .. }))) = done else {
            panic!("{tap:?}: {done:?}");
        };
        assert!(what.contains(said), "{tap:?}: {what}");
        for chip in chips {
            assert!(!chip.with(|chip| chip.brakes_ever_opened()), "{tap:?}");
        }
    }
}

/// Loses a board's supply in motion; by their pins and states the others stop in time.
fn loses_of_three(lost_board: usize) {
    let model = model_of(THREE);
    let (link, chip) = chip_and_two(&model, hash_of_the_chip());
    link.with(Simulation::record_boards);
    let mut moments = Moments::default();
    let (done, _) = run(&link, &model, &Handle::new(), |simulation, now_us| {
        let lose = |simulation: &mut Simulation| {
            simulation.set_power_of(lost_board, false).unwrap();
        };
        moments.look(simulation, &chip, lose, now_us);
    });
    let said = format!("{done:?}");
    let name = several_boards::name(lost_board);
    assert!(said.contains(&name), "{said}");
    let lost = moments.lost.unwrap();
    let points = link.with(Simulation::take_boards);
    for board in (1..3).filter(|board| *board != lost_board) {
        let mut of_it = points.iter().filter(|point| point.board == board);
        let stops = of_it.find(|point| point.state == BoardState::Stopping);
        let after_us = stops.unwrap().at_us - lost as f64;
        println!(
            "{name} without supply: board {} after {after_us:.0} us",
            board + 1
        );
        assert!(after_us <= LINE_US as f64, "{after_us}");
    }
    if lost_board > 0 {
        let after_us = moments.reacts.unwrap() - lost;
        println!("{name} without supply: the chip after {after_us} us");
        assert!(after_us <= LINE_US && moments.open, "{moments:?}");
    }
}

#[test]
fn l19_boards_without_supply_stop_a_chip_beside_them_and_it_stops_them() {
    for board in 0..3 {
        loses_of_three(board);
    }
}

#[test]
fn a_chip_and_two_other_boards_move_as_one() {
    let model = model_of(THREE);
    let (link, _) = chip_and_two(&model, hash_of_the_chip());
    let (done, _) = run(&link, &model, &Handle::new(), |_, _| {});
    done.unwrap();
}

#[test]
fn boards_of_different_firmware_are_refused_with_both_names() {
    let model = model_of(THREE);
    let other = *b"feedbeef";
    let own = hash_of_the_chip();
    assert_ne!(own, other);
    let (link, chip) = chip_and_two(&model, other);
    let (done, _) = run(&link, &model, &Handle::new(), |_, _| {});
    let Err(RunError::Client(ClientError::Link(LinkError::Boards { what, help }))) = done else {
        panic!("{done:?}");
    };
    let said = format!(
        "runs firmware {}, board 2 (simulated 02) runs feedbeef",
        String::from_utf8_lossy(&own)
    );
    assert!(what.contains(&said), "{what}");
    assert!(help.contains("flash all boards"), "{help}");
    assert!(!chip.with(|chip| chip.brakes_ever_opened()));
}
