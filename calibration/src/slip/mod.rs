//! Self-check of a calibrated robot: a cable that slipped on its drum, and a calibration that no
//! longer holds.
//!
//! At rest lengths and tensions are redundant: from the lengths of the length-held cables and the
//! tension of the other follow its length and their tensions. One pose shows that something slipped;
//! several, seen from different places, or one look at a tag, show which cable.
//!
//! The rows of one reading share the tension of the tension-held cable, from which all else is
//! predicted, and those of all readings what the calibration is off by: they are whitened together
//! (Aitken, 1936).

mod residual;

use mcdpr_core::motion::{Model, PlanError};
use mcdpr_kinematics::Pose;
use nalgebra::{DMatrix, DVector};
use residual::{Block, Known};

/// What was measured at one resting pose.
#[derive(Debug, Clone, PartialEq)]
pub struct Reading {
    /// Paid-out lengths by the drum encoders, m.
    pub lengths_m: Vec<f64>,
    /// Tensions, N.
    pub tensions_n: Vec<f64>,
    /// world_from_platform by a tag whose place is calibrated, if one was seen.
    pub seen: Option<Pose>,
}

/// Standard deviations of what is read. What the calibration is off by comes to it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sigmas {
    /// A length, m.
    pub length_m: f64,
    /// A mean tension, N.
    pub tension_n: f64,
    /// A tension, relative: pulleys.
    pub tension_relative: f64,
    /// A length that follows from a look at a tag, m.
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
    /// For a calibrated robot whose pulleys rub: a tension at the winch tells that at the platform to
    /// `tension_relative`, and a look at a tag is no better than the predicted error. With the
    /// calibration's covariance (`known`) lengths are as good as they are read; without, no better
    /// than that error.
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

/// What the readings say.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Finding {
    /// Everything fits.
    Holds,
    /// Something slipped; the readings do not tell which cable.
    Slip {
        /// Length that does not fit, m, for the cable that explains most.
        about_m: f64,
    },
    /// A cable slipped.
    Cable {
        /// Number of the cable, from 1.
        cable: usize,
        /// Cable that is off the drum beyond what the encoder says, m.
        slip_m: f64,
        /// Its standard deviation, m.
        sigma_m: f64,
    },
    /// No single cable explains the readings: the calibration no longer holds.
    NoLongerHolds {
        /// Chi-square per degree of freedom that stays with the best cable.
        ratio: f64,
    },
}

/// Gain in chi-square by which something slipped, at one place and at several. One place without a
/// tag sees one combination of the lengths, whose gain is over the first by chance in 3 of 10 000
/// checks; several, or a tag, see up to four, each over the second in 1 of 10 000.
const SHOWN: [f64; 2] = [13.0, 15.5];
/// Gain that names a cable: 4.5 standard deviations.
const SURE: f64 = 20.0;
/// Lead in chi-square of the cable to blame over every other one.
const LEAD: f64 = 9.0;
/// Chi-square per degree of freedom that no measurement noise explains, at least: few degrees need
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
    /// Without readings. A calibrated robot's covariance, where its model has one, counts.
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
    /// [`PlanError::Holding`] where it is not of this robot, [`PlanError::Lengths`] where no resting
    /// pose fits the lengths.
    pub fn add(&mut self, reading: &Reading) -> Result<(), PlanError> {
        let count = self.model.robot().cables.len();
        let whole = reading.lengths_m.len() == count && reading.tensions_n.len() == count;
        let numbers = reading.lengths_m.iter().chain(&reading.tensions_n);
        if !whole || numbers.into_iter().any(|x| !x.is_finite()) {
            return Err(PlanError::Holding {
                held: reading.lengths_m.len(),
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
            let off = by_unknown * &known.factor;
            covariance += &off * off.transpose();
        }
        let factor = covariance.cholesky()?.unpack();
        let value = factor.solve_lower_triangular(&value)?;
        Some((value, factor.solve_lower_triangular(&by_slip)?))
    }

    /// What the readings so far say.
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
        let freedom = value.len().saturating_sub(1).max(1) as f64;
        let ratio = (value.norm_squared() - gain) / freedom;
        let several = self.readings > 1 || self.seen;
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

/// Chi-square per degree of freedom that is no chance (1 in 10 000; Wilson and Hilferty, 1931), and
/// not less than [`RATIO_MAX`].
fn most(freedom: f64) -> f64 {
    const Z: f64 = 3.72;
    let part = 2.0 / (9.0 * freedom);
    (1.0 - part + Z * part.sqrt()).powi(3).max(RATIO_MAX)
}
