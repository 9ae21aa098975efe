//! The error that a plan states beforehand: a tube around the path that should hold the tool.
//!
//! At every time of a plan the platform is in equilibrium: cables held by length have their lengths,
//! the others their tensions, forces and moments balance. An error of the machine (an anchor, a mass, a
//! sensor) leaves a residual in these equations, and the platform moves until it vanishes. To first
//! order the tool moves by a slope times the error. Slopes and the errors' covariance give that of the
//! tool. The slopes come from one transposed solution per axis of the tool, which costs no more for many
//! errors than for few (the adjoint method).
//!
//! What is not static is added: what the boards have not learnt yet of drives that follow late (`drives`), and how the
//! platform answers the plan's acceleration (`swing`).

mod at_rest;
mod balance;
mod belief;
mod doubts;
mod drives;
mod slopes;
mod swing;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod tied_tests;

use super::region::radius_95_m;
use crate::motion::{Plan, PlanError};
use belief::PER_CABLE;
pub use belief::{Belief, Errors};
pub use doubts::Doubts;
use drives::Drives;
use nalgebra::{DMatrix, Matrix3, Matrix6};
use serde::Serialize;
use slopes::Instant;
use swing::Swing;

/// Most points of a tube.
const MOST_POINTS: f64 = 1000.0;
/// Least time between two points, s.
const LEAST_STEP_S: f64 = 0.01;
/// Travel over which a pulley's friction turns, m: Dahl's model, as in docs/day.md.
const PRESLIDING_M: f64 = 2e-4;
/// Quantile of a normal distribution that leaves 5 % on one side, over the one that leaves them on both.
const ONE_SIDE: f64 = 1.645 / 1.96;

/// One point of a tube.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TubePoint {
    /// Path time, s.
    pub time_s: f64,
    /// Planned tool, world, m.
    pub tool_m: [f64; 3],
    /// The true tool is within this distance with a probability of 95 %, m.
    pub radius_m: f64,
}

/// A tube around a plan's path.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Tube {
    /// Points in order of time, both ends included.
    pub points: Vec<TubePoint>,
    /// Mean radius over time, m.
    pub mean_m: f64,
    /// The widest point.
    pub widest: TubePoint,
    /// The greatest part of the variance at the widest point: what, and its share.
    pub mostly: (&'static str, f64),
    /// Where the belief in the machine comes from.
    pub source: String,
    /// How the platform swings at the end: covariance of its shift (m) and turn (rad), world, about its origin.
    #[serde(skip)]
    pub swings: Matrix6<f64>,
}

impl Tube {
    /// The tube of a plan of a machine believed to be so. `None` where the platform does not hang firmly
    /// enough for a first-order answer.
    ///
    /// # Errors
    /// None for a plan that was made.
    pub fn along(plan: &Plan, belief: &Belief) -> Result<Option<Self>, PlanError> {
        Self::after(plan, belief, &Matrix6::zeros())
    }

