//! A task on a robot, from connecting to disarming, and its result.
//!
//! [`SimulatedRobot`] says which robot is simulated, [`Experiment`] what is done with a robot.
//!
//! ```
//! use mcdpr::experiment::{Experiment, SimulatedRobot};
//! use mcdpr::machine::Mismatch;
//! use mcdpr::motion::{Model, Task};
//!
//! let model = Model::new(&mcdpr::robot::Robot::built_in("paper-table5")?)?;
//! let home = model.robot().tool.home_in_world_m * 1e3;
//! let text = format!(
//!     "start_mm = [{0}, {1}, {2}]\n[[leg]]\nto_mm = [{0}, {1}, {3}]\n",
//!     home.x, home.y, home.z, home.z + 5.0
//! );
//! let task = Task::parse(&text, "up.toml".into())?;
//! let robot = SimulatedRobot::new(Mismatch::default(), 1);
//! let done = Experiment::new(&model, task).simulate(&robot)?;
//! assert!(done.run.figures(&model)?.cable_length_error_m.mean < 1e-3);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod collected;
mod laps;
mod told;

pub(crate) use collected::{calibrated, collected, over_board};
pub(crate) use laps::Looking;
pub(crate) use laps::simulated_eyes;
use laps::{Keep, Laps, Noting, Tracked, Truth};
pub(crate) use told::{Told, told, truth};

use crate::control::Handle;
use crate::link::{Link, Paced, SimulatedLink};
use crate::machine::{self, Controller, Mismatch};
use crate::motion::{Model, Plan, PlanError, Task};
use crate::record::events::{EventBus, TruthTap, Watched};
use crate::report::{self, Figures, PathPoint, tube::share_inside};
use crate::robot::Robot;
use crate::run::tracking::{Lesson, Tracking};
use crate::run::{self, Homing, Measured, Progress, ResumeError, RunError, Session};
use crate::sight::Scene;
use mcdpr_core::estimate::tube::Tube;
use mcdpr_core::recovery::{Journal, JournalError};
use mcdpr_kinematics::Pose;
use mcdpr_protocol::SessionId;
use mcdpr_simulator::{LinkOptions, Simulation};
use nalgebra::{Rotation3, Vector3};
use serde::Serialize;
use std::time::{Duration, Instant};

/// Modules on the board whose firmware the emulated chip executes.
const CHIP_CABLES: u8 = 4;

/// A task that was run.
#[derive(Debug, Clone)]
pub struct Run {
    /// What was planned.
    pub plan: Plan,
    /// The measurements of the board.
    pub samples: Vec<Measured>,
    /// True positions of the tool; `None` on hardware.
    pub true_path: Option<Vec<PathPoint>>,
    /// True attitudes of the platform (world_from_platform); `None` on hardware, and for a robot that was
    /// calibrated, whose world frame is another one.
    pub(crate) true_turns: Option<Vec<(f64, Rotation3<f64>)>>,
    /// Whether the board was simulated.
    pub simulated: bool,
    /// Figures of every lap, if the task was repeated; the other fields are those of the last.
    pub laps: Vec<Figures>,
    /// The tube that the plan stated by what was tracked, if the robot was.
    pub(crate) tube: Option<Tube>,
    /// What the plan of each lap stated, if the task was repeated and the robot tracked.
    pub(crate) stated: Vec<Stated>,
}

/// What a plan stated of the tool's error, and whether it held.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(crate) struct Stated {
    /// Mean radius of 95 %, m.
    pub(crate) mean_m: f64,
    /// Greatest radius, m.
    pub(crate) widest_m: f64,
    /// Share of the path with the tool inside; `None` on hardware.
    pub(crate) inside: Option<f64>,
}

impl Run {
    /// Judges the run.
    ///
    /// # Errors
    /// Never for a plan that was run.
    pub fn figures(&self, model: &Model) -> Result<Figures, PlanError> {
        let truth = self.true_path.as_deref();
        let figures = report::measure(model, &self.plan, &self.samples, truth)?;
        Ok(figures.with_attitude(model, &self.plan, self.true_turns.as_deref()))
    }

    /// What the plan stated by what was tracked, if the robot was.
    pub(crate) fn stated(&self) -> Option<Stated> {
        let tube = self.tube.as_ref()?;
        let truth = self.true_path.as_deref();
        Some(Stated {
            mean_m: tube.mean_m,
            widest_m: tube.widest.radius_m,
            inside: truth.map(|points| share_inside(&self.plan, tube, points)),
        })
    }
}

