//! Seeded scenes, with calibrated and with nominal parameters: one, or many ([`Study`]).

use super::place::Places;
use super::report::{Outcome, Report};
use super::task::Picker;
use super::workcell::{self, CellObserver, Mounting, SimulatedEye};
use super::{Arm, News, Phase, PickError, Tell, calibrated, news};
use crate::control::Handle;
use crate::experiment::SimulatedRobot;
use crate::link::{Link, Paced, SimulatedLink};
use crate::machine::{Controller, Mismatch};
use crate::motion::{Model, PlanOptions, Shaping, Tensioning};
use crate::record::events::{TruthTap, Watched};
use crate::report::PathPoint;
use crate::robot::Robot;
use crate::run::Measured;
use crate::sight::Shown;
use mcdpr_core::estimate::track::Prior;
use mcdpr_protocol::SessionId;
use mcdpr_simulator::camera::{Cell, Grip, Order};
use mcdpr_vision::grasp::{Antipodal, Detector};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

mod cut;
mod many;
mod tally;

pub(crate) use cut::scene_after_cut;
pub use many::Study;
pub use tally::{Figures, Line, Tally};

/// The program's knowledge of the machine.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Knowledge {
    /// As after the project's own calibration of this machine ([`calibrated`]); the machine is as
    /// built.
    Calibrated,
    /// Likewise on a machine as found ([`Mismatch::as_found`]).
    Found,
    /// As assembled: anchors within 5 mm, the camera within 3 mm and 0.5 degrees.
    Nominal,
    /// Exactly.
    Exact,
}

/// Whether the camera's pose is as stated.
const NO_MOUNTING: Mounting = Mounting {
    shift_m: 0.0,
    turn_rad: 0.0,
};

impl Knowledge {
    /// Differences of the simulated machine.
    #[must_use]
    pub const fn mismatch(self) -> (Mismatch, Mounting) {
        match self {
            // Drawn with the machine: as mounted.
            Self::Calibrated => (Mismatch::as_built(), NO_MOUNTING),
            Self::Found => (Mismatch::as_found(), NO_MOUNTING),
            Self::Nominal => (
                Mismatch {
                    anchors_m: 5e-3,
                    ..Mismatch::realistic()
                },
                Mounting {
                    shift_m: 3e-3,
                    turn_rad: 9e-3,
                },
            ),
            Self::Exact => (
                Mismatch {
                    anchors_m: 0.0,
                    attachments_m: 0.0,
                    center_of_mass_m: 0.0,
                    mass: 0.0,
                    ea: 0.0,
                    sensor_gain: 0.0,
                    bandwidth: 0.0,
                    pulley_loss: 0.0,
                    gears: Mismatch::realistic().gears,
                    found: Mismatch::realistic().found,
                    hours: None,
                },
                NO_MOUNTING,
            ),
        }
    }
}

/// One scene, picked.
#[derive(Debug, Clone, Serialize)]
pub struct SceneReport {
    /// The scene's seed.
    pub seed: u64,
    /// Objects at first.
    pub objects: usize,
    /// Objects in the tray at the end.
    pub left: usize,
    /// Objects that were truly put down beside the tray.
    pub carried_off: usize,
    /// The program's own report.
    pub report: Report,
    /// True errors of the grasp point, m.
    pub errors_m: Vec<f64>,
    /// The same as a vector, world, m.
    pub off_m: Vec<[f64; 3]>,
    /// Result of each closing of the jaws, in words.
    pub grips: Vec<String>,
    /// The trace, if requested.
    #[serde(skip)]
    pub kept: Option<Kept>,
}

/// A true state of the simulated robot.
#[derive(Debug, Clone, Copy)]
pub struct TrueState {
    /// Time since the start of picking, s.
    pub time_s: f64,
    /// The state.
    pub truth: mcdpr_simulator::plant::Truth,
}

/// Trace of a scene. Times from the start of picking, s.
#[derive(Debug, Clone, Default)]
pub struct Kept {
    /// The board's samples.
    pub samples: Vec<Measured>,
    /// Planned tool positions, m.
    pub planned: Vec<PathPoint>,
    /// True states, every 10 ms.
    pub truth: Vec<TrueState>,
    /// The first picture in which a grasp was chosen.
    pub first_look: Option<Shown>,
}

/// Observers of a scene, and its speed.
#[derive(Default)]
pub struct Watching<'a> {
    /// Watches the line.
    pub events: Option<&'a crate::record::EventBus>,
    /// Simulated seconds per second; as fast as possible if not given.
    pub time_scale: Option<f64>,
    /// Whether to keep the trace.
    pub keep: bool,
    /// Receives the news.
    pub(crate) tell: Tell<'a>,
}

