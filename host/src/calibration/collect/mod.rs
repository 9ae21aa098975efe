//! Collecting calibration data on a robot: choice of poses, moves, waiting for rest, measuring.

mod choice;
mod guard;
mod reach;
mod recheck;
mod skeleton;
mod still;
mod travel;

pub use reach::{Asked, Reach};
pub use recheck::recheck;
pub(crate) use skeleton::{Sketch, of_this_robot};
pub use still::Still;
use still::Waited;
pub use travel::{Transfer, way};

use super::data::{Data, Observation, View};
use super::error::Refusal;
use super::general::slip::{self, Slipped};
use super::plan::Halt;
use crate::control::Handle;
use crate::link::{Client, Link, meanwhile};
use crate::machine;
use crate::motion::{Model, PlanError, StaticState};
use crate::robot::Control;
use crate::run::{self, Recorder, RunError, interrupted};
use crate::sight::{SightError, TagSource};
use choice::Choice;
use mcdpr_protocol::{ConfigHash, SessionId, Status, StopKind};
use miette::Diagnostic;

/// This many failed poses in a row end the collection.
const LOST_MAX: usize = 8;

/// What to collect.
#[derive(Debug, Clone)]
pub struct Options {
    /// Number of poses, home included.
    pub poses: usize,
    /// Number of reachable poses to choose from.
    pub candidates: usize,
    /// Stop when the expected error is below this, m; then each next pose is chosen during the
    /// collection.
    pub target_error_m: Option<f64>,
    /// Seed of the candidates.
    pub seed: u64,
    /// Seed of the simulated machine, if it is one.
    pub simulated_seed: Option<u64>,
    /// Kind of that machine, as `--machine` names it; `None`: as built.
    pub simulated_machine: Option<String>,
    /// Hash of the robot's description, if the tags in use are not those of the description.
    pub described: Option<u32>,
    /// Session of the link; `None` for a new one.
    pub session: Option<SessionId>,
    /// Stops, holds and resumes from another thread.
    pub orders: Handle,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            poses: 20,
            candidates: 300,
            target_error_m: None,
            seed: 1,
            simulated_seed: None,
            simulated_machine: None,
            described: None,
            session: None,
            orders: Handle::new(),
        }
    }
}

/// Progress of the collection.
#[derive(Debug, Clone, PartialEq)]
pub enum Step {
    /// The robot moves to a pose.
    Going {
        /// Poses done.
        done: usize,
        /// Poses wanted.
        wanted: usize,
    },
    /// A pose is measured.
    Measured {
        /// Poses done.
        done: usize,
        /// Poses wanted.
        wanted: usize,
        /// Swing of the platform, m.
        swing_m: f64,
        /// Whether whole periods were averaged.
        averaged: bool,
        /// Tags in view.
        tags: usize,
        /// Roll and pitch by the inclinometer, rad.
        tilt_rad: Option<[f64; 2]>,
        /// Expected root mean square position error with the poses so far, m.
        expected_error_m: f64,
    },
    /// The first pose was measured again at the end.
    Returned {
        /// Largest difference of a length from its first reading there, m.
        apart_m: f64,
    },
    /// A pose failed.
    Skipped {
        /// Why.
        reason: String,
    },
}

/// Why collecting ended early. Earlier measurements are kept.
#[derive(Debug, thiserror::Error, Diagnostic)]
pub enum CollectError {
    /// The robot or the line to it.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Run(#[from] RunError),
    /// The camera.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Sight(#[from] SightError),
    /// The collection is not possible.
    #[error("{what}")]
    #[diagnostic(code(mcdpr::calibration::collect), help("{help}"))]
    Impossible {
        /// What is wrong.
        what: String,
        /// What to do.
        help: String,
    },
    /// The data cannot be saved.
    #[error(transparent)]
    #[diagnostic(transparent)]
    File(#[from] super::result::FileError),
    /// The data do not allow a calibration.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Refused(#[from] Refusal),
}

impl From<PlanError> for CollectError {
    fn from(error: PlanError) -> Self {
        Self::Run(error.into())
    }
}

impl From<crate::link::ClientError> for CollectError {
    fn from(error: crate::link::ClientError) -> Self {
        Self::Run(error.into())
    }
}

impl CollectError {
    /// The program's exit code for this error.
    #[must_use]
    pub(crate) const fn exit_code(&self) -> i32 {
        match self {
            Self::Run(error) => error.exit_code(),
            _ => 1,
        }
    }

