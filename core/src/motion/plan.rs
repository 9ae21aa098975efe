//! From a path to the knots that a board follows, judged before anything moves.
//!
//! At every instant the platform is assumed to be in equilibrium. Where it hangs (three cables hold
//! lengths, the others tensions) the planner specifies the tool's position and obtains attitude, tensions
//! and lengths; where the lengths hold the whole pose, it specifies the attitude too and distributes the
//! tensions. The platform's inertia is left out: at these accelerations it shifts the equilibrium by
//! less than the plan's tolerance, and a planner that includes it can diverge.

use super::model::{Model, StaticState};
use super::path::PathError;
use super::resume::Resumed;
use super::spline::SplineError;
use super::time_law::TimeLawError;
use super::timed::{Step, Timed};
use super::verdict::{Extremes, Watch};
use super::{verdict, wire};
use crate::holding::HoldingError;
use mcdpr_protocol::Knot;
use miette::Diagnostic;
use nalgebra::{Rotation3, Vector3};
use thiserror::Error;

/// Knots are close enough together when no length between them is off by more than this, m.
/// A third of an encoder count of the paper's robot (0.03 mm).
pub(crate) const TOLERANCE_M: f64 = 1e-5;
/// Longest motion in one plan, s. Judging an hour takes about two seconds.
pub(super) const LONGEST_S: f64 = 3600.0;
/// Most steps of one task.
pub(super) const MOST_STEPS: usize = 10_000;
/// Longest path in one plan, m.
pub(super) const LONGEST_M: f64 = 500.0;
/// Most points at which one plan solves the statics; they take about 200 MB.
pub(super) const MOST_PLACES: usize = 200_000;
/// Most evaluations of the shaped law in one pass over a plan: impulses times milliseconds, some
/// seconds of work. Three modes shaped by ZVD have 27 impulses; six have 729.
/// With 27 impulses that is half an hour of motion.
pub(super) const MOST_IMPULSES: f64 = 5e7;