impl<'a> Watching<'a> {
    /// The line to a simulated robot as these observers see it.
    fn line(&self, link: &SimulatedLink, cables: usize, handle: &Handle) -> Box<dyn Link + 'a> {
        let mut line: Box<dyn Link + 'a> = Box::new(link.clone());
        if let Some(seen_by) = self.events {
            let tap = TruthTap::forgetful(link.clone(), cables);
            let watched = Watched::new(line, seen_by);
            line = Box::new(watched.with_truth(tap).with_orders(handle));
        }
        if let Some(scale) = self.time_scale {
            line = Box::new(Paced::new(line, scale));
        }
        line
    }
}

/// Greatest acceleration, m/s^2, and jerk, m/s^3.
const GENTLE_MPS2: f64 = 0.5;
const GENTLE_MPS3: f64 = 4.0;

/// The robot as used for planning: acceleration and jerk are kept low, because a swinging tool
/// misses.
#[must_use]
pub fn picking_robot(robot: &Robot) -> Robot {
    let mut robot = robot.clone();
    let limits = &mut robot.limits;
    limits.acceleration_mps2 = limits.acceleration_mps2.min(GENTLE_MPS2);
    limits.jerk_mps3 = limits.jerk_mps3.min(GENTLE_MPS3);
    robot
}

/// Planning options for picking: every motion is shaped against swing, and cable 4 gets the tension
/// that keeps all cables tautest (at the paper's 10 N there is no equilibrium at its own grasp
/// point).
#[must_use]
pub fn planning() -> PlanOptions {
    PlanOptions {
        tensioning: Tensioning::MaxMin,
        shaping: Shaping::Zvd,
        ..PlanOptions::default()
    }
}

/// One scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wanted {
    /// Arrangement of the objects.
    pub order: Order,
    /// How many.
    pub count: usize,
    /// The program's knowledge of the machine.
    pub knowledge: Knowledge,
    /// Seed of scene, machine and noise.
    pub seed: u64,
    /// Whether the jaws turn about the tool's axis.
    pub turns: bool,
    /// Most attempts.
    pub attempts_max: Option<usize>,
    /// Views of the tray before each choice.
    pub views: usize,
    /// Whether a chosen grasp is looked at again from nearby.
    pub near: bool,
    /// The paper's single object instead of a tray of them.
    pub paper: bool,
    /// Whether the tray's floor is covered with printed tags for localisation.
    pub mat: bool,
    /// Factor of the objects' masses.
    pub heavier: f64,
    /// Whether the robot tracks its loads and slow changes.
    pub tracked: bool,
}

/// Picks one scene on the simulator.
///
/// # Errors
/// The error that stops the robot.
pub fn scene(robot: &Robot, wanted: &Wanted) -> Result<SceneReport, PickError> {
    scene_with(robot, wanted, &Handle::new(), &Watching::default())
}

/// As [`scene`], with orders from a handle, and watched.
///
/// # Errors
/// The error that stops the robot; [`RunError::Interrupted`](crate::run::RunError) if the handle
/// does.
pub(crate) fn scene_with(
    robot: &Robot,
    wanted: &Wanted,
    handle: &Handle,
    watching: &Watching<'_>,
) -> Result<SceneReport, PickError> {
    let detector = &mut Antipodal::default();
    let controller = &Controller::InProcess;
    scene_by(robot, wanted, handle, detector, watching, controller)
}

/// As [`scene_with`], with another detector.
///
/// # Errors
/// As [`scene_with`].
pub(crate) fn scene_by(
    robot: &Robot,
    wanted: &Wanted,
    handle: &Handle,
    detector: &mut dyn Detector,
    watching: &Watching<'_>,
    controller: &Controller,
) -> Result<SceneReport, PickError> {
    if let Some(tell) = watching.tell {
        tell(&News::Phase(Phase::Preparing));
    }
    let mut stage = Stage::new(robot, wanted, controller)?;
    let link = stage.link.clone();
    // With each phase, where the objects truly are.
    let with_objects = |news: &News| {
        let Some(tell) = watching.tell else { return };
        tell(news);
        if matches!(news, News::Phase(_)) {
            let objects = link.with(|simulation| simulation.cell().map(news::objects));
            tell(&News::Objects(objects.unwrap_or_default()));
        }
    };
    let line = watching.line(&link, stage.model.robot().cables.len(), handle);
    let mut arm = Arm::start(stage.model.clone(), line, SessionId(1), handle)?;
    if wanted.tracked {
        arm.track(&Prior::default());
    }
    let began_us = link.now_us();
    if watching.keep {
        arm.keep_samples();
        link.with(mcdpr_simulator::Simulation::record_truth);
    }
    let report = Picker::new(&mut arm, &mut stage.eye, detector, &stage.options)
        .telling(watching.tell.is_some().then_some(&with_objects))
        .run(&mut stage.observer)?;
    let kept = watching.keep.then(|| Kept {
        samples: arm.samples().to_vec(),
        planned: arm.planned().to_vec(),
        truth: true_states(&link, began_us),
        first_look: stage.observer.first_look.take(),
    });
    arm.finish()?;
    Ok(stage.ended(report, kept))
}

