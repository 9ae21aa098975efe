//! Results of picking: each attempt, and why it ended.

use super::budget::Budget;
use mcdpr_core::estimate::track::Load;
use serde::Serialize;

/// Result of one attempt.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// Taken, carried and released.
    Delivered,
    /// The jaws closed on nothing.
    Missed,
    /// The object was lost after the lift.
    Lost,
    /// The robot cannot carry it: it was put down where it lay.
    TooHeavy,
}

/// A load as tracked.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Weighed {
    /// Mass, kg.
    pub mass_kg: f64,
    /// Its standard deviation, kg.
    pub mass_sigma_kg: f64,
    /// Centre of mass, platform frame, m.
    pub center_m: [f64; 3],
    /// Its standard deviation per axis, m.
    pub center_sigma_m: [f64; 3],
}

impl From<Load> for Weighed {
    fn from(load: Load) -> Self {
        Self {
            mass_kg: load.mass_kg,
            mass_sigma_kg: load.mass_sigma_kg,
            center_m: load.center_m.into(),
            center_sigma_m: load.center_sigma_m.into(),
        }
    }
}

/// One attempt.
#[derive(Debug, Clone, Serialize)]
pub struct Attempt {
    /// Its result.
    pub outcome: Outcome,
    /// The grasp in the colour picture, px.
    pub pixel: [f64; 2],
    /// The tool point as seen, world, m.
    pub seen_m: [f64; 3],
    /// Commanded tool position, world, m.
    pub tool_m: [f64; 3],
    /// The platform's origin then, world, m.
    pub platform_m: [f64; 3],
    /// Turn of the jaws, rad.
    pub wrist_rad: f64,
    /// Tilt of the tool, rad.
    pub tilt_rad: f64,
    /// Distance between the pads, m.
    pub width_m: f64,
    /// Rank of the grasp.
    pub quality: f64,
    /// Weight by the difference of tensions, N; `None` if nothing was lifted.
    pub lifted_n: Option<f64>,
    /// Mass and centre as tracked, where loads are tracked.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub load: Option<Weighed>,
    /// Whether that weight agrees with the gripper's switch.
    pub weight_agrees: Option<bool>,
    /// Distance of the tool from its target before the jaws closed and the last correction was
    /// made, by lengths, m.
    pub left_m: f64,
    /// Error budget of the grasp point.
    pub budget: Budget,
}

/// Why picking ended.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "why", rename_all = "snake_case")]
pub enum End {
    /// Nothing left.
    Empty,
    /// Things are left that it cannot take.
    Unreachable {
        /// Why not.
        reason: String,
    },
    /// Too many failures in a row.
    Failures {
        /// How many.
        count: usize,
    },
    /// The maximum number of attempts.
    Enough,
}

/// Contents of the jaws after a loss of power.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Jaws {
    /// They were open, or they closed on nothing.
    Empty,
    /// They were closed before and are open now: what they held has fallen.
    Dropped,
    /// They hold an object.
    Holding,
}

/// How picking continued after a loss of power.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Resumed {
    /// What was in the jaws.
    pub jaws: Jaws,
    /// Weight by tensions and statics, N; `None` with open jaws.
    pub weight_n: Option<f64>,
    /// What became of an object in the jaws.
    pub outcome: Option<Outcome>,
}

/// All of a picking task.
#[derive(Debug, Clone, Serialize)]
pub struct Report {
    /// How it continued, if a loss of power had interrupted it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub resumed: Option<Resumed>,
    /// Every attempt, of the continuation alone after a loss of power.
    pub attempts: Vec<Attempt>,
    /// Why it ended.
    pub end: End,
    /// Observed position of [`super::Options::probe_px`] in the world, m.
    pub probe_m: Option<[f64; 3]>,
    /// Final position after returning, world, m.
    pub returned_m: Option<[f64; 3]>,
    /// Time on the link's clock, s.
    pub duration_s: f64,
}

impl Report {
    /// Attempts that ended with a delivery.
    #[must_use]
    pub fn delivered(&self) -> usize {
        let delivered = |attempt: &&Attempt| attempt.outcome == Outcome::Delivered;
        let resumed = self.resumed.as_ref().and_then(|resumed| resumed.outcome);
        self.attempts.iter().filter(delivered).count()
            + usize::from(resumed == Some(Outcome::Delivered))
    }
}