/// Why planning failed. Nothing has moved.
#[derive(Debug, Error, Diagnostic)]
pub enum PlanError {
    /// The robot's geometry is invalid.
    #[error("the robot's geometry is unusable")]
    #[diagnostic(code(mcdpr::plan::geometry), help("correct the robot file"))]
    Geometry(#[from] mcdpr_kinematics::Error),
    /// The cables that are held by length do not hold the robot.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Holding(#[from] HoldingError),
    /// What is made for a platform whose attitude gravity decides.
    #[error(
        "{what} needs a platform that hangs on three cables held by length and at least one by tension; {robot} is held otherwise"
    )]
    #[diagnostic(
        code(mcdpr::plan::hanging),
        help("choose another robot; docs/robot-file.md says what each kind of robot can do")
    )]
    Hanging {
        /// What was asked for.
        what: &'static str,
        /// The robot's name.
        robot: String,
    },
    /// What is made for a platform that hangs, or whose whole pose lengths hold.
    #[error(
        "{what} needs a platform that hangs on three cables held by length and at least one by tension, or one that six \
         lengths place and turn; {robot} is held otherwise"
    )]
    #[diagnostic(
        code(mcdpr::plan::placed),
        help("choose another robot; docs/robot-file.md says what each kind of robot can do")
    )]
    Placed {
        /// What was asked for.
        what: &'static str,
        /// The robot's name.
        robot: String,
    },
    /// What needs a platform at rest, of a load that turns freely.
    #[error(
        "{what} needs a platform that comes to rest; the load of {robot} hangs on one point, and nothing stops it turning"
    )]
    #[diagnostic(
        code(mcdpr::plan::turning),
        help(
            "measure its anchors from outside, with a tape or a tracker, and write them into the robot file \
             (docs/calibration.md); home it at a known place, with `mcdpr home --at X Y Z`"
        )
    )]
    Turning {
        /// What was asked for.
        what: &'static str,
        /// The robot's name.
        robot: String,
    },
    /// What goes to places beside the plane in which a robot moves.
    #[error(
        "{what} asks for places on either side of the plane of {robot}, and it moves in that plane only"
    )]
    #[diagnostic(
        code(mcdpr::plan::in_plane),
        help(
            "choose a robot that moves in space; in its plane this one goes to a known place with `mcdpr move X Y Z`, or \
             along a task with `mcdpr run` (docs/robot-file.md)"
        )
    )]
    InPlane {
        /// What was asked for.
        what: &'static str,
        /// The robot's name.
        robot: String,
    },
    /// An attitude that the robot cannot take.
    #[error("step {step} asks for an attitude, but {why}")]
    #[diagnostic(
        code(mcdpr::plan::attitude),
        help(
            "leave out attitude_deg and start_attitude_deg of the task (A, B and C of G-code), or choose a robot that has it"
        )
    )]
    Attitude {
        /// Which step, from 1.
        step: usize,
        /// Why not.
        why: &'static str,
    },
    /// A position beside the plane in which all cables lie.
    #[error(
        "the tool at ({x_mm:.1}, {y_mm:.1}, {z_mm:.1}) mm is {off_mm:.3} mm beside the plane of the cables, across which nothing pulls"
    )]
    #[diagnostic(
        code(mcdpr::plan::off_plane),
        help("give the task positions in the plane of the anchors")
    )]
    OffPlane {
        /// Tool, mm.
        x_mm: f64,
        /// Tool, mm.
        y_mm: f64,
        /// Tool, mm.
        z_mm: f64,
        /// Distance from the plane, mm.
        off_mm: f64,
    },
    /// More cables than a board drives.
    #[error(
        "the robot has {cables} cables, a board drives at most {}",
        mcdpr_protocol::MAX_CABLES
    )]
    #[diagnostic(
        code(mcdpr::plan::cables),
        help("leave out [[cable]] tables of the robot file")
    )]
    Cables {
        /// How many it has.
        cables: usize,
    },
    /// The tool may not accelerate or move as fast as a step asks.
    #[error("{what} asks for {asked:.4} {unit}, limit {limit:.4} {unit}")]
    #[diagnostic(
        code(mcdpr::plan::step),
        help("ask for less, or raise [limits] in the robot file if the machine can do it")
    )]
    Step {
        /// Which step and what of it.
        what: String,
        /// What it asks for.
        asked: f64,
        /// What is allowed.
        limit: f64,
        /// Unit of both.
        unit: &'static str,
    },
    /// The robot cannot hang there.
    #[error("the robot cannot hold its tool at ({x_mm:.1}, {y_mm:.1}, {z_mm:.1}) mm")]
    #[diagnostic(
        code(mcdpr::plan::no_equilibrium),
        help("choose a place further inside the frame or lower, or another tension set-point")
    )]
    NoEquilibrium {
        /// Tool, mm.
        x_mm: f64,
        /// Tool, mm.
        y_mm: f64,
        /// Tool, mm.
        z_mm: f64,
        /// Why.
        source: mcdpr_kinematics::Error,
    },
    /// The lengths do not belong to any pose.
    #[error("the cable lengths that the board reports fit no resting pose")]
    #[diagnostic(
        code(mcdpr::plan::lengths),
        help(
            "the lengths were lost or belong to another robot: switch the board off and on at the home pose"
        )
    )]
    Lengths {
        /// Why.
        source: mcdpr_kinematics::Error,
    },
    /// The path is invalid.
    #[error(transparent)]
    #[diagnostic(code(mcdpr::plan::path))]
    Path(#[from] PathError),
    /// The path cannot be followed in time.
    #[error(transparent)]
    #[diagnostic(
        code(mcdpr::plan::time),
        help("allow more time, or raise [limits] in the robot file if the machine can do it")
    )]
    TimeLaw(#[from] TimeLawError),
    /// The lengths cannot be fitted by knots.
    #[error(transparent)]
    #[diagnostic(code(mcdpr::plan::knots))]
    Spline(#[from] SplineError),
    /// A motion that would take too much memory.
    #[error("the motion would take {duration_s:.0} s, more than the {LONGEST_S:.0} s of one plan")]
    #[diagnostic(
        code(mcdpr::plan::long),
        help("cut the task into several, or allow more speed")
    )]
    Long {
        /// How long it would take, s.
        duration_s: f64,
    },
    /// A task that would take too much memory.
    #[error("{what}: {asked:.0}, more than the {limit:.0} of one plan")]
    #[diagnostic(code(mcdpr::plan::large), help("cut the task into several"))]
    Large {
        /// Which quantity is too large.
        what: &'static str,
        /// How much.
        asked: f64,
        /// The limit of one plan.
        limit: f64,
    },
    /// A position that a cable of this length does not reach.
    #[error(
        "step {step} goes to ({x_mm:.1}, {y_mm:.1}, {z_mm:.1}) mm, {distance_mm:.0} mm from the anchor of cable {cable}, which reaches {reach_mm:.0} mm at most"
    )]
    #[diagnostic(
        code(mcdpr::plan::reach),
        help(
            "choose a place nearer to the frame, or correct turns_max and drum_radius_mm of that [[winch]]"
        )
    )]
    Reach {
        /// Which step, from 1.
        step: usize,
        /// Tool, mm.
        x_mm: f64,
        /// Tool, mm.
        y_mm: f64,
        /// Tool, mm.
        z_mm: f64,
        /// Which cable, from 1.
        cable: usize,
        /// Distance of the tool from its anchor, mm.
        distance_mm: f64,
        /// Limit from drum, platform and stretch, mm.
        reach_mm: f64,
    },
    /// A limit would be broken.
    #[error(
        "at {time_s:.2} s, tool at ({x_mm:.1}, {y_mm:.1}, {z_mm:.1}) mm, {what} would be {value:.3} {unit}, limit {limit:.3} {unit}"
    )]
    #[diagnostic(
        code(mcdpr::plan::limit),
        help("change the task, or the limit in the robot file if the machine allows it")
    )]
    Limit {
        /// Time along the motion, s.
        time_s: f64,
        /// Tool, mm.
        x_mm: f64,
        /// Tool, mm.
        y_mm: f64,
        /// Tool, mm.
        z_mm: f64,
        /// The limited quantity, with the cable if there is one.
        what: String,
        /// Its value.
        value: f64,
        /// The limit.
        limit: f64,
        /// Unit of both.
        unit: &'static str,
    },
}

