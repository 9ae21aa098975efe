//! Weights of the encoders' rows: their noise, and the stretch of cables that differ in stiffness.

use super::data::Data;

/// Relative spread of the cables' stiffness about the common one, one standard deviation: an assumption.
/// Pieces of one line differ by some per cent, and their ends and the layers on the drum add to it.
const EA_SPREAD: f64 = 0.1;

/// Standard deviation of the encoders' lengths, m, by pose and cable: their noise, and the stretch of a
/// cable whose stiffness is not quite the one that all share. A constant stretch is part of the initial
/// length; the tension's deviation from its mean over the poses is not. Where the root mean square of
/// that stretch is less than the encoders' noise, as with short cables, it is neglected.
///
/// Measurements alone determine it: every step of the estimate is judged by the same weights.
pub(crate) fn encoder_sigmas_m(data: &Data, statics: bool) -> Vec<Vec<f64>> {
    let (noise_m, cables) = (data.noise.encoder_m, data.robot.cables.len());
    let by_pose = stretch_m(data);
    let squares: Vec<f64> = by_pose.iter().flatten().flatten().map(|s| s * s).collect();
    let rms_m = (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt();
    let matters = statics && rms_m > noise_m;
    let sigmas = by_pose.iter().map(|pose| match pose {
        Some(stretch) if matters => stretch.iter().map(|s| noise_m.hypot(*s)).collect(),
        _ => vec![noise_m; cables],
    });
    sigmas.collect()
}

/// The stretch by one standard deviation of a cable's stiffness, m, by pose and cable; `None` for poses
/// without tensions.
fn stretch_m(data: &Data) -> Vec<Option<Vec<f64>>> {
    let tensions = || data.poses.iter().filter_map(|pose| pose.tension_n.as_ref());
    let count = tensions().count().max(1) as f64;
    let half_span_m = half_span_m(data);
    let cables = 0..data.robot.cables.len();
    let mean_n: Vec<f64> = cables
        .map(|i| tensions().map(|t| t[i]).sum::<f64>() / count)
        .collect();
    let one = |i: usize, tension_n: f64| {
        let stretching_m = half_span_m + data.robot.routing_m[i];
        EA_SPREAD * data.robot.compliance_per_n * (tension_n - mean_n[i]) * stretching_m
    };
    let all = data.poses.iter().map(|seen| seen.tension_n.as_deref());
    let pose = |tension_n: &[f64]| {
        let cables = tension_n.iter().enumerate();
        cables.map(|(i, t)| one(i, *t)).collect()
    };
    all.map(|tension_n| tension_n.map(pose)).collect()
}

/// Half of the greatest distance between two anchors, m: about a cable's free length.
fn half_span_m(data: &Data) -> f64 {
    let cables = &data.robot.cables;
    let pairs = cables
        .iter()
        .flat_map(|a| cables.iter().map(move |b| (a.anchor_m - b.anchor_m).norm()));
    0.5 * pairs.fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::super::simulate::{Setup, simulate};
    use super::*;

    fn data() -> Data {
        simulate(&Setup {
            poses: 4,
            ..Setup::default()
        })
        .unwrap()
        .0
    }

    /// Cable 1 at 10, 30, 50 and 70 N: 30 N below the mean at the first pose.
    fn pulled(mut data: Data) -> Data {
        for (pose, first) in data.poses.iter_mut().zip([10.0, 30.0, 50.0, 70.0]) {
            pose.tension_n = Some(vec![first, 20.0, 20.0, 20.0]);
        }
        data
    }

    #[test]
    fn a_soft_cable_adds_its_stretch_to_the_noise_and_a_stiff_one_adds_nothing() {
        let mut data = pulled(data());
        data.robot.compliance_per_n = 1.0 / 2e3;
        let stretching_m = half_span_m(&data) + data.robot.routing_m[0];
        // A tenth of 30 N in 2 kN.
        let expected = data.noise.encoder_m.hypot(1.5e-3 * stretching_m);
        let sigmas = encoder_sigmas_m(&data, true);
        assert!((sigmas[0][0] - expected).abs() < 1e-12, "{}", sigmas[0][0]);
        assert!(sigmas[1][0] < sigmas[0][0] && sigmas[0][0] > 5.0 * data.noise.encoder_m);
        // A constant tension says nothing: its stretch is part of the initial length.
        assert_eq!(sigmas[0][1], data.noise.encoder_m);
        data.robot.compliance_per_n = 1.0 / 50e6;
        let noise = vec![vec![data.noise.encoder_m; 4]; 4];
        assert_eq!(encoder_sigmas_m(&data, true), noise);
    }

    #[test]
    fn without_tensions_or_statics_only_the_noise_counts() {
        let mut data = pulled(data());
        data.robot.compliance_per_n = 1.0 / 2e3;
        let noise = vec![data.noise.encoder_m; 4];
        assert_eq!(encoder_sigmas_m(&data, false)[0], noise);
        data.poses[0].tension_n = None;
        let sigmas = encoder_sigmas_m(&data, true);
        assert_eq!(sigmas[0], noise);
        assert!(sigmas[3][0] > data.noise.encoder_m);
    }
}
