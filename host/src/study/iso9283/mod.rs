//! Accuracy as industry measures it: the characteristics of ISO 9283:1998.
//!
//! Five poses in the robot's own cube ([`Cube`]) are visited in cycles ([`simulated`]); what was
//! attained there, by the simulator or by an external tracker, is judged here. The
//! tool of these robots is a point whose attitude follows from gravity, so only positions are
//! judged.

mod cube;
mod path;
pub mod simulated;
pub(crate) mod tracker;

pub use cube::{Cube, CubeError, POSES};
pub use path::PathFigures;
pub(crate) use path::judge_path;

use nalgebra::Vector3;
use serde::Serialize;

/// Least number of cycles: a spread needs two, the standard asks for 30.
pub(crate) const LEAST_CYCLES: usize = 2;

/// Accuracy and repeatability at one pose.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PoseFigures {
    /// AP: distance of the barycentre of the attained positions from the commanded one, m.
    pub accuracy_m: f64,
    /// RP: mean distance from the barycentre plus three standard deviations of it, m.
    pub repeatability_m: f64,
    /// Drift: distance between the barycentres of the first and the last third of the cycles, m.
    pub drift_m: f64,
}

/// Accuracy and repeatability of the distance between two poses.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct DistanceFigures {
    /// AD: mean of the attained distances minus the commanded one, m.
    pub accuracy_m: f64,
    /// RD: three standard deviations of the attained distance, m.
    pub repeatability_m: f64,
}

/// Judges the positions attained at one pose, in the order of the cycles.
///
/// ISO 9283:1998, 7.2.1 (AP) and 7.2.2 (RP). `None` for fewer than two cycles.
///
/// - `commanded_m`: world frame, m.
/// - `attained_m`: one position for each cycle, world frame, m.
///
/// ```
/// use mcdpr::study::iso9283::judge_pose;
/// use nalgebra::Vector3;
///
/// // Two cycles, 1 mm to either side of a place 2 mm above the commanded one.
/// let attained = [Vector3::new(1e-3, 0.0, 2e-3), Vector3::new(-1e-3, 0.0, 2e-3)];
/// let found = judge_pose(&Vector3::zeros(), &attained).unwrap();
/// assert!((found.accuracy_m - 2e-3).abs() < 1e-12);
/// assert!((found.repeatability_m - 1e-3).abs() < 1e-12);
/// ```
#[must_use]
pub fn judge_pose(commanded_m: &Vector3<f64>, attained_m: &[Vector3<f64>]) -> Option<PoseFigures> {
    let (middle_m, repeatability_m) = scatter(attained_m)?;
    // With fewer than three cycles a third is one cycle.
    let third = (attained_m.len() / 3).max(1);
    let first = mean(attained_m.get(..third)?)?;
    let last = mean(attained_m.get(attained_m.len() - third..)?)?;
    Some(PoseFigures {
        accuracy_m: (middle_m - commanded_m).norm(),
        repeatability_m,
        drift_m: (last - first).norm(),
    })
}

/// Judges the distance between the positions attained at two poses, cycle by cycle.
///
/// ISO 9283:1998, 7.3.2 (AD) and 7.3.3 (RD). `None` for fewer than two cycles or for slices of
/// different lengths.
#[must_use]
pub(crate) fn judge_distance(
    commanded_m: [&Vector3<f64>; 2],
    attained_m: [&[Vector3<f64>]; 2],
) -> Option<DistanceFigures> {
    let [from, to] = attained_m;
    if from.len() != to.len() {
        return None;
    }
    let distances: Vec<f64> = from.iter().zip(to).map(|(a, b)| (a - b).norm()).collect();
    let (middle_m, deviation_m) = spread(&distances)?;
    Some(DistanceFigures {
        accuracy_m: middle_m - (commanded_m[0] - commanded_m[1]).norm(),
        repeatability_m: 3.0 * deviation_m,
    })
}

/// How a pose is reached: overshoot and stabilisation time.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Arrival {
    /// OV: greatest distance from the attained position after the tool first came within the band;
    /// 0 where it then stays within the band, m.
    pub overshoot_m: f64,
    /// From the first moment within the band to the last one outside of it, s; 0 where the tool
    /// does not leave the band again.
    pub stabilisation_s: f64,
}

