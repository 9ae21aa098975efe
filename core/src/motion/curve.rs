//! A smooth curve through points, measured by arc length.

use super::path::{PathError, PathPoint, near};
use super::spline::{Ends, Spline};
use nalgebra::Vector3;

/// Intervals between two points in which the arc length is tabulated.
const INTERVALS: usize = 64;

/// Splines through points over the sum of chords (Lee, 1989, with exponent 1), with the table that
/// turns arc length into their parameter.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Curve {
    axes: [Spline; 3],
    /// Parameter and arc length, ascending in both.
    table: Vec<(f64, f64)>,
    least_radius_m: f64,
}

impl Curve {
    /// The curve through at least three points; consecutive points must differ.
    pub(super) fn through(points_m: &[Vector3<f64>]) -> Result<Self, PathError> {
        let mut chords = vec![0.0];
        let mut sum = 0.0;
        for (index, pair) in points_m.windows(2).enumerate() {
            let [a, b] = pair else { continue };
            let chord_m = (b - a).norm();
            if !chord_m.is_finite() {
                return Err(PathError::NotFinite { what: "a point" });
            }
            near(a)?;
            near(b)?;
            if chord_m < 1e-6 {
                return Err(PathError::Repeated { point: index + 2 });
            }
            sum += chord_m;
            chords.push(sum);
        }
        let axis = |pick: fn(&Vector3<f64>) -> f64| {
            let values: Vec<_> = points_m.iter().map(pick).collect();
            Spline::interpolate(&chords, &values, Ends::NotAKnot)
                .map_err(|_| PathError::NotFinite { what: "a point" })
        };
        let axes = [axis(|p| p.x)?, axis(|p| p.y)?, axis(|p| p.z)?];
        let mut curve = Self {
            axes,
            table: vec![(0.0, 0.0)],
            least_radius_m: f64::INFINITY,
        };
        let (mut at, mut length_m) = (0.0, 0.0);
        for pair in chords.windows(2) {
            let &[from, to] = pair else { continue };
            let step = (to - from) / INTERVALS as f64;
            for index in 1..=INTERVALS {
                let next = from + step * index as f64;
                // Simpson's rule: of the fifth order in an interval this short.
                let ends = curve.speed(at) + curve.speed(next);
                length_m += (next - at) / 6.0 * (ends + 4.0 * curve.speed(0.5 * (at + next)));
                curve.table.push((next, length_m));
                let bend = curve.at_parameter(next).curvature_per_m.norm();
                // A straight part counts as a radius of 1e9 m.
                curve.least_radius_m = curve.least_radius_m.min(1.0 / bend.max(1e-9));
                at = next;
            }
        }
        Ok(curve)
    }

    /// Arc length, m.
    pub(super) fn length_m(&self) -> f64 {
        self.table.last().map_or(0.0, |last| last.1)
    }

    /// Least radius of curvature, m.
    pub(super) const fn least_radius_m(&self) -> f64 {
        self.least_radius_m
    }

    /// The point at an arc length.
    pub(super) fn at(&self, way_m: f64) -> PathPoint {
        let later = self.table.partition_point(|(_, length)| *length < way_m);
        let pair = later.checked_sub(1).and_then(|i| self.table.get(i..i + 2));
        let parameter = match pair {
            Some(&[(from, before), (to, after)]) => {
                let mut guess = from + (to - from) * (way_m - before) / (after - before);
                // One correction: the speed hardly changes in an interval.
                let middle = self.speed(0.5 * (from + guess));
                let reached = before
                    + (guess - from) / 6.0 * (self.speed(from) + 4.0 * middle + self.speed(guess));
                guess += (way_m - reached) / self.speed(guess).max(1e-9);
                guess
            }
            _ if later == 0 => 0.0,
            _ => self.table.last().map_or(0.0, |last| last.0),
        };
        self.at_parameter(parameter)
    }

    fn sample(&self, parameter: f64) -> [Vector3<f64>; 3] {
        let (from, to) = self.axes[0].span_s();
        let at = parameter.clamp(from, to);
        let mut out = [Vector3::zeros(); 3];
        for (axis, spline) in self.axes.iter().enumerate() {
            // Inside the span there is a sample.
            if let Ok(found) = spline.sample(at) {
                out[0][axis] = found.value;
                out[1][axis] = found.velocity;
                out[2][axis] = found.acceleration;
            }
        }
        out
    }

    fn speed(&self, parameter: f64) -> f64 {
        self.sample(parameter)[1].norm()
    }

    fn at_parameter(&self, parameter: f64) -> PathPoint {
        let [position_m, first, second] = self.sample(parameter);
        let speed = first.norm().max(1e-12);
        let tangent = first / speed;
        PathPoint {
            position_m,
            tangent,
            curvature_per_m: (second - tangent * second.dot(&tangent)) / (speed * speed),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_of_a_circle_give_its_length_radius_and_places() {
        let radius = 0.1;
        let points: Vec<_> = (0..=24)
            .map(|i| {
                let (sin, cos) = libm::sincos(std::f64::consts::PI * f64::from(i) / 24.0);
                Vector3::new(radius * cos, radius * sin, 0.2)
            })
            .collect();
        let curve = Curve::through(&points).unwrap();
        let length = std::f64::consts::PI * radius;
        assert!(
            (curve.length_m() - length).abs() < 2e-6,
            "{}",
            curve.length_m()
        );
        assert!((curve.least_radius_m() - radius).abs() < 3e-3);
        for step in 0..=100 {
            let way = curve.length_m() * f64::from(step) / 100.0;
            let point = curve.at(way);
            assert!((point.position_m.xy().norm() - radius).abs() < 3e-6);
            let angle = libm::atan2(point.position_m.y, point.position_m.x);
            assert!((angle * radius - way).abs() < 5e-6, "{way}");
            assert!((point.tangent.norm() - 1.0).abs() < 1e-9);
        }
        // Coordinate by coordinate: the arc length is the parameter.
        let h = 1e-5;
        let chord = (curve.at(0.1 + h).position_m - curve.at(0.1).position_m).norm();
        assert!((chord / h - 1.0).abs() < 1e-4, "{chord}");
    }

    #[test]
    fn points_that_stand_still_are_named() {
        let a = Vector3::new(0.0, 0.0, 0.0);
        let b = Vector3::new(0.1, 0.0, 0.0);
        let error = Curve::through(&[a, b, b]).unwrap_err();
        assert_eq!(error, PathError::Repeated { point: 3 });
    }
}
