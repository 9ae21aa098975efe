//! A task again and again on an armed robot, and what is noticed at its rests.

use super::{Run, in_calibrated_frame};
use crate::link::{Link, SimulatedLink, meanwhile};
use crate::motion::{Model, Plan, Task};
use crate::report;
use crate::robot::{Robot, TagPlace};
use crate::run::tracking::{Lesson, Tracking};
use crate::run::{Progress, Recorder, RunError, Session, Sight};
use crate::sight::{Scene, SimulatedTags, TagSource};
use mcdpr_core::estimate::tube::{Doubts, Tube};
use mcdpr_simulator::TracePoint;

/// Called after every rest that was taken note of.
pub(super) type OnRest<'a> = dyn FnMut(&Tracking, &Lesson) + 'a;
/// Keeps a tracked state on a disk, on another thread than the board's.
pub(super) type Keep = dyn FnMut(&Tracking) + Send;
/// The true states of a simulated robot since the last call.
pub(super) type Truth<'a> = dyn FnMut() -> Vec<TracePoint> + 'a;

/// A camera and the places of its tags.
pub(crate) type Eyes<'a> = (Box<dyn TagSource + 'a>, Vec<TagPlace>);

/// Which camera sees the robot's tags at its rests.
pub(crate) enum Looking<'a> {
    /// None.
    Blind,
    /// The simulated robot's own.
    Simulated,
    /// This one; the places of the tags are known.
    By(Eyes<'a>),
}

/// What is tracked, and by which camera.
pub(super) struct Tracked<'a> {
    pub(super) tracking: Tracking,
    /// When it was kept, s since 1970; `None` for a new one.
    pub(super) kept_unix_s: Option<u64>,
    pub(super) looking: Looking<'a>,
    pub(super) on_rest: Box<OnRest<'a>>,
    pub(super) keep: Option<Box<Keep>>,
}

/// Error of the camera's mounting that a calibration leaves, half widths per axis, m and rad.
const MOUNTED_M: f64 = 1.7e-4;
const MOUNTED_RAD: f64 = 3.4e-4;
/// Noise of a corner in a simulated picture, px.
const CORNER_PX: f64 = 0.1;

/// The simulated robot's camera and the places of its tags. A robot that was not calibrated on the simulator counts
/// as one whose camera and tags were calibrated elsewhere.
pub(crate) fn simulated_eyes<'a>(robot: &Robot, link: &SimulatedLink, seed: u64) -> Eyes<'a> {
    let (scene, places) = match &robot.calibrated {
        Some(calibrated) => (Scene::of(robot, seed), calibrated.places.clone()),
        None => {
            let scene = Scene::on_floor(robot, MOUNTED_M, MOUNTED_RAD, seed);
            let places = scene.places.clone();
            (scene, places)
        }
    };
    let camera = SimulatedTags::new(link.clone(), scene, CORNER_PX, seed);
    (Box::new(camera), places)
}

/// Who takes note of rests.
pub(super) struct Noting<'a> {
    pub(super) eyes: Option<Eyes<'a>>,
    pub(super) on_rest: Box<OnRest<'a>>,
    pub(super) keep: Option<Box<Keep>>,
}

impl Noting<'_> {
    fn rest<L: Link>(&mut self, session: &mut Session<'_, L>) -> Result<(), RunError> {
        let sight = self.eyes.as_mut().map(|(camera, places)| Sight {
            camera: camera.as_mut(),
            places,
        });
        let Some(noticed) = session.notice(sight)? else {
            return Ok(());
        };
        let learnt = meanwhile(session.client(), || noticed.learn())??;
        let lesson = session.learnt(learnt);
        if let Some(tracking) = session.tracking() {
            (self.on_rest)(tracking, &lesson);
        }
        if let Some((keep, tracking)) = self.keep.as_mut().zip(session.tracking().cloned()) {
            meanwhile(session.client(), || keep(&tracking))?;
        }
        Ok(())
    }
}

/// The laps of a task on an armed robot.
pub(super) struct Laps<'a> {
    pub(super) model: &'a Model,
    pub(super) task: Task,
    pub(super) count: usize,
    pub(super) noting: Option<Noting<'a>>,
    pub(super) truth: Option<Box<Truth<'a>>>,
    pub(super) progress: Box<dyn FnMut(Progress) + 'a>,
}

impl Laps<'_> {
    /// Follows `first`, and then the task from where the tool is, again and again.
    pub(super) fn follow<L: Link>(
        &mut self,
        session: &mut Session<'_, L>,
        first: Plan,
    ) -> Result<Run, RunError> {
        let (mut plan, mut tube) = (first, None);
        if let Some(noting) = &mut self.noting {
            noting.rest(session)?;
            (plan, tube) = self.plan(session, None)?;
        }
        let (mut figures, mut stated) = (Vec::new(), Vec::new());
        loop {
            let mut recorder = Recorder::default();
            session.follow(&plan, &mut recorder, &mut self.progress)?;
            if let Some(noting) = &mut self.noting {
                noting.rest(session)?;
            }
            let mut run = Run {
                plan,
                samples: recorder.samples,
                true_path: None,
                true_turns: None,
                simulated: false,
                laps: Vec::new(),
                tube,
                stated: Vec::new(),
            };
            if self.count <= 1 {
                return Ok(run);
            }
            self.judge(&mut run);
            stated.extend(run.stated());
            let model = self.model;
            figures.push(meanwhile(session.client(), || run.figures(model))??);
            if figures.len() >= self.count {
                run.laps = figures;
                run.stated = stated;
                return Ok(run);
            }
            (plan, tube) = self.plan(session, run.tube)?;
        }
    }

    /// Plans the task from where the tool of the armed robot is, while its board is kept fed; with the tube that the plan
    /// states, if the robot is tracked.
    fn plan<L: Link>(
        &self,
        session: &mut Session<'_, L>,
        before: Option<Tube>,
    ) -> Result<(Plan, Option<Tube>), RunError> {
        let (planning, task) = (session.planning(), self.task.clone());
        meanwhile(session.client(), || {
            let plan = planning.plan(task, None)?;
            let tube = planning.tube(&plan, &Doubts::by_tape(), before.as_ref())?;
            Ok((plan, tube))
        })?
    }

    /// Adds the truth of a simulated robot's last motion.
    pub(super) fn judge(&mut self, run: &mut Run) {
        let Some(trace) = self.truth.as_mut().map(|truth| truth()) else {
            return;
        };
        let known = self.model.robot().calibrated.is_none();
        run.true_turns = known.then(|| report::true_turns(&trace));
        run.true_path = Some(in_calibrated_frame(self.model, report::true_path(&trace)));
    }
}
