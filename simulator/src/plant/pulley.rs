//! Geometry of a cable over a swivelling pulley, derived for the plant alone.
//!
//! The cable reaches the fixed point `B` travelling along the swivel axis `a`, wraps a circle of
//! radius `R` whose plane holds `a` and the attachment `A`, leaves it tangentially and runs
//! straight to `A`. With `e` the unit vector across the axis toward `A`, the circle's centre is
//! `C = B + R e`. Describe points of the plane by the complex number `(-e part) + i (a part)`
//! seen from `C`: then `B` sits at angle 0, the cable turns through growing angles, the tangent
//! point sits at the wrap angle `w`, and `A` at `w + acos(R / |A - C|)`, because `C`, the tangent
//! point and `A` form a right triangle. Multiplying by the conjugate of `R + i s` removes the
//! triangle's angle without an inverse cosine.

use super::vec3::{V3, axpy, dot, scale, sub};

/// A cable's path for one attachment position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Path {
    /// From `B` to the attachment, arc included (m).
    pub length_m: f64,
    /// Unit vector from the tangent point to the attachment, world frame. The cable pulls the
    /// platform along its negative.
    pub direction: V3,
}

/// The fixed parts of a pulley.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pulley {
    /// Entry point `B`, world frame (m).
    pub anchor_m: V3,
    /// Unit swivel axis: where the cable is heading when it reaches `B`.
    pub axis: V3,
    /// Radius of the cable's arc (m); 0 is a point anchor.
    pub radius_m: f64,
}

impl Pulley {
    /// The path to an attachment at `point_m` (world frame), or `None` if no path exists: on the
    /// axis, or inside the circle.
    #[inline(always)]
    pub(crate) fn path_to(&self, point_m: V3) -> Option<Path> {
        let from_b = sub(point_m, self.anchor_m);
        let up = dot(from_b, self.axis);
        let across = axpy(from_b, -up, self.axis);
        let rho_squared = dot(across, across);
        if self.radius_m == 0.0 {
            // No wheel: the cable is straight in any direction, also along the axis.
            let length_m = (rho_squared + up * up).sqrt();
            return (length_m > 1e-9).then(|| Path {
                length_m,
                direction: scale(from_b, 1.0 / length_m),
            });
        }
        let rho = rho_squared.sqrt();
        let out = rho - self.radius_m;
        let to_point_squared = out * out + up * up;
        // The straight part: a right triangle with the radius, its right angle at the tangent
        // point.
        let straight_squared = to_point_squared - self.radius_m * self.radius_m;
        // Negated comparisons refuse NaN as well.
        if !(straight_squared > 0.0 && rho > 1e-9) {
            return None;
        }
        let straight = straight_squared.sqrt();
        let sine = up * self.radius_m + out * straight;
        let cosine = up * straight - out * self.radius_m;
        let mut wrap = libm::atan2(sine, cosine);
        // `atan2` ends at half a turn; a cable can wrap further.
        if wrap < 0.0 {
            wrap += std::f64::consts::TAU;
        }
        let inverse = 1.0 / to_point_squared;
        // The circle's tangent after the wrap angle w is sin(w) e + cos(w) a.
        let direction = axpy(
            scale(across, sine * inverse / rho),
            cosine * inverse,
            self.axis,
        );
        Some(Path {
            length_m: self.radius_m * wrap + straight,
            direction,
        })
    }
}