/// A simulated robot before a tray, and the options of picking there.
struct Stage {
    seed: u64,
    model: Model,
    link: SimulatedLink,
    options: super::Options,
    eye: SimulatedEye,
    observer: CellObserver,
    objects: usize,
}

impl Stage {
    fn new(robot: &Robot, wanted: &Wanted, controller: &Controller) -> Result<Self, PickError> {
        let Wanted {
            order,
            count,
            knowledge,
            seed,
            turns,
            attempts_max,
            views,
            near,
            paper,
            mat,
            heavier,
            ..
        } = *wanted;
        let (mismatch, mounting) = knowledge.mismatch();
        let known = match knowledge {
            Knowledge::Calibrated if robot.calibrated.is_none() => {
                &calibrated(robot, seed, controller, None)?
            }
            Knowledge::Found if robot.calibrated.is_none() => {
                &calibrated(robot, seed, controller, Some("as-found"))?
            }
            _ => robot,
        };
        let model = Model::new(known)?.with_options(planning());
        let robot = known;
        let link = SimulatedRobot::new(mismatch, seed)
            .controller(controller)
            .at_home(&model)?;
        let (mut cell, mut options) = if paper {
            workcell::paper(&model)?
        } else {
            let mut tray = Places::of(robot)?.tray();
            if mat {
                tray = tray.with_mat();
            }
            let cell = workcell::cell(robot, tray, order, count, seed)?;
            (cell, workcell::options(robot)?)
        };
        cell.make_heavier(heavier);
        options.mat = cell.tray.mat.as_ref().map(workcell::mat);
        if options.mat.is_some() {
            options.hand.margin_m = workcell::MARGIN_BY_MAT_M;
        }
        workcell::look_from(&mut options, views);
        if !near {
            options.near_m = None;
        }
        let objects = cell.objects().len();
        link.with(|simulation| simulation.set_cell(cell));
        let eye = SimulatedEye::new(link.clone(), robot, &mounting, seed);
        let observer = CellObserver::new(link.clone(), *eye.camera());
        options.turns = turns;
        if let Some(most) = attempts_max {
            options.attempts_max = most;
        }
        Ok(Self {
            seed,
            model,
            link,
            options,
            eye,
            observer,
            objects,
        })
    }

    /// The scene after picking.
    fn ended(self, report: Report, kept: Option<Kept>) -> SceneReport {
        let end = self
            .link
            .with(|simulation| simulation.cell().map(Ended::of));
        let end = end.unwrap_or_default();
        SceneReport {
            seed: self.seed,
            objects: self.objects,
            left: end.left,
            carried_off: end.carried_off,
            report,
            errors_m: self.observer.off_m.iter().map(Vector3::norm).collect(),
            off_m: self.observer.off_m.into_iter().map(Into::into).collect(),
            grips: end.grips,
            kept,
        }
    }
}

/// True states since `began_us`, every 10 ms.
fn true_states(link: &SimulatedLink, began_us: u64) -> Vec<TrueState> {
    let took_s = (link.now_us() - began_us) as f64 * 1e-6;
    let trace = link.with(mcdpr_simulator::Simulation::take_trace);
    // The trace ends now, one point per millisecond.
    let count = trace.len() as u64;
    let states = (0_u64..).zip(&trace).step_by(10).map(|(index, point)| {
        let before_ms = count.saturating_sub(index + 1);
        TrueState {
            time_s: took_s - before_ms as f64 * 1e-3,
            truth: point.truth,
        }
    });
    states.collect()
}

/// The tray at the end.
#[derive(Default)]
struct Ended {
    left: usize,
    carried_off: usize,
    /// What the gripper held each time, in words.
    grips: Vec<String>,
}

impl Ended {
    fn of(cell: &Cell) -> Self {
        let words = cell.log().iter().map(|event| match &event.grip {
            Grip::Held { width_m, .. } => {
                format!("holds {}, {:.1} mm", event.object, width_m * 1e3)
            }
            Grip::Missed(reason) => reason.clone(),
        });
        Self {
            left: cell.left_in_tray(),
            carried_off: cell.carried_off().len(),
            grips: words.collect(),
        }
    }
}

impl SceneReport {
    /// Attempts that the program counts as successful and that were not, or the other way round.
    #[must_use]
    pub fn misjudged(&self) -> usize {
        let believed = self
            .report
            .attempts
            .iter()
            .filter(|attempt| attempt.outcome == Outcome::Delivered)
            .count();
        believed.abs_diff(self.carried_off)
    }
}
