//! One robot on two emulated chips, each of which executes the firmware's file: what the fault line between them does.

use mcdpr::control::Handle;
use mcdpr::link::{ClientError, Link, LinkError, SimulatedLink};
use mcdpr::machine::{Mismatch, at_rest};
use mcdpr::motion::{Model, Task};
use mcdpr::robot::Robot;
use mcdpr::run::{Homing, NoStore, Recorder, RunError, Session};
use mcdpr_emulator::{Drive, SharedChip};
use mcdpr_protocol::{BoardState, FaultId, SessionId};
use mcdpr_simulator::{BoardTime, FaultLineTap, LinkOptions, Simulation};
use mcdpr_tests::chip::firmware;
use std::cell::RefCell;
use std::rc::Rc;

/// Crystals 120 ppm apart, ticks three quarters of a millisecond apart.
const APART: [BoardTime; 2] = [
    BoardTime {
        slow_ppm: 60.0,
        begins_us: 110.0,
    },
    BoardTime {
        slow_ppm: -60.0,
        begins_us: 860.0,
    },
];
/// Within this time of the loss the other board must have reacted, µs.
const LINE_US: u64 = 3000;
/// Time in motion before something happens, µs.
const MOVING_US: u64 = 500_000;

fn model() -> Model {
    Model::new(&Robot::built_in("eight-two-boards").unwrap()).unwrap()
}

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

fn drive(model: &Model, line: impl Link) -> Result<(), RunError> {
    let home = Homing::Place(model.robot().tool.home_in_world_m);
    let handle = Handle::new();
    let mut session = Session::open(model, line, SessionId(1), &handle, home, &NoStore)?;
    let plan = session.plan(Task::fitting(model)?, None)?;
    session.arm()?;
    session.follow(&plan, &mut Recorder::default(), |_| {})?;
    session.disarm()
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

struct Watching<F> {
    inner: SimulatedLink,
    chips: Vec<SharedChip>,
    lose: Option<F>,
    moments: Rc<RefCell<Moments>>,
}

impl<F: FnOnce(&mut Simulation)> Watching<F> {
    fn look(&mut self, now_us: u64) {
        let mut moments = self.moments.borrow_mut();
        let state = self.inner.with(|simulation| simulation.look_at(0).0);
        if state == BoardState::Moving {
            moments.moves.get_or_insert(now_us);
        }
        if moments
            .moves
            .is_some_and(|began| now_us >= began + MOVING_US)
            && let Some(lose) = self.lose.take()
        {
            self.inner.with(lose);
            moments.lost = Some(now_us);
        }
        // It tells its own fault by the pin in the tick in which it stops.
        let pins = self.chips[0].with(|chip| chip.pins());
        if moments.lost.is_some() && moments.reacts.is_none() && pins.well != Drive::Low {
            moments.reacts = Some(now_us);
            moments.open = pins.brakes == [Drive::High; 4];
        }
    }
}

impl<F: FnOnce(&mut Simulation)> Link for Watching<F> {
    fn now_us(&self) -> u64 {
        self.inner.now_us()
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.inner.send(bytes)
    }

    fn receive(&mut self, until_us: u64, into: &mut Vec<u8>) -> Result<u64, LinkError> {
        loop {
            let piece_us = until_us.min(self.inner.now_us() + 100);
            let before = into.len();
            let now = self.inner.receive(piece_us, into)?;
            self.look(now);
            if into.len() > before || now >= until_us {
                return Ok(now);
            }
        }
    }
}

/// Loses the second board in motion: the first one stops along its path, by the line.
fn loses(what: &str, lose: impl FnOnce(&SharedChip, &mut Simulation)) {
    let model = model();
    let (link, chips) = two_chips(&model);
    let moments = Rc::new(RefCell::new(Moments::default()));
    let second = chips[1].clone();
    let line = Watching {
        inner: link.clone(),
        chips: chips.clone(),
        lose: Some(|simulation: &mut Simulation| lose(&second, simulation)),
        moments: Rc::clone(&moments),
    };
    let done = drive(&model, line);
    let said = format!("{done:?}");
    let moments = *moments.borrow();
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
        let done = drive(&model, link);
        let Err(RunError::Client(ClientError::Link(LinkError::Boards { what, .. }))) = done else {
            panic!("{tap:?}: {done:?}");
        };
        assert!(what.contains(said), "{tap:?}: {what}");
        for chip in chips {
            assert!(!chip.with(|chip| chip.brakes_ever_opened()), "{tap:?}");
        }
    }
}
