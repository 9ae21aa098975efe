//! Corrections to the length of an ideal cable: stretch, and sag under its own weight.
//!
//! The tangent point on the pulley is that of the straight cable; for the small sags where these
//! corrections are useful, its shift changes the length in second order only.

use crate::error::{Error, Solver};
use crate::inverse::CablePath;
use crate::math::{asinh, cosh, sinh, sqrt};

/// Material and routing of a cable.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CableMaterial {
    /// Axial stiffness EA, N; `None` for inextensible.
    pub ea_n: Option<f64>,
    /// Unstretched length behind the anchor (to the drum) that stretches as well, m.
    pub routing_length_m: f64,
    /// Weight per length, N/m.
    pub weight_n_per_m: f64,
}

/// Which corrections to apply.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Correction {
    /// None: the taut geometric length.
    #[default]
    Geometric,
    /// Stretch only.
    Elastic,
    /// Stretch, and sag as a parabola.
    Parabola,
    /// Stretch, and sag as a catenary.
    Catenary,
}

/// A length and the contributions of the corrections.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CorrectedLength {
    /// Unstretched length from anchor to attachment to pay out, m:
    /// geometric + sag - stretch.
    pub unstretched_m: f64,
    /// Stretch under tension, routing included, m.
    pub stretch_m: f64,
    /// Arc length minus chord of the straight part, m.
    pub sag_m: f64,
    /// Cable weight over tension, w s / T: the parabola is good to about its square; above about
    /// 0.1 the taut-cable statics of this crate no longer hold.
    pub weight_ratio: f64,
}

/// The length to pay out for a cable at a pose under a tension at the platform (N).
///
/// Source: Hooke's law over cable and routing; parabola: w^2 l^2 s/(24 T^2) with horizontal span l
/// and chord s (Irvine, 1981, to first order); catenary: `catenary_excess_m`.
///
/// # Errors
/// [`Error::InvalidInput`] for a value that is not finite, positive tension included;
/// [`Error::NotConverged`] if the tension cannot carry the cable's weight.
///
/// ```
/// use mcdpr_kinematics::{CableMaterial, CablePath, Correction, corrected_length};
/// // 1 m at 10 N and EA = 1000 N stretches by 1 %: 1/1.01 m is paid out.
/// let path = CablePath { length_m: 1.0, ..Default::default() };
/// let material = CableMaterial { ea_n: Some(1e3), routing_length_m: 0.0, weight_n_per_m: 0.0 };
/// let got = corrected_length(&path, 10.0, &material, Correction::Elastic)?;
/// assert!((got.unstretched_m - 1.0 / 1.01).abs() < 1e-15);
/// # Ok::<(), mcdpr_kinematics::Error>(())
/// ```
pub fn corrected_length(
    path: &CablePath,
    tension_n: f64,
    material: &CableMaterial,
    correction: Correction,
) -> Result<CorrectedLength, Error> {
    let check = |what, value: f64, ok: bool| {
        if ok && value.is_finite() {
            Ok(())
        } else {
            Err(Error::InvalidInput {
                what,
                cable: None,
                value,
            })
        }
    };
    check(
        "the length must be positive",
        path.length_m,
        path.length_m > 0.0,
    )?;
    check("the tension must be positive", tension_n, tension_n > 0.0)?;
    let (w, routing) = (material.weight_n_per_m, material.routing_length_m);
    check("the cable's weight must be zero or positive", w, w >= 0.0)?;
    check(
        "the routing length must be zero or positive",
        routing,
        routing >= 0.0,
    )?;
    let chord = path.attachment_m - path.tangent_point_m;
    let horizontal = sqrt(chord.x * chord.x + chord.y * chord.y);
    let straight = chord.norm();
    let mut out = CorrectedLength {
        weight_ratio: w * straight / tension_n,
        ..CorrectedLength::default()
    };
    out.sag_m = match correction {
        Correction::Parabola => {
            let ratio = w * horizontal / tension_n;
            ratio * ratio * straight / 24.0
        }
        Correction::Catenary => catenary_excess_m(horizontal, chord.z, w, tension_n)?,
        Correction::Geometric | Correction::Elastic => 0.0,
    };
    let arc = path.length_m + out.sag_m;
    if let (Some(ea), false) = (material.ea_n, correction == Correction::Geometric) {
        check("the stiffness EA must be positive", ea, ea > 0.0)?;
        // (unstretched + routing)(1 + T/EA) = arc + stretched routing: with the routing given
        // unstretched, all of the stretch comes out at the anchor.
        out.unstretched_m = (arc - routing * (tension_n / ea)) / (1.0 + tension_n / ea);
        out.stretch_m = arc - out.unstretched_m;
    } else {
        out.unstretched_m = arc;
    }
    Ok(out)
}

