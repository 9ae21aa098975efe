//! A task on a robot, from connecting to disarming, and its results.

use crate::control::Handle;
use crate::link::{Link, Paced, SimulatedLink};
use crate::machine::{self, Mismatch};
use crate::motion::{Model, Plan, PlanError, PlanOptions, Rest, Task};
use crate::record::witness::{TruthTap, Watched, Witness};
use crate::report::{self, Figures};
use crate::run::{self, Homing, Measured, Progress, Recorder, RunError, Session};
use crate::sight::Scene;
use mcdpr_protocol::SessionId;
use mcdpr_simulator::LinkOptions;
use std::time::{Duration, Instant};

/// A task that was run.
#[derive(Debug, Clone)]
pub struct Run {
    /// What was planned.
    pub plan: Plan,
    /// The measurements of the board.
    pub samples: Vec<Measured>,
    /// True positions of the tool; `None` on hardware.
    pub true_path: Option<Vec<(f64, [f64; 3])>>,
    /// Whether the board was simulated.
    pub simulated: bool,
}

impl Run {
    /// Judges the run.
    ///
    /// # Errors
    /// Never for a plan that was run.
    pub fn figures(&self, model: &Model) -> Result<Figures, PlanError> {
        report::measure(model, &self.plan, &self.samples, self.true_path.as_deref())
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

/// How the robot hangs when it is switched on.
///
/// # Errors
/// If the robot cannot hang at the robot file's home.
pub fn home(model: &Model) -> Result<Rest, PlanError> {
    model.rest(&model.robot().tool.home_in_world_m, None)
}

/// The plan for a task that starts from home: also the judgement before anything is connected.
///
/// # Errors
/// The first limit that would be broken.
pub fn plan_from_home(model: &Model, task: Task) -> Result<Plan, RunError> {
    let start = model.robot().tool.home_in_world_m;
    run::plan_from(model, task, &start, None)
}

/// Runs a task on a simulated robot that hangs at home, with this `mismatch` from its description.
///
/// # Errors
/// As [`on_link`]; also if the simulated robot cannot hang at home.
pub fn simulate(
    model: &Model,
    task: Task,
    mismatch: &Mismatch,
    seed: u64,
    progress: impl FnMut(Progress),
) -> Result<SimulatedRun, RunError> {
    simulate_with(model, task, mismatch, seed, &Orders::default(), progress)
}

/// Control of a run, and the speed of a simulated one.
#[derive(Debug, Clone, Default)]
pub struct Orders {
    /// Gives orders to the run, and shows it to observers.
    pub handle: Handle,
    /// Simulated seconds per second; as fast as possible if not given.
    pub time_scale: Option<f64>,
}

/// As [`simulate`], with orders from a handle.
///
/// # Errors
/// As [`simulate`].
pub(crate) fn simulate_with(
    model: &Model,
    task: Task,
    mismatch: &Mismatch,
    seed: u64,
    orders: &Orders,
    progress: impl FnMut(Progress),
) -> Result<SimulatedRun, RunError> {
    let began = Instant::now();
    let link = simulated_robot(model, mismatch, seed, &LinkOptions::default())?;
    link.with(mcdpr_simulator::Simulation::record_truth);
    let session = SessionId(1);
    let paced: Box<dyn Link> = match orders.time_scale {
        Some(scale) => Box::new(Paced::new(link.clone(), scale)),
        None => Box::new(link.clone()),
    };
    let homing = Homing::Place(model.robot().tool.home_in_world_m);
    let (session, handle) = (Some(session), &orders.handle);
    let mut run = on_link_homed(model, task, paced, session, handle, homing, progress)?;
    let trace = link.with(mcdpr_simulator::Simulation::take_trace);
    // A chip's firmware does not know that its robot is simulated.
    run.simulated = true;
    run.true_path = Some(in_calibrated_frame(model, report::true_path(&trace)));
    Ok(SimulatedRun {
        run,
        simulated_s: link.with(|simulation| simulation.now_us() as f64 * 1e-6),
        took: began.elapsed(),
    })
}

/// As [`simulate`], with a witness.
///
/// # Errors
/// As [`simulate`].
pub fn simulate_seen(
    model: &Model,
    task: Task,
    mismatch: &Mismatch,
    seed: u64,
    (witness, session): (&Witness, SessionId),
    orders: &Orders,
    progress: impl FnMut(Progress),
) -> Result<SimulatedRun, RunError> {
    let began = Instant::now();
    let link = simulated_robot(model, mismatch, seed, &LinkOptions::default())?;
    let tap = TruthTap::new(link.clone(), model.robot().cables.len());
    let watched = Watched::new(link.clone(), witness)
        .with_truth(tap.clone())
        .with_orders(&orders.handle);
    let paced: Box<dyn Link> = match orders.time_scale {
        Some(scale) => Box::new(Paced::new(watched, scale)),
        None => Box::new(watched),
    };
    let homing = Homing::Place(model.robot().tool.home_in_world_m);
    let (session, handle) = (Some(session), &orders.handle);
    let mut run = on_link_homed(model, task, paced, session, handle, homing, progress)?;
    // A chip's firmware does not know that its robot is simulated.
    run.simulated = true;
    run.true_path = Some(in_calibrated_frame(model, report::true_path(&tap.take())));
    Ok(SimulatedRun {
        run,
        simulated_s: link.with(|simulation| simulation.now_us() as f64 * 1e-6),
        took: began.elapsed(),
    })
}

/// A true path in the world frame that the robot knows. A calibration cannot determine the world
/// frame, only relative positions: for a robot that was calibrated on the simulator, the tags used
/// relate both frames.
fn in_calibrated_frame(model: &Model, path: Vec<(f64, [f64; 3])>) -> Vec<(f64, [f64; 3])> {
    let Some(known_from_true) = Scene::known_from_true(model.robot()) else {
        return path;
    };
    let moved =
        |(time_s, at): (f64, [f64; 3])| (time_s, known_from_true.transform(&at.into()).into());
    path.into_iter().map(moved).collect()
}

/// A simulated robot at home behind a line, with the tensions that the model's options have there,
/// controlled by the firmware that this program has
/// chosen ([`machine::choose_firmware`]), or by the control core in this process.
///
/// # Errors
/// If it cannot hang there.
pub fn simulated_robot(
    model: &Model,
    mismatch: &Mismatch,
    seed: u64,
    link: &LinkOptions,
) -> Result<SimulatedLink, RunError> {
    simulated_robot_on(model, mismatch, seed, link, machine::chosen_firmware())
}

/// As [`simulated_robot`], controlled by this firmware on an emulated chip, or by the control core
/// in this process.
///
/// # Errors
/// If it cannot hang there.
pub(crate) fn simulated_robot_on(
    model: &Model,
    mismatch: &Mismatch,
    seed: u64,
    link: &LinkOptions,
    firmware: Option<&machine::Firmware>,
) -> Result<SimulatedLink, RunError> {
    // A robot that was calibrated on the simulator is that machine, whatever is requested.
    let (machine, mismatch, seed) = match &model.robot().calibrated {
        Some(calibrated) => match calibrated.simulated_seed {
            Some(seed) => (&calibrated.designed, &Mismatch::as_built(), seed),
            None => (model.robot(), mismatch, seed),
        },
        None => (model.robot(), mismatch, seed),
    };
    // A planner for a level platform does not use other attitudes.
    let hanging = PlanOptions {
        tensioning: model.options().tensioning,
        ..PlanOptions::default()
    };
    let home = home(&Model::new(machine)?.with_options(hanging))?;
    let params = machine::plant_params(machine, mismatch, seed);
    let simulation = machine::simulate(
        params,
        &home.equilibrium.pose,
        home.tensions_n(),
        model.tension_held(),
        link,
        seed,
        firmware,
    )
    .map_err(|error| RunError::Client(crate::link::plant_failed(error).into()))?;
    Ok(SimulatedLink::new(simulation))
}

/// Runs a task on the board behind a line: connects, configures, references the lengths if the
/// board has lost them (the robot then hangs at home), arms, moves, disarms.
///
/// # Errors
/// [`RunError`]; in every case the robot is at rest with its brakes closed, or the board has lost
/// the line and stops by itself.
pub fn on_link<L: Link>(
    model: &Model,
    task: Task,
    link: L,
    session: Option<SessionId>,
    progress: impl FnMut(Progress),
) -> Result<Run, RunError> {
    on_link_with(model, task, link, session, &Handle::new(), progress)
}

/// As [`on_link`], for a simulated robot that hangs at home, with any kind of board in front of it:
/// a chip's firmware does not know that its robot is simulated, and lengths of an earlier run do
/// not apply.
///
/// # Errors
/// As [`on_link`].
pub fn on_link_at_home<L: Link>(
    model: &Model,
    task: Task,
    link: L,
    session: Option<SessionId>,
) -> Result<Run, RunError> {
    let homing = Homing::Place(model.robot().tool.home_in_world_m);
    on_link_homed(model, task, link, session, &Handle::new(), homing, |_| {})
}

/// As [`on_link`], with orders from a handle.
///
/// # Errors
/// As [`on_link`]; [`RunError::Interrupted`] if the handle ordered a stop.
pub fn on_link_with<L: Link>(
    model: &Model,
    task: Task,
    link: L,
    session: Option<SessionId>,
    handle: &Handle,
    progress: impl FnMut(Progress),
) -> Result<Run, RunError> {
    on_link_homed(model, task, link, session, handle, Homing::Known, progress)
}

/// As [`on_link_with`], for a robot with a given way of homing.
///
/// # Errors
/// As [`on_link_with`].
pub(crate) fn on_link_homed<L: Link>(
    model: &Model,
    task: Task,
    link: L,
    session: Option<SessionId>,
    handle: &Handle,
    homing: Homing<'_>,
    progress: impl FnMut(Progress),
) -> Result<Run, RunError> {
    handle.publish(|view| view.task = Some(task.name.clone()));
    let run = commanded(model, task, link, session, handle, homing, progress);
    handle.close("the run has ended");
    handle.publish(|view| view.task = None);
    run
}

fn commanded<L: Link>(
    model: &Model,
    task: Task,
    link: L,
    session: Option<SessionId>,
    handle: &Handle,
    homing: Homing<'_>,
    progress: impl FnMut(Progress),
) -> Result<Run, RunError> {
    let number = session.unwrap_or_else(run::new_session);
    let mut session = Session::open(model, link, number, handle, homing, &run::LengthFiles)?;
    let plan = session.plan(task, None)?;
    session.arm()?;
    let mut recorder = Recorder::default();
    session.follow(&plan, &mut recorder, progress)?;
    let simulated = session.client().info().simulated;
    session.disarm()?;
    Ok(Run {
        plan,
        samples: recorder.samples,
        true_path: None,
        simulated,
    })
}
