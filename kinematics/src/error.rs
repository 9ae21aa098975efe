//! Errors of the crate. Cables are counted from 1 in every message.

use core::fmt;

/// The solver, for messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Solver {
    /// Position for a given attitude.
    Position,
    /// Position and yaw for a given roll and pitch.
    PositionYaw,
    /// All six degrees of freedom from lengths.
    Pose,
    /// Resting pose from held lengths and tensions.
    GeometricoStatic,
    /// Attitude, lengths and tensions at equilibrium for a given point.
    Equilibrium,
    /// Linearisation at an equilibrium.
    Linearisation,
    /// Stiffness and natural modes.
    Stability,
    /// Tension distribution.
    TensionDistribution,
    /// Sagging cable.
    Catenary,
}

impl fmt::Display for Solver {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Solver::Position => "position forward solver",
            Solver::PositionYaw => "position-and-yaw forward solver",
            Solver::Pose => "six-degree forward solver",
            Solver::GeometricoStatic => "geometrico-static solver",
            Solver::Equilibrium => "equilibrium solver",
            Solver::Linearisation => "linearisation",
            Solver::Stability => "stability analysis",
            Solver::TensionDistribution => "tension distribution",
            Solver::Catenary => "catenary solver",
        })
    }
}

/// The side of a tension interval that stopped a solution.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bound {
    /// The lower tension limit.
    Minimum,
    /// The upper tension limit.
    Maximum,
}

impl fmt::Display for Bound {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Bound::Minimum => "minimum",
            Bound::Maximum => "maximum",
        })
    }
}

/// All errors of this crate. Cable numbers are 1-based.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Error {
    /// A list does not have one entry per cable, or a robot has no cables or too many.
    CableCount {
        /// Number of cables needed.
        expected: usize,
        /// Number given.
        got: usize,
    },
    /// A geometric value of one cable is invalid.
    InvalidCable {
        /// Cable number, from 1.
        cable: usize,
        /// The value and what it must be.
        what: &'static str,
        /// The value given.
        value: f64,
    },
    /// A value of the platform is invalid.
    InvalidPlatform {
        /// The value and what it must be.
        what: &'static str,
        /// The value given.
        value: f64,
    },
    /// An argument is invalid (not finite, wrong sign).
    InvalidInput {
        /// The argument and what it must be.
        what: &'static str,
        /// The cable concerned, from 1, if there is one.
        cable: Option<usize>,
        /// The value given.
        value: f64,
    },
    /// The attachment lies inside the rim of the pulley: no taut path exists.
    InsidePulley {
        /// Cable number, from 1.
        cable: usize,
        /// Distance of the attachment from the pulley's centre.
        distance_m: f64,
        /// The pulley's radius.
        radius_m: f64,
    },
    /// The attachment lies on the swivel axis (or on the anchor): the swivel angle is undefined.
    OnSwivelAxis {
        /// Cable number, from 1.
        cable: usize,
    },
    /// The problem has more unknowns than the robot has cables.
    TooFewCables {
        /// The solver.
        solver: Solver,
        /// Number of cables (of the kind named by the solver's documentation) needed.
        needed: usize,
        /// Number available.
        got: usize,
    },
    /// The solver used up its iterations.
    NotConverged {
        /// The solver.
        solver: Solver,
        /// Iterations done.
        iterations: usize,
        /// Residual left (metres for lengths, newtons for forces).
        residual: f64,
    },
    /// The best pose does not fit the lengths.
    ResidualTooLarge {
        /// The solver.
        solver: Solver,
        /// Root mean square of the length residuals.
        residual_m: f64,
        /// The limit that was asked for.
        limit_m: f64,
    },
    /// A matrix that must be inverted is singular: the pose is a singular one.
    Singular {
        /// The solver.
        solver: Solver,
    },
    /// The equilibrium needs a cable to push.
    NegativeTension {
        /// Cable number, from 1.
        cable: usize,
        /// The tension it would need.
        tension_n: f64,
    },
    /// No tensions within the limits balance the wrench.
    OutsideTensionLimits {
        /// The cable with the largest violation, from 1.
        cable: usize,
        /// Which of its limits.
        bound: Bound,
        /// By how much it would have to be exceeded.
        violation_n: f64,
    },
    /// The cables cannot produce the wrench with any tensions.
    WrenchNotBalanced {
        /// Norm of the unbalanced part of the wrench (newtons, and newton metres for moments).
        residual_n: f64,
    },
    /// The platform is not supported: its energy has no minimum for these tensions.
    Unbounded {
        /// The solver.
        solver: Solver,
    },
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Error::CableCount { expected, got } => write!(
                f,
                "{got} entries given, {expected} needed: give one per cable (1 to 16 cables)"
            ),
            Error::InvalidCable { cable, what, value } => {
                write!(f, "cable {cable}: {what}, got {value}")
            }
            Error::InvalidPlatform { what, value } => write!(f, "platform: {what}, got {value}"),
            Error::InvalidInput { what, cable, value } => match cable {
                Some(cable) => write!(f, "cable {cable}: {what}, got {value}"),
                None => write!(f, "{what}, got {value}"),
            },
            Error::InsidePulley {
                cable,
                distance_m,
                radius_m,
            } => write!(
                f,
                "cable {cable}: its attachment is {:.3} mm from the pulley's centre, inside the \
                 radius of {:.3} mm; move the platform away from the pulley",
                distance_m * 1e3,
                radius_m * 1e3
            ),
            Error::OnSwivelAxis { cable } => write!(
                f,
                "cable {cable}: its attachment lies on the pulley's swivel axis, where the cable \
                 has no direction; move the platform aside"
            ),
            Error::TooFewCables {
                solver,
                needed,
                got,
            } => write!(
                f,
                "{solver}: needs {needed} cables of its kind, this robot has {got}"
            ),
            Error::NotConverged {
                solver,
                iterations,
                residual,
            } => write!(
                f,
                "{solver}: no solution after {iterations} iterations (residual {residual:.3e}); \
                 check the lengths and tensions or start closer"
            ),
            Error::ResidualTooLarge {
                solver,
                residual_m,
                limit_m,
            } => write!(
                f,
                "{solver}: the best pose misses the lengths by {:.4} mm rms, over the limit of \
                 {:.4} mm; a cable may have slipped or the attitude may differ",
                residual_m * 1e3,
                limit_m * 1e3
            ),
            Error::Singular { solver } => write!(
                f,
                "{solver}: the pose is singular (the cables do not fix it); choose another pose"
            ),
            Error::NegativeTension { cable, tension_n } => write!(
                f,
                "cable {cable}: equilibrium would need {tension_n:.3} N, but a cable cannot push; \
                 change the position or the held tension"
            ),
            Error::OutsideTensionLimits {
                cable,
                bound,
                violation_n,
            } => write!(
                f,
                "cable {cable}: its {bound} tension would be exceeded by {violation_n:.3} N; \
                 change the pose, the load or the limit"
            ),
            Error::WrenchNotBalanced { residual_n } => write!(
                f,
                "the cables cannot balance the wrench: {residual_n:.3e} N is left over"
            ),
            Error::Unbounded { solver } => write!(
                f,
                "{solver}: nothing holds the platform for these tensions; hold a length or lower \
                 the tensions"
            ),
        }
    }
}

impl core::error::Error for Error {}
