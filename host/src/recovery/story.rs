//! A simulated robot at work whose power goes, and what happens meanwhile: everything at the plant,
//! the line and the supplies, nothing in the host's or the board's memory.

use super::writer::{About, JournalWriter};
use super::{Before, Journal, JournalError, MemoryDisk, Verdict, recover};
use crate::estimate::TagPlace;
use crate::experiment::Experiment;
use crate::link::{Client, ClientError, Link as _, SimulatedLink, plant_failed};
use crate::machine::{self, Controller, Mismatch};
use crate::motion::{Model, Task};
use crate::record::EventBus;
use crate::record::events::{Patience, Watched};
use crate::run::saved::scale_of;
use crate::run::{self, Homing, RunError};
use crate::scenario::{FaultyLink, Injection, Supply, When};
use crate::sight::{Scene, SimulatedTags, TagSource};
use mcdpr_core::random::Random;
use mcdpr_core::recovery::journal::Mark;
use mcdpr_protocol::frame::crc32;
use mcdpr_protocol::{FaultId, Request, SessionId};
use mcdpr_simulator::{LinkOptions, Simulation, TracePoint};
use nalgebra::Vector3;

/// Board and robot come to rest after the power is back, µs.
const SETTLE_US: u64 = 5_000_000;
/// Noise of a tag's corners, px.
const CORNER_PX: f64 = 0.1;
/// What a calibration leaves of the camera's mounting: half width, m and rad.
const MOUNTING: [f64; 2] = [2e-4, 3e-4];
/// What happens in this time after the cut is the drop, s.
const DROP_S: f64 = 0.6;

/// What else goes wrong.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Mishap {
    /// Nothing.
    None,
    /// A brake holds this much only, N, from the cut on.
    Weak {
        /// The cable, from 0.
        cable: usize,
        /// Its holding force, N.
        holds_n: f64,
    },
    /// A brake closes this late, s.
    Late {
        /// The cable, from 0.
        cable: usize,
        /// By how much, s.
        by_s: f64,
    },
    /// Somebody moves the platform and turns the drums after it, by this, m.
    Moved {
        /// From where it hung, world.
        by_m: [f64; 3],
    },
}

/// What happens.
#[derive(Debug, Clone)]
pub struct Story {
    /// What the robot does.
    pub task: Task,
    /// How far the machine is from its file.
    pub mismatch: Mismatch,
    /// Seed of the machine and of everything else.
    pub seed: u64,
    /// Whose supply goes.
    pub supply: Supply,
    /// When, s after the motion's start.
    pub at_s: f64,
    /// For how long, s.
    pub lasts_s: f64,
    /// What else goes wrong.
    pub mishap: Mishap,
    /// What controls the robot.
    pub controller: Controller,
}

/// What is left when the power is back.
pub struct Played {
    /// The line to the robot.
    pub link: SimulatedLink,
    /// The journal's bytes.
    pub journal: Vec<u8>,
    /// Up to where they are certain.
    pub mark: Option<Mark>,
    /// Number of its board.
    pub board: String,
    /// How far the tool fell below where its way led, m.
    pub drop_m: f64,
    /// Speed of the tool at the cut, m/s.
    pub speed_mps: f64,
    pub(super) seed: u64,
}

/// Brakes as they are: closing times within a quarter of the robot file's, holding 60 to 250 N, and
/// friction off by a third. Drawn apart from what a recovery assumes of them.
fn brakes(params: &mut mcdpr_simulator::plant::PlantParams, seed: u64) {
    let mut random = Random::new(seed ^ 0x6272_616B);
    for winch in &mut params.winches {
        let brake = &mut winch.brake;
        brake.close_delay_s *= 1.05 + random.within(0.25);
        brake.holding_n = 155.0 + random.within(95.0);
        winch.friction_n *= 1.0 + random.within(0.33);
    }
}