/// A motion that a board can follow, and the states expected along it.
#[derive(Debug, Clone)]
pub struct Plan {
    /// The motion of the tool.
    pub timed: Timed,
    /// The knots for the board.
    pub knots: Vec<Knot>,
    /// How the robot hangs at the start.
    pub start: StaticState,
    /// The interrupted motion that this plan continues, if it does.
    pub resumed: Option<Resumed>,
    model: Model,
}

impl Plan {
    /// Plans a motion of the tool from `start_m` (world, m), where the first step must start, and
    /// judges it.
    ///
    /// # Errors
    /// The first limit that it would break, or why it cannot be followed at all.
    pub fn new(model: &Model, start_m: &Vector3<f64>, steps: &[Step]) -> Result<Self, PlanError> {
        Self::unjudged(model, start_m, steps)?.judged()
    }

    /// As [`Plan::new`], from an attitude other than level (world_from_platform). A robot whose attitude
    /// gravity decides ignores it.
    ///
    /// # Errors
    /// As [`Plan::new`].
    pub fn turned(
        model: &Model,
        start_m: &Vector3<f64>,
        attitude: Rotation3<f64>,
        steps: &[Step],
    ) -> Result<Self, PlanError> {
        Self::unjudged_turned(model, start_m, attitude, steps)?.judged()
    }

    /// Plans without checking limits, to examine a plan that breaks one.
    ///
    /// # Errors
    /// Why it cannot be followed at all.
    pub fn unjudged(
        model: &Model,
        start_m: &Vector3<f64>,
        steps: &[Step],
    ) -> Result<Self, PlanError> {
        Self::of(model, Timed::new(model, start_m, steps)?)
    }

    /// As [`Plan::unjudged`], from an attitude other than level (world_from_platform).
    ///
    /// # Errors
    /// As [`Plan::unjudged`].
    pub(crate) fn unjudged_turned(
        model: &Model,
        start_m: &Vector3<f64>,
        attitude: Rotation3<f64>,
        steps: &[Step],
    ) -> Result<Self, PlanError> {
        Self::of(model, Timed::turned(model, start_m, attitude, steps)?)
    }

    fn of(model: &Model, timed: Timed) -> Result<Self, PlanError> {
        let start = timed.rest(model, 0.0)?;
        Ok(Self {
            timed,
            knots: Vec::new(),
            start,
            resumed: None,
            model: model.clone(),
        })
    }

    /// The same plan, if it breaks no limit, with its knots.
    ///
    /// # Errors
    /// The first limit that it would break.
    pub fn judged(mut self) -> Result<Self, PlanError> {
        // Before the knots are fitted: a refused plan costs no fitting.
        verdict::judge(&self.model, &self.timed)?;
        self.knots = wire::knots(&self.model, &self.timed)?;
        Ok(self)
    }

    /// The same plan, if it also keeps the watched limits.
    ///
    /// # Errors
    /// The first limit that it would break.
    pub fn watched(self, watch: &Watch) -> Result<Self, PlanError> {
        verdict::judge_watched(&self.model, &self.timed, watch)?;
        Ok(self)
    }

    /// How close it comes to every limit; the first broken one is in the answer.
    ///
    /// # Errors
    /// None for a plan that was made.
    pub fn extremes(&self, watch: &Watch) -> Result<Extremes, PlanError> {
        verdict::extremes(&self.model, &self.timed, watch)
    }

    /// The model that it was made with.
    #[must_use]
    pub const fn model(&self) -> &Model {
        &self.model
    }

    /// The expected state at a time; at the ends before and after. `None` only for a time that is
    /// not a number.
    #[must_use]
    pub fn state(&self, time_s: f64) -> Option<StaticState> {
        self.timed.rest(&self.model, time_s).ok()
    }

    /// Expected states at equal times, both ends included.
    pub fn states(&self, step_s: f64) -> impl Iterator<Item = (f64, StaticState)> + '_ {
        let end_s = self.timed.duration_s();
        let times = (0_u32..).map(move |index| f64::from(index) * step_s);
        let times = times.take_while(move |time_s| *time_s < end_s);
        times
            .chain([end_s])
            .filter_map(|time_s| Some((time_s, self.state(time_s)?)))
    }
}
