//! Steps of a task in time: paths with their laws, waits, and the times of gripper commands.

use super::bounds;
use super::model::{Model, StaticState};
use super::options::Planner;
use super::path::TURN_LEVER_M;
use super::path::{Path, PathError};
use super::plan::{LONGEST_S, MOST_IMPULSES, MOST_PLACES, PlanError};
use super::shaper::Shaper;
use super::time_law::{Bounds, TimeLaw};
use super::track::{Track, Turn};
use nalgebra::{Rotation3, Vector3};
use std::f64::consts::SQRT_2;

/// Time for a gripper if its robot file gives none, s.
const LEAST_GRIPPER_S: f64 = 0.05;
/// Share of a drum's greatest speed that a plan uses: the slope of a length is known only at the
/// solved points.
const DRUM_SHARE: f64 = 0.995;
/// A motion whose duration is free takes at least this long, s: a board's knots are 21 ms apart or more, and two
/// segments do not describe even a motion of a tenth of a millimetre within the tolerance.
const LEAST_MOVE_S: f64 = 0.1;
/// A step may start this far from where the one before ends, m.
const JOIN_M: f64 = 1.1e-5;

/// One step of a task; the tool is at rest between steps.
#[derive(Debug, Clone)]
pub enum Step {
    /// Along a path.
    Move {
        /// The path.
        path: Path,
        /// Exact duration, shaping included; `None`: the fastest within the limits.
        duration_s: Option<f64>,
        /// Greatest speed, m/s; `None`: the robot's limit.
        speed_mps: Option<f64>,
    },
    /// Wait in place.
    Dwell {
        /// Duration, s.
        duration_s: f64,
    },
    /// Open or close the gripper, and wait until it has finished.
    Gripper {
        /// Whether to close it.
        closed: bool,
    },
}

/// An action at a time of a motion, besides moving.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Action {
    /// Open or close the gripper.
    Gripper {
        /// Whether to close it.
        closed: bool,
    },
}

#[derive(Debug, Clone)]
struct Leg {
    /// The step, from 0.
    step: usize,
    start_s: f64,
    /// `None`: it stays at the track's only point.
    path: Option<(Path, TimeLaw, Shaper)>,
    /// Position of the tool while it stays.
    at_m: Vector3<f64>,
    track: Track,
}

/// An action, and when it is due.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TimedAction {
    /// Path time, s.
    pub time_s: f64,
    /// The action.
    pub action: Action,
}

/// Progress of a motion.
pub(crate) struct StepProgress {
    /// The step, from 0.
    pub(crate) step: usize,
    /// Its start, path time, s.
    pub(crate) began_s: f64,
    /// Distance along its path, m.
    pub(crate) way_m: f64,
}

/// A motion in time.
#[derive(Debug, Clone)]
pub struct Timed {
    legs: Vec<Leg>,
    actions: Vec<TimedAction>,
    duration_s: f64,
    /// The step that is being added, from 0.
    step: usize,
    /// Points at which the statics were solved.
    places: usize,
    /// Impulses of the shapers over all milliseconds so far.
    impulses: f64,
    /// Attitude after the steps so far.
    attitude: Rotation3<f64>,
}

impl Timed {
    /// Gives each step its time and its states, from `start_m` (world, m) on.
    ///
    /// # Errors
    /// [`PlanError::TimeLaw`] and [`PlanError::Step`] if a step asks for too much,
    /// [`PlanError::NoEquilibrium`] if the robot cannot hang there, [`PlanError::Path`] if a step
    /// does not start where the one before ends; [`PlanError::Long`], [`PlanError::Large`] and
    /// [`PlanError::Reach`] if it exceeds the bounds of one plan.
    pub fn new(model: &Model, start_m: &Vector3<f64>, steps: &[Step]) -> Result<Self, PlanError> {
        Self::turned(model, start_m, Rotation3::identity(), steps)
    }

