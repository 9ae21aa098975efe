//! How far an error of a known covariance reaches.

use nalgebra::{Matrix3, Matrix3x6, Vector3};

/// The quantile of a chi-square distribution at a normal deviate (Wilson and Hilferty 1931).
#[must_use]
pub(crate) fn chi2_quantile(freedoms: f64, deviate: f64) -> f64 {
    let part = 2.0 / (9.0 * freedoms);
    let root = (1.0 - part + deviate * part.sqrt()).max(0.0);
    freedoms * root * root * root
}

/// Radius that holds an error of this covariance in 95 % of cases, m: its square is taken for a
/// scaled chi-square of the same mean and variance (Satterthwaite 1946).
///
/// `limited_m2` is the part of the covariance by errors that are known within limits, such as a place after a
/// calibration: a uniform distribution (GUM, JCGM 100:2008, 4.3.7). Its fourth cumulant is -1.2 times its squared
/// variance, so large errors are rarer than with a normal distribution.
#[must_use]
pub(crate) fn radius_95_m(covariance_m2: &Matrix3<f64>, limited_m2: &Matrix3<f64>) -> f64 {
    radius_m(covariance_m2, limited_m2, 1.645)
}

/// As [`radius_95_m`] in 99.9 % of cases, m.
#[must_use]
pub(crate) fn radius_999_m(covariance_m2: &Matrix3<f64>, limited_m2: &Matrix3<f64>) -> f64 {
    radius_m(covariance_m2, limited_m2, 3.090)
}

/// As [`radius_95_m`] for the quantile of a standard normal deviate.
fn radius_m(covariance_m2: &Matrix3<f64>, limited_m2: &Matrix3<f64>, deviate: f64) -> f64 {
    let mean = covariance_m2.trace();
    let normal = 2.0 * (covariance_m2 * covariance_m2).trace();
    if mean.is_nan() || mean <= 0.0 || normal <= 0.0 {
        return 0.0;
    }
    let limited = 1.2 * limited_m2.diagonal().norm_squared();
    // A part of the covariance: the variance stays positive.
    let variance = (normal - limited).max(0.2 * normal);
    let freedoms = 2.0 * mean * mean / variance;
    (variance / (2.0 * mean) * chi2_quantile(freedoms, deviate)).sqrt()
}

/// Shift of the tool (world, m) per shift (m) and turn (rad, world) of the platform, the tool at `arm` from its origin
/// (world, m).
#[must_use]
pub(crate) fn tool_per_pose(arm: &Vector3<f64>) -> Matrix3x6<f64> {
    let mut out = Matrix3x6::identity();
    out.fixed_view_mut::<3, 3>(0, 3)
        .copy_from(&-arm.cross_matrix());
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    #[test]
    fn a_quantile_is_that_of_the_tables() {
        let q95 = chi2_quantile(3.0, 1.645);
        assert!((q95 - 7.815).abs() < 0.05, "{q95}");
    }

    #[test]
    fn the_radius_holds_95_percent_of_draws() {
        let mut random = Random::new(11);
        for sigmas in [
            [1.0, 1.0, 1.0],
            [1.0, 0.3, 0.1],
            [1.0, 0.0, 0.0],
            [1.0, 1.0, 0.1],
        ] {
            let covariance = Matrix3::from_diagonal(&Vector3::from(sigmas).map(|s| s * s));
            let radius = radius_95_m(&covariance, &Matrix3::zeros());
            let inside = (0..40_000)
                .filter(|_| {
                    let at = Vector3::from(sigmas).map(|sigma| sigma * random.normal());
                    at.norm() <= radius
                })
                .count();
            let share = inside as f64 / 40_000.0;
            assert!((0.943..=0.957).contains(&share), "{sigmas:?}: {share}");
        }
    }

    #[test]
    fn errors_within_limits_reach_less_far() {
        // Uniform on a cube of half width 1.732: 95 % are within 2.39, and none is beyond 3.
        let one = Matrix3::identity();
        assert!((radius_95_m(&one, &one) - 2.39).abs() < 0.06);
        // 16.27 is the 99.9 % quantile of chi-square with three degrees of freedom.
        assert!((radius_999_m(&one, &Matrix3::zeros()) - 16.27_f64.sqrt()).abs() < 0.05);
    }
}
