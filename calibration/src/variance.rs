//! Scatter and priors that the data widen.
//!
//! What is assumed of a machine holds for a good one. On a real one each drum has its own radius, each
//! load cell its own zero, and the equations of equilibrium do not close. Each such group has one standard
//! deviation, which is estimated by variance components: the sum of the squared residuals over the sum of
//! their redundancies (Foerstner, 1979). It changes only where the residuals, each over its own standard
//! deviation, are larger than chance explains, and never falls below what was assumed: the estimate from
//! data of a good machine is the same as without it.

use super::normal::{Normal, Weights};
use super::rows::{Model, Scatter, Source};
use super::unknowns::{Part, Priors, State};
use mcdpr_kinematics::Descent;
use nalgebra::DMatrix;

/// Leverage and residual of each row at a minimum.
pub(crate) struct Rows {
    /// Leverage of each row, by pose.
    pub leverage: Weights,
    /// Source of each row.
    pub sources: Vec<Vec<Source>>,
}

/// Greatest change of a standard deviation in one round.
const STEP: f64 = 8.0;
/// A smaller change does not count.
const LITTLE: f64 = 1.02;
/// Redundancy below which a prior's residual says nothing but rounding.
const NOTHING: f64 = 1e-9;
/// Standard deviations of the mean square above which equilibrium counts as disturbed.
const DISTURBED: f64 = 4.0;
/// The same where the machine has shown another error already: such machines have them all.
const DISTURBED_ALREADY: f64 = 0.5;

/// Mean of `count` squares of standard normal numbers that is exceeded by chance in 1 of 1000 cases (Wilson
/// and Hilferty, 1931).
fn chance(count: f64) -> f64 {
    const Z: f64 = 3.09;
    let part = 2.0 / (9.0 * count);
    (1.0 - part + Z * part.sqrt()).powi(3)
}

/// Direction and block of a balance row: force or moment, level or vertical.
fn block_of(axis: usize) -> (usize, usize) {
    (axis / 3, usize::from(axis % 3 == 2))
}

/// Redundancy of the equations of equilibrium whose scatter the data have widened, force and moment, level and vertical:
/// the degrees of freedom of these estimates. `None` where nothing was widened.
pub(crate) fn freedoms(model: &Model<'_>, rows: &Rows, weights: &Weights) -> [[Option<f64>; 2]; 2] {
    let (now, least) = (model.scatter, model.assumed);
    let now = [now.force_n, now.moment_nm];
    let least = [least.force_n, least.moment_nm];
    let mut sums = [[None; 2]; 2];
    for (k, sources) in rows.sources.iter().enumerate() {
        for (j, source) in sources.iter().enumerate() {
            let Source::Balance(axis) = source else {
                continue;
            };
            let (block, direction) = block_of(*axis);
            if now[block][direction] > least[block][direction] && weights[k][j] > 0.0 {
                *sums[block][direction].get_or_insert(0.0) += 1.0 - rows.leverage[k][j];
            }
        }
    }
    sums
}

/// Factor on a covariance whose scale was estimated with this many degrees of freedom, so that the 95 % region of
/// chi-square in space is that of Fisher's distribution, 3 F(3, freedom). Within 0.5 % of the tables from 10 degrees
/// of freedom on (Abramowitz and Stegun, 1964, table 26.9).
pub(crate) fn of_fisher(freedom: f64) -> f64 {
    let f = freedom.max(5.0);
    1.0 + 3.39 / f + 7.9 / (f * f)
}

/// What is adapted, and what the data were solved with.
pub(crate) struct Widening<'a, 'd> {
    /// Its scatter is adapted.
    pub model: &'a mut Model<'d>,
    /// Adapted.
    pub priors: &'a mut Priors,
    /// The priors before the data.
    pub assumed: &'a Priors,
}

impl Widening<'_, '_> {
    /// Adapts priors and the scatter of equilibrium at an estimate. Returns whether any has changed.
    pub(crate) fn step(
        &mut self,
        descent: &Descent<State, Normal>,
        rows: &Rows,
        covariance: &DMatrix<f64>,
        weights: &Weights,
    ) -> bool {
        let shown = self.shown();
        let others = Part::ALL.iter().filter(|part| **part != Part::Radii);
        let mut changed = false;
        for part in others {
            changed |= self.widen_prior(*part, descent, covariance, shown);
        }
        if self.model.layout.statics {
            changed |= self.widen_balance(&descent.linear, rows, weights, shown);
        }
        // Only what all else does not explain shows a wrong radius. Data that tell little of radii, as of a robot in a plane,
        // bend them to explain a sensor's zero, and once they are free nothing holds them.
        if !changed || self.priors.radius_m > self.assumed.radius_m {
            changed |= self.widen_prior(Part::Radii, descent, covariance, shown);
        }
        changed
    }