/// Plays it. `None` where the task is done before the cut.
///
/// # Errors
/// Where the task cannot be planned, the machine cannot hang, or physics end.
pub fn play(model: &Model, story: &Story) -> Result<Option<Played>, RunError> {
    let plant = |error| RunError::Client(ClientError::from(plant_failed(error)));
    let robot = model.robot();
    let home = model.rest_at_home()?;
    let mut params = machine::plant_params(robot, &story.mismatch, story.seed);
    brakes(&mut params, story.seed);
    let (pose, held, seed) = (
        &home.equilibrium.pose,
        model.holding().by_tension(),
        story.seed,
    );
    let simulation = machine::hang(params, pose, home.tensions_n(), held, seed).and_then(|plant| {
        machine::with_board(plant, &LinkOptions::default(), seed, &story.controller)
    });
    let link = SimulatedLink::new(simulation.map_err(plant)?);
    link.with(Simulation::record_truth);
    let mut injections = vec![Injection {
        lasts_s: Some(story.lasts_s),
        ..Injection::cut(story.supply, When::Motion(story.at_s))
    }];
    injections.extend(brake_fault(story));
    let faulty = FaultyLink::new(link.clone(), &injections);
    let disk = MemoryDisk::default();
    let mine = disk.clone();
    let about = About {
        session: 1,
        robot: robot.name.clone(),
        scale: scale_of(robot),
        task: story.task.name.clone(),
        task_hash: crc32(story.task.name.as_bytes()),
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
    let place = Homing::Place(robot.tool.home_in_world_m);
    let outcome = Experiment::new(model, story.task.clone())
        .session(SessionId(1))
        .homing(place)
        .run_on(watched);
    events.finish();
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
    let lasts_us = (story.lasts_s * 1e6) as u64;
    faulty
        .settle(lasts_us + SETTLE_US)
        .map_err(ClientError::from)?;
    let trace = link.with(Simulation::take_trace);
    let cut_s = faulty
        .injected_ms()
        .first()
        .map_or(0.0, |ms| *ms as f64 * 1e-3);
    let (drop_m, speed_mps) = fallen(&trace, cut_s, model);
    if let Mishap::Moved { by_m } = story.mishap {
        moved(model, &link, Vector3::from(by_m))?;
    }
    let board = Client::connect(link.clone(), SessionId(2))
        .map(|client| run::saved::board_name(client.hello()))?;
    let alive = matches!(story.supply, Supply::Board | Supply::Drives);
    let (journal, mark) = left(&disk, alive, story.seed);
    Ok(Some(Played {
        link,
        journal,
        mark,
        board,
        drop_m: if story.supply == Supply::Host {
            0.0
        } else {
            drop_m
        },
        speed_mps,
        seed: story.seed,
    }))
}

fn brake_fault(story: &Story) -> Option<Injection> {
    // With the cut: while the robot holds, a bad brake does nothing, and arming has proved it.
    let when = When::Motion((story.at_s - 0.002).max(0.0));
    match story.mishap {
        Mishap::Weak { cable, holds_n } => Some(Injection {
            cable,
            // The nominal fault leaves a fiftieth, of 155 N in the middle.
            strength: 0.02 * 155.0 / holds_n.max(0.1),
            ..Injection::new(FaultId::B2, when)
        }),
        Mishap::Late { cable, by_s } => Some(Injection {
            cable,
            strength: by_s / 0.3,
            ..Injection::new(FaultId::B3, when)
        }),
        Mishap::None | Mishap::Moved { .. } => None,
    }
}

/// How far the tool fell, and its speed at the cut. What it would have gone down at its speed until the
/// slowest brake of the file has closed is its way.
fn fallen(trace: &[TracePoint], cut_s: f64, model: &Model) -> (f64, f64) {
    let after = trace.partition_point(|point| point.truth.time_s < cut_s);
    let Some(first) = trace.get(after) else {
        return (0.0, 0.0);
    };
    let brakes = model
        .robot()
        .winches
        .iter()
        .map(|winch| winch.brake_close_s);
    let close_s = brakes.fold(0.0, f64::max);
    let speed = Vector3::from(first.truth.velocity_mps).norm();
    let from_m = first.truth.tool_position_m[2];
    let way_m = first.truth.velocity_mps[2].min(0.0) * close_s;
    let rest = trace.get(after..).unwrap_or_default();
    let soon = rest
        .iter()
        .take_while(|point| point.truth.time_s < cut_s + DROP_S);
    let lowest_m = soon
        .map(|point| point.truth.tool_position_m[2])
        .fold(from_m, f64::min);
    ((from_m + way_m - lowest_m).max(0.0), speed)
}

/// Somebody carries the platform away and turns the drums after it.
fn moved(model: &Model, link: &SimulatedLink, by_m: Vector3<f64>) -> Result<(), RunError> {
    let plant = |error| RunError::Client(ClientError::from(plant_failed(error)));
    let truth = link
        .with(|simulation| simulation.plant().truth())
        .map_err(plant)?;
    let from_m = Vector3::from(truth.tool_position_m);
    let (from, to) = (
        model.rest(&from_m, None)?,
        model.rest(&(from_m + by_m), None)?,
    );
    let longer: Vec<f64> = to
        .paid_out_m
        .iter()
        .zip(&from.paid_out_m)
        .map(|(to, from)| to - from)
        .collect();
    let steps = 50;
    let mut line = link.clone();
    let mut unread = Vec::new();
    for _ in 0..steps {
        for (cable, way_m) in longer.iter().enumerate() {
            link.with(|s| s.plant_mut().slip_cable(cable, way_m / f64::from(steps)))
                .map_err(plant)?;
        }
        let until_us = line.now_us() + 20_000;
        while line.now_us() < until_us {
            line.receive(until_us, &mut unread)
                .map_err(ClientError::from)?;
        }
    }
    FaultyLink::new(link.clone(), &[])
        .settle(SETTLE_US)
        .map_err(ClientError::from)?;
    Ok(())
}

/// What a program leaves that lived on, or whose computer went with it: then its end was never
/// written, and the last records had not reached the disk.
fn left(disk: &MemoryDisk, alive: bool, seed: u64) -> (Vec<u8>, Option<Mark>) {
    let (bytes, mark) = disk.synced();
    if alive {
        return (bytes, mark);
    }
    let mut random = Random::new(seed ^ 0x6469_736B);
    let share = 0.5 + random.within(0.5);
    // An end of 11 bytes, and up to 50 ms of records of 92 bytes every 10 ms.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "some hundred bytes"
    )]
    let lost = 11 + (share * 5.0 * 92.0) as usize;
    let kept = bytes
        .get(..bytes.len().saturating_sub(lost))
        .unwrap_or_default();
    let mark = Journal::read(kept).ok().map(|journal| Mark {
        session: journal.identity.session,
        number: journal.number,
    });
    (kept.to_vec(), mark)
}

