//! A session with a robot: connecting and homing, arming, one motion after another, closing.

use super::planning::Planning;
use super::saved::{Implausible, LengthStore, Saved, board_name};
use super::tracking::{AtRest, Lesson, Tracking};
use super::{Progress, Recorder, RunError, follow_plan, joined_to, lead_in, resting};
use crate::control::Handle;
use crate::estimate::{EstimateError, Measurements, Sigmas, estimate};
use crate::link::{Client, Link, Note};
use crate::machine;
use crate::motion::{Model, Plan, PlanError, StaticState, Task};
use crate::recovery::Journal;
use crate::robot::{Control, TagPlace};
use crate::sight::TagSource;
use mcdpr_kinematics::Pose;
use mcdpr_protocol::{BoardState, ConfigHash, Request, SessionId};
use nalgebra::Vector3;

/// Number of pictures that one observation of a tag averages.
/// Their mean has a fifth of one picture's noise.
const PICTURES: usize = 30;
/// Time between them, µs: thirty a second.
const BETWEEN_PICTURES_US: u64 = 33_333;

/// How the robot's position is determined.
pub enum Homing<'a> {
    /// From the board; else from saved lengths if plausible; a simulated robot starts at home.
    Known,
    /// The tool hangs here, world, m: a taught position, for example home.
    Place(Vector3<f64>),
    /// The drums have paid out these lengths, m.
    Lengths(Vec<f64>),
    /// From tags in the camera's view whose poses are known.
    Tags {
        /// The camera.
        camera: &'a mut dyn TagSource,
        /// The tags' bodies.
        places: Vec<TagPlace>,
    },
}

/// A measured rest, and what was tracked before it.
pub struct Noticed {
    tracking: Tracking,
    rest: AtRest,
    near: Pose,
    held_m: Vec<f64>,
}

/// What was learnt from a rest.
pub struct Learnt {
    tracking: Tracking,
    at: StaticState,
    lesson: Lesson,
}

impl Noticed {
    /// Learns from the rest. That takes some milliseconds, more where something moved: a board is kept fed meanwhile.
    ///
    /// # Errors
    /// [`PlanError`] where what was learnt leaves no valid robot.
    pub fn learn(mut self) -> Result<Learnt, PlanError> {
        let readings_n = self.rest.tensions_n.clone();
        let lesson = self.tracking.rest(self.rest, &self.near)?;
        let model = self.tracking.model();
        let at = model.rest_from_lengths(&self.held_m, &readings_n)?;
        Ok(Learnt {
            tracking: self.tracking,
            at,
            lesson,
        })
    }
}

/// A camera, and the places of the tags that it may see.
pub struct Sight<'a> {
    /// The camera.
    pub camera: &'a mut dyn TagSource,
    /// The tags' bodies.
    pub places: &'a [TagPlace],
}

/// A robot under this program's control.
pub struct Session<'m, L: Link> {
    client: Client<L>,
    model: &'m Model,
    hash: ConfigHash,
    at: StaticState,
    kept: &'m dyn LengthStore,
    tracking: Option<Tracking>,
    /// A simulated robot that has just been switched on.
    fresh: bool,
}

