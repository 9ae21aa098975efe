//! From a path to the knots that a board follows, judged before anything moves.
//!
//! At every instant the platform is taken to hang in equilibrium (three cables hold lengths, the
//! others tensions): the planner asks for the tool's place and gets attitude, tensions and
//! lengths. The platform's inertia is left out: at these accelerations it shifts the equilibrium
//! by less than the plan's tolerance, and a planner with it can diverge.

use super::knots::{self, FitOptions, Spacing};
use super::model::{Model, Rest};
use super::path::{Path, PathError};
use super::spline::{Ends, Spline, SplineError};
use super::time_law::{Bounds, TimeLaw, TimeLawError};
use mcdpr_protocol::{
    CableKnot, Coefficient, Knot, List, Micrometres, MicrometresPerSecond, Millinewtons, PerCable,
    ResidualRow, TenthMicrometres,
};
use miette::Diagnostic;
use nalgebra::Vector3;
use thiserror::Error;

/// Knots are close enough together when no length between them is off by more than this, m.
pub const TOLERANCE_M: f64 = 1e-5;
/// Longest motion in one plan, s: a state is kept for every millisecond.
const LONGEST_S: f64 = 300.0;
/// Knots closer than this would only fill the board's buffer, ms.
const LEAST_SPACING_MS: usize = 8;
/// States are checked against the limits this often, s.
const CHECK_STEP_S: f64 = 0.01;
/// A cable that slips shows as a closure error; this much is no slip, m. Swing, friction and a
/// machine that is not quite as described stay below it.
const CLOSURE_LIMIT_M: f64 = 0.004;

/// Why there is no plan. Nothing has moved.
#[derive(Debug, Error, Diagnostic)]
pub enum PlanError {
    /// The robot's geometry makes no sense.
    #[error("the robot's geometry is unusable")]
    #[diagnostic(code(mcdpr::plan::geometry), help("correct the robot file"))]
    Geometry(#[from] mcdpr_kinematics::Error),
    /// The planner works for three length-held cables.
    #[error(
        "{held} cables are held by length: this planner needs exactly three, the rest by tension"
    )]
    #[diagnostic(
        code(mcdpr::plan::holding),
        help("set control = \"tension\" for the cables of the robot file that keep it taut")
    )]
    Holding {
        /// Cables that are.
        held: usize,
    },
    /// The robot can not hang there.
    #[error("the robot can not hold its tool at ({x_mm:.1}, {y_mm:.1}, {z_mm:.1}) mm")]
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
    /// The lengths fit no pose.
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
    /// The path is none.
    #[error(transparent)]
    #[diagnostic(code(mcdpr::plan::path))]
    Path(#[from] PathError),
    /// The path can not be followed in time.
    #[error(transparent)]
    #[diagnostic(
        code(mcdpr::plan::time),
        help("allow more time, or raise [limits] in the robot file if the machine can do it")
    )]
    TimeLaw(#[from] TimeLawError),
    /// The lengths can not be put into knots.
    #[error(transparent)]
    #[diagnostic(code(mcdpr::plan::knots))]
    Spline(#[from] SplineError),
    /// A motion that would fill the memory.
    #[error("the motion would take {duration_s:.0} s, more than the {LONGEST_S:.0} s of one plan")]
    #[diagnostic(
        code(mcdpr::plan::long),
        help("cut the task into several, or allow more speed")
    )]
    Long {
        /// How long it would take, s.
        duration_s: f64,
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
        /// What, with the cable where there is one.
        what: String,
        /// How much it would be.
        value: f64,
        /// The limit.
        limit: f64,
        /// Unit of both.
        unit: &'static str,
    },
}

/// A piece of a motion, from rest to rest.
#[derive(Debug, Clone)]
pub struct Leg {
    /// Where.
    pub path: Path,
    /// Exact duration; the fastest within the limits where none is given.
    pub duration_s: Option<f64>,
}

/// A motion: legs with their time laws.
#[derive(Debug, Clone)]
pub struct Timed {
    legs: Vec<(f64, Path, TimeLaw)>,
    duration_s: f64,
}

