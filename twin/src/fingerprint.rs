//! A hash of everything that happens in a simulated run: the same on every computer and in a browser.

use crate::events::RunEvent;
use crate::line::{SimulatedLink, in_process};
use crate::plant::{Mismatch, at_rest};
use crate::watched::{Sink, TruthTap, Watched};
use mcdpr_core::control::Handle;
use mcdpr_core::link::Direction;
use mcdpr_core::motion::{Model, Task};
use mcdpr_core::run::{Homing, NoStore, Recorder, RunError, Session};
use mcdpr_protocol::SessionId;
use mcdpr_simulator::LinkOptions;
use sha2::{Digest, Sha256};
use std::cell::{Cell, RefCell};

/// What a run was, as a number.
#[derive(Debug, Clone, PartialEq)]
pub struct Fingerprint {
    /// SHA-256, in hexadecimal digits.
    pub sha256: String,
    /// Virtual time that passed, s.
    pub simulated_s: f64,
    /// Bytes on the line, both ways.
    pub bytes: u64,
    /// True states that were hashed, one in ten ticks.
    pub states: u64,
}

#[derive(Default)]
struct Hasher {
    hash: RefCell<Sha256>,
    bytes: Cell<u64>,
    states: Cell<u64>,
}

impl Sink for Hasher {
    fn publish(&self, event: RunEvent) {
        let mut hash = self.hash.borrow_mut();
        match event {
            RunEvent::Wire { frame, .. } => {
                hash.update(frame.time_us.to_le_bytes());
                hash.update([u8::from(frame.direction == Direction::ToBoard)]);
                hash.update(&frame.bytes);
                self.bytes.set(self.bytes.get() + frame.bytes.len() as u64);
            }
            RunEvent::Truth { truth, .. } => {
                let pose = truth.tool_m.into_iter().chain(truth.position_m);
                let values = pose.chain(truth.rotation_xyzw).chain(truth.tensions_n);
                for value in values {
                    hash.update(value.to_bits().to_le_bytes());
                }
                self.states.set(self.states.get() + 1);
            }
            // Made from the same bytes.
            _ => {}
        }
    }

    fn is_empty(&self) -> bool {
        false
    }
}

/// Runs a task on the simulated robot from home until its brakes are closed again, and hashes each byte on
/// the line with its time, and the bits of the true pose and tensions.
///
/// # Errors
/// The run's.
pub fn fingerprint(
    model: &Model,
    task: Task,
    mismatch: &Mismatch,
    seed: u64,
) -> Result<Fingerprint, RunError> {
    let plant = at_rest(model, model.robot(), mismatch, seed, None)?;
    let line = LinkOptions::default();
    let link = SimulatedLink::of(model.robot(), plant, &line, seed, &in_process)
        .map_err(|error| RunError::Client(error.into()))?;
    let tap = TruthTap::forgetful(link.clone(), model.robot().cables.len());
    let hasher = Hasher::default();
    let line = Watched::new(link.clone(), &hasher).with_truth(tap);
    let home = Homing::Place(model.robot().tool.home_in_world_m);
    let (number, handle) = (SessionId(1), Handle::new());
    let mut session = Session::open(model, line, number, &handle, home, &NoStore)?;
    let plan = session.plan(task, None)?;
    session.arm()?;
    session.follow(&plan, &mut Recorder::default(), |_| {})?;
    session.disarm()?;
    let digest = hasher.hash.borrow().clone().finalize();
    Ok(Fingerprint {
        sha256: digest.iter().map(|byte| format!("{byte:02x}")).collect(),
        simulated_s: link.with(|simulation| simulation.now_us() as f64 * 1e-6),
        bytes: hasher.bytes.get(),
        states: hasher.states.get(),
    })
}