    /// As [`Timed::new`], from an attitude other than level (world_from_platform).
    ///
    /// # Errors
    /// As [`Timed::new`]; [`PlanError::Attitude`] if a step asks for an attitude that the robot cannot
    /// take.
    pub fn turned(
        model: &Model,
        start_m: &Vector3<f64>,
        attitude: Rotation3<f64>,
        steps: &[Step],
    ) -> Result<Self, PlanError> {
        let mut timed = Self {
            legs: Vec::new(),
            actions: Vec::new(),
            duration_s: 0.0,
            step: 0,
            places: 0,
            impulses: 0.0,
            attitude,
        };
        if model.options().planner == Planner::Level {
            model.hanging("a plan for a level platform (--planner level)")?;
        }
        // Cheap bounds first: an absurd file is refused before statics are solved.
        bounds::check(model, steps)?;
        let mut at_m = *start_m;
        for (number, step) in (1..).zip(steps) {
            timed.step = number - 1;
            match step {
                Step::Move {
                    path,
                    duration_s,
                    speed_mps,
                } => {
                    let gap_m = (path.point(0.0)?.position_m - at_m).norm();
                    if gap_m > JOIN_M {
                        return Err(PathError::Gap {
                            next: number,
                            gap_m,
                        }
                        .into());
                    }
                    at_m = path.point(path.length_m())?.position_m;
                    timed.travel(model, number, path, *duration_s, *speed_mps)?;
                }
                Step::Dwell { duration_s } => {
                    if !(duration_s.is_finite() && *duration_s >= 0.0) {
                        return Err(PlanError::Step {
                            what: format!("step {number}: a wait"),
                            asked: *duration_s,
                            limit: 0.0,
                            unit: "s",
                        });
                    }
                    timed.stay(model, &at_m, *duration_s)?;
                }
                Step::Gripper { closed } => {
                    timed.actions.push(TimedAction {
                        time_s: timed.duration_s,
                        action: Action::Gripper { closed: *closed },
                    });
                    // The tool stays until the jaws have finished.
                    let wait_s = model.robot().gripper.close_s.max(LEAST_GRIPPER_S);
                    timed.stay(model, &at_m, wait_s)?;
                }
            }
        }
        if timed.legs.is_empty() {
            return Err(PathError::Empty.into());
        }
        // Known only now: accelerations and shapers add to the lower bound of `bounds::check`.
        if timed.duration_s > LONGEST_S {
            return Err(PlanError::Long {
                duration_s: timed.duration_s,
            });
        }
        Ok(timed)
    }

    fn travel(
        &mut self,
        model: &Model,
        number: usize,
        path: &Path,
        duration_s: Option<f64>,
        speed_mps: Option<f64>,
    ) -> Result<(), PlanError> {
        let turn = self.turn(model, number, path)?;
        let track = Track::along(model, path, &turn, self.last_rest())?;
        self.attitude = turn.at(1.0);
        // The swing that remains is the one at the end of the way: its modes are shaped.
        let shaper = match track.nodes().last() {
            Some(end) => {
                let modes = model.geometry().stability(&end.equilibrium)?.modes_hz;
                Shaper::new(model.options().shaping, &modes)
            }
            None => Shaper::none(),
        };
        self.places += track.nodes().len();
        if self.places > MOST_PLACES {
            return Err(PlanError::Large {
                what: "places at which the statics are solved",
                asked: self.places as f64,
                limit: MOST_PLACES as f64,
            });
        }
        let mut bounds = tool_bounds(model, path, number, speed_mps)?;
        // A platform that turns much on a short way is limited by its turn.
        let spin = turn.angle_rad() * TURN_LEVER_M / path.length_m();
        if spin > 1.0 {
            bounds.speed_mps /= spin;
            bounds.acceleration_mps2 /= spin;
            bounds.jerk_mps3 /= spin;
        }
        for (cable, slope) in track.slopes().into_iter().enumerate() {
            if let Some(winch) = model.robot().winch_of(cable) {
                // A cable whose length does not change along the path sets no limit.
                let most_mps = winch.max_cable_speed_mps() * DRUM_SHARE / slope.max(1e-6);
                bounds.speed_mps = bounds.speed_mps.min(most_mps);
            }
        }
        let length_m = path.length_m();
        let law = match duration_s {
            Some(duration_s) => {
                TimeLaw::fit_duration(length_m, bounds, duration_s - shaper.delay_s())?
            }
            None => {
                TimeLaw::fastest(length_m, bounds)?.stretched_to(LEAST_MOVE_S - shaper.delay_s())
            }
        };
        let duration_s = law.duration_s() + shaper.delay_s();
        // Six modes shaped by ZVD have 729 impulses: each is evaluated at every millisecond.
        self.impulses += duration_s * 1e3 * shaper.impulses().len() as f64;
        if self.impulses > MOST_IMPULSES {
            return Err(PlanError::Large {
                what: "impulses of the shaper over all milliseconds of the motion (fewer with zv than with zvd)",
                asked: self.impulses,
                limit: MOST_IMPULSES,
            });
        }
        let at_m = path.point(length_m)?.position_m;
        let path = Some((path.clone(), law, shaper));
        self.push(path, at_m, track, duration_s);
        Ok(())
    }

