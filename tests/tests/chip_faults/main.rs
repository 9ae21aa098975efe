//! The rows of the fault list on the emulated chip, which executes the firmware's own file: faults
//! at its pins, its bus, its line, its plant, its processor and its host, and requests that it must
//! refuse. The ids of the rows are in the tests' names.
//!
//! With `MCDPR_IN_THE_LOOP=emulated` the chip is in another process, behind the three wires of a board in the loop; with
//! `MCDPR_IN_THE_LOOP=hil:PORT,CAN,PORT` the tests run against a real board (docs/hil.md). Then the tests of `processor`
//! and the chip's half of `floods` cannot run: they reach into the processor.
//!
//! `cargo xtask test` builds the file and says where it is. The board reports its state over the line:
//! some ms of every time here are the report.

mod floods;
mod processor;
mod reactions;
mod refusals;

use mcdpr::experiment::SimulatedRobot;
use mcdpr::link::{Link, SimulatedLink};
use mcdpr::machine::{self, Controller, Mismatch};
use mcdpr::motion::{Model, Task};
use mcdpr::robot::Robot;
use mcdpr::scenario::{self, Aftermath, Injection, Scenario};
use mcdpr_emulator::SharedChip;
use mcdpr_simulator::{LinkOptions, Simulation};
use mcdpr_tests::chip::{LINE, firmware};
use mcdpr_tests::in_the_loop;

fn model() -> Model {
    Model::new(&Robot::built_in("paper-optimistic").unwrap()).unwrap()
}

fn line() -> Task {
    Task::parse(LINE, "line.toml".into()).unwrap()
}

/// What controls the robots: the chip, here or in the loop.
fn controller() -> Controller {
    in_the_loop::wires().map_or_else(|| Controller::Chip(firmware()), Controller::Hil)
}

/// Runs the line on the chip with these faults.
fn run_on(model: &Model, words: &[&str]) -> Aftermath {
    let robot = SimulatedRobot::new(Mismatch::realistic(), 3).controller(&controller());
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

/// What a test sees of the board besides its messages.
struct Seen {
    link: SimulatedLink,
    /// Where it is in this process.
    chip: Option<SharedChip>,
}

impl Seen {
    /// The chip itself.
    fn chip(&self) -> &SharedChip {
        let chip = self.chip.as_ref();
        chip.expect("this test reaches into the processor: not in the loop")
    }

    /// Whether the board has run on since it got power.
    fn was_never_reset(&self) -> bool {
        if let Some(chip) = &self.chip {
            return chip.with(|chip| chip.resets().is_empty());
        }
        let mut link = self.link.clone();
        let since_ms = link.now_us() / 1000;
        // It took some ms to start, and some to answer.
        u64::from(refusals::status(&mut link).tick.0) + 100 > since_ms
    }

    /// Whether a brake of the plant is open.
    fn any_brake_open(&self) -> bool {
        let truth = self.link.with(|simulation| simulation.plant().truth());
        truth
            .unwrap()
            .brakes_closed
            .iter()
            .take(4)
            .any(|closed| !closed)
    }
}

/// The paper's robot at home in front of a chip, and what can be seen of the chip.
fn robot(model: &Model) -> (SimulatedLink, Seen) {
    let home = model.rest_at_home().unwrap();
    let params = machine::plant_params(model.robot(), &Mismatch::realistic(), 3);
    let (pose, tensions) = (&home.equilibrium.pose, home.tensions_n());
    let plant = machine::hang(params, pose, tensions, model.holding().by_tension(), 3).unwrap();
    let options = LinkOptions::default();
    let (simulation, chip) = if let Controller::Hil(_) = controller() {
        (
            machine::with_board(plant, &options, 3, &controller()).unwrap(),
            None,
        )
    } else {
        let board = firmware().board().unwrap();
        let chip = board.chip();
        let simulation = Simulation::with_board(plant, Box::new(board), &options, 3);
        (simulation, Some(chip))
    };
    let link = SimulatedLink::new(simulation);
    (link.clone(), Seen { link, chip })
}