/// A run on the simulator in this process.
#[derive(Debug, Clone)]
pub struct SimulatedRun {
    /// The run.
    pub run: Run,
    /// Virtual time from power-on to the end, s.
    pub simulated_s: f64,
    /// Wall time that it took.
    pub took: Duration,
}

impl SimulatedRun {
    /// Simulated seconds per second.
    #[must_use]
    pub(crate) fn realtime_factor(&self) -> f64 {
        self.simulated_s / self.took.as_secs_f64().max(1e-9)
    }
}

/// A simulated robot at home behind a line, to be made.
#[derive(Debug, Clone)]
pub struct SimulatedRobot {
    mismatch: Mismatch,
    seed: u64,
    session: u64,
    line: LinkOptions,
    controller: Controller,
    machine: Option<Robot>,
}

impl SimulatedRobot {
    /// A robot that differs from its description by `mismatch`, drawn with `seed`, behind a line
    /// without errors, controlled by the control core in this process.
    #[must_use]
    pub fn new(mismatch: Mismatch, seed: u64) -> Self {
        Self {
            mismatch,
            seed,
            session: 1,
            line: LinkOptions::default(),
            controller: Controller::InProcess,
            machine: None,
        }
    }

    /// Built as this description says, whatever the controller's own says of it.
    #[must_use]
    pub(crate) fn machine(mut self, machine: &Robot) -> Self {
        self.machine = Some(machine.clone());
        self
    }

    /// A calibrated machine in the session in which it was calibrated: not homed anew since.
    #[must_use]
    pub(crate) const fn just_calibrated(mut self) -> Self {
        self.session = 0;
        self
    }

    /// Behind a line with these properties.
    #[must_use]
    pub const fn line(mut self, line: LinkOptions) -> Self {
        self.line = line;
        self
    }

    /// Controlled by this controller.
    #[must_use]
    pub fn controller(mut self, controller: &Controller) -> Self {
        self.controller = controller.clone();
        self
    }

    /// The robot at home, with the tensions that the model's options have there. A robot that was
    /// calibrated on the simulator is the machine of that calibration, with its mismatch and seed.
    ///
    /// # Errors
    /// Where it cannot hang there.
    pub fn at_home(&self, model: &Model) -> Result<SimulatedLink, RunError> {
        let described = self.machine.as_ref().unwrap_or(model.robot());
        let calibrated = machine::of_calibration(model.robot(), self.session);
        let (machine, mismatch, seed) = calibrated.unwrap_or((described, self.mismatch, self.seed));
        let mismatch = &mismatch;
        // The emulated chip is the board of the paper: it has four modules.
        let own = machine.boards.iter().map(|board| board.cables.len());
        let cables = own
            .chain(machine.boards.is_empty().then_some(machine.cables.len()))
            .find(|cables| *cables != usize::from(CHIP_CABLES));
        if let (Controller::Chip(_) | Controller::Hil(_), Some(robot)) = (&self.controller, cables)
        {
            return Err(RunError::Cables {
                board: CHIP_CABLES,
                robot,
            });
        }
        let plant = machine::at_rest(model, machine, mismatch, seed, None)?;
        machine::line_to(machine, plant, &self.line, seed, &self.controller)
            .map_err(|error| RunError::Client(error.into()))
    }
}

/// A task to be run on a robot: a simulated one ([`Self::simulate`]) or any board behind a line
/// ([`Self::run_on`]).
pub struct Experiment<'a> {
    model: &'a Model,
    task: Task,
    homing: Option<Homing<'a>>,
    session: Option<SessionId>,
    handle: Handle,
    progress: Box<dyn FnMut(Progress) + 'a>,
    recorder: Option<&'a EventBus>,
    time_scale: Option<f64>,
    resume: Option<Resume<'a>>,
    laps: usize,
    tracked: Option<Tracked<'a>>,
    truth: Option<Box<Truth<'a>>>,
}

/// The journal of a board, by the board's number.
type JournalOf<'a> = dyn FnOnce(&str) -> Result<Journal, JournalError> + 'a;

/// A task that is to be continued: its checksum, and the journal.
struct Resume<'a> {
    hash: u32,
    journal: Box<JournalOf<'a>>,
}

impl<'a> Experiment<'a> {
    /// A task on this robot.
    #[must_use]
    pub fn new(model: &'a Model, task: Task) -> Self {
        Self {
            model,
            task,
            homing: None,
            session: None,
            handle: Handle::new(),
            progress: Box::new(|_| {}),
            recorder: None,
            time_scale: None,
            resume: None,
            laps: 1,
            tracked: None,
            truth: None,
        }
    }

