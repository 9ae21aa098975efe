//! The simulated robot with a board in front of it.

use super::{Controller, Mismatch, plant_params};
use crate::hil::{HilBoard, Wires};
use crate::link::{LinkError, SimulatedLink};
use crate::robot::Robot;
use mcdpr_simulator::plant::{Plant, PlantError, PlantParams};
use mcdpr_simulator::{LinkOptions, Simulation, VirtualBoard};

/// A simulated machine whose winches are built in, with no cable on them yet, behind a line.
///
/// # Errors
/// If the description is not a valid machine.
pub fn simulate_unloaded(
    robot: &Robot,
    mismatch: &Mismatch,
    link: &LinkOptions,
    seed: u64,
    controller: &Controller,
) -> Result<Simulation, PlantError> {
    let params = PlantParams {
        cables_attached: false,
        ..plant_params(robot, mismatch, seed)
    };
    with_board(Plant::new(params, seed)?, link, seed, controller)
}

/// A line to the plant of a robot in its present state, with the boards that the robot has.
///
/// # Errors
/// If no board supports such a robot.
pub(crate) fn line_to(
    robot: &Robot,
    plant: Plant,
    link: &LinkOptions,
    seed: u64,
    controller: &Controller,
) -> Result<SimulatedLink, LinkError> {
    let bits_per_s = plant.params().bus.bitrate;
    SimulatedLink::of(robot, plant, link, seed, &|cables, number| {
        let firmware = match controller {
            Controller::InProcess => return Ok(None),
            Controller::Hil(_) if !robot.boards.is_empty() => {
                return Err(PlantError::Board {
                    reason: "one board can be in the loop, and the robot file names boards"
                        .to_owned(),
                });
            }
            Controller::Hil(wires) => return in_the_loop(wires, bits_per_s).map(Some),
            Controller::Chip(firmware) => firmware,
        };
        let board = firmware.board_for(cables, number);
        board.map(Some).ok_or_else(|| PlantError::Board {
            reason: "there is no emulated chip in this program".to_owned(),
        })
    })
}

/// The board behind these wires.
fn in_the_loop(wires: &Wires, bits_per_s: u32) -> Result<Box<dyn VirtualBoard + Send>, PlantError> {
    let board = HilBoard::open(wires, bits_per_s).map_err(|error| PlantError::Board {
        reason: error.to_string(),
    })?;
    Ok(Box::new(board))
}

/// A plant in its present state, behind a line, with a board that controls it.
///
/// # Errors
/// If no board supports such a plant.
pub fn with_board(
    plant: Plant,
    link: &LinkOptions,
    seed: u64,
    controller: &Controller,
) -> Result<Simulation, PlantError> {
    let firmware = match controller {
        Controller::InProcess => return Simulation::new(plant, link, seed),
        Controller::Hil(wires) => {
            let board = in_the_loop(wires, plant.params().bus.bitrate)?;
            return Ok(Simulation::with_board(plant, board, link, seed));
        }
        Controller::Chip(firmware) => firmware,
    };
    let board = firmware.board().ok_or_else(|| PlantError::Board {
        reason: "there is no emulated chip in this program".to_owned(),
    })?;
    Ok(Simulation::with_board(plant, Box::new(board), link, seed))
}
