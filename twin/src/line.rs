//! The simulated robot in virtual time.

use mcdpr_core::link::{Link, LinkError};
use mcdpr_simulator::Simulation;
use mcdpr_simulator::plant::PlantError;
use std::cell::RefCell;
use std::rc::Rc;

/// A line to a [`Simulation`]. Waiting on it is what makes its time pass.
///
/// Clones share the simulation, so that a caller can read the true state independently of a client.
#[derive(Clone)]
pub struct SimulatedLink {
    simulation: Rc<RefCell<Simulation>>,
}

impl SimulatedLink {
    /// A line to this simulation.
    #[must_use]
    pub fn new(simulation: Simulation) -> Self {
        Self {
            simulation: Rc::new(RefCell::new(simulation)),
        }
    }

    /// Accesses the simulation, to read or to disturb it.
    pub fn with<R>(&self, look: impl FnOnce(&mut Simulation) -> R) -> R {
        look(&mut self.simulation.borrow_mut())
    }
}

impl Link for SimulatedLink {
    fn now_us(&self) -> u64 {
        self.simulation.borrow().now_us()
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.simulation.borrow_mut().send(bytes);
        Ok(())
    }

    fn receive(&mut self, until_us: u64, into: &mut Vec<u8>) -> Result<u64, LinkError> {
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