/// Arc length minus chord of a catenary, m, on its taut branch.
///
/// `horizontal_m` is the horizontal span, `rise_m` the height of the platform's end over the other
/// end, `weight_n_per_m` the weight per length, `tension_n` the tension at the platform's end.
///
/// # Errors
/// [`Error::InvalidInput`]; [`Error::NotConverged`] if no taut catenary has so little tension.
pub(crate) fn catenary_excess_m(
    horizontal_m: f64,
    rise_m: f64,
    weight_n_per_m: f64,
    tension_n: f64,
) -> Result<f64, Error> {
    let (l, w) = (horizontal_m, weight_n_per_m);
    for value in [l, w, tension_n, rise_m.abs()] {
        if !(value >= 0.0 && value.is_finite()) {
            return Err(Error::InvalidInput {
                what: "span, weight and tension must be zero or positive",
                cable: None,
                value,
            });
        }
    }
    let chord = sqrt(l * l + rise_m * rise_m);
    // A vertical cable hangs straight, whatever it weighs.
    if w == 0.0 || l < 1e-9 * chord || chord == 0.0 {
        return Ok(0.0);
    }
    // With a = H/w and u = l/(2a): the platform's end lies at m + u, sinh(m) = rise/(2 a sinh u).
    let end_tension = |a: f64| {
        let u = l / (2.0 * a);
        let m = asinh(rise_m / (2.0 * a * sinh(u)));
        w * a * cosh(m + u)
    };
    // T >= w a bounds a from above; going down, the first tension below the given one brackets it.
    let mut high = tension_n / w;
    let mut low = high;
    loop {
        low *= 0.9;
        let at = end_tension(low);
        if at <= tension_n {
            break;
        }
        // H / w far below the span is a deep loop: no taut cable has so little tension.
        if !at.is_finite() || low < 1e-3 * l {
            return Err(Error::NotConverged {
                solver: Solver::Catenary,
                iterations: 0,
                residual: tension_n,
            });
        }
        high = low;
    }
    for _ in 0..200 {
        let middle = 0.5 * (low + high);
        if middle <= low || middle >= high {
            break;
        }
        if end_tension(middle) > tension_n {
            high = middle;
        } else {
            low = middle;
        }
    }
    let u = l / (low + high);
    // (sinh(u)/u)^2 - 1 without cancellation.
    let excess = if u < 0.1 {
        let v = u * u;
        v / 3.0 * (1.0 + v * (2.0 / 15.0) * (1.0 + v / 14.0 * (1.0 + 2.0 * v / 45.0)))
    } else {
        let q = sinh(u) / u;
        q * q - 1.0
    };
    let difference = l * l * excess;
    Ok(difference / (sqrt(chord * chord + difference) + chord))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    #[test]
    fn the_level_catenary_is_the_textbook_one() {
        // a = 2 m, span 1 m, level ends: S = 2 a sinh(1/4), T = w a cosh(1/4).
        let (a, w) = (2.0_f64, 3.0);
        let tension = w * a * 0.25_f64.cosh();
        let got = catenary_excess_m(1.0, 0.0, w, tension).unwrap();
        assert!(
            (got - (2.0 * a * 0.25_f64.sinh() - 1.0)).abs() < 1e-13,
            "{got}"
        );
    }

    #[test]
    fn an_inclined_catenary_agrees_with_integration() {
        // Integrate from the platform's end: slope and tension by components.
        let (l, rise, w, tension) = (0.8, -0.5, 0.4, 3.0);
        let excess = catenary_excess_m(l, rise, w, tension).unwrap();
        let length = excess + f64::hypot(l, rise);
        // Vertical force at the platform's end by shooting on the horizontal component.
        let span_and_rise = |h: f64| {
            let v_end = -(tension * tension - h * h).sqrt();
            // The vertical component at arc length s from the frame's end.
            let v_at = |s: f64| v_end - w * (length - s);
            let n = 20_000;
            let (mut x, mut z) = (0.0, 0.0);
            for k in 0..n {
                let s = (f64::from(k) + 0.5) / f64::from(n) * length;
                let v = v_at(s);
                let t = h.hypot(v);
                x += h / t * length / f64::from(n);
                z += v / t * length / f64::from(n);
            }
            (x, z)
        };
        let (mut low, mut high) = (0.0, tension);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if span_and_rise(middle).0 < l {
                low = middle;
            } else {
                high = middle;
            }
        }
        let (x, z) = span_and_rise(low);
        assert!((x - l).abs() < 1e-7, "{x}");
        assert!((z - rise).abs() < 1e-6, "{z}");
    }

    #[test]
    fn the_parabola_is_the_limit_of_the_catenary() {
        let path = CablePath {
            length_m: 1.0,
            tangent_point_m: Vector3::zeros(),
            attachment_m: Vector3::new(0.8, 0.0, -0.6),
            ..CablePath::default()
        };
        for (w, bound) in [(0.01, 2e-3), (0.001, 2e-4)] {
            let material = CableMaterial {
                ea_n: None,
                routing_length_m: 0.0,
                weight_n_per_m: w,
            };
            let of = |c| corrected_length(&path, 5.0, &material, c).unwrap().sag_m;
            let (p, c) = (of(Correction::Parabola), of(Correction::Catenary));
            assert!(p > 0.0 && (p / c - 1.0).abs() < bound, "{p:e} {c:e}");
        }
    }

    #[test]
    fn a_cable_too_heavy_for_its_tension_is_refused() {
        assert!(catenary_excess_m(1.0, 0.0, 10.0, 1.0).is_err());
        assert!(catenary_excess_m(f64::NAN, 0.0, 10.0, 1.0).is_err());
        assert_eq!(catenary_excess_m(0.0, -1.0, 10.0, 1.0), Ok(0.0));
    }

    #[test]
    fn stretch_is_hookes_law_over_cable_and_routing() {
        let path = CablePath {
            length_m: 0.5,
            ..CablePath::default()
        };
        let material = CableMaterial {
            ea_n: Some(5e4),
            routing_length_m: 1.0,
            weight_n_per_m: 0.0,
        };
        let got = corrected_length(&path, 25.0, &material, Correction::Elastic).unwrap();
        // T = EA (arc - unstretched) / (unstretched + routing), as the static solver has it.
        let tension = 5e4 * (0.5 - got.unstretched_m) / (got.unstretched_m + 1.0);
        assert!((tension - 25.0).abs() < 1e-9);
        assert!((got.stretch_m - (0.5 - got.unstretched_m)).abs() < 1e-16);
        let plain = corrected_length(&path, 25.0, &material, Correction::Geometric).unwrap();
        assert_eq!((plain.unstretched_m, plain.stretch_m), (0.5, 0.0));
        assert!(corrected_length(&path, -1.0, &material, Correction::Elastic).is_err());
    }
}
