//! Errors of the plant.

use thiserror::Error;

/// Why the plant could not be built, placed, commanded or advanced. Cables are named 1-based.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum PlantError {
    /// The robot has no cable, or more than the plant can hold.
    #[error("the robot has {count} cables; give 1 to {max}", max = super::MAX_CABLES)]
    CableCount {
        /// Number of cables found.
        count: usize,
    },
    /// The lists of cables and winches differ in length.
    #[error("{cables} cables but {winches} winches; each cable needs exactly one winch")]
    WinchCount {
        /// Number of cables found.
        cables: usize,
        /// Number of winches found.
        winches: usize,
    },
    /// A list handed over does not have one entry per cable.
    #[error("{what} has {given} entries for {expected} cables; give one per cable")]
    Length {
        /// The list in question.
        what: &'static str,
        /// Entries found.
        given: usize,
        /// Entries needed.
        expected: usize,
    },
    /// A parameter of a cable or its winch is out of range.
    #[error("cable {}: {name} is {value}; it must be {rule}", cable + 1)]
    CableParameter {
        /// Index of the cable, from 0 (printed from 1).
        cable: usize,
        /// The parameter's name, with its unit.
        name: &'static str,
        /// The value found.
        value: f64,
        /// What is allowed.
        rule: &'static str,
    },
    /// A parameter of the platform, the bus or the integrator is out of range.
    #[error("{name} is {value}; it must be {rule}")]
    Parameter {
        /// The parameter's name, with its unit.
        name: &'static str,
        /// The value found.
        value: f64,
        /// What is allowed.
        rule: &'static str,
    },
    /// A cable index beyond the robot's cables.
    #[error("there is no cable {} on a robot of {count}; use 1 to {count}", cable + 1)]
    NoSuchCable {
        /// Index asked for, from 0 (printed from 1).
        cable: usize,
        /// Number of cables of the robot.
        count: usize,
    },
    /// An attachment point lies on the swivel axis or inside the pulley: there is no cable path.
    #[error(
        "cable {}: the attachment lies on the swivel axis or inside the pulley; keep the platform clear of the pulley",
        cable + 1
    )]
    InsidePulley {
        /// Index of the cable, from 0 (printed from 1).
        cable: usize,
    },
    /// The drum has wound in all of the cable.
    #[error("cable {}: wound in completely; pay out before going on", cable + 1)]
    Exhausted {
        /// Index of the cable, from 0 (printed from 1).
        cable: usize,
    },
    /// No resting pose was reached from the given start.
    #[error(
        "no equilibrium found: the force left after {simulated_s} s is {residual_n} N; start nearer to a pose that the cables can hold"
    )]
    NoEquilibrium {
        /// Simulated time spent searching.
        simulated_s: f64,
        /// Largest remaining force (or moment over 0.1 m).
        residual_n: f64,
    },
    /// The state is no longer finite: the step is too long for the stiffness, or a force is huge.
    #[error("the simulation diverged at {time_s} s; use a shorter step_s or softer cables")]
    Diverged {
        /// Simulated time of the first bad state.
        time_s: f64,
    },
    /// The board in front of the plant cannot continue: the firmware misused an emulated chip, or
    /// this board does not support the robot.
    #[error("the board stopped: {reason}")]
    Board {
        /// Why, with a remedy if there is one.
        reason: String,
    },
}