impl Played {
    /// The journal as a recovery finds it.
    ///
    /// # Errors
    /// [`JournalError`].
    pub fn read(&self, model: &Model, now_ms: u64) -> Result<Journal, JournalError> {
        let journal = Journal::read(&self.journal)?;
        journal.check(&self.board, scale_of(model.robot()), self.mark, now_ms)?;
        Ok(journal)
    }

    /// Recovers, and says where the tool truly hung meanwhile, on average, world, m.
    ///
    /// # Errors
    /// As [`recover`].
    pub fn recover(
        &self,
        model: &Model,
        journal: Result<Journal, JournalError>,
        camera: bool,
        untouched: bool,
        bound_m: f64,
    ) -> Result<(Verdict, Vector3<f64>), RunError> {
        let scene = Scene::on_floor(model.robot(), MOUNTING[0], MOUNTING[1], self.seed);
        let places = scene.world_from_body.iter().map(|(body, pose)| TagPlace {
            body: *body,
            world_from_body: *pose,
        });
        let places: Vec<_> = places.collect();
        let mut tags = SimulatedTags::new(self.link.clone(), scene, CORNER_PX, self.seed);
        let mut client = Client::connect(self.link.clone(), SessionId(3))?;
        if run::status(&mut client)?.fault.is_some() {
            client.request(Request::ClearFault)?;
        }
        self.link.with(Simulation::take_trace);
        let source: &mut dyn TagSource = &mut tags;
        let before = Before {
            journal,
            camera: camera.then_some((source, places)),
            untouched,
            bound_m,
        };
        let verdict = recover(&mut client, model, before)?;
        client.request(Request::Close)?;
        let trace = self.link.with(Simulation::take_trace);
        let tools = trace
            .iter()
            .map(|point| Vector3::from(point.truth.tool_position_m));
        let mean = tools.sum::<Vector3<f64>>() / (trace.len().max(1)) as f64;
        Ok((verdict, mean))
    }
}