/// A motion that a board can follow, and what is expected on the way.
#[derive(Debug, Clone)]
pub struct Plan {
    /// The motion of the tool.
    pub timed: Timed,
    /// What goes to the board.
    pub knots: Vec<Knot>,
    /// How the robot hangs at the start.
    pub start: Rest,
    /// Expected states every [`Plan::STEP_S`].
    pub states: Vec<Rest>,
}

impl Timed {
    /// Gives each leg its time law.
    ///
    /// # Errors
    /// [`PlanError::TimeLaw`].
    pub fn new(legs: Vec<Leg>, bounds: Bounds) -> Result<Self, PlanError> {
        let mut timed = Self {
            legs: Vec::new(),
            duration_s: 0.0,
        };
        for leg in legs {
            let length_m = leg.path.length_m();
            let law = match leg.duration_s {
                Some(duration_s) => TimeLaw::fit_duration(length_m, bounds, duration_s)?,
                None => TimeLaw::fastest(length_m, bounds)?,
            };
            let start_s = timed.duration_s;
            // Legs end on whole milliseconds, where a knot can be.
            timed.duration_s = ((start_s + law.duration_s()) * 1e3).ceil() * 1e-3;
            timed.legs.push((start_s, leg.path, law));
        }
        if timed.duration_s > LONGEST_S {
            return Err(PlanError::Long {
                duration_s: timed.duration_s,
            });
        }
        Ok(timed)
    }

    /// The whole duration, s: a whole number of milliseconds.
    #[must_use]
    pub const fn duration_s(&self) -> f64 {
        self.duration_s
    }

    /// Times at which the tool is at rest between legs, s, both ends included.
    #[must_use]
    pub fn rests_s(&self) -> Vec<f64> {
        let starts = self.legs.iter().map(|(start, ..)| *start);
        starts.chain([self.duration_s]).collect()
    }

    /// Where the tool shall be at a time, world, m; at the ends before and after.
    ///
    /// # Errors
    /// [`PlanError::Path`]: not for a path that was built.
    pub fn tool_m(&self, time_s: f64) -> Result<Vector3<f64>, PlanError> {
        let later = self.legs.iter().rposition(|(start, ..)| *start <= time_s);
        let Some((start, path, law)) = self.legs.get(later.unwrap_or(0)) else {
            return Err(PathError::Empty.into());
        };
        let along = law
            .at((time_s - start).clamp(0.0, law.duration_s()))
            .position_m;
        Ok(path.point(along.clamp(0.0, path.length_m()))?.position_m)
    }
}

impl Plan {
    /// Time between the states that a plan keeps, s.
    pub const STEP_S: f64 = 0.001;

    /// Plans a motion of the tool and judges it.
    ///
    /// # Errors
    /// The first limit that it would break, or why it can not be followed at all.
    pub fn new(model: &Model, legs: Vec<Leg>) -> Result<Self, PlanError> {
        let limits = &model.robot().limits;
        let bounds = Bounds {
            speed_mps: limits.speed_mps,
            acceleration_mps2: limits.acceleration_mps2,
            jerk_mps3: limits.jerk_mps3,
        };
        let timed = Timed::new(legs, bounds)?;
        let states = states(model, &timed)?;
        judge(model, &timed, &states)?;
        let knots = wire_knots(model, &timed, &states)?;
        let start = states.first().cloned().ok_or(PathError::Empty)?;
        Ok(Self {
            timed,
            knots,
            start,
            states,
        })
    }

    /// The expected state at a time, the nearest that is kept.
    #[must_use]
    pub fn state(&self, time_s: f64) -> Option<&Rest> {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "saturates"
        )]
        let index = (time_s / Self::STEP_S).round() as usize;
        self.states.get(index).or(self.states.last())
    }
}

/// Expected states, millisecond by millisecond.
fn states(model: &Model, timed: &Timed) -> Result<Vec<Rest>, PlanError> {
    let mut states: Vec<Rest> = Vec::new();
    for index in 0.. {
        let time_s = f64::from(index) * Plan::STEP_S;
        if time_s > timed.duration_s() + 0.5 * Plan::STEP_S {
            break;
        }
        let rest = model.rest(&timed.tool_m(time_s)?, states.last())?;
        states.push(rest);
    }
    Ok(states)
}

