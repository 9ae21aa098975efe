//! Self-check of a calibrated robot: a cable that slipped on its drum, and a calibration that no
//! longer holds.
//!
//! At rest lengths and tensions are redundant: from the lengths of the length-held cables and the
//! tension of the other follow its length and their tensions. One pose shows that something slipped;
//! several, seen from different places, or one look at a tag, show which cable.
//!
//! The rows of one reading share the tension of the tension-held cable, from which all else is
//! predicted: they are whitened together (Aitken, 1936).

use crate::motion::{Model, PlanError};
use crate::robot::Control;
use mcdpr_kinematics::{Equilibrium, Held, Pose, Start, StaticOptions};
use nalgebra::{DMatrix, DVector};

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

/// Standard deviations of the residuals, calibration error included.
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
            length_m: 4e-5,
            tension_n: 0.02,
            tension_relative: 0.0,
            seen_m: 2.5e-4,
        }
    }
}

impl Sigmas {
    /// For a calibrated robot whose pulleys rub: its lengths are no better than its calibration,
    /// and a tension at the winch tells that at the platform to `tension_relative`. What a
    /// calibration is off by is nearly the same at all poses of one check, so that it counts
    /// whole at each.
    #[must_use]
    pub fn calibrated(predicted_error_m: f64, tension_relative: f64) -> Self {
        let exact = Self::default();
        Self {
            length_m: exact.length_m.hypot(predicted_error_m),
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

/// Gain in chi-square that is no chance: 4.5 standard deviations.
const SURE: f64 = 20.0;
/// Lead in chi-square of the cable to blame over every other one.
const LEAD: f64 = 9.0;
/// Chi-square per degree of freedom that no measurement noise explains.
const RATIO_MAX: f64 = 6.0;
/// Step of the derivatives, m.
const STEP_M: f64 = 2e-4;
/// The same of a tension, N.
const TENSION_STEP_N: f64 = 0.02;

/// Collects readings.
#[derive(Debug, Clone)]
pub struct SelfCheck<'a> {
    model: &'a Model,
    sigmas: Sigmas,
    /// Whitened residual and its derivative by each cable's slip.
    rows: Vec<(f64, Vec<f64>)>,
    readings: usize,
}

impl<'a> SelfCheck<'a> {
    /// Without readings.
    #[must_use]
    pub const fn new(model: &'a Model, sigmas: Sigmas) -> Self {
        Self {
            model,
            sigmas,
            rows: Vec::new(),
            readings: 0,
        }
    }

    /// How the robot hangs with these paid-out lengths and the measured tensions of its
    /// tension-held cables.
    fn hang(&self, reading: &Reading, near: Option<&Pose>) -> Result<Equilibrium, PlanError> {
        let cables = self.model.robot().cables.iter();
        let held: Vec<Held> = cables
            .zip(reading.lengths_m.iter().zip(&reading.tensions_n))
            .map(|(cable, (length, tension))| match cable.control {
                Control::Tension => Held::Tension(*tension),
                Control::Position => {
                    let total = (length + cable.routing_length_m) * (1.0 + tension / cable.ea_n);
                    Held::Length(total - cable.routing_length_m)
                }
            })
            .collect();
        let start = near.map_or(Start::Cold, Start::Pose);
        self.model
            .geometry()
            .geometrico_static(&held, start, &StaticOptions::default())
            .map_err(|source| PlanError::Lengths { source })
    }

    /// What the model expects: lengths of tension-held cables, tensions of length-held ones.
    fn expected(
        &self,
        reading: &Reading,
        near: Option<&Pose>,
    ) -> Result<(Vec<f64>, Pose), PlanError> {
        let found = self.hang(reading, near)?;
        let rest = self.model.with_lengths(found);
        let cables = self.model.robot().cables.iter().enumerate();
        let out = cables.map(|(i, cable)| match cable.control {
            Control::Tension => rest.paid_out_m[i],
            Control::Position => rest.tensions_n()[i],
        });
        Ok((out.collect(), rest.equilibrium.pose))
    }

    /// Adds a reading.
    ///
    /// # Errors
    /// [`PlanError::Holding`] where it is not of this robot, [`PlanError::Lengths`] where no resting
    /// pose fits the lengths.
    pub fn add(&mut self, reading: &Reading) -> Result<(), PlanError> {
        let cables = &self.model.robot().cables;
        let count = cables.len();
        let whole = reading.lengths_m.len() == count && reading.tensions_n.len() == count;
        let numbers = reading.lengths_m.iter().chain(&reading.tensions_n);
        if !whole || numbers.into_iter().any(|x| !x.is_finite()) {
            return Err(PlanError::Holding {
                held: reading.lengths_m.len(),
            });
        }
        let (expected, pose) = self.expected(reading, None)?;
        // By each cable's slip (columns), and by each tension as measured.
        let mut slopes = DMatrix::zeros(count, count);
        let mut by_tension = DMatrix::zeros(count, count);
        for (j, cable) in cables.iter().enumerate() {
            let difference = |step: f64, change: &dyn Fn(&mut Reading, f64)| {
                let at = |step: f64| {
                    let mut moved = reading.clone();
                    change(&mut moved, step);
                    self.expected(&moved, Some(&pose))
                };
                let ((up, _), (down, _)) = (at(step)?, at(-step)?);
                let slope = up.iter().zip(&down).map(|(u, d)| (u - d) / (2.0 * step));
                Ok::<_, PlanError>(DVector::from_iterator(count, slope))
            };
            if cable.control == Control::Tension {
                let slope = difference(TENSION_STEP_N, &|r, step| r.tensions_n[j] += step)?;
                by_tension.set_column(j, &slope);
                // More cable off the drum than its encoder says makes the true length longer.
                slopes[(j, j)] -= 1.0;
            } else {
                let slope = difference(STEP_M, &|r, step| r.lengths_m[j] += step)?;
                slopes.set_column(j, &slope);
                by_tension[(j, j)] -= 1.0;
            }
        }
        let sigma_n = DVector::from_iterator(
            count,
            (reading.tensions_n.iter()).map(|t| {
                self.sigmas
                    .tension_n
                    .hypot(self.sigmas.tension_relative * t)
            }),
        );
        let spread = &by_tension * DMatrix::from_diagonal(&sigma_n);
        // Lengths, by way of the slips' slopes: both are lengths that are off.
        let off = &slopes * self.sigmas.length_m;
        let covariance = &spread * spread.transpose() + &off * off.transpose();
        let residual = DVector::from_iterator(
            count,
            cables.iter().enumerate().map(|(i, cable)| {
                let measured = match cable.control {
                    Control::Tension => reading.lengths_m[i],
                    Control::Position => reading.tensions_n[i],
                };
                measured - expected[i]
            }),
        );
        if let Some(factor) = covariance.cholesky()
            && let Some(residual) = factor.l().solve_lower_triangular(&residual)
            && let Some(slopes) = factor.l().solve_lower_triangular(&slopes)
        {
            let rows = residual.iter().zip(slopes.row_iter());
            self.rows
                .extend(rows.map(|(r, row)| (*r, row.iter().copied().collect())));
        }
        if let Some(seen) = &reading.seen
            && let Ok(lengths) = self.model.geometry().lengths_m(seen)
        {
            for (i, length) in lengths.iter().enumerate() {
                let off = crate::machine::paid_out_m(
                    self.model.robot(),
                    i,
                    *length,
                    reading.tensions_n[i],
                );
                let mut row = vec![0.0; count];
                row[i] = 1.0 / self.sigmas.seen_m;
                self.rows
                    .push(((off - reading.lengths_m[i]) / self.sigmas.seen_m, row));
            }
        }
        self.readings += 1;
        Ok(())
    }

    /// Number of readings so far.
    #[must_use]
    pub const fn readings(&self) -> usize {
        self.readings
    }

    /// What the readings so far say.
    #[must_use]
    pub fn finding(&self) -> Finding {
        let before: f64 = self.rows.iter().map(|(r, _)| r * r).sum();
        let count = self.model.robot().cables.len();
        let mut fits: Vec<(usize, f64, f64, f64)> = (0..count)
            .map(|j| {
                let square: f64 = self.rows.iter().map(|(_, row)| row[j] * row[j]).sum();
                let dot: f64 = self.rows.iter().map(|(r, row)| r * row[j]).sum();
                let square = square.max(1e-12);
                (j, dot / square, 1.0 / square.sqrt(), dot * dot / square)
            })
            .collect();
        fits.sort_by(|a, b| b.3.total_cmp(&a.3));
        let freedom = self.rows.len().saturating_sub(1).max(1) as f64;
        let Some(&(cable, slip_m, sigma_m, gain)) = fits.first() else {
            return Finding::Holds;
        };
        let second = fits.get(1).map_or(0.0, |fit| fit.3);
        if gain > SURE && gain - second > LEAD {
            let ratio = (before - gain) / freedom;
            if ratio > RATIO_MAX {
                return Finding::NoLongerHolds { ratio };
            }
            return Finding::Cable {
                cable: cable + 1,
                slip_m,
                sigma_m,
            };
        }
        if gain > SURE {
            return Finding::Slip { about_m: slip_m };
        }
        let ratio = before / freedom;
        if ratio > RATIO_MAX {
            return Finding::NoLongerHolds { ratio };
        }
        Finding::Holds
    }
}