    /// The turn that a path asks for.
    fn turn(&self, model: &Model, step: usize, path: &Path) -> Result<Turn, PlanError> {
        let Some(to) = path.attitude() else {
            return Ok(Turn::between(self.attitude, self.attitude));
        };
        model
            .takes_attitude(&to)
            .map_err(|why| PlanError::Attitude { step, why })?;
        Ok(Turn::between(self.attitude, to))
    }

    fn stay(
        &mut self,
        model: &Model,
        at_m: &Vector3<f64>,
        duration_s: f64,
    ) -> Result<(), PlanError> {
        // Shorter than a tick: no knot could lie at its end.
        if duration_s < 1e-3 {
            return Ok(());
        }
        let rest = match self.last_rest() {
            Some(rest) => rest.clone(),
            None if !model.holding().hangs() => model.rest_turned(at_m, &self.attitude)?,
            None => {
                let rest = model.rest(at_m, None)?;
                let held = model.holding().first_by_tension().unwrap_or(0);
                let tension_n = rest.tensions_n().get(held).copied().unwrap_or(0.0);
                model.rest_planned(at_m, tension_n, None)?
            }
        };
        let beside = model.beside().map(|_| model.tool_m(&rest));
        self.push(
            None,
            beside.unwrap_or(*at_m),
            Track::still(rest),
            duration_s,
        );
        Ok(())
    }

    /// Steps end on whole milliseconds, where a knot can lie.
    fn push(
        &mut self,
        path: Option<(Path, TimeLaw, Shaper)>,
        at_m: Vector3<f64>,
        track: Track,
        duration_s: f64,
    ) {
        let start_s = self.duration_s;
        // The 1e-6 ms keep rounding from turning a whole number of milliseconds into one more.
        self.duration_s = ((start_s + duration_s) * 1e3 - 1e-6).ceil() * 1e-3;
        self.legs.push(Leg {
            step: self.step,
            start_s,
            path,
            at_m,
            track,
        });
    }

    fn last_rest(&self) -> Option<&StaticState> {
        self.legs.last().and_then(|leg| leg.track.nodes().last())
    }

    /// The whole duration, s: a whole number of milliseconds.
    #[must_use]
    pub const fn duration_s(&self) -> f64 {
        self.duration_s
    }

    /// Times at which the tool is at rest between steps, s, both ends included.
    #[must_use]
    pub(crate) fn rests_s(&self) -> Vec<f64> {
        let starts = self.legs.iter().map(|leg| leg.start_s);
        starts.chain([self.duration_s]).collect()
    }

    /// The step in progress at a path time.
    #[must_use]
    pub(crate) fn progress(&self, time_s: f64) -> Option<StepProgress> {
        let (leg, way_m) = self.locate(time_s).ok()?;
        let length_m = leg.path.as_ref().map_or(0.0, |(path, ..)| path.length_m());
        Some(StepProgress {
            step: leg.step,
            began_s: leg.start_s,
            way_m: way_m.clamp(0.0, length_m),
        })
    }