/// The first limit that the motion would break.
fn judge(model: &Model, timed: &Timed, states: &[Rest]) -> Result<(), PlanError> {
    let mut before: Option<(f64, &Rest)> = None;
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a small count"
    )]
    let every = (CHECK_STEP_S / Plan::STEP_S).round() as usize;
    for (index, rest) in states.iter().enumerate() {
        if index % every != 0 && index + 1 != states.len() {
            continue;
        }
        #[expect(
            clippy::cast_precision_loss,
            reason = "far fewer than 2^52 milliseconds"
        )]
        let time_s = index as f64 * Plan::STEP_S;
        let tool_m = timed.tool_m(time_s)?;
        let broken = judge_state(model, &tool_m, rest)
            .or_else(|| before.and_then(|(at, old)| judge_speed(model, old, rest, time_s - at)));
        if let Some((what, value, limit, unit)) = broken {
            return Err(PlanError::Limit {
                time_s,
                x_mm: tool_m.x * 1e3,
                y_mm: tool_m.y * 1e3,
                z_mm: tool_m.z * 1e3,
                what,
                value,
                limit,
                unit,
            });
        }
        before = Some((time_s, rest));
    }
    Ok(())
}

type Broken = (String, f64, f64, &'static str);

fn judge_state(model: &Model, tool_m: &Vector3<f64>, rest: &Rest) -> Option<Broken> {
    let robot = model.robot();
    let limits = &robot.limits;
    if let Some([low, high]) = &limits.box_in_world_m {
        for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
            let (value, low, high) = (tool_m[axis], low[axis], high[axis]);
            if value < low || value > high {
                let limit = if value < low { low } else { high };
                let what = format!("the tool's {name} (limits.box_mm)");
                return Some((what, value * 1e3, limit * 1e3, "mm"));
            }
        }
    }
    let tilt = rest.equilibrium.pose.tilt_rad();
    if tilt > limits.tilt_max_rad {
        let degrees = (tilt.to_degrees(), limits.tilt_max_rad.to_degrees());
        return Some((
            "the platform's tilt".to_owned(),
            degrees.0,
            degrees.1,
            "deg",
        ));
    }
    if !rest.equilibrium.stable {
        return Some((
            "the stability of the platform (1 stable)".to_owned(),
            0.0,
            1.0,
            "",
        ));
    }
    let cables = rest.tensions_n().iter().zip(&rest.paid_out_m);
    for (index, (&tension, &paid_out)) in cables.enumerate() {
        let Some(winch) = robot.winch_of(index) else {
            continue;
        };
        let number = index + 1;
        let most = limits.tension_max_n.min(winch.tension_max_n);
        if tension > most || tension < limits.tension_min_n {
            let limit = if tension > most {
                most
            } else {
                limits.tension_min_n
            };
            return Some((
                format!("the tension of cable {number}"),
                tension,
                limit,
                "N",
            ));
        }
        let most = winch.turns_max * std::f64::consts::TAU * winch.drum_radius_m;
        if paid_out > most {
            let what = format!("the length of cable {number} on its drum (turns_max)");
            return Some((what, paid_out * 1e3, most * 1e3, "mm"));
        }
    }
    None
}

fn judge_speed(model: &Model, old: &Rest, rest: &Rest, step_s: f64) -> Option<Broken> {
    let pairs = old.paid_out_m.iter().zip(&rest.paid_out_m);
    for (index, (before, after)) in pairs.enumerate() {
        let winch = model.robot().winch_of(index)?;
        let speed = (after - before).abs() / step_s;
        let most = winch.max_cable_speed_mps();
        if speed > most {
            let number = index + 1;
            let rpm = speed / most * winch.max_motor_rpm;
            let what = format!("the speed of cable {number} ({rpm:.0} motor rpm)");
            return Some((what, speed * 1e3, most * 1e3, "mm/s"));
        }
    }
    None
}