    /// Does the task several times in one session.
    #[must_use]
    pub(crate) const fn laps(mut self, laps: usize) -> Self {
        self.laps = laps;
        self
    }

    /// Tracks the robot's slow changes at its rests, and plans by what is tracked: a new state, or one that was kept
    /// at a time (s since 1970). `on_rest` gets what each rest taught, `keep` the state after it.
    #[must_use]
    pub(crate) fn tracked(
        mut self,
        (tracking, kept_unix_s): (Tracking, Option<u64>),
        looking: Looking<'a>,
        on_rest: impl FnMut(&Tracking, &Lesson) + 'a,
        keep: Option<Box<Keep>>,
    ) -> Self {
        self.tracked = Some(Tracked {
            tracking,
            kept_unix_s,
            looking,
            on_rest: Box::new(on_rest),
            keep,
        });
        self
    }

    /// How the robot learns where it is. By default a simulated robot is known to hang at home,
    /// and a board behind a line uses [`Homing::Known`].
    #[must_use]
    pub(crate) fn homing(mut self, homing: Homing<'a>) -> Self {
        self.homing = Some(homing);
        self
    }

    /// The robot hangs at home, whatever the board behind the line says. A chip's firmware does
    /// not know that its robot is simulated, and lengths saved by an earlier run do not apply.
    #[must_use]
    pub fn at_home(self) -> Self {
        let home = self.model.robot().tool.home_in_world_m;
        self.homing(Homing::Place(home))
    }

    /// Number of the session on the wire. By default 1 on the simulator, a new one on a line.
    #[must_use]
    pub const fn session(mut self, session: SessionId) -> Self {
        self.session = Some(session);
        self
    }

    /// Gives orders to the run, and shows it to observers.
    #[must_use]
    pub fn handle(mut self, handle: &Handle) -> Self {
        self.handle = handle.clone();
        self
    }

    /// Called as the run advances.
    #[must_use]
    pub fn progress(mut self, progress: impl FnMut(Progress) + 'a) -> Self {
        self.progress = Box::new(progress);
        self
    }

    /// Records a simulated run. A line brings its own recording ([`Watched`]).
    #[must_use]
    pub const fn recorded_by(mut self, recorder: &'a EventBus) -> Self {
        self.recorder = Some(recorder);
        self
    }

    /// Simulated seconds per second; by default as fast as it goes.
    #[must_use]
    pub(crate) const fn time_scale(mut self, scale: Option<f64>) -> Self {
        self.time_scale = scale;
        self
    }

    /// Continues the task where a loss of power interrupted it, by the journal of the board; `hash` is
    /// the task's checksum.
    #[must_use]
    pub(crate) fn resume(
        mut self,
        hash: u32,
        journal: impl FnOnce(&str) -> Result<Journal, JournalError> + 'a,
    ) -> Self {
        self.resume = Some(Resume {
            hash,
            journal: Box::new(journal),
        });
        self
    }

    /// The plan from home: also the judgement before anything is connected.
    ///
    /// # Errors
    /// The first limit that would be broken.
    pub fn plan(&self) -> Result<Plan, RunError> {
        let start = self.model.robot().tool.home_in_world_m;
        run::plan_from(self.model, self.task.clone(), &start, None)
    }

    /// Runs the task on a simulated robot.
    ///
    /// # Errors
    /// As [`Self::run_on`]; also where the simulated robot cannot hang at home.
    pub fn simulate(self, robot: &SimulatedRobot) -> Result<SimulatedRun, RunError> {
        let link = robot.at_home(self.model)?;
        self.simulate_on(&link, robot.seed)
    }

