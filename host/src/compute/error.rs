//! Why a computation was refused.

use crate::units::UnitError;
use mcdpr_kinematics::Error;
use miette::Diagnostic;

/// Reference to further documentation.
const MORE: &str =
    "`mcdpr ik --help` and its like show the arguments, docs/compute.md explains them";

/// Why a computation failed. Cables are counted from 1.
#[derive(Debug, thiserror::Error, Diagnostic)]
pub enum ComputeError {
    /// The solver refused.
    #[error(transparent)]
    #[diagnostic(code(mcdpr::compute), help("{MORE}"))]
    Kinematics(#[from] Error),
    /// The robot's cables hold it in one plane only.
    #[error(
        "this robot is planar: all anchors and attachments lie in one vertical plane, so its cables \
         fix neither its place across that plane nor its attitude, and of the four computations only \
         `mcdpr ik` has an answer ({refusal})"
    )]
    #[diagnostic(code(mcdpr::compute), help("{MORE}"))]
    Planar {
        /// The solver's error.
        refusal: Error,
    },
    /// A text is not a number with a unit.
    #[error("{what}: {wrong}")]
    #[diagnostic(code(mcdpr::compute), help("{MORE}"))]
    Quantity {
        /// The argument.
        what: &'static str,
        /// What is wrong with it.
        wrong: UnitError,
    },
    /// A list has the wrong number of entries.
    #[error("{what}: {got} given, {expected} needed")]
    #[diagnostic(code(mcdpr::compute), help("{MORE}"))]
    Count {
        /// The list, and what it must hold.
        what: &'static str,
        /// Number needed.
        expected: String,
        /// Number given.
        got: usize,
    },
    /// A `CABLE=FORCE` is invalid.
    #[error("--tension {text}: write CABLE=FORCE, such as 4=10 or 4=10N")]
    #[diagnostic(code(mcdpr::compute), help("{MORE}"))]
    Tension {
        /// The text.
        text: String,
    },
    /// There is no such cable.
    #[error("cable {cable}: there is no such cable; this robot has cables 1 to {count}")]
    #[diagnostic(code(mcdpr::compute), help("{MORE}"))]
    NoSuchCable {
        /// The number given.
        cable: String,
        /// Number of cables.
        count: usize,
    },
    /// One cable has two tensions.
    #[error("cable {cable}: its tension is given twice; give it once")]
    #[diagnostic(code(mcdpr::compute), help("{MORE}"))]
    Twice {
        /// Cable number.
        cable: usize,
    },
    /// A cable's length and tension are both held.
    #[error(
        "cable {cable}: both its length and its tension are given; a winch holds one of them: leave \
         the length out (null) or do not name its tension"
    )]
    #[diagnostic(code(mcdpr::compute), help("{MORE}"))]
    BothHeld {
        /// Cable number.
        cable: usize,
    },
    /// Neither a length nor a tension is given.
    #[error("cable {cable}: neither its length nor its tension is given; give one of them")]
    #[diagnostic(code(mcdpr::compute), help("{MORE}"))]
    NeitherHeld {
        /// Cable number.
        cable: usize,
    },
    /// The statics need three length-held cables, or six and more.
    #[error(
        "{held} of {count} cables are length-held: the attitude follows from the statics only with \
         exactly three (name {named} with --tension CABLE=FORCE or \"tensions_n\"), and can be \
         chosen only with six or more"
    )]
    #[diagnostic(code(mcdpr::compute), help("{MORE}"))]
    LengthHeld {
        /// Number of length-held cables.
        held: usize,
        /// Number of cables.
        count: usize,
        /// How many tension-held cables to name.
        named: String,
    },
    /// An attitude was given although it follows from statics.
    #[error(
        "an attitude was given, but with three length-held cables it follows from the statics; leave \
         it out"
    )]
    #[diagnostic(code(mcdpr::compute), help("{MORE}"))]
    AttitudeFollows,
    /// Six degrees of freedom need six cables.
    #[error(
        "{count} cables do not fix all six degrees of freedom: six are needed; give the attitude, or \
         use --free yaw (four cables and more) or --static"
    )]
    #[diagnostic(code(mcdpr::compute), help("{MORE}"))]
    TooFewForAll {
        /// Number of cables.
        count: usize,
    },
    /// A slice is not of the form AXIS=LENGTH.
    #[error("--slice {text}: write an axis and a place on it, such as z=-100 or x=0.3m")]
    #[diagnostic(code(mcdpr::compute), help("{MORE}"))]
    Slice {
        /// The text.
        text: String,
    },
    /// The grid is invalid.
    #[error(
        "--step: a step of {step_mm} mm gives {points:.3e} points; choose one that gives at least \
         1 and at most {most:.0e}"
    )]
    #[diagnostic(code(mcdpr::compute), help("{MORE}"))]
    Grid {
        /// The step.
        step_mm: f64,
        /// Number of points that it would give.
        points: f64,
        /// Most points.
        most: f64,
    },
    /// A size is negative.
    #[error("{what} must not be negative, got {value_mm} mm")]
    #[diagnostic(code(mcdpr::compute), help("{MORE}"))]
    Negative {
        /// The argument.
        what: &'static str,
        /// Its value.
        value_mm: f64,
    },
}
