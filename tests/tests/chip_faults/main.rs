//! The rows of the fault list on the emulated chip, which executes the firmware's own file: faults
//! at its pins, its bus, its line, its plant, its processor and its host, and requests that it must
//! refuse. The ids of the rows are in the tests' names.
//!
//! `cargo xtask test` builds the file and says where it is. The board reports its state over the line:
//! some ms of every time here are the report.

mod floods;
mod processor;
mod reactions;
mod refusals;

use mcdpr::experiment::SimulatedRobot;
use mcdpr::link::SimulatedLink;
use mcdpr::machine::{self, Controller, Mismatch};
use mcdpr::motion::{Model, Task};
use mcdpr::robot::Robot;
use mcdpr::scenario::{self, Aftermath, Injection, Scenario};
use mcdpr_emulator::SharedChip;
use mcdpr_simulator::{LinkOptions, Simulation};
use mcdpr_tests::chip::{LINE, firmware};

fn model() -> Model {
    Model::new(&Robot::built_in("paper-optimistic").unwrap()).unwrap()
}

fn line() -> Task {
    Task::parse(LINE, "line.toml".into()).unwrap()
}

/// Runs the line on the chip with these faults.
fn run_on(model: &Model, words: &[&str]) -> Aftermath {
    let robot =
        SimulatedRobot::new(Mismatch::realistic(), 3).controller(&Controller::Chip(firmware()));
    let injections = words.iter().map(|word| Injection::parse(word, 4).unwrap());
    let scenario = Scenario {
        name: words.join(" "),
        injections: injections.collect(),
    };
    scenario::run(model, line(), &robot, &scenario).unwrap()
}

/// The same, on the paper's robot.
fn run_with(words: &[&str]) -> Aftermath {
    run_on(&model(), words)
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
