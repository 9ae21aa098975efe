//! How to plan: which model of the platform, which tension, which shaper.

use serde::{Deserialize, Serialize};

/// What the platform is taken to do.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "snake_case")]
pub enum Planner {
    /// It hangs in equilibrium: gravity and tensions give its attitude.
    #[default]
    Equilibrium,
    /// It stays level, as the paper takes it; lengths of a rigid geometry. For comparison.
    Level,
}

/// Which tension the tension-held cable gets along the path.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "snake_case")]
pub enum Tensioning {
    /// The tension that makes the smallest tension of all cables as great as it can be, smoothed
    /// along the path.
    #[default]
    MaxMin,
    /// The robot file's set-point, everywhere.
    Setpoint,
}

/// Which shaper takes the swing out of a motion.
///
/// Source: Singer and Seering, 1990 (zero vibration; with derivative), for each of the platform's
/// soft modes at the pose where a leg ends; several modes by convolution.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "snake_case")]
pub enum Shaping {
    /// None.
    #[default]
    None,
    /// Zero vibration: two impulses a mode, half a period of it longer.
    Zv,
    /// Zero vibration and derivative: three impulses a mode, a period of it longer, forgives a
    /// wrong frequency.
    Zvd,
}

/// How to plan.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PlanOptions {
    /// What the platform is taken to do.
    pub planner: Planner,
    /// Which tension the tension-held cable gets.
    pub tensioning: Tensioning,
    /// Which shaper takes the swing out.
    pub shaping: Shaping,
}