/// Knots of the whole motion: clamped cubic splines from rest to rest (Eq. 53), as many knots as
/// the tolerance needs, rounded to the wire's units.
fn wire_knots(model: &Model, timed: &Timed, states: &[Rest]) -> Result<Vec<Knot>, PlanError> {
    let mut knots: Vec<Knot> = Vec::new();
    let rests: Vec<_> = timed
        .rests_s()
        .iter()
        .map(|&time_s| milliseconds(time_s))
        .collect();
    for pair in rests.windows(2) {
        let &[from, to] = pair else { continue };
        let splines = fit(model, timed, states, (from, to))?;
        let count = splines.first().map_or(0, |spline| spline.knots().len());
        // A leg's first knot is the last one of the leg before.
        for index in usize::from(!knots.is_empty())..count {
            let at_s = splines
                .first()
                .and_then(|s| s.knots().get(index))
                .map_or(0.0, |k| k.time_s);
            let state = states.get(milliseconds(at_s)).or(states.last());
            let Some(state) = state else { continue };
            let cables = splines
                .iter()
                .zip(state.tensions_n())
                .map(|(spline, &tension)| {
                    let knot = spline.knots().get(index);
                    CableKnot {
                        length: TenthMicrometres(rounded(knot.map_or(0.0, |k| k.value) * 1e7)),
                        velocity: MicrometresPerSecond(rounded(
                            knot.map_or(0.0, |k| k.velocity) * 1e6,
                        )),
                        tension: Millinewtons(rounded(tension * 1e3)),
                    }
                });
            knots.push(Knot {
                index: u16::try_from(knots.len()).map_err(|_| SplineError::Count {
                    least: 0,
                    times: knots.len(),
                    values: usize::from(u16::MAX),
                })?,
                time_ms: u32::try_from(milliseconds(at_s)).unwrap_or(u32::MAX),
                last: false,
                cables: PerCable::collect(cables),
                rows: List::collect(closure_row(model, state)),
            });
        }
    }
    if let Some(last) = knots.last_mut() {
        last.last = true;
    }
    Ok(knots)
}

/// Splines of all cables over one leg, with common knots at whole milliseconds.
fn fit(
    model: &Model,
    timed: &Timed,
    states: &[Rest],
    (from, to): (usize, usize),
) -> Result<Vec<Spline>, PlanError> {
    let seconds = |time: usize| time as f64 * Plan::STEP_S;
    let options = FitOptions {
        ends: Ends::Clamped {
            start: 0.0,
            end: 0.0,
        },
        spacing: Spacing::Ticks,
        tolerance: TOLERANCE_M,
        most_segments: (to - from) / LEAST_SPACING_MS,
    };
    let cables = model.robot().cables.len();
    let fit = knots::fit(
        cables,
        (seconds(from), seconds(to)),
        options,
        |time_s, values| {
            let near = states.get(milliseconds(time_s));
            let rest = model.rest(&timed.tool_m(time_s)?, near)?;
            values.copy_from_slice(&rest.paid_out_m);
            Ok::<(), PlanError>(())
        },
    )?;
    Ok(fit.splines)
}

/// How measured lengths and tensions must fit together here: at equilibrium the length of the
/// tension-held cable follows from the other lengths and its tension.
fn closure_row(model: &Model, rest: &Rest) -> Option<ResidualRow> {
    let held = model.tension_held()?;
    let response = model.geometry().linearise(&rest.equilibrium).ok()?.response;
    let row = response.row(held)?;
    let mut lengths = PerCable::new();
    let mut tensions = PerCable::new();
    for (cable, &by_input) in row.iter().enumerate() {
        let (length, tension) = if cable == held {
            // m/N is 1000 µm/mN.
            (1.0, -by_input * 1e3)
        } else {
            (-by_input, 0.0)
        };
        let scaled = |value: f64, scale: i32| {
            i16::try_from(rounded(value * f64::from(scale)))
                .ok()
                .map(Coefficient)
        };
        lengths
            .push(scaled(length, ResidualRow::LENGTH_SCALE)?)
            .ok()?;
        tensions
            .push(scaled(tension, ResidualRow::TENSION_SCALE)?)
            .ok()?;
    }
    Some(ResidualRow {
        lengths,
        tensions,
        limit: Micrometres(rounded(CLOSURE_LIMIT_M * 1e6)),
    })
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "saturates"
)]
fn milliseconds(time_s: f64) -> usize {
    (time_s * 1e3).round() as usize
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "saturates beyond any robot"
)]
fn rounded(value: f64) -> i32 {
    value.round() as i32
}
