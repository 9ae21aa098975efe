//! One robot on two emulated chips, each of which executes the firmware's file: what the fault line between them does.

#[path = "../../twin/tests/two_boards/mod.rs"]
mod two_boards;

use mcdpr_core::control::Handle;
use mcdpr_core::link::{ClientError, LinkError};
use mcdpr_core::motion::Model;
use mcdpr_core::run::RunError;
use mcdpr_emulator::{Drive, SharedChip};
use mcdpr_protocol::{BoardState, FaultId};
use mcdpr_simulator::{FaultLineTap, LinkOptions, Simulation};
use mcdpr_tests::chip::firmware;
use mcdpr_twin::SimulatedLink;
use mcdpr_twin::plant::{Mismatch, at_rest};
use std::cell::RefCell;
use two_boards::{APART, model, run};

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
    let model = model();
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
    let model = model();
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