impl<'m, L: Link> Session<'m, L> {
    /// Connects, configures, and determines the robot's position. Nothing moves. Lengths of a real
    /// robot are read from `kept`, and saved there at the end.
    ///
    /// # Errors
    /// [`RunError`]; [`RunError::NotHomed`] if the position cannot be determined.
    pub fn open(
        model: &'m Model,
        link: L,
        session: SessionId,
        handle: &Handle,
        homing: Homing<'_>,
        kept: &'m dyn LengthStore,
    ) -> Result<Self, RunError> {
        let mut client = Client::connect(link, session)?;
        client.obey(handle.clone());
        let hash = super::configure(&mut client, model.robot())?;
        let status = super::status(&mut client)?;
        if let Some(record) = status.fault {
            return Err(RunError::Latched { record });
        }
        let tensions_n: Vec<_> = status.tensions_n().collect();
        let known: Vec<_> = status.lengths_m().collect();
        let fresh = client.info().simulated && !status.referenced;
        // A simulated robot in this process is homed in every session.
        let anew = !matches!(homing, Homing::Known) && !client.info().simulated;
        let home = |place: &Vector3<f64>| -> Result<(StaticState, Vec<f64>), RunError> {
            let rest = model.rest(place, None)?;
            let lengths_m = rest.paid_out_m.clone();
            Ok((rest, lengths_m))
        };
        let (at, lengths_m) = match homing {
            Homing::Place(place) => home(&place)?,
            Homing::Tags { camera, places } => {
                let start = if status.referenced {
                    model.tool_m(&model.rest_from_lengths(&known, &tensions_n)?)
                } else {
                    model.robot().tool.home_in_world_m
                };
                let rest = seen(model, camera, places, &tensions_n, &start, &mut || Ok(()))?;
                let lengths_m = rest.paid_out_m.clone();
                (rest, lengths_m)
            }
            Homing::Lengths(lengths_m) => {
                (model.rest_from_lengths(&lengths_m, &tensions_n)?, lengths_m)
            }
            Homing::Known if status.referenced => {
                (model.rest_from_lengths(&known, &tensions_n)?, known)
            }
            Homing::Known if client.info().simulated => home(&model.robot().tool.home_in_world_m)?,
            Homing::Known => {
                let saved = kept.load(&board_name(client.hello()));
                let saved = saved.ok_or(Implausible::None).and_then(|saved| {
                    saved.check(model, &tensions_n)?;
                    Ok(saved)
                });
                let saved = saved.map_err(|reason| RunError::NotHomed { reason })?;
                let rest = model.rest_from_lengths(&saved.lengths_m, &tensions_n)?;
                (rest, saved.lengths_m)
            }
        };
        // A board that knows its lengths keeps them; the expected tensions are those of this
        // position.
        let tensions_n = machine::expected_n(model.robot(), at.tensions_n());
        client.request(machine::reference(&lengths_m, &tensions_n))?;
        if anew {
            kept.homed(&board_name(client.hello()));
        }
        Ok(Self {
            client,
            model,
            hash,
            at,
            kept,
            tracking: None,
            fresh,
        })
    }

    /// From now on the robot's slow changes are tracked at its rests, see [`Self::notice`], and plans follow
    /// them. The board's configuration stays that of this session's model. States that were kept before a homing
    /// learn of it; those kept of another simulated robot are not used: it has not aged.
    ///
    /// # Errors
    /// [`RunError::Plan`] if no resting pose fits the lengths by what was tracked.
    pub fn track(
        &mut self,
        mut tracking: Tracking,
        kept_unix_s: Option<u64>,
    ) -> Result<(), RunError> {
        if let Some(kept_s) = kept_unix_s {
            if self.fresh {
                tracking = tracking.anew();
            } else if let Some(homed_s) = self.kept.homed_unix_s(&board_name(self.client.hello()))
                && homed_s >= kept_s
            {
                tracking.homed();
            }
        }
        let tensions_n: Vec<f64> = super::status(&mut self.client)?.tensions_n().collect();
        let held_m = &self.at.paid_out_m;
        self.at = tracking.model().rest_from_lengths(held_m, &tensions_n)?;
        self.tracking = Some(tracking);
        Ok(())
    }

    /// What is tracked, if anything is.
    #[must_use]
    pub const fn tracking(&self) -> Option<&Tracking> {
        self.tracking.as_ref()
    }

    /// The model that plans are made with: the described one, or what tracking made of it.
    #[must_use]
    pub fn planner(&self) -> &Model {
        self.tracking.as_ref().map_or(self.model, Tracking::model)
    }

    /// Measures how the robot rests, for two seconds: lengths, tensions and, with a camera, the tags of known
    /// places. It must hold. `None` without tracking. What is learnt from it goes back by [`Self::learnt`].
    ///
    /// # Errors
    /// The client's, the camera's.
    pub fn notice(&mut self, sight: Option<Sight<'_>>) -> Result<Option<Noticed>, RunError> {
        if self.tracking.is_none() {
            return Ok(None);
        }
        let rest = resting::measure(&mut self.client, sight)?;
        // Plans start where the board holds the cables, wherever that is by what is known now.
        let status = super::status(&mut self.client)?;
        // A cable that is held by its tension is where its encoder says.
        let cables = self.model.robot().cables.iter();
        let held_m: Vec<f64> = cables
            .zip(status.setpoints_m().zip(status.lengths_m()))
            .map(|(cable, (setpoint_m, length_m))| match cable.control {
                Control::Position => setpoint_m,
                Control::Tension => length_m,
            })
            .collect();
        let near = self.at.equilibrium.pose;
        Ok(self.tracking.take().map(|tracking| Noticed {
            tracking,
            rest,
            near,
            held_m,
        }))
    }