    /// Greatest speed of the tool in a step (from 0), m/s, every 5 ms.
    #[must_use]
    pub(crate) fn top_speed_mps(&self, step: usize) -> f64 {
        let mut legs = self.legs.iter().skip_while(|leg| leg.step != step);
        let Some(leg) = legs.next() else {
            return 0.0;
        };
        let end_s = legs.next().map_or(self.duration_s, |next| next.start_s);
        let times = (0_u32..).map(|index| leg.start_s + f64::from(index) * 5e-3);
        let times = times.take_while(|time_s| *time_s < end_s);
        times
            .map(|time_s| self.speed_mps(time_s))
            .fold(0.0, f64::max)
    }

    /// The actions in order of time, s.
    #[must_use]
    pub fn actions(&self) -> &[TimedAction] {
        &self.actions
    }

    /// The step in progress at a time, and the distance along its path, m.
    fn locate(&self, time_s: f64) -> Result<(&Leg, f64), PlanError> {
        // Steps are in order of time: take the last that has begun.
        let begun = self.legs.partition_point(|leg| leg.start_s <= time_s);
        let leg = self
            .legs
            .get(begun.saturating_sub(1))
            .ok_or(PathError::Empty)?;
        let way_m = leg.path.as_ref().map_or(0.0, |(_, law, shaper)| {
            shaper.at(law, time_s - leg.start_s).0
        });
        Ok((leg, way_m))
    }

    /// Planned tool position at a time, world, m; clamped to the ends.
    ///
    /// # Errors
    /// [`PlanError::Path`]: never for a path that was built.
    pub fn tool_m(&self, time_s: f64) -> Result<Vector3<f64>, PlanError> {
        let (leg, way_m) = self.locate(time_s)?;
        match &leg.path {
            Some((path, ..)) => {
                let at_m = path.point(way_m.clamp(0.0, path.length_m()))?.position_m;
                leg.track.tool_m(way_m, at_m)
            }
            None => Ok(leg.at_m),
        }
    }

    /// Speed of the tool along its path at a time, m/s.
    #[must_use]
    pub fn speed_mps(&self, time_s: f64) -> f64 {
        self.locate(time_s).map_or(0.0, |(leg, _)| {
            leg.path.as_ref().map_or(0.0, |(_, law, shaper)| {
                shaper.at(law, time_s - leg.start_s).1
            })
        })
    }

    /// Paid-out lengths at a time, m.
    ///
    /// # Errors
    /// [`PlanError::Path`], [`PlanError::Spline`]: never for a finite time.
    pub fn lengths_m(&self, time_s: f64) -> Result<Vec<f64>, PlanError> {
        let (leg, way_m) = self.locate(time_s)?;
        leg.track.lengths_m(way_m)
    }

    /// How the robot hangs at a time.
    ///
    /// # Errors
    /// As [`Timed::lengths_m`].
    pub fn rest(&self, model: &Model, time_s: f64) -> Result<StaticState, PlanError> {
        let (leg, way_m) = self.locate(time_s)?;
        leg.track.rest(model, way_m, &self.tool_m(time_s)?)
    }
}

/// Limits of the tool along a path. On a curve the acceleration across the path counts too: both
/// parts get an equal share, so that their sum keeps the limit; the jerk of the curve, `v^3 / r^2`,
/// keeps its own limit.
fn tool_bounds(
    model: &Model,
    path: &Path,
    number: usize,
    speed_mps: Option<f64>,
) -> Result<Bounds, PlanError> {
    let limits = &model.robot().limits;
    let mut bounds = Bounds {
        speed_mps: limits.speed_mps,
        acceleration_mps2: limits.acceleration_mps2,
        jerk_mps3: limits.jerk_mps3,
    };
    if let Some(asked) = speed_mps {
        if !(asked > 0.0 && asked <= limits.speed_mps) {
            return Err(PlanError::Step {
                what: format!("step {number}: its speed (limits.speed_mps)"),
                asked,
                limit: limits.speed_mps,
                unit: "m/s",
            });
        }
        bounds.speed_mps = asked;
    }
    if let Some(radius_m) = path.least_radius_m() {
        bounds.acceleration_mps2 /= SQRT_2;
        let across = (bounds.acceleration_mps2 * radius_m).sqrt();
        let around = libm::cbrt(limits.jerk_mps3 * radius_m * radius_m);
        bounds.speed_mps = bounds.speed_mps.min(across).min(around);
    }
    Ok(bounds)
}