    pub(crate) fn impossible(what: impl Into<String>, help: impl Into<String>) -> Self {
        Self::Impossible {
            what: what.into(),
            help: help.into(),
        }
    }
}

/// Collects data: moves to chosen poses, waits for rest, measures, and moves home. `before` are
/// earlier data; `keep` gets all data after every pose; `progress` is called before and after every pose.
///
/// # Errors
/// [`CollectError`]; the robot then is at rest with its brakes closed, or stops by itself.
pub fn collect<L: Link, S: TagSource>(
    model: &Model,
    link: L,
    source: &mut S,
    options: &Options,
    before: Option<Data>,
    mut keep: impl FnMut(&Data) -> Result<(), CollectError>,
    mut progress: impl FnMut(Step),
) -> Result<Data, CollectError> {
    let reach = Reach::new(model)?;
    let mut client = Client::connect(link, options.session.unwrap_or_else(run::new_session))?;
    client.obey(options.orders.clone());
    let hash = run::configure(&mut client, model.robot())?;
    let status = run::status(&mut client)?;
    if let Some(record) = status.fault {
        return Err(RunError::Latched { record }.into());
    }
    // A simulated machine is the same after every start.
    if before.is_some() && !status.referenced && options.simulated_seed.is_none() {
        return Err(CollectError::impossible(
            "the board has lost its lengths since the data were begun, so new poses do not fit them",
            "start again without --resume",
        ));
    }
    let home = model.rest_at_home()?;
    let start = if status.referenced {
        let (metres, newtons) = measured(&status);
        let there = model.rest_from_lengths(&metres, &newtons)?;
        let tensions_n = machine::expected_n(model.robot(), there.tensions_n());
        client.request(machine::reference(&metres, &tensions_n))?;
        there
    } else {
        client.request(machine::reference(&home.paid_out_m, home.tensions_n()))?;
        home.clone()
    };
    run::arm(&mut client, hash)?;
    let mut session = Session {
        model,
        reach,
        client,
        hash,
        here: start,
        home,
        offsets_m: Vec::new(),
    };
    let outcome = session.work(source, options, before, &mut keep, &mut progress);
    match outcome {
        Ok(data) => {
            session.go_home()?;
            run::disarm(&mut session.client)?;
            Ok(data)
        }
        Err(CollectError::Run(error)) => {
            Err(run::explained(&mut session.client, model, error).into())
        }
        Err(error) => {
            // The robot works: disarm it before reporting the error.
            session.go_home()?;
            run::disarm(&mut session.client)?;
            Err(error)
        }
    }
}

/// Fewer poses show no slip.
const SLIP_POSES: usize = 8;

/// The error that ends a collection during which a cable slipped.
fn a_slip(slip: &Slipped) -> CollectError {
    CollectError::impossible(
        format!("{}; poses before and after do not fit together", slip.words),
        "look how that cable is held on its drum, home the robot, and collect again without --resume; the poses so far \
         are kept in the file",
    )
}

/// A cable that has slipped since the first pose.
fn slipped(data: &Data) -> Option<Slipped> {
    if data.poses.len() < SLIP_POSES {
        return None;
    }
    slip::in_data(data, None).into_iter().next()
}

struct Session<'a, L: Link> {
    model: &'a Model,
    reach: Reach<'a>,
    client: Client<L>,
    hash: ConfigHash,
    here: StaticState,
    home: StaticState,
    offsets_m: Vec<f64>,
}

