//! Elementary functions that do not depend on the system's C library, and the arc-tangent of the hot path.
//!
//! The C library's functions differ between systems, versions and processors in the last bit; libm's are
//! plain Rust. So a seed means the same run in the program and in a browser.

pub(crate) use libm::{asinh, atan2, cosh, log as ln, sincos as sin_cos, sinh};

/// Correctly rounded everywhere; an instruction of its own on most processors.
#[inline(always)]
pub(crate) fn sqrt(x: f64) -> f64 {
    #[cfg(feature = "std")]
    return x.sqrt();
    #[cfg(not(feature = "std"))]
    return libm::sqrt(x);
}

/// Coefficients of atan(u)/u in powers of u^2 on |u| <= tan(pi/8), interpolated at Chebyshev
/// nodes in 50-digit arithmetic; relative error below 7e-17 before rounding.
#[allow(clippy::excessive_precision)]
const ATAN: [f64; 11] = [
    1.0,
    -0.3333333333332844,
    0.19999999998855109,
    -0.14285714180976392,
    0.11111106180452865,
    -0.0909077307473686,
    0.07689953495298942,
    -0.06640233921673451,
    0.056883491809884175,
    -0.04348052083340628,
    0.021135371536498415,
];

/// Angle in `[0, 2 pi)` of the vector `(cos, sin)` whose norm is `norm`.
///
/// The vector is folded into the first octant and halved by tan(phi/2) = sin/(norm + cos), so one
/// division and one polynomial give full precision, without a branch.
#[inline(always)]
pub(crate) fn angle_of(sin: f64, cos: f64, norm: f64) -> f64 {
    use core::f64::consts::{FRAC_PI_2, PI};
    let (s, c) = (sin.abs(), cos.abs());
    let steep = s > c;
    let small = if steep { c } else { s };
    let large = if steep { s } else { c };
    let u = small / (norm + large);
    let v = u * u;
    let v2 = v * v;
    let v4 = v2 * v2;
    let p01 = ATAN[0] + ATAN[1] * v;
    let p23 = ATAN[2] + ATAN[3] * v;
    let p45 = ATAN[4] + ATAN[5] * v;
    let p67 = ATAN[6] + ATAN[7] * v;
    let p89 = ATAN[8] + ATAN[9] * v;
    let low = p01 + p23 * v2;
    let mid = p45 + p67 * v2;
    let high = p89 + ATAN[10] * v2;
    let poly = low + (mid + high * v4) * v4;
    let octant = 2.0 * u * poly;
    let quadrant = if steep { FRAC_PI_2 - octant } else { octant };
    let half = if cos < 0.0 { PI - quadrant } else { quadrant };
    if sin < 0.0 { 2.0 * PI - half } else { half }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_angle_agrees_with_atan2_over_the_whole_turn() {
        let mut worst: f64 = 0.0;
        for i in 0..200_001 {
            let angle = f64::from(i) * core::f64::consts::TAU / 200_001.0;
            let (s, c) = sin_cos(angle);
            let (s, c) = (3.7 * s, 3.7 * c);
            let mut want = atan2(s, c);
            if want < 0.0 {
                want += core::f64::consts::TAU;
            }
            let got = angle_of(s, c, sqrt(s * s + c * c));
            worst = worst.max((got - want).abs() / want.max(1e-3));
        }
        assert!(worst < 5e-16, "worst relative error {worst:e}");
    }
}