    /// Runs the task on a simulated robot that hangs at home.
    ///
    /// # Errors
    /// As [`Self::run_on`].
    pub(crate) fn simulate_on(
        mut self,
        link: &SimulatedLink,
        seed: u64,
    ) -> Result<SimulatedRun, RunError> {
        let began = Instant::now();
        let model = self.model;
        self.session.get_or_insert(SessionId(1));
        let home = Homing::Place(model.robot().tool.home_in_world_m);
        self.homing.get_or_insert(home);
        if let Some(tracked) = &mut self.tracked
            && matches!(tracked.looking, Looking::Simulated)
        {
            tracked.looking = Looking::By(simulated_eyes(model.robot(), link, seed));
        }
        let scale = self.time_scale;
        let paced = |line: Box<dyn Link + 'a>| -> Box<dyn Link + 'a> {
            match scale {
                Some(scale) => Box::new(Paced::new(line, scale)),
                None => line,
            }
        };
        let mut run = if let Some(recorder) = self.recorder {
            let tap = TruthTap::new(link.clone(), model.robot().cables.len());
            let watched = Watched::new(link.clone(), recorder)
                .with_truth(tap.clone())
                .with_orders(&self.handle);
            self.truth = Some(Box::new(move || tap.take()));
            self.run_on(paced(Box::new(watched)))?
        } else {
            link.with(Simulation::record_truth);
            let truth = link.clone();
            self.truth = Some(Box::new(move || truth.with(Simulation::take_trace)));
            self.run_on(paced(Box::new(link.clone())))?
        };
        // A chip's firmware does not know that its robot is simulated.
        run.simulated = true;
        Ok(SimulatedRun {
            run,
            simulated_s: link.with(|simulation| simulation.now_us() as f64 * 1e-6),
            took: began.elapsed(),
        })
    }

    /// Runs the task on the board behind a line: connects, configures, references the lengths if
    /// the board has lost them, arms, moves, disarms.
    ///
    /// # Errors
    /// [`RunError`]; whatever it is, the robot stands still with its brakes closed, or the board
    /// has lost the line and stops by itself. [`RunError::Interrupted`] where the handle ordered a
    /// stop.
    pub fn run_on<L: Link>(self, link: L) -> Result<Run, RunError> {
        let handle = self.handle.clone();
        let name = self.task.name.clone();
        handle.publish(|view| view.task = Some(name));
        let run = self.commanded(link);
        handle.close("the run has ended");
        handle.publish(|view| view.task = None);
        run
    }

    fn commanded<L: Link>(self, link: L) -> Result<Run, RunError> {
        let number = self.session.unwrap_or_else(run::new_session);
        let homing = self.homing.unwrap_or(Homing::Known);
        let (model, handle) = (self.model, &self.handle);
        // Planned before it is armed: a refused task moves nothing.
        let mut session = Session::open(model, link, number, handle, homing, &run::LengthFiles)?;
        let mut noting = None;
        if let Some(Tracked {
            tracking,
            kept_unix_s,
            looking,
            on_rest,
            keep,
        }) = self.tracked
        {
            session.track(tracking, kept_unix_s)?;
            let eyes = match looking {
                Looking::By(eyes) => Some(eyes),
                Looking::Blind | Looking::Simulated => None,
            };
            noting = Some(Noting {
                eyes,
                on_rest,
                keep,
            });
        }
        let first = match self.resume {
            None => session.plan(self.task.clone(), None)?,
            Some(Resume { hash, journal }) => {
                let board = run::saved::board_name(session.client().hello());
                let journal = journal(&board).map_err(ResumeError::Journal)?;
                session.plan_rest(self.task.clone(), hash, &journal)?
            }
        };
        session.arm()?;
        let mut laps = Laps {
            model,
            task: self.task,
            count: self.laps,
            noting,
            truth: self.truth,
            progress: self.progress,
        };
        match laps.follow(&mut session, first) {
            Ok(mut run) => {
                run.simulated = session.client().info().simulated;
                session.disarm()?;
                if run.laps.is_empty() {
                    laps.judge(&mut run);
                }
                Ok(run)
            }
            // A plan between two laps was refused: the robot still holds.
            Err(error @ (RunError::Plan(_) | RunError::Task(_) | RunError::Sight(_))) => {
                session.disarm()?;
                Err(error)
            }
            Err(error) => Err(error),
        }
    }
}

/// A true path in the world frame that the robot knows.
pub(crate) fn in_calibrated_frame(model: &Model, path: Vec<PathPoint>) -> Vec<PathPoint> {
    match Scene::known_from_true(model.robot()) {
        Some(known_from_true) => in_frame(&known_from_true, path),
        None => path,
    }
}

/// A true path in a frame in which the simulator's world frame has this pose.
pub(crate) fn in_frame(known_from_true: &Pose, mut path: Vec<PathPoint>) -> Vec<PathPoint> {
    for point in &mut path {
        point.tool_m = known_from_true.transform(&point.tool_m.into()).into();
    }
    path
}

/// A true position, m, in the world frame that the robot knows. A calibration cannot determine the world
/// frame, only relative positions: for a robot that was calibrated on the simulator, the tags used
/// relate both frames.
pub(crate) fn in_known_frame(robot: &Robot, true_m: &Vector3<f64>) -> Vector3<f64> {
    Scene::known_from_true(robot)
        .map_or(*true_m, |known_from_true| known_from_true.transform(true_m))
}