impl<L: Link> Session<'_, L> {
    fn work<S: TagSource>(
        &mut self,
        source: &mut S,
        options: &Options,
        before: Option<Data>,
        keep: &mut impl FnMut(&Data) -> Result<(), CollectError>,
        progress: &mut impl FnMut(Step),
    ) -> Result<Data, CollectError> {
        let robot = self.model.robot().clone();
        self.join()?;
        let seed = options.simulated_seed;
        let hash = options.described.unwrap_or_else(|| robot.content_hash());
        let kind = options.simulated_machine.clone();
        let mut sketch = match before {
            Some(data) => Sketch::resumed(&robot, hash, data, (seed, kind))?,
            None => Sketch::new(&robot, hash, &self.home, (seed, kind)),
        };
        let mut suspected = None;
        let mut first = None;
        if sketch.data.poses.is_empty() {
            let here = self.here.clone();
            match self.measure(source, &sketch)? {
                Waited::Still(still) => {
                    let pose = &here.equilibrium.pose;
                    meanwhile(&mut self.client, || sketch.add(pose, &still))?;
                    first = Some((here, still));
                }
                Waited::Nothing(reason) => {
                    return Err(CollectError::impossible(
                        format!("where the robot hangs now, {reason}"),
                        "lay the target so that the camera sees it from home, with the tags of the \
                         robot file facing up",
                    ));
                }
            }
            keep(&sketch.data)?;
        }
        let missing = options.poses.saturating_sub(sketch.data.poses.len());
        let (client, reach) = (&mut self.client, &self.reach);
        let orders = client.handle().clone();
        let halt = Halt::when(move || interrupted() || orders.stop_ordered().is_some());
        let choice = meanwhile(client, || {
            let mut choice = Choice::new(reach, &sketch, missing, options, &halt)?;
            if options.target_error_m.is_none() {
                choice.plan(missing);
            }
            Ok::<_, CollectError>(choice)
        })?;
        self.obey()?;
        let mut choice = choice?;
        let mut lost = 0;
        loop {
            let count = sketch.data.poses.len();
            let expected_error_m = meanwhile(&mut self.client, || choice.expected_error_m())?;
            let reached = options.target_error_m.is_some_and(|target| {
                expected_error_m < target && count >= super::check::POSES_MIN
            });
            if reached || count >= options.poses {
                break;
            }
            let (client, here) = (&mut self.client, &self.here);
            let next = meanwhile(client, || choice.next(here))?;
            self.obey()?;
            let Some((k, goal)) = next else {
                break;
            };
            progress(Step::Going {
                done: count,
                wanted: options.poses,
            });
            let tried = match self.go(&goal)? {
                None => self.measure(source, &sketch)?,
                Some(reason) => {
                    // Where a cable has little tension, the straight ways to other poses may take it away, too. The way
                    // home gives it back.
                    self.go_home()?;
                    Waited::Nothing(reason)
                }
            };
            match tried {
                Waited::Still(still) => {
                    let expected_error_m = meanwhile(&mut self.client, || {
                        sketch.add(&goal.equilibrium.pose, &still);
                        choice.measured(k);
                        choice.expected_error_m()
                    })?;
                    lost = 0;
                    keep(&sketch.data)?;
                    let slipped = meanwhile(&mut self.client, || slipped(&sketch.data))?;
                    // A second pose must agree: a collection asks often, and one reading may be wrong.
                    let again = slipped.as_ref().filter(|now| suspected == Some(now.cable));
                    if let Some(slip) = again {
                        return Err(a_slip(slip));
                    }
                    suspected = slipped.map(|slip| slip.cable);
                    progress(Step::Measured {
                        done: count + 1,
                        wanted: options.poses,
                        swing_m: still.swing_m,
                        averaged: still.averaged,
                        tags: still.tags.len(),
                        tilt_rad: still.tilt_rad,
                        expected_error_m,
                    });
                }
                Waited::Nothing(reason) => {
                    choice.give_up(k);
                    lost += 1;
                    if lost == LOST_MAX {
                        return Err(CollectError::impossible(
                            format!(
                                "{lost} poses one after another gave nothing; the last: {reason}"
                            ),
                            "look at camera and target, then continue with --resume",
                        ));
                    }
                    progress(Step::Skipped { reason });
                }
            }
        }
        if let Some((first, before)) = first {
            self.revisit(source, &first, &before, &sketch, progress)?;
        }
        Ok(sketch.data)
    }

    /// Measures the first pose once more. A slip before the second or the last pose leaves a single pose on one side,
    /// which its neighbours hardly contradict; here the same pose has two lengths. The measurement is not kept: it
    /// repeats another.
    fn revisit<S: TagSource>(
        &mut self,
        source: &mut S,
        first: &StaticState,
        before: &Still,
        sketch: &Sketch,
        progress: &mut impl FnMut(Step),
    ) -> Result<(), CollectError> {
        if sketch.data.poses.len() < SLIP_POSES || self.go(first)?.is_some() {
            return Ok(());
        }
        let Waited::Still(still) = self.measure(source, sketch)? else {
            return Ok(());
        };
        let slipped = meanwhile(&mut self.client, || {
            let mut with = sketch.clone();
            with.add(&first.equilibrium.pose, &still);
            slipped(&with.data)
        })?;
        let pairs = still.lengths_m.iter().zip(&before.lengths_m);
        progress(Step::Returned {
            apart_m: pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max),
        });
        slipped.map_or(Ok(()), |slip| Err(a_slip(&slip)))
    }

    /// Stops the robot if that was asked for.
    fn obey(&mut self) -> Result<(), CollectError> {
        match run::stop_wanted(&self.client) {
            Some(kind) => Err(run::stop_now(&mut self.client, kind).into()),
            None => Ok(()),
        }
    }

    fn measure<S: TagSource>(
        &mut self,
        source: &mut S,
        sketch: &Sketch,
    ) -> Result<Waited, CollectError> {
        let (model, here) = (self.model, &self.here);
        let slowest_s = meanwhile(&mut self.client, || slowest_s(model, here))?;
        still::measure(&mut self.client, source, |id| sketch.size_m(id), slowest_s)
    }

    /// Moves to a resting pose, over home if the straight line leaves the robot's reach. Returns the
    /// reason if the robot did not arrive.
    fn go(&mut self, goal: &StaticState) -> Result<Option<String>, CollectError> {
        let model = self.model;
        let robot = model.robot();
        let (reach, offsets_m) = (&self.reach, &self.offsets_m);
        let (here, home) = (&self.here, &self.home);
        let ways = meanwhile(&mut self.client, || {
            let slowest_s = slowest_s(model, goal).max(slowest_s(model, here));
            let straight = |from: &StaticState, to: &StaticState| {
                travel::way(reach, robot, from, to, slowest_s, offsets_m)
            };
            straight(here, goal)
                .map(|way| vec![(way, goal)])
                .or_else(|| {
                    let over_home = [(straight(here, home)?, home), (straight(home, goal)?, goal)];
                    Some(over_home.into())
                })
                .map(|ways| ways.into_iter().map(|(way, to)| (way, to.clone())))
                .map(Vec::from_iter)
        })?;
        let Some(ways) = ways else {
            return Ok(Some(
                "no way there keeps every cable within its limits".into(),
            ));
        };
        for (way, to) in ways {
            let mut recorder = Recorder::default();
            let watch = |seen: &Recorder| guard::halt(&self.reach, &seen.samples);
            let gone = run::follow_watched(&mut self.client, &way.knots, &mut recorder, watch)?;
            if let Some(halt) = gone {
                self.turn_back(halt.kind, &recorder)?;
                return Ok(Some(halt.reason));
            }
            self.here = to;
        }
        Ok(None)
    }

    /// After a stop during a move: back to its start.
    fn turn_back(&mut self, stopped: StopKind, seen: &Recorder) -> Result<(), CollectError> {
        let status = run::status(&mut self.client)?;
        // After a hold it is armed, at its set-points; after a stop it must be armed anew.
        let there = if stopped == StopKind::Hold {
            let commanded = status.setpoints_m();
            let commanded_m: Vec<f64> = commanded.collect();
            let newtons = guard::mean_n(&seen.samples);
            self.model.rest_from_lengths(&commanded_m, &newtons)?
        } else {
            let (metres, newtons) = measured(&status);
            // The expected tensions are those of this position, on this machine.
            let expected_n = machine::expected_n(self.model.robot(), &newtons);
            let reference = machine::reference(&metres, &expected_n);
            self.client.request(reference)?;
            run::arm(&mut self.client, self.hash)?;
            self.model.rest_from_lengths(&metres, &newtons)?
        };
        let began = std::mem::replace(&mut self.here, there);
        self.join()?;
        let (model, reach, offsets_m) = (self.model, &self.reach, &self.offsets_m);
        let here = &self.here;
        let back = meanwhile(&mut self.client, || {
            let slowest_s = slowest_s(model, here);
            travel::back(reach, model.robot(), here, &began, slowest_s, offsets_m)
        })?;
        if let Some(way) = back {
            run::follow(
                &mut self.client,
                &way.knots,
                &mut Recorder::default(),
                |_| {},
            )?;
            self.here = began;
        }
        Ok(())
    }

    /// Motions from here start where the board holds the cables.
    fn join(&mut self) -> Result<(), CollectError> {
        let status = run::status(&mut self.client)?;
        let pairs = status.setpoints.iter().zip(&self.here.paid_out_m);
        self.offsets_m = pairs
            .zip(&self.model.robot().cables)
            .map(|((setpoint, planned), cable)| match cable.control {
                Control::Position => setpoint.metres() - planned,
                Control::Tension => 0.0,
            })
            .collect();
        Ok(())
    }

    fn go_home(&mut self) -> Result<(), CollectError> {
        let home = self.home.clone();
        // If there is no straight path home, the brakes hold it in place.
        let _ = self.go(&home)?;
        Ok(())
    }
}

/// Period of the slowest swing there, s.
fn slowest_s(model: &Model, rest: &StaticState) -> f64 {
    let found = model.geometry().stability(&rest.equilibrium).ok();
    let slowest = found.and_then(|s| s.modes_hz.iter().copied().next());
    // Without a credible mode (over 0.2 Hz) a period of 1 s is assumed.
    1.0 / slowest.filter(|hz| *hz > 0.2).unwrap_or(1.0)
}

/// Lengths (m) and tensions (N) that a board reports.
fn measured(status: &Status) -> (Vec<f64>, Vec<f64>) {
    let lengths = status.lengths_m();
    let tensions = status.tensions_n();
    (lengths.collect(), tensions.collect())
}

/// The data of one pose.
fn observation(home_m: &[f64], still: &Still, views: Vec<View>, factor: f64) -> Observation {
    Observation {
        encoder_m: still
            .lengths_m
            .iter()
            .zip(home_m)
            .map(|(length, home)| Some(length - home))
            .collect(),
        tension_n: Some(still.tensions_n.clone()),
        views,
        tilt_rad: still.tilt_rad,
        noise_factor: factor,
    }
}