    /// Takes what was learnt from a rest: later plans follow it.
    pub fn learnt(&mut self, learnt: Learnt) -> Lesson {
        self.at = learnt.at;
        self.tracking = Some(learnt.tracking);
        learnt.lesson
    }

    /// The line to the board.
    pub const fn client(&mut self) -> &mut Client<L> {
        &mut self.client
    }

    /// The model of the robot.
    #[must_use]
    pub const fn model(&self) -> &'m Model {
        self.model
    }

    /// Updates the state after a motion that was planned while it ran.
    pub(super) fn set_at(&mut self, at: StaticState) {
        self.at = at;
    }

    /// How the robot hangs now.
    #[must_use]
    pub const fn at(&self) -> &StaticState {
        &self.at
    }

    /// Current tool position, world, m.
    #[must_use]
    pub fn tool_m(&self) -> Vector3<f64> {
        self.planner().tool_m(&self.at)
    }

    /// Plans a task from where the tool is.
    ///
    /// # Errors
    /// The first limit that would be broken.
    pub fn plan(&self, task: Task, speed_mps: Option<f64>) -> Result<Plan, RunError> {
        self.planning().plan(task, speed_mps)
    }

    /// What a plan from here needs, to make it on another thread while the board of an armed robot is kept fed.
    #[must_use]
    pub fn planning(&self) -> Planning {
        Planning {
            model: self.planner().clone(),
            tool_m: self.tool_m(),
            attitude: self.at.equilibrium.pose.rotation,
            tracking: self.tracking.clone(),
        }
    }

    /// Plans the rest of the task that a loss of power interrupted, from where the tool is; `hash` is
    /// the task's checksum.
    ///
    /// # Errors
    /// [`super::ResumeError`]; the first limit that the rest would break.
    pub fn plan_rest(
        &mut self,
        task: Task,
        hash: u32,
        journal: &Journal,
    ) -> Result<Plan, RunError> {
        if journal.identity.task_hash != hash {
            return Err(super::ResumeError::Task {
                journal: journal.identity.task.clone(),
                asked: task.name,
            }
            .into());
        }
        let status = super::status(&mut self.client)?;
        // Once the robot holds, tensions are no longer those that the cut left: with the same lengths
        // the tool hangs elsewhere, and from there the motion starts.
        let planned = self.model.rest(&self.tool_m(), None)?;
        let (held_m, tensions_n) = (&self.at.paid_out_m, planned.tensions_n());
        let start = self.model.rest_from_lengths(held_m, tensions_n)?;
        let tool_m = self.model.tool_m(&start);
        super::resume::plan_rest(self.model, task, journal, &status, &tool_m)
    }

    /// Enables drives, checks, opens brakes and holds.
    ///
    /// # Errors
    /// As [`super::arm`].
    pub fn arm(&mut self) -> Result<(), RunError> {
        // A simulated robot starts at home: it has no lengths to keep.
        if self.client.info().simulated {
            let armed = super::arm(&mut self.client, self.hash);
            return armed.map_err(|error| self.explain(error));
        }
        // Before any drum turns: after a cut in motion the saved lengths would be wrong.
        self.kept.forget(&board_name(self.client.hello()));
        let armed = super::arm(&mut self.client, self.hash);
        // A refused arming leaves a disarmed robot whose board still knows its lengths.
        if armed.is_err()
            && let Ok(status) = super::status(&mut self.client)
            && status.state == BoardState::Disarmed
            && status.referenced
        {
            let saved = Saved::of(self.client.hello(), &status, self.model.robot());
            self.kept.keep(&saved);
        }
        armed.map_err(|error| self.explain(error))
    }

    /// Follows a plan that starts at the robot's position; it holds at its end.
    ///
    /// # Errors
    /// As [`super::follow`].
    pub fn follow(
        &mut self,
        plan: &Plan,
        recorder: &mut Recorder,
        progress: impl FnMut(Progress),
    ) -> Result<(), RunError> {
        self.client.note(Note::Plan(plan));
        let mut status = super::status(&mut self.client)?;
        if let Some(way) = lead_in(plan, &status, self.model) {
            super::follow(&mut self.client, &way, &mut Recorder::default(), |_| {})?;
            status = super::status(&mut self.client)?;
        }
        let knots = joined_to(plan, &status, self.planner())?;
        let before = recorder.samples.len();
        let done = follow_plan(&mut self.client, plan, &knots, recorder, progress);
        if let Some(tracking) = &mut self.tracking {
            tracking.moved(recorder.samples.get(before..).unwrap_or_default());
        }
        if done.is_ok()
            && let Some(rest) = plan.state(plan.timed.duration_s())
        {
            self.at = rest;
        }
        done.map_err(|error| self.explain(error))
    }

    /// Observes tags whose poses are known while the robot holds, for a second, and takes the tool
    /// to be where they show it: later motions start there. The board's lengths stay as they are;
    /// their difference here becomes a constant offset of those motions, which is refused above 1
    /// mm.
    ///
    /// # Errors
    /// [`RunError::NoTag`], the camera's, the client's; the previous position is kept then.
    pub fn look(
        &mut self,
        source: &mut dyn TagSource,
        places: Vec<TagPlace>,
    ) -> Result<(), RunError> {
        let status = super::status(&mut self.client)?;
        let tensions = status.tensions.iter();
        let tensions_n: Vec<_> = tensions.map(|t| t.newtons()).collect();
        let start_m = self.tool_m();
        let client = &mut self.client;
        let mut between = || {
            let until_us = client.now_us() + BETWEEN_PICTURES_US;
            Ok(client.pump(until_us)?)
        };
        self.at = seen(
            self.model,
            source,
            places,
            &tensions_n,
            &start_m,
            &mut between,
        )?;
        Ok(())
    }

    /// Opens or closes the gripper.
    ///
    /// # Errors
    /// The client's.
    pub fn gripper(&mut self, closed: bool) -> Result<(), RunError> {
        self.client.request(Request::Gripper { closed })?;
        Ok(())
    }

    /// Closes the brakes under torque, switches torque off, saves the lengths, releases the board.
    ///
    /// # Errors
    /// As [`super::disarm`].
    pub fn disarm(mut self) -> Result<(), RunError> {
        super::ask_to_disarm(&mut self.client)
            .and_then(|()| super::wait_for(&mut self.client, BoardState::Disarmed, super::PARKS_S))
            .map_err(|error| self.explain(error))?;
        self.close()
    }

    /// [`super::explained`] with this robot.
    pub(super) fn explain(&mut self, error: RunError) -> RunError {
        super::explained(&mut self.client, self.model, error)
    }

    /// Saves the lengths and releases a disarmed board.
    ///
    /// # Errors
    /// The client's.
    pub fn close(mut self) -> Result<(), RunError> {
        let status = super::status(&mut self.client)?;
        if !self.client.info().simulated && status.state == BoardState::Disarmed {
            let saved = Saved::of(self.client.hello(), &status, self.model.robot());
            self.kept.keep(&saved);
        }
        self.client.request(Request::Close)?;
        Ok(())
    }
}