/// Judges how the tool comes to rest (ISO 9283:1998, 7.4 and 7.5).
///
/// - `positions_m`: from the motion to the end of the wait, `step_s` apart, world frame, m.
/// - `attained_m`: where the tool rests, m.
/// - `band_m`: half width of the limit band, m.
///
/// `None` if the tool never comes within the band.
#[must_use]
pub(crate) fn judge_arrival(
    positions_m: &[Vector3<f64>],
    step_s: f64,
    attained_m: &Vector3<f64>,
    band_m: f64,
) -> Option<Arrival> {
    let off: Vec<f64> = positions_m
        .iter()
        .map(|p| (p - attained_m).norm())
        .collect();
    let first = off.iter().position(|d| *d <= band_m)?;
    let after = off.get(first..)?;
    let last_outside = after.iter().rposition(|d| *d > band_m);
    Some(Arrival {
        overshoot_m: last_outside.map_or(0.0, |_| after.iter().copied().fold(0.0, f64::max)),
        stabilisation_s: last_outside.map_or(0.0, |index| (index + 1) as f64 * step_s),
    })
}

/// Barycentre (m) and mean distance from it plus three standard deviations (m).
fn scatter(positions_m: &[Vector3<f64>]) -> Option<(Vector3<f64>, f64)> {
    let middle_m = mean(positions_m)?;
    let distances: Vec<f64> = positions_m.iter().map(|p| (p - middle_m).norm()).collect();
    let (mean_m, deviation_m) = spread(&distances)?;
    Some((middle_m, mean_m + 3.0 * deviation_m))
}

fn mean(positions_m: &[Vector3<f64>]) -> Option<Vector3<f64>> {
    let sum: Vector3<f64> = positions_m.iter().sum();
    (!positions_m.is_empty()).then(|| sum / positions_m.len() as f64)
}

/// Mean and standard deviation with `n - 1` in the denominator; `None` for fewer than two values.
fn spread(values: &[f64]) -> Option<(f64, f64)> {
    let n = values.len();
    if n < LEAST_CYCLES {
        return None;
    }
    let mean = values.iter().sum::<f64>() / n as f64;
    let squares: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
    Some((mean, (squares / (n - 1) as f64).sqrt()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repeatability_has_three_standard_deviations_of_the_distance_from_the_barycentre() {
        // Distances from the barycentre 3, 1, 1, 3 mm: mean 2, standard deviation sqrt(4/3).
        let at = |x: f64| Vector3::new(x * 1e-3, 0.0, 0.0);
        let found = judge_pose(&at(1.0), &[at(-3.0), at(-1.0), at(1.0), at(3.0)]).unwrap();
        let wanted = 2e-3 + 3.0 * (4.0_f64 / 3.0).sqrt() * 1e-3;
        assert!((found.repeatability_m - wanted).abs() < 1e-12);
        assert!((found.accuracy_m - 1e-3).abs() < 1e-12);
        // The first third is the first cycle, the last one the last.
        assert!((found.drift_m - 6e-3).abs() < 1e-12);
        assert_eq!(judge_pose(&at(0.0), &[at(1.0)]), None);
    }

    #[test]
    fn a_distance_that_comes_out_short_has_a_negative_accuracy() {
        let at = |x: f64| Vector3::new(x * 1e-3, 0.0, 0.0);
        let found = judge_distance(
            [&at(0.0), &at(100.0)],
            [&[at(0.0), at(1.0)], &[at(98.0), at(101.0)]],
        )
        .unwrap();
        assert!((found.accuracy_m + 1e-3).abs() < 1e-12);
        // 98 and 100 mm: standard deviation sqrt(2) mm.
        assert!((found.repeatability_m - 3.0 * 2.0_f64.sqrt() * 1e-3).abs() < 1e-12);
        assert_eq!(
            judge_distance([&at(0.0), &at(1.0)], [&[at(0.0)], &[]]),
            None
        );
    }

    #[test]
    fn an_overshoot_counts_from_the_first_moment_within_the_band() {
        let at = |x: f64| Vector3::new(x * 1e-3, 0.0, 0.0);
        let track = [50.0, 10.0, 0.5, -2.0, -1.5, 0.8, 0.1, 0.0].map(at);
        let found = judge_arrival(&track, 0.001, &at(0.0), 1e-3).unwrap();
        assert!((found.overshoot_m - 2e-3).abs() < 1e-12);
        assert!((found.stabilisation_s - 3e-3).abs() < 1e-12);
        let calm = judge_arrival(&track[5..], 0.001, &at(0.0), 1e-3).unwrap();
        assert_eq!((calm.overshoot_m, calm.stabilisation_s), (0.0, 0.0));
        assert_eq!(judge_arrival(&track[..2], 0.001, &at(0.0), 1e-3), None);
    }
}
