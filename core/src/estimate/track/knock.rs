//! What moved, when a rest does not fit: one cause at a time is set free, and the likelihoods of all
//! rests that wait are compared (Willsky and Jones, 1976, with the filter's own rows).

use super::gaussian::{Fit, Gaussian};
use super::layout::Layout;
use super::pulleys::Rubbing;
use super::rows::vector;
use super::{DOUBT_SIGMAS, Tracker};
use crate::estimate::Measurements;
use crate::estimate::region::chi2_quantile;
use mcdpr_kinematics::Pose;
use nalgebra::Vector3;

/// A knock of an anchor is looked for within this, per axis, m.
pub(super) const ANCHOR_M: f64 = 5e-3;
/// A bent bracket: shift, m, and turn, rad.
const CAMERA_M: f64 = 5e-3;
const CAMERA_RAD: f64 = 2e-2;
/// The best cause is named if no other is more likely than a hundredth of it: ln(100).
pub(super) const CLEARER: f64 = 4.6;
/// One rest names nothing: something may have touched the platform. A second one must agree.
const CONFIRMED: usize = 2;
/// Rests that wait for an explanation, at most.
pub(super) const MOST: usize = 4;

/// Something that moved.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Moved {
    /// The anchor of a cable, 1 for the first. A cable that slipped looks alike from one place.
    Anchor(usize),
    /// The camera on its bracket.
    Camera,
    /// The payload: it was dropped, or slipped.
    Payload,
}

/// What moved, and by how much.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Named {
    /// What.
    pub what: Moved,
    /// By how much: world, m, for an anchor; camera frame, m, for the camera; kg in the first component for
    /// a payload.
    pub by: Vector3<f64>,
}

impl Named {
    /// What moved, and by how much, as a sentence without its full stop.
    #[must_use]
    pub fn words(&self) -> String {
        let [x, y, z]: [f64; 3] = (self.by * 1e3).into();
        let by_mm = self.by.norm() * 1e3;
        match self.what {
            Moved::Anchor(cable) => format!(
                "anchor {cable} moved by {by_mm:.1} mm ({x:+.1}, {y:+.1}, {z:+.1}), or its cable slipped"
            ),
            Moved::Camera => format!(
                "the camera moved by {by_mm:.1} mm on its bracket ({x:+.1}, {y:+.1}, {z:+.1})"
            ),
            Moved::Payload => format!("the load changed by {:+.0} g", self.by.x * 1e3),
        }
    }
}

/// A rest that did not fit.
#[derive(Debug, Clone)]
pub(super) struct Pending {
    pub(super) measured: Measurements,
    pub(super) rubbing: Vec<Rubbing>,
    pub(super) near: Pose,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Hypothesis(pub(super) Moved);

impl Hypothesis {
    pub(super) fn free(self, layout: Layout, states: &mut Gaussian) {
        match self.0 {
            Moved::Anchor(cable) => {
                for axis in 0..3 {
                    states.loosen(layout.anchor(cable - 1) + axis, ANCHOR_M * ANCHOR_M);
                }
            }
            Moved::Camera => {
                for axis in 0..3 {
                    states.loosen(layout.camera() + axis, CAMERA_M * CAMERA_M);
                    states.loosen(layout.camera() + 3 + axis, CAMERA_RAD * CAMERA_RAD);
                }
            }
            Moved::Payload => {
                let first = layout.payload();
                let mass = states.mean[first].max(0.1);
                states.loosen(first, mass * mass);
                for axis in 0..3 {
                    states.loosen(first + 1 + axis, (mass * 0.05).powi(2));
                }
            }
        }
    }

    pub(super) fn change(self, layout: Layout, from: &Gaussian, to: &Gaussian) -> Vector3<f64> {
        let first = match self.0 {
            Moved::Anchor(cable) => layout.anchor(cable - 1),
            Moved::Camera => layout.camera(),
            Moved::Payload => {
                let first = layout.payload();
                return Vector3::new(to.mean[first] - from.mean[first], 0.0, 0.0);
            }
        };
        vector(&to.mean, first) - vector(&from.mean, first)
    }
}

/// The cause of the rests that wait, if one is clear, and the states with it.
pub(super) fn explain(tracker: &Tracker) -> (Option<Named>, Option<Gaussian>) {
    if tracker.pending.len() < CONFIRMED {
        return (None, None);
    }
    let mut causes: Vec<Moved> = (1..=tracker.layout.cables).map(Moved::Anchor).collect();
    if tracker
        .pending
        .iter()
        .any(|look| !look.measured.views.is_empty())
    {
        causes.push(Moved::Camera);
    }
    if tracker.loaded {
        causes.push(Moved::Payload);
    }
    let mut found: Vec<(f64, Moved, Gaussian, Fit)> = Vec::new();
    for what in causes {
        let mut states = tracker.freed(Hypothesis(what));
        let mut fit = Fit::default();
        let explained = tracker.pending.iter().all(|look| {
            tracker.taken(&states, look).is_some_and(|taken| {
                states = taken.states;
                fit = fit.with(taken.fit);
                true
            })
        });
        if explained {
            found.push((fit.log_likelihood(), what, states, fit));
        }
    }
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    let second = found.get(1).map_or(f64::NEG_INFINITY, |f| f.0);
    let Some((likelihood, what, states, fit)) = found.into_iter().next() else {
        return (None, None);
    };
    let fits = fit.squares < chi2_quantile(fit.rows as f64, DOUBT_SIGMAS);
    if !fits || likelihood - second < CLEARER {
        return (None, None);
    }
    let by = Hypothesis(what).change(tracker.layout, &tracker.now, &states);
    (Some(Named { what, by }), Some(states))
}