    /// Whether anything is wider than assumed.
    fn shown(&self) -> bool {
        let Scatter {
            force_n, moment_nm, ..
        } = self.model.scatter;
        let least = self.model.assumed;
        let (now, before) = (&self.priors, self.assumed);
        force_n != least.force_n
            || moment_nm != least.moment_nm
            || now.drum_own > before.drum_own
            || now.zero_n > before.zero_n
            || now.loss > before.loss
            || now.center_of_mass_m > before.center_of_mass_m
    }

    fn widen_prior(
        &mut self,
        part: Part,
        descent: &Descent<State, Normal>,
        covariance: &DMatrix<f64>,
        shown: bool,
    ) -> bool {
        let layout = &self.model.layout;
        let all = descent.at.priors(self.model.data, layout, self.priors);
        let least = descent.at.priors(self.model.data, layout, self.assumed);
        let range = part.range(layout);
        let (mut squares, mut redundancy, mut studentised, mut count) = (0.0, 0.0, 0.0, 0.0);
        let mut over = 1.0_f64;
        for (prior, assumed) in all.iter().zip(&least) {
            if !range.contains(&prior.index) {
                continue;
            }
            let variance = prior.sigma * prior.sigma;
            let free = 1.0 - covariance[(prior.index, prior.index)] / variance;
            over = prior.sigma / assumed.sigma;
            if free < NOTHING {
                continue;
            }
            let square = prior.deviation * prior.deviation / variance;
            squares += square;
            redundancy += free;
            studentised += square / free;
            count += 1.0;
        }
        // A wrong radius is a mistake, which one error more does not make likely.
        let limit = if shown && part != Part::Radii {
            1.0
        } else {
            chance(count)
        };
        if over < LITTLE && (count == 0.0 || studentised / count < limit) {
            return false;
        }
        let ratio = squares / redundancy.max(NOTHING);
        // Back to what was assumed at most.
        let by = ratio.sqrt().clamp(1.0 / STEP, STEP).max(1.0 / over);
        if (1.0 / LITTLE..=LITTLE).contains(&by) {
            return false;
        }
        part.widen(self.priors, by);
        true
    }

    fn widen_balance(
        &mut self,
        normal: &Normal,
        rows: &Rows,
        weights: &Weights,
        shown: bool,
    ) -> bool {
        let mut changed = false;
        let assumed = self.model.assumed;
        let all = [assumed.force_n, assumed.moment_nm];
        for (block, direction) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            let belongs = |axis: usize| block_of(axis) == (block, direction);
            let (mut squares, mut redundancy) = (0.0, 0.0);
            for (k, sources) in rows.sources.iter().enumerate() {
                for (j, source) in sources.iter().enumerate() {
                    let own = matches!(source, Source::Balance(axis) if belongs(*axis));
                    if own && weights[k][j] > 0.0 {
                        squares += normal.residuals[k][j].powi(2);
                        redundancy += 1.0 - rows.leverage[k][j];
                    }
                }
            }
            let redundancy = redundancy.max(1e-6);
            let scatter = &mut self.model.scatter;
            let sigma = match block {
                0 => &mut scatter.force_n[direction],
                _ => &mut scatter.moment_nm[direction],
            };
            let ratio = squares / redundancy;
            let sure = if shown { DISTURBED_ALREADY } else { DISTURBED };
            let over = *sigma / all[block][direction];
            if over < LITTLE && ratio < 1.0 + sure * (2.0 / redundancy).sqrt() {
                continue;
            }
            let by = ratio.sqrt().clamp(1.0 / STEP, STEP).max(1.0 / over);
            if !(1.0 / LITTLE..=LITTLE).contains(&by) {
                *sigma *= by;
                changed = true;
            }
        }
        changed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_region_is_that_of_fishers_distribution() {
        // 3 F(3, n) at 95 % over 7.815, from tables.
        for (freedom, f) in [
            (10.0, 3.708),
            (20.0, 3.098),
            (30.0, 2.922),
            (60.0, 2.758),
            (120.0, 2.680),
        ] {
            let right = 3.0 * f / 7.815;
            assert!((of_fisher(freedom) / right - 1.0).abs() < 5e-3, "{freedom}");
        }
        assert!(of_fisher(1e9) < 1.0 + 1e-8);
    }

    #[test]
    fn a_machine_whose_scatter_is_estimated_states_more_and_a_clean_one_does_not() {
        use super::super::check::usable;
        use super::super::fit::{Options, model, start};
        use super::super::simulate::{Setup, simulate};
        use super::super::solve::solve;
        for found in [false, true] {
            let setup = Setup {
                found,
                ..Setup::default()
            };
            let (data, _) = simulate(&setup).unwrap();
            let (usable, options) = (usable(&data).unwrap(), Options::default());
            let model = model(&usable, &options);
            let minimum = solve(&model, &options.priors, start(&usable, &model.layout)).unwrap();
            let known = minimum.reduced.covariance().unwrap();
            let factor = minimum.covariance[(0, 0)] / known[(0, 0)];
            assert_eq!(found, factor > 1.02, "{factor}");
            assert!(found || (factor - 1.0).abs() < 1e-12, "{factor}");
        }
    }
}