    /// As [`Self::along`] for a platform that still swings from the plan before, whose [`Self::swings`] is `before`.
    ///
    /// # Errors
    /// None for a plan that was made.
    pub fn after(
        plan: &Plan,
        belief: &Belief,
        before: &Matrix6<f64>,
    ) -> Result<Option<Self>, PlanError> {
        let model = plan.model();
        let errors = Errors {
            cables: model.robot().cables.len(),
        };
        let home = belief.home(model)?;
        let end_s = plan.timed.duration_s();
        let step_s = (end_s / MOST_POINTS).max(LEAST_STEP_S);
        let mut rubbed = vec![0.0; errors.cables];
        let mut drives = Drives::new(errors.cables);
        let mut last_m: Option<Vec<f64>> = None;
        let mut swing = Swing::new(belief.doubts, before);
        let mut points: Vec<TubePoint> = Vec::new();
        let mut widest: Option<(TubePoint, (&'static str, f64))> = None;
        for (time_s, rest) in plan.states(step_s) {
            if let Some(last_m) = &last_m {
                for (state, (to, from)) in rubbed.iter_mut().zip(rest.paid_out_m.iter().zip(last_m))
                {
                    let travel = (from - to) / PRESLIDING_M;
                    let side = if travel == 0.0 { 0.0 } else { travel.signum() };
                    *state = side + (*state - side) * libm::exp(-travel.abs());
                }
            }
            last_m = Some(rest.paid_out_m.clone());
            let motion = drives.at(plan, time_s)?;
            let Some(slopes) = Instant {
                model,
                errors,
                rest: &rest,
                home: home.as_ref(),
                home_m: belief.doubts.home_m,
                tracked: belief.tracked,
                rubbed: &rubbed,
                motion: &motion,
            }
            .slopes() else {
                return Ok(None);
            };
            let (fixed, at_home) = slopes;
            let swing = swing.at(model, &rest, time_s)?.unwrap_or_default();
            let covariance = &fixed * &belief.covariance * fixed.transpose();
            let covariance =
                Matrix3::from_fn(|i, j| covariance[(i, j)]) + at_home + swing.covariance;
            let radius_m = beside(
                swing.off_m.norm(),
                radius_95_m(&covariance, &Matrix3::zeros()),
            );
            let tool_m = plan.timed.tool_m(time_s)?;
            let point = TubePoint {
                time_s,
                tool_m: tool_m.into(),
                radius_m,
            };
            points.push(point);
            if widest.is_none_or(|(known, _)| known.radius_m < point.radius_m) {
                let swings = swing.covariance.trace() + swing.off_m.norm_squared();
                let whole = covariance.trace() + swing.off_m.norm_squared();
                widest = Some((point, mostly(errors, &fixed, belief, swings, whole)));
            }
        }
        Ok(widest.map(|(widest, mostly)| Self {
            mean_m: points.iter().map(|point| point.radius_m).sum::<f64>() / points.len() as f64,
            points,
            widest,
            mostly,
            source: belief.source.clone(),
            swings: swing.left(),
        }))
    }

    /// Radius at a path time, m; that of the nearest point in time, the greater of both sides.
    #[must_use]
    pub fn radius_m(&self, time_s: f64) -> f64 {
        let after = self.points.partition_point(|point| point.time_s < time_s);
        let sides = [after.saturating_sub(1), after.min(self.points.len() - 1)];
        let radii = sides.map(|at| self.points.get(at).map_or(0.0, |point| point.radius_m));
        radii[0].max(radii[1])
    }

    /// The tube in one sentence.
    #[must_use]
    pub fn words(&self) -> String {
        let at = self.widest.tool_m.map(|v| format!("{:.0}", v * 1e3));
        let (what, share) = self.mostly;
        format!(
            "the tool stays within {:.2} mm of the path with a probability of 95 %, {:.2} mm on average; widest \
             at {:.2} s, tool at {} mm, {:.0} % of it {what}; by {}",
            self.widest.radius_m * 1e3,
            self.mean_m * 1e3,
            self.widest.time_s,
            at.join(" "),
            share * 100.0,
            self.source
        )
    }
}

/// Radius that holds 95 % of an error with a known part, m: `radius_m` is that of the unknown part alone.
///
/// Where the known part is large, only one side counts: 1.645 standard deviations instead of 1.96.
fn beside(known_m: f64, radius_m: f64) -> f64 {
    radius_m.max(known_m + ONE_SIDE * radius_m)
}

/// The greatest part of a point's variance.
fn mostly(
    errors: Errors,
    slopes: &DMatrix<f64>,
    belief: &Belief,
    swing: f64,
    whole: f64,
) -> (&'static str, f64) {
    let of = |columns: &dyn Fn(usize) -> bool| {
        let mut part = slopes.clone();
        for k in (0..errors.count()).filter(|k| !columns(*k)) {
            part.column_mut(k).fill(0.0);
        }
        (&part * &belief.covariance * part.transpose()).trace()
    };
    let own = |from: usize, to: usize| {
        move |k: usize| k < errors.shared() && (from..to).contains(&(k % PER_CABLE))
    };
    let shared = |from: usize, to: usize| move |k: usize| (from..to).contains(&k);
    let parts = [
        // A calibration ties a pulley's radius to its anchor and length: their shares of the variance mean nothing apart.
        (
            "from anchors, attachments, pulleys' radii and lengths",
            of(&|k| own(0, 8)(k) || own(13, 14)(k)),
        ),
        ("from the cables' stiffness", of(&own(8, 9))),
        ("from the cables' creep", of(&own(12, 13))),
        (
            "from tension sensors and pulleys' friction",
            of(&|k| own(9, 11)(k) || own(14, 15)(k)),
        ),
        (
            "from the drives",
            of(&|k| own(11, 12)(k) || k == errors.all_late()),
        ),
        (
            "from mass and centre of mass",
            of(&shared(errors.mass(), errors.payload())),
        ),
        ("from a load", of(&|k| k == errors.payload())),
        (
            "from forces that no model has",
            of(&shared(errors.force(), errors.all_late())),
        ),
        ("from swing", swing),
    ];
    let most = parts.into_iter().max_by(|a, b| a.1.total_cmp(&b.1));
    most.map_or(("", 0.0), |(what, part)| {
        (what, (part / whole.max(1e-18)).clamp(0.0, 1.0))
    })
}
