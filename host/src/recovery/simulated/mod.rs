//! A simulated robot in motion that loses power: faults at the plant, the line and the supplies, never in
//! the memory of host or board.

mod after;
mod fall;

pub use after::AfterCut;

use super::MemoryDisk;
use super::writer::{About, JournalWriter};
use crate::experiment::{Experiment, in_known_frame};
use crate::link::{ClientError, plant_failed};
use crate::machine::{self, Controller, Mismatch, of_calibration};
use crate::motion::{Model, Task};
use crate::record::EventBus;
use crate::record::events::{Patience, Watched};
use crate::run::saved::scale_of;
use crate::run::{Homing, RunError};
use crate::scenario::{FaultyLink, Injection, Supply, When};
use fall::{fallen, moved};
use mcdpr_core::random::Random;
use mcdpr_protocol::frame::crc32;
use mcdpr_protocol::{FaultId, SessionId};
use mcdpr_simulator::{LinkOptions, Simulation};
use nalgebra::Vector3;

/// Board and robot come to rest after the power is back, µs.
const SETTLE_US: u64 = 5_000_000;

/// What else happens.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Disturbance {
    /// Nothing.
    None,
    /// A brake holds only this force from the cut on, N.
    Weak {
        /// The cable, from 0.
        cable: usize,
        /// Its holding force, N.
        holds_n: f64,
    },
    /// A brake closes late.
    Late {
        /// The cable, from 0.
        cable: usize,
        /// By how much, s.
        by_s: f64,
    },
    /// A person moves the platform and turns the drums after it.
    Moved {
        /// From where it hung, world, m.
        by_m: [f64; 3],
    },
}

/// A motion that is interrupted by a loss of power.
#[derive(Debug, Clone)]
pub struct SimulatedCut {
    /// The robot's task.
    pub task: Task,
    /// Difference of the machine from its file.
    pub mismatch: Mismatch,
    /// Seed of the machine and of everything else.
    pub seed: u64,
    /// The supply that fails.
    pub supply: Supply,
    /// Time of the cut after the motion's start, s.
    pub at_s: f64,
    /// Its duration, s.
    pub lasts_s: f64,
    /// What else happens.
    pub disturbance: Disturbance,
    /// Whether a camera saw the tags when the robot was homed.
    pub seen_at_home: bool,
    /// Whether the board's backup registers have a battery.
    pub battery: bool,
    /// The controller of the robot.
    pub controller: Controller,
}

/// Closing time of a brake over the robot file's, middle and half width: an operating manual gives mean
/// values that are "subject to variations", for a warm coil and the rated air gap (INTORQ BFK458, BA
/// 14.0217, table 9: 28 ms for 4 Nm). Their size is an assumption.
const CLOSE: [f64; 2] = [1.05, 0.25];
/// Its holding force, N, middle and half width: 4 Nm of the same table at a drum of 20 mm would be 200 N.
const HOLDS_N: [f64; 2] = [155.0, 95.0];
/// Friction of a winch over the robot file's, half width; assumption.
const FRICTION: f64 = 0.33;
/// A tension sensor's zero, half width, N: 0.5 % of 39 N, what 10 K do to a simple load cell with 0.05 % per
/// kelvin.
const ZERO_N: f64 = 0.2;
/// The place of the tool while the robot is homed, half width per axis, m: that of anchors after a
/// calibration ([`Mismatch::realistic`]).
const HOMED_M: f64 = 3e-4;

/// What else differs from the robot file.
fn differ(params: &mut mcdpr_simulator::plant::PlantParams, seed: u64) {
    let mut random = Random::new(seed ^ 0x6272_616B);
    for winch in &mut params.winches {
        let brake = &mut winch.brake;
        brake.close_delay_s *= CLOSE[0] + random.within(CLOSE[1]);
        brake.holding_n = HOLDS_N[0] + random.within(HOLDS_N[1]);
        winch.friction_n *= 1.0 + random.within(FRICTION);
    }
    for winch in &mut params.winches {
        let sensor = &mut winch.sensor;
        sensor.zero_v += random.within(ZERO_N) / sensor.gain_n_per_v;
    }
}

