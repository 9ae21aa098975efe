//! How to plan: which model of the platform, which tension, which shaper.

use serde::{Deserialize, Serialize};

/// Model of the platform.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "snake_case")]
pub enum Planner {
    /// It hangs in equilibrium: gravity and tensions give its attitude.
    #[default]
    Equilibrium,
    /// It stays level, as the paper assumes; lengths of a rigid geometry. For comparison.
    Level,
}

/// Tension of the tension-held cable along the path.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "snake_case")]
pub enum Tensioning {
    /// The tension that maximises the smallest tension of all cables, smoothed along the path.
    #[default]
    MaxMin,
    /// The robot file's set-point, everywhere.
    Setpoint,
}

/// Input shaper that removes the swing of a motion.
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
    /// Model of the platform.
    pub planner: Planner,
    /// Tension of the tension-held cable.
    pub tensioning: Tensioning,
    /// Input shaper.
    pub shaping: Shaping,
}
