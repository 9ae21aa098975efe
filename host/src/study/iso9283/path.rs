//! Path accuracy and path repeatability along a straight line.

use super::{mean, spread};
use nalgebra::Vector3;
use serde::Serialize;

/// Planes across the path in which it is judged.
const PLANES: usize = 20;

/// Accuracy and repeatability of a path.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PathFigures {
    /// ATp: greatest distance of the barycentre of the attained paths from the commanded one, m.
    pub accuracy_m: f64,
    /// RTp: greatest mean distance from the barycentre plus three standard deviations, m.
    pub repeatability_m: f64,
}

/// Judges cycles along a straight line by where they cross planes normal to it (ISO 9283:1998,
/// 8.2 and 8.3).
///
/// - `ends_m`: start and end of the commanded line, world frame, m.
/// - `attained_m`: for each cycle the positions along the way, world frame, m.
///
/// `None` for fewer than two cycles, or where a cycle does not cross every plane.
#[must_use]
pub(crate) fn judge_path(
    ends_m: [&Vector3<f64>; 2],
    attained_m: &[Vec<Vector3<f64>>],
) -> Option<PathFigures> {
    let [from_m, to_m] = ends_m;
    let along = (to_m - from_m).try_normalize(1e-9)?;
    let length_m = (to_m - from_m).norm();
    let mut figures = PathFigures {
        accuracy_m: 0.0,
        repeatability_m: 0.0,
    };
    for plane in 0..PLANES {
        let at_m = length_m * (plane as f64 + 0.5) / PLANES as f64;
        let crossings: Option<Vec<Vector3<f64>>> = attained_m
            .iter()
            .map(|way| crossing(way, from_m, &along, at_m))
            .collect();
        let crossings = crossings?;
        let middle_m = mean(&crossings)?;
        let distances: Vec<f64> = crossings.iter().map(|p| (p - middle_m).norm()).collect();
        let (mean_m, deviation_m) = spread(&distances)?;
        let commanded_m = from_m + along * at_m;
        figures.accuracy_m = figures.accuracy_m.max((middle_m - commanded_m).norm());
        figures.repeatability_m = figures.repeatability_m.max(mean_m + 3.0 * deviation_m);
    }
    Some(figures)
}

/// Where a way first crosses the plane `at_m` along the line.
fn crossing(
    way_m: &[Vector3<f64>],
    from_m: &Vector3<f64>,
    along: &Vector3<f64>,
    at_m: f64,
) -> Option<Vector3<f64>> {
    let along_m = |p: &Vector3<f64>| (p - from_m).dot(along) - at_m;
    way_m.windows(2).find_map(|pair| {
        let [a, b] = pair else { return None };
        let (before, after) = (along_m(a), along_m(b));
        (before <= 0.0 && after > 0.0).then(|| a + (b - a) * (before / (before - after)))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_ways_beside_a_line_have_its_accuracy_in_their_middle() {
        let at = |x: f64, y: f64, z: f64| Vector3::new(x, y, z) * 1e-3;
        let way = |y: f64| (-1..=101).map(|x| at(f64::from(x), y, 3.0)).collect();
        let found = judge_path(
            [&at(0.0, 0.0, 0.0), &at(100.0, 0.0, 0.0)],
            &[way(1.0), way(-1.0)],
        );
        let found = found.unwrap();
        assert!((found.accuracy_m - 3e-3).abs() < 1e-12);
        // Both are 1 mm from the barycentre: no deviation.
        assert!((found.repeatability_m - 1e-3).abs() < 1e-12);
        let short = (0..50).map(|x| at(f64::from(x), 0.0, 0.0)).collect();
        let ends = [&at(0.0, 0.0, 0.0), &at(100.0, 0.0, 0.0)];
        assert_eq!(judge_path(ends, &[way(0.0), short]), None);
    }
}
