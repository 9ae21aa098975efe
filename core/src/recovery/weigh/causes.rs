//! The estimate where two causes of the cut are possible: the drives lost their supply with the board, or
//! they held their drums until the brakes closed.
//!
//! The lengths differ by millimetres between both, so their distribution has two peaks. Each cause is
//! estimated by itself and weighted with the probability of the evidence (a Gaussian sum; Alspach and
//! Sorenson 1972). A tag decides between them as a rule. Without one the estimate is in between, and the
//! bound reaches both.

use super::{HOMED_M, Known, TAG_PLACE_M};
use crate::estimate::EstimateError;
use crate::estimate::region::{radius_95_m, radius_999_m};
use crate::motion::Model;
use crate::recovery::fuse::{Found, Weighed, fuse};
use nalgebra::{Matrix3, Vector3};

/// A cause with this probability counts as known.
const KNOWN: f64 = 0.99;
/// A cause under this probability is outside the bound of 95 %.
const LEAST_PROBABILITY: f64 = 0.02;
/// Standard deviations between an estimate and a peak from which on the error is beyond the peak.
const APART: f64 = 2.0;
/// Normal deviate of 95 %, one-sided.
const ONE_SIDED: f64 = 1.645;

/// An estimate, and how far the causes are from it.
#[derive(Debug, Clone)]
pub(super) struct Chosen {
    pub(super) found: Found,
    /// One for each possible cause. Empty where the cause is known.
    peaks: Vec<Peak>,
    places: Places,
}

/// Places whose errors are common to all rows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Places {
    /// Lengths know that of homing, tags know their own.
    Own,
    /// Both know that of homing: the tags were seen from it.
    OfHoming {
        /// Its standard deviation, m per axis.
        homed_m: f64,
    },
}

/// The estimate under one cause.
#[derive(Debug, Clone)]
struct Peak {
    probability: f64,
    /// Displacement of the tool from the weighted estimate, world, m.
    shift_m: Vector3<f64>,
    covariance_m2: Matrix3<f64>,
}

impl Chosen {
    /// An estimate without any doubt about the cause.
    pub(super) const fn only(found: Found, places: Places) -> Self {
        Self {
            found,
            peaks: Vec::new(),
            places,
        }
    }

    /// Covariance of the tool, world, m².
    pub(super) fn covariance_m2(&self) -> Matrix3<f64> {
        if self.peaks.is_empty() {
            return self.found.covariance_m2 + self.of_places();
        }
        let parts = self.peaks.iter().map(|peak| {
            let shifted = peak.shift_m * peak.shift_m.transpose();
            (peak.covariance_m2 + shifted) * peak.probability
        });
        parts.sum::<Matrix3<f64>>() + self.of_places()
    }

    /// Covariance by the places of homing, of tags and of the camera, m². They are wrong by the same in all
    /// rows, so each counts as far as the estimate follows it.
    fn of_places(&self) -> Matrix3<f64> {
        if let Places::OfHoming { homed_m } = self.places {
            return Matrix3::identity() * homed_m.powi(2);
        }
        let homed = Matrix3::identity() * HOMED_M.powi(2);
        let tag = self.found.tool_per_tag;
        let mut sum = tag * tag.transpose() * TAG_PLACE_M.powi(2);
        if !self.found.residual_per_length.is_empty() {
            let rest = Matrix3::identity() - tag;
            sum += rest * homed * rest.transpose();
        }
        sum
    }

    /// Radius that holds the error in 99.9 % of cases, m, where there is one cause only.
    pub(super) fn bound_999_m(&self) -> f64 {
        radius_999_m(&self.covariance_m2(), &self.of_places())
    }

    /// Radius that holds the error in 95 % of cases, m.
    pub(super) fn bound_95_m(&self) -> f64 {
        let places = self.of_places();
        let round = radius_95_m(&self.covariance_m2(), &places);
        // Beyond a peak's shift along it, with what is across.
        let reach = |peak: &Peak| {
            let covariance = peak.covariance_m2 + places;
            let far = peak.shift_m.norm();
            let along = peak.shift_m / far.max(1e-12);
            let variance = (along.transpose() * covariance * along).x;
            // Close to it, or at it, the error may be on any side.
            if far < 1e-9 || far < APART * variance.sqrt() {
                return far + radius_95_m(&covariance, &places);
            }
            let ahead = far + ONE_SIDED * variance.sqrt();
            libm::hypot(ahead, (covariance.trace() - variance).max(0.0).sqrt())
        };
        let peaks = self
            .peaks
            .iter()
            .filter(|peak| peak.probability > LEAST_PROBABILITY);
        let reached = peaks.map(reach).fold(0.0, f64::max);
        if reached > 0.0 {
            round.min(reached)
        } else {
            round
        }
    }
}

/// The estimate by lengths and the other evidence in `weighed`.
///
/// # Errors
/// [`EstimateError`].
pub(super) fn choose(
    model: &Model,
    weighed: &Weighed<'_>,
    known: &Known,
    start_m: &Vector3<f64>,
    places: Places,
) -> Result<Chosen, EstimateError> {
    let with = |lengths| Weighed {
        lengths: Some(lengths),
        ..weighed.clone()
    };
    let mut each = Vec::new();
    for cause in &known.causes {
        // A cause under which the robot could not hang at all is impossible.
        if let Ok(found) = fuse(model, &with(&cause.lengths), start_m) {
            each.push((libm::log(cause.probability) + found.log_evidence, found));
        }
    }
    // Relative to the likeliest cause: exp of a log density of -1000 alone would be zero.
    let most = each.iter().map(|(log, _)| *log).fold(f64::MIN, f64::max);
    let total: f64 = each.iter().map(|(log, _)| libm::exp(log - most)).sum();
    let share = |log: f64| libm::exp(log - most) / total;
    if let Some((_, found)) = each.iter().find(|(log, _)| share(*log) > KNOWN) {
        return Ok(Chosen::only(found.clone(), places));
    }
    let found = fuse(model, &with(&known.lengths), start_m)?;
    let peaks = each.iter().map(|(log, of)| Peak {
        probability: share(*log),
        shift_m: of.tool_m - found.tool_m,
        covariance_m2: of.covariance_m2,
    });
    Ok(Chosen {
        peaks: peaks.collect(),
        found,
        places,
    })
}
