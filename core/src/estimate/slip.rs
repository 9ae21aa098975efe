//! Which cable slipped: its length is off while the others, the tensions and the pictures agree.

use super::fix::{Estimate, EstimateError, solve};
use super::held;
use super::rows::{Measurements, Sigmas};
use crate::motion::Model;
use nalgebra::Vector4;

/// Below this sum of squares per degree of freedom there is no fault.
const FINE: f64 = 3.0;
/// A cable is named when leaving its length out explains this share of the disagreement.
const EXPLAINS: f64 = 0.7;
/// And the next best cable explains it less well by this factor.
const CLEARER: f64 = 1.5;

/// A cable that slipped.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Slip {
    /// The cable, 1 for the first.
    pub cable: usize,
    /// How much longer it truly is than its encoder says, m.
    pub slip_m: f64,
    /// Whether no other cable explains it nearly as well.
    pub clear: bool,
}

/// Names the cable whose length disagrees with everything else; `None` where all agree. The
/// estimate is the one from the same measurements.
///
/// # Errors
/// As [`super::estimate`].
pub fn find_slip(
    model: &Model,
    measured: &Measurements,
    sigmas: &Sigmas,
    estimate: &Estimate,
) -> Result<Option<Slip>, EstimateError> {
    // With one degree of freedom every cable explains the disagreement alike.
    if estimate.freedoms < 2 || estimate.chi2 < FINE * estimate.freedoms as f64 {
        return Ok(None);
    }
    let mut found: Vec<(f64, Slip)> = Vec::new();
    for cable in 0..measured.lengths_m.len() {
        let state = without(cable, model, measured, sigmas, estimate)?;
        let left = state.chi2;
        let said = state.rest.paid_out_m.get(cable).copied().unwrap_or(0.0);
        let read = measured.lengths_m.get(cable).copied().unwrap_or(0.0);
        found.push((
            left,
            Slip {
                cable: cable + 1,
                slip_m: said - read,
                clear: false,
            },
        ));
    }
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    let Some((left, mut best)) = found.first().copied() else {
        return Ok(None);
    };
    // No single length explains the disagreement: naming one would send the user to a good drum.
    if left > (1.0 - EXPLAINS) * estimate.chi2 {
        return Ok(None);
    }
    best.clear = found
        .get(1)
        .is_none_or(|(next, _)| *next > CLEARER * left.max(estimate.freedoms as f64));
    Ok(Some(best))
}

/// The estimate without the length of a cable (from 0).
fn without(
    cable: usize,
    model: &Model,
    measured: &Measurements,
    sigmas: &Sigmas,
    estimate: &Estimate,
) -> Result<Estimate, EstimateError> {
    if !model.holding().hangs() {
        let start = estimate.rest.equilibrium.pose;
        return held::solve(model, measured, sigmas, start, Some(cable));
    }
    let held = model.holding().first_by_tension().unwrap_or(0);
    let tension = estimate.rest.tensions_n().get(held).copied().unwrap_or(1.0);
    let tool = &estimate.tool_m;
    let start = Vector4::new(tool.x, tool.y, tool.z, tension);
    solve(model, measured, sigmas, start, Some(cable))
}

#[cfg(test)]
mod tests {
    use super::super::estimate;
    use super::*;
    use crate::robot::Robot;
    use nalgebra::Vector3;

    fn hanging(model: &Model, at: &Vector3<f64>) -> Measurements {
        let rest = model.rest(at, None).unwrap();
        Measurements {
            lengths_m: rest.paid_out_m.clone(),
            tensions_n: rest.tensions_n().to_vec(),
            ..Measurements::default()
        }
    }

    #[test]
    fn exact_measurements_give_the_place_and_an_honest_covariance() {
        let model = Model::new(&Robot::built_in("paper-optimistic").unwrap()).unwrap();
        let at = Vector3::new(0.30, -0.05, -0.22);
        let measured = hanging(&model, &at);
        let start = Vector3::new(0.335, 0.0, -0.18);
        let found = estimate(&model, &measured, &Sigmas::default(), &start).unwrap();
        assert!((found.tool_m - at).norm() < 1e-7, "{}", found.tool_m - at);
        assert_eq!(found.freedoms, 4);
        assert!(found.chi2 < 1e-6);
        let sigma_m = found.covariance_m2.diagonal().map(f64::sqrt);
        // Of the order of the scatter of the lengths.
        assert!(
            sigma_m.iter().all(|s| (5e-5..3e-3).contains(s)),
            "{sigma_m}"
        );
    }

    #[test]
    fn a_slipping_cable_is_named() {
        let model = Model::new(&Robot::built_in("paper-optimistic").unwrap()).unwrap();
        let at = Vector3::new(0.30, -0.05, -0.22);
        for cable in 0..4 {
            let mut measured = hanging(&model, &at);
            measured.lengths_m[cable] -= 0.006;
            let sigmas = Sigmas::default();
            let found = estimate(&model, &measured, &sigmas, &at).unwrap();
            assert!(
                found.redundancy().unwrap() > 2.0,
                "{:?}",
                found.redundancy()
            );
            let slip = find_slip(&model, &measured, &sigmas, &found)
                .unwrap()
                .unwrap();
            assert_eq!(slip.cable, cable + 1);
            assert!((slip.slip_m - 0.006).abs() < 1e-3, "{slip:?}");
        }
        let fine = hanging(&model, &at);
        let found = estimate(&model, &fine, &Sigmas::default(), &at).unwrap();
        assert_eq!(
            find_slip(&model, &fine, &Sigmas::default(), &found).unwrap(),
            None
        );
    }

    #[test]
    fn too_little_and_nonsense_are_refused() {
        let model = Model::new(&Robot::built_in("paper-optimistic").unwrap()).unwrap();
        let at = Vector3::new(0.30, -0.05, -0.22);
        let nothing = Measurements::default();
        assert!(estimate(&model, &nothing, &Sigmas::default(), &at).is_err());
        let mut wrong = hanging(&model, &at);
        wrong.lengths_m[2] = f64::NAN;
        assert!(matches!(
            estimate(&model, &wrong, &Sigmas::default(), &at),
            Err(EstimateError::NotFinite)
        ));
    }
}
