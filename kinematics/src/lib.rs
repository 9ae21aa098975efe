//! Geometry, kinematics and statics of cable-driven parallel robots with swivel pulleys.
//!
//! Any robot of 1 to 16 cables: [`Robot<N>`] fixes the number at compile time (the fast path),
//! [`AnyRobot`] at run time. All quantities are SI (m, rad, N, kg) in f64; the world's z axis points
//! up and gravity along -z; a pose is world_from_platform with R = Rz Ry Rx.
//! A cable's direction `t` points from the frame to the platform, so a tension T exerts the force
//! `-T t` on the platform. Twists are `[velocity of the platform's origin, angular velocity]` in the
//! world frame.
#![cfg_attr(not(feature = "std"), no_std)]
// Component loops over parallel arrays read better, and vectorise, with an index.
#![allow(clippy::needless_range_loop)]
// `!(a < b)` makes NaN fail a check.
#![allow(clippy::neg_cmp_op_on_partial_ord)]

mod any_robot;
mod cable_vec;
mod centred;
mod correction;
mod descent;
mod energy;
mod equilibrium;
mod equilibrium_state;
mod error;
mod example;
mod forward;
mod geometrico_static;
mod interference;
mod inverse;
mod jacobian;
mod linear;
mod math;
mod pose;
mod robot;
mod stability;
mod tension;
mod workspace;

pub use any_robot::{AnyGoal, AnyRobot, AnyWorkspaceTest, Balance};
pub use cable_vec::{CableMatrix, CableSet, CableVec, MAX_CABLES};
pub use centred::Band;
pub use correction::{CableMaterial, CorrectedLength, Correction, corrected_length};
pub use descent::{Attempt, Damping, Descent, descend};
pub use equilibrium::EquilibriumGuess;
pub use equilibrium_state::{Equilibrium, Held, Start, StaticOptions};
pub use error::{Bound, Error, Solver};
pub use example::{EXAMPLE_TOOL_M, eight_cables, example_platform, four_cables};
pub use forward::{Forward, ForwardOptions};
pub use interference::{CablePair, CableToPlatform, PlatformBox};
pub use inverse::{CablePath, Inverse};
pub use jacobian::LengthDerivatives;
pub use pose::{Pose, angular_velocity_from_rates, rotation_from_rpy, rpy_from_rotation};
pub use robot::{Cable, GRAVITY_MPS2, Platform, Robot};
pub use stability::{Linearisation, Stability, ToolSensitivity};
pub use tension::{Distribution, Goal, TensionLimits, distribute};
pub use workspace::{Grid, Verdict, WorkspaceTest};