/// How the robot hangs according to the camera's view of tags.
fn seen(
    model: &Model,
    source: &mut dyn TagSource,
    places: Vec<TagPlace>,
    tensions_n: &[f64],
    start_m: &Vector3<f64>,
    between: &mut dyn FnMut() -> Result<(), RunError>,
) -> Result<StaticState, RunError> {
    let mut views = Vec::new();
    for _ in 0..PICTURES {
        between()?;
        let found = source.look().map_err(RunError::Sight)?;
        let known = |id: u32| {
            let mut tags = model.robot().tags.iter();
            tags.any(|tag| tag.id == id && places.iter().any(|place| place.body == tag.body))
        };
        views.extend(found.into_iter().filter(|view| known(view.id)));
    }
    if views.is_empty() {
        return Err(RunError::NoTag);
    }
    let measured = Measurements {
        // The lengths are what is to be found: the board's own must not count.
        lengths_m: Vec::new(),
        tensions_n: tensions_n.to_vec(),
        views,
        places,
    };
    let found = estimate(model, &measured, &Sigmas::default(), start_m)?;
    // An error of the platform's attitude must not be compensated by the lengths: the tool's
    // position counts, and the model's lengths for it.
    Ok(found.rest)
}

impl From<EstimateError> for RunError {
    fn from(error: EstimateError) -> Self {
        Self::Estimate(error)
    }
}

impl From<Implausible> for RunError {
    fn from(reason: Implausible) -> Self {
        Self::NotHomed { reason }
    }
}
