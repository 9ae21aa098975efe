//! Self-check of a calibrated robot: a cable that slipped on its drum, and a calibration that no
//! longer holds.
//!
//! At rest lengths and tensions are redundant: the length of the tension-held cable and the
//! tensions of the others follow from the other lengths and its tension. One pose shows that a
//! cable slipped; several different poses, or one observation of a tag, show which one.
//!
//! The rows of one reading share the tension of the tension-held cable, from which all else is
//! predicted, and those of all readings share the errors of the calibration: they are whitened
//! together (Aitken, 1936).

mod residual;

use mcdpr_core::motion::{Model, PlanError};
use mcdpr_kinematics::Pose;
use nalgebra::{DMatrix, DVector};
use residual::{Block, Known};

/// Measurements at one resting pose.
#[derive(Debug, Clone, PartialEq)]
pub struct Reading {
    /// Paid-out lengths by the drum encoders, m.
    pub lengths_m: Vec<f64>,
    /// Tensions, N.
    pub tensions_n: Vec<f64>,
    /// world_from_platform by a tag whose pose is calibrated, if one was seen.
    pub seen: Option<Pose>,
}

/// Standard deviations of the readings. The errors of the calibration add to them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sigmas {
    /// A length, m.
    pub length_m: f64,
    /// A mean tension, N.
    pub tension_n: f64,
    /// A tension, relative: pulleys.
    pub tension_relative: f64,
    /// A length that follows from an observation of a tag, m.
    pub seen_m: f64,
}

impl Default for Sigmas {
    fn default() -> Self {
        Self {
            length_m: 2e-5,
            tension_n: 0.01,
            tension_relative: 0.0,
            seen_m: 2.5e-4,
        }
    }
}

impl Sigmas {
    /// For a calibrated robot with friction in its pulleys: a tension at the winch equals that at
    /// the platform to `tension_relative`, and an observation of a tag has the predicted error.
    /// With the calibration's covariance (`known`) lengths have the accuracy of the encoders;
    /// without it, that error.
    #[must_use]
    pub fn calibrated(predicted_error_m: f64, tension_relative: f64, known: bool) -> Self {
        let exact = Self::default();
        let off_m = if known { 0.0 } else { predicted_error_m };
        Self {
            length_m: exact.length_m.hypot(off_m),
            tension_n: 0.05,
            tension_relative,
            seen_m: exact.seen_m.hypot(predicted_error_m),
        }
    }
}

/// The verdict of the readings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Finding {
    /// Everything fits.
    Holds,
    /// A cable slipped; the readings do not determine which one.
    Slip {
        /// Length that does not fit, m, for the cable that explains most.
        about_m: f64,
    },
    /// A cable slipped.
    Cable {
        /// Number of the cable, from 1.
        cable: usize,
        /// Length off the drum beyond the encoder's value, m.
        slip_m: f64,
        /// Its standard deviation, m.
        sigma_m: f64,
    },
    /// No single cable explains the readings: the calibration no longer holds.
    NoLongerHolds {
        /// Chi-square per degree of freedom that remains with the best cable.
        ratio: f64,
    },
}

/// Gain in chi-square that indicates slip, at one pose and at several. One pose without a tag
/// observes one combination of the lengths, whose gain exceeds the first limit by chance in 3 of 10
/// 000 checks; several poses, or a tag, observe up to four, each above the second in 1 of 10 000.
const SHOWN: [f64; 2] = [13.0, 15.5];
/// Gain that names a cable: 4.5 standard deviations.
const SURE: f64 = 20.0;
/// Lead in chi-square of the named cable over every other one.
const LEAD: f64 = 9.0;
/// Least chi-square per degree of freedom that measurement noise does not explain: few degrees need
/// more, see [`most`].
const RATIO_MAX: f64 = 6.0;

/// Collects readings.
#[derive(Debug, Clone)]
pub struct SelfCheck<'a> {
    model: &'a Model,
    sigmas: Sigmas,
    known: Option<Known>,
    blocks: Vec<Block>,
    readings: usize,
    /// Whether a tag was seen.
    seen: bool,
}

impl<'a> SelfCheck<'a> {
    /// Without readings. Uses a calibrated robot's covariance if its model has one.
    #[must_use]
    pub fn new(model: &'a Model, sigmas: Sigmas) -> Self {
        Self {
            model,
            sigmas,
            known: Known::of(model.robot()),
            blocks: Vec::new(),
            readings: 0,
            seen: false,
        }
    }

