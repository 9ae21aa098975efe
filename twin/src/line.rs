//! The simulated robot in virtual time.

use mcdpr_core::boards::{Boards, Lines};
use mcdpr_core::link::{Link, LinkError};
use mcdpr_core::random::Random;
use mcdpr_core::robot::Robot;
use mcdpr_simulator::plant::{Plant, PlantError};
use mcdpr_simulator::{BoardPlace, BoardTime, LinkOptions, Simulation, VirtualBoard};
use std::cell::RefCell;
use std::rc::Rc;

/// A board's crystal is off by at most this, parts in a million: two differ by twice as much.
const CRYSTAL_PPM: f64 = 60.0;
/// Salt of the boards' clocks in a machine's seed.
const CLOCKS: u64 = 0x636C_6F63_6B73;

/// A board of a simulated robot that is not the control core in this process.
pub type ExtraBoard = Box<dyn VirtualBoard + Send>;

/// Makes the board of these cables of a plant, number n of its robot; `None` is the control core in this process.
pub type MakeBoard<'a> = &'a dyn Fn(&[usize], u8) -> Result<Option<ExtraBoard>, PlantError>;

/// A line to a [`Simulation`]. Waiting on it is what makes its time pass.
///
/// Clones share the simulation, so that a caller can read the true state independently of a client.
/// Several boards are one behind this line.
#[derive(Clone)]
pub struct SimulatedLink {
    simulation: Rc<RefCell<Simulation>>,
    boards: Option<Rc<RefCell<Boards<SimulatedLines>>>>,
}

/// The lines to several boards of a simulation.
#[derive(Clone)]
pub struct SimulatedLines {
    simulation: Rc<RefCell<Simulation>>,
}

impl Lines for SimulatedLines {
    fn count(&self) -> usize {
        self.simulation.borrow().boards()
    }

    fn now_us(&self) -> u64 {
        self.simulation.borrow().now_us()
    }

    fn send(&mut self, line: usize, bytes: &[u8]) -> Result<(), LinkError> {
        self.simulation.borrow_mut().send_to(line, bytes);
        Ok(())
    }

    fn receive(&mut self, until_us: u64, into: &mut [Vec<u8>]) -> Result<u64, LinkError> {
        let mut simulation = self.simulation.borrow_mut();
        simulation
            .advance_all(until_us, into)
            .map_err(plant_failed)?;
        Ok(simulation.now_us())
    }

    fn name(&self, line: usize) -> String {
        format!("simulated {:02}", line + 1)
    }

    fn path_begins(&mut self, ms: u32) {
        self.simulation.borrow_mut().set_path_zero(ms);
    }
}

/// The clocks of a machine's boards, by its seed.
fn times(boards: usize, seed: u64) -> Vec<BoardTime> {
    let mut random = Random::new(seed ^ CLOCKS);
    let each = (0..boards).map(|_| BoardTime {
        slow_ppm: random.within(CRYSTAL_PPM),
        // Anywhere in the first millisecond.
        begins_us: 500.0 + random.within(499.0),
        ..BoardTime::default()
    });
    each.collect()
}

impl SimulatedLink {
    /// A line to this simulation.
    #[must_use]
    pub fn new(simulation: Simulation) -> Self {
        Self {
            simulation: Rc::new(RefCell::new(simulation)),
            boards: None,
        }
    }

    /// A line to a plant in its present state, controlled by as many boards as the robot has: the
    /// control core in this process, or the boards that `board` makes for these cables of the
    /// plant.
    ///
    /// # Errors
    /// No board drives such a robot.
    pub fn of(
        robot: &Robot,
        plant: Plant,
        link: &LinkOptions,
        seed: u64,
        board: MakeBoard<'_>,
    ) -> Result<Self, LinkError> {
        let times = times(robot.boards.len(), seed);
        Self::timed(robot, plant, link, seed, board, &times)
    }

    /// As [`Self::of`], with these clocks of the boards.
    ///
    /// # Errors
    /// As [`Self::of`].
    pub fn timed(
        robot: &Robot,
        plant: Plant,
        link: &LinkOptions,
        seed: u64,
        board: MakeBoard<'_>,
        times: &[BoardTime],
    ) -> Result<Self, LinkError> {
        if robot.boards.is_empty() {
            let cables: Vec<usize> = (0..plant.cable_count()).collect();
            return match board(&cables, 0).map_err(plant_failed)? {
                None => Simulation::new(plant, link, seed).map_err(plant_failed),
                Some(board) => Ok(Simulation::with_board(plant, board, link, seed)),
            }
            .map(Self::new);
        }
        let mut places = Vec::new();
        for ((number, of), time) in (0..).zip(&robot.boards).zip(times) {
            places.push(BoardPlace {
                cables: of.cables.clone(),
                time: *time,
                link: *link,
                board: board(&of.cables, number).map_err(plant_failed)?,
            });
        }
        let simulation = Simulation::with_boards(plant, places, seed).map_err(plant_failed)?;
        let simulation = Rc::new(RefCell::new(simulation));
        Self::joined(robot, SimulatedLines { simulation })
    }

    /// A line to the boards of a robot behind these lines.
    ///
    /// # Errors
    /// A value of the robot does not fit a board.
    pub fn joined(robot: &Robot, lines: SimulatedLines) -> Result<Self, LinkError> {
        let simulation = Rc::clone(&lines.simulation);
        let boards = Boards::new(robot, lines).map_err(|error| LinkError::Boards {
            what: error.to_string(),
            help: "correct the value in the robot file; see docs/robot-file.md".into(),
        })?;
        Ok(Self {
            simulation,
            boards: boards.map(|boards| Rc::new(RefCell::new(boards))),
        })
    }

    /// The lines to the boards, if there are several.
    #[must_use]
    pub fn lines(&self) -> Option<SimulatedLines> {
        let simulation = Rc::clone(&self.simulation);
        self.boards.as_ref().map(|_| SimulatedLines { simulation })
    }

    /// Accesses the simulation, to read or to disturb it.
    pub fn with<R>(&self, look: impl FnOnce(&mut Simulation) -> R) -> R {
        look(&mut self.simulation.borrow_mut())
    }
}

/// The control core in this process on every board.
///
/// # Errors
/// Never.
pub fn in_process(_cables: &[usize], _number: u8) -> Result<Option<ExtraBoard>, PlantError> {
    Ok(None)
}

impl Link for SimulatedLink {
    fn goes_on(&self) -> bool {
        self.simulation.borrow().goes_on()
    }

    fn now_us(&self) -> u64 {
        self.simulation.borrow().now_us()
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        if let Some(boards) = &self.boards {
            return boards.borrow_mut().send(bytes);
        }
        self.simulation.borrow_mut().send(bytes);
        Ok(())
    }

    fn receive(&mut self, until_us: u64, into: &mut Vec<u8>) -> Result<u64, LinkError> {
        if let Some(boards) = &self.boards {
            return boards.borrow_mut().receive(until_us, into);
        }
        let mut simulation = self.simulation.borrow_mut();
        let mut arrived = Vec::new();
        simulation
            .advance(until_us, &mut arrived)
            .map_err(plant_failed)?;
        into.append(&mut arrived);
        Ok(simulation.now_us())
    }
}

/// A failure of the simulated robot as an error for the client of its board.
#[must_use]
pub fn plant_failed(error: PlantError) -> LinkError {
    match error {
        PlantError::Board { reason } => LinkError::Board { reason },
        other => LinkError::Plant(Box::new(other)),
    }
}