/// Runs the task until the cut and after it. `None` where the task is done before the cut.
///
/// # Errors
/// Where the task cannot be planned, the machine cannot hang, or physics end.
pub fn simulate(model: &Model, case: &SimulatedCut) -> Result<Option<AfterCut>, RunError> {
    let plant = |error| RunError::Client(ClientError::from(plant_failed(error)));
    let robot = model.robot();
    let machine = of_calibration(robot, 1);
    let (built, mismatch, built_seed) = machine.unwrap_or((robot, case.mismatch, case.seed));
    let described = Model::new(built)?.with_options(model.options());
    let home = described.rest_at_home()?;
    let mut params = machine::plant_params(built, &mismatch, built_seed);
    differ(&mut params, case.seed);
    let (pose, held, seed) = (
        &home.equilibrium.pose,
        model.holding().by_tension(),
        case.seed,
    );
    let hung = machine::hang(params, pose, home.tensions_n(), held, seed).map_err(plant)?;
    let line = LinkOptions::default();
    let link = machine::line_to(built, hung, &line, seed, &case.controller)
        .map_err(|error| RunError::Client(error.into()))?;
    let mut random = Random::new(case.seed ^ 0x686F_6D65);
    let off_m = Vector3::from_fn(|_, _| random.within(HOMED_M));
    let truth = link.with(|simulation| simulation.plant().truth());
    let truth_m = in_known_frame(robot, &truth.map_err(plant)?.tool_position_m.into());
    let home_m = machine.map_or(robot.tool.home_in_world_m, |_| truth_m);
    let place_m = home_m + off_m;
    let homed_off_m = place_m - truth_m;
    let reference = if case.seen_at_home {
        after::seen_at_home(model, &link, &place_m, case.seed)?
    } else {
        None
    };
    link.with(Simulation::record_truth);
    if case.battery {
        link.with(Simulation::fit_battery);
    }
    let mut injections = vec![Injection {
        lasts_s: Some(case.lasts_s),
        ..Injection::cut(case.supply, When::Motion(case.at_s))
    }];
    injections.extend(brake_fault(case));
    let faulty = FaultyLink::new(link.clone(), &injections);
    let disk = MemoryDisk::default();
    let mine = disk.clone();
    let about = About {
        session: 1,
        robot: robot.name.clone(),
        scale: scale_of(robot),
        task: case.task.name.clone(),
        task_hash: crc32(case.task.name.as_bytes()),
    };
    let mut events = EventBus::default();
    let writer = JournalWriter::new(about, move |_: &str| Ok(mine.clone()));
    if let Err(error) = events.add(writer, Patience::Wait) {
        let what = error.to_string();
        return Err(RunError::Sight(crate::sight::SightError::Simulation {
            what,
        }));
    }
    let watched = Watched::new(faulty.clone(), &events);
    let outcome = Experiment::new(model, case.task.clone())
        .session(SessionId(1))
        .homing(Homing::Place(place_m))
        .run_on(watched);
    events.finish();
    // An error is the expected end of a run whose power is cut; these two come before it.
    match outcome {
        Ok(_) => return Ok(None),
        Err(error @ (RunError::Plan(_) | RunError::Config(_))) => return Err(error),
        Err(_) => {}
    }
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "some seconds"
    )]
    let lasts_us = (case.lasts_s * 1e6) as u64;
    faulty
        .settle(lasts_us + SETTLE_US)
        .map_err(ClientError::from)?;
    let trace = link.with(Simulation::take_trace);
    let cut_s = faulty
        .injected_ms()
        .first()
        .map_or(0.0, |ms| *ms as f64 * 1e-3);
    let (drop_m, speed_mps) = fallen(&trace, cut_s, model);
    if let Disturbance::Moved { by_m } = case.disturbance {
        moved(model, &link, Vector3::from(by_m))?;
    }
    let alive = matches!(
        case.supply,
        Supply::Board | Supply::Drives | Supply::Dip | Supply::Crash
    );
    Ok(Some(AfterCut {
        drop_m: if case.supply == Supply::Host {
            0.0
        } else {
            drop_m
        },
        speed_mps,
        together: case.supply == Supply::All,
        reference,
        homed_off_m,
        ..AfterCut::of(link, &disk, alive, case.seed)?
    }))
}

fn brake_fault(case: &SimulatedCut) -> Option<Injection> {
    // With the cut: an open brake has no effect, and arming has tested it.
    let when = When::Motion((case.at_s - 0.002).max(0.0));
    match case.disturbance {
        Disturbance::Weak { cable, holds_n } => Some(Injection {
            cable,
            // The nominal fault leaves a fiftieth, of 155 N in the middle.
            strength: 0.02 * 155.0 / holds_n.max(0.1),
            ..Injection::new(FaultId::B2, when)
        }),
        Disturbance::Late { cable, by_s } => Some(Injection {
            cable,
            // The fault's own delay is 0.3 s at strength 1.
            strength: by_s / 0.3,
            ..Injection::new(FaultId::B3, when)
        }),
        Disturbance::None | Disturbance::Moved { .. } => None,
    }
}