    /// Adds a reading.
    ///
    /// # Errors
    /// [`PlanError::Lengths`] if it is not of this robot, or if no resting pose fits the lengths.
    pub fn add(&mut self, reading: &Reading) -> Result<(), PlanError> {
        let count = self.model.robot().cables.len();
        let whole = reading.lengths_m.len() == count && reading.tensions_n.len() == count;
        let numbers = reading.lengths_m.iter().chain(&reading.tensions_n);
        if !whole || numbers.into_iter().any(|x| !x.is_finite()) {
            return Err(PlanError::Lengths {
                source: mcdpr_kinematics::Error::CableCount {
                    expected: count,
                    got: reading.lengths_m.len(),
                },
            });
        }
        let hung = residual::hung(self.model, reading, &self.sigmas, self.known.as_ref())?;
        self.blocks.push(hung);
        let looked = residual::looked(self.model, reading, &self.sigmas, self.known.as_ref());
        self.seen |= looked.is_some();
        self.blocks.extend(looked);
        self.readings += 1;
        Ok(())
    }

    /// Number of readings so far.
    #[must_use]
    pub const fn readings(&self) -> usize {
        self.readings
    }

    /// Residuals of all readings and their derivatives by each cable's slip, whitened together.
    fn whitened(&self) -> Option<(DVector<f64>, DMatrix<f64>)> {
        let rows: usize = self.blocks.iter().map(|block| block.value.len()).sum();
        let count = self.model.robot().cables.len();
        let unknowns = self.known.as_ref().map_or(0, |known| known.factor.nrows());
        let mut value = DVector::zeros(rows);
        let mut by_slip = DMatrix::zeros(rows, count);
        let mut by_unknown = DMatrix::zeros(rows, unknowns);
        let mut covariance = DMatrix::zeros(rows, rows);
        let mut at = 0;
        for block in &self.blocks {
            let size = block.value.len();
            value.rows_mut(at, size).copy_from(&block.value);
            by_slip.rows_mut(at, size).copy_from(&block.by_slip);
            by_unknown.rows_mut(at, size).copy_from(&block.by_unknown);
            let mut own = covariance.view_mut((at, at), (size, size));
            own.copy_from(&block.noise);
            at += size;
        }
        if let Some(known) = &self.known {
            // The errors of the calibration are the same in all readings: they correlate the
            // blocks.
            let off = by_unknown * &known.factor;
            covariance += &off * off.transpose();
        }
        let factor = covariance.cholesky()?.unpack();
        let value = factor.solve_lower_triangular(&value)?;
        Some((value, factor.solve_lower_triangular(&by_slip)?))
    }

    /// The verdict of the readings so far.
    #[must_use]
    pub fn finding(&self) -> Finding {
        let Some((value, by_slip)) = self.whitened() else {
            return Finding::Holds;
        };
        let mut fits: Vec<(usize, f64, f64, f64)> = (0..by_slip.ncols())
            .map(|j| {
                let column = by_slip.column(j);
                let square = column.norm_squared().max(1e-12);
                let dot = column.dot(&value);
                (j, dot / square, 1.0 / square.sqrt(), dot * dot / square)
            })
            .collect();
        fits.sort_by(|a, b| b.3.total_cmp(&a.3));
        let Some(&(cable, slip_m, sigma_m, gain)) = fits.first() else {
            return Finding::Holds;
        };
        let second = fits.get(1).map_or(0.0, |fit| fit.3);
        // One degree of freedom goes to the slip of the best cable.
        let freedom = value.len().saturating_sub(1).max(1) as f64;
        let ratio = (value.norm_squared() - gain) / freedom;
        let several = self.readings > 1 || self.seen;
        // First: where nothing fits, naming the best cable would send the user to a good drum.
        if ratio > most(freedom) {
            Finding::NoLongerHolds { ratio }
        } else if gain > SURE && gain - second > LEAD {
            Finding::Cable {
                cable: cable + 1,
                slip_m,
                sigma_m,
            }
        } else if gain > SHOWN[usize::from(several)] {
            Finding::Slip { about_m: slip_m }
        } else {
            Finding::Holds
        }
    }
}

/// Chi-square per degree of freedom that is exceeded by chance in 1 of 10 000 checks (Wilson and
/// Hilferty, 1931), and not less than [`RATIO_MAX`].
fn most(freedom: f64) -> f64 {
    const Z: f64 = 3.72;
    let part = 2.0 / (9.0 * freedom);
    (1.0 - part + Z * part.sqrt()).powi(3).max(RATIO_MAX)
}
